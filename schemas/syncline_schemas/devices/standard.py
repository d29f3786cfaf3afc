"""Devices of which nothing is known but the CiA profile that they follow."""

from functools import cache
from importlib.resources import files as package_files

from syncline_schemas.devices.model import Device, Key, ObjectFacts
from syncline_schemas.devices.profile import Profile, read_profile

_INTEGER16, _INTEGER32, _UNSIGNED32 = 0x03, 0x04, 0x07
_POSITIONS: dict[int, dict[int, tuple[str, int]]] = {
    406: {0x6004: ("Position value", _UNSIGNED32)},
    410: {
        0x6010: ("Slope longitudinal 16 bit", _INTEGER16),
        0x6020: ("Slope lateral 16 bit", _INTEGER16),
        0x6110: ("Slope longitudinal 32 bit", _INTEGER32),
        0x6120: ("Slope lateral 32 bit", _INTEGER32),
    },
}
"""Name and data type of the objects that hold positions, by CiA profile number."""


@cache
def standard_profiles() -> dict[int, Profile]:
    """Device profiles by CiA number (`profiles/406.toml` ...)."""
    folder = package_files("syncline_schemas.devices") / "profiles"
    return {
        int(entry.name.removesuffix(".toml")): read_profile(
            entry.read_text(encoding="utf-8"), entry.name
        )
        for entry in folder.iterdir()
        if entry.name.endswith(".toml")
    }


@cache
def standard_device(number: int) -> Device | None:
    """A device that follows a CiA profile and of which no EDS is known; None for other profiles."""
    profile = standard_profiles().get(number)
    if profile is None:
        return None
    from canopen import ObjectDictionary

    facts: dict[Key, ObjectFacts] = {
        (index, 0): ObjectFacts(index, 0, name, data_type, "ro", mappable=True)
        for index, (name, data_type) in _POSITIONS.get(number, {}).items()
    }
    return Device(
        f"cia{number}",
        profile.title,
        "",
        "encoder" if profile.kind == "encoder" else "inclinometer",
        ObjectDictionary(),
        facts,
        measurement=profile.measurement,
    )


@cache
def standard_facts(number: int, index: int, sub: int) -> ObjectFacts | None:
    """Name, unit and words of an object by a CiA profile, None where it tells nothing of it.

    >>> standard_facts(406, 0x6003, 0).name, standard_facts(402, 0x6003, 0)
    ('preset value', None)
    """
    profile = standard_profiles().get(number)
    more = profile.objects.get((index, sub)) if profile else None
    return ObjectFacts(index, sub, **{"name": "", **more}) if more is not None else None


def standard_of(index: int, sub: int) -> int | None:
    """Number of the CiA profile in which an object holds a position.

    >>> standard_of(0x6004, 0), standard_of(0x6120, 0), standard_of(0x6064, 0)
    (406, 410, None)
    """
    if sub == 0:
        for number, objects in _POSITIONS.items():
            if index in objects:
                return number
    return None
