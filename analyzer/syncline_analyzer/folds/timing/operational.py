"""When a node was OPERATIONAL, as its PDOs are judged by it."""

from collections.abc import Sequence
from itertools import groupby

from syncline_analyzer.folds.timing.rhythm import Operational
from syncline_analyzer.results import NmtStateRow


def operational(
    rows: Sequence[NmtStateRow], bus: str, node: int, gap_starts: set[int]
) -> list[Operational] | None:
    """When a node was OPERATIONAL; None when nothing at all is known of its state.

    It left that state unless the recorder stopped listening: an UNKNOWN that no gap begins comes
    from a silence of the whole bus.
    """
    of_node = [row for row in rows if row.bus == bus and row.node == node]
    if all(row.state == "UNKNOWN" for row in of_node):
        return None
    stretches = [list(group) for _, group in groupby(of_node, key=lambda row: row.state)]
    left = [
        after[0].state != "UNKNOWN" or after[0].start_ns not in gap_starts
        for after in stretches[1:]
    ]
    return [
        Operational(stretch[0].start_ns, stretch[-1].end_ns, is_left)
        for stretch, is_left in zip(stretches, [*left, False], strict=False)
        if stretch[0].state == "OPERATIONAL"
    ]
