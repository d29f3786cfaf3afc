"""How full each bus is, in words for the text and HTML views alike."""

from syncline_analyzer.results import Analysis, BusLoadRow
from syncline_analyzer.views.services import Listing
from syncline_analyzer.views.words import Clock, duration, number
from syncline_schemas.wording import counted


def load_listing(analysis: Analysis, clock: Clock) -> Listing:
    """One line per bus: its bit rate and who says so, mean load and peaks with their moments."""
    heads = [
        "bus", ">bit rate", ">mean", ">peak of 1 s", ">of 100 ms", ">of 10 ms", ">longest busy",
        ">frames/s",
    ]  # fmt: skip
    return Listing("Bus load", heads, [_line(row, clock) for row in analysis.bus_load])


def bit_rate(row: BusLoadRow) -> str:
    """The bit rate of a bus as far as it is known, with its source where it is not told.

    >>> bit_rate(BusLoadRow("can0", 250_000, 30.0, 40.0, 900.0, "estimated", "high", 250_000))
    '250 kbit/s (estimated)'
    >>> bit_rate(BusLoadRow("can0", None, None, None, 9.0, bitrate_estimate=500_000))
    'not known (500 kbit/s?)'
    """
    if row.bitrate is None:
        guess = f" ({row.bitrate_estimate / 1000:g} kbit/s?)" if row.bitrate_estimate else ""
        return f"not known{guess}"
    data = f" + {row.data_bitrate / 1000:g}" if row.data_bitrate else ""
    mark = " (estimated)" if row.bitrate_source == "estimated" else ""
    return f"{row.bitrate / 1000:g}{data} kbit/s{mark}"


def _line(row: BusLoadRow, clock: Clock) -> list[str]:
    busy = "-"
    if row.longest_busy_us is not None and row.longest_busy_frames is not None:
        lasts = duration(round(1000 * row.longest_busy_us))
        frames = counted(row.longest_busy_frames, "frame")
        busy = _at(f"{lasts}, {frames}", row.longest_busy_ns, clock)
    return [
        row.bus,
        bit_rate(row),
        _mean(row),
        _at(number(row.peak_percent, "%", 3), row.peak_ns, clock),
        _at(number(row.peak_100ms_percent, "%", 3), row.peak_100ms_ns, clock),
        _at(number(row.burst_percent, "%", 3), row.burst_ns, clock),
        busy,
        number(row.frames_per_s),
    ]


def _mean(row: BusLoadRow) -> str:
    """Mean load, also of what was heard where the bus was silent for a part of the time."""
    mean = number(row.mean_percent, "%", 3)
    if not row.silent_ns or row.heard_percent is None:
        return mean
    return f"{mean} ({number(row.heard_percent, '%', 3)} without {duration(row.silent_ns)} unheard)"


def _at(figure: str, t_ns: int | None, clock: Clock) -> str:
    # What begins with the first frame begins before its stamp, which is taken at its end.
    return figure if t_ns is None else f"{figure} at {clock.short(max(t_ns, clock.first_ns))}"
