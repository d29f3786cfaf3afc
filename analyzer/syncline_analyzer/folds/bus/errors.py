"""Error frames: what the recorder's own controller said of the bus (SocketCAN error classes)."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.grouping import BUS_SHIFT
from syncline_analyzer.results import BusErrorRow, BusStateRow
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.can_errors import (
    PASSIVE_COUNT,
    RECORDER_OFF,
    RECORDER_OVERFLOW,
    WARNING_COUNT,
    CanError,
    can_error,
)
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MAX_EVENTS = 10_000
MAX_KINDS = 200
"""Kinds of error frames kept apart per bus."""
OTHER_KINDS = "other kinds"
MAX_EVIDENCE = 20
MAX_STRETCHES = 1000
TOGETHER_NS = 10_000_000_000
"""Error frames no further apart than this are one stretch [ns]."""
RETRY_BITS = 250
"""A frame that ends so soon after an error frame is the repetition of the destroyed one [bit]."""
RETRY_NS = 1_000_000
"""The same where the bit rate is not known [ns]."""

Rows = NDArray[np.intp]
Ints = NDArray[np.int64]


class BusError(NamedTuple):
    """The recorder's controller went bus-off, or started again."""

    bus: str
    seq: int
    t_ns: int
    restarted: bool


@dataclass(slots=True)
class ErrorStretch:
    """Error frames of one sort that follow one another, by `seq`."""

    bus: str
    start_ns: int
    end_ns: int
    count: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    evidence: list[int] = field(default_factory=list)
    runs: int = 0
    """Destroyed frames, those one after the other without a frame in between counted once."""
    followers: Counter[int] = field(default_factory=Counter)
    """How often which 11-bit identifier came next after a destroyed frame."""


@dataclass(frozen=True, slots=True)
class BusErrorTable:
    """What the error frames tell; `events` in order of `seq`, `frames` their number by bus."""

    events: list[BusError] = field(default_factory=list)
    frames: dict[str, int] = field(default_factory=dict)
    states: list[BusStateRow] = field(default_factory=list)
    kinds: list[BusErrorRow] = field(default_factory=list)
    destroyed: list[ErrorStretch] = field(default_factory=list)
    """Frames destroyed on the wire."""
    no_ack: list[ErrorStretch] = field(default_factory=list)
    overflow: list[ErrorStretch] = field(default_factory=list)
    """Overruns of the controller's receive buffer."""
    usual: dict[str, Counter[int]] = field(default_factory=dict)
    """By bus, how many frames there are of each 11-bit identifier."""


@dataclass(slots=True)
class _Kind:
    count: int
    first_ns: int
    last_ns: int
    evidence: list[int]


@dataclass(slots=True)
class _Bus:
    state: str | None = None
    """As last told; None before the first."""
    rows: list[BusStateRow] = field(default_factory=list)
    kinds: dict[str, _Kind] = field(default_factory=dict)
    stretches: dict[str, list[ErrorStretch]] = field(default_factory=dict)
    usual: Counter[int] = field(default_factory=Counter)
    open: tuple[ErrorStretch, int] | None = None
    """Stretch and time of a destroyed frame that nothing followed yet."""

    @property
    def waits(self) -> bool:
        """Whether frames without an error tell something."""
        return self.state in ("bus-off", "restarted") or self.open is not None


