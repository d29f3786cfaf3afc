"""What figures of timing rest on, said beside them: the step of the stamps and the bit rate."""

from collections.abc import Iterator

from syncline_analyzer.results import Analysis, BusLoadRow, Jitter, Quantiles
from syncline_analyzer.views.load import bit_rate
from syncline_analyzer.views.words import duration, number

_SOURCES = {
    "bus-description": "by the bus description",
    "recorded": "as recorded",
    "command-line": "as given",
}
_CONFIDENT = {"high": "with high confidence", "low": "with low confidence"}


def estimated_buses(analysis: Analysis) -> set[str]:
    """Buses whose bit rate nobody told: load, device and waiting times rest on an estimate."""
    return {row.bus for row in analysis.bus_load if row.bitrate_source == "estimated"}


def basis_lines(analysis: Analysis) -> Iterator[str]:
    """One sentence on the stamps, and one on the bit rate of each bus."""
    if analysis.capture.time_base == "none" or not analysis.capture.frames:
        return
    step = duration(analysis.capture.resolution_ns)
    yield f'The stamps have steps of {step}; a spread that they cannot show is written "< {step}".'
    if error := _quantile_error(analysis):
        yield f"Medians and percentiles are within {error:.2g} %; minima and maxima are exact."
    for row in analysis.bus_load:
        yield f"{row.bus}: {_rate(row)}"


def _quantile_error(analysis: Analysis) -> float:
    """Largest relative error of a quantile [%]; 0 while all of them are exact."""
    errors = [row.quantile_error for row in analysis.sync]
    errors += [row.quantile_error for row in analysis.pdos]
    errors += [row.quantile_error for row in analysis.error_control_periods]
    return 100 * max(errors, default=0.0)


def _rate(row: BusLoadRow) -> str:
    if row.bitrate is None:
        return (
            f"bit rate {bit_rate(row)}, so there is no load in percent, no device time and no "
            "waiting time."
        )
    if row.bitrate_source != "estimated":
        by = f" {_SOURCES[row.bitrate_source]}" if row.bitrate_source else ""
        return f"bit rate {bit_rate(row)}{by}."
    sure = f" {_CONFIDENT[row.bitrate_confidence]}" if row.bitrate_confidence in _CONFIDENT else ""
    told = bit_rate(row).removesuffix(" (estimated)")
    return (
        f"bit rate {told}, estimated{sure} from the spacing of the frames: load, device and "
        "waiting times rest on it."
    )


def fine(value_us: float | None, resolution_us: float) -> str:
    """A spread in us, or "< 1 ms" where the stamps are too coarse to show it.

    >>> fine(71.5, 1.0), fine(None, 1000.0)
    ('71.5', '< 1 ms')
    """
    return number(value_us, digits=3) if value_us is not None else _below(resolution_us)


def jitter_words(jitter: Jitter | None, resolution_us: float) -> str:
    """Standard deviation, and 99th less 1st percentile, in one cell.

    >>> jitter_words(Jitter(None, 2000.0, 3000.0), 1000.0)
    '< 1 ms/2000'
    >>> jitter_words(Jitter(None, None, 1000.0), 1000.0), jitter_words(None, 1000.0)
    ('< 1 ms', '-')
    """
    if jitter is None:
        return "-"
    if jitter.std is None and jitter.p99_p1 is None:
        return _below(resolution_us)
    return f"{fine(jitter.std, resolution_us)}/{fine(jitter.p99_p1, resolution_us)}"


def deviation(value_us: float | None, expected_us: int | None, resolution_us: float) -> str:
    """How far the median lies off what was told; "-" where nothing was.

    >>> deviation(10.3, 515_000, 0.001), deviation(None, 515_000, 1000.0), deviation(None, None, 1.0)
    ('+10.3', '< 1 ms', '-')
    """
    if expected_us is None:
        return "-"
    sign = "+" if value_us is not None and value_us > 0 else ""
    return f"{sign}{fine(value_us, resolution_us)}"


def stepped(value: float, resolution: float, digits: int = 3) -> str:
    """A time as exact as the stamps: in whole steps of theirs, "<1000" below one.

    >>> stepped(1490.0, 1000.0), stepped(0.0, 1000.0), stepped(33.17, 0.001)
    ('1000', '<1000', '33.2')
    """
    if resolution < _FINE * max(abs(value), 1.0):
        return number(value, digits=digits)
    steps = round(value / resolution)
    return number(steps * resolution, digits=digits) if steps else f"<{number(resolution)}"


def trio(quantiles: Quantiles | None, resolution_us: float) -> str:
    """Minimum, median and maximum in one cell, as exact as the stamps.

    >>> trio(Quantiles(9990.0, 10000.0, 10010.0, 10020.0), 0.001)
    '9990/10000/10020'
    """
    if quantiles is None:
        return "-"
    parts = (quantiles.min, quantiles.median, quantiles.max)
    return "/".join(stepped(part, resolution_us) for part in parts)


def trio_ms(quantiles: Quantiles | None, resolution_us: float) -> str:
    """The same in ms.

    >>> trio_ms(Quantiles(9990.0, 10000.0, 10010.0, 10020.0), 0.001)
    '9.99/10/10.02'
    """
    if quantiles is None:
        return "-"
    parts = (quantiles.min, quantiles.median, quantiles.max)
    return "/".join(stepped(part / 1000, resolution_us / 1000, 4) for part in parts)


def quartet(quantiles: Quantiles | None, resolution_us: float) -> str:
    """Minimum, median, 99th percentile and maximum in one cell, as exact as the stamps.

    >>> quartet(Quantiles(9990.0, 10000.0, 10010.0, 10020.0), 1000.0)
    '10000/10000/10000/10000'
    """
    if quantiles is None:
        return "-"
    parts = (quantiles.min, quantiles.median, quantiles.p99, quantiles.max)
    return "/".join(stepped(part, resolution_us) for part in parts)


def usual_and_most(quantiles: Quantiles | None, resolution_us: float) -> str:
    """Median and maximum in one cell, as exact as the stamps.

    >>> usual_and_most(Quantiles(9990.0, 10000.0, 10010.0, 10020.0), 1.0)
    '10000/10020'
    """
    if quantiles is None:
        return "-"
    return "/".join(stepped(part, resolution_us) for part in (quantiles.median, quantiles.max))


_FINE = 0.0005
"""Steps below this part of a figure are finer than the digits that are written."""


def _below(resolution_us: float) -> str:
    return f"< {duration(round(resolution_us * 1000))}" if resolution_us else "-"
