"""NMT states of a node as a row of cells, in which no state is too short to be seen."""

import numpy as np

from syncline_analyzer.results import Analysis, NmtStateRow
from syncline_analyzer.views.palette import URGENCY

Lanes = dict[tuple[str, int], list[NmtStateRow]]


def lanes_of(analysis: Analysis) -> Lanes:
    """Intervals by (bus, node), nodes in ascending order."""
    lanes: Lanes = {}
    for row in sorted(analysis.nmt_states, key=lambda row: (row.bus, row.node)):
        lanes.setdefault((row.bus, row.node), []).append(row)
    return lanes


def cells(rows: list[NmtStateRow], start_ns: int, end_ns: int, width: int) -> list[str]:
    """State shown in each of `width` equal cells of a stretch; "" where nothing is known.

    Where several states share a cell the most urgent one wins, so that a node that was lost for a
    millisecond is seen.
    """
    shown = np.full(width, -1, np.int64)
    span = max(end_ns - start_ns, 1)
    for row in rows:
        first = (row.start_ns - start_ns) * width // span
        last = max(first + 1, -((start_ns - row.end_ns) * width // span))
        part = slice(max(min(first, width - 1), 0), max(last, 0))
        shown[part] = np.maximum(shown[part], URGENCY.index(row.state))
    return [URGENCY[rank] if rank >= 0 else "" for rank in shown.tolist()]
