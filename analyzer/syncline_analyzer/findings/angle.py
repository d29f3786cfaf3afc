"""Findings on angle traces (analysis.md 7)."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.results import Analysis, Finding, TraceEventRow, TraceRow

TOGETHER_NS = 10_000_000_000
"""Events no further apart than this are one finding [ns]."""
MAX_FINDINGS = 10
MAX_EVIDENCE = 100
_AT_PRESET = "preset value"
_ASSUMED = "assumed"


def _jumps(facts: Facts) -> Iterator[Finding]:
    """Steps faster than the device can turn; a wrap or a preset by SDO is none."""
    for trace in facts.analysis.traces:
        for group in _together(_events(facts.analysis, trace, "jump")):
            yield _jump(trace, group)


def _jump(trace: TraceRow, group: Sequence[TraceEventRow]) -> Finding:
    first = group[0]
    more = f" ({len(group)} jumps)" if len(group) > 1 else ""
    by_wire = _AT_PRESET in first.text
    cause = (
        "The set input (wire) of the encoder was activated: it puts the position to the preset value"
        " without any bus message."
        if by_wire
        else "The encoder lost its position (fault, loose coupling, disturbed sensor), or its"
        " offset was changed without a message in this capture."
    )
    check = (
        "Check the wire of the set input and what drives it; insulate it when it is not used."
        if by_wire
        else "Compare with the true position of the shaft; look at coupling, shielding and EMCY"
        " messages of the encoder."
    )
    return Finding(
        "angle.jump",
        "warning" if by_wire else "error",
        trace.bus,
        trace.node,
        first.t_ns,
        group[-1].t_ns + 1,
        f"{trace.name} of node {trace.node} jumped from {_value(first.before)} to"
        f" {_value(first.after)} {trace.unit} without a command on the bus{more}: {first.text}."
        f"{_rests_on(trace)}",
        cause,
        check,
        [event.seq for event in group][:MAX_EVIDENCE],
    )


def _out_of_range(facts: Facts) -> Iterator[Finding]:
    """Values that the object cannot have: the scale is wrong rather than the sensor."""
    for trace in facts.analysis.traces:
        events = _events(facts.analysis, trace, "out of range")
        if not events:
            continue
        assumed = any(event.text.startswith(_ASSUMED) for event in events)
        tilt = trace.unit == "deg"
        objects = "6000h (resolution) or 2040h (quadrant)" if tilt else "6001h or 6002h (range)"
        first = events[0]
        yield Finding(
            "angle.out_of_range",
            "warning",
            trace.bus,
            trace.node,
            first.t_ns,
            events[-1].t_ns + 1,
            f"{trace.name} of node {trace.node} shows impossible values, {trace.flags['out_of_range']}"
            f" of {trace.samples}, the first is {_value(first.after)} {trace.unit} ({first.text}).",
            f"The scale that was assumed is wrong: {objects}; the sensor itself may be fine."
            if assumed
            else f"{objects} changed without a message in this capture, or the device is faulty.",
            f"Read {objects} from the device, or state them in the bus description.",
            [event.seq for event in events][:MAX_EVIDENCE],
        )


def _events(analysis: Analysis, trace: TraceRow, kind: str) -> list[TraceEventRow]:
    return [
        event
        for event in analysis.trace_events
        if (event.bus, event.node, event.object, event.kind)
        == (trace.bus, trace.node, trace.object, kind)
    ]


def _together(events: Sequence[TraceEventRow]) -> list[list[TraceEventRow]]:
    groups: list[list[TraceEventRow]] = []
    for event in events:
        if groups and 0 <= event.t_ns - groups[-1][-1].t_ns <= TOGETHER_NS:
            groups[-1].append(event)
        else:
            groups.append([event])
    return groups if len(groups) <= MAX_FINDINGS else [list(events)]


def _value(value: float | None) -> str:
    return "?" if value is None else f"{value:.10g}"


def _rests_on(trace: TraceRow) -> str:
    """Says so when the numbers rest on an assumed scale."""
    return " The scale is assumed in part." if trace.flags["scale_assumed"] else ""


RULES = (
    Rule(
        "angle.jump",
        "A position stepped further than the device can turn in that time.",
        "The two samples around the step.",
        (
            "A wrap at the measuring range is no step.",
            "A preset, a direction change, a teach or a reset cuts the trace instead.",
            "No step is told across a capture gap or a step of the clock.",
        ),
        _jumps,
        untimed=True,
    ),
    Rule(
        "angle.out_of_range",
        "A measured value that the object cannot have: the scale is wrong, or the device is faulty.",
        "The first sample of each such stretch.",
        ("The text says whether the scale was only assumed.",),
        _out_of_range,
        untimed=True,
    ),
)
