"""Findings on EMCY messages: errors that were active, storms, inhibit times."""

from collections.abc import Iterator
from itertools import groupby

from syncline_analyzer.context import Context
from syncline_analyzer.findings.bus import tells_bus_off
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import error_name, seconds
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.results import Analysis, ErrorRow, Finding
from syncline_schemas.wording import counted

LIFE_GUARD = 0x8130
"""Told as the story of the master's silence, by the NMT findings."""


def _active(facts: Facts) -> Iterator[Finding]:
    """Errors by node and code; those still active at the end are apart from those that are over."""
    analysis, control, context = facts.analysis, facts.control, facts.context
    rows = [row for row in analysis.errors if not _told_elsewhere(analysis, context, row)]
    rows.sort(key=lambda row: (row.bus, row.node, row.code, row.status == "still active"))
    for (bus, node, _, still), group in groupby(
        rows, key=lambda row: (row.bus, row.node, row.code, row.status == "still active")
    ):
        found = sorted(group, key=lambda row: row.evidence[0])
        yield _active_finding(control, context, bus, node, found, still)


def _active_finding(
    control: ControlTables, context: Context, bus: str, node: int, rows: list[ErrorRow], still: bool
) -> Finding:
    first = rows[0]
    end_ns = control.nmt.end_ns
    ends = [row.cleared_ns if row.cleared_ns is not None else row.raised_ns for row in rows]
    count = sum(row.count for row in rows)
    text = f"Node {node} reports {error_name(first.code, first.meaning)}"
    text += f" in {count} messages" if count > len(rows) else ""
    lasted = sum((row.cleared_ns or row.raised_ns) - row.raised_ns for row in rows)
    lost = sum(row.status == "lost at reset" for row in rows)
    if still:
        text += "; it is still active at the end of the capture."
    elif lost == len(rows):
        often = f"it came {lost} times, each time " if lost > 1 else ""
        text += f"; {often}ended by a restart of the node, not cleared."
    else:
        often = f"it came {len(rows)} times and was " if len(rows) > 1 else ""
        text += f"; {often}cleared"
        text += f" after {seconds(lasted)}" if context.timed else ""
        text += " altogether" if context.timed and often else ""
        text += f" ({lost} of them ended by a restart of the node)." if lost else "."
    return Finding(
        "emcy.active",
        "error" if still else "warning",
        bus,
        node,
        first.raised_ns,
        end_ns if still else max(ends),
        text,
        "The node itself found this fault; the code is its own word for it.",
        "Look the code up in the device's manual; read 1001h and 1003h of the node.",
        [seq for row in rows for seq in row.evidence][:20],
    )


def _told_elsewhere(analysis: Analysis, context: Context, row: ErrorRow) -> bool:
    return context.timed and (row.code == LIFE_GUARD or tells_bus_off(row.code, row.meaning))


def _storms(facts: Facts) -> Iterator[Finding]:
    for storm in facts.control.emcy.storms:
        yield Finding(
            "emcy.storm",
            "error",
            storm.bus,
            storm.node,
            storm.start_ns,
            storm.end_ns,
            f"Node {storm.node} sent {storm.number} EMCYs within"
            f" {seconds(storm.end_ns - storm.start_ns)}.",
            "A fault that comes and goes many times a second: loose contact, or a limit without"
            " hysteresis; no inhibit time (1015h) holds it back.",
            "Which codes alternate? Set 1015h to keep the bus free.",
            [storm.first_seq],
        )


def _before(facts: Facts) -> Iterator[Finding]:
    """A partial clear as first EMCY: an error was there before the capture began."""
    wanted = set(facts.control.emcy.before)
    for row in facts.analysis.emcy:
        if row.seq in wanted:
            left = ", ".join(row.registers) or f"register {row.error_register or 0:02X}h"
            yield Finding(
                "emcy.active_before",
                "warning",
                row.bus,
                row.node,
                row.t_ns,
                row.t_ns,
                f"The first EMCY of node {row.node} clears one error and leaves others: {left}.",
                "These errors were raised before the capture began.",
                "Read 1003h of the node for the codes.",
                [row.seq],
            )


def _too_soon(facts: Facts) -> Iterator[Finding]:
    rows = sorted(facts.control.emcy.too_soon, key=lambda row: (row.bus, row.node, row.seq))
    for (bus, node), group in groupby(rows, key=lambda row: (row.bus, row.node)):
        found = list(group)
        yield Finding(
            "emcy.inhibit_time",
            "info",
            bus,
            node,
            found[0].t_ns,
            found[-1].t_ns,
            f"Node {node} sent {counted(len(found), 'EMCY')} sooner than its inhibit time 1015h allows"
            f" ({found[0].passed_us:.0f} us after the one before instead of"
            f" {found[0].inhibit_us:.0f} us).",
            "1015h is not in effect, or the recorder's stamps are not exact.",
            "Read 1015h back.",
            [row.seq for row in found[:20]],
        )


def _malformed(facts: Facts) -> Iterator[Finding]:
    """EMCYs that are too short to tell an error (CiA 301 7.2.7.3: eight bytes)."""
    rows = [row for row in facts.analysis.emcy if row.transition == "malformed"]
    rows.sort(key=lambda row: (row.bus, row.node, row.seq))
    for (bus, node), group in groupby(rows, key=lambda row: (row.bus, row.node)):
        found = list(group)
        yield Finding(
            "emcy.malformed",
            "warning",
            bus,
            node,
            found[0].t_ns,
            found[-1].t_ns,
            f"{counted(len(found), 'frame')} on the EMCY identifier of node {node}"
            f" {'does' if len(found) == 1 else 'do'} not have eight bytes (the first is an"
            f" {found[0].meaning}): no error is concluded from"
            f" {'it' if len(found) == 1 else 'them'}.",
            "The device does not keep to CiA 301, or the identifier carries something else than"
            " EMCYs.",
            "Look at the frames; read 1014h of the node and 1005h of all nodes.",
            [row.seq for row in found[:20]],
        )


RULES = (
    Rule(
        "emcy.storm",
        "A node sends more than 10 EMCYs in a second.",
        "The first EMCY of the storm.",
        ("Malformed EMCYs are counted elsewhere.",),
        _storms,
    ),
    Rule(
        "emcy.active",
        "A node reports an error of its own, with its code in words.",
        "The EMCYs that raise, repeat and clear it.",
        (
            "Life-guard and bus-off errors are told as the stories of their causes.",
            "Nothing is concluded from frames shorter than eight bytes.",
        ),
        _active,
        untimed=True,
    ),
    Rule(
        "emcy.active_before",
        "An error was active before the capture began.",
        "The first EMCY of the node, which clears one error and leaves others.",
        ("Only the node's first EMCY is judged so.",),
        _before,
        untimed=True,
    ),
    Rule(
        "emcy.inhibit_time",
        "EMCYs follow one another sooner than 1015h allows.",
        "The EMCYs that came too soon.",
        ("Only where 1015h is known.",),
        _too_soon,
    ),
    Rule(
        "emcy.malformed",
        "Frames on an EMCY identifier do not have eight bytes.",
        "These frames.",
        ("No error is concluded from them.",),
        _malformed,
        untimed=True,
    ),
)
