"""When a node was OPERATIONAL, as its PDOs are judged by it."""

from collections.abc import Sequence
from dataclasses import replace

from syncline_analyzer.folds.nmt.events import UNASKED, UNSEEN
from syncline_analyzer.folds.timing.rhythm import Operational
from syncline_analyzer.results import NmtStateRow

_OTHER_STATES = {"INITIALISING", "PRE-OPERATIONAL", "STOPPED"}


def operational(
    rows: Sequence[NmtStateRow], bus: str, node: int, gap_starts: set[int]
) -> list[Operational] | None:
    """When a node was OPERATIONAL; None when nothing at all is known of its state.

    It left that state unless the recorder stopped listening: an UNKNOWN that no gap begins comes
    from a silence of the whole bus. A guarded node that nobody asks any more has left no state:
    its PDOs are due as before.
    """
    of_node = unstepped([row for row in rows if row.bus == bus and row.node == node])
    if all(row.state == "UNKNOWN" for row in of_node):
        return None
    stretches = _stretches(of_node)
    left = [
        state != "UNKNOWN" or after[0].start_ns not in gap_starts for state, after in stretches[1:]
    ]
    before = ["UNKNOWN", *(state for state, _ in stretches)]
    return [
        Operational(
            stretch[0].start_ns,
            stretch[-1].end_ns,
            is_left,
            earlier in _OTHER_STATES,
            -1 if stretch[0].evidence is None else stretch[0].evidence,
        )
        for (state, stretch), is_left, earlier in zip(
            stretches, [*left, False], before, strict=False
        )
        if state == "OPERATIONAL"
    ]


def unstepped(rows: Sequence[NmtStateRow]) -> list[NmtStateRow]:
    """Intervals of a node without the cuts where the clock stepped back.

    One that ends before it began has no length: of times that the stamps tell twice nothing is said.
    """
    found: list[NmtStateRow] = []
    for row in rows:
        last = found[-1] if found else None
        if last is not None and row.state == last.state and row.start_ns < last.end_ns:
            found[-1] = replace(last, end_ns=max(last.start_ns, row.end_ns))
        else:
            found.append(row)
    return found


def _stretches(rows: Sequence[NmtStateRow]) -> list[tuple[str, list[NmtStateRow]]]:
    """Rows in a row of one state, and those that tell no other one."""
    found: list[tuple[str, list[NmtStateRow]]] = []
    for row in rows:
        if found and (row.state == found[-1][0] or row.cause.startswith((UNASKED, UNSEEN))):
            found[-1][1].append(row)
        else:
            found.append((row.state, [row]))
    return found
