"""PDO timing: answers to SYNC with the bounds of the device time, missed and extra ones, periods."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.block import UNKNOWN_BITS, Block
from syncline_analyzer.folds.timing.extremes import limits_of
from syncline_analyzer.folds.timing.lateness import others_as_late
from syncline_analyzer.folds.timing.on_wire import OnWire
from syncline_analyzer.folds.timing.overdue import lacking_after
from syncline_analyzer.folds.timing.pdo_frames import PdoFrames
from syncline_analyzer.folds.timing.pdo_state import Pause, PdoState
from syncline_analyzer.folds.timing.phase import UNTOLD, Phase
from syncline_analyzer.folds.timing.sync import SyncFold
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_analyzer.folds.timing.waiting_fold import WaitingFold
from syncline_analyzer.pdo_binding import PdoBindings, Transmission, settled
from syncline_schemas.batch import FrameFlag
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.wire_length import INTERMISSION_BITS

MAX_PAUSES = 1000
MAX_EVIDENCE = 20
PAUSE_NS = 5_000_000_000
PAUSE_PERIODS = 20
"""A PDO that stays away for so long, and so many of its periods, has stopped."""
_BY_EVENTS = (0xFE, 0xFF)
"""Transmission types of a PDO that answers no SYNC, so that none can have kept it waiting."""
DEADLINE = 1.1
"""An RPDO is overdue when it takes longer than so many times what its node allows (140xh:5)."""


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

    def __init__(
        self,
        context: Context,
        bindings: PdoBindings,
        sync: SyncFold,
        waiting: WaitingFold,
        on_wire: OnWire,
    ) -> None:
        self._context = context
        self._on_wire = on_wire
        self._bindings = bindings
        self._sync = sync
        self._waiting = waiting
        self._sent: dict[int, int] = {}
        self._told_ids: dict[int, tuple[int | None, set[int]]] = {}
        self._told_syncs: dict[int, tuple[tuple[int | None, int] | None, list[int]]] = {}
        self.states: dict[tuple[int, int], PdoState] = {}

    def update(self, block: Block, bus: int) -> None:
        """Take in the frames of one bus of a block, SYNCs included."""
        self._bindings.refresh(bus)
        first_seq, last_seq = block.batch.seq0, block.batch.last_seq
        version = settled(self._context.shadow, bus, last_seq)
        for can_id in self._new_pdo_ids(block, bus, version):
            if (bus, can_id) not in self.states:
                self.states[bus, can_id] = PdoState()
        for can_id, state in self._states_of(bus):
            if version is None or state.bound_version != version:
                self._rebind(state, bus, can_id, first_seq, last_seq)
                state.bound_version = version
        requests = self._requests(block, bus)
        bit_ns = self._on_wire.bit_ns(bus)
        sent = self._sent_bits(block, bus)
        syncs = {
            cob: self._sync.update(block, bus, cob, sent, version)
            for cob in self._followed_syncs(bus, last_seq, version)
        }
        passing = _Pass(block, bus, sent, bit_ns, syncs)
        self._waiting.begin(block, bus, passing.bit_ns)
        for can_id, state in self._states_of(bus):
            frames = PdoFrames.in_block(block, bus, can_id)
            if len(frames.rows):
                self._follow(block, state, frames, syncs.get(state.sync_cob_id))
            asked = state.requested.follow(frames.rows, requests[can_id])
            state.request_answers.add(
                frames.rows,
                requests[can_id],
                block.frames.t_ns,
                block.batch.seqs,
                timed=self._context.timed,
            )
            self._answer(passing, can_id, state, frames, asked)

    def gap(self, bus: int | None) -> None:
        """Nothing is due and no period counts over a gap."""
        for (state_bus, _), state in self.states.items():
            if bus in (None, state_bus):
                state.last_ns = None
                state.rhythm.restart()
                state.slips.restart()
                # How many SYNCs lie in it is not known: their numbers begin anew.
                state.phase = Phase()
                state.requested.restart()
                state.request_answers.restart()
                state.overdue.flush()

    def _requests(self, block: Block, bus: int) -> dict[int, NDArray[np.intp]]:
        """Rows of the remote frames that asked for each PDO (CiA 301 7.2.2.5.2), counted as well."""
        remote = _remote(block, bus)
        found = {}
        for can_id, state in self._states_of(bus):
            rows = block.batch.rows(bus, can_id)
            empty = rows[block.frames.dlc.take(rows) == 0]
            asked = remote[block.frames.can_id[remote] == can_id] if len(remote) else remote
            if 0 < len(empty) < len(rows):
                asked = np.sort(np.concatenate((asked, empty)))
            state.asked += len(asked)
            found[can_id] = asked
        return found

    def _states_of(self, bus: int) -> list[tuple[int, PdoState]]:
        return [(can_id, state) for (b, can_id), state in self.states.items() if b == bus]

    def _sent_bits(self, block: Block, bus: int) -> NDArray[np.int64]:
        bits = block.wire_bits
        if block.batch.flags_seen & FrameFlag.ERROR:
            bits = bits + block.error * np.int64(UNKNOWN_BITS)
        if len(block.batch.buses) > 1:
            bits = np.where(block.frames.bus == bus, bits, 0)
        sent: NDArray[np.int64] = np.cumsum(bits) + self._sent.get(bus, 0)
        self._sent[bus] = int(sent[-1])
        return sent

    def _new_pdo_ids(self, block: Block, bus: int, version: int | None) -> list[int]:
        """PDO identifiers in a block, as far as that was not told with the same `version`."""
        seen = {can_id for id_bus, can_id in block.batch.ids() if id_bus == bus}
        seen.update(block.frames.can_id[_remote(block, bus)].tolist())
        told_version, told = self._told_ids.get(bus, (None, set()))
        if version is not None and told_version == version:
            seen -= told
        else:
            told = set()
        if not seen:
            return []
        self._told_ids[bus] = version, told | seen
        bound = set(self._bindings.identifiers(bus))
        seq = block.batch.last_seq
        taken = set(self._sync_ids(bus, seq))
        for can_id in self._bindings.other_services(bus, seq):
            owner = self._bindings.owner(bus, can_id, seq)
            if owner is None or owner.guess:
                taken.add(can_id)
        return sorted(
            can_id
            for can_id in seen - taken
            if can_id in bound or SERVICE_OF_ID[can_id] == Service.PDO
        )

    def _followed_syncs(self, bus: int, seq: int, version: int | None) -> list[int]:
        """`_sync_ids` once all states know their owners, looked up again for another `version`."""
        key = version, len(self.states)
        if version is None or self._told_syncs.get(bus, (None, []))[0] != key:
            self._told_syncs[bus] = key, self._sync_ids(bus, seq)
        return self._told_syncs[bus][1]

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
            state.overdue.flush()
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
        self, block: Block, state: PdoState, frames: PdoFrames, sync: SyncIndex | None
    ) -> None:
        """Periods of the identifier, SYNC or not; those in a backlog of SYNCs are none."""
        t_ns, seq, rows = frames.t_ns, frames.seq, frames.rows
        last_ns, last_seq = state.last_ns, state.last_seq
        state.last_ns, state.last_seq = int(t_ns[-1]), int(seq[-1])
        state.frames += len(rows)
        state.repeats.add(block.batch.words_by_id[frames.place])
        if not self._context.timed:
            return
        if last_ns is not None:
            t_ns = np.concatenate(([last_ns], t_ns))
            seq = np.concatenate(([last_seq], seq))
        periods = t_ns[1:] - t_ns[:-1]
        if not len(periods):
            return
        true = periods >= 0
        if sync is not None and sync.any_bundled:
            bundled = np.concatenate(([False], sync.bundled[sync.before[rows]]))
            true &= ~(bundled[1:] | bundled[:-1])[len(rows) - len(periods) :]
        if true.all():
            state.periods.add(periods, seq[1:], t_ns[1:])
        else:
            state.periods.add(periods[true], seq[1:][true], t_ns[1:][true])
        self._find_pauses(state, periods, t_ns, seq)
        self._find_too_soon(state, periods, true, t_ns[1:], seq[1:])
        self._find_overdue(block, state, rows[-len(periods) :], periods, t_ns[:-1], seq[:-1])

    @staticmethod
    def _find_pauses(
        state: PdoState,
        periods: NDArray[np.int64],
        t_ns: NDArray[np.int64],
        seq: NDArray[np.int64],
    ) -> None:
        """Long times without a frame, of which the rhythm of the whole capture tells more."""
        if int(periods.max()) < PAUSE_NS:
            return
        for at in np.flatnonzero(periods >= PAUSE_NS)[: MAX_PAUSES - len(state.pauses)].tolist():
            state.pauses.append(
                Pause(int(t_ns[at]), int(t_ns[at + 1]), int(seq[at]), int(seq[at + 1]))
            )

    @staticmethod
    def _find_too_soon(
        state: PdoState,
        periods: NDArray[np.int64],
        true: NDArray[np.bool_],
        t_ns: NDArray[np.int64],
        seq: NDArray[np.int64],
    ) -> None:
        """Frames closer than half the inhibit time: more than arbitration can pull together."""
        inhibit_ns = state.told_inhibit_ns()
        if inhibit_ns is None:
            return
        soon = np.flatnonzero(true & (periods < inhibit_ns / 2) & (seq > state.changed_seq))
        if len(soon):
            state.broken_inhibit_ns = inhibit_ns
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
        """Missing periods of a cyclic TPDO whose event timer was told, late ones of such an RPDO.

        Not where others on the bus are as late: then nobody was heard, or the clock was set.
        """
        timer_ns, deadline_ns = state.told_timer_ns(), state.told_deadline_ns()
        if timer_ns is None:
            state.overdue.flush()
        due_ns = timer_ns or deadline_ns
        if state.owner is None or due_ns is None:
            return
        if timer_ns is not None:
            late = lacking_after(periods, timer_ns)[0]
        else:
            late = np.flatnonzero(periods > DEADLINE * due_ns)
        judged = before_seq >= state.changed_seq
        for at in late[judged[late]].tolist():
            begin = block.batch.row_at(int(before_seq[at]))
            late_ns = int(periods[at]) - due_ns
            judged[at] = not others_as_late(block, state.owner, begin, int(rows[at]), late_ns)
        if timer_ns is not None:
            state.overdue.add(timer_ns, periods, before_ns, before_seq, judged)
        else:
            late = late[judged[late]]
            state.past_deadline.add(before_ns[late] + due_ns, before_seq[late])

    def _answer(
        self,
        passing: _Pass,
        can_id: int,
        state: PdoState,
        frames: PdoFrames,
        asked: NDArray[np.bool_],
    ) -> None:
        """Pair the PDOs of a block with the SYNCs before them; those `asked` for prove less."""
        sync = passing.syncs.get(state.sync_cob_id)
        if sync is None:
            return
        at = sync.before_by_id[frames.place]
        spared = None
        if state.told_type() is None:
            spared = state.slips.follow(at, frames.t_ns, sync)
        # The SYNCs before the frames stand in order.
        heard = int(np.searchsorted(at, sync.first)) if len(at) and at[0] < sync.first else 0
        frames, at, asked = frames.since(heard), at[heard:], asked[heard:]
        ordinal = sync.first_ordinal + at
        first = state.rhythm.first_of_period(ordinal)
        answers = frames
        if asked.any() or not first.all():
            # Where a SYNC may be lost, two frames in one period prove nothing.
            beside = state.requested.beside(ordinal, asked)
            extra = np.flatnonzero(~first & ~beside)
            if len(extra):
                extra = extra[sync.lossless(frames.rows[extra], passing.block.frames.t_ns)]
                self._count_extra(passing.block, state, frames.rows, ordinal, first, extra)
            answers = frames.chosen(np.flatnonzero(first & ~asked))
            frames, at, ordinal = frames.chosen(np.flatnonzero(first)), at[first], ordinal[first]
        if self._context.timed and len(answers.rows):
            self._respond(passing, can_id, state, answers, sync)
        fresh = int(np.searchsorted(frames.seq, state.changed_seq))
        state.rhythm.answered(ordinal[fresh:])
        every = self._due_every(passing.bus, state)
        self._count_phase(state, at, sync)
        unanswered = state.rhythm.evaluate(every, sync, spared if every == 1 else None)
        if len(unanswered):
            self._waiting.unanswered(can_id, state.owner, unanswered, sync)

    @staticmethod
    def _count_extra(
        block: Block,
        state: PdoState,
        rows: NDArray[np.intp],
        ordinal: NDArray[np.int64],
        first: NDArray[np.bool_],
        extra: NDArray[np.intp],
    ) -> None:
        """Second frames in a SYNC period, those apart beside which nothing is missing."""
        state.extra += len(extra)
        state.rhythm.crowded += len(np.unique(ordinal[extra]))
        alone = extra[state.rhythm.beside_answers(ordinal[first], ordinal[extra], _kind(state))]
        state.extra_alone += len(alone)
        more = rows[alone[: MAX_EVIDENCE - len(state.extra_seq)]]
        state.extra_seq.extend(block.batch.seqs[more].tolist())
        _span(state.extra_ns, block.frames.t_ns[rows[alone]])

    @staticmethod
    def _count_phase(state: PdoState, at: NDArray[np.int64], sync: SyncIndex) -> None:
        """Which of n SYNCs, by their positions, were answered."""
        state.answered += len(at)
        told = state.told_type()
        every = UNTOLD if told is None else told
        if state.off or not 2 <= every <= 0xF0:
            return
        state.phase.add(every, at, sync)

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
        self,
        passing: _Pass,
        can_id: int,
        state: PdoState,
        frames: PdoFrames,
        sync: SyncIndex,
    ) -> None:
        """Response and both bounds of the device time (analysis.md section 5)."""
        position = frames.of(sync.before_by_id)
        response = frames.of(sync.since_by_id)
        if sync.any_bundled or not sync.all_usable or int(response.min()) < 0:
            # After a pause of the SYNC a PDO answers one that was not heard.
            to_other = ~sync.usable[position] & (response > sync.cycle_ns)
            true = np.flatnonzero((response >= 0) & ~sync.bundled[position] & ~to_other)
            if not len(true):
                return
            frames, position, response = frames.chosen(true), position[true], response[true]
        block, rows, seq, t_ns = passing.block, frames.rows, frames.seq, frames.t_ns
        limits = limits_of(response)
        state.response.add(response, limits)
        state.slowest.add(response, seq, t_ns, limits)
        state.late += self._late(passing.bus, state, rows, response, block)
        kept = state.responses.chosen(response.astype(np.float64))
        # Copies: what is kept must not hold on to the columns of the whole block.
        columns = {"seq": seq[kept], "t_ns": t_ns[kept], "response_us": response[kept] / 1000}
        if passing.bit_ns is not None:
            low, high = self._device_bounds(passing, passing.bit_ns, rows, position, response, sync)
            state.device_low.add(low)
            state.device_high.add(high)
            columns |= {"device_low_us": low[kept] / 1000, "device_high_us": high[kept] / 1000}
            if state.told_type() not in _BY_EVENTS:
                least, waiting = self._waiting.answers(
                    can_id, state.owner, seq, position, sync, low, high
                )
                columns |= {
                    "device_least_us": least[kept] / 1000,
                    "waiting_us": waiting[kept] / 1000,
                }
        state.responses.add_chosen(columns)

    def _device_bounds(
        self,
        passing: _Pass,
        bit_ns: float,
        rows: NDArray[np.intp],
        position: NDArray[np.int64],
        response: NDArray[np.int64],
        sync: SyncIndex,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(low, high) [ns] of the time from the end of the SYNC to the request to send.

        At least: everything since the SYNC, intermissions included, kept the device waiting. At
        most: the bus was idle, and only the frame itself (which has no intermission before its
        end) passed. Both are widened by the step of the stamps and by what these prove to be off
        beyond it.
        """
        block = passing.block
        busy = passing.sent[rows] - sync.bits[position]
        own = block.wire_bits[rows] - INTERMISSION_BITS
        step_ns = self._context.resolution_ns - 1 + self._on_wire.noise_ns(passing.bus)
        low = np.floor(response - busy * bit_ns) - step_ns
        high = np.ceil(response - own * bit_ns) + step_ns
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
        seq = block.batch.seq(rows[-1])
        window_us = self._context.shadow.number(bus, state.owner.node, 0x1007, 0, seq)
        return int((response > window_us * 1000).sum()) if window_us else 0


def _remote(block: Block, bus: int) -> NDArray[np.intp]:
    """Rows of the remote frames with 11-bit identifiers."""
    if not block.batch.flags_seen & FrameFlag.REMOTE:
        return np.zeros(0, np.intp)
    rows = np.flatnonzero(block.batch.remote)
    short = (block.frames.flags[rows] & FrameFlag.EXTENDED) == 0
    found: NDArray[np.intp] = rows[short & (block.frames.bus[rows] == bus)]
    return found


def _span(span: list[int], t_ns: NDArray[np.int64]) -> None:
    """Widen (first, last) by more stamps, in order."""
    if len(t_ns):
        span[:] = [span[0] if span else int(t_ns[0]), int(t_ns[-1])]


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
