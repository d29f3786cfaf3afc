"""SYNC, PDO timing and bus load in one pass over the frames."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import Unread
from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.timing.block import BLOCK_FRAMES, Block, Blocks
from syncline_analyzer.folds.timing.held import held
from syncline_analyzer.folds.timing.load import LoadFold
from syncline_analyzer.folds.timing.pause import pauses
from syncline_analyzer.folds.timing.pdo import PdoFold, PdoState
from syncline_analyzer.folds.timing.rhythm import LEARN, MissedList, Operational
from syncline_analyzer.folds.timing.silence import Silence, SilenceFold, within_silence
from syncline_analyzer.folds.timing.sync import SyncFold, SyncHole, SyncTable
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_analyzer.results import (
    BusLoadRow,
    BusSilenceRow,
    ClockStepRow,
    HoleRow,
    NmtCommandRow,
    NmtStateRow,
    OverloadRow,
    PdoPauseRow,
    PdoRow,
    Responses,
    Series,
    SyncDoubleRow,
    SyncJitterRow,
    SyncRow,
)
from syncline_analyzer.shadow import Known
from syncline_schemas.batch import Gap

MAX_HOLES = 1000
MAX_EVIDENCE = 100
LONG_HOLE_NS = 1_000_000_000
"""A stretch without SYNC as long as a node's restart."""
START_NS = 10_000_000
"""Time that a node has to act on a start command."""
_CYCLIC = 0.1
"""Interquartile range of the period of a cyclic PDO, as a share of the median."""


@dataclass(frozen=True, slots=True)
class TimingTables:
    """Everything about SYNC, PDOs and bus load."""

    sync: list[SyncRow] = field(default_factory=list)
    pdos: list[PdoRow] = field(default_factory=list)
    bus_load: list[BusLoadRow] = field(default_factory=list)
    holes: list[HoleRow] = field(default_factory=list)
    sync_jitter: list[SyncJitterRow] = field(default_factory=list)
    responses: list[Responses] = field(default_factory=list)
    series: list[Series] = field(default_factory=list)
    pdo_pauses: list[PdoPauseRow] = field(default_factory=list)
    clock_steps: list[ClockStepRow] = field(default_factory=list)
    bus_silences: list[BusSilenceRow] = field(default_factory=list)
    overloads: list[OverloadRow] = field(default_factory=list)
    sync_doubles: list[SyncDoubleRow] = field(default_factory=list)


MAX_TURNS = 256
"""Changes of PDO or SYNC parameters that are followed within one block; a master does less."""


