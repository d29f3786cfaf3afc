"""Findings on SDO writes: configurations that fail, values that are not kept, saves without end."""

from collections.abc import Iterator
from itertools import groupby, pairwise

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.sdo.groups import (
    History,
    alike,
    by_object,
    evidence,
    grouped,
    object_words,
    stretches,
)
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.results import Finding, SdoObject, SdoRow, SdoTransfers
from syncline_analyzer.results.sdo_records import SIDES
from syncline_schemas.canopen.sdo import SAVE_SIGNATURE, abort_meaning
from syncline_schemas.devices import Quirks, quirks

STORE, RESTORE = 0x1010, 0x1011
ATTEMPTS = 3
"""Refusals of one write that are a failed configuration, when the node never runs in between."""
STORMS = ((300_000_000_000, 10), (3_600_000_000_000, 50))
"""(pause [ns], count): as many saves with no longer pause between them wear the memory."""
ENDURANCE = 100_000
"""Write cycles that an EEPROM is usually rated for."""
DAY_NS = 86_400_000_000_000
KEPT = frozenset(
    {0x1006, 0x1007, 0x100C, 0x100D, 0x1015, 0x1016, 0x1017, 0x1019, 0x1029}
    | set(range(0x1600, 0x1800))
    | set(range(0x1A00, 0x1C00))
)
"""Communication objects that only a write changes; of PDO parameters see `_KEPT_SUBS`."""
_KEPT_SUBS = (2, 3, 5)


def failed_configurations(facts: Facts) -> list[SdoTransfers]:
    """Equal refused writes, tried again and again while the node never became OPERATIONAL."""
    aborted = facts.analysis.sdo.writes.aborted
    refused = aborted.part(aborted.records["abort_by"] == SIDES.index("server"))
    groups = map(refused.part, alike(refused, "object", "abort_code"))
    found = [rows for rows in groups if len(rows) >= ATTEMPTS and _never_ran(facts, rows)]
    return sorted(found, key=lambda rows: _refusal(rows[0]))


def _refusal(row: SdoRow) -> tuple[str, int, int, int, int]:
    return row.bus, row.node, *_key(row), row.abort_code or 0


def _never_ran(facts: Facts, rows: SdoTransfers) -> bool:
    first, last = rows[0], rows[-1]
    states = {
        row.state
        for row in facts.analysis.nmt_states
        if row.bus == first.bus
        and row.node == first.node
        and row.start_ns < last.end_ns
        and first.start_ns < row.end_ns
    }
    return "PRE-OPERATIONAL" in states and "OPERATIONAL" not in states


def _configuration(facts: Facts) -> Iterator[Finding]:
    for rows in failed_configurations(facts):
        first, last = rows[0], rows[-1]
        code = first.abort_code or 0
        yield Finding(
            "sdo.configuration_failed",
            "error",
            first.bus,
            first.node,
            first.start_ns,
            last.end_ns,
            f"{facts.who(first.bus, first.node)} refused the write of {object_words(first)} "
            f"{len(rows)} times and never became OPERATIONAL meanwhile: {abort_meaning(code)} "
            f"({code:08X}h).",
            "The master cannot configure the node: another device or firmware than planned.",
            "Compare device and EDS with the master's project; is the value within the limits?",
            evidence(rows),
        )


def _saves(facts: Facts) -> Iterator[Finding]:
    asked = facts.analysis.sdo.accepted.of_objects(lambda of: _may_store(facts, of))
    for rows in by_object(row for row in asked if _stores(row)):
        for apart_ns, least in STORMS:
            storms = [part for part in stretches(rows, apart_ns) if len(part) >= least]
            yield from (_storm(facts, part) for part in storms)
            if storms:
                break


def _may_store(facts: Facts, of: SdoObject) -> bool:
    """Whether a write of an object makes the device write its memory, with the signature at 1010h."""
    return of.index == STORE or _key(of) in _quirks(facts, of).stored_at_once


def _stores(row: SdoRow) -> bool:
    return row.index != STORE or int.from_bytes(row.data, "little") == SAVE_SIGNATURE


