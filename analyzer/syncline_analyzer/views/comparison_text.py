"""A comparison as text for a terminal, the most serious difference first."""

from collections.abc import Iterator
from io import StringIO

from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from syncline_analyzer.comparison.rows import Comparison, ComparisonRow
from syncline_analyzer.views.comparison_words import (
    comparison_verdict,
    evidence,
    place,
    side_words,
    unseen_line,
)
from syncline_analyzer.views.palette import SEVERITY_COLOURS, css
from syncline_analyzer.views.words import printable

PIPE_WIDTH = 120
MAX_UNSEEN = 10
"""Lines of what was not seen; a note says how many there are in all."""
_WORDS = {"error": "ERROR", "warning": "WARNING", "info": "NOTE"}


def comparison_text(comparison: Comparison, *, width: int = PIPE_WIDTH) -> str:
    """The comparison as plain text without colours."""
    out = StringIO()
    print_comparison(comparison, Console(file=out, width=width, color_system=None))
    return out.getvalue()


def print_comparison(comparison: Comparison, console: Console) -> None:
    """Print the comparison."""
    for part in _parts(comparison):
        console.print(part, highlight=False)


def _parts(comparison: Comparison) -> Iterator[RenderableType]:
    golden = side_words(comparison.golden, comparison.golden_heard_s)
    capture = side_words(comparison.capture, comparison.capture_heard_s)
    yield Text(f"golden   {golden}", style="dim")
    yield Text(f"capture  {capture}", style="dim")
    yield Text(comparison_verdict(comparison), style="bold")
    for row in comparison.rows:
        yield from _difference(row, comparison)
    if comparison.unseen:
        yield Text("\nNot seen in one of both (no difference)", style="bold underline")
        for each in comparison.unseen[:MAX_UNSEEN]:
            yield Text(unseen_line(each), style="dim")
        if (rest := len(comparison.unseen) - MAX_UNSEEN) > 0:
            yield Text(f"and {rest} more", style="dim")


def _difference(row: ComparisonRow, comparison: Comparison) -> Iterator[RenderableType]:
    head = Text("\n")
    colour = css(SEVERITY_COLOURS[row.severity])
    head.append(f"{_WORDS[row.severity]} ", style=f"bold {colour}")
    head.append(printable(f"{place(row)}: {row.subject}"), style="bold")
    yield head
    body = Table.grid(padding=(0, 1))
    body.add_row("", Text(printable(row.text)))
    for label, told in (("golden", row.golden), ("capture", row.capture), ("why", row.why)):
        if told not in row.text:
            body.add_row(Text(label, style="dim"), Text(printable(told)))
    proof = "; ".join(evidence(row, comparison)) or "the whole of both"
    body.add_row(Text("evidence", style="dim"), Text(f"{proof}  [{row.kind}]", style="dim"))
    yield Padding(body, (0, 0, 0, 2))
