"""Logs of text lines: blocks of lines to batches, by layout where possible, else line by line."""

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import CaptureFacts, Unread
from syncline_analyzer.readers.layout import (
    FrameLayout,
    LineBatch,
    LineMatcher,
    Row,
    known_lines,
    lines_of,
)
from syncline_analyzer.readers.resolution import Resolution
from syncline_analyzer.readers.source import (
    BLOCK_BYTES,
    MAX_LINE_BYTES,
    CaptureSource,
    LineSource,
)
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.memory import keep_freed_memory
from syncline_schemas.records import dataclass

MAX_MATCHERS = 48
"""Layouts kept for one line length."""
MAX_IDLE_BLOCKS = 4
MAX_POOR_LAYOUTS = 64
"""Layouts that may fit next to nothing in one block; then its other lines are read singly."""
MAX_BUSES = 256
MAX_PARSED_LINE = 1024
"""No format has longer lines with a frame."""
MAX_T_NS = 1 << 62
"""Later times, which are none, would not fit into the columns."""


@dataclass(frozen=True, slots=True)
class OddFrame:
    """A frame whose line cannot serve as a layout for others."""

    row: Row
    timed: bool = True
    lost: "LostFrames | None" = None
    """Frames lost before this one, where its own line says so."""


@dataclass(frozen=True, slots=True)
class LostFrames:
    """That frames were lost: between the neighbours of the line that says so, or before its frame."""

    reason: str
    lost_frames: int | None = None
    bus: int | None = None


@dataclass(frozen=True, slots=True)
class NoFrame:
    """A line of the format that is no frame; its time counts where times are differences."""

    t_ns: int | None = None


Parsed = FrameLayout | OddFrame | LostFrames | NoFrame | None


class Lines(Protocol):
    """Where blocks of whole lines come from."""

    head: bytes
    """The first part of the text."""

    @property
    def damage(self) -> str | None:
        """What is wrong with the source, once it was met."""
        ...

    def blocks(self) -> Iterator[bytes]:
        """Blocks of whole lines; only the last may lack its line end."""
        ...


class LineFormat(ABC):
    """What one text format is: the wire knowledge that `TextReader` drives.

    Attributes:
        origin_ns: added to every time, unless the log has none.
        differences: whether each time is the time since the line before.
        wraps_ns: after which time they begin at 0 again (times of day), 0 when never.
        late_ns: what of a step back is that of a late frame, not a new beginning; None is half of `wraps_ns`.
        markers: words on lines after which other lines mean something else.
    """

    markers: tuple[bytes, ...] = ()

    def __init__(self, facts: CaptureFacts) -> None:
        self.facts = facts
        self.origin_ns = 0
        self.differences = False
        self.wraps_ns = 0
        self.late_ns: int | None = None

    def bus(self, name: bytes) -> int | None:
        """Number of a bus, in the order of appearance; None when a log names more than 256."""
        text = name.decode("utf-8", "replace")
        if len(self.facts.buses) >= MAX_BUSES and text not in self.facts.buses:
            return None
        return self.facts.bus_number(text)

    def prepare(self, head: bytes) -> None:  # noqa: B027  most formats need one of these only
        """Take facts from the first part of the file, before any line is parsed."""

    def control(self, part: bytes) -> bool:
        """Look at a part that may start at a marker; True when layouts so far do not hold in it."""
        return False

    @abstractmethod
    def parse(self, line: bytes) -> Parsed:
        """Understand one line without its line end; None when it is none of this format."""

    def finish(self, last_ns: int | None) -> None:  # noqa: B027
        """Complete the facts after the last line, of which `last_ns` is the stamp."""