def _storm(facts: Facts, rows: list[SdoRow]) -> Finding:
    first, last = rows[0], rows[-1]
    span_ns = last.start_ns - first.start_ns
    every_ns = span_ns / (len(rows) - 1)
    days = ENDURANCE * every_ns / DAY_NS
    worn = f"{days:.0f} days" if days >= 2 else f"{days * 24:.0f} hours"
    return Finding(
        "sdo.save_storm",
        "warning",
        first.bus,
        first.node,
        first.start_ns,
        last.end_ns,
        f"{facts.who(first.bus, first.node)} was told {len(rows)} times in {seconds(span_ns)} to "
        f"store its parameters ({object_words(first)}): at this pace {ENDURANCE:,} write cycles "
        f"are used up in {worn}.",
        "The master's program stores in a loop or at every change instead of once.",
        "Where the program writes this object; store only after parameters were changed.",
        evidence(rows),
        assumed=[f"the memory is good for {ENDURANCE:,} write cycles (usual for an EEPROM)"],
    )


def _not_kept(facts: Facts) -> Iterator[Finding]:
    history = History(facts)
    lasting = facts.analysis.sdo.ok.of_objects(lambda of: _lasting(facts, of))
    rows = [row for row in lasting if isinstance(row.value, int)]
    wrong = [
        pair
        for group in grouped(rows, lambda row: (row.bus, row.node, row.index or 0, row.sub or 0))
        for pair in pairwise(group)
        if _reads_differently(history, *pair)
    ]
    writes = facts.analysis.sdo.writes if wrong else SdoTransfers.of()
    upset = list(writes.of_objects(lambda of: _upsets(facts, of)))
    lost = [pair for pair in wrong if not _changed_otherwise(upset, *pair)]
    for _, pairs in groupby(lost, key=lambda pair: (pair[0].bus, pair[0].node, *_key(pair[0]))):
        yield _changed(facts, list(pairs))


def _key(of: SdoRow | SdoObject) -> tuple[int, int]:
    return of.index or 0, of.sub or 0


def _lasting(facts: Facts, of: SdoObject) -> bool:
    """Whether an object keeps what is written to it until it is written again."""
    index, sub = _key(of)
    pdo = 0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00
    if not (index in KEPT or (pdo and sub in _KEPT_SUBS)):
        return False
    known = _quirks(facts, of)
    special = (known.pending_until_reset, known.aliases, known.stored_at_once)
    return not any((index, sub) in keys for keys in special)


def _reads_differently(history: History, before: SdoRow, after: SdoRow) -> bool:
    """Whether a value that was written, and confirmed, reads back as another one."""
    return (
        before.direction == "download"
        and after.direction == "upload"
        and before.value != after.value
        and history.undisturbed((before.bus, before.node), before.end_ns, after.end_ns)
    )


def _upsets(facts: Facts, of: SdoObject) -> bool:
    """Whether a write brings other values back, or makes the device restart."""
    return of.index == RESTORE or _key(of) in _quirks(facts, of).reset_writes


def _changed_otherwise(upset: list[SdoRow], before: SdoRow, after: SdoRow) -> bool:
    return any(
        (row.bus, row.node) == (before.bus, before.node) and before.seq < row.seq < after.seq
        for row in upset
    )


def _changed(facts: Facts, pairs: list[tuple[SdoRow, SdoRow]]) -> Finding:
    written, read = pairs[0]
    more = f" ({len(pairs)} times)" if len(pairs) > 1 else ""
    return Finding(
        "sdo.write_not_kept",
        "warning",
        written.bus,
        written.node,
        written.start_ns,
        pairs[-1][1].end_ns,
        f"{facts.who(written.bus, written.node)} confirmed {written.value} for "
        f"{object_words(written)}{facts.at(written.start_ns)}, but reads back {read.value}{more}.",
        "The device limits or rounds the value, or something else writes it.",
        "The limits and steps of the object in the device's manual; other masters and tools.",
        [row.seq for pair in pairs for row in pair][:20],
    )


def _quirks(facts: Facts, of: SdoObject) -> Quirks:
    return quirks(facts.context.shadow.device(facts.number(of.bus), of.node))


RULES: tuple[Rule, ...] = (
    Rule(
        "sdo.configuration_failed",
        "A node refuses the same write at every attempt and never becomes OPERATIONAL.",
        "The refused writes.",
        (
            "At least three refusals with the same code.",
            "Only where the node's state is known and it never ran between them.",
        ),
        _configuration,
    ),
    Rule(
        "sdo.save_storm",
        "A node is told to store its parameters again and again, which wears its memory.",
        "The writes that store.",
        ("At least 10 without a pause of 5 min, or 50 without a pause of 1 h.",),
        _saves,
    ),
    Rule(
        "sdo.write_not_kept",
        "A parameter that a node confirmed reads back with another value.",
        "The writes and the reads after them.",
        (
            "Only communication parameters that nothing but a write changes.",
            "Not across a reset, a loss of the node, a load of defaults or a capture gap.",
        ),
        _not_kept,
    ),
)
