"""One device made of several that cannot be told apart yet."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

from syncline_schemas.devices.model import GENERIC_QUIRKS, Device, Quirks


def either(devices: Sequence[Device]) -> Device | None:
    """A device of which only that is claimed on which all of `devices` agree; None without any.

    Its object dictionary is that of the first one; of the quirks, what they do not share is what
    CiA 301 says, but for the bytes of a boot-up, which may be any of theirs, and for the longest
    silence after a reset.
    """
    if not devices:
        return None
    first, *others = devices
    if not others:
        return first
    facts = {
        key: value
        for key, value in first.facts.items()
        if all(key in other.facts and other.facts[key].name == value.name for other in others)
    }
    return replace(
        first,
        name=" or ".join(device.name for device in devices),
        title=" or ".join(device.title for device in devices),
        facts=facts,
        quirks=_quirks([device.quirks for device in devices]),
        overrides={},
        emcy_fields=first.emcy_fields
        if all(other.emcy_fields == first.emcy_fields for other in others)
        else (),
        measurement=_shared(devices, "measurement"),
        limits=_shared(devices, "limits"),
        health=_shared(devices, "health"),
        identity=_shared(devices, "identity"),
        emcy_codes=_shared(devices, "emcy_codes"),
        emcy_groups=_shared(devices, "emcy_groups"),
        emcy_register_names=_shared(devices, "emcy_register_names"),
        emcy_registers=_shared(devices, "emcy_registers"),
    )


def _shared(devices: Sequence[Device], name: str) -> dict[Any, Any]:
    """Entries of a mapping that all devices have alike."""
    first, *others = (getattr(device, name) for device in devices)
    return {
        key: value
        for key, value in first.items()
        if all(key in other and other[key] == value for other in others)
    }


def _quirks(each: Sequence[Quirks]) -> Quirks:
    first, *others = each
    alike = {
        f.name: getattr(first, f.name)
        for f in fields(Quirks)
        if all(getattr(other, f.name) == getattr(first, f.name) for other in others)
    }
    alike["bootup_bytes"] = tuple(sorted({byte for quirks in each for byte in quirks.bootup_bytes}))
    alike["reset_quiet_ms"] = max(quirks.reset_quiet_ms for quirks in each)
    return replace(GENERIC_QUIRKS, **alike)
