"""Moments of an analysis that a plot marks and a log tells, the same in HTML and Rerun."""

from collections.abc import Iterator
from typing import Literal

from syncline_analyzer.results import Analysis, EmcyRow, SdoRow, SdoTransfers, Severity
from syncline_analyzer.views.palette import (
    EMCY_CLEAR_COLOUR,
    EMCY_COLOUR,
    GAP_COLOUR,
    MARK_COLOUR,
    SEVERITY_COLOURS,
    STATE_COLOURS,
    Rgb,
)
from syncline_analyzer.views.words import (
    duration,
    hex_code,
    names_of,
    node_label,
    object_name,
    printable,
    sdo_result,
)
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.records import dataclass
from syncline_schemas.wording import counted

LOUD_STATES: dict[str, Severity] = {
    NmtState.LOST: "error",
    NmtState.STOPPED: "warning",
    NmtState.INITIALISING: "warning",
}
"""States that deserve a second look, with how loud the log says so."""

MAX_TRANSFERS = 2_000
"""SDO transfers of one kind that a log lists."""
_VERBS = {"upload": "read", "download": "write"}
_VALUE = 60
"""Characters of a value that a log shows."""

CLEARING = ("partly cleared", "all cleared")
RESET = "reset"
"""Transition of a boot-up that takes the error list with it: no message of the node."""


@dataclass(frozen=True, slots=True)
class Event:
    """One line of a log; `seq` is None where no single frame proves it, `bus` where it is of none."""

    t_ns: int
    seq: int | None
    severity: Severity
    text: str
    bus: str | None = None


@dataclass(frozen=True, slots=True)
class Marks:
    """Markers of one kind: their colour, shape and row in the strip of events."""

    name: str
    colour: Rgb
    shape: Literal["down", "up", "diamond", "square"]
    row: int
    moments: list[tuple[int, int]]
    """(t_ns, seq)"""


def marks(analysis: Analysis) -> list[Marks]:
    """Markers of everything that is over in a moment, or may be too short to see."""
    severities: tuple[Severity, ...] = ("error", "warning", "info")
    emcy, gaps = analysis.emcy, analysis.capture.gaps
    raised = [(row.t_ns, row.seq) for row in emcy if row.transition not in (*CLEARING, RESET)]
    cleared = [(row.t_ns, row.seq) for row in emcy if row.transition in CLEARING]
    found = [
        Marks("node lost", STATE_COLOURS[NmtState.LOST], "square", 4, _starts(analysis, NmtState.LOST)),
        Marks("node starting", STATE_COLOURS[NmtState.INITIALISING], "up", 3,
              _starts(analysis, NmtState.INITIALISING)),
        Marks("EMCY", EMCY_COLOUR, "down", 2, raised),
        Marks("EMCY cleared", EMCY_CLEAR_COLOUR, "up", 2, cleared),
        Marks("recorder blind", GAP_COLOUR, "square", 1, [(gap.start_ns, 0) for gap in gaps]),
        Marks("marked by the recorder", MARK_COLOUR, "diamond", 2,
              [(mark.t_ns, 0) for mark in analysis.capture.marks]),
        *(Marks(f"finding: {severity}", SEVERITY_COLOURS[severity], "diamond", 1,
                _found(analysis, severity)) for severity in severities),
    ]  # fmt: skip
    return [mark for mark in found if mark.moments]


def _starts(analysis: Analysis, state: str) -> list[tuple[int, int]]:
    rows = [row for row in analysis.nmt_states if row.state == state]
    return [(row.start_ns, row.evidence or 0) for row in rows]


def _found(analysis: Analysis, severity: Severity) -> list[tuple[int, int]]:
    rows = [row for row in analysis.findings if row.severity == severity]
    return [(row.start_ns, row.evidence[0] if row.evidence else 0) for row in rows]


def emcy_events(analysis: Analysis) -> Iterator[Event]:
    """EMCY messages."""
    labels = names_of(analysis.nodes)
    for row in analysis.emcy:
        label = labels.get((row.bus, row.node), node_label(row.node))
        severity: Severity = "error"
        if row.transition in CLEARING:
            severity = "info"
        elif row.transition in ("malformed", RESET):
            severity = "warning"
        yield Event(row.t_ns, row.seq, severity, f"node {label}: {emcy_text(row)}", row.bus)


