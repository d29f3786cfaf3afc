"""What the nodes of a bus were told about SYNC: who sends it, how often, with which counter."""

from collections.abc import Iterator

from syncline_analyzer.service_ids import PRODUCES, SYNC, sync_id
from syncline_analyzer.shadow import Known, Shadow

PERIOD, OVERFLOW = 0x1006, 0x1019
MAX_OVERFLOW = 240
"""Largest counter (CiA 301 7.5.2.17)."""


def producers(shadow: Shadow, bus: int, cob_id: int, seq: int | None = None) -> list[int]:
    """Nodes that are set to send a SYNC (1005h bit 30), as far as the bus or the user told."""
    found = []
    for node in shadow.nodes_of(bus):
        known = shadow.get(bus, node, SYNC, 0, seq)
        value = known.value if known is not None and known.source != "eds-default" else None
        if isinstance(value, int) and value & PRODUCES and value & 0x7FF == cob_id:
            found.append(node)
    return found


def told_period(
    shadow: Shadow, bus: int, cob_id: int, seq: int | None = None
) -> tuple[int, str] | None:
    """(1006h [us], where it comes from) of a SYNC; None where nobody told it.

    The producer's counts; else that of the nodes which take the SYNC, where all say the same.
    """
    sending = producers(shadow, bus, cob_id, seq)
    for node in sending:
        known = shadow.get(bus, node, PERIOD, 0, seq)
        if (value := _told(known)) and known is not None:
            return value, f"1006h of node {node} ({known.source})"
    if sending:
        return None
    taking = list(_of_takers(shadow, bus, cob_id, PERIOD, seq))
    values = {value for _, value, _ in taking}
    if len(values) != 1:
        return None
    node, value, source = taking[0]
    return value, f"1006h of node {node} that takes it ({source})"


def told_overflow(
    shadow: Shadow, bus: int, cob_id: int, seq: int | None = None
) -> tuple[int, str] | None:
    """(1019h, where it comes from) of a SYNC: the producer's, else that of a node that takes it.

    What only a device's EDS says comes last.
    """
    sending = producers(shadow, bus, cob_id, seq)
    taking = [node for node in shadow.nodes_of(bus) if sync_id(shadow, bus, node, seq) == cob_id]
    assumed = None
    for node in [*sending, *(node for node in taking if node not in sending)]:
        known = shadow.get(bus, node, OVERFLOW, 0, seq)
        if known is None or not isinstance(known.value, int):
            continue
        if not 1 < known.value <= MAX_OVERFLOW:
            continue
        found = known.value, f"1019h of node {node} ({known.source})"
        if known.source != "eds-default":
            return found
        assumed = assumed or found
    return assumed


def _of_takers(
    shadow: Shadow, bus: int, cob_id: int, index: int, seq: int | None
) -> Iterator[tuple[int, int, str]]:
    """(node, value, source) of an object of each node that takes a SYNC, where it is set."""
    for node in shadow.nodes_of(bus):
        known = shadow.get(bus, node, index, 0, seq)
        value = _told(known)
        if known is not None and value and sync_id(shadow, bus, node, seq) == cob_id:
            yield node, value, known.source


def _told(known: Known | None) -> int:
    """A value that the bus or the user told, 0 where it is off or only assumed."""
    if known is None or known.source == "eds-default" or not isinstance(known.value, int):
        return 0
    return known.value