class BusErrorFold:
    """Follows the state of each bus's controller, and counts error frames by what they say."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._buses: dict[int, _Bus] = {}
        self._events: list[BusError] = []
        self._frames: dict[str, int] = {}
        self._begin: tuple[int, int] | None = None
        """`seq` and time of the first frame of all buses so far."""

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        frames = batch.frames
        if len(frames) and (self._begin is None or batch.seq0 < self._begin[0]):
            self._begin = batch.seq0, int(frames.t_ns[0])
        for bus, counts in _by_id(batch).items():
            self._buses.setdefault(bus, _Bus()).usual.update(counts)
        rows = np.zeros(0, np.intp)
        if batch.flags_seen & FrameFlag.ERROR:
            rows = np.flatnonzero(frames.flags & FrameFlag.ERROR)
        waiting = [n for n, bus in self._buses.items() if bus.waits]
        for bus in sorted({*frames.bus[rows].tolist(), *waiting}):
            self._take(batch, bus, rows[frames.bus[rows] == bus])

    def gap(self, gap: Gap) -> None:
        """After a gap the state is not known until it is told again."""
        for number, bus in self._buses.items():
            if gap.bus in (None, number):
                bus.open = None
        if gap.reason in (RECORDER_OFF, RECORDER_OVERFLOW):
            return
        for number, bus in self._buses.items():
            if gap.bus in (None, number) and bus.state is not None:
                self._change(number, "unknown", gap.start_ns, f"gap: {gap.reason}", None, None)

    def finish(self, end_ns: int) -> BusErrorTable:
        """Everything seen; `end_ns` is the end of the capture."""
        table = BusErrorTable(sorted(self._events, key=lambda event: event.seq), self._frames)
        for number, bus in sorted(self._buses.items()):
            name = self._context.bus_name(number)
            table.states.extend(_closed(bus.rows, self._begin, end_ns))
            table.kinds.extend(
                BusErrorRow(name, text, kind.count, kind.first_ns, kind.last_ns, kind.evidence)
                for text, kind in sorted(bus.kinds.items(), key=lambda entry: entry[1].first_ns)
            )
            table.destroyed.extend(bus.stretches.get("destroyed", ()))
            table.no_ack.extend(bus.stretches.get("no_ack", ()))
            table.overflow.extend(bus.stretches.get("overflow", ()))
            table.usual[name] = bus.usual
        return table

    def _take(self, batch: IndexedBatch, bus: int, rows: Rows) -> None:
        state = self._buses.setdefault(bus, _Bus())
        name = self._context.bus_name(bus)
        if len(rows):
            self._frames[name] = self._frames.get(name, 0) + len(rows)
        group, errors = _decoded(batch.frames, rows)
        texts = _texts(state, errors)
        for text in dict.fromkeys(texts):
            same = [number for number, each in enumerate(texts) if each == text]
            self._count(batch, state, rows[np.isin(group, same)], text)
        destroyed: list[tuple[Rows, ErrorStretch]] = []
        for sort, chosen in _sorts(group, errors):
            found = self._stretch(batch, bus, sort, rows[chosen], errors, group[chosen])
            destroyed += found if sort == "destroyed" else []
        self._add_followers(batch, bus, destroyed)
        self._follow(batch, bus, rows, group, errors)

    def _count(self, batch: IndexedBatch, state: _Bus, rows: Rows, text: str) -> None:
        t_ns = batch.frames.t_ns[rows]
        kind = state.kinds.setdefault(text, _Kind(0, int(t_ns[0]), int(t_ns[0]), []))
        kind.count += len(rows)
        kind.last_ns = int(t_ns[-1])
        room = MAX_EVIDENCE - len(kind.evidence)
        kind.evidence.extend(batch.seqs_at(rows[:room]).tolist())

    def _stretch(
        self,
        batch: IndexedBatch,
        bus: int,
        sort: str,
        rows: Rows,
        errors: list[CanError],
        group: NDArray[np.intp],
    ) -> list[tuple[Rows, ErrorStretch]]:
        """Gather error frames of one sort to stretches; tells which are of which."""
        found = []
        stretches = self._buses[bus].stretches.setdefault(sort, [])
        t_ns = batch.frames.t_ns[rows]
        before = stretches[-1].end_ns if stretches else int(t_ns[0])
        apart = np.diff(t_ns, prepend=before)
        cuts = np.flatnonzero((apart > TOGETHER_NS) | (apart < 0))
        starts = sorted({0, *cuts.tolist()})
        for first, stop in zip(starts, [*starts[1:], len(rows)], strict=True):
            goes_on = bool(stretches) and first not in cuts
            if not goes_on and len(stretches) >= MAX_STRETCHES:
                break
            if not goes_on:
                start_ns = int(t_ns[first])
                stretches.append(ErrorStretch(self._context.bus_name(bus), start_ns, start_ns))
            _extend(stretches[-1], batch, rows[first:stop], group[first:stop], errors)
            found.append((rows[first:stop], stretches[-1]))
        return found

    def _add_followers(
        self, batch: IndexedBatch, bus: int, destroyed: list[tuple[Rows, ErrorStretch]]
    ) -> None:
        """Count which identifier came next after each destroyed frame: its sender tries again.

        Of several destroyed frames before the same one, it is the repetition of the last.
        """
        state, frames = self._buses[bus], batch.frames
        if not destroyed and state.open is None:
            return
        bitrate = self._context.bitrates.get(self._context.bus_name(bus))
        retry_ns = RETRY_BITS * 10**9 // bitrate if bitrate else RETRY_NS
        plain = (frames.flags & (FrameFlag.ERROR | FrameFlag.EXTENDED)) == 0
        mine = np.flatnonzero(plain & (frames.bus == bus))
        rows = np.concatenate([np.zeros(0, np.intp), *(rows for rows, _ in destroyed)])
        after = mine.searchsorted(rows)
        if state.open is not None and len(mine) and not (len(after) and after[0] == 0):
            stretch, t_ns = state.open
            _followed(stretch, frames, mine[:1], np.array([t_ns]), retry_ns)
        state.open = None if len(mine) or len(rows) else state.open
        last = np.append(after[1:] != after[:-1], True)[: len(after)] & (after < len(mine))
        begin = 0
        for own, stretch in destroyed:
            chosen = np.flatnonzero(last[begin : begin + len(own)])
            next_rows = mine[after[begin + chosen]]
            _followed(stretch, frames, next_rows, frames.t_ns[own[chosen]], retry_ns)
            begin += len(own)
        if len(rows) and after[-1] == len(mine):
            state.open = destroyed[-1][1], int(frames.t_ns[rows[-1]])

    def _follow(
        self,
        batch: IndexedBatch,
        bus: int,
        rows: Rows,
        group: NDArray[np.intp],
        errors: list[CanError],
    ) -> None:
        """Changes of the controller's state, in order; being heard ends a bus-off."""
        state, frames = self._buses[bus], batch.frames
        mine = frames.bus == bus
        heard = np.flatnonzero(mine & ((frames.flags & FrameFlag.ERROR) == 0))
        row = 0
        for at in _telling(group, errors):
            told = int(rows[at])
            self._heard(batch, bus, heard, row, told)
            error, row = errors[int(group[at])], told
            if error.state in ("bus-off", "restarted") and len(self._events) < MAX_EVENTS:
                self._events.append(
                    BusError(
                        self._context.bus_name(bus),
                        batch.seq(told),
                        int(frames.t_ns[told]),
                        error.state == "restarted",
                    )
                )
            if error.state is not None and error.state != state.state:
                seq, t_ns = batch.seq(told), int(frames.t_ns[told])
                exact = can_error(int(frames.can_id[told]), frames.data[told, :8].tobytes())
                self._change(bus, error.state, t_ns, exact.words, seq, exact)
        self._heard(batch, bus, heard, row, len(batch))

    def _heard(self, batch: IndexedBatch, bus: int, heard: Rows, first: int, stop: int) -> None:
        if self._buses[bus].state not in ("bus-off", "restarted"):
            return
        at = int(np.searchsorted(heard, first))
        if at < len(heard) and heard[at] < stop:
            row = int(heard[at])
            t_ns = int(batch.frames.t_ns[row])
            self._change(bus, "active", t_ns, "frames are heard again", batch.seq(row), None)

    def _change(
        self, bus: int, state: str, t_ns: int, cause: str, seq: int | None, error: CanError | None
    ) -> None:
        entry, name = self._buses[bus], self._context.bus_name(bus)
        if not entry.rows:
            entry.rows.append(BusStateRow(name, "unknown", t_ns, t_ns, "start of capture", None))
        entry.state = state
        if len(entry.rows) >= MAX_EVENTS:
            return
        entry.rows[-1] = replace(entry.rows[-1], end_ns=t_ns)
        tx, rx = (error.tx_errors, error.rx_errors) if error else (None, None)
        entry.rows.append(BusStateRow(name, state, t_ns, t_ns, cause, seq, tx, rx))


