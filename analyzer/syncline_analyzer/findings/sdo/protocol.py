"""Findings on SDO transfers of several frames: damaged, out of step, broken off."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.sdo.groups import (
    MAX_EVIDENCE,
    by_node,
    by_object,
    evidence,
    object_words,
    objects_words,
    stretches,
    times,
)
from syncline_analyzer.results import Finding
from syncline_analyzer.results.sdo_records import ENDERS, KINDS, NONE, RESULTS
from syncline_schemas.wording import counted

TOGGLE_ERROR = 0x05030000
CRC_ERROR = 0x05040004
TOLD_BY_PROTOCOL = (TOGGLE_ERROR, CRC_ERROR)
"""Abort codes that the rules here tell."""
OK, EXPEDITED = RESULTS.index("ok"), KINDS.index("expedited")
BROKEN_OFF = 3
"""Transfers of a node that a new request breaks off before it is said."""
OFTEN = 3
"""How often segments must be sent again before it is said."""


def _bad_crc(facts: Facts) -> Iterator[Finding]:
    transfers = facts.analysis.sdo.unusual
    wrong = transfers.records["crc"] == 0
    rows = transfers.part(wrong | (transfers.records["abort_code"] == CRC_ERROR))
    for group in by_object(rows):
        first = group[0]
        accepted = all(row.result == "ok" for row in group)
        yield Finding(
            "sdo.block_crc",
            "warning",
            first.bus,
            first.node,
            first.start_ns,
            group[-1].end_ns,
            f"{facts.who(first.bus, first.node)}: the CRC of the block transfer of "
            f"{object_words(first)}{facts.at(first.start_ns)} does not match its data"
            f"{times(len(group))}" + (", and the receiver accepted it." if accepted else "."),
            "A segment was damaged or not recorded, or the sender computes its CRC wrongly.",
            "Repeat the transfer and compare.",
            [seq for row in group for seq in (row.seq, row.end_seq or row.seq)][:MAX_EVIDENCE],
        )


def _toggle(facts: Facts) -> Iterator[Finding]:
    transfers = facts.analysis.sdo.unusual
    records = transfers.records
    counted_size = (records["result"] == OK) & (records["announced"] == records["length"])
    proven = (records["toggle_errors"] > 0) & counted_size
    rows = transfers.part(proven | (records["abort_code"] == TOGGLE_ERROR))
    for group in by_node(rows):
        first = group[0]
        yield Finding(
            "sdo.toggle",
            "warning",
            first.bus,
            first.node,
            first.start_ns,
            group[-1].end_ns,
            f"{facts.who(first.bus, first.node)}: the toggle bit did not alternate in "
            f"{counted(len(group), 'segmented SDO transfer')} ({objects_words(group)}).",
            "A segment was sent twice after a time-out, or one side does not follow the protocol.",
            "The client's SDO time-out; the firmware of the side that repeats the toggle bit.",
            evidence(group),
        )


def _size_mismatch(facts: Facts) -> Iterator[Finding]:
    transfers = facts.analysis.sdo.unusual
    records = transfers.records
    differs = (records["announced"] != NONE) & (records["announced"] != records["length"])
    told = (records["result"] == OK) & (records["kind"] != EXPEDITED) & differs
    rows = [row for row in transfers.part(told) if row.value is not None]
    for group in by_object(rows):
        first = group[0]
        yield Finding(
            "sdo.size_mismatch",
            "info",
            first.bus,
            first.node,
            first.start_ns,
            group[-1].end_ns,
            f"{facts.who(first.bus, first.node)}: the transfer of {object_words(first)} announced "
            f"{counted(first.announced or 0, 'byte')} and brought {len(first.data)}"
            f"{times(len(group))}.",
            "The sender announces the size of its buffer instead of that of the value.",
            "Whether the receiver takes the bytes that are too many or too few for the value.",
            evidence(group),
        )


def _repeated(facts: Facts) -> Iterator[Finding]:
    transfers = facts.analysis.sdo.unusual
    rows = transfers.part((transfers.records["repeated"] > 0) & (transfers.records["crc"] != 0))
    often = dict(zip(rows.records["seq"].tolist(), rows.records["repeated"].tolist(), strict=True))
    for group in by_node(rows):
        first = group[0]
        repeated = sum(often[row.seq] for row in group)
        if repeated < OFTEN:
            continue
        yield Finding(
            "sdo.block_repeated",
            "warning",
            first.bus,
            first.node,
            first.start_ns,
            group[-1].end_ns,
            f"{facts.who(first.bus, first.node)}: segments had to be sent again "
            f"{repeated} times in {counted(len(group), 'block transfer')} "
            f"({objects_words(group)}).",
            "The receiver cannot take the segments as fast as they come.",
            "A smaller block size, or a pause between segments; the receiver's load.",
            evidence(group),
        )


def _interrupted(facts: Facts) -> Iterator[Finding]:
    transfers = facts.analysis.sdo.unusual
    broken = transfers.records["result"] == RESULTS.index("interrupted")
    rows = transfers.part(broken & (transfers.records["ended_by"] == ENDERS.index("request")))
    for found in by_node(rows):
        for group in stretches(found, 600_000_000_000):
            if len(group) < BROKEN_OFF:
                continue
            first = group[0]
            yield Finding(
                "sdo.interrupted",
                "warning",
                first.bus,
                first.node,
                first.start_ns,
                group[-1].end_ns,
                f"{facts.who(first.bus, first.node)}: {counted(len(group), 'SDO transfer')} "
                f"({objects_words(group)}) ended in the middle because a new request came.",
                "Two clients use one SDO server, or the client starts over without an abort.",
                "Whether a second master, panel or service tool asks the same node.",
                evidence(group),
            )


RULES: tuple[Rule, ...] = (
    Rule(
        "sdo.block_crc",
        "The CRC of a block transfer does not match its data.",
        "The first and the last frame of the transfer.",
        ("Only transfers that were recorded whole and use a CRC, or that the receiver refused.",),
        _bad_crc,
        untimed=True,
    ),
    Rule(
        "sdo.toggle",
        "The toggle bit of a segmented transfer did not alternate.",
        "The first requests of the transfers.",
        ("Only where the receiver refused, or the announced size proves that nothing is missing.",),
        _toggle,
        untimed=True,
    ),
    Rule(
        "sdo.size_mismatch",
        "A transfer brought more or fewer bytes than it announced.",
        "The first requests of the transfers.",
        ("Not where segments may be missing in the capture.",),
        _size_mismatch,
        untimed=True,
    ),
    Rule(
        "sdo.block_repeated",
        "Segments of block transfers had to be sent again and again.",
        "The first requests of the transfers.",
        ("At least three times; the protocol is made for one.",),
        _repeated,
        untimed=True,
    ),
    Rule(
        "sdo.interrupted",
        "Transfers of several frames were broken off again and again by a new request.",
        "The first requests of the transfers that were broken off.",
        (
            "At least three within ten minutes of each other; resets, gaps and the end do not count.",
        ),
        _interrupted,
    ),
)
