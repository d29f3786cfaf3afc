"""Likely cause of an EMCY and what to check next, by its code."""

from syncline_analyzer.findings.rule import Facts

CAUSES: dict[int, str] = {
    0x2: "Too much current: a short circuit or an overload at the node's outputs, or inside of it.",
    0x3: "A voltage of the node is too low or too high: weak supply, long cable, or a load that is"
    " switched.",
    0x4: "The node is too hot or too cold: its surroundings, its cooling, or its load.",
    0x5: "A part of the node's electronics, for example its memory, failed the node's own test.",
    0x6: "The node's firmware stumbled, or its stored data do not fit.",
    0x7: "A sensor or module that belongs to the node delivers nothing valid.",
    0x9: "Something outside of the node, which it watches, is not as it should be.",
}
"""Likely cause by the first digit of the code."""
EXACT_CAUSES: dict[int, str] = {
    0x7510: "The node's frames are destroyed on the wire.",
    0x8110: "Frames came faster than the node could read them; some are lost to it.",
    0x8120: "Frames from or to the node are destroyed on the wire: plug, cable, termination, or"
    " another bit rate.",
    0x8130: "What the node watches (heartbeat or guarding) did not come in time.",
    0x8140: "Frames of the node were destroyed on the wire until it switched itself off the bus.",
    0x8150: "Another node sends on an identifier of this node.",
    0x8210: "A PDO that the node receives is shorter than its mapping.",
    0x8220: "A PDO that the node receives is longer than its mapping.",
    0x8240: "The SYNC has a counter that the node does not expect, or lacks the one it expects.",
    0x8250: "A PDO that the node waits for did not come in time.",
}
"""Likely cause by the whole code; goes before that of the group."""
UNNAMED = (
    "The node names no cause: only its manual tells what this code and the maker's bytes mean."
)

HINTS: dict[int, str] = {
    0x2: "Look for a short circuit or an overload at the outputs of the node.",
    0x3: "Measure the supply at the node's connector, also under load and when motors start.",
    0x4: "Check the temperature at the node, its cooling and its load.",
    0x5: "Restart the node once; replace it if the error comes back.",
    0x6: "Note the software version; look for supply dips and interference before the moment.",
    0x7: "Check the sensor or module that the code names, its cable and its mounting.",
    0x9: "Check what is wired to the node; its fault lies outside of it.",
}
"""Hint by the first digit of the code."""
EXACT: dict[int, str] = {
    0x7510: "Check cable, plugs and terminating resistors (60 ohm between CAN_H and CAN_L).",
    0x8110: "Look at the bus load and at bursts just before: the node could not keep up.",
    0x8120: "Check cable, plugs and terminating resistors (60 ohm between CAN_H and CAN_L).",
    0x8130: "Look at the node that it watches, or at the master that should guard it.",
    0x8150: "Two senders share an identifier: compare node ids and the COB-IDs of all PDOs.",
    0x8210: "Compare the length of the PDO that is sent with the node's mapping 160xh.",
    0x8220: "Compare the length of the PDO that is sent with the node's mapping 160xh.",
    0x8240: "Compare the length of the SYNC with 1019h of the node.",
    0x8250: "Look for the RPDO that did not come in time, and for its sender.",
}
"""Hint by the whole code; goes before that of the group."""
MANUAL = "Look the code up in the device's manual; read 1001h and 1003h of the node."


_GROUPED = range(0x2, 0x8)
"""First digits that CiA 301 only names; device profiles divide them."""
_COVERED = (401, 406, 410)
"""Profiles of I/O modules, encoders and inclinometers: the hints by group are written for them."""
_PROFILES = range(401, 500)


def explained(facts: Facts, bus: str, node: int, code: int) -> tuple[str, str]:
    """The likely cause of a node's error, and what to check next.

    Where the node says that it has another profile, and nothing else is known of it, a code that
    CiA 301 leaves to the profiles is not explained by its group.
    """
    number = facts.number(bus)
    shadow = facts.context.shadow
    profile = (shadow.number(number, node, 0x1000) or 0) & 0xFFFF
    known = shadow.device(number, node) is not None or profile in _COVERED
    if known or profile not in _PROFILES or code >> 12 not in _GROUPED:
        return likely_cause(code), check_next(code)
    cause = (
        "CiA 301 tells only the group of this code; what it means is left to the device's profile"
        f" (CiA {profile} by its 1000h) and to its maker."
    )
    return cause, MANUAL


def likely_cause(code: int) -> str:
    """The likely cause of an error.

    >>> likely_cause(0x8220), likely_cause(0x1000) == UNNAMED
    ('A PDO that the node receives is longer than its mapping.', True)
    """
    return EXACT_CAUSES.get(code) or CAUSES.get(code >> 12) or UNNAMED


def check_next(code: int) -> str:
    """What to check after an error.

    >>> check_next(0x3120)[:18], check_next(0xFF01) == MANUAL
    ('Measure the supply', True)
    """
    hint = EXACT.get(code) or HINTS.get(code >> 12)
    return f"{hint} {MANUAL}" if hint else MANUAL
