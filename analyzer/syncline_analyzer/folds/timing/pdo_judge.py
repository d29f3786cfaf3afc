"""What each PDO was due at the end of the capture: missed frames, pauses and its row."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.operational import operational, unstepped
from syncline_analyzer.folds.timing.pause import pauses
from syncline_analyzer.folds.timing.pdo_rows import pdo_holes, pdo_row, responses
from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.pdo_statistics import with_phase, with_statistics, worst
from syncline_analyzer.folds.timing.request_answers import ANSWER_NS
from syncline_analyzer.folds.timing.rhythm import MissedList, Operational
from syncline_analyzer.folds.timing.sending import Sending, by_chance, due_step_ns, sending
from syncline_analyzer.folds.timing.silence import Silence, SilenceFold, within_silence
from syncline_analyzer.folds.timing.sync import SyncFold
from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_analyzer.folds.timing.waiting_fold import WaitingFold
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_analyzer.results import NmtStateRow, PdoPauseRow, PdoRow
from syncline_schemas.devices import quirks
from syncline_schemas.records import dataclass

START_NS = 10_000_000
"""Time that a node has to act on a start command."""
ENTERED_NS = 500_000_000
"""Time that a node has to send a cyclic PDO for the first time after it became OPERATIONAL."""
BY_TIMER = "its event timer (180xh:5)"
"""What says when a PDO is due that its event timer sends."""
_NOTHING = MissedList(np.zeros(0, np.int64), np.zeros(0, np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class PdoJudge:
    """Makes the rows of PDOs from what was counted, and from the states of their nodes.

    A PDO is missed only while `nmt_states` say OPERATIONAL (None: always), and never in what is
    `unread`.
    """

    context: Context
    bindings: PdoBindings
    sync: SyncFold
    silence: SilenceFold
    waiting: WaitingFold
    gap_starts: set[int]
    nmt_states: Sequence[NmtStateRow] | None
    unread: Sequence[Silence]
    end_ns: int

    def add(self, tables: TimingTables, bus: int, can_id: int, state: PdoState) -> None:
        """Append the rows of one PDO."""
        sync_ns = self.sync.median_ns(bus, state.sync_cob_id)
        how = sending(state, sync_ns, self.context)
        missed = self._missed(bus, state, how, sync_ns)
        silences = [
            *self.silence.of(bus),
            *self._unsure(bus, state),
            *self.unread,
        ]
        if silences:
            step_ns = due_step_ns(state, how, sync_ns)
            after_ns = step_ns if how.every > 1 else 0.0
            missed = missed.without(within_silence(missed.t_ns, silences, step_ns, after_ns))
        name = self.context.bus_name(bus)
        resolution_ns = self.context.resolution_ns
        told = pdo_row(name, can_id, state, how, missed, resolution_ns)
        counter = self.bindings.repeat_counter(state.owner) if state.owner else None
        overdue = self._overdue(bus, state, silences)
        unanswered = self._unanswered(bus, state, silences)
        counter_end = self.sync.counter_end(bus, state.sync_cob_id) or 0
        told = with_phase(told, state, how, counter_end)
        row = with_statistics(told, state, how, overdue, unanswered, counter, resolution_ns)
        if self.context.contradicted(name):
            row = replace(row, device_us_low=None, device_us_high=None)
        elif how.synchronous and state.response.count:
            row = self.waiting.judge(tables, bus, can_id, row, missed.seq)
        if not state.frames:
            tables.unsent_pdos.append(row)
            return
        tables.pdos.append(row)
        tables.worst.extend(worst(row, state))
        tables.pdo_pauses.extend(self._pauses(bus, row, state, how, missed))
        filled = self.sync.filled(bus, state.sync_cob_id) if how.synchronous else []
        tables.holes.extend(pdo_holes(row, missed, due_step_ns(state, how, sync_ns), filled))
        if how.synchronous and state.response.count:
            tables.responses.append(responses(row, state))

    def _unsure(self, bus: int, state: PdoState) -> list[Silence]:
        """Times that the stamps go through twice, unless the node was OPERATIONAL all along.

        One that became so before the clock was set back was it the second time, too; and one that
        is so at the end was it the first time.
        """
        name = self.context.bus_name(bus)
        if state.owner is None or self.nmt_states is None:
            return []
        own = (name, state.owner.node)
        rows = unstepped([row for row in self.nmt_states if (row.bus, row.node) == own])
        whole = [(row, row is rows[-1]) for row in rows if row.state == "OPERATIONAL"]
        return [
            back
            for back in self.silence.backs(bus)
            if not any(
                (back.end_ns <= row.end_ns or last)
                and (row.start_ns <= back.start_ns or _proven_before(row, back))
                for row, last in whole
            )
        ]

    def _pauses(
        self,
        bus: int,
        row: PdoRow,
        state: PdoState,
        how: Sending,
        missed: MissedList,
    ) -> list[PdoPauseRow]:
        """Long stretches without a PDO that has a rhythm, and whose node said OPERATIONAL."""
        owner = state.owner
        counter = self.bindings.repeat_counter(owner) if owner else None
        if owner is None or self.nmt_states is None or (counter is not None and counter.value):
            return []
        stretches = operational(self.nmt_states, row.bus, owner.node, self.gap_starts)
        if not stretches or not self.context.timed:
            return []
        rhythm = self._rhythm(bus, state, how)
        if rhythm is None:
            return []
        missed_ns = missed.t_ns if how.synchronous else None
        silences = self.silence.of(bus)
        found = pauses(row, state, rhythm, stretches, silences, self.end_ns, missed_ns)
        if how.synchronous or not state.may_stand_still(counter):
            return found
        return [pause for pause in found if not pause.resumed]

    def _rhythm(self, bus: int, state: PdoState, how: Sending) -> tuple[float, str] | None:
        """Time between due frames [ns] and what says so; None where a change may send them."""
        if state.off or state.polled():
            return None
        if how.synchronous:
            sync_ns = self.sync.median_ns(bus, state.sync_cob_id)
            known = state.told_type() is not None or state.rhythm.every() is not None
            step_ns = sync_ns * how.every
            return (step_ns, "its SYNC") if known and how.type != 0 and step_ns else None
        timer_ns = state.told_timer_ns()
        if timer_ns:
            return timer_ns, BY_TIMER
        kept_ns = state.kept_timer_ns()
        if kept_ns and state.owner and how.type in self._timer_types(bus, state.owner.node):
            return kept_ns, BY_TIMER
        if how.source.startswith("inferred: cyclic") and state.sent_by_timer():
            return state.period.quantile(0.5), "the period that it kept before"
        return None

    def _timer_types(self, bus: int, node: int) -> tuple[int, ...]:
        return quirks(self.context.shadow.device(bus, node)).event_timer_types

    def _missed(self, bus: int, state: PdoState, how: Sending, sync_ns: float) -> MissedList:
        counter = self.bindings.repeat_counter(state.owner) if state.owner else None
        if state.polled() or (counter is not None and counter.value):
            return _NOTHING
        intervals = self._intervals(bus, state)
        if how.synchronous:
            if by_chance(state, how, self.context):
                return _NOTHING
            found = state.rhythm.missed.within(intervals, sync_ns, START_NS)
            return found.without(state.slips.within(found.t_ns))
        timer_ns = state.told_timer_ns()
        state.overdue.flush()
        if not timer_ns:
            return _NOTHING
        return state.overdue.missed.within(intervals, timer_ns, timer_ns, ENTERED_NS)

    def _overdue(self, bus: int, state: PdoState, silences: Sequence[Silence]) -> MissedList:
        """Deadlines of an RPDO (140xh:5) that passed while its node was OPERATIONAL."""
        deadline_ns = state.told_deadline_ns()
        if deadline_ns is None:
            return _NOTHING
        found = state.past_deadline.within(self._intervals(bus, state), deadline_ns, deadline_ns)
        if not silences:
            return found
        return found.without(within_silence(found.t_ns, silences, deadline_ns, 0.0))

    def _unanswered(self, bus: int, state: PdoState, silences: Sequence[Silence]) -> MissedList:
        """Requests that the node did not answer while it was OPERATIONAL."""
        intervals = self._intervals(bus, state)
        found = state.request_answers.missed.within(intervals, ANSWER_NS, START_NS)
        return found.without(within_silence(found.t_ns, silences, ANSWER_NS, 0.0))

    def _intervals(self, bus: int, state: PdoState) -> list[Operational] | None:
        """When the PDO's node was OPERATIONAL; None where nothing is known of it."""
        if self.nmt_states is None or state.owner is None or not self.context.timed:
            return None
        name = self.context.bus_name(bus)
        return operational(self.nmt_states, name, state.owner.node, self.gap_starts)


def _proven_before(row: NmtStateRow, back: Silence) -> bool:
    """Whether the node was in a state, and past its first answers, before the clock was set back."""
    early = row.start_ns + START_NS <= back.end_ns
    return early and row.evidence is not None and row.evidence < back.end_seq
