"""LSS frames in words (CiA 305)."""

from syncline_schemas.records import dataclass

COMMANDS: dict[int, str] = {
    0x04: "switch state global",
    0x11: "configure node-ID",
    0x13: "configure bit timing",
    0x15: "activate bit timing",
    0x17: "store configuration",
    0x40: "switch state selective vendor-ID",
    0x41: "switch state selective product code",
    0x42: "switch state selective revision number",
    0x43: "switch state selective serial number",
    0x44: "switch state selective answer",
    0x46: "identify remote slave vendor-ID",
    0x47: "identify remote slave product code",
    0x48: "identify remote slave revision number low",
    0x49: "identify remote slave revision number high",
    0x4A: "identify remote slave serial number low",
    0x4B: "identify remote slave serial number high",
    0x4C: "identify non-configured remote slave",
    0x4F: "identify slave",
    0x50: "identify non-configured slave",
    0x51: "fastscan",
    0x5A: "inquire vendor-ID",
    0x5B: "inquire product code",
    0x5C: "inquire revision number",
    0x5D: "inquire serial number",
    0x5E: "inquire node-ID",
}
"""Name by command specifier, byte 0 of a frame on 7E4h or 7E5h."""


def command_name(specifier: int) -> str:
    """Name of an LSS command specifier.

    >>> command_name(0x5A), command_name(0xFF)
    ('inquire vendor-ID', 'unknown FFh')
    """
    return COMMANDS.get(specifier, f"unknown {specifier:02X}h")


BIT_RATES: dict[int, int] = {
    0: 1_000_000,
    1: 800_000,
    2: 500_000,
    3: 250_000,
    4: 125_000,
    6: 50_000,
    7: 20_000,
    8: 10_000,
}
"""Bit rate [bit/s] by index of the standard table (CiA 305, table selector 0)."""
_AUTOMATIC = 9
UNCONFIGURED = 0xFF
"""Node-ID of a device that has none."""

_MODES = {0: "waiting", 1: "configuration"}
_REFUSALS: dict[int, dict[int, str]] = {
    0x11: {1: "node-ID out of range"},
    0x13: {1: "bit timing not supported"},
    0x17: {1: "storing not supported", 2: "storage medium failed"},
}
"""Error codes of the answers, by command specifier."""
_NUMBERS = frozenset({*range(0x40, 0x44), *range(0x46, 0x4C)})
_INQUIRED = frozenset(range(0x5A, 0x5E))


@dataclass(frozen=True, slots=True)
class LssFrame:
    """One LSS frame: the name of its command, what it says in words, and its numbers by name.

    `values` may hold `node_id`, `bit_rate` [bit/s], `delay_ms`, `mode`, `number`, `error`,
    `table`, `index`, `bit`, `sub` and `next`.
    """

    command: str
    text: str
    values: dict[str, int]

    @property
    def refused(self) -> bool:
        """Whether a slave says that it could not do what was asked."""
        return bool(self.values.get("error"))


def decode_frame(data: bytes, *, request: bool) -> LssFrame:
    """Decode a frame of 7E5h (`request`) or 7E4h; missing bytes count as 0 and are told.

    >>> decode_frame(bytes([0x11, 5, 0, 0, 0, 0, 0, 0]), request=True).text
    'configure node-ID: 5'
    >>> decode_frame(bytes([0x13, 1, 0, 0, 0, 0, 0, 0]), request=False).text
    'configure bit timing: refused, bit timing not supported'
    """
    if not data:
        return LssFrame("empty", "empty frame", {})
    full = data[:8].ljust(8, b"\0")
    name = command_name(full[0])
    said, values = (_request if request else _answer)(full)
    text = f"{name}: {said}" if said else name
    if len(data) != 8:
        text += f" ({len(data)} bytes instead of 8)"
    return LssFrame(name, text, values)


def _request(data: bytes) -> tuple[str, dict[str, int]]:
    command, number = data[0], int.from_bytes(data[1:5], "little")
    if command == 0x04:
        return _MODES.get(data[1], f"mode {data[1]}"), {"mode": data[1]}
    if command == 0x11:
        said = "none (unconfigured)" if data[1] == UNCONFIGURED else str(data[1])
        return said, {"node_id": data[1]}
    if command == 0x13:
        return _bit_timing(data[1], data[2])
    if command == 0x15:
        delay_ms = int.from_bytes(data[1:3], "little")
        return f"after {delay_ms} ms", {"delay_ms": delay_ms}
    if command in _NUMBERS:
        return f"{number:08X}h", {"number": number}
    if command == 0x51:
        if data[5] == 0x80:
            return "start, all unconfigured slaves answer", {"bit": data[5]}
        values = {"number": number, "bit": data[5], "sub": data[6], "next": data[7]}
        return f"{number:08X}h, from bit {data[5]}, part {data[6]}", values
    return "", {}


def _answer(data: bytes) -> tuple[str, dict[str, int]]:
    command, number = data[0], int.from_bytes(data[1:5], "little")
    if command in _REFUSALS:
        return _result(command, data[1], data[2])
    if command in _INQUIRED:
        return f"{number:08X}h", {"number": number}
    if command == 0x5E:
        said = "none (unconfigured)" if data[1] == UNCONFIGURED else str(data[1])
        return said, {"node_id": data[1]}
    return "", {}


def _result(command: int, error: int, specific: int) -> tuple[str, dict[str, int]]:
    if not error:
        return "done", {"error": 0}
    reason = _REFUSALS[command].get(error, f"error {error}")
    if error == 0xFF:
        reason = f"maker's error {specific}"
    return f"refused, {reason}", {"error": error}


def _bit_timing(table: int, index: int) -> tuple[str, dict[str, int]]:
    values = {"table": table, "index": index}
    if table == 0 and index in BIT_RATES:
        return f"{BIT_RATES[index] // 1000} kbit/s", {**values, "bit_rate": BIT_RATES[index]}
    if table == 0 and index == _AUTOMATIC:
        return "automatic detection", values
    return f"entry {index} of table {table}", values
