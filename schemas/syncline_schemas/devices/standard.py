"""Devices of which nothing is known but the CiA profile that they follow."""

from functools import cache
from pathlib import Path

from syncline_schemas.devices.model import Device, Jump, Key, ObjectFacts
from syncline_schemas.devices.profile import Profile, read_profile

_PROFILES = Path(__file__).parent / "profiles"
_INTEGER16, _INTEGER32, _UNSIGNED32 = 0x03, 0x04, 0x07
_CHANNELS = range(1, 9)
"""Channels of encoders with several sensors that are looked for."""
_POSITIONS: dict[int, dict[Key, tuple[str, int]]] = {
    406: {(0x6004, 0): ("Position value", _UNSIGNED32)}
    | {(0x6020, sub): (f"Position value of channel {sub}", _INTEGER32) for sub in _CHANNELS},
    410: {
        (0x6010, 0): ("Slope longitudinal 16 bit", _INTEGER16),
        (0x6020, 0): ("Slope lateral 16 bit", _INTEGER16),
        (0x6110, 0): ("Slope longitudinal 32 bit", _INTEGER32),
        (0x6120, 0): ("Slope lateral 32 bit", _INTEGER32),
    },
}
"""Name and data type of the objects that hold positions, by CiA profile number."""


_SIGNED: dict[int, dict[int, int]] = {
    406: {0x6509: _INTEGER32},
    410: dict.fromkeys((0x6012, 0x6013, 0x6014, 0x6022, 0x6023, 0x6024), _INTEGER16)
    | dict.fromkeys((0x6112, 0x6113, 0x6114, 0x6122, 0x6123, 0x6124), _INTEGER32),
}
"""Data type of the settings that may be negative, by CiA profile number and index."""


@cache
def _paths() -> dict[int, Path]:
    return {int(path.stem): path for path in _PROFILES.glob("*.toml")}


@cache
def _read(path: Path) -> Profile:
    return read_profile(path.read_text(encoding="utf-8"), path.name)


def standard_profiles() -> dict[int, Profile]:
    """Device profiles by CiA number (`profiles/406.toml` ...)."""
    return {number: _read(path) for number, path in _paths().items()}


def standard_profile(number: int) -> Profile | None:
    """The device profile of a CiA number; None, and nothing read, for others."""
    path = _paths().get(number)
    return None if path is None else _read(path)


@cache
def standard_device(number: int) -> Device | None:
    """A device that follows a CiA profile and of which no EDS is known; None for other profiles."""
    profile = standard_profile(number)
    if profile is None:
        return None
    from syncline_schemas.lean_canopen import ObjectDictionary

    facts: dict[Key, ObjectFacts] = {
        key: ObjectFacts(*key, name, data_type, "ro", mappable=True)
        for key, (name, data_type) in _POSITIONS.get(number, {}).items()
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
    profile = standard_profile(number)
    more = profile.objects.get((index, sub)) if profile else None
    kind = _SIGNED.get(number, {}).get(index)
    known = {"name": "", "data_type": kind, **(more or {})}
    return ObjectFacts(index, sub, **known) if more is not None else None


def standard_of(index: int, sub: int) -> int | None:
    """Number of the CiA profile in which an object holds a position.

    >>> standard_of(0x6004, 0), standard_of(0x6120, 0), standard_of(0x6064, 0)
    (406, 410, None)
    >>> standard_of(0x6020, 0), standard_of(0x6020, 2)
    (410, 406)
    """
    return next((n for n, objects in _POSITIONS.items() if (index, sub) in objects), None)


@cache
def standard_jumps(number: int | None) -> tuple[Jump, ...]:
    """Writes that move a position without motion, by a CiA profile; by all where it is not known.

    >>> [jump.text for jump in standard_jumps(410)][0], len(standard_jumps(402))
    ('resolution', 0)
    """
    if number:
        profile = standard_profile(number)
        return profile.quirks.jumps if profile else ()
    return tuple(jump for each in standard_profiles().values() for jump in each.quirks.jumps)
