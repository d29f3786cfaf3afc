"""Which numbers are nodes, and their rows."""

from collections.abc import Iterable

from syncline_analyzer.context import Context
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.folds.nmt.table import NodeKey, NodeNmt
from syncline_analyzer.folds.sdo.fold import SdoNodeCounts
from syncline_analyzer.identification import identification
from syncline_analyzer.results import NodeRow, PdoRow
from syncline_schemas.canopen.nmt import NmtState

FRAGMENT = 4
"""Segments in order that prove a transfer whose beginning is not in the capture."""


def node_rows(
    context: Context, control: ControlTables, pdos: Iterable[PdoRow] = ()
) -> list[NodeRow]:
    """Rows of all nodes that something on the bus proves or claims, by bus and number.

    A number that only a master called for is none, nor is one that only frames without any other
    sign of CANopen on their bus would make one. `pdos` give the PDO frames that a node sent.
    """
    listed = proofs(control)
    own = _own_pdos(context, pdos)
    return [_row(context, control, key, listed[key], own.get(key, [])) for key in sorted(listed)]


def proofs(control: ControlTables) -> dict[NodeKey, list[str]]:
    """What lists each node: "error control", "emcy", "sdo answer", "pdo", "pdo (guess)"."""
    alive = [key for key, node in control.nmt.nodes.items() if node.alive]
    found: dict[NodeKey, list[str]] = {}
    for key in alive:
        found.setdefault(key, []).append("error control")
    for key, count in control.emcy.counts.items():
        if count:
            found.setdefault(key, []).append("emcy")
    for key, sdo in control.sdo.counts.items():
        if sdo.confirmed or (sdo.answers and _fragment(sdo, control, key)):
            found.setdefault(key, []).append("sdo answer")
    for key, node in control.nmt.nodes.items():
        if node.pdos != "no":
            word = "pdo" if node.pdos == "bound" else "pdo (guess)"
            found.setdefault(key, []).append(word)
    return found


def _fragment(sdo: SdoNodeCounts, control: ControlTables, key: NodeKey) -> bool:
    """A server heard in the middle of a block transfer, with its client: segments count up."""
    strays = control.sdo.strays.get(key)
    return strays is not None and strays.requests > 0 and strays.numbered >= FRAGMENT


def _row(
    context: Context, control: ControlTables, key: NodeKey, proof: list[str], pdos: list[PdoRow]
) -> NodeRow:
    bus, node = key
    identity = identification(context, bus, node, pdos)
    nmt = control.nmt.nodes.get(key, NodeNmt())
    sdo = control.sdo.counts.get(key, SdoNodeCounts())
    device = context.shadow.device(bus, node)
    period_ns = nmt.heartbeat_period_ns if nmt.counts.heartbeats > 1 else None
    return NodeRow(
        bus=context.bus_name(bus),
        node=node,
        name=context.shadow.name(bus, node),
        device=device.name if device else None,
        boot_ups=nmt.counts.boot_ups,
        heartbeats=nmt.counts.heartbeats,
        heartbeat_period_ms=period_ns / 1e6 if period_ns is not None else None,
        guard_requests=nmt.counts.guard_requests,
        guard_answers=nmt.counts.guard_answers,
        toggle_errors=nmt.counts.toggle_errors,
        emcy=control.emcy.counts.get(key, 0),
        sdo_transfers=sdo.transfers,
        sdo_aborts=sdo.aborts,
        sdo_unanswered=sdo.unanswered,
        pdo_frames=sum(pdo.frames for pdo in pdos),
        state_share=nmt.share,
        final_state=nmt.final_state if key in control.nmt.nodes else NmtState.UNKNOWN.value,
        proof=proof,
        heartbeat_period_us=nmt.period_us,
        guard_period_us=nmt.guarding.periods.quantiles() if nmt.counts.guard_answers else None,
        guard_missed=nmt.guarding.missed,
        confirmed_ms=nmt.confirmed_ms,
        boot_ms=nmt.boot_ms,
        device_source=identity.source,
        device_reason=identity.reason,
        device_guess=identity.guesses,
    )


def _own_pdos(context: Context, pdos: Iterable[PdoRow]) -> dict[NodeKey, list[PdoRow]]:
    """TPDOs by the node that sends them."""
    numbers = {name: number for number, name in enumerate(context.buses)}
    found: dict[NodeKey, list[PdoRow]] = {}
    for pdo in pdos:
        if pdo.node is not None and (pdo.pdo or "").startswith("TPDO") and pdo.bus in numbers:
            found.setdefault((numbers[pdo.bus], pdo.node), []).append(pdo)
    return found
