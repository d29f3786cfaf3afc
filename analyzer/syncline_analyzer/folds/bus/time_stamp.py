"""TIME messages: what the bus takes for the time, against the recorder's clock (CiA 301 7.2.6)."""

from collections.abc import Sequence
from dataclasses import field, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.results import TimeStampRow
from syncline_analyzer.service_ids import FRAME_29_BIT, changes_of
from syncline_schemas.batch import Gap
from syncline_schemas.decoder.services import decode_time
from syncline_schemas.records import dataclass

PREDEFINED_ID = 0x100
MAX_MALFORMED = 10
"""Malformed messages that become rows, the first of each identifier."""
MAX_ROWS = 10_000
MAX_JUMPS = 1000
APART_NS = 60_000_000_000
"""Rows are kept about so far apart [ns]."""
JUMP_NS = 500_000_000
"""TIME and the recorder's clock that part by more between two messages: one of them jumped [ns]."""
TIME = 0x1012
STILL_NS = 2_000_000_000
"""TIME that says the same for longer stands still [ns]."""
_FIRST_UTC_NS = 631_152_000_000_000_000
"""Stamps from 1990 on are dates, smaller ones count from the start of a log."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TimeJump:
    """TIME moved against the recorder's clock by `by_ns` between two messages."""

    before: TimeStampRow
    after: TimeStampRow
    by_ns: int


@dataclass(slots=True)
class TimeStand:
    """TIME said the same from one message to another, while the recorder's clock ran on."""

    first: TimeStampRow
    last: TimeStampRow


@dataclass(frozen=True, slots=True)
class TimeTable:
    """Kept messages, jumps in order of `seq`, and the number of messages by (bus, identifier)."""

    rows: list[TimeStampRow] = field(default_factory=list)
    jumps: list[TimeJump] = field(default_factory=list)
    stands: list[TimeStand] = field(default_factory=list)
    counts: dict[tuple[str, int], int] = field(default_factory=dict)


@dataclass(slots=True)
class _State:
    count: int = 0
    malformed: int = 0
    last: TimeStampRow | None = None
    """The last message that tells a time; None where there is nothing to compare with."""
    begun: TimeStampRow | None = None
    """The first of those before it that said the same."""
    kept_ns: int | None = None
    rows: list[TimeStampRow] = field(default_factory=list)
    jumps: list[TimeJump] = field(default_factory=list)
    stands: list[TimeStand] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Messages:
    """Messages on one identifier, (n,) each; `utc_ns` means nothing where one is not `valid`."""

    bus: str
    can_id: int
    seq: Ints
    t_ns: Ints
    utc_ns: Ints
    valid: NDArray[np.bool_]
    dlc: NDArray[np.uint8]

    def row(self, at: int) -> TimeStampRow:
        """One of them."""
        t_ns, utc_ns = int(self.t_ns[at]), int(self.utc_ns[at])
        place = self.bus, self.can_id, int(self.seq[at]), t_ns
        if not self.valid[at]:
            text = f"malformed: {int(self.dlc[at])} bytes instead of 6"
            return TimeStampRow(*place, None, None, text)
        return TimeStampRow(*place, utc_ns, utc_ns - t_ns, _text(utc_ns))


class TimeFold:
    """Follows TIME on 100h, or on the identifier that 1012h names, from the frame on that does."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._states: dict[tuple[int, int], _State] = {}
        self._identifiers: dict[int, set[int]] = {}
        """By bus, as long as the shadow learns nothing."""
        self._version = -1

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        if self._version != self._context.shadow.version:
            self._version = self._context.shadow.version
            self._identifiers.clear()
        for bus in batch.buses:
            if bus in self._identifiers:
                self._take_bus(batch, bus, batch.seq0, batch.last_seq + 1)
                continue
            nodes = [node for on, node in self._context.shadow.nodes() if on == bus]
            cuts = changes_of(self._context.shadow, bus, nodes, TIME, batch.seq0, batch.last_seq)
            for first, stop in pairwise([batch.seq0, *sorted(cuts), batch.last_seq + 1]):
                self._identifiers[bus] = self._named(bus, nodes, first)
                self._take_bus(batch, bus, first, stop)

    def gap(self, gap: Gap) -> None:
        """The recorder's clock may have been set while it was blind."""
        for (bus, _), state in self._states.items():
            if gap.bus in (None, bus):
                state.last = state.begun = None

    def finish(self, buses: set[str]) -> TimeTable:
        """Everything on buses that speak CANopen, by name; offsets only where stamps are dates."""
        table = TimeTable()
        for (bus, can_id), state in sorted(self._states.items()):
            name = self._context.bus_name(bus)
            if name not in buses:
                continue
            table.counts[name, can_id] = state.count
            table.rows.extend(
                row if row.t_ns >= _FIRST_UTC_NS else replace(row, offset_ns=None)
                for row in state.rows
            )
            table.jumps.extend(state.jumps)
            table.stands.extend(state.stands)
        return table

    def _named(self, bus: int, nodes: Sequence[int], seq: int) -> set[int]:
        """100h, unless every 1012h that was seen on the bus names another one."""
        shadow = self._context.shadow
        told = {
            value & 0x7FF
            for node in nodes
            if (value := shadow.number(bus, node, TIME, 0, seq)) is not None
            if not value & FRAME_29_BIT
        }
        return told or {PREDEFINED_ID}

    def _take_bus(self, batch: IndexedBatch, bus: int, first: int, stop: int) -> None:
        """Take in the messages of a bus from a `seq` to another."""
        frames = batch.frames
        for can_id in sorted(self._identifiers[bus]):
            rows, seqs = batch.rows(bus, can_id), batch.seqs_of(bus, can_id)
            rows = rows[slice(*seqs.searchsorted((first, stop)).tolist())]
            if not len(rows):
                continue
            dlc, t_ns = frames.dlc[rows], frames.t_ns[rows]
            decoded = decode_time(frames.data[rows], dlc)
            valid = decoded.valid & (dlc == 6)
            name, seq = self._context.bus_name(bus), batch.seqs_at(rows)
            told = _Messages(name, can_id, seq, t_ns, decoded.t_ns, valid, dlc)
            state = self._states.setdefault((bus, can_id), _State())
            state.count += len(rows)
            _keep(state, told, _compare(state, told))


