"""One line through the samples of several sources of a trace, unwrapped from piece to piece."""

from collections.abc import Callable
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.samples import Samples
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = NDArray[np.intp]
Step = Callable[[Floats, Floats], Floats]
"""(differences (n,), widths (n,)) -> the shortest way modulo the widths."""

BETTER = 2.0
"""So many times better a source must be to take over from the one that leads or is counted."""
HEARD_NS = 1_000_000_000
"""So long, or ten times its usual spacing, the leading source may be silent and lead on."""


@dataclass(slots=True)
class Link:
    """Where a piece ends: what the next samples are compared with.

    One source leads: its samples are joined the shortest way, and those of the others are laid
    onto its line modulo their own width, for they carry values of another age.
    """

    unwrapped: float | None = None
    """Where the line ends; None where nothing is joined to what comes."""
    seq: int = 0
    width: float = np.inf
    """What the values of the leading source repeat after."""
    offset: float | None = None
    """What is added to the line for the value in the whole range; None while only lower bits of
    it were seen."""
    leader: int | None = None
    counted: int | None = None
    """Source whose samples tell the motion: the one that comes most often."""
    heard_ns: int = 0
    shown: tuple[float, float] | None = None
    """(value, line) of the last counted sample."""
    sources: dict[int, tuple[int, float]] = field(default_factory=dict)
    """(t_ns, value) of the last sample by source."""
    spacing_ns: dict[int, float] = field(default_factory=dict)
    jump_ns: int | None = None
    steps: dict[int, tuple[int, int]] = field(default_factory=dict)
    """The last two steps [counts] by source, 0 where there is none."""
    measured_ns: dict[int, float] = field(default_factory=dict)
    """By source: after what time the value is usually another one, where it stands in between."""

    def cut(self) -> None:
        """Forget everything but the usual spacing."""
        self.unwrapped = self.offset = self.shown = self.leader = self.counted = None
        self.width = np.inf
        self.sources.clear()
        self.steps.clear()


class Line(NamedTuple):
    """The line through a piece; all (n,).

    unwrapped: NaN where a sample tells nothing. counted: rows of the source that tells the motion.
    """

    unwrapped: Floats
    counted: Mask


def line_through(
    link: Link, piece: Samples, value: Floats, width: Floats, whole: float, step: Step
) -> Line:
    """Join the samples of a piece to the line that ends in `link`, which is moved to its end.

    Args:
        link: where the piece before ended.
        piece: the samples.
        value: (n,) what was sent.
        width: (n,) what it repeats after.
        whole: what the quantity itself repeats after.
        step: the shortest way.
    """
    unwrapped = np.full(len(value), np.nan)
    counted = np.zeros(len(value), np.bool_)
    rows = _by_source(piece)
    if not rows:
        return Line(unwrapped, counted)
    leader = _leader(link, piece, rows, width)
    lead = rows.get(leader, np.zeros(0, np.intp))
    seq, line = _led(link, piece, lead, value, width, whole, step)
    unwrapped[lead] = line[1:]
    others = np.sort(
        np.concatenate([each for name, each in rows.items() if name != leader] or [lead[:0]])
    )
    if len(others):
        near = np.interp(piece.seq[others], seq, line)
        wide = np.flatnonzero(width[others] >= whole)
        if link.offset is None and len(wide):
            _place(link, float(value[others[wide[0]]]), float(near[wide[0]]))
        away = value[others] - (near + (link.offset or 0.0))
        unwrapped[others] = near + step(away, width[others])
    counted[_counted(link, piece, rows, leader)] = True
    return Line(unwrapped, counted)


def wraps(link: Link, line: Line, value: Floats, whole: float) -> Mask:
    """Where the value (n,) goes over the end of its range while the line goes on."""
    found = np.zeros(len(value), np.bool_)
    rows = np.flatnonzero(line.counted)
    if len(rows):
        shown, drawn = link.shown or (float(value[rows[0]]), float(line.unwrapped[rows[0]]))
        plain = np.diff(np.concatenate(([shown], value[rows])))
        moved = np.diff(np.concatenate(([drawn], line.unwrapped[rows])))
        found[rows] = np.abs(plain - moved) > min(whole, link.width) / 2
        link.shown = float(value[rows[-1]]), float(line.unwrapped[rows[-1]])
    return found


