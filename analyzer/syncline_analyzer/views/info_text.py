"""What `syncline info` prints of one capture."""

from collections.abc import Iterator

from syncline_analyzer.info import CaptureInfo
from syncline_analyzer.views.words import Clock, capture_time, duration, printable, told_stretches
from syncline_schemas.capture.adapter_fit import AdapterFit

MAX_ROWS = 5


def info_text(info: CaptureInfo) -> str:
    """One capture in a few lines: its name, then one fact a line."""
    facts = [(name, printable(told)) for name, told in _facts(info)]
    width = max(len(name) for name, _ in facts)
    lines = [f"  {name:<{width}}  {told}" for name, told in facts]
    return "\n".join([printable(str(info.path)), *lines])


def _facts(info: CaptureInfo) -> Iterator[tuple[str, str]]:
    yield "format", f"{info.format}, {info.size_bytes:,} bytes"
    yield "whole", "yes" if info.whole else f"NO: {info.damage}"
    yield "frames", _frames(info)
    yield from _times(info)
    for bus, frames in info.frames_by_bus.items():
        rate = info.bitrates.get(bus)
        count = f"{frames:,} frame{'s'[: frames != 1]}"
        yield f"bus {bus}", count + (f", {rate / 1000:g} kbit/s" if rate else "")
    for bus, fit in info.adapter_fits.items():
        yield f"clock {bus}", _fit(fit)
    for gap in info.gaps[:MAX_ROWS]:
        yield "blind", f"for {duration(gap.end_ns - gap.start_ns)}: {gap.reason}"
    if info.gap_count > MAX_ROWS:
        yield "blind", f"{info.gap_count} stretches in all"
    for mark in info.marks[:MAX_ROWS]:
        begin_ns = info.first_ns or mark.t_ns
        yield "marked", f"{capture_time(mark.t_ns - begin_ns)}: {mark.reason}"
    yield from _contents(info)


def _fit(fit: AdapterFit) -> str:
    drift = f"{abs(fit.rate_ppb) / 1000:.1f} ppm {'slow' if fit.rate_ppb > 0 else 'fast'}"
    worst = f", {duration(fit.worst_residual_ns)} at worst" * (
        fit.worst_residual_ns > fit.residual_ns
    )
    return f"of the adapter, {drift}, onto UTC to {duration(fit.residual_ns)}{worst}"


def _frames(info: CaptureInfo) -> str:
    kinds = {
        "data": info.data_frames,
        "remote": info.remote_frames,
        "error": info.error_frames,
        "29-bit": info.extended_frames,
        "FD": info.fd_frames,
    }
    told = ", ".join(f"{count:,} {kind}" for kind, count in kinds.items() if count)
    return f"{info.frames:,}" + (f": {told}" if told else "")


def _times(info: CaptureInfo) -> Iterator[tuple[str, str]]:
    if info.first_ns is None or info.last_ns is None:
        yield "times", "none"
        return
    clock = Clock(info.first_ns, info.time_base == "utc", True)
    if info.stretches:
        yield "times", f"{told_stretches(clock, info.stretches)} ({duration(info.duration_ns)})"
    else:
        yield "from", clock.full(info.first_ns)
        yield "to", f"{clock.full(info.last_ns)} ({duration(info.duration_ns)})"
    whose = f", {info.clock} clock" if info.clock != "unknown" else ""
    yield "stamps", f"resolution {duration(info.resolution_ns)}{whose}"
    if info.time_base == "relative":
        yield "date", "none: times count from the first frame"
    if info.steps_back:
        count = "1 stamp is" if info.steps_back == 1 else f"{info.steps_back:,} stamps are"
        yield "steps back", f"{count} earlier than the one before"


def _contents(info: CaptureInfo) -> Iterator[tuple[str, str]]:
    if info.has_description:
        yield "attached", "bus description"
    for name in info.eds_files:
        yield "attached", name
    if info.unparsed_count:
        yield "unread lines", f"{info.unparsed_count:,}"
    for number, line in info.unparsed_lines[:MAX_ROWS]:
        yield f"line {number}", line
    for note in info.notes:
        yield "note", note
