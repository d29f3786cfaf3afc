"""PDO timing: answers to SYNC with the bounds of the device time, missed and extra ones, periods."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.block import UNKNOWN_BITS, Block
from syncline_analyzer.folds.timing.device_times import DeviceTimes
from syncline_analyzer.folds.timing.extremes import limits_of
from syncline_analyzer.folds.timing.on_wire import OnWire
from syncline_analyzer.folds.timing.pdo_answers import PdoAnswers
from syncline_analyzer.folds.timing.pdo_columns import PdoColumns
from syncline_analyzer.folds.timing.pdo_frames import PdoFrames
from syncline_analyzer.folds.timing.pdo_periods import follow, widen
from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.phase import UNTOLD, Phase
from syncline_analyzer.folds.timing.sync import SyncFold
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_analyzer.folds.timing.waiting_fold import WaitingFold
from syncline_analyzer.pdo_binding import Pdo, PdoBindings, Transmission, settled
from syncline_schemas import native
from syncline_schemas.batch import FrameFlag
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.records import dataclass

_NO_ROWS = np.zeros(0, np.intp)
MAX_EVIDENCE = 20


@dataclass(frozen=True, slots=True, eq=False)
class _Pass:
    """A block as one bus sees it, and what is found of its PDOs.

    Attributes:
        columns: of the PDOs that were sent.
        numbers: of these PDOs there, by their identifiers.
        answers: those of which the times tell something, with the SYNCs that they answer.
        unanswered: identifier and owner of PDOs, and positions of SYNCs that they left unanswered.
    """

    block: Block
    bus: int
    syncs: dict[int, SyncIndex | None]
    columns: PdoColumns
    numbers: dict[int, int]
    answers: list[tuple[SyncIndex, PdoAnswers]] = field(default_factory=list)
    unanswered: list[tuple[int, Pdo | None, NDArray[np.int64], SyncIndex]] = field(
        default_factory=list
    )


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
                state.window_ns = self._window_ns(bus, state, last_seq)
                state.bound_version = version
        requests = self._requests(block, bus)
        sent = self._sent_bits(block, bus)
        syncs = {
            cob: self._sync.update(block, bus, cob, sent, version)
            for cob in self._followed_syncs(bus, last_seq, version)
        }
        passing = _Pass(block, bus, syncs, *self._columns(block, bus))
        self._waiting.begin(block, bus, self._on_wire.bit_ns(bus))
        for can_id, state in self._states_of(bus):
            self._take(passing, can_id, state, requests.get(can_id, _NO_ROWS))
        times = DeviceTimes(self._context, self._on_wire, self._waiting, block, bus, sent)
        for sync in syncs.values():
            answers = [each for to, each in passing.answers if to is sync]
            if sync is not None and answers:
                times.measure(sync, passing.columns.after(sync), answers)
        for can_id, owner, missed, sync in passing.unanswered:
            self._waiting.unanswered(can_id, owner, missed, sync)

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

    def _columns(self, block: Block, bus: int) -> tuple[PdoColumns, dict[int, int]]:
        """The PDOs that were sent, and the number of each by its identifier."""
        places = [(block.batch.place(bus, can_id), can_id) for can_id, _ in self._states_of(bus)]
        found = sorted((at.start, at.stop, can_id) for at, can_id in places if at.stop > at.start)
        states = [self.states[bus, can_id] for *_, can_id in found]
        columns = PdoColumns(block, [slice(start, stop) for start, stop, _ in found], states)
        return columns, {can_id: number for number, (*_, can_id) in enumerate(found)}

    def _take(
        self, passing: _Pass, can_id: int, state: PdoState, requests: NDArray[np.intp]
    ) -> None:
        """Take in the frames of one PDO, and the requests for it."""
        block, sync = passing.block, passing.syncs.get(state.sync_cob_id)
        frames = PdoFrames.in_block(block, passing.bus, can_id)
        if len(frames.rows):
            number = passing.numbers[can_id]
            follow(passing.columns, number, state, frames, sync, timed=self._context.timed)
        asked = state.requested.follow(frames.rows, requests)
        state.request_answers.add(block.batch, frames.rows, requests, timed=self._context.timed)
        if sync is not None:
            self._answer(passing, can_id, state, frames, sync, asked)

    def _requests(self, block: Block, bus: int) -> dict[int, NDArray[np.intp]]:
        """Rows of the remote frames that asked for PDOs (CiA 301 7.2.2.5.2), counted as well."""
        remote, lengths = _remote(block, bus), block.batch.lengths
        found = {}
        for can_id, state in self._states_of(bus):
            shortest, _ = lengths.get((bus, can_id), (1, 1))
            if shortest and not len(remote):
                continue
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
        sent = running(bits, self._sent.get(bus, 0))
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

    def _answer(
        self,
        passing: _Pass,
        can_id: int,
        state: PdoState,
        frames: PdoFrames,
        sync: SyncIndex,
        asked: NDArray[np.bool_] | None,
    ) -> None:
        """Pair the PDOs of a block with the SYNCs before them; those `asked` for prove less."""
        at = frames.of(passing.columns.after(sync).position)
        spared = None
        if state.told_type() is None:
            spared = state.slips.follow(at, frames.t_ns, sync)
        # Where every frame is the first after its SYNC, what follows is known of all PDOs at once.
        number = passing.numbers.get(can_id) if asked is None else None
        steps = None if number is None else passing.columns.steps(sync, number)
        if steps is None or steps[0] < 1 or at[0] < sync.first:
            number = steps = None
        answers = frames
        if number is None:
            frames, answers, at = self._first_ones(passing, state, frames, at, sync, asked)
        if self._context.timed and len(answers.rows):
            self._respond(passing, can_id, state, answers, sync, number)
        fresh = int(np.searchsorted(frames.seq, state.changed_seq))
        ordinal = sync.first_ordinal + at
        state.rhythm.answered(ordinal[fresh:], None if fresh else steps)
        every = self._due_every(passing.bus, state)
        self._count_phase(passing, state, at, sync, number)
        unanswered = state.rhythm.evaluate(every, sync, spared if every == 1 else None)
        if len(unanswered):
            passing.unanswered.append((can_id, state.owner, unanswered, sync))

    def _first_ones(
        self,
        passing: _Pass,
        state: PdoState,
        frames: PdoFrames,
        at: NDArray[np.int64],
        sync: SyncIndex,
        asked: NDArray[np.bool_] | None,
    ) -> tuple[PdoFrames, PdoFrames, NDArray[np.int64]]:
        """The first frames after each SYNC, those of them that answer it, and its position."""
        # The SYNCs before the frames stand in order.
        heard = int(np.searchsorted(at, sync.first)) if len(at) and at[0] < sync.first else 0
        frames, at = frames.since(heard), at[heard:]
        if asked is not None:
            asked = asked[heard:] if asked[heard:].any() else None
        ordinal = sync.first_ordinal + at
        first = state.rhythm.first_of_period(ordinal)
        if asked is None and first.all():
            return frames, frames, at
        # Where a SYNC may be lost, two frames in one period prove nothing.
        beside = state.requested.beside(ordinal, asked)
        extra = np.flatnonzero(~first & ~beside)
        if len(extra):
            extra = extra[sync.lossless(frames.rows[extra], passing.block.frames.t_ns)]
            self._count_extra(passing.block, state, frames.rows, ordinal, first, extra)
        answering = first if asked is None else first & ~asked
        answers = frames.chosen(np.flatnonzero(answering))
        return frames.chosen(np.flatnonzero(first)), answers, at[first]

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
        # The SYNCs before the frames stand in order.
        state.rhythm.crowded += int(np.count_nonzero(np.diff(ordinal[extra], prepend=-2)))
        alone = extra[state.rhythm.beside_answers(ordinal[first], ordinal[extra], _kind(state))]
        state.extra_alone += len(alone)
        more = rows[alone[: MAX_EVIDENCE - len(state.extra_seq)]]
        state.extra_seq.extend(block.batch.seqs_at(more).tolist())
        widen(state.extra_ns, block.frames.t_ns[rows[alone]])

    @staticmethod
    def _count_phase(
        passing: _Pass,
        state: PdoState,
        at: NDArray[np.int64],
        sync: SyncIndex,
        number: int | None,
    ) -> None:
        """Which of n SYNCs, by their positions, were answered; by all frames of PDO `number`."""
        state.answered += len(at)
        told = state.told_type()
        every = UNTOLD if told is None else told
        if state.off or not 2 <= every <= 0xF0:
            return
        if number is not None and every == UNTOLD and not sync.counted:
            state.phase.add_counts(every, passing.columns.after(sync).phases[number])
        else:
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

    @staticmethod
    def _respond(
        passing: _Pass,
        can_id: int,
        state: PdoState,
        frames: PdoFrames,
        sync: SyncIndex,
        number: int | None,
    ) -> None:
        """Responses (analysis.md section 5), which are those of all frames of PDO `number`."""
        after = passing.columns.after(sync)
        position, response = frames.of(after.position), frames.of(after.since)
        limits = limits_of(response) if number is None else after.responses[number]
        if sync.any_bundled or not sync.all_usable or limits[0] < 0:
            # After a pause of the SYNC a PDO answers one that was not heard.
            to_other = ~sync.usable[position] & (response > sync.cycle_ns)
            true = np.flatnonzero((response >= 0) & ~sync.bundled[position] & ~to_other)
            if not len(true):
                return
            frames, position, response = frames.chosen(true), position[true], response[true]
            limits = limits_of(response)
        state.response.add(response, limits)
        state.slowest.add(response, frames.seq, frames.t_ns, limits)
        if state.window_ns is not None and limits[1] > state.window_ns:
            state.late += int(np.count_nonzero(response > state.window_ns))
        passing.answers.append((sync, PdoAnswers(can_id, state, frames, position, response)))

    def _window_ns(self, bus: int, state: PdoState, seq: int) -> int | None:
        """Synchronous window length (1007h) of the node that sends a PDO."""
        if state.owner is None or state.owner.kind == "rpdo":
            return None
        window_us = self._context.shadow.number(bus, state.owner.node, 0x1007, 0, seq)
        return window_us * 1000 if window_us else None


def running(values: NDArray[np.int64], first: int) -> NDArray[np.int64]:
    """(n,) `first` and the values up to each one, added up."""
    if native.available():
        return native.running(values, first)
    sums: NDArray[np.int64] = np.cumsum(values)
    sums += first
    return sums


def _remote(block: Block, bus: int) -> NDArray[np.intp]:
    """Rows of the remote frames with 11-bit identifiers."""
    if not block.batch.flags_seen & FrameFlag.REMOTE:
        return np.zeros(0, np.intp)
    rows = np.flatnonzero(block.batch.remote)
    short = (block.frames.flags[rows] & FrameFlag.EXTENDED) == 0
    found: NDArray[np.intp] = rows[short & (block.frames.bus[rows] == bus)]
    return found


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
