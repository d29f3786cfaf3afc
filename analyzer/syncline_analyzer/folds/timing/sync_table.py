"""Rows of a SYNC identifier."""

from dataclasses import field

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.sync_settings import producers, told_overflow, told_period
from syncline_analyzer.folds.timing.sync_state import SyncHole, SyncState
from syncline_analyzer.results import (
    ClockStepRow,
    Series,
    SyncDoubleRow,
    SyncJitterRow,
    SyncRow,
    WorstRow,
)
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class SyncTable:
    """A SYNC identifier: its row, the holes in it, its period over time and stretches of jitter."""

    row: SyncRow
    holes: list[SyncHole]
    series: Series | None
    jitter: list[SyncJitterRow]
    doubles: list[SyncDoubleRow] = field(default_factory=list)
    worst: list[WorstRow] = field(default_factory=list)
    steps: list[ClockStepRow] = field(default_factory=list)


def sync_table(context: Context, bus: int, cob_id: int, state: SyncState) -> SyncTable:
    """The table of one of them."""
    name = context.bus_name(bus)
    columns = state.over_time.columns()
    series = None
    if columns:
        counts, edges_ns = state.period.histogram()
        title = f"SYNC {cob_id:03X}h period"
        series = Series(
            name, title, "us", columns["t_ns"], columns["value"], counts, edges_ns / 1000
        )
    doubles = state.double.rows(name, cob_id)
    jitter = [
        each
        for each in state.unsteady.rows(name, cob_id)
        if not any(_mostly_within(each, double) for double in doubles)
    ]
    row = _row(context, bus, cob_id, state, doubles)
    worst = state.periods.extremes.rows(name, cob_id, None, "sync period")
    return SyncTable(row, state.holes, series, jitter, doubles, worst, state.steps)


def _row(
    context: Context, bus: int, cob_id: int, state: SyncState, doubles: list[SyncDoubleRow]
) -> SyncRow:
    shadow, step_ns = context.shadow, context.resolution_ns
    expected = told_period(shadow, bus, cob_id)
    overflow = told_overflow(shadow, bus, cob_id)
    drift, hidden = state.pace.drift_ppm(step_ns)
    return SyncRow(
        bus=context.bus_name(bus),
        cob_id=cob_id,
        count=state.count,
        period_us=state.period.quantiles(1000),
        missing=state.missing,
        counter_jumps=state.counter.jumps,
        backlog=state.bundled,
        last_ns=state.last_ns if context.timed else None,
        last_seq=state.last_seq if state.last_ns is not None else None,
        jitter_us=state.periods.jitter_us(step_ns),
        mean_us=state.pace.mean_us(),
        expected_us=expected[0] if expected else None,
        expected_source=expected[1] if expected else None,
        deviation_us=state.period.off(expected[0] * 1000, 1000, step_ns) if expected else None,
        drift_ppm=drift,
        drift_resolution_ppm=hidden,
        doubled=state.doubled.count + sum(double.pairs for double in doubles),
        doubled_seq=state.doubled.seq,
        producers=2 if doubles else 1,
        producer_nodes=producers(shadow, bus, cob_id),
        counter_max=state.counter.highest or None,
        counter_wraps=state.counter.wraps,
        counter_overflow=overflow[0] if overflow else None,
        counter_source=overflow[1] if overflow else None,
        resolution_us=step_ns / 1000,
        quantile_error=state.period.relative_error,
    )


def _mostly_within(jitter: SyncJitterRow, double: SyncDoubleRow) -> bool:
    """Whether a stretch of jitter is one of two producers: two rhythms are no jitter of either."""
    both_ns = min(jitter.end_ns, double.end_ns) - max(jitter.start_ns, double.start_ns)
    return 2 * both_ns > jitter.end_ns - jitter.start_ns