class TextReader:
    """Reads a log of text lines as batches of about `block_bytes` of text each."""

    def __init__(self, path: Path, form: LineFormat, *, block_bytes: int = BLOCK_BYTES) -> None:
        self.facts = form.facts
        self._path = path
        self._form = form
        self._block_bytes = block_bytes
        self._matchers: dict[int, list[LineMatcher]] = defaultdict(list)
        self._carry_ns = 0
        self._wrap_from_ns: int | None = None
        self._wraps = 0
        self._last_ns: int | None = None
        self._pending: list[LostFrames] = []
        self._resolution = Resolution()
        self._line_number = 1
        self._unread: list[int] = []

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order, with a Gap between them where frames were lost."""
        keep_freed_memory()
        source = CaptureSource(self._path)
        try:
            yield from self.batches_of(LineSource(source, self._block_bytes))
        finally:
            source.close()

    def batches_of(self, lines: Lines) -> Iterator[FrameBatch | Gap]:
        """The same of lines from elsewhere, a batch of each block."""
        for item in self._read(lines):
            if self.facts.time_base != "none":
                self.facts.resolution_ns = self._resolution.step_ns
            yield item
        self.facts.damage = self.facts.damage or lines.damage
        self._form.finish(self._last_ns)

    def _read(self, lines: Lines) -> Iterator[FrameBatch | Gap]:
        self._form.prepare(lines.head)
        for block in lines.blocks():
            for part in _split(block, self._form.markers):
                if not part.endswith(b"\n"):
                    part = self._last_line(part, damaged=lines.damage is not None)
                self._control(part)
                yield from self._part(part)
        for lost in self._pending:
            yield self._gap(lost, self._last_ns or 0)

    def _last_line(self, part: bytes, *, damaged: bool) -> bytes:
        """A part whose last line has no end: what of it can be trusted."""
        if not damaged:
            if len(part) < MAX_LINE_BYTES:
                self.facts.notes.append("the last line has no line end: it may be cut off")
            return part
        text = part[: part.rfind(b"\n") + 1]
        line_number = self._line_number + text.count(b"\n")
        self.facts.add_unparsed(line_number, _shown(part[len(text) :]))
        return text

    def _control(self, part: bytes) -> None:
        origin_ns = self._form.origin_ns
        if self._form.control(part):
            self._matchers.clear()
        if self._form.origin_ns != origin_ns:
            self._wrap_from_ns, self._wraps = None, 0
            if self._form.differences:
                self._carry_ns = 0

    def _part(self, part: bytes) -> Iterator[FrameBatch | Gap]:
        known = known_lines(part, self._matchers)
        if known is None:
            batch, lengths = lines_of(part)
            left = self._read_known(batch, lengths)
        else:
            batch, lengths, present = known
            left = np.flatnonzero(~batch.read)
            for length in present:
                self._keep_useful(length)
        lost = self._read_singly(part, batch, lengths, left)
        self._finish_times(batch)
        self._place_unread(batch)
        self._line_number += len(lengths)
        yield from self._deliver(batch, lost)

    def _read_known(self, batch: LineBatch, lengths: NDArray[np.intp]) -> NDArray[np.intp]:
        short = len(lengths) > 0 and int(lengths.max()) < 1 << 16
        # Numbers of 16 bits are sorted digit by digit, several times as fast as longer ones.
        order = np.argsort(lengths.astype(np.uint16) if short else lengths, kind="stable")
        ordered = lengths[order]
        cuts = np.flatnonzero(np.diff(ordered)) + 1
        left = []
        for lines in np.split(order, cuts):
            if len(lines):
                left.append(self._read_length(batch, int(lengths[lines[0]]), lines))
        return np.sort(np.concatenate(left)) if left else order

    def _read_length(
        self, batch: LineBatch, length: int, lines: NDArray[np.intp]
    ) -> NDArray[np.intp]:
        matchers = self._matchers.get(length, [])
        for matcher in matchers:
            matcher.hits = 0
            if len(lines):
                good = matcher.read(batch, lines)
                matcher.hits = int(np.count_nonzero(good))
                lines = lines[~good] if matcher.hits else lines
            matcher.idle = 0 if matcher.hits else matcher.idle + 1
        self._keep_useful(length)
        return lines

    def _keep_useful(self, length: int) -> None:
        """The layouts of a line length that fitted lately, those that fitted most first."""
        matchers = self._matchers.get(length)
        if matchers:
            kept = [matcher for matcher in matchers if matcher.idle <= MAX_IDLE_BLOCKS]
            kept.sort(key=lambda matcher: -matcher.hits)
            self._matchers[length] = kept[:MAX_MATCHERS]

    def _read_singly(
        self,
        part: bytes,
        batch: LineBatch,
        lengths: NDArray[np.intp],
        left: NDArray[np.intp],
    ) -> list[tuple[int, LostFrames]]:
        lost: list[tuple[int, LostFrames]] = []
        poor = 0
        for line in left[lengths[left] > 0].tolist():
            if batch.read[line]:
                continue
            text = _line_text(part, batch, line, int(lengths[line]))
            parsed = self._parsed(text)
            if isinstance(parsed, LostFrames):
                lost.append((line, parsed))
            elif isinstance(parsed, NoFrame):
                if parsed.t_ns is not None:
                    batch.t_ns[line], batch.timed[line] = parsed.t_ns, True
            elif isinstance(parsed, OddFrame):
                if parsed.lost is not None:
                    lost.append((line, parsed.lost))
                batch.put_row(line, parsed.row, timed=parsed.timed)
            elif isinstance(parsed, FrameLayout):
                if not self._put_layout(parsed, text, batch, line):
                    self._add_unparsed(line, text)
                elif poor < MAX_POOR_LAYOUTS:
                    same = left[(lengths[left] == len(text)) & ~batch.read[left]]
                    poor += len(same) > 0 and self._learn(parsed, text, batch, same)
            elif text.strip():
                self._add_unparsed(line, text)
        return lost

    def _add_unparsed(self, line: int, text: bytes) -> None:
        self.facts.add_unparsed(self._line_number + line, _shown(text))
        self._unread.append(line)

    def _place_unread(self, batch: LineBatch) -> None:
        """Note between which frames the unparsed lines of a part are."""
        unread, self._unread = self._unread, []
        read = np.flatnonzero(batch.read)
        for line in unread if len(read) else []:
            at = int(np.searchsorted(read, line))
            start_ns = int(batch.t_ns[read[at - 1]]) if at else self._last_ns
            end_ns = int(batch.t_ns[read[min(at, len(read) - 1)]])
            start_ns = end_ns if start_ns is None else start_ns
            self.facts.add_unread(Unread(start_ns, max(start_ns, end_ns), 1))

    def _parsed(self, text: bytes) -> Parsed:
        parsed = self._form.parse(text) if len(text) <= MAX_PARSED_LINE else None
        t_ns = parsed.row[0] if isinstance(parsed, OddFrame) else 0
        if isinstance(parsed, NoFrame):
            t_ns = parsed.t_ns or 0
        return parsed if abs(t_ns) < MAX_T_NS else None

    def _put_layout(self, layout: FrameLayout, text: bytes, batch: LineBatch, line: int) -> bool:
        row = layout.row(text)
        if row is None or abs(row[0]) >= MAX_T_NS:
            return False
        self._resolution.written(layout.times)
        batch.put_row(line, row, timed=bool(layout.times))
        return True

    def _learn(
        self, layout: FrameLayout, text: bytes, batch: LineBatch, lines: NDArray[np.intp]
    ) -> bool:
        matcher = LineMatcher.learn(layout, text)
        if matcher is None:
            return True
        good = matcher.read(batch, lines)
        self._matchers[len(text)].insert(0, matcher)
        return int(np.count_nonzero(good)) < 4

    def _finish_times(self, batch: LineBatch) -> None:
        if self._form.wraps_ns:
            self._unwrap(batch, self._form.wraps_ns)
        if self._form.differences:
            steps = np.where(batch.timed, batch.t_ns, 0)
            batch.t_ns[:] = np.cumsum(steps) + self._carry_ns
            self._carry_ns = int(batch.t_ns[-1]) if len(steps) else self._carry_ns
        else:
            self._fill_times(batch)
        own = batch.read & batch.timed
        rows = slice(None) if own.all() else own
        self._resolution.sample(batch.t_ns[rows], batch.bus[rows], batch.can_id[rows])
        if self.facts.time_base != "none":
            batch.t_ns += self._form.origin_ns

    def _unwrap(self, batch: LineBatch, wraps_ns: int) -> None:
        """Add a day, or whatever the times begin again after, at each step back of most of it."""
        rows = np.flatnonzero(batch.timed)
        if not len(rows):
            return
        t_ns = batch.t_ns[rows]
        before_ns = int(t_ns[0]) if self._wrap_from_ns is None else self._wrap_from_ns
        steps = np.diff(t_ns, prepend=before_ns)
        late_ns = wraps_ns // 2 if self._form.late_ns is None else self._form.late_ns
        turns = np.cumsum((steps < -late_ns).astype(np.int64) - (steps > wraps_ns - late_ns))
        batch.t_ns[rows] = t_ns + (turns + self._wraps) * wraps_ns
        self._wraps += int(turns[-1])
        self._wrap_from_ns = int(t_ns[-1])

    def _fill_times(self, batch: LineBatch) -> None:
        # A line without a time in a log with times takes that of the line before it.
        if not np.any(batch.read & ~batch.timed):
            if batch.timed.any():
                self._carry_ns = int(batch.t_ns[np.flatnonzero(batch.timed)[-1]])
            return
        places = np.where(batch.timed, np.arange(len(batch.timed)), -1)
        last = np.maximum.accumulate(places)
        batch.t_ns[:] = np.where(last < 0, self._carry_ns, batch.t_ns[last])
        self._carry_ns = int(batch.t_ns[-1])

    def _deliver(
        self, batch: LineBatch, lost: list[tuple[int, LostFrames]]
    ) -> Iterator[FrameBatch | Gap]:
        frames = FrameBatch(
            batch.t_ns,
            batch.bus,
            batch.can_id,
            batch.flags,
            batch.dlc,
            batch.words.view(np.uint8).reshape(len(batch.words), 8 * batch.words.shape[1]),
        )
        everything = bool(batch.read.all())
        place = 0
        for line, note in [*lost, (len(batch.read), None)]:
            rows = frames[place:line]
            part = rows if everything else rows[batch.read[place:line]]
            if len(part):
                for pending in self._pending:
                    yield self._gap(pending, int(part.t_ns[0]))
                self._pending.clear()
                self._last_ns = int(part.t_ns[-1])
                yield part
            if note is not None:
                self._pending.append(note)
            place = line

    def _gap(self, lost: LostFrames, end_ns: int) -> Gap:
        start_ns = self._last_ns if self._last_ns is not None else end_ns
        return Gap(start_ns, max(start_ns, end_ns), lost.reason, lost.lost_frames, lost.bus)


def _split(block: bytes, markers: tuple[bytes, ...]) -> Iterator[bytes]:
    cuts = {0}
    for marker in markers:
        at = block.find(marker)
        while at >= 0:
            cuts.add(block.rfind(b"\n", 0, at) + 1)
            at = block.find(marker, at + len(marker))
    if len(cuts) == 1:
        yield block
        return
    for start, end in pairwise([*sorted(cuts), len(block)]):
        yield block[start:end]


def _line_text(text: bytes, batch: LineBatch, line: int, length: int) -> bytes:
    start = int(batch.starts[line]) - 8
    return text[start : start + length]


def _shown(line: bytes) -> str:
    return line.rstrip(b"\r").decode("utf-8", "replace")


def note_requests(facts: CaptureFacts, count: int) -> None:
    """Say how many lines tell what was only asked to be sent (`TxRq`), which is no frame on the bus."""
    if count:
        facts.notes.append(
            f"{count} line(s) tell what was asked to be sent (TxRq); they are no frames on the bus"
        )


def bit_flags(
    *,
    extended: bool = False,
    tx: bool = False,
    fd: bool = False,
    brs: bool = False,
    esi: bool = False,
) -> int:
    """`FrameFlag` bits as a number, from what most formats tell.

    >>> bit_flags(extended=True, fd=True, brs=True)
    25
    """
    chosen = (
        (extended, FrameFlag.EXTENDED),
        (tx, FrameFlag.TX),
        (fd, FrameFlag.FD),
        (brs, FrameFlag.BRS),
        (esi, FrameFlag.ESI),
    )
    return sum(flag for wanted, flag in chosen if wanted)
