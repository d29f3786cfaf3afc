"""What happened between two looks at the recorder, in words for its own log."""

from collections.abc import Iterator

from syncline_logger.live_status import BusSnapshot, StatusSnapshot
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.wording import counted


def status_changes(before: StatusSnapshot | None, now: StatusSnapshot) -> list[str]:
    """One line for each thing worth a line, None = the first look."""
    changes = []
    if before is None or before.path != now.path:
        changes.append(f"writing {now.path}")
    if before is not None and now.gaps > before.gaps:
        changes.append(f"{counted(now.gaps - before.gaps, 'gap')} noted")
    trouble = before.trouble if before else ""
    if now.trouble != trouble:
        changes.append(now.trouble or "the disk can be written again")
    known = {bus.name: bus for bus in before.buses} if before else {}
    for bus in now.buses:
        changes += [f"{bus.name}: {text}" for text in _bus_changes(known.get(bus.name), bus)]
    return changes


def _bus_changes(before: BusSnapshot | None, now: BusSnapshot) -> Iterator[str]:
    was_present, was_state, lost, nodes = (
        (before.adapter_present, before.state, before.dropped_frames, before.nodes)
        if before
        else (True, "unknown", 0, {})
    )
    if now.adapter_present != was_present:
        yield "the adapter is back" if now.adapter_present else "the adapter is lost"
    if now.state != was_state:
        yield f"the controller went from {was_state} to {now.state}"
    if now.dropped_frames > lost:
        yield f"{counted(now.dropped_frames - lost, 'frame')} lost, {now.dropped_frames} in all"
    for node, state in now.nodes.items():
        was = nodes.get(node)
        if was is None:
            yield f"node {node} is heard, {state}"
        elif (was == NmtState.LOST) != (state == NmtState.LOST):
            yield f"node {node} went from {was} to {state}"
