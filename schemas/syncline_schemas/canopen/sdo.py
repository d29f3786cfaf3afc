"""SDO vocabulary: command specifiers and abort codes (CiA 301 7.2.4.3, table 22)."""

from enum import IntEnum


class ClientCommand(IntEnum):
    """Bits 7..5 of byte 0 of a request (600h + node)."""

    DOWNLOAD_SEGMENT = 0
    INITIATE_DOWNLOAD = 1
    INITIATE_UPLOAD = 2
    UPLOAD_SEGMENT = 3
    ABORT = 4
    BLOCK_UPLOAD = 5
    BLOCK_DOWNLOAD = 6
    UNKNOWN = 7


class ServerCommand(IntEnum):
    """Bits 7..5 of byte 0 of an answer (580h + node)."""

    UPLOAD_SEGMENT = 0
    DOWNLOAD_SEGMENT = 1
    INITIATE_UPLOAD = 2
    INITIATE_DOWNLOAD = 3
    ABORT = 4
    BLOCK_DOWNLOAD = 5
    BLOCK_UPLOAD = 6
    UNKNOWN = 7


SAVE_SIGNATURE = 0x65766173
"""`save`, to be written to 1010h."""
LOAD_SIGNATURE = 0x64616F6C
"""`load`, to be written to 1011h."""

ABORT_CODES: dict[int, str] = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "SDO protocol timed out",
    0x05040001: "client/server command specifier not valid or unknown",
    0x05040002: "invalid block size",
    0x05040003: "invalid sequence number",
    0x05040004: "CRC error",
    0x05040005: "out of memory",
    0x06010000: "unsupported access to an object",
    0x06010001: "read of a write-only object",
    0x06010002: "write to a read-only object",
    0x06010003: "subindex cannot be written, subindex 0 has to be 0 for write access",
    0x06010004: "complete access not supported",
    0x06010005: "object length exceeds the mailbox size",
    0x06010006: "object mapped to an RPDO, download blocked",
    0x06020000: "object does not exist",
    0x06040041: "object cannot be mapped to the PDO",
    0x06040042: "mapped objects would exceed the PDO length",
    0x06040043: "general parameter incompatibility",
    0x06040047: "general internal incompatibility in the device",
    0x06060000: "access failed due to a hardware error",
    0x06070010: "data type or length of the service parameter does not match",
    0x06070012: "data type does not match, length too high",
    0x06070013: "data type does not match, length too low",
    0x06090011: "subindex does not exist",
    0x06090030: "invalid value for the parameter",
    0x06090031: "value too high",
    0x06090032: "value too low",
    0x06090036: "maximum value is less than minimum value",
    0x060A0023: "resource not available: SDO connection",
    0x08000000: "general error",
    0x08000020: "data cannot be transferred or stored",
    0x08000021: "data cannot be transferred or stored because of local control",
    0x08000022: "data cannot be transferred or stored in the present device state",
    0x08000023: "object dictionary not present or its generation failed",
    0x08000024: "no data available",
}
"""Words for the abort codes of CiA 301, and for 0601 0003..6 that devices took from ETG.1000."""


_GROUPS = {
    0x0503: "toggle bit",
    0x0504: "protocol",
    0x0601: "access to the object",
    0x0602: "object",
    0x0604: "mapping or compatibility",
    0x0606: "hardware",
    0x0607: "data type or length",
    0x0609: "subindex or value",
    0x060A: "resources",
    0x0800: "device or its present state",
}
"""What a code that no standard lists is about, by its upper half (error class and error code)."""


def abort_meaning(code: int) -> str:
    """Words for an SDO abort code, without its number.

    Codes of a maker's own are told by their group; codes sent high byte first are recognised.

    >>> abort_meaning(0x06020000), abort_meaning(0x12345678)
    ('object does not exist', 'unknown code')
    >>> abort_meaning(0x06090099), abort_meaning(0x00000206)
    ('unknown code about subindex or value', 'object does not exist (its bytes are exchanged)')
    """
    if code in ABORT_CODES:
        return ABORT_CODES[code]
    exchanged = int.from_bytes(code.to_bytes(4, "little"), "big")
    if exchanged in ABORT_CODES:
        return f"{ABORT_CODES[exchanged]} (its bytes are exchanged)"
    group = _GROUPS.get(code >> 16)
    return f"unknown code about {group}" if group else "unknown code"
