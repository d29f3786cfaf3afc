"""Figures of a PDO beyond what it missed: jitter, phase, repeats, requests, timers."""

from dataclasses import replace

from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.rhythm import MissedList
from syncline_analyzer.folds.timing.sending import Sending
from syncline_analyzer.results import PdoRow, WorstRow
from syncline_analyzer.shadow import Known

MAX_EVIDENCE = 20


def with_statistics(
    row: PdoRow,
    state: PdoState,
    how: Sending,
    overdue: MissedList,
    unanswered: MissedList,
    counter: Known | None,
    resolution_ns: int,
) -> PdoRow:
    """The row with them.

    Args:
        row: what the PDO was told to be, and missed.
        state: what was counted.
        how: how it is sent.
        overdue: of an RPDO, the moments past its deadline.
        unanswered: requests without an answer.
        counter: 280xh of the node.
        resolution_ns: step of the stamps.
    """
    period = state.period
    settings = state.transmission
    timer_ns, deadline_ns = state.told_timer_ns(), state.told_deadline_ns()
    response = state.response if how.synchronous else None
    return replace(
        row,
        jitter_us=response.jitter(1000, resolution_ns) if response else None,
        period_jitter_us=state.periods.jitter_us(resolution_ns)
        if how.synchronous or timer_ns or state.cyclic()
        else None,
        answered=state.answered if how.synchronous else 0,
        repeat_counter=counter.value if counter and isinstance(counter.value, int) else None,
        repeat_source=counter.source if counter else None,
        repeats=state.repeats.count,
        longest_repeat=state.repeats.longest,
        asked=state.asked,
        asked_answered=state.request_answers.answered,
        unanswered=unanswered.count,
        unanswered_seq=unanswered.seq[:MAX_EVIDENCE].tolist(),
        unanswered_first_ns=int(unanswered.t_ns[0]) if len(unanswered.t_ns) else None,
        unanswered_last_ns=int(unanswered.t_ns[-1]) if len(unanswered.t_ns) else None,
        answer_us=state.request_answers.time.quantiles(1000),
        timer_source=_source(settings.event_timer_ms if settings else None, timer_ns),
        timer_deviation_us=period.off(timer_ns, 1000, resolution_ns) if timer_ns else None,
        inhibit_source=_source(settings.inhibit_100us if settings else None, row.inhibit_us),
        deadline_us=deadline_ns // 1000 if deadline_ns else None,
        overdue=overdue.count,
        overdue_seq=overdue.seq[:MAX_EVIDENCE].tolist(),
        overdue_first_ns=int(overdue.t_ns[0]) if len(overdue.t_ns) else None,
        overdue_last_ns=int(overdue.t_ns[-1]) if len(overdue.t_ns) else None,
        resolution_us=resolution_ns / 1000,
        quantile_error=max(period.relative_error, state.response.relative_error),
    )


def worst(row: PdoRow, state: PdoState) -> list[WorstRow]:
    """Its longest and shortest periods, and its slowest responses and answers."""
    place = row.bus, row.cob_id, row.node
    found = state.periods.extremes.rows(*place, "period")
    if row.response_us is not None:
        found += state.slowest.rows(*place, "response")
    return found + state.request_answers.slowest.rows(*place, "answer")


def with_phase(row: PdoRow, state: PdoState, how: Sending, counter_end: int) -> PdoRow:
    """n of a synchronous PDO and which of n SYNCs it answers; none for type 0, sent on change.

    `counter_end` is the highest value of the SYNC counter (1019h), 0 without one.
    """
    if not how.synchronous or how.type == 0:
        return row
    usual = state.phase.usual(how.every, counter_end) if how.every > 1 else None
    if usual is None:
        return replace(row, every=how.every)
    return replace(
        row,
        every=how.every,
        phase=usual.remainder,
        phase_basis=usual.basis,
        phase_share=usual.share,
        phase_changes=state.rhythm.strays(how.every),
    )


def _source(known: Known | None, used: int | None) -> str | None:
    """Where a setting that is used comes from."""
    return known.source if known is not None and used is not None else None
