"""EMCY codes and the error register (CiA 301 7.2.7.1 table 27, 7.5.2.2)."""

EMCY_BYTES = 8
UNKNOWN = "unknown code"

CODES: dict[int, str] = {
    0x0000: "error reset or no error",
    0x1000: "generic error",
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error",
    0x8140: "recovered from bus-off",
    0x8150: "CAN-ID collision",
    0x8210: "PDO not processed, length error",
    0x8220: "PDO length exceeded",
    0x8230: "DAM MPDO not processed, destination object not available",
    0x8240: "unexpected SYNC data length",
    0x8250: "RPDO timeout",
}
"""Meaning of exact codes."""

GROUPS: dict[int, str] = {
    0x00: "error reset or no error",
    0x10: "generic error",
    0x20: "current",
    0x21: "current, device input side",
    0x22: "current inside the device",
    0x23: "current, device output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "device specific",
}
"""Meaning of a code group by its high byte."""

REGISTER_BITS: dict[int, str] = {
    0: "generic",
    1: "current",
    2: "voltage",
    3: "temperature",
    4: "communication",
    5: "device profile",
    6: "reserved",
    7: "manufacturer",
}
"""Bits of the error register 1001h."""


def code_meaning(code: int) -> str:
    """Words for an EMCY code, without its number: the exact code, else its group.

    >>> code_meaning(0x8130), code_meaning(0x3141), code_meaning(0x1234)
    ('life guard or heartbeat error', 'mains voltage', 'unknown code')
    """
    if code in CODES:
        return CODES[code]
    high = code >> 8
    group = GROUPS.get(high) or (GROUPS.get(high & 0xF0) if 0x20 <= high < 0x90 else None)
    return group or UNKNOWN


_GROUP_BITS = {0x2: 1, 0x3: 2, 0x4: 3, 0x8: 4}
"""Register bit by the first digit of a code: current, voltage, temperature, communication."""


def group_bit(code: int) -> int | None:
    """Bit of the error register that goes with a code's group (CiA 301 7.5.2.2), None for others.

    Monitoring that is no communication (80xxh) has none.

    >>> group_bit(0x3110), group_bit(0x8130), group_bit(0x5530)
    (2, 4, None)
    """
    return None if code >> 8 == 0x80 else _GROUP_BITS.get(code >> 12)


def short_message(data: bytes, meaning: str = "") -> str:
    """What is wrong with an EMCY of fewer than eight bytes (CiA 301 7.2.7.3), and what it may be.

    `meaning` are the words for its code, where it has one.

    >>> short_message(b"")
    'EMCY with 0 instead of 8 bytes: the boot-up of a device made after CiA DS-301 V3'
    >>> short_message(bytes.fromhex("3081"), "life guard or heartbeat error")
    'EMCY with 2 instead of 8 bytes: only the code 8130h (life guard or heartbeat error)'
    """
    text = f"EMCY with {len(data)} instead of 8 bytes"
    if not data:
        return f"{text}: the boot-up of a device made after CiA DS-301 V3"
    if len(data) == 1:
        return f"{text}: a SYNC with counter {data[0]}, or half a code"
    code = f"code {int.from_bytes(data[:2], 'little'):04X}h"
    named = f"{code} ({meaning})" if meaning else code
    if len(data) == 2:
        return f"{text}: only the {named}"
    missing = EMCY_BYTES - len(data)
    return f"{text}: {named}, register {data[2]:02X}h, {missing} of the maker's 5 bytes missing"


def register_bits(register: int, names: dict[int, str] | None = None) -> list[str]:
    """Names of the bits that are set in an error register, lowest first.

    >>> register_bits(0x11)
    ['generic', 'communication']
    """
    known = REGISTER_BITS if names is None else names
    return [known.get(bit, f"bit {bit}") for bit in range(8) if register >> bit & 1]
