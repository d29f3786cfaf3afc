"""What a user's settings of a device change in it, and what they state of its objects."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from syncline_schemas.devices.convert import integer, need, to_list, to_number, to_truth
from syncline_schemas.devices.model import Device, Key, Override
from syncline_schemas.devices.profile import QUIRKS
from syncline_schemas.errors import DescriptionError

_COUNTS = (1, (1 << 32) - 1)
WHOLE_NUMBERS: dict[str, tuple[int, int]] = {
    "cpr": _COUNTS,
    "turns": _COUNTS,
    "range": (1, 1 << 32),
    "res": (1, (1 << 16) - 1),
    "quad": (0, (1 << 8) - 1),
    "angle_def": (0, (1 << 8) - 1),
}
"""Settings that `syncline_schemas.measurement` reads as whole numbers: (least, greatest)."""
NUMBERS: dict[str, tuple[float, float]] = {
    "max_rpm": (0.001, 1_000_000),
    "max_rpm_mech": (0.001, 1_000_000),
    "reset_quiet_s": (0, 3600),
}
"""Settings that are any number: (least, greatest)."""
_ITEMS = {"bootup_bytes": (1 << 8) - 1, "vendor_ids": (1 << 32) - 1}
"""Greatest number in a list of numbers from 0 on."""


def check_numbers(given: Mapping[str, Any]) -> list[str]:
    """What is wrong with the numbers among a node's settings, whatever its device is."""
    errors = []
    for name, value in given.items():
        try:
            _is_sensible(name, value)
        except ValueError as error:
            errors.append(f"{name}: {error}")
    return errors


def _is_sensible(name: str, value: Any) -> None:
    """Raise ValueError where a number is none that the setting can have."""
    if value == "auto" and name not in _ITEMS:
        return
    if name in WHOLE_NUMBERS:
        low, high = WHOLE_NUMBERS[name]
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        need(is_whole and low <= value <= high, value, f"whole number from {low} to {high}")
    elif name in NUMBERS:
        least, most = NUMBERS[name]
        need(least <= to_number(value) <= most, value, f"number from {least:g} to {most:g}")
    elif name in _ITEMS:
        most = _ITEMS[name]
        inside = all(0 <= item <= most for item in to_list(integer)(value))
        need(inside, value, f"list of numbers from 0 to {most}")


def stated_objects(device: Device, given: Mapping[str, Any], node: int) -> dict[Key, int]:
    """Values of objects that a user's settings state: (index, sub) -> value.

    Raises:
        DescriptionError: identifiers are bound to another node than the one that is described.
    """
    found: dict[Key, int] = {}
    for name, value in given.items():
        setting = device.overrides.get(name)
        if setting is None or value == "auto":
            continue
        if setting.sets is not None:
            found[setting.sets] = int(_quirk_value(setting, value))
        if setting.binds:
            found |= _bound(name, value, node)
    return found


def _bound(name: str, value: Any, node: int) -> dict[Key, int]:
    """COB-IDs of TPDOs by the identifiers that a node is said to send: {"18A" = 12}."""
    found: dict[Key, int] = {}
    for text, owner in value.items() if isinstance(value, dict) else ():
        try:
            can_id = int(str(text).removesuffix("h"), 16)
        except ValueError:
            can_id = 0
        pdo = (can_id - 0x180) // 0x100
        if not (0x180 <= can_id < 0x580 and can_id & 0x80):
            raise DescriptionError(f"{name}: {text!r} is no identifier of a TPDO, like 18A")
        if owner != node:
            raise DescriptionError(f"{name}: say at node {owner} that {text} is its own")
        found[0x1800 + pdo, 1] = can_id
    return found


def configured(device: Device, given: Mapping[str, Any]) -> Device:
    """The device with a user's settings in its quirks, limits, scales and EMCY fields.

    Raises:
        DescriptionError: there is no such setting, or it does not take the value; all at once.
    """
    errors: list[str] = []
    changed: dict[str, Any] = {}
    facts = dict(device.facts)
    for name, value in given.items():
        setting = device.overrides.get(name)
        if setting is None:
            errors.append(f"{name}: there is no such setting, but {', '.join(device.overrides)}")
            continue
        try:
            _suits(setting, value)
            _is_sensible(name, value)
            if setting.quirk and value != "auto":
                changed[setting.quirk] = QUIRKS[setting.quirk](_quirk_value(setting, value))
            if setting.object in facts and value != "auto":
                facts[setting.object] = replace(facts[setting.object], scale=float(value))
        except (ValueError, TypeError) as error:
            errors.append(f"{name}: {error}")
    if errors:
        raise DescriptionError(f"settings of {device.name}: " + "; ".join(errors))
    identity = dict(device.identity)
    if "vendor_ids" in given:
        identity["vendors"] = tuple(given["vendor_ids"])
    numbers = {k: float(v) for k, v in given.items() if k in device.limits and v != "auto"}
    return replace(
        device,
        facts=facts,
        identity=identity,
        quirks=replace(device.quirks, **changed),
        limits={**device.limits, **numbers},
        emcy_fields=() if given.get("emcy_layout") == "none" else device.emcy_fields,
    )


def _suits(setting: Override, value: Any) -> None:
    """Raise ValueError where the value is none that the setting takes."""
    if setting.choices:
        choices = ", ".join(str(choice) for choice in setting.choices)
        if value not in setting.choices:
            raise ValueError(f"{value!r} is none of {choices}")
    elif isinstance(setting.default, bool):
        to_truth(value)
    elif isinstance(setting.default, dict):
        need(isinstance(value, dict), value, 'table, like { "18A" = 12 }')
    elif isinstance(setting.default, list):
        to_list(integer)(value)
    elif value != "auto" and (
        isinstance(setting.default, int | float) or setting.default == "auto"
    ):
        to_number(value)


def _quirk_value(setting: Override, value: Any) -> Any:
    if setting.means:
        return setting.means[str(value).lower()]
    return int(value * setting.factor) if setting.factor != 1 else value
