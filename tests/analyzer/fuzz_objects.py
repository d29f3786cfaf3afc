"""The object dictionary as the analyzer knows it, against that of the simulated devices."""

from collections.abc import Iterator

from tests.analyzer.fuzz_case import Case
from tests.analyzer.fuzz_rows import twins

_ACTS = (0x1003, 0x1010, 0x1011, 0x2002, 0x207F)
"""What is written there is an order, not a value."""


def objects(case: Case) -> Iterator[str]:
    """At the end a node holds what it was seen to take over, and what a reset left of it.

    A node that fell silent may have lost what it held; where the recorder was deaf, it may have
    heard only half of what happened.
    """
    if case.deaf:
        return
    gone = {row.node for row in case.analysis.nodes if row.final_state in ("LOST", "INITIALISING")}
    for row in case.analysis.objects:
        told = row.source == "sdo-write" or row.cause == "reset"
        node = case.numbered.get(row.node)
        if not told or node is None or row.node in gone | twins(case) or row.index in _ACTS:
            continue
        true = node.objects.number(row.index, row.sub)
        if isinstance(row.value, int) and row.value != true:
            where = f"{row.index:04X}h:{row.sub} of node {row.node}"
            yield f"{where} is {true}, not {row.value} ({row.source}, {row.cause})"
