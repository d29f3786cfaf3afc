"""SYNC whose counter is not the one that the nodes were told (1019h)."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.folds.timing.sync_settings import OVERFLOW
from syncline_analyzer.results import Finding, SyncRow
from syncline_analyzer.service_ids import sync_id

ENOUGH = 50
"""SYNCs that must have come since the setting was seen."""
SURE = 3
"""So often the counter must have begun again from the same number."""


def _counter(facts: Facts) -> Iterator[Finding]:
    for row in facts.analysis.sync:
        nodes = _others(facts, row)
        if not nodes:
            continue
        listed = ", ".join(f"node {node} ({value})" for node, value in sorted(nodes.items()))
        counts = (
            "has no counter" if row.counter_max is None else f"counts from 1 to {row.counter_max}"
        )
        one = len(nodes) == 1
        yield Finding(
            "sync.counter_setting",
            "warning",
            row.bus,
            next(iter(nodes)) if one else None,
            facts.analysis.capture.begin_ns,
            facts.analysis.capture.end_ns,
            f"SYNC {row.cob_id:03X}h {counts}, but {listed} {'was' if one else 'were'} told another"
            " end of the counter (1019h; 0 means none).",
            "1019h was set on one side only, or after the SYNC producer had started: nodes answer a"
            " SYNC of another length with EMCY 8240h, or count from the wrong SYNC.",
            "Read 1019h of the SYNC producer and of all nodes: it must be the same, and can only be"
            " set while 1006h is 0.",
            [] if row.last_seq is None else [row.last_seq],
        )


def _others(facts: Facts, row: SyncRow) -> dict[int, int]:
    """1019h of each node that takes a SYNC and was told another counter than it has."""
    sure = row.counter_max is None or row.counter_wraps >= SURE
    if row.count < ENOUGH or row.last_ns is None or row.period_us is None or not sure:
        return {}
    shadow, bus = facts.context.shadow, facts.number(row.bus)
    settled_ns = row.last_ns - ENOUGH * row.period_us.median * 1000
    found: dict[int, int] = {}
    for node in shadow.nodes_of(bus):
        known = shadow.get(bus, node, OVERFLOW)
        if known is None or not known.confirmed or not isinstance(known.value, int):
            continue
        late = known.t_ns is not None and known.t_ns > settled_ns
        takes = known.value != 1 and sync_id(shadow, bus, node) == row.cob_id
        if takes and not late and known.value != (row.counter_max or 0):
            found[node] = known.value
    return found


RULES: tuple[Rule, ...] = (
    Rule(
        "sync.counter_setting",
        "The counter in SYNC is not the one that nodes were told to expect (1019h).",
        "The last SYNC; the setting itself is in the object history.",
        (
            "Only where the node itself told or acknowledged 1019h, and 50 SYNCs came after that.",
            "Only where the counter began again three times from the same number, or is not there.",
        ),
        _counter,
    ),
)
