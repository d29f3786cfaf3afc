"""Which buses to record, from what the user typed; the options are python-can's own."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from syncline_schemas.errors import UsageError

Filter = dict[str, int]
"""A python-can filter: can_id, can_mask."""

_INVERTED = 0x2000_0000
"""CAN_INV_FILTER of SocketCAN, which python-can passes through."""

_NOT_FOR_TOPICS = re.compile(r"[^A-Za-z0-9_.-]+")


@dataclass(frozen=True, slots=True)
class BusOptions:
    """One bus as python-can opens it: `can.Bus(channel, interface, **arguments)`.

    Attributes:
        name: what the bus is called in the capture (a part of its topics).
        interface: python-can's name of the interface; None lets python-can's own configuration
            files and environment variables decide, as for `channel`.
        timing: bit timing parameters by python-can's names.
        arguments: further keyword arguments of the interface.
        acknowledge: let the adapter acknowledge frames; False asks for listen-only mode where
            the interface has one.
    """

    name: str
    interface: str | None = None
    channel: str | int | None = None
    bitrate: int | None = None
    fd: bool = False
    data_bitrate: int | None = None
    timing: dict[str, int] = field(default_factory=dict)
    filters: tuple[Filter, ...] = ()
    arguments: dict[str, Any] = field(default_factory=dict)
    acknowledge: bool = False


def bus_name(channel: object) -> str:
    """A name for topics from a channel.

    >>> bus_name("/dev/ttyUSB0@115200"), bus_name("can0"), bus_name(0)
    ('ttyUSB0', 'can0', '0')
    """
    tail = str(channel).replace("\\", "/").rsplit("/", 1)[-1].split("@")[0]
    return _NOT_FOR_TOPICS.sub("_", tail) or "bus"


def parse_value(text: str) -> str | int | float | bool:
    """A value as python-can's own tools read it.

    >>> parse_value("500000"), parse_value("true"), parse_value("0x10")
    (500000, True, '0x10')
    """
    if re.fullmatch(r"[-+]?\d+", text):
        return int(text)
    if re.fullmatch(r"[-+]?\d*\.\d+(?:e[-+]?\d+)?", text):
        return float(text)
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    return text


def parse_arguments(words: Sequence[str], option: str) -> dict[str, Any]:
    """KEY=VALUE words of an option as keyword arguments.

    >>> parse_arguments(["app_name=test", "serial=12"], "--bus-kwargs")
    {'app_name': 'test', 'serial': 12}
    """
    arguments = {}
    for word in words:
        match = re.fullmatch(r"([A-Za-z_][A-Za-z0-9_-]*)=(\S*)", word)
        if not match:
            raise UsageError(f"{option}: '{word}' is not KEY=VALUE")
        arguments[match[1].replace("-", "_")] = parse_value(match[2])
    return arguments


def parse_timing(words: Sequence[str]) -> dict[str, int]:
    """KEY=NUMBER words of --timing."""
    timing = parse_arguments(words, "--timing")
    for key, value in timing.items():
        if type(value) is not int:
            raise UsageError(f"--timing: '{key}={value}' is not a whole number")
    return timing


def parse_filter(word: str) -> Filter:
    """A filter as python-can's tools write it, ID and mask hexadecimal.

    >>> parse_filter("100:7FC") == {"can_id": 0x100, "can_mask": 0x7FC}
    True
    """
    match = re.fullmatch(r"([0-9A-Fa-f]{1,8})([:~])([0-9A-Fa-f]{1,8})", word)
    if not match:
        raise UsageError(f"--filter: '{word}' is not ID:MASK or ID~MASK (hexadecimal)")
    inverted = _INVERTED if match[2] == "~" else 0
    return {"can_id": int(match[1], 16) | inverted, "can_mask": int(match[3], 16)}


def filter_words(filters: Sequence[Filter]) -> str:
    """Filters in words.

    >>> filter_words([{"can_id": 0x100, "can_mask": 0x7FC}])
    '100:7FC'
    """
    return " ".join(f"{each['can_id']:X}:{each['can_mask']:X}" for each in filters)


def parse_bus(word: str, common: BusOptions) -> BusOptions:
    """A bus from `[NAME=]INTERFACE:CHANNEL[,KEY=VALUE...]`; what it leaves open is as in `common`.

    >>> bus = parse_bus("robot=pcan:PCAN_USBBUS1,bitrate=250000", BusOptions("", bitrate=500000))
    >>> bus.name, bus.interface, bus.channel, bus.bitrate
    ('robot', 'pcan', 'PCAN_USBBUS1', 250000)
    """
    place, *words = word.split(",")
    match = re.fullmatch(r"(?:([A-Za-z0-9_.-]+)=)?([A-Za-z0-9_]+):(.+)", place)
    if not match:
        raise UsageError(
            f"--bus: '{word}' is not [NAME=]INTERFACE:CHANNEL[,KEY=VALUE...],"
            " for example can0=socketcan:can0"
        )
    own = parse_arguments(words, "--bus")
    channel = parse_value(match[3])
    return BusOptions(
        name=match[1] or bus_name(channel),
        interface=match[2],
        channel=channel if isinstance(channel, int) else match[3],
        bitrate=_whole(own.pop("bitrate", common.bitrate), "bitrate"),
        fd=bool(own.pop("fd", common.fd)),
        data_bitrate=_whole(own.pop("data_bitrate", common.data_bitrate), "data_bitrate"),
        timing=common.timing,
        filters=common.filters,
        arguments={**common.arguments, **own},
        acknowledge=common.acknowledge,
    )


def _whole(value: object, name: str) -> int | None:
    if value is None or type(value) is int:
        return value
    raise UsageError(f"--bus: {name}={value} is not a whole number")


def with_unique_names(buses: Sequence[BusOptions]) -> list[BusOptions]:
    """The same buses; raises UsageError where two would have one name."""
    seen: dict[str, BusOptions] = {}
    for bus in buses:
        if bus.name in seen:
            raise UsageError(
                f"two buses are called '{bus.name}'; name them with"
                f" --bus NAME={bus.interface}:{bus.channel}"
            )
        seen[bus.name] = bus
    return list(buses)
