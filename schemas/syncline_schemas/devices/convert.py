"""Values of a TOML file as the types that are wanted; what does not fit is a ValueError that says so."""

from collections.abc import Callable, Mapping
from typing import Any, cast

from syncline_schemas.devices.model import Key
from syncline_schemas.eds_repair import number

Convert = Callable[[Any], Any]


def object_key(text: Any) -> Key:
    """(index, sub) of "6000" or "1018:2", both hexadecimal.

    >>> object_key("1018:2"), object_key("6000")
    ((4120, 2), (24576, 0))
    """
    index, _, sub = str(text).strip().lower().partition(":")
    try:
        key = int(index.removesuffix("h"), 16), int(sub or "0", 16)
    except ValueError:
        raise ValueError(f'{text!r} is no object: write it as "6000" or "1018:2"') from None
    if not (0 <= key[0] <= 0xFFFF and 0 <= key[1] <= 0xFF):
        raise ValueError(f"{text!r} is no object: the index has four digits, the subindex two")
    return key


def need(fits: bool, value: Any, what: str) -> None:
    if not fits:
        raise ValueError(f"{value!r} is no {what}")


def integer(value: Any) -> int:
    """A number, also as text ("0x10", "10h")."""
    need(isinstance(value, int | str) and not isinstance(value, bool), value, "whole number")
    read = value if isinstance(value, int) else number(value)
    need(read is not None, value, "whole number")
    return cast("int", read)


def to_number(value: Any) -> float:
    need(isinstance(value, int | float) and not isinstance(value, bool), value, "number")
    return float(value)


def to_bit(value: Any) -> int:
    read = integer(value)
    need(0 <= read < 64, value, "bit number from 0 to 63")
    return read


def to_text(value: Any) -> str:
    need(isinstance(value, str), value, "text")
    return cast("str", value)


def to_truth(value: Any) -> bool:
    need(isinstance(value, bool), value, "true or false")
    return cast("bool", value)


def to_one_of(*choices: str) -> Convert:
    def convert(value: Any) -> str:
        if value not in choices:
            raise ValueError(f"{value!r} is none of {', '.join(choices)}")
        return str(value)

    return convert


def to_list(item: Convert) -> Convert:
    def convert(value: Any) -> tuple[Any, ...]:
        need(isinstance(value, list), value, "list")
        return tuple(item(part) for part in value)

    return convert


def to_pair(item: Convert) -> Convert:
    def convert(value: Any) -> tuple[Any, ...]:
        read: tuple[Any, ...] = to_list(item)(value)
        need(len(read) == 2, value, "pair")
        return read

    return convert


def to_table(key: Convert, item: Convert) -> Convert:
    def convert(value: Any) -> dict[Any, Any]:
        need(isinstance(value, dict), value, "table")
        return {key(name): item(part) for name, part in value.items()}

    return convert


def to_record(
    required: Mapping[str, Convert], optional: Mapping[str, Convert] | None = None
) -> Convert:
    known = {**required, **(optional or {})}

    def convert(value: Any) -> dict[str, Any]:
        need(isinstance(value, dict), value, "table")
        if missing := required.keys() - value.keys():
            raise ValueError(f"{', '.join(sorted(missing))} missing")
        if unknown := value.keys() - known.keys():
            raise ValueError(f"unknown key {', '.join(sorted(unknown))}")
        return {name: known[name](part) for name, part in value.items()}

    return convert
