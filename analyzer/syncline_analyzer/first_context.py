"""The context with which a pass over captures begins."""

from collections.abc import Mapping, Sequence
from contextlib import suppress

from syncline_analyzer.capture import CaptureFacts, time_base
from syncline_analyzer.context import Context
from syncline_analyzer.recall import recall
from syncline_analyzer.shadow import Shadow
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device, device_from_files
from syncline_schemas.errors import DescriptionError


def first_context(
    facts: Sequence[CaptureFacts],
    buses: list[str],
    description: BusDescription,
    devices: Mapping[int, Device],
) -> Context:
    """What is known before the first frame: description, devices, what earlier segments taught.

    Args:
        facts: of every file.
        buses: names by bus number; may grow.
        description: what the user says of buses and nodes.
        devices: device by node id, where the description leaves it open.
    """

    def bus_name(bus: int) -> str:
        return buses[bus] if bus < len(buses) else str(bus)

    context = Context(
        buses=buses,
        shadow=Shadow(bus_name, description, dict(devices), _attached(facts)),
        timed=time_base(facts) != "none",
        description=description,
    )
    recall(context.shadow, facts)
    return context


def _attached(facts: Sequence[CaptureFacts]) -> list[Device]:
    """Devices whose files the captures carry; what cannot be used of them is left out."""
    found: dict[str, Device] = {}
    for each in facts:
        for name in each.eds_files:
            if name.endswith(".toml"):
                with suppress(DescriptionError):
                    found[name] = device_from_files(name, each.eds_files)
    return list(found.values())