def _by_source(piece: Samples) -> dict[int, Rows]:
    """Rows that tell something, by source, the first one heard first."""
    told = piece.told
    if not told.any():
        return {}
    # Sources are COB-IDs or -1, so counting them beats sorting them.
    numbers = (np.flatnonzero(np.bincount(piece.source[told] + 1)) - 1).tolist()
    found = {number: np.flatnonzero(told & (piece.source == number)) for number in numbers}
    return dict(sorted(found.items(), key=lambda item: int(item[1][0])))


def _spacing(link: Link, piece: Samples, source: int, rows: Rows) -> float:
    """Usual time between samples of a source [ns]; without times the share of others."""
    usual_ns = link.spacing_ns.get(source, 0.0)
    span_ns = float(int(piece.t_ns[rows[-1]]) - int(piece.t_ns[rows[0]]))
    if usual_ns > 0.0:
        return usual_ns
    if len(rows) > 1 and span_ns > 0.0:
        return span_ns / (len(rows) - 1)
    return 1e15 / len(rows)


def _leader(link: Link, piece: Samples, rows: dict[int, Rows], width: Floats) -> int:
    """The source that tells the fastest motion; another one takes over only if far better."""
    reach = {
        source: min(float(width[own].min()), 1e15) / _spacing(link, piece, source, own)
        for source, own in rows.items()
    }
    best = max(reach.values())
    if link.leader in reach and BETTER * reach[link.leader] >= best:
        return link.leader
    if link.leader is not None and link.leader not in reach:
        last_ns = max(int(piece.t_ns[own[-1]]) for own in rows.values())
        usual_ns = link.spacing_ns.get(link.leader, 0.0)
        if last_ns - link.heard_ns <= max(HEARD_NS, 10 * usual_ns):
            return link.leader
    return next(source for source in rows if BETTER * reach[source] >= best)


def _counted(link: Link, piece: Samples, rows: dict[int, Rows], leader: int) -> Rows:
    """Rows of the source that comes most often: the leading one unless another is far better."""
    spacing = {source: _spacing(link, piece, source, own) for source, own in rows.items()}
    often = min(spacing, key=lambda source: spacing[source])
    kept = (name for name in (link.counted, leader) if name in spacing)
    often = next((name for name in kept if spacing[name] <= BETTER * spacing[often]), often)
    if link.counted is not None and link.counted not in rows:
        last_ns = max(int(piece.t_ns[own[-1]]) for own in rows.values())
        if last_ns - link.heard_ns <= HEARD_NS:
            return rows[often][:0]
    link.counted = often
    return rows[often]


def _led(
    link: Link,
    piece: Samples,
    lead: Rows,
    value: Floats,
    width: Floats,
    whole: float,
    step: Step,
) -> tuple[NDArray[np.int64], Floats]:
    """(seq, line) of the leading source, with the end of the piece before in front."""
    if link.unwrapped is None:
        first = int(lead[0])
        link.unwrapped, link.seq = float(value[first]), int(piece.seq[first])
        link.offset = 0.0 if width[first] >= whole else None
        link.width = float(width[first])
    seq = np.concatenate(([link.seq], piece.seq[lead]))
    if not len(lead):
        return seq, np.array([link.unwrapped])
    if link.offset is None and width[lead[0]] >= whole:
        _place(link, float(value[lead[0]]), link.unwrapped)
    before = link.unwrapped + (link.offset or 0.0)
    steps = step(np.diff(np.concatenate(([before], value[lead]))), width[lead])
    line = link.unwrapped + np.concatenate(([0.0], np.cumsum(steps)))
    link.unwrapped, link.seq = float(line[-1]), int(piece.seq[lead[-1]])
    link.width = float(width[lead].min())
    link.leader, link.heard_ns = int(piece.source[lead[0]]), int(piece.t_ns[lead[-1]])
    return seq, line


def _place(link: Link, value: float, drawn: float) -> None:
    """Learn in which of the turns that look alike the line is, from a value that tells it."""
    link.offset = round((value - drawn) / link.width) * link.width
    link.shown = None
