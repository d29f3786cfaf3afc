"""What is wrong with a device description file, beyond what keeps it from loading."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from syncline_schemas.canopen.datatypes import DATA_TYPES
from syncline_schemas.devices.catalog import load_device
from syncline_schemas.devices.model import Device
from syncline_schemas.eds import EdsWarning
from syncline_schemas.errors import DescriptionError

_MANDATORY = {0x1000: "device type", 0x1001: "error register", 0x1018: "identity"}
_MAPPINGS = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))
_PDO_BITS = 64


@dataclass(frozen=True, slots=True)
class FileCheck:
    """Outcome of a check; `problem` says why nothing in the file can be used, else it is None."""

    path: Path
    title: str
    variables: int
    warnings: tuple[EdsWarning, ...]
    problem: str | None = None

    @property
    def usable(self) -> bool:
        """Whether the file can be used."""
        return self.problem is None


def check_file(path: str | Path) -> FileCheck:
    """Check an EDS, DCF or device TOML file; never raises for what is in the file."""
    try:
        device = load_device(Path(path).absolute())
    except DescriptionError as error:
        return FileCheck(Path(path), "", 0, (), str(error))
    found = (*device.warnings, *_missing(device), *_mappings(device), *_limits(device))
    return FileCheck(Path(path), device.title, len(device.facts), found)


def _missing(device: Device) -> Iterator[EdsWarning]:
    for index, name in _MANDATORY.items():
        if index not in device.od.indices:
            yield EdsWarning("file", f"mandatory object {index:04X}h ({name}) is missing")


def _mappings(device: Device) -> Iterator[EdsWarning]:
    for index in sorted({index for index, _ in device.facts}):
        if any(index in span for span in _MAPPINGS):
            yield from _mapping(device, index)


def _mapping(device: Device, index: int) -> Iterator[EdsWarning]:
    count = device.default(index, 0, 1)
    total = 0
    for sub in range(1, min(count if isinstance(count, int) else 0, 64) + 1):
        entry = device.default(index, sub, 1)
        if isinstance(entry, int) and entry:
            total += entry & 0xFF
            yield from _mapped(device, f"[{index:04X}sub{sub:X}]", entry)
    if total > _PDO_BITS:
        yield EdsWarning(f"[{index:04X}]", f"maps {total} bits, a frame holds {_PDO_BITS}")


def _mapped(device: Device, where: str, entry: int) -> Iterator[EdsWarning]:
    index, sub, bits = entry >> 16 & 0xFFFF, entry >> 8 & 0xFF, entry & 0xFF
    facts = device.object(index, sub)
    if index in DATA_TYPES:
        return
    if facts is None:
        yield EdsWarning(where, f"maps {index:04X}h:{sub:02X}, which is not described")
        return
    known = DATA_TYPES.get(facts.data_type or 0)
    if known is not None and known.bits is not None and known.bits != bits:
        yield EdsWarning(where, f"maps {bits} bits of {index:04X}h:{sub:02X}, a {known.name}")


def _limits(device: Device) -> Iterator[EdsWarning]:
    for (index, sub), facts in device.facts.items():
        value = device.default(index, sub, 1)
        low, high = facts.low, facts.high
        if not isinstance(value, int) or (low is not None and high is not None and low >= high):
            continue
        if (low is not None and value < low) or (high is not None and value > high):
            place = f"[{index:04X}sub{sub:X}]" if facts.record else f"[{index:04X}]"
            yield EdsWarning(place, f"default {value} is outside its limits {low} .. {high}")
