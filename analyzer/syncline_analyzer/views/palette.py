"""Colours that mean the same in every view, and stay apart for people who see red and green alike."""

from syncline_schemas.canopen.nmt import NmtState

Rgb = tuple[int, int, int]

STATE_COLOURS: dict[str, Rgb] = {
    NmtState.INITIALISING: (171, 130, 255),
    NmtState.PRE_OPERATIONAL: (255, 193, 7),
    NmtState.OPERATIONAL: (67, 160, 71),
    NmtState.STOPPED: (30, 136, 229),
    NmtState.LOST: (229, 57, 53),
    NmtState.UNKNOWN: (158, 158, 158),
}
"""Fill of a lane by NMT state."""

STATE_LETTERS: dict[str, str] = {
    NmtState.INITIALISING: "I",
    NmtState.PRE_OPERATIONAL: "P",
    NmtState.OPERATIONAL: "O",
    NmtState.STOPPED: "S",
    NmtState.LOST: "L",
    NmtState.UNKNOWN: "?",
}
"""One letter per state, so that no view needs its colours to be understood."""

URGENCY: tuple[str, ...] = (
    NmtState.UNKNOWN,
    NmtState.OPERATIONAL,
    NmtState.PRE_OPERATIONAL,
    NmtState.STOPPED,
    NmtState.INITIALISING,
    NmtState.LOST,
)
"""States in the order in which they are drawn: where two share a pixel the later one is seen."""

SEVERITY_COLOURS: dict[str, Rgb] = {
    "error": (211, 47, 47),
    "warning": (245, 124, 0),
    "info": (25, 118, 210),
}

EMCY_COLOUR: Rgb = (255, 45, 120)
EMCY_CLEAR_COLOUR: Rgb = (0, 200, 170)
GAP_COLOUR: Rgb = (120, 120, 120)
MARK_COLOUR: Rgb = (150, 90, 255)

LINE_COLOURS: tuple[Rgb, ...] = (
    (80, 160, 255),
    (255, 160, 60),
    (90, 200, 120),
    (200, 120, 255),
    (240, 220, 80),
    (60, 210, 220),
    (255, 130, 170),
    (170, 190, 90),
)
"""Colours of series, in turn."""


def line_colour(number: int) -> Rgb:
    """Colour of the n-th series of a plot."""
    return LINE_COLOURS[number % len(LINE_COLOURS)]


def paler(colour: Rgb) -> Rgb:
    """A colour for what lies behind a line of that colour, to be told apart on black and on white.

    >>> paler((80, 160, 255))
    (115, 155, 202)
    """
    red, green, blue = ((part + _MIDDLE_GREY) // 2 for part in colour)
    return red, green, blue


_MIDDLE_GREY = 150


def css(colour: Rgb) -> str:
    """A colour as CSS and rich write it.

    >>> css((255, 0, 16))
    '#ff0010'
    """
    return "#{:02x}{:02x}{:02x}".format(*colour)


def rgba(colour: Rgb) -> int:
    """A colour as Rerun packs it.

    >>> hex(rgba((255, 0, 16)))
    '0xff0010ff'
    """
    red, green, blue = colour
    return red << 24 | green << 16 | blue << 8 | 0xFF
