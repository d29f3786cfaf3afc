"""Quality of the recording, in the report: what was missed, how good the clock was, what was odd."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.results import Analysis
from syncline_analyzer.views import report_tables as tables
from syncline_analyzer.views.html import Html, element
from syncline_analyzer.views.report_moment import Moments
from syncline_analyzer.views.services import listings
from syncline_analyzer.views.words import duration, extent_words, frame_kinds, number
from syncline_schemas.wording import counted

LONG_SILENCE_NS = 1_000_000_000
"""Silences of the whole bus that the first screen tells; the table has the shorter ones too."""


def quality(analysis: Analysis) -> str:
    """The recording in one phrase, for the first screen."""
    capture = analysis.capture
    if capture.damage:
        return "damaged, read in part"
    told = [_blind(analysis)] if capture.gaps else []
    if lost := sum(gap.lost_frames or 0 for gap in capture.gaps):
        told.append(f"at least {counted(lost, 'frame')} lost")
    if capture.unparsed_lines:
        told.append(f"{counted(capture.unparsed_lines, 'line')} could not be read")
    if capture.error_frames:
        told.append(counted(capture.error_frames, "error frame"))
    silences = (row.end_ns - row.start_ns for row in analysis.bus_silences)
    if silent_ns := sum(ns for ns in silences if ns >= LONG_SILENCE_NS):
        told.append(f"nobody heard for {duration(silent_ns)} though heartbeats were due")
    if analysis.clock_steps:
        told.append(f"clock set {counted(len(analysis.clock_steps), 'time')}")
    if capture.stretches:
        told.append(f"clock set back {counted(len(capture.stretches) - 1, 'time')}")
    return ", ".join(told) or "whole, without gaps"


def _blind(analysis: Analysis) -> str:
    """Gaps and how long they last together; where buses share one it is counted once."""
    until, blind_ns = 0, 0
    for start_ns, end_ns in sorted((gap.start_ns, gap.end_ns) for gap in analysis.capture.gaps):
        blind_ns += max(end_ns - max(start_ns, until), 0)
        until = max(until, end_ns)
    told = f"{counted(len(analysis.capture.gaps), 'gap')}"
    if blind_ns and analysis.capture.duration_ns:
        share = 100 * blind_ns / analysis.capture.duration_ns
        told += f", {duration(blind_ns)} blind ({number(share, digits=2)} %)"
    return told


def recording_part(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    """Facts of the capture, then everything that was missed or odd, a table each."""
    yield element("dl", *_facts(analysis, moments), class_="facts")
    yield from _gaps(analysis, moments)
    yield from _clock_steps(analysis, moments)
    yield from _silences(analysis, moments)
    yield from _overloads(analysis, moments)
    yield from _doubled(analysis, moments)
    yield from _marks(analysis, moments)
    for listing in listings(analysis, moments.clock):
        yield from tables.listed_table(listing)


def _facts(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    capture = analysis.capture
    yield from _fact("Files", ", ".join(capture.files))
    yield from _fact("Frames", f"{capture.frames:,}: {frame_kinds(capture)}")
    yield from _fact("Recording", quality(analysis))
    for damage in capture.damage:
        yield from _fact("Damaged, read in part", damage)
    if capture.unparsed_lines:
        lines = f"{capture.unparsed_lines:,} lines of the log could not be read"
        yield from _fact("Not read", lines)
    if moments.clock.timed and capture.frames:
        when, lasts = extent_words(capture, moments.clock), duration(capture.duration_ns)
        yield from _fact("Time", f"{when} ({lasts})")
        yield from _fact("Clock", _clock_words(analysis))
    for note in capture.notes:
        yield from _fact("Note", note)


def _clock_words(analysis: Analysis) -> str:
    capture = analysis.capture
    told = [
        "dates are UTC" if capture.start_utc_ns is not None else "the log has no date",
        f"resolution of the stamps: {duration(capture.resolution_ns)}",
    ]
    if analysis.clock_steps:
        told.append(f"set forward {counted(len(analysis.clock_steps), 'time')}")
    back = sum(row.id == "clock.step_back" for row in analysis.findings)
    told.append("steps back: see the findings" if back else "no step back")
    return "; ".join(told)


def _fact(term: str, told: object) -> Iterator[Html]:
    yield element("dt", term)
    yield element("dd", told)


def _gaps(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    rows: list[Sequence[object]] = [
        (
            gap.bus or "all",
            moments.when(gap.start_ns, gap.end_ns),
            duration(gap.end_ns - gap.start_ns),
            "not known" if gap.lost_frames is None else gap.lost_frames,
            gap.reason,
        )
        for gap in analysis.capture.gaps
    ]
    heads = ["Bus", "Blind", ">Lasts", ">Frames lost", "Reason"]
    yield from tables.limited("Stretches in which the recorder was blind", heads, rows)


def _clock_steps(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    rows: list[Sequence[object]] = [
        (row.bus, moments.when(row.start_ns), duration(row.step_ns), row.witnesses)
        for row in analysis.clock_steps
    ]
    heads = ["Bus", "At", ">Set forward by", ">Identifiers that show it"]
    yield from tables.limited("Steps of the recorder's clock", heads, rows)


def _silences(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    rows: list[Sequence[object]] = [
        (row.bus, moments.when(row.start_ns, row.end_ns), duration(row.end_ns - row.start_ns))
        for row in analysis.bus_silences
    ]
    yield from tables.limited(
        "Nobody heard although heartbeats were due", ["Bus", "When", ">Lasts"], rows
    )


def _overloads(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    rows: list[Sequence[object]] = [
        (row.bus, moments.when(row.start_ns, row.end_ns), f"{row.percent:.1f} %")
        for row in analysis.overloads
    ]
    yield from tables.limited("Bus nearly full", ["Bus", "When", ">Load"], rows)


def _doubled(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    rows: list[Sequence[object]] = [
        (
            row.bus,
            moments.when(row.start_ns, row.end_ns),
            row.copies,
            row.scope,
            number(row.delay_us, "us"),
        )
        for row in analysis.doubled
    ]
    heads = ["Bus", "When", ">Copies", "Of which frames", ">Copy follows after"]
    yield from tables.limited("Frames that were written twice", heads, rows)


def _marks(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    rows: list[Sequence[object]] = [
        (moments.when(mark.t_ns), mark.bus or "-", mark.reason) for mark in analysis.capture.marks
    ]
    yield from tables.limited("Moments marked by the recorder", ["At", "Bus", "Why"], rows)