class TimingFold:
    """SYNC periods, PDO responses, missed PDOs and bus load.

    Comes after the fold that fills the shadow. Batches are joined to blocks first, so the state of
    the shadow counts by `seq`, not by when it is asked.
    """

    def __init__(self, context: Context, block_frames: int = BLOCK_FRAMES) -> None:
        self._context = context
        self._blocks = Blocks(block_frames)
        self._bindings = PdoBindings(context.shadow)
        self._sync = SyncFold(context)
        self._pdo = PdoFold(context, self._bindings, self._sync)
        self._load = LoadFold(context)
        self._silence = SilenceFold()
        self._gap_starts: set[int] = set()
        self._unread: list[Silence] = []
        self._end_ns = 0

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        for block in self._blocks.add(batch):
            self._take(block)

    def gap(self, gap: Gap) -> None:
        """Periods, counts and windows start again after a gap."""
        self._flush()
        self._gap_starts.add(gap.start_ns)
        self._sync.gap(gap.bus)
        self._pdo.gap(gap.bus)
        self._load.gap(gap.bus)
        self._silence.gap(gap.bus)

    def finish(
        self,
        end_ns: int,
        nmt_states: Sequence[NmtStateRow] | None = None,
        commands: Sequence[NmtCommandRow] = (),
        unread: Sequence[Unread] = (),
    ) -> TimingTables:
        """All tables; a PDO is missed only while `nmt_states` say OPERATIONAL (None: always).

        `commands` are those of the master, which may switch SYNC off while it holds all nodes. Where
        lines are `unread`, what is missing may be in them.
        """
        self._unread = [Silence(each.start_ns, each.end_ns, 0, 0, {}) for each in unread]
        self._flush()
        self._end_ns = end_ns
        load, load_series = self._load.finish()
        syncs = self._sync.finish()
        tables = TimingTables(
            bus_load=load,
            sync_jitter=[row for table in syncs for row in table.jitter],
            series=[t.series for t in syncs if t.series is not None] + load_series,
            overloads=self._load.overloads(),
            sync_doubles=[row for table in syncs for row in table.doubles],
        )
        self._add_silences(tables)
        for table in syncs:
            silences = self._silences(table.row.bus)
            judged = _judged(table, nmt_states or (), silences, commands, unread)
            tables.sync.append(judged.row)
            tables.holes.extend(_sync_holes(judged))
        for (bus, can_id), state in sorted(self._pdo.states.items()):
            if state.frames:
                self._add_pdo(tables, bus, can_id, state, nmt_states)
        return tables

    def _add_silences(self, tables: TimingTables) -> None:
        for bus, name in enumerate(self._context.buses):
            steps = self._silence.steps(bus)
            stepped = {step.end_seq for step in steps}
            tables.clock_steps.extend(
                ClockStepRow(name, s.start_ns, s.end_ns, s.by_ns, s.witnesses, [s.end_seq])
                for s in steps
            )
            tables.bus_silences.extend(
                BusSilenceRow(name, s.start_ns, s.end_ns, [s.start_seq, s.end_seq])
                for s in self._silence.of(bus)
                if s.end_seq not in stepped and not s.stalled
            )

    def _silences(self, bus_name: str) -> list[Silence]:
        buses = [k for k, name in enumerate(self._context.buses) if name == bus_name]
        return [silence for bus in buses for silence in self._silence.of(bus)]

    def _flush(self) -> None:
        for block in self._blocks.flush():
            self._take(block)

    def _take(self, block: Block) -> None:
        for part in block.parts(self._turns(block)):
            for bus in part.by_bus:
                self._pdo.update(part, bus)
        for bus in block.by_bus:
            self._load.update(block, bus)
            if self._context.timed:
                self._silence.update(block, bus)

    def _turns(self, block: Block) -> list[int]:
        """Where PDOs or SYNC moved or got another timing: nothing is told over such a frame."""
        first, last = block.batch.seq0, block.batch.seq0 + len(block.batch) - 1
        turns = {turn for bus in block.by_bus for turn in self._bindings.turns(bus, first, last)}
        return sorted(turns)[:MAX_TURNS]

    def _add_pdo(
        self,
        tables: TimingTables,
        bus: int,
        can_id: int,
        state: PdoState,
        nmt_states: Sequence[NmtStateRow] | None,
    ) -> None:
        sync_ns = self._sync.median_ns(bus, state.sync_cob_id)
        sending = _sending(state, sync_ns, self._context)
        missed = self._missed(bus, state, sending, sync_ns, nmt_states)
        silences = [
            *self._silence.of(bus),
            *self._unsure(bus, state, nmt_states),
            *self._unread,
        ]
        if silences:
            step_ns = _due_step_ns(state, sending, sync_ns)
            after_ns = step_ns if sending.every > 1 else 0.0
            missed = missed.without(within_silence(missed.t_ns, silences, step_ns, after_ns))
        name = self._context.bus_name(bus)
        row = _pdo_row(name, can_id, state, sending, missed)
        tables.pdos.append(row)
        tables.pdo_pauses.extend(self._pauses(bus, row, state, sending, missed, nmt_states))
        tables.holes.extend(_pdo_holes(row, missed, _due_step_ns(state, sending, sync_ns)))
        if sending.synchronous and state.response.count:
            tables.responses.append(_responses(row, state))

    def _unsure(
        self, bus: int, state: PdoState, nmt_states: Sequence[NmtStateRow] | None
    ) -> list[Silence]:
        """Times that the stamps go through twice, unless the node was OPERATIONAL all along."""
        name = self._context.bus_name(bus)
        if state.owner is None or nmt_states is None:
            return []
        whole = [
            (row.start_ns, row.end_ns)
            for row in nmt_states
            if (row.bus, row.node, row.state) == (name, state.owner.node, "OPERATIONAL")
        ]
        return [
            back
            for back in self._silence.backs(bus)
            if not any(start <= back.start_ns and back.end_ns <= end for start, end in whole)
        ]

    def _pauses(
        self,
        bus: int,
        row: PdoRow,
        state: PdoState,
        sending: "_Sending",
        missed: MissedList,
        nmt_states: Sequence[NmtStateRow] | None,
    ) -> list[PdoPauseRow]:
        """Long stretches without a PDO that has a rhythm, and whose node said OPERATIONAL."""
        owner = state.owner
        counter = self._bindings.repeat_counter(owner) if owner else None
        if owner is None or nmt_states is None or (counter is not None and counter.value):
            return []
        operational = _operational(nmt_states, row.bus, owner.node, self._gap_starts)
        if not operational or not self._context.timed:
            return []
        rhythm = self._rhythm(bus, state, sending)
        if rhythm is None:
            return []
        missed_ns = missed.t_ns if sending.synchronous else None
        silences = self._silence.of(bus)
        return pauses(row, state, rhythm, operational, silences, self._end_ns, missed_ns)

    def _rhythm(self, bus: int, state: PdoState, sending: "_Sending") -> tuple[float, str] | None:
        """Time between due frames [ns] and what says so; None where a change may send them."""
        if state.off or state.polled():
            return None
        if sending.synchronous:
            sync_ns = self._sync.median_ns(bus, state.sync_cob_id)
            known = state.told_type() is not None or state.rhythm.every() is not None
            step_ns = sync_ns * sending.every
            return (step_ns, "its SYNC") if known and sending.type != 0 and step_ns else None
        timer_ns = state.told_timer_ns()
        if timer_ns:
            return timer_ns, "its event timer (180xh:5)"
        if sending.source.startswith("inferred: cyclic") and state.sent_by_timer():
            return state.period.quantile(0.5), "the period that it kept before"
        return None

    def _missed(
        self,
        bus: int,
        state: PdoState,
        sending: "_Sending",
        sync_ns: float,
        nmt_states: Sequence[NmtStateRow] | None,
    ) -> MissedList:
        nothing = MissedList(np.zeros(0, np.int64), np.zeros(0, np.int64))
        counter = self._bindings.repeat_counter(state.owner) if state.owner else None
        if state.polled() or (counter is not None and counter.value):
            return nothing
        intervals = None
        if nmt_states is not None and state.owner is not None and self._context.timed:
            name = self._context.bus_name(bus)
            intervals = _operational(nmt_states, name, state.owner.node, self._gap_starts)
        if sending.synchronous:
            if _by_chance(state, sending, self._context):
                return nothing
            return state.rhythm.missed.within(intervals, sync_ns, START_NS)
        timer_ns = state.told_timer_ns()
        return state.overdue.within(intervals, timer_ns, timer_ns) if timer_ns else nothing


