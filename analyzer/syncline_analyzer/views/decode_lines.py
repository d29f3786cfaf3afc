"""Decoded frames as lines of text: one frame a line, columns that stay where they are."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field
from itertools import repeat
from textwrap import wrap
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.decode.part import Head, Part, Rows, Tone, Words
from syncline_analyzer.decode.stream import DecodedBatch, Decoding
from syncline_analyzer.views.words import capture_time, duration, printable
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.records import dataclass
from syncline_schemas.wording import counted

T = TypeVar("T")

_DATA_WIDTH = 23
_NAME_WIDTH = 16
_SERVICE_WIDTH = 9
_WITH_DATA, _WITH_SEQ, _WITH_ID = 118, 96, 72
"""Columns of a terminal from which on there is room for each."""
_LEAST_ROOM = 14
_SECOND = 1_000_000_000
_THREE = [f"{number:03}" for number in range(1000)]

PLAIN: Mapping[Tone, tuple[str, str]] = MappingProxyType({})
_RESET = "\x1b[0m"
COLOURS: Mapping[Tone, tuple[str, str]] = MappingProxyType(
    {
        Tone.QUIET: ("\x1b[2m", _RESET),
        Tone.ORDER: ("\x1b[1;33m", _RESET),
        Tone.GOOD: ("\x1b[32m", _RESET),
        Tone.BAD: ("\x1b[1;31m", _RESET),
    }
)
"""What is written before and after the words of each tone."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Which columns there are, and how wide a line may be.

    Attributes:
        width: columns of the terminal, None where lines may be of any length.
        utc: times are dates, not capture times.
        timed: there are times at all.
        colours: what is written around words, by tone.
    """

    width: int | None = None
    utc: bool = False
    timed: bool = True
    colours: Mapping[Tone, tuple[str, str]] = field(default_factory=lambda: PLAIN)

    @property
    def data(self) -> bool:
        """Whether the bytes are shown."""
        return self.width is None or self.width >= _WITH_DATA

    @property
    def seq(self) -> bool:
        """Whether the place in the capture is shown."""
        return self.width is None or self.width >= _WITH_SEQ

    @property
    def roomy(self) -> bool:
        """Whether there is room for identifiers, names and microseconds."""
        return self.width is None or self.width >= _WITH_ID

    @property
    def time_width(self) -> int:
        """Columns that a time takes."""
        return (19 if self.utc else 8) + (7 if self.roomy else 4)


class DecodedLines:
    """Writes decoded batches as lines.

    Args:
        first_ns: the stamp from which capture time counts.
        headed: a line above all others names the columns.
    """

    def __init__(
        self, decoding: Decoding, columns: Columns, first_ns: int, *, headed: bool = False
    ) -> None:
        self._decoding = decoding
        self._columns = columns
        self._first_ns = first_ns
        self._headed = headed
        self._buses = decoding.buses > 1
        """Whether there are several, so that each line names its own; a log may show so late."""

    def _names(self) -> str:
        """The names of the columns."""
        columns = self._columns
        cells = [f"{'frame':>8}"] * columns.seq
        cells += [f"{'time':>{columns.time_width}}"] * columns.timed
        cells += [f"{'bus':<6}"] * self._buses
        if columns.roomy:
            cells += [f"{'COB-ID':<8}", f"{'service':<{_SERVICE_WIDTH}}"]
            cells.append(f"{'node':<{_NAME_WIDTH}}")
        else:
            cells += [f"{'service':<{_SERVICE_WIDTH}}", f"{'node':>4}"]
        cells += [f"{'data':<{_DATA_WIDTH}}"] * columns.data
        cells.append("meaning")
        before, after = columns.colours.get(Tone.QUIET, ("", ""))
        return f"{before}{' '.join(cells)}{after}"

    def lines(self, item: DecodedBatch | Gap) -> list[str]:
        """The lines of a batch in the order of its frames, or that of a gap."""
        if self._headed:
            self._headed = False
            return [self._names(), *self.lines(item)]
        if isinstance(item, Gap):
            return [self._gap(item)]
        self._buses = self._buses or self._decoding.buses > 1
        found, rows = in_order(item.parts, len(item.batch), self._texts(item))
        prefixes = self._prefixes(item, rows)
        if prefixes is None:
            return found
        return [prefix + text for prefix, text in zip(prefixes, found, strict=True)]

    def _prefixes(self, item: DecodedBatch, rows: NDArray[np.intp]) -> Iterator[str] | None:
        columns = self._columns
        seqs = item.batch.seqs_at(rows).tolist()
        if not columns.timed:
            return (f"{seq:>8} " for seq in seqs) if columns.seq else None
        times = self._times(item.batch.frames.t_ns[rows])
        if not columns.seq:
            return (f"{time} " for time in times)
        return (f"{seq:>8} {time} " for seq, time in zip(seqs, times, strict=True))

    def _times(self, t_ns: NDArray[np.int64]) -> Iterator[str]:
        """Times of equal width; the seconds of each are written once."""
        since_us = (t_ns if self._columns.utc else t_ns - self._first_ns) // 1000
        seconds, parts_us = np.divmod(since_us, 1_000_000)
        listed, which = np.unique(seconds, return_inverse=True)
        written = [self._second(second) for second in listed.tolist()]
        whole = [written[at] for at in which.tolist()]
        ms, us = np.divmod(parts_us, 1000)
        three = _THREE
        if not self._columns.roomy:
            return (f"{a}.{three[b]}" for a, b in zip(whole, ms.tolist(), strict=True))
        return (
            f"{a}.{three[b]}{three[c]}"
            for a, b, c in zip(whole, ms.tolist(), us.tolist(), strict=True)
        )

    def _second(self, second: int) -> str:
        if self._columns.utc:
            return str(np.datetime64(second, "s")).replace("T", " ")
        return f"{capture_time(second * _SECOND).removesuffix('.000'):>8}"

    def _texts(self, item: DecodedBatch) -> Iterator[list[str]]:
        """For each part its distinct lines without what differs by frame."""
        columns = self._columns
        for part in item.parts:
            head, words = self._head(part.head), part.words
            data = payloads(item.batch.frames, part.first)
            texts = [
                told.text if not told.opaque else self._opaque(told.text, shown)
                for told, shown in zip(words, data, strict=True)
            ]
            indent = len(head) + self._before
            if columns.data:
                cells = (d if len(d) <= _DATA_WIDTH else f"{d[: _DATA_WIDTH - 3]} .." for d in data)
                heads: Iterable[str] = (f"{head}{cell:<{_DATA_WIDTH}} " for cell in cells)
                indent += _DATA_WIDTH + 1
            else:
                heads = repeat(head, len(texts))
            if (width := columns.width) is not None:
                texts = [_wrapped(text, indent, width) for text in texts]
            lines = [a + b for a, b in zip(heads, texts, strict=True)]
            yield self._coloured(lines, words) if columns.colours else lines

    def _opaque(self, text: str, data: str) -> str:
        """What is said of a frame of which only the bytes are known: those, unless shown already."""
        if self._columns.data and len(data) <= _DATA_WIDTH:
            return text or "-"
        return f"{text}: {data}" if text else data or "-"

    def _coloured(self, lines: list[str], words: list[Words]) -> list[str]:
        plain = ("", "")
        marks = [self._columns.colours.get(told.tone, plain) for told in words]
        return [f"{mark[0]}{line}{mark[1]}" for mark, line in zip(marks, lines, strict=True)]

    @property
    def _before(self) -> int:
        """Columns before the words that depend on the identifier."""
        columns = self._columns
        return 9 * columns.seq + (columns.time_width + 1) * columns.timed

    def _head(self, head: Head) -> str:
        columns = self._columns
        cells = [f"{self._decoding.bus_name(head.bus):<6}"] * self._buses
        if not columns.roomy:
            node = "" if head.node is None else "all" if head.node == 0 else str(head.node)
            return " ".join([*cells, f"{head.service:<{_SERVICE_WIDTH}}", f"{node:>4}", ""])
        label = "" if head.node is None else self._decoding.label(head.bus, head.node)
        if len(label) > _NAME_WIDTH:
            label = f"{label[: _NAME_WIDTH - 2]}.."
        cob_id = f"{head.can_id:08X}" if head.extended else f"{head.can_id:03X}h"
        if head.family == "error":
            cob_id = "-"
        cells += [f"{cob_id:<8}", f"{head.service:<{_SERVICE_WIDTH}}", f"{label:<{_NAME_WIDTH}}"]
        return " ".join([*cells, ""])

    def _gap(self, gap: Gap) -> str:
        bus = "" if gap.bus is None else f" on {printable(self._decoding.bus_name(gap.bus))}"
        lost = "" if gap.lost_frames is None else f", {counted(gap.lost_frames, 'frame')} lost"
        blind = f" for {duration(gap.end_ns - gap.start_ns)}" if self._columns.timed else ""
        text = f"--- nothing heard{bus}{blind}: {printable(gap.reason)}{lost} ---"
        if self._columns.width is not None:
            text = "\n".join(wrap(text, self._columns.width))
        before, after = self._columns.colours.get(Tone.BAD, ("", ""))
        return f"{before}{text}{after}"


def in_order(
    parts: list[Part], count: int, texts: Iterator[list[T]]
) -> tuple[list[T], NDArray[np.intp]]:
    """Texts, or whatever is said, of all parts in the order of their frames, and those frames' rows."""
    lines = np.empty(count, object)
    present = np.zeros(count, np.bool_)
    for part, told in zip(parts, texts, strict=True):
        column = np.empty(len(told), object)
        column[:] = told
        lines[part.rows] = column[part.which]
        present[part.rows] = True
    rows = np.flatnonzero(present)
    return lines[rows].tolist(), rows


def payloads(frames: FrameBatch, rows: Rows) -> list[str]:
    """Bytes of frames in hexadecimal, or what remote frames ask for."""
    width = 3 * frames.data.shape[1]
    written = frames.data[rows].tobytes().hex(" ")
    lengths = frames.dlc[rows].tolist()
    found = [
        written[at * width : at * width + max(3 * length - 1, 0)]
        for at, length in enumerate(lengths)
    ]
    for at in np.flatnonzero(frames.flags[rows] & np.uint16(FrameFlag.REMOTE)).tolist():
        found[at] = f"remote, {counted(lengths[at], 'byte')}"
    return found


def _wrapped(text: str, indent: int, width: int) -> str:
    """Text on as many lines as it needs, below one another."""
    room = width - indent
    if len(text) <= room:
        return text
    if room >= _LEAST_ROOM:
        return f"\n{' ' * indent}".join(wrap(text, room))
    return "".join(f"\n  {line}" for line in wrap(text, max(width - 2, 1)))
