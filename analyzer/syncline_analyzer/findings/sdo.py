"""Findings on SDO transfers: refused, unanswered, damaged."""

from collections.abc import Iterator
from itertools import groupby

from syncline_analyzer.context import Context
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import Stretch, seconds
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.results import Finding, SdoRow
from syncline_schemas.canopen.sdo import abort_meaning
from syncline_schemas.devices import quirks
from syncline_schemas.wording import counted

TIMED_OUT = 0x05040000
PROBING = (0x06020000, 0x06090011)
"""Abort codes with which a node says that it does not have what a master looks for."""
TOGETHER_NS = 60_000_000_000
"""Unanswered requests closer than this are told as one [ns]."""


def _aborts(facts: Facts) -> Iterator[Finding]:
    """One finding for all equal refusals of a node."""
    rows = [row for row in facts.analysis.sdo if row.result == "abort" and not _timed_out(row)]
    rows.sort(key=lambda row: (*_what(row), row.seq))
    for _, group in groupby(rows, key=_what):
        yield _abort(facts.control, facts.context, list(group))


def _what(row: SdoRow) -> tuple[str, int, int, int, str, int]:
    code = row.abort_code if row.abort_code is not None else -1
    return row.bus, row.node, row.index or 0, row.sub or 0, row.direction, code


def _abort(control: ControlTables, context: Context, rows: list[SdoRow]) -> Finding:
    first, last = rows[0], rows[-1]
    code = first.abort_code or 0
    by_client = control.sdo.aborted_by.get(first.seq) == "client"
    probing = first.direction == "upload" and (code in PROBING or _normal(context, first))
    times = "" if len(rows) == 1 else f", {len(rows)} times"
    verb = "read" if first.direction == "upload" else "write"
    who = "The client gave up" if by_client else f"Node {first.node} refused"
    what = f"the {verb} of {_object(first)}"
    return Finding(
        "sdo.abort",
        "info" if probing else "warning",
        first.bus,
        first.node,
        first.start_ns,
        last.end_ns,
        f"{who} {what}: {abort_meaning(code)} ({code:08X}h){times}.",
        "The master looks for an object that this device does not have."
        if probing
        else "The client's configuration does not fit this device or its present state.",
        "Nothing, if the object is optional; else compare the device with the one that was planned."
        if probing
        else "Compare object, data length and value with the device's manual; was the write needed?",
        [row.seq for row in rows[:20]],
    )


def _unanswered(facts: Facts) -> Iterator[Finding]:
    """Requests to nodes that are there; numbers where nobody is are a master's search."""
    analysis, control, context = facts.analysis, facts.control, facts.context
    there = {(row.bus, row.node) for row in analysis.nodes}
    rows = [
        row
        for row in analysis.sdo
        if (row.result == "no answer" or (_timed_out(row) and row.answer_us is None))
        and (row.bus, row.node) in there
        and not _explained(control, context, row)
    ]
    rows.sort(key=lambda row: (row.bus, row.node, row.seq))
    for (bus, node), group in groupby(rows, key=lambda row: (row.bus, row.node)):
        found = list(group)
        for start, end in Stretch.of([row.start_ns for row in found], TOGETHER_NS):
            part = [row for row in found if start <= row.start_ns <= end]
            objects = sorted({_object(row) for row in part})
            named = ", ".join(objects[:5]) + (" ..." if len(objects) > 5 else "")
            yield Finding(
                "sdo.no_answer",
                "warning",
                bus,
                node,
                start,
                max(row.end_ns for row in part),
                f"Node {node} did not answer {counted(len(part), 'SDO request')} ({named})"
                + (f" within {seconds(end - start)}." if end > start else "."),
                "The node was busy or restarting, its SDO server moved (1200h), or it is STOPPED.",
                "Look at its state at that time; repeat the request.",
                [row.seq for row in part[:20]],
            )


def _timed_out(row: SdoRow) -> bool:
    return row.result == "abort" and row.abort_code == TIMED_OUT


def _normal(context: Context, row: SdoRow) -> bool:
    """Refusals that the device's maker describes."""
    if row.bus not in context.buses or row.direction != "upload":
        return False
    device = context.shadow.device(context.buses.index(row.bus), row.node)
    facts = device.object(row.index or 0, row.sub or 0) if device else None
    return row.index in quirks(device).absent or (facts is not None and facts.access == "wo")


def _explained(control: ControlTables, context: Context, row: SdoRow) -> bool:
    """Whether the node was silent altogether, or starting: that is told by another finding."""
    if row.bus not in context.buses:
        return False
    timeline = control.nmt.timelines.get((context.buses.index(row.bus), row.node))
    if timeline is None:
        return False
    gone = [*timeline.lost, *timeline.restarts]
    if any(lost.last_ns <= row.end_ns and row.start_ns < lost.end_ns for lost in gone):
        return True
    return any(
        interval.state.value == "INITIALISING"
        and interval.start_ns <= row.start_ns < interval.end_ns
        for interval in timeline.intervals
    )


def _bad_crc(facts: Facts) -> Iterator[Finding]:
    wrong = set(facts.control.sdo.bad_crc)
    for row in facts.analysis.sdo:
        if row.end_seq in wrong:
            yield Finding(
                "sdo.block_crc",
                "warning",
                row.bus,
                row.node,
                row.start_ns,
                row.end_ns,
                f"The CRC of the block transfer of {_object(row)} does not match its data.",
                "A segment was damaged or not recorded, or the sender computes its CRC wrongly.",
                "Repeat the transfer and compare.",
                [row.seq, row.end_seq or row.seq],
            )


def _object(row: SdoRow) -> str:
    name = f" ({row.name})" if row.name else ""
    return f"{row.index or 0:04X}h:{row.sub or 0:02X}{name}"


RULES = (
    Rule(
        "sdo.abort",
        "An SDO transfer was refused or given up, with the reason in words.",
        "The requests that were refused.",
        (
            "Reads of objects that a device does not have are a note: a master that searches.",
            "Refusals that the device's maker describes are a note.",
        ),
        _aborts,
        untimed=True,
    ),
    Rule(
        "sdo.no_answer",
        "A node that is there did not answer SDO requests.",
        "The requests without an answer.",
        (
            "Numbers where nobody was heard are a master's search.",
            "Not while the node was lost, restarting, or the recorder blind.",
        ),
        _unanswered,
        untimed=True,
    ),
    Rule(
        "sdo.block_crc",
        "The CRC of a block transfer does not match its data.",
        "The first and the last frame of the transfer.",
        ("Only transfers that were recorded whole and use a CRC.",),
        _bad_crc,
        untimed=True,
    ),
)
