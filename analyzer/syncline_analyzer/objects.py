"""The object dictionary as the capture shows it: last known value of each object of each node."""

from syncline_analyzer.context import Context
from syncline_analyzer.results import ObjectRow
from syncline_analyzer.shadow import Known
from syncline_schemas.devices import Device


def object_rows(context: Context) -> list[ObjectRow]:
    """One row per object that was seen on the bus, by bus, node, index and sub-index."""
    shadow = context.shadow
    return [
        _row(context, bus, node, key, known)
        for bus, node in sorted(shadow.nodes())
        for key, known in sorted(shadow.learned(bus, node).items())
    ]


def _row(context: Context, bus: int, node: int, key: tuple[int, int], known: Known) -> ObjectRow:
    device = context.shadow.device(bus, node)
    facts = device.object(*key) if device else None
    return ObjectRow(
        bus=context.bus_name(bus),
        node=node,
        index=key[0],
        sub=key[1],
        name=facts.name if facts else None,
        unit=(facts.unit or None) if facts else None,
        value=_shown(device, key, known),
        source=known.source,
        seq=known.seq,
        t_ns=known.t_ns,
    )


def _shown(device: Device | None, key: tuple[int, int], known: Known) -> int | float | str:
    """The value by the object's type; bytes of an unknown type as hexadecimal."""
    if isinstance(known.value, int):
        return known.value
    value = device.value(*key, known.value) if device else None
    if value is None or isinstance(value, bytes):
        return known.value.hex(" ").upper()
    return value
