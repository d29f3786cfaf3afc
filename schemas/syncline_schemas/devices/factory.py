"""What the TPDOs of a device look like as it leaves the factory."""

from collections.abc import Iterator

from syncline_schemas.devices.model import Device
from syncline_schemas.named_tuples import NamedTuple


class FactoryPdo(NamedTuple):
    """A TPDO as a device leaves the factory: bytes, transmission type and event timer."""

    length: int
    type: int | None
    timer_ms: int | None


def factory_tpdos(device: Device) -> dict[int, FactoryPdo]:
    """TPDOs that are on and mapped, by the identifier that node 0 would have."""
    return dict(_tpdos(device))


def _tpdos(device: Device) -> Iterator[tuple[int, FactoryPdo]]:
    for index in sorted({i for i, sub in device.facts if 0x1800 <= i < 0x1A00 and sub == 1}):
        can_id = device.default(index, 1, 0)
        length = _mapped_length(device, index + 0x200)
        if isinstance(can_id, int) and not can_id >> 31 and length:
            kind, timer = device.default(index, 2, 0), device.default(index, 5, 0)
            yield (
                can_id & 0x7FF,
                FactoryPdo(
                    length,
                    kind if isinstance(kind, int) else None,
                    timer if isinstance(timer, int) else None,
                ),
            )


def _mapped_length(device: Device, mapping: int) -> int | None:
    """Bytes that a device maps into a PDO by itself, None where its files do not say it."""
    count = device.default(mapping, 0, 0)
    if not isinstance(count, int) or not 0 < count <= 64:
        return None
    entries = [device.default(mapping, sub, 0) for sub in range(1, count + 1)]
    bits = [entry & 0xFF for entry in entries if isinstance(entry, int)]
    return (sum(bits) + 7) // 8 if len(bits) == count else None