@dataclass(frozen=True, slots=True)
class _Sending:
    """Transmission type of a row, where it comes from, and n of a synchronous PDO."""

    type: int | None
    source: str
    synchronous: bool = False
    every: int = 1


def _sending(state: PdoState, sync_ns: float, context: Context) -> _Sending:
    """The transmission type as told; a mere default only where the frames do not contradict it."""
    judged = context.timed and not state.polled()
    inferred = _inferred(state, sync_ns) if judged else _Sending(None, "unknown")
    known = state.transmission.type if state.transmission else None
    if known is None or not isinstance(known.value, int):
        return inferred
    told = _told(known)
    if known.source == "eds-default" and inferred.source != "unknown":
        agree = told.synchronous == inferred.synchronous and (
            told.every == inferred.every or told.type == 0
        )
        event_on_sync = told.type == 0 and not inferred.synchronous
        # Frames every n periods of a steady SYNC look the same from a timer of that length.
        by_timer = (
            inferred.synchronous
            and not told.synchronous
            and not state.timer_excluded(context.resolution_ns)
        )
        return told if agree or event_on_sync or by_timer else inferred
    return told


def _by_chance(state: PdoState, sending: _Sending, context: Context) -> bool:
    """Whether a PDO whose sender was not told to be synchronous keeps step with SYNC by chance.

    A timer of n SYNC periods looks the same, and so do new values at that pace: who sends those
    owes nothing when the value stands still. The sender of an RPDO often sends SYNC as well, and
    its type (140xh:2) says when it is taken over, not when it is sent.
    """
    rpdo = state.owner is not None and state.owner.kind == "rpdo"
    inferred = sending.source.startswith("inferred")
    if not rpdo and (not inferred or sending.every == 1):
        return False
    steady = state.sent_by_timer() and not rpdo
    return not steady and not state.timer_excluded(context.resolution_ns)


