"""What to check next after an EMCY, by its code."""

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


def check_next(code: int) -> str:
    """What to check after an error.

    >>> check_next(0x3120)[:18], check_next(0xFF01) == MANUAL
    ('Measure the supply', True)
    """
    hint = EXACT.get(code) or HINTS.get(code >> 12)
    return f"{hint} {MANUAL}" if hint else MANUAL
