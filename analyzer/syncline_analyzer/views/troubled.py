"""Which nodes are worth a look before the others."""

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.events import CLEARING, RESET
from syncline_schemas.canopen.nmt import NmtState

NodeKey = tuple[str, int]
"""(bus, node)"""

_FOUND = {"error": 0, "warning": 1}
_TOLD = 2


def troubled(analysis: Analysis) -> dict[NodeKey, int]:
    """Rank of each node that something is to be seen of: 0 an error, 1 a warning, 2 the rest.

    The rest are nodes that sent an EMCY, were lost or stopped, without a finding of their own.
    """
    ranks: dict[NodeKey, int] = {}
    for finding in analysis.findings:
        rank = _FOUND.get(finding.severity)
        if rank is not None and finding.bus is not None and finding.node:
            _note(ranks, (finding.bus, finding.node), rank)
    for emcy in analysis.emcy:
        if emcy.transition not in (*CLEARING, RESET):
            _note(ranks, (emcy.bus, emcy.node), _TOLD)
    for state in analysis.nmt_states:
        if state.state in (NmtState.LOST, NmtState.STOPPED):
            _note(ranks, (state.bus, state.node), _TOLD)
    return ranks


def _note(ranks: dict[NodeKey, int], key: NodeKey, rank: int) -> None:
    ranks[key] = min(rank, ranks.get(key, rank))
