"""PDO timing: answers to SYNC with the bounds of the device time, missed and extra ones, periods."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.lateness import others_as_late
from syncline_analyzer.folds.timing.rhythm import Missed, Rhythm
from syncline_analyzer.folds.timing.sync import SyncFold, SyncIndex
from syncline_analyzer.pdo_binding import Pdo, PdoBindings, Transmission
from syncline_analyzer.series import Thinner
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.wire_length import INTERMISSION_BITS

MAX_PAUSES = 1000
MAX_EVIDENCE = 20
PAUSE_NS = 5_000_000_000
PAUSE_PERIODS = 20
"""A PDO that stays away for so long, and so many of its periods, has stopped."""
_SEEN = ("sdo-read", "sdo-write", "bus-description")
"""Sources of a setting that hold for this very device."""
MAX_RESPONSES = 100_000
"""Responses of one PDO that are kept one by one."""
UNKNOWN_BITS = 1 << 24
"""What an error frame counts as between a SYNC and its answer: nothing is known of the bus then."""
OVERDUE = 1.5
"""A cyclic PDO is missing when its period is longer than this many event timers."""
_SMALL_SPREAD = 0.25
"""Interquartile range of the response, as a share of the SYNC period, of a synchronous PDO."""
_OTHER_TIMER = 0.1
"""A period that differs by more than this share from the event timer is not made by it."""
_KEEPS_TO_SYNC = 3.0
"""So much more than the response the period must spread: 1.4 come from independent jitter alone."""


@dataclass(frozen=True, slots=True)
class Pause:
    """A long time between two frames of a PDO; `end_seq` is None where it did not come again."""

    start_ns: int
    end_ns: int
    start_seq: int
    end_seq: int | None


@dataclass(slots=True)
class PdoState:
    """A PDO identifier from block to block, and what its row is made of."""

    frames: int = 0
    last_ns: int | None = None
    last_seq: int = 0
    period: Distribution = field(default_factory=Distribution)
    response: Distribution = field(default_factory=Distribution)
    device_low: Distribution = field(default_factory=Distribution)
    device_high: Distribution = field(default_factory=Distribution)
    extra: int = 0
    extra_alone: int = 0
    """Those beside which no SYNC went unanswered, so that none is a late or early answer."""
    late: int = 0
    rhythm: Rhythm = field(default_factory=Rhythm)
    overdue: Missed = field(default_factory=Missed)
    responses: Thinner = field(default_factory=lambda: Thinner("response_us", MAX_RESPONSES))
    owner: Pdo | None = None
    transmission: Transmission | None = None
    changed_seq: int = 0
    """`seq` since which `transmission` holds."""
    sync_cob_id: int = 0x80
    off: bool = False
    """Its owner has switched it off (bit 31 of 180xh:1), or gave it another identifier."""
    last_data: bytes = b""
    repeats: int = 0
    """Frames with the same data as the one before: no change of the value made the device send."""
    asked: int = 0
    """Remote frames that asked for it, or empty frames as which some loggers write these down."""
    pauses: list[Pause] = field(default_factory=list)
    extra_seq: list[int] = field(default_factory=list)
    extra_ns: list[int] = field(default_factory=list)
    """Stamps of the first and the last of these."""
    too_soon: int = 0
    too_soon_seq: list[int] = field(default_factory=list)
    too_soon_ns: list[int] = field(default_factory=list)

    def told_inhibit_ns(self) -> int | None:
        """Inhibit time of an event-driven TPDO that the bus or the user told; None without one."""
        inhibit = self.transmission.inhibit_100us if self.transmission else None
        if self.told_type() not in (0xFE, 0xFF) or inhibit is None or inhibit.source not in _SEEN:
            return None
        value = inhibit.value
        return value * 100_000 if isinstance(value, int) and value else None

    def polled(self) -> bool:
        """Whether it is sent because it is asked for: then nothing is due without a request."""
        return 2 * self.asked >= self.frames > 0

    def sent_by_timer(self) -> bool:
        """Whether most frames bring nothing new, so that no change of the value sends them."""
        return 2 * self.repeats >= self.frames > 0

    def told_type(self) -> int | None:
        """Transmission type that the bus or the user told; a device's default does not count."""
        known = self.transmission.type if self.transmission else None
        if known is None or known.source == "eds-default" or not isinstance(known.value, int):
            return None
        return known.value if self.owner is not None and self.owner.kind == "tpdo" else None

    def told_timer_ns(self) -> int | None:
        """Event timer of a cyclic TPDO that the bus or the user told, None when 0 or not in use."""
        timer = self.transmission.event_timer_ms if self.transmission else None
        if self.told_type() not in (0xFE, 0xFF) or timer is None or timer.source == "eds-default":
            return None
        return timer.value * 1_000_000 if isinstance(timer.value, int) and timer.value else None

    def answers_sync(self, sync_period_ns: float) -> int | None:
        """n when the frames follow every n-th SYNC closely enough to answer it."""
        known = self.transmission.type if self.transmission else None
        default = known.value if known is not None and known.source == "eds-default" else None
        every = self.rhythm.every(default if isinstance(default, int) else None)
        if every is None or not self.response.count:
            return None
        return every if _spread(self.response) <= _SMALL_SPREAD * sync_period_ns else None

    def timer_excluded(self, resolution_ns: int) -> bool:
        """Whether no event timer of the device's own can have sent the frames.

        The timer is known to be off or of another length, or the frames keep to the SYNC while the
        SYNC itself wavers. A steady SYNC proves nothing: a timer of n periods looks the same.
        """
        timer = self.transmission.event_timer_ms if self.transmission else None
        if timer is not None and isinstance(timer.value, int):
            timer_ns = timer.value * 1_000_000
            if abs(self.period.quantile(0.5) - timer_ns) > _OTHER_TIMER * timer_ns:
                return True
        kept = max(_spread(self.response), resolution_ns)
        return _spread(self.period) >= _KEEPS_TO_SYNC * kept


