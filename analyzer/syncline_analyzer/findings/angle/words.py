"""Words and groups that the rules on angles share."""

from collections.abc import Sequence

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.results import Analysis, TraceEventRow, TraceRow

TOGETHER_NS = 10_000_000_000
"""Events no further apart than this are one finding [ns]."""
MAX_FINDINGS = 10
MAX_EVIDENCE = 100
DEGREES = {"cpr": "counts per turn (6001h)", "res": "resolution (6000h)"}
"""Settings without which there are no degrees, by their short names."""
SETTING = {"cpr": (0x6001, 0), "res": (0x6000, 0)}
"""Their objects."""
_SETTINGS = {
    "range": "measuring range (6002h or 6502h)",
    "scaling": "scaling (6000h bit 2)",
    "direction": "direction (6000h bit 0)",
    "quad": "quadrant correction (2040h)",
    "angle_def": "angle definition (2044h)",
    "profile": "device profile (1000h)",
}
"""The others."""


def scale_of(trace: TraceRow) -> list[str]:
    """Settings of the scale that were only assumed, in words."""
    words = DEGREES | _SETTINGS
    return [words.get(name, name) for name in trace.assumed]


def events_of(analysis: Analysis, trace: TraceRow, *kinds: str) -> list[TraceEventRow]:
    """Events of these kinds on a trace, in order of time."""
    return [
        event
        for event in analysis.trace_events
        if (event.bus, event.node, event.object) == (trace.bus, trace.node, trace.object)
        and event.kind in kinds
    ]


def together(events: Sequence[TraceEventRow]) -> list[list[TraceEventRow]]:
    """Events near one another; all of them where that makes too many groups."""
    groups: list[list[TraceEventRow]] = []
    for event in events:
        if groups and 0 <= event.t_ns - groups[-1][-1].t_ns <= TOGETHER_NS:
            groups[-1].append(event)
        else:
            groups.append([event])
    return groups if len(groups) <= MAX_FINDINGS else [list(events)]


def evidence_of(events: Sequence[TraceEventRow]) -> list[int]:
    """Frames that prove a group of events."""
    return [event.seq for event in events][:MAX_EVIDENCE]


def number(value: float | None) -> str:
    """A value as people read it."""
    return "?" if value is None else f"{value:.10g}"


def rests_on(trace: TraceRow) -> str:
    """Says so when the numbers rest on an assumed scale."""
    return " The scale is assumed in part." if trace.flags["scale_assumed"] else ""


def stepped(facts: Facts, trace: TraceRow, group: Sequence[TraceEventRow], what: str) -> str:
    """How a position left its line."""
    first = group[0]
    more = f" ({len(group)} {what})" if len(group) > 1 else ""
    return (
        f"{trace.name} of {facts.inside(trace.bus, trace.node)} jumped from {number(first.before)} to"
        f" {number(first.after)} {trace.unit}{facts.at(first.t_ns)} without a command on the"
        f" bus{more}: {first.text}."
        f"{rests_on(trace)}"
    )