def _compare(state: _State, told: _Messages) -> NDArray[np.bool_]:
    """(n,) where TIME jumped; jumps and stretches in which it stands still are noted."""
    jumped = np.zeros(len(told.t_ns), np.bool_)
    good = np.flatnonzero(told.valid)
    if not len(good):
        return jumped
    last, begun = state.last, state.begun
    before = [] if last is None or last.utc_ns is None else [(last.utc_ns, last.t_ns)]
    ahead = np.array(before, np.int64).reshape(-1, 2)
    utc_ns = np.concatenate((ahead[:, 0], told.utc_ns[good]))
    t_ns = np.concatenate((ahead[:, 1], told.t_ns[good]))
    held = len(before)
    same = utc_ns[1:] == utc_ns[:-1]
    by_ns = (utc_ns[1:] - t_ns[1:]) - (utc_ns[:-1] - t_ns[:-1])

    def row(at: int) -> TimeStampRow:
        return last if at < held and last is not None else told.row(int(good[at - held]))

    for at in (np.flatnonzero((np.abs(by_ns) > JUMP_NS) & ~same) + 1).tolist():
        jumped[good[at - held]] = True
        if len(state.jumps) < MAX_JUMPS:
            state.jumps.append(TimeJump(row(at - 1), row(at), int(by_ns[at - 1])))
    starts = np.append(0, np.flatnonzero(~same) + 1)
    ends = np.append(starts[1:], len(utc_ns)) - 1
    goes_on = begun if held else None
    since_ns = t_ns[starts]
    since_ns[0] = since_ns[0] if goes_on is None else goes_on.t_ns
    for run in np.flatnonzero(t_ns[ends] - since_ns > STILL_NS).tolist():
        first = goes_on if run == 0 and goes_on is not None else row(int(starts[run]))
        _stand(state, first, row(int(ends[run])))
    state.begun = goes_on if len(starts) == 1 and goes_on is not None else row(int(starts[-1]))
    state.last = row(len(utc_ns) - 1)
    return jumped


def _keep(state: _State, told: _Messages, jumped: NDArray[np.bool_]) -> None:
    """Keep what matters as rows: one a minute, what jumped, the first malformed ones."""
    malformed = ~told.valid
    kept = malformed & (np.cumsum(malformed) + state.malformed <= MAX_MALFORMED)
    state.malformed += int(np.count_nonzero(malformed))
    kept |= jumped
    begin = 0
    while begin < len(kept) and len(state.rows) < MAX_ROWS:
        wanted = kept[begin:] | (told.valid[begin:] & _far(state.kept_ns, told.t_ns[begin:]))
        if not wanted.any():
            return
        at = begin + int(np.argmax(wanted))
        state.rows.append(told.row(at))
        state.kept_ns = int(told.t_ns[at])
        begin = at + 1


def _far(kept_ns: int | None, t_ns: Ints) -> NDArray[np.bool_]:
    """(n,) which messages are far enough from the one that was kept last."""
    far: NDArray[np.bool_] = np.abs(t_ns - (kept_ns or 0)) >= APART_NS
    return far if kept_ns is not None else np.ones(len(t_ns), np.bool_)


def _stand(state: _State, first: TimeStampRow, last: TimeStampRow) -> None:
    """Go on with a stretch in which TIME stands still, or begin one."""
    if state.stands and state.stands[-1].first.seq == first.seq:
        state.stands[-1].last = last
    elif len(state.stands) < MAX_JUMPS:
        state.stands.append(TimeStand(first, last))


def _text(utc_ns: int) -> str:
    """
    >>> _text(441_763_200_000_000_000)
    '1984-01-01 00:00:00.000'
    """
    moment = _EPOCH + timedelta(microseconds=utc_ns // 1000)
    return moment.isoformat(sep=" ", timespec="milliseconds").removesuffix("+00:00")