def _decoded(frames: FrameBatch, rows: Rows) -> tuple[NDArray[np.intp], list[CanError]]:
    """Which error frames say the same, and what: (n,) numbers by their order, an error for each."""
    data = frames.data[rows, :8].astype(np.int64)
    counters = np.maximum(data[:, 6], data[:, 7])
    level = np.searchsorted([1, WARNING_COUNT, PASSIVE_COUNT], counters, side="right")
    # Detail bytes are packed beside the class, so that a flood of equal frames is decoded once.
    key = frames.can_id[rows].astype(np.int64) << 34 | level << 32
    for place in range(4):
        key |= data[:, place] << 8 * place
    table = np.stack([key, data[:, 4]], axis=1)
    _, first, group = np.unique(table, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    errors = [
        can_error(int(frames.can_id[row]), frames.data[row, :8].tobytes())
        for row in rows[first[order]].tolist()
    ]
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    return number[group.reshape(-1)], errors


def _sorts(
    group: NDArray[np.intp], errors: list[CanError]
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Each sort of error frames that has a stretch of its own, with the frames it is made of."""
    for sort, numbers in (
        ("destroyed", [n for n, error in enumerate(errors) if error.destroyed]),
        ("no_ack", [n for n, error in enumerate(errors) if error.no_ack]),
        ("overflow", [n for n, error in enumerate(errors) if error.overflow]),
    ):
        if numbers:
            yield sort, np.isin(group, numbers)


def _telling(group: NDArray[np.intp], errors: list[CanError]) -> list[int]:
    """Which error frames may change the state; of equal ones in a row only the first."""
    states = [error.state for error in errors]
    numbers = {state: k for k, state in enumerate(dict.fromkeys(states))}
    code = np.array([numbers[state] for state in states], np.int64)[group]
    told = np.flatnonzero(np.isin(code, [k for state, k in numbers.items() if state is not None]))
    ends = [k for state, k in numbers.items() if state in ("bus-off", "restarted")]
    changed = np.diff(code[told], prepend=-1) != 0
    chosen: list[int] = told[changed | np.isin(code[told], ends)].tolist()
    return chosen


def _extend(
    stretch: ErrorStretch,
    batch: IndexedBatch,
    rows: Rows,
    group: NDArray[np.intp],
    errors: list[CanError],
) -> None:
    stretch.count += len(rows)
    stretch.end_ns = int(batch.frames.t_ns[rows[-1]])
    for number, count in zip(*np.unique(group, return_counts=True), strict=True):
        stretch.kinds[errors[int(number)].words] += int(count)
    room = MAX_EVIDENCE - len(stretch.evidence)
    stretch.evidence.extend(batch.seqs_at(rows[:room]).tolist())


def _followed(
    stretch: ErrorStretch, frames: FrameBatch, rows: Rows, since_ns: Ints, retry_ns: int
) -> None:
    """Note the frames that came next after destroyed ones."""
    stretch.runs += len(rows)
    soon = rows[frames.t_ns[rows] - since_ns <= retry_ns]
    found, counts = np.unique(frames.can_id[soon], return_counts=True)
    stretch.followers.update(dict(zip(found.tolist(), counts.tolist(), strict=True)))


def _by_id(batch: IndexedBatch) -> dict[int, dict[int, int]]:
    """By bus and 11-bit identifier, how many frames there are; remote ones count as well."""
    found: dict[int, dict[int, int]] = {bus: {} for bus in batch.buses}
    grouping = batch.grouping
    counts = (grouping.edges[1:] - grouping.edges[:-1]).tolist()
    for key, count in zip(grouping.keys.tolist(), counts, strict=True):
        of_bus, can_id = found[key >> BUS_SHIFT], key & 0x7FF
        of_bus[can_id] = of_bus.get(can_id, 0) + count
    return found


def _texts(state: _Bus, errors: list[CanError]) -> list[str]:
    """What each of the errors is counted as, in order of their first frames."""
    known, texts = set(state.kinds), []
    for error in errors:
        if error.words not in known and len(known) >= MAX_KINDS:
            texts.append(OTHER_KINDS)
        else:
            known.add(error.words)
            texts.append(error.words)
    return texts


def _closed(
    rows: list[BusStateRow], begin: tuple[int, int] | None, end_ns: int
) -> list[BusStateRow]:
    """The intervals, from the beginning of the capture to its end."""
    if not rows or begin is None:
        return []
    first = replace(rows[0], start_ns=begin[1])
    return [first, *rows[1:-1], replace(rows[-1], end_ns=max(end_ns, rows[-1].start_ns))]
