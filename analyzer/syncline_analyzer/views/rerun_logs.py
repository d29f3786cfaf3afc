"""Logs in a Rerun recording: EMCY, NMT, findings, SDO, changes, and frames."""

from collections.abc import Callable, Iterable, Sequence

import rerun as rr

from syncline_analyzer.decode.stream import Decoding
from syncline_analyzer.results import Analysis
from syncline_analyzer.views import events
from syncline_analyzer.views.events import Event
from syncline_analyzer.views.frame_rows import (
    ONE_PASS_FRAMES,
    LeftOut,
    ReadFrames,
    Shown,
    frame_rows,
)
from syncline_analyzer.views.frame_words import FrameLines, Said
from syncline_analyzer.views.rerun_layout import PlotContent
from syncline_analyzer.views.rerun_sink import Sink
from syncline_analyzer.views.words import Clock
from syncline_schemas.wording import counted

Tell = Callable[[Analysis], Iterable[Event]]

_LEVELS = {"error": "ERROR", "warning": "WARN", "info": "INFO"}

_LOGS: list[tuple[str, str, Tell, str]] = [
    ("EMCY log", "/log/emcy", events.emcy_events, "No EMCY message in this capture."),
    ("SDO log", "/log/sdo", events.sdo_events, "No SDO transfer in this capture."),
    ("Change log", "/log/changes", events.change_events, "No object was changed in this capture."),
    ("NMT log", "/log/nmt", events.nmt_events, "No NMT state known in this capture."),
    ("Finding log", "/log/findings", events.finding_events, "Nothing was found."),
]
LOGS = {title: entity for title, entity, _, _ in _LOGS}
"""Entity of each log by its title; every recording has all of them."""
Decode = Callable[[], Decoding]
"""Opens the session once more, to be decoded (`Session.decoding`)."""
FRAMES = PlotContent("Frames around the cursor", "/log/frames")


def logs_of(analysis: Analysis) -> list[PlotContent]:
    """What was said and done; logs that tell something first."""
    silent = {entity: not any(True for _ in tell(analysis)) for _, entity, tell, _ in _LOGS}
    plots = [PlotContent(title, entity) for title, entity, _, _ in _LOGS]
    return sorted(plots, key=lambda plot: silent[plot.entity])


def write_logs(sink: Sink, analysis: Analysis) -> None:
    """Write all logs but that of the frames; one that has nothing to tell says so."""
    begin_ns, clock = analysis.capture.begin_ns, sink.axis.clock
    several = len(analysis.capture.buses) > 1

    def line(event: Event) -> str:
        bus = f"{event.bus} " if several and event.bus else ""
        return f"{clock.short(event.t_ns)}  {bus}{event.text}"

    for _, entity, tell, nothing in _LOGS:
        told = list(tell(analysis)) or [Event(begin_ns, 0, "info", nothing)]
        _write(sink, entity, told, line)


def write_frames(
    sink: Sink, analysis: Analysis, read: ReadFrames, decode: Decode | None = None
) -> None:
    """Write the frames of a short capture, or those around the events of a long one.

    With `decode` those of a short capture tell the values that they carry.
    """
    lines = FrameLines(analysis)
    short = decode is not None and analysis.capture.frames <= ONE_PASS_FRAMES
    said = lines.decoded(decode()) if decode is not None and short else []
    told: list[Event] = []
    for item in frame_rows(analysis, read):
        if isinstance(item, Shown):
            told += _frame_events(lines, item, said)
        else:
            told.append(Event(item.start_ns, None, "warning", _left_out(item, sink.axis.clock)))
    _write(sink, FRAMES.entity, told, lambda event: event.text)


def _frame_events(lines: FrameLines, shown: Shown, said: Sequence[Said]) -> Iterable[Event]:
    for row, t_ns in enumerate(shown.frames.t_ns.tolist()):
        seq = None if shown.seq is None else int(shown.seq[row])
        words = said[seq] if seq is not None and seq < len(said) else None
        text, severity = lines.line(shown.frames, row, seq, words)
        yield Event(t_ns, seq, severity, text)


def _left_out(item: LeftOut, clock: Clock) -> str:
    frames = "frames" if item.count is None else counted(item.count, "frame")
    if not clock.timed:
        return f"... {frames} more are not listed"
    until = clock.short(item.end_ns)
    return f"... {frames} up to {until} not listed: see syncline decode"


def _write(sink: Sink, entity: str, told: list[Event], line: Callable[[Event], str]) -> None:
    told.sort(key=lambda event: (event.t_ns, event.seq or 0))
    sink.rows(
        entity,
        [event.t_ns for event in told],
        [event.seq or 0 for event in told],
        lambda part: rr.TextLog.columns(
            text=[line(event) for event in told[part]],
            level=[_LEVELS[event.severity] for event in told[part]],
        ),
    )