def _told(known: Known) -> _Sending:
    number = known.value if isinstance(known.value, int) else 0
    return _Sending(number, known.source, number <= 0xF0, max(1, number) if number <= 0xF0 else 1)


def _inferred(state: PdoState, sync_ns: float) -> _Sending:
    """What the frames say (analysis.md section 5)."""
    every = state.answers_sync(sync_ns)
    if every is not None:
        which = "every SYNC" if every == 1 else f"every {_ordinal(every)} SYNC"
        return _Sending(every, f"inferred: synchronous, {which}", True, every)
    if state.period.count < LEARN - 1:
        return _Sending(None, "unknown")
    median = state.period.quantile(0.5)
    spread = state.period.quantile(0.75) - state.period.quantile(0.25)
    if median > 0 and spread < _CYCLIC * median:
        return _Sending(None, f"inferred: cyclic, {median / 1e6:.4g} ms")
    return _Sending(None, "inferred: event-driven")


def _ordinal(number: int) -> str:
    """
    >>> [_ordinal(n) for n in (2, 3, 4, 11, 21)]
    ['2nd', '3rd', '4th', '11th', '21st']
    """
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10)
    return f"{number}{ending or 'th'}"


def _operational(
    rows: Sequence[NmtStateRow], bus: str, node: int, gap_starts: set[int]
) -> list[Operational] | None:
    """When a node was OPERATIONAL; None when nothing at all is known of its state.

    It left that state unless the recorder stopped listening: an UNKNOWN that no gap begins comes
    from a silence of the whole bus.
    """
    of_node = [row for row in rows if row.bus == bus and row.node == node]
    if all(row.state == "UNKNOWN" for row in of_node):
        return None
    stretches = [list(group) for _, group in groupby(of_node, key=lambda row: row.state)]
    left = [
        after[0].state != "UNKNOWN" or after[0].start_ns not in gap_starts
        for after in stretches[1:]
    ]
    return [
        Operational(stretch[0].start_ns, stretch[-1].end_ns, is_left)
        for stretch, is_left in zip(stretches, [*left, False], strict=False)
        if stretch[0].state == "OPERATIONAL"
    ]


def _due_step_ns(state: PdoState, sending: _Sending, sync_ns: float) -> float:
    """Time between two moments at which the PDO is due."""
    if sending.synchronous:
        return sync_ns * sending.every
    return float(state.told_timer_ns() or 0)


def _pdo_row(
    bus: str, can_id: int, state: PdoState, sending: _Sending, missed: MissedList
) -> PdoRow:
    owner, answers = state.owner, sending.synchronous
    return PdoRow(
        bus=bus,
        cob_id=can_id,
        node=owner.node if owner else None,
        pdo=owner.name if owner else None,
        frames=state.frames,
        transmission_type=sending.type,
        type_source=sending.source,
        period_us=state.period.quantiles(1000),
        response_us=state.response.quantiles(1000, std=True) if answers else None,
        device_us_low=state.device_low.quantiles(1000) if answers else None,
        device_us_high=state.device_high.quantiles(1000) if answers else None,
        missed=missed.count,
        extra=state.extra if answers else 0,
        late=state.late if answers else 0,
        missed_seq=missed.seq[:MAX_EVIDENCE].tolist(),
        too_soon=state.too_soon,
        extra_alone=state.extra_alone if answers else 0,
        extra_seq=state.extra_seq if answers else [],
        extra_first_ns=state.extra_ns[0] if answers and state.extra_ns else None,
        extra_last_ns=state.extra_ns[-1] if answers and state.extra_ns else None,
        too_soon_seq=state.too_soon_seq,
        too_soon_first_ns=state.too_soon_ns[0] if state.too_soon_ns else None,
        too_soon_last_ns=state.too_soon_ns[-1] if state.too_soon_ns else None,
        inhibit_us=_us(state.told_inhibit_ns()),
        event_timer_us=_us(state.told_timer_ns()),
    )