def emcy_text(row: EmcyRow) -> str:
    """An EMCY in one line: code, meaning, what it does, register and manufacturer bytes."""
    code = "" if row.code is None else f"{hex_code(row.code)} "
    parts = [f"{code}{printable(row.meaning)}", row.transition]
    if row.error_register is not None:
        names = " ".join(row.registers)
        parts.append(f"register {hex_code(row.error_register, 2)}{' ' + names if names else ''}")
    if row.manufacturer_hex.strip("0 "):
        parts.append(row.manufacturer_hex)
    return ", ".join(parts)


def nmt_events(analysis: Analysis) -> Iterator[Event]:
    """Where the capture starts and ends, capture gaps, changes of NMT states, NMT commands."""
    capture = analysis.capture
    yield Event(capture.begin_ns, 0, "info", "capture starts")
    last = max(capture.frames - 1, 0)
    yield Event(capture.end_ns, last, "info", "capture ends")
    for gap in capture.gaps:
        blind = duration(gap.end_ns - gap.start_ns)
        text = f"recorder blind for {blind}: {printable(gap.reason)}"
        yield Event(gap.start_ns, None, "warning", text, gap.bus)
    for mark in capture.marks:
        text = f"marked by the recorder: {printable(mark.reason)}"
        yield Event(mark.t_ns, None, "info", text, mark.bus)
    labels = names_of(analysis.nodes)
    for state in analysis.nmt_states:
        label = labels.get((state.bus, state.node), node_label(state.node))
        text = f"node {label}: {state.state} ({printable(state.cause)}, {state.certainty})"
        severity = LOUD_STATES.get(state.state, "info")
        yield Event(state.start_ns, state.evidence, severity, text, state.bus)
    for command in analysis.nmt_commands:
        label = labels.get((command.bus, command.node), node_label(command.node))
        text = f"command: {printable(command.command)} to {_whom(command.node, label)}"
        yield Event(command.t_ns, command.seq, "info", text, command.bus)


def _whom(node: int, label: str) -> str:
    return f"node {label}" if node else "all nodes"


def sdo_events(analysis: Analysis) -> Iterator[Event]:
    """SDO transfers: those that failed, writes, and reads, the first 2000 of each."""
    labels = names_of(analysis.nodes)
    done = analysis.sdo.ok
    parts: tuple[tuple[SdoTransfers, Severity], ...] = (
        (analysis.sdo.failed, "warning"),
        (done.writes, "info"),
        (done.reads, "info"),
    )
    for transfers, severity in parts:
        for row in transfers[:MAX_TRANSFERS]:
            label = labels.get((row.bus, row.node), node_label(row.node))
            yield Event(row.start_ns, row.seq, severity, f"node {label}: {_sdo_text(row)}", row.bus)
        if (left := len(transfers) - MAX_TRANSFERS) > 0:
            text = f"{counted(left, 'further transfer')} like this not listed"
            yield Event(transfers[MAX_TRANSFERS].start_ns, None, "warning", text)


def _sdo_text(row: SdoRow) -> str:
    what = f"{_VERBS[row.direction]} {object_name(row.index, row.sub)}"
    name = f" {printable(row.name)}" if row.name else ""
    if row.result != "ok":
        return f"{what}{name}: {sdo_result(row)}"
    value = "" if row.value is None else f" = {printable(str(row.value))[:_VALUE]}"
    return f"{what}{name}{value}"


def change_events(analysis: Analysis) -> Iterator[Event]:
    """Changes of parameters, who made them and what was there before."""
    labels = names_of(analysis.nodes)
    for row in analysis.object_changes:
        label = labels.get((row.bus, row.node or 0), node_label(row.node))
        where = f" ({object_name(row.index, row.sub)})" if row.index is not None else ""
        was = f", was {printable(row.old_words)}" if row.old_words else ""
        again = f", again {counted(row.repeats, 'time')}" if row.repeats else ""
        kept = {True: ", saved", False: ", not saved", None: ""}[row.saved]
        told = f"{printable(row.words)}{where} by {printable(row.who)}{was}{kept}{again}"
        yield Event(row.t_ns, row.seq, "info", f"node {label}: {told}", row.bus)


def finding_events(analysis: Analysis) -> Iterator[Event]:
    """Findings with their numbers, at their start."""
    for place, row in enumerate(analysis.findings, 1):
        seq = row.evidence[0] if row.evidence else None
        yield Event(row.start_ns, seq, row.severity, f"{place}: {printable(row.text)} [{row.id}]")