@dataclass(frozen=True, slots=True, eq=False)
class _Pass:
    """A block as one bus sees it; `sent` (n,) bits on the bus up to the end of each row."""

    block: Block
    bus: int
    sent: NDArray[np.int64]
    bit_ns: float | None
    syncs: dict[int, SyncIndex | None]


class PdoFold:
    """Follows every PDO identifier by `seq`; durations only in captures with times."""

    def __init__(self, context: Context, bindings: PdoBindings, sync: SyncFold) -> None:
        self._context = context
        self._bindings = bindings
        self._sync = sync
        self._sent: dict[int, int] = {}
        self.states: dict[tuple[int, int], PdoState] = {}

    def update(self, block: Block, bus: int) -> None:
        """Take in the frames of one bus of a block, SYNCs included."""
        self._bindings.refresh(bus)
        for can_id in self._pdo_ids(block, bus):
            self.states.setdefault((bus, can_id), PdoState())
        first_seq, last_seq = block.batch.seq0, block.batch.seq0 + len(block.batch) - 1
        for can_id, state in self._states_of(bus):
            self._rebind(state, bus, can_id, first_seq, last_seq)
        self._count_requests(block, bus)
        bitrate = self._context.bitrates.get(self._context.bus_name(bus))
        sent = self._sent_bits(block, bus)
        syncs = {
            cob: self._sync.update(block, bus, cob, sent) for cob in self._sync_ids(bus, last_seq)
        }
        passing = _Pass(block, bus, sent, 1e9 / bitrate if bitrate else None, syncs)
        for can_id, state in self._states_of(bus):
            rows = block.batch.rows(bus, can_id)
            if len(rows):
                self._follow(block, state, rows, syncs.get(state.sync_cob_id))
            self._answer(passing, state, rows)

    def gap(self, bus: int | None) -> None:
        """Nothing is due and no period counts over a gap."""
        for (state_bus, _), state in self.states.items():
            if bus in (None, state_bus):
                state.last_ns = None
                state.rhythm.restart()

    def _count_requests(self, block: Block, bus: int) -> None:
        """How often somebody asked for each PDO (CiA 301 7.2.2.5.2)."""
        asked = block.frames.can_id[block.batch.remote & (block.frames.bus == bus)]
        for can_id, state in self._states_of(bus):
            rows = block.batch.rows(bus, can_id)
            empty = np.count_nonzero(block.frames.dlc[rows] == 0)
            state.asked += int(np.count_nonzero(asked == can_id)) + (
                int(empty) if empty < len(rows) else 0
            )

    def _states_of(self, bus: int) -> list[tuple[int, PdoState]]:
        return [(can_id, state) for (b, can_id), state in self.states.items() if b == bus]

    def _sent_bits(self, block: Block, bus: int) -> NDArray[np.int64]:
        bits = block.wire_bits + block.error * np.int64(UNKNOWN_BITS)
        if not isinstance(block.by_bus[bus], slice):
            bits = np.where(block.frames.bus == bus, bits, 0)
        sent: NDArray[np.int64] = np.cumsum(bits) + self._sent.get(bus, 0)
        self._sent[bus] = int(sent[-1])
        return sent

    def _pdo_ids(self, block: Block, bus: int) -> list[int]:
        bound = set(self._bindings.identifiers(bus))
        seq = block.batch.seq0 + len(block.batch) - 1
        taken = set(self._sync_ids(bus, seq))
        for can_id in self._bindings.other_services(bus, seq):
            owner = self._bindings.owner(bus, can_id, seq)
            if owner is None or owner.guess:
                taken.add(can_id)
        return [
            can_id
            for id_bus, can_id in block.batch.ids()
            if id_bus == bus
            and can_id not in taken
            and (can_id in bound or SERVICE_OF_ID[can_id] == Service.PDO)
        ]

    def _sync_ids(self, bus: int, seq: int) -> list[int]:
        """080h and every identifier that a node of the bus takes for SYNC at `seq` or in the end.

        A value that is read later most likely held before as well.
        """
        nodes = {node for node_bus, node in self._context.shadow.nodes() if node_bus == bus}
        nodes |= {state.owner.node for _, state in self._states_of(bus) if state.owner}
        found = {self._bindings.sync_cob_id(bus, n, at) for n in nodes for at in (seq, None)}
        return sorted({0x80} | found)

    def _rebind(
        self, state: PdoState, bus: int, can_id: int, first_seq: int, last_seq: int
    ) -> None:
        """Look up whose PDO it is by now; a new transmission type starts a new rhythm."""
        owner = self._bindings.owner(bus, can_id, last_seq)
        bound = state.owner is not None and not state.owner.guess
        if owner is None or (owner.guess and bound):
            if state.owner is not None and not state.off:
                state.off = True
                state.rhythm.relearn()
            return
        if state.off:
            state.off, state.last_ns = False, None
        state.owner = owner
        sync_cob_id = self._bindings.sync_cob_id(bus, owner.node, last_seq)
        if sync_cob_id != state.sync_cob_id:
            # The SYNCs of another identifier have numbers of their own.
            state.rhythm.restart()
            state.sync_cob_id = sync_cob_id
        before, now = state.transmission, self._bindings.transmission(owner, last_seq)
        state.transmission = now
        if before is not None and _value(before.type) != _value(now.type):
            state.rhythm.relearn()
        if before is not None and _values(before) != _values(now):
            state.changed_seq = first_seq

    def _follow(
        self, block: Block, state: PdoState, rows: NDArray[np.intp], sync: SyncIndex | None
    ) -> None:
        """Periods of the identifier, SYNC or not; those in a backlog of SYNCs are none."""
        t_ns, seq = block.frames.t_ns[rows], block.batch.seq0 + rows
        state.frames += len(rows)
        if self._context.timed:
            if state.last_ns is not None:
                t_ns = np.concatenate(([state.last_ns], t_ns))
                seq = np.concatenate(([state.last_seq], seq))
            periods = np.diff(t_ns)
            true = periods >= 0
            if sync is not None:
                bundled = np.concatenate(([False], sync.bundled[sync.before[rows]]))
                true &= ~(bundled[1:] | bundled[:-1])[len(rows) - len(periods) :]
            state.period.add(periods[true])
            self._find_pauses(state, periods, t_ns, seq)
            self._find_too_soon(state, np.where(true, periods, PAUSE_NS), t_ns[1:], seq[1:])
            self._find_overdue(block, state, rows[-len(periods) :], periods, t_ns[:-1], seq[:-1])
        _count_repeats(state, block, rows)
        state.last_ns, state.last_seq = int(t_ns[-1]), int(seq[-1])

    @staticmethod
    def _find_pauses(
        state: PdoState,
        periods: NDArray[np.int64],
        t_ns: NDArray[np.int64],
        seq: NDArray[np.int64],
    ) -> None:
        """Long times without a frame, of which the rhythm of the whole capture tells more."""
        for at in np.flatnonzero(periods >= PAUSE_NS)[: MAX_PAUSES - len(state.pauses)].tolist():
            state.pauses.append(
                Pause(int(t_ns[at]), int(t_ns[at + 1]), int(seq[at]), int(seq[at + 1]))
            )

    @staticmethod
    def _find_too_soon(
        state: PdoState,
        periods: NDArray[np.int64],
        t_ns: NDArray[np.int64],
        seq: NDArray[np.int64],
    ) -> None:
        """Frames closer than half the inhibit time: more than arbitration can pull together."""
        inhibit_ns = state.told_inhibit_ns()
        if inhibit_ns is None:
            return
        soon = np.flatnonzero((periods < inhibit_ns / 2) & (seq > state.changed_seq))
        state.too_soon += len(soon)
        _span(state.too_soon_ns, t_ns[soon])
        state.too_soon_seq.extend(seq[soon[: MAX_EVIDENCE - len(state.too_soon_seq)]].tolist())

    @staticmethod
    def _find_overdue(
        block: Block,
        state: PdoState,
        rows: NDArray[np.intp],
        periods: NDArray[np.int64],
        before_ns: NDArray[np.int64],
        before_seq: NDArray[np.int64],
    ) -> None:
        """Missing periods of a cyclic PDO whose event timer was told.

        Not where others on the bus are as late: then nobody was heard, or the clock was set.
        """
        timer_ns = state.told_timer_ns()
        if timer_ns is None or state.owner is None:
            return
        late = (periods > OVERDUE * timer_ns) & (before_seq >= state.changed_seq)
        for at in np.flatnonzero(late).tolist():
            begin = max(int(before_seq[at]) - block.batch.seq0, 0)
            late_ns = int(periods[at]) - timer_ns
            if others_as_late(block, state.owner, begin, int(rows[at]), late_ns):
                continue
            count = round(float(periods[at]) / timer_ns) - 1
            state.overdue.add_evenly(int(before_ns[at]), timer_ns, count, int(before_seq[at]))

    def _answer(self, passing: _Pass, state: PdoState, rows: NDArray[np.intp]) -> None:
        """Pair the PDOs of a block with the SYNCs before them."""
        sync = passing.syncs.get(state.sync_cob_id)
        if sync is None:
            return
        rows = rows[sync.before[rows] >= sync.first]
        ordinal = sync.first_ordinal + sync.before[rows]
        first = state.rhythm.first_of_period(ordinal)
        # Where a SYNC may be lost, two frames in one period prove nothing.
        extra = np.flatnonzero(~first & sync.whole[sync.before[rows]])
        state.extra += len(extra)
        alone = extra[state.rhythm.beside_answers(ordinal[first], ordinal[extra], _kind(state))]
        state.extra_alone += len(alone)
        more = rows[alone[: MAX_EVIDENCE - len(state.extra_seq)]]
        state.extra_seq.extend((passing.block.batch.seq0 + more).tolist())
        _span(state.extra_ns, passing.block.frames.t_ns[rows[alone]])
        rows, ordinal = rows[first], ordinal[first]
        if self._context.timed and len(rows):
            self._respond(passing, state, rows, sync)
        fresh = passing.block.batch.seq0 + rows >= state.changed_seq
        state.rhythm.answered(ordinal[fresh])
        state.rhythm.evaluate(self._due_every(passing.bus, state), sync)

    def _due_every(self, bus: int, state: PdoState) -> int | None:
        if state.off:
            return None
        told = state.told_type()
        if told is not None:
            return told if 1 <= told <= 0xF0 else None
        if not self._context.timed:
            return None
        return state.answers_sync(self._sync.median_ns(bus, state.sync_cob_id))

    def _respond(
        self, passing: _Pass, state: PdoState, rows: NDArray[np.intp], sync: SyncIndex
    ) -> None:
        """Response and both bounds of the device time (analysis.md section 5)."""
        block, position = passing.block, sync.before[rows]
        response = block.frames.t_ns[rows] - sync.t_ns[position]
        # After a pause of the SYNC a PDO answers one that was not heard.
        to_other = ~sync.usable[position] & (response > sync.cycle_ns)
        true = (response >= 0) & ~sync.bundled[position] & ~to_other
        rows, position, response = rows[true], position[true], response[true]
        if not len(rows):
            return
        state.response.add(response)
        state.late += self._late(passing.bus, state, rows, response, block)
        low, high = self._device_bounds(passing, rows, position, response, sync)
        if passing.bit_ns is not None:
            state.device_low.add(low)
            state.device_high.add(high)
        state.responses.add(
            {
                "seq": block.batch.seq0 + rows,
                "t_ns": block.frames.t_ns[rows],
                "response_us": response / 1000,
                "device_low_us": low / 1000,
                "device_high_us": high / 1000,
            }
        )

    def _device_bounds(
        self,
        passing: _Pass,
        rows: NDArray[np.intp],
        position: NDArray[np.int64],
        response: NDArray[np.int64],
        sync: SyncIndex,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(low, high) [ns] of the time from the end of the SYNC to the request to send.

        At least: everything since the SYNC, intermissions included, kept the device waiting. At
        most: the bus was idle, and only the frame itself (which has no intermission before its
        end) passed. Both are widened by the step of the stamps; NaN without a bit rate.
        """
        if passing.bit_ns is None:
            nothing = np.full(len(rows), np.nan)
            return nothing, nothing
        block = passing.block
        busy = passing.sent[rows] - sync.bits[position]
        own = np.where(block.fd[rows], 0, block.wire_bits[rows] - INTERMISSION_BITS)
        step_ns = self._context.resolution_ns - 1
        low = np.floor(response - busy * passing.bit_ns) - step_ns
        high = np.ceil(response - own * passing.bit_ns) + step_ns
        return np.maximum(low, 0.0), np.maximum(high, 0.0)

    def _late(
        self,
        bus: int,
        state: PdoState,
        rows: NDArray[np.intp],
        response: NDArray[np.int64],
        block: Block,
    ) -> int:
        """Answers after the synchronous window (1007h), where the node has one."""
        if state.owner is None or state.owner.kind == "rpdo":
            return 0
        seq = block.batch.seq0 + int(rows[-1])
        window_us = self._context.shadow.number(bus, state.owner.node, 0x1007, 0, seq)
        return int((response > window_us * 1000).sum()) if window_us else 0


def _span(span: list[int], t_ns: NDArray[np.int64]) -> None:
    """Widen (first, last) by more stamps, in order."""
    if len(t_ns):
        span[:] = [span[0] if span else int(t_ns[0]), int(t_ns[-1])]


def _count_repeats(state: PdoState, block: Block, rows: NDArray[np.intp]) -> None:
    """Count frames whose data are those of the frame before."""
    data = block.frames.data[rows, :8]
    state.repeats += int((data[1:] == data[:-1]).all(axis=1).sum())
    state.repeats += bool(state.last_data == data[0].tobytes())
    state.last_data = data[-1].tobytes()


def _spread(values: Distribution) -> float:
    """Interquartile range."""
    return values.quantile(0.75) - values.quantile(0.25)


def _kind(state: PdoState) -> int:
    """n of a PDO that answers every n-th SYNC by its settings, 1 where they do not tell."""
    kind = _value(state.transmission.type) if state.transmission else None
    return kind if isinstance(kind, int) and 1 <= kind <= 0xF0 else 1


def _value(known: object) -> object:
    return getattr(known, "value", None)


def _values(settings: Transmission) -> tuple[object, ...]:
    return tuple(
        _value(e) for e in (settings.type, settings.inhibit_100us, settings.event_timer_ms)
    )
