"""NMT commands and states (CiA 301 7.3.2.1, 7.3.2.2)."""

from enum import StrEnum

COMMANDS: dict[int, str] = {
    0x01: "start",
    0x02: "stop",
    0x80: "enter pre-operational",
    0x81: "reset node",
    0x82: "reset communication",
}
"""Name by command specifier; any other value is written as "unknown XXh"."""
RESETS = (0x81, 0x82)
"""Command specifiers after which a node starts anew."""


class NmtState(StrEnum):
    """State of a node as the analyzer tells it (analysis.md section 4)."""

    INITIALISING = "INITIALISING"
    PRE_OPERATIONAL = "PRE-OPERATIONAL"
    OPERATIONAL = "OPERATIONAL"
    STOPPED = "STOPPED"
    LOST = "LOST"
    UNKNOWN = "UNKNOWN"


STATE_OF_BYTE: dict[int, NmtState] = {
    0x00: NmtState.INITIALISING,
    0x04: NmtState.STOPPED,
    0x05: NmtState.OPERATIONAL,
    0x7F: NmtState.PRE_OPERATIONAL,
}
"""State by bits 6..0 of a heartbeat or guard answer (CiA 301 table 45)."""

STATE_AFTER_COMMAND: dict[int, NmtState] = {
    0x01: NmtState.OPERATIONAL,
    0x02: NmtState.STOPPED,
    0x80: NmtState.PRE_OPERATIONAL,
    0x81: NmtState.INITIALISING,
    0x82: NmtState.INITIALISING,
}


def command_name(specifier: int) -> str:
    """Name of an NMT command specifier.

    >>> command_name(0x81), command_name(0x7)
    ('reset node', 'unknown 07h')
    """
    return COMMANDS.get(specifier, f"unknown {specifier:02X}h")
