"""TIME messages: what the bus takes for the time, against the recorder's clock (CiA 301 7.2.6)."""

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.results import TimeStampRow
from syncline_schemas.batch import Gap
from syncline_schemas.decoder.services import decode_time

PREDEFINED_ID = 0x100
MAX_MALFORMED = 10
"""Malformed messages that become rows, the first of each identifier."""
MAX_ROWS = 10_000
MAX_JUMPS = 1000
APART_NS = 60_000_000_000
"""Rows are kept about so far apart [ns]."""
JUMP_NS = 500_000_000
"""TIME and the recorder's clock that part by more between two messages: one of them jumped [ns]."""
_FRAME_29_BIT = 1 << 29
_FIRST_UTC_NS = 631_152_000_000_000_000
"""Stamps from 1990 on are dates, smaller ones count from the start of a log."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


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
    kept_ns: int | None = None
    fresh: bool = True
    """Nothing to compare with: the first message, or the first after a gap."""
    rows: list[TimeStampRow] = field(default_factory=list)
    jumps: list[TimeJump] = field(default_factory=list)
    stands: list[TimeStand] = field(default_factory=list)


class TimeFold:
    """Follows TIME on 100h, or on the identifier that 1012h names."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._states: dict[tuple[int, int], _State] = {}

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        wanted: dict[int, set[int]] = {}
        for bus, can_id in batch.ids():
            if bus not in wanted:
                wanted[bus] = self._identifiers(bus)
            if can_id in wanted[bus]:
                self._take(batch, bus, can_id)

    def gap(self, gap: Gap) -> None:
        """The recorder's clock may have been set while it was blind."""
        for (bus, _), state in self._states.items():
            state.fresh |= gap.bus in (None, bus)

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

    def _identifiers(self, bus: int) -> set[int]:
        """100h, unless every 1012h that was seen on the bus names another one."""
        shadow = self._context.shadow
        told = {
            value & 0x7FF
            for node_bus, node in shadow.nodes()
            if node_bus == bus and (value := shadow.number(bus, node, 0x1012)) is not None
            if not value & _FRAME_29_BIT
        }
        return told or {PREDEFINED_ID}

    def _take(self, batch: IndexedBatch, bus: int, can_id: int) -> None:
        state, rows = self._states.setdefault((bus, can_id), _State()), batch.rows(bus, can_id)
        frames = batch.frames
        state.count += len(rows)
        decoded = decode_time(frames.data[rows], frames.dlc[rows])
        valid = decoded.valid & (frames.dlc[rows] == 6)
        offset = np.where(valid, decoded.t_ns - frames.t_ns[rows], 0)
        for at in self._chosen(state, frames.t_ns[rows], offset, valid).tolist():
            row = TimeStampRow(
                self._context.bus_name(bus),
                can_id,
                batch.seq(int(rows[at])),
                int(frames.t_ns[rows[at]]),
                int(decoded.t_ns[at]) if valid[at] else None,
                int(offset[at]) if valid[at] else None,
                _text(int(decoded.t_ns[at]))
                if valid[at]
                else f"malformed: {int(frames.dlc[rows[at]])} bytes instead of 6",
            )
            self._add(state, row)
        good = np.flatnonzero(valid)
        if len(good):
            state.fresh = False

    def _chosen(
        self,
        state: _State,
        t_ns: np.ndarray,
        offset: np.ndarray,
        valid: np.ndarray,
    ) -> np.ndarray:
        """Which messages matter: about one a minute, both sides of a jump, the first malformed."""
        chosen = np.zeros(len(t_ns), np.bool_)
        good = np.flatnonzero(valid)
        jumps = np.flatnonzero(np.abs(np.diff(offset[good])) > JUMP_NS)
        chosen[good[jumps]] = chosen[good[jumps + 1]] = True
        if len(good):
            chosen[good[[0, -1]]] = True
            minute = (t_ns[good] - t_ns[good[0]]) // APART_NS
            chosen[good[np.flatnonzero(np.diff(minute, prepend=minute[0] - 1))]] = True
        bad = np.flatnonzero(~valid)
        chosen[bad[: max(0, MAX_MALFORMED - state.malformed)]] = True
        state.malformed += len(bad)
        return np.flatnonzero(chosen)

    def _add(self, state: _State, row: TimeStampRow) -> None:
        last, jumped = state.last, False
        if row.offset_ns is not None:
            if last is not None and last.offset_ns is not None and not state.fresh:
                by_ns = row.offset_ns - last.offset_ns
                stands = row.utc_ns == last.utc_ns
                jumped = abs(by_ns) > JUMP_NS and not stands
                if stands and by_ns < -JUMP_NS:
                    _stand(state, last, row)
                if jumped and len(state.jumps) < MAX_JUMPS:
                    state.jumps.append(TimeJump(last, row, by_ns))
            state.last, state.fresh = row, False
        far = state.kept_ns is None or abs(row.t_ns - state.kept_ns) >= APART_NS
        if (far or jumped or row.utc_ns is None) and len(state.rows) < MAX_ROWS:
            state.rows.append(row)
            state.kept_ns = row.t_ns


def _stand(state: _State, last: TimeStampRow, row: TimeStampRow) -> None:
    """Go on with a stretch in which TIME stands still, or begin one."""
    if state.stands and state.stands[-1].last is last:
        state.stands[-1].last = row
    elif len(state.stands) < MAX_JUMPS:
        state.stands.append(TimeStand(last, row))


def _text(utc_ns: int) -> str:
    """
    >>> _text(441_763_200_000_000_000)
    '1984-01-01 00:00:00.000'
    """
    moment = _EPOCH + timedelta(microseconds=utc_ns // 1000)
    return moment.isoformat(sep=" ", timespec="milliseconds").removesuffix("+00:00")
