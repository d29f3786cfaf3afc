"""Ticks of the report's axes: round times and round values, written as short as they can be."""

import math

from syncline_analyzer.views.words import capture_time

_TIME_STEPS_NS = (
    *(k * 10**power for power in range(3, 9) for k in (1, 2, 5)),
    *(round(s * 1e9) for s in (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800)),
    *(hours * 3_600_000_000_000 for hours in (1, 2, 3, 6, 12, 24, 48, 120, 240)),
)
_SECOND_NS = 1_000_000_000
_QUARTER_DEG = 90.0
_WHOLE_CIRCLE_DEG = 200.0


def time_ticks(start_ns: int, span_ns: int, most: int) -> list[tuple[int, str]]:
    """At most so many round moments of capture time within a stretch, with their labels.

    >>> time_ticks(0, 120 * 10**9, 5)
    [(0, '0:00'), (30000000000, '0:30'), (60000000000, '1:00'), (90000000000, '1:30'), (120000000000, '2:00')]
    """
    step = next((s for s in _TIME_STEPS_NS if span_ns // s < most), _TIME_STEPS_NS[-1])
    first = -(-start_ns // step) * step
    return [(t, _time_label(t, step)) for t in range(first, start_ns + span_ns + 1, step)][:most]


def _time_label(t_ns: int, step_ns: int) -> str:
    text = capture_time(t_ns)
    if step_ns >= _SECOND_NS:
        return text.removesuffix(".000")
    if step_ns >= 1_000_000:
        return text
    sign = "-" if t_ns < 0 else ""
    whole, rest = divmod(abs(t_ns), _SECOND_NS)
    return f"{sign}{capture_time(whole * _SECOND_NS).removesuffix('.000')}.{rest // 1000:06}"


def value_ticks(low: float, high: float, most: int, unit: str = "") -> list[tuple[float, str]]:
    """At most so many round values within limits, with their labels; quarters of a full circle.

    >>> value_ticks(-3.0, 11.5, 4), value_ticks(0.0, 414.0, 5, "deg")
    ([(0.0, '0'), (5.0, '5'), (10.0, '10')], [(0.0, '0'), (90.0, '90'), (180.0, '180'), (270.0, '270'), (360.0, '360')])
    """
    span = high - low
    if not (math.isfinite(span) and span > 0):
        return []
    step = _QUARTER_DEG if unit == "deg" and span > _WHOLE_CIRCLE_DEG else _step(span, most)
    while math.floor(high / step) - math.ceil(low / step) + 1 > most:
        step *= 2
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    numbers = range(math.ceil(low / step), math.floor(high / step) + 1)
    return [(n * step, f"{n * step:.{digits}f}") for n in numbers]


def _step(span: float, most: int) -> float:
    rough = span / most
    power = 10.0 ** math.floor(math.log10(rough))
    return next(k * power for k in (1, 2, 5, 10) if k * power >= rough * (1 - 1e-9))