def _us(ns: int | None) -> int | None:
    return None if ns is None else ns // 1000


def _responses(row: PdoRow, state: PdoState) -> Responses:
    columns = state.responses.columns()
    counts, edges = state.response.histogram()
    return Responses(
        row.bus,
        row.cob_id,
        row.node,
        row.pdo,
        columns["seq"],
        columns["t_ns"],
        columns["response_us"],
        columns["device_low_us"],
        columns["device_high_us"],
        counts,
        edges / 1000,
    )


def _judged(
    table: SyncTable,
    nmt_states: Sequence[NmtStateRow],
    silences: Sequence[Silence],
    commands: Sequence[NmtCommandRow],
    unread: Sequence[Unread],
) -> SyncTable:
    """The table without the holes in which the producer itself may have been off, or unheard."""
    bus = table.row.bus
    off = [
        row
        for row in nmt_states
        if row.bus == bus and row.state in ("LOST", "INITIALISING", "UNKNOWN")
    ]
    mine = [command for command in commands if command.bus == bus]
    period_ns = table.row.period_us.median * 1000 if table.row.period_us else 0.0
    holes = [
        hole
        for hole in table.holes
        if not _explained(hole, off)
        and not _unheard(hole, silences)
        and not held(hole, mine, period_ns)
        and hole.missing > _unread_within(hole, unread)
    ]
    missing = (
        table.row.missing - sum(h.missing for h in table.holes) + sum(h.missing for h in holes)
    )
    return replace(table, row=replace(table.row, missing=missing), holes=holes)


def _explained(hole: SyncHole, off: Sequence[NmtStateRow]) -> bool:
    """Whether a node was off for most of a long hole, or nobody at all was heard: the NMT tells it.

    Only an UNKNOWN that begins within the hole comes from a silence of the whole bus.
    """
    length = hole.end_ns - hole.start_ns
    return length >= LONG_HOLE_NS and any(
        2 * (min(row.end_ns, hole.end_ns) - max(row.start_ns, hole.start_ns)) > length
        and (row.state != "UNKNOWN" or row.start_ns > hole.start_ns)
        for row in off
    )


def _unread_within(hole: SyncHole, unread: Sequence[Unread]) -> int:
    """How many lines of the log could not be read around a hole."""
    return sum(
        each.lines
        for each in unread
        if each.start_ns <= hole.end_ns and hole.start_ns <= each.end_ns
    )


def _unheard(hole: SyncHole, silences: Sequence[Silence]) -> bool:
    """Whether nothing at all was heard of the bus for most of a hole."""
    length = hole.end_ns - hole.start_ns
    return any(
        2 * (min(each.end_ns, hole.end_ns) - max(each.start_ns, hole.start_ns)) > length
        for each in silences
    )


def _sync_holes(table: SyncTable) -> list[HoleRow]:
    row = table.row
    return [
        HoleRow(row.bus, row.cob_id, "sync", h.start_ns, h.end_ns, h.missing, list(h.seq))
        for h in table.holes[:MAX_HOLES]
    ]


def _pdo_holes(row: PdoRow, missed: MissedList, step_ns: float) -> list[HoleRow]:
    """Missed moments that follow one another, joined."""
    if not len(missed.t_ns):
        return []
    apart = np.diff(missed.t_ns)
    cuts = np.flatnonzero((apart > 1.5 * step_ns) | (apart < 0)) + 1
    edges = [0, *cuts[: MAX_HOLES - 1].tolist(), len(missed.t_ns)]
    return [_hole(row, missed, step_ns, a, b) for a, b in pairwise(edges)]


def _hole(row: PdoRow, missed: MissedList, step_ns: float, first: int, stop: int) -> HoleRow:
    t_ns: NDArray[np.int64] = missed.t_ns
    end_ns = int(t_ns[stop - 1]) + round(step_ns)
    evidence = sorted(set(missed.seq[first : min(stop, first + MAX_EVIDENCE)].tolist()))
    return HoleRow(row.bus, row.cob_id, "pdo", int(t_ns[first]), end_ns, stop - first, evidence)
