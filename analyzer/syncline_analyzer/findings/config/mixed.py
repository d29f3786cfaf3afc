"""Findings on TPDOs whose frames have several lengths though nothing changed their mapping."""

from bisect import bisect
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.folds.timing.mixed_length import MixedLengths
from syncline_analyzer.folds.timing.pdo_length import SETTLE_NS
from syncline_analyzer.pdo_binding import COMMUNICATION
from syncline_analyzer.results import Finding, SdoObject
from syncline_schemas.canopen.nmt import RESETS
from syncline_schemas.wording import counted

MIN_FRAMES = 3
"""Frames of each length from which on they are told."""
THERE_AND_BACK = 2
"""Changes of the length with nothing between them that explains one."""
_ACTS_NS = 2_000_000_000
"""A write acts on what a PDO carries within this time [ns]."""
_EVIDENCE = 20


def _mixed(facts: Facts) -> Iterator[Finding]:
    """TPDOs of which nobody told the mapping, and whose length goes there and back."""
    for mixed in facts.control.mixed_lengths:
        counts = {length: count for length, count in mixed.counts.items() if count >= MIN_FRAMES}
        changes = _unexplained(facts, mixed)
        if len(counts) > 1 and changes:
            yield _finding(facts, mixed, counts, changes)


def _finding(
    facts: Facts, mixed: MixedLengths, counts: dict[int, int], changes: list[tuple[int, int]]
) -> Finding:
    pdo, bus = mixed.pdo, facts.context.bus_name(mixed.pdo.bus)
    listed = " and ".join(
        f"{length} bytes ({counted(counts[length], 'frame')})" for length in sorted(counts)
    )
    changed = len(changes) + mixed.changed - len(mixed.changes)
    rarer = sum(counts.values()) - max(counts.values())
    taking_turns = changed >= rarer
    mapping = f"{pdo.mapping:04X}h"
    default = pdo.source == "eds-default"
    return Finding(
        "config.pdo_mixed_lengths",
        "warning",
        bus,
        pdo.node,
        changes[0][0],
        changes[-1][0],
        f"Frames of TPDO{pdo.number} of {facts.inside(bus, pdo.node)} ({mixed.can_id:03X}h) have"
        f" {listed}: the length changed {counted(changed, 'time')}, first"
        f"{facts.at(changes[0][0])}, though nothing was written to the node just before and it did not restart.",
        "Another device sends on this identifier: the frames of both stand side by side."
        if taking_turns
        else "Another device sent on this identifier for a while, or the device changes its mapping"
        " by itself in some state of its own.",
        f"Read {mapping} of the node; look for who else uses this identifier (180xh:1, node-IDs):"
        " which frames are left when the node is taken off the bus?",
        [seq for _, seq in changes[:_EVIDENCE]],
        assumed=[f"{pdo.communication:04X}h:1 = {mixed.can_id:X}h (eds-default)"]
        if default
        else [],
    )


def _unexplained(facts: Facts, mixed: MixedLengths) -> list[tuple[int, int]]:
    """Changes of the length that no write explains, and that no restart or gap parts."""
    bus = facts.context.bus_name(mixed.pdo.bus)
    cuts = sorted(_restarts(facts, bus, mixed.pdo.node))
    writes = _writes(facts, mixed)
    groups: dict[int, list[tuple[int, int]]] = {}
    for change in mixed.changes:
        if bool(((change[0] - _ACTS_NS <= writes) & (writes <= change[0] + SETTLE_NS)).any()):
            continue
        groups.setdefault(bisect(cuts, change[0]), []).append(change)
    return [each for group in groups.values() if len(group) >= THERE_AND_BACK for each in group]


def _restarts(facts: Facts, bus: str, node: int) -> Iterator[int]:
    """Moments at which a node may have begun anew, and ends of gaps."""
    key = facts.number(bus), node
    timeline = facts.control.nmt.timelines.get(key)
    if timeline is not None:
        yield from (boot.t_ns for boot in timeline.boot_ups)
        yield from (c.t_ns for c in timeline.history.commands if c.specifier in RESETS)
        yield from (lost.end_ns for lost in timeline.lost)
    yield from (gap.end_ns for gap in facts.analysis.capture.gaps if gap.bus in (None, bus))


def _writes(facts: Facts, mixed: MixedLengths) -> NDArray[np.int64]:
    """Ends of the writes to a node, answered or not, that may change what its PDOs carry."""
    tried = facts.analysis.sdo.of_node(facts.context.bus_name(mixed.pdo.bus), mixed.pdo.node)
    ends_ns: NDArray[np.int64] = tried.writes.of_objects(_may_remap).records["end_ns"]
    return ends_ns


def _may_remap(setting: SdoObject) -> bool:
    return setting.index is None or setting.index >= COMMUNICATION["rpdo"]


RULES = (
    Rule(
        "config.pdo_mixed_lengths",
        "Frames of a TPDO have several lengths though nothing changed its mapping.",
        "The first 20 frames that are not as long as the one before.",
        (
            "Where the mapping is known or fixed `config.pdo_length` tells more.",
            (
                "Only identifiers that a TPDO is bound to by its node or its EDS, not by the predefined"
                " connection set alone; no RPDOs."
            ),
            (
                "The length must go there and back, with three frames of each, and no restart, loss or"
                " gap between; one change for good may be another mapping."
            ),
            "A change up to 2 s after a write to the node, answered or not, is none.",
            "Empty frames do not count: they may be remote frames.",
        ),
        _mixed,
    ),
)
