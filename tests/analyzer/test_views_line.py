"""Texts are broken, measured and cut as rich does it, whether it is asked or not."""

from io import StringIO

from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len, set_cell_size
from rich.console import Console
from rich.text import Text

from syncline_analyzer.views.line import Line, broken, columns, fitted

PLAIN = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=80)
WORDS = st.lists(st.text("ab-.", max_size=12), max_size=20).map(" ".join)
ANY = st.text(max_size=40)
TEXTS = PLAIN | WORDS | ANY
CONSOLE = Console(file=StringIO(), color_system=None)


@given(TEXTS, st.integers(-1, 40))
def test_rows_are_those_of_rich(text: str, width: int) -> None:
    rows = Text(text).wrap(CONSOLE, max(width, 1))
    assert broken(text, width) == [row.plain.rstrip() for row in rows]


@given(TEXTS, st.integers(0, 40))
def test_columns_are_those_of_rich(text: str, width: int) -> None:
    assert columns(text) == cell_len(text)
    assert fitted(text, width) == set_cell_size(text, width)


def test_pieces_keep_their_styles() -> None:
    line = Line((("1 ", ""), ("ERROR", "bold red"), (" lost", "")))
    out = StringIO()
    Console(file=out, force_terminal=True, color_system="standard").print(line.coloured())
    assert line.plain == "1 ERROR lost"
    assert out.getvalue() == "1 \x1b[1;31mERROR\x1b[0m lost\n"
