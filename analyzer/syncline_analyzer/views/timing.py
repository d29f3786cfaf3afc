"""Jitter, settings and worst cases of SYNC, PDOs and error control, for text and HTML alike."""

from collections.abc import Iterator

from syncline_analyzer.results import Analysis, ErrorControlRow, Jitter, PdoRow, SyncRow
from syncline_analyzer.views.services import Listing
from syncline_analyzer.views.words import duration, hex_code, names_of, node_label, number, spread


def timing_listings(analysis: Analysis) -> Iterator[Listing]:
    """Jitter and what is held against the settings; figures that the stamps hide say so."""
    rows = [_sync(row) for row in analysis.sync if row.period_us]
    rows += [_pdo(row) for row in analysis.pdos if _told(row)]
    if rows:
        heads = ["bus", "COB-ID", "of", ">std", ">p99 - p1", ">max - min", "held against"]
        step = duration(analysis.capture.resolution_ns)
        yield Listing(f"Jitter of SYNC and PDOs (us; stamps in steps of {step})", heads, rows)
    if analysis.error_control_periods:
        names = names_of(analysis.nodes)
        heads = ["bus", "node", "what", ">count", ">period (ms)", ">jitter (us)", "held against"]
        lines = [
            _error_control(row, names.get((row.bus, row.node), node_label(row.node)))
            for row in analysis.error_control_periods
        ]
        yield Listing("Heartbeats and guarding (min / median / max)", heads, lines)


def figure(value: float | None, resolution_us: float) -> str:
    """A spread [us], or what the stamps can show at best.

    >>> figure(12.5, 1.0), figure(None, 1000.0)
    ('12.5', '< 1000')
    """
    return f"< {number(resolution_us)}" if value is None else number(value)


def _told(row: PdoRow) -> bool:
    return bool(row.jitter_us or row.period_jitter_us or row.asked or row.deadline_us)


def _sync(row: SyncRow) -> list[str]:
    against = []
    if row.expected_us is not None:
        off = figure(row.deviation_us, row.resolution_us)
        against.append(f"{row.expected_us} us ({row.expected_source}): {off} us off")
    if row.drift_ppm is not None:
        against.append(f"drift {number(row.drift_ppm, 'ppm', 3)}")
    elif row.drift_resolution_ppm is not None and row.deviation_us is None:
        against.append(f"drift < {number(row.drift_resolution_ppm, 'ppm', 2)}")
    if row.counter_max is not None:
        end = f" (1019h: {row.counter_overflow})" if row.counter_overflow else ""
        against.append(f"counter to {row.counter_max}{end}")
    if row.doubled:
        against.append(f"{row.doubled} doubled")
    return [
        row.bus,
        hex_code(row.cob_id, 3),
        "SYNC period",
        *_jitter(row.jitter_us, row.resolution_us),
        ", ".join(against),
    ]


def _pdo(row: PdoRow) -> list[str]:
    of = "response" if row.jitter_us else "period" if row.period_jitter_us else "-"
    return [
        row.bus,
        hex_code(row.cob_id, 3),
        of,
        *_jitter(row.jitter_us or row.period_jitter_us, row.resolution_us),
        ", ".join(_settings(row)),
    ]


def _settings(row: PdoRow) -> Iterator[str]:
    if row.phase is not None and row.every is not None and row.phase_basis is not None:
        yield f"SYNC {row.phase} of {row.every} (by {row.phase_basis})"
    if row.event_timer_us:
        off = figure(row.timer_deviation_us, row.resolution_us)
        yield f"event timer {row.event_timer_us} us: {off} us off"
    if row.inhibit_us:
        yield f"inhibit time {row.inhibit_us} us: {row.too_soon} too soon"
    if row.repeat_counter:
        yield f"repeat counter {row.repeat_counter}"
    if row.asked:
        yield f"{row.asked_answered} of {row.asked} requests answered in {spread(row.answer_us)} us"
    if row.deadline_us:
        yield f"deadline {row.deadline_us} us: {row.overdue} past it"


def _jitter(jitter: Jitter | None, resolution_us: float) -> list[str]:
    if jitter is None:
        return ["-"] * 3
    return [figure(each, resolution_us) for each in (jitter.std, jitter.p99_p1, jitter.max_min)]


def _error_control(row: ErrorControlRow, label: str) -> list[str]:
    against = []
    if row.expected_us is not None:
        off = figure(row.deviation_us, row.resolution_us)
        setting = "1017h" if row.kind == "heartbeat" else "100Ch"
        against.append(
            f"{number(row.expected_us / 1000)} ms ({setting}, {row.expected_source}): {off} us off"
        )
    if row.missing:
        against.append(f"{row.missing} {'missing' if row.kind == 'heartbeat' else 'not answered'}")
    if row.answer_us is not None:
        against.append(f"answered in {spread(row.answer_us)} us")
    period = row.period_us
    lengths = (period.min, period.median, period.max) if period else ()
    return [
        row.bus,
        label,
        row.kind,
        str(row.count),
        "/".join(number(each / 1000) for each in lengths) or "-",
        figure(row.jitter_us.std, row.resolution_us) if row.jitter_us else "-",
        ", ".join(against),
    ]
