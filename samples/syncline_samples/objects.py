"""The object dictionary of a simulated node: running values, EEPROM and factory defaults."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from syncline_samples import abort

WIDTH = {"u8": 1, "u16": 2, "u32": 4, "i16": 2, "i32": 4}
"""Bytes by type; `str` has the length of its value."""


class SdoAbort(Exception):
    """The node refuses an access with an abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"abort {code:08X}h")
        self.code = code


@dataclass(frozen=True, slots=True)
class Object:
    """One entry: type, access (`ro`, `rw`, `wo`), factory value, whether `save` keeps it."""

    index: int
    sub: int
    kind: str
    access: str
    value: int | bytes
    kept: bool = False
    low: int | None = None
    high: int | None = None


@dataclass(slots=True)
class _Hooks:
    read: Callable[[], int | bytes] | None = None
    write: Callable[[int], None] | None = None


class ObjectDictionary:
    """Objects by (index, sub) with values in RAM and EEPROM.

    Hooks answer reads of values that live elsewhere (a position) and react to writes; a write hook
    runs before the value is taken over and may raise `SdoAbort`.
    """

    def __init__(self, objects: Iterable[Object]) -> None:
        self._objects = {(item.index, item.sub): item for item in objects}
        self._indexes = {index for index, _ in self._objects}
        self._hooks: dict[tuple[int, int], _Hooks] = {}
        self._factory = {key: item.value for key, item in self._objects.items()}
        self._eeprom = dict(self._factory)
        self._values = dict(self._factory)

    def on_read(self, index: int, sub: int, hook: Callable[[], int | bytes]) -> None:
        """Let a function give the value of an object."""
        self._hooks.setdefault((index, sub), _Hooks()).read = hook

    def on_write(self, index: int, sub: int, hook: Callable[[int], None]) -> None:
        """Let a function check and act on a value that a client writes."""
        self._hooks.setdefault((index, sub), _Hooks()).write = hook

    def number(self, index: int, sub: int = 0) -> int:
        """Running value of a number; 0 where the object does not exist."""
        value = self._values.get((index, sub), 0)
        return value if isinstance(value, int) else 0

    def put(self, index: int, sub: int, value: int | bytes) -> None:
        """Set a running value from inside the device."""
        self._values[index, sub] = value

    def commission(self, index: int, sub: int, value: int) -> None:
        """Set a value as if somebody had written and saved it before the simulation."""
        self._eeprom[index, sub] = self._values[index, sub] = value

    def save(self, low: int = 0, high: int = 0xFFFF) -> None:
        """Keep the running values of an index range, of those objects that are kept at all."""
        for key, item in self._objects.items():
            if item.kept and low <= key[0] <= high:
                self._eeprom[key] = self._values[key]

    def restore(self, low: int = 0, high: int = 0xFFFF) -> None:
        """Put the factory values of an index range into the EEPROM; running values stay."""
        for key in self._eeprom:
            if low <= key[0] <= high:
                self._eeprom[key] = self._factory[key]

    def reload(self, low: int = 0, high: int = 0xFFFF) -> None:
        """Take the values of the EEPROM, as after a reset."""
        self._values |= {key: each for key, each in self._eeprom.items() if low <= key[0] <= high}

    def renumber(self, before: int, after: int) -> None:
        """Give the identifiers that belong to a node id those of another one."""
        for index, sub in self._eeprom:
            if not _is_cob_id(index, sub):
                continue
            for values in (self._eeprom, self._factory):
                value = values[index, sub]
                if isinstance(value, int) and value & 0x7F == before:
                    values[index, sub] = value - before + after

    def _find(self, index: int, sub: int) -> Object:
        found = self._objects.get((index, sub))
        if found is None:
            raise SdoAbort(abort.NO_SUB if index in self._indexes else abort.NO_OBJECT)
        return found

    def read(self, index: int, sub: int) -> bytes:
        """Bytes of an object as a client gets them."""
        item = self._find(index, sub)
        if item.access == "wo":
            raise SdoAbort(abort.WRITE_ONLY)
        hook = self._hooks.get((index, sub))
        value = hook.read() if hook and hook.read else self._values[index, sub]
        if isinstance(value, bytes):
            return value
        width = WIDTH[item.kind]
        return (value & ((1 << 8 * width) - 1)).to_bytes(width, "little")

    def check_writable(self, index: int, sub: int) -> None:
        """Refuse a transfer of several steps before it begins."""
        if self._find(index, sub).access == "ro":
            raise SdoAbort(abort.READ_ONLY)

    def write(self, index: int, sub: int, data: bytes) -> None:
        """Take what a client writes; without a stated size the surplus bytes are ignored."""
        item = self._find(index, sub)
        if item.access == "ro":
            raise SdoAbort(abort.READ_ONLY)
        if item.kind == "str":
            self._values[index, sub] = data
            return
        width = WIDTH[item.kind]
        value = int.from_bytes(data[:width], "little", signed=item.kind.startswith("i"))
        if (item.low is not None and value < item.low) or (
            item.high is not None and value > item.high
        ):
            raise SdoAbort(abort.VALUE_RANGE)
        self._values_hook(index, sub, value)

    def _values_hook(self, index: int, sub: int, value: int) -> None:
        before = self._values[index, sub]
        self._values[index, sub] = value
        hook = self._hooks.get((index, sub))
        if hook and hook.write:
            try:
                hook.write(value)
            except SdoAbort:
                self._values[index, sub] = before
                raise


def _is_cob_id(index: int, sub: int) -> bool:
    if index == 0x1014:
        return sub == 0
    if index == 0x1200:
        return sub in (1, 2)
    return sub == 1 and (0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00)
