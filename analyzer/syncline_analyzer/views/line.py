"""A line of the screen: pieces of text in their styles, and what breaks and measures texts.

rich knows how wide characters are and what colours them. It is asked only where it must be: to
import it takes longer than to print a screen.
"""

import re
from typing import TYPE_CHECKING

from syncline_schemas.named_tuples import NamedTuple

if TYPE_CHECKING:
    from rich.text import Text

_WORD = re.compile(r" *[^ ]+ *")


class Line(NamedTuple):
    """Pieces of text, each with its style as rich names it, "" for none."""

    pieces: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, text: str, style: str = "") -> "Line":
        """A line of one style."""
        return cls(((text, style),))

    @property
    def plain(self) -> str:
        """Its text without styles."""
        return "".join(text for text, _ in self.pieces)

    def coloured(self) -> "Text":
        """The same for a console."""
        from rich.text import Text

        return Text.assemble(*self.pieces)


def columns(text: str) -> int:
    """Columns that a text takes: some characters take two, some none."""
    if _is_plain(text):
        return len(text)
    from rich.cells import cell_len

    return cell_len(text)


def fitted(text: str, width: int) -> str:
    """A text cut, or filled with blanks, to so many columns."""
    if _is_plain(text):
        return text[:width].ljust(width)
    from rich.cells import set_cell_size

    return set_cell_size(text, width)


def broken(text: str, width: int) -> list[str]:
    """A text broken between words into rows of so many columns, longer words anywhere.

    >>> broken("Node 5 was lost.", 8)
    ['Node 5', 'was', 'lost.']
    """
    width = max(width, 1)
    if not _is_plain(text):
        from rich.console import Console
        from rich.text import Text

        return [row.plain.rstrip() for row in Text(text).wrap(Console(color_system=None), width)]
    starts, taken = [0], 0
    for word in _WORD.finditer(text):
        length = len(word[0].rstrip())
        if taken + length <= width:
            taken += len(word[0])
            continue
        step = width if length > width else len(word[0])
        starts += [at for at in range(word.start(), word.end(), step) if at]
        taken = word.end() - starts[-1]
    ends = [*starts[1:], len(text)]
    return [text[start:end].rstrip() for start, end in zip(starts, ends, strict=True)]


def _is_plain(text: str) -> bool:
    """Whether each character takes one column."""
    return text.isascii() and text.isprintable()
