"""Identifiers that nodes give to SYNC and EMCY at any moment (CiA 301 7.5.2)."""

from collections.abc import Iterable

from syncline_analyzer.shadow import Shadow

OFF = 1 << 31
"""Bit 31 of 1014h, 1200h and 180xh:1: the service does not exist."""
PRODUCES = 1 << 30
"""Bit 30 of 1005h and 1012h: the node sends SYNC or TIME."""
FRAME_29_BIT = 1 << 29
SYNC, EMCY = 0x1005, 0x1014


def cob_id(value: int) -> int | None:
    """Identifier of 11 bits in a COB-ID, None where the service is off or has 29 bits.

    >>> cob_id(0x185), cob_id(0x80000185), cob_id(0x20000185)
    (389, None, None)
    """
    return None if value & (OFF | FRAME_29_BIT) else value & 0x7FF


def sync_id(shadow: Shadow, bus: int, node: int, seq: int | None = None) -> int:
    """Identifier of the SYNC that a node takes or sends (1005h), 080h unless it is told otherwise.

    Bit 30 says that the node is the producer, bit 31 means nothing (CiA 301 7.5.2.5).
    """
    value = shadow.number(bus, node, SYNC, 0, seq)
    if value is None or value & FRAME_29_BIT or not value & 0x7FF:
        return 0x80
    return value & 0x7FF


def moved_emcy_id(shadow: Shadow, bus: int, node: int, seq: int | None = None) -> int | None:
    """Identifier to which 1014h moves the EMCYs of a node, None where they are where all are.

    A device's default is no proof: some files state 080h for every node.
    """
    known = shadow.get(bus, node, EMCY, 0, seq)
    if known is None or known.source == "eds-default" or not isinstance(known.value, int):
        return None
    found = cob_id(known.value)
    return None if found in (None, 0, 0x80, 0x80 + node) else found


def changes_of(
    shadow: Shadow, bus: int, nodes: Iterable[int], index: int, first: int, last: int
) -> set[int]:
    """Moments `first < seq <= last` at which a variable of any of the nodes changed."""
    return {
        seq for node in nodes for seq in shadow.changes(bus, node, index) if first < seq <= last
    }
