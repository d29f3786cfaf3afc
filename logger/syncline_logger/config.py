"""`logger.toml`: everything that `syncline record` can do, read from a file with all errors at once.

Its keys are the long options of `record` with `_` for `-`; buses are `[[bus]]` tables.
"""

import difflib
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from syncline_logger.bus_options import BusOptions, bus_name, parse_filter
from syncline_logger.option_types import duration_ns, size_bytes
from syncline_schemas.devices import is_path
from syncline_schemas.errors import UsageError

BusTable = Mapping[str, Any]
"""A [[bus]] table whose values have the right types."""

BUS_KEYS = {
    "name": "text",
    "interface": "text",
    "channel": "text or number",
    "bitrate": "number",
    "fd": "switch",
    "data_bitrate": "number",
    "timing": "table of numbers",
    "filter": "filters",
    "bus_kwargs": "table",
    "acknowledge": "switch",
}
"""Keys of a [[bus]] table and what stands there; but for `name` all hold for every bus too."""

NOT_IN_A_FILE = frozenset({"config", "check_config", "buses", "help"})
"""Parameters of the command that are no settings, or are written as [[bus]]."""

WITHOUT_CHANNEL = frozenset(
    {"virtual", "pcan", "canalystii", "neovi", "nixnet", "udp_multicast", "usb2can"}
)
"""Interfaces of python-can that have a channel of their own choice."""

_NAME = re.compile(r"[A-Za-z0-9_.-]+")
"""What can be a part of a topic."""

_WORDS = {
    "text": "a text in quotes",
    "text or number": "a text in quotes or a whole number",
    "number": "a whole number",
    "switch": "true or false",
    "texts": "a list of texts",
    "filters": "a list of texts ID:MASK",
    "table": "a table { key = value }",
    "table of numbers": "a table { key = number }",
    "time": 'a time in quotes ("500ms", "10s", "2h")',
    "size": 'a size in quotes ("256MB", "4GiB")',
}


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """A configuration file.

    Attributes:
        values: by the name of the command's parameter, as the command line would give them;
            only what can be used.
        buses: the [[bus]] tables.
        places: how each of them is called where something is wrong with it.
        names_buses: whether there is a `bus` at all, right or wrong.
        problems: everything that is wrong, each with file, key and what to write.
    """

    path: Path
    values: Mapping[str, Any]
    buses: tuple[BusTable, ...]
    problems: tuple[str, ...]
    places: tuple[str, ...] = ()
    names_buses: bool = False

    def place(self, key: str, number: int | None = None) -> str:
        """Where a key stands that holds for a bus: in its table, else above all of them."""
        if number is not None and (key in self.buses[number] or key == "name"):
            return f"{self.path}: {self.places[number]}: {key}: "
        return f"{self.path}: {key}: "


def load_config(path: Path, parameters: Sequence[click.Parameter]) -> LoadedConfig:
    """Read a file for a command with these parameters; never raises, it says what is wrong."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no UTF-8 text"
        return LoadedConfig(path, {}, (), (f"{path} cannot be read: {reason}",))
    except tomllib.TOMLDecodeError as error:
        return LoadedConfig(path, {}, (), (f"{path} is no TOML: {error}",))
    reader = _Reader(path, parameters)
    reader.read(content)
    return LoadedConfig(
        path,
        reader.values,
        tuple(reader.buses),
        tuple(reader.problems),
        tuple(reader.places),
        "bus" in content,
    )


def configured_buses(
    config: LoadedConfig, common: BusOptions, overrides: Mapping[str, Any]
) -> list[BusOptions]:
    """The buses of a file.

    Args:
        common: what holds where a table says nothing.
        overrides: fields of BusOptions that the command line gives; they hold for every bus.
    """
    return [replace(_bus(each, common), **overrides) for each in config.buses]


def _bus(table: BusTable, common: BusOptions) -> BusOptions:
    channel = table.get("channel", common.channel)
    interface = table.get("interface", common.interface)
    return replace(
        common,
        name=table.get("name")
        or (bus_name(channel) if channel is not None else interface or "can"),
        interface=interface,
        channel=channel,
        bitrate=table.get("bitrate", common.bitrate),
        fd=table.get("fd", common.fd),
        data_bitrate=table.get("data_bitrate", common.data_bitrate),
        timing=table.get("timing", common.timing),
        filters=tuple(parse_filter(word) for word in table["filter"])
        if "filter" in table
        else common.filters,
        arguments={**common.arguments, **table.get("bus_kwargs", {})},
        acknowledge=table.get("acknowledge", common.acknowledge),
    )


class _Reader:
    def __init__(self, path: Path, parameters: Sequence[click.Parameter]) -> None:
        self._path = path
        self._options = {
            long_name(option): option
            for option in parameters
            if isinstance(option, click.Option) and option.name not in NOT_IN_A_FILE
        }
        self.values: dict[str, Any] = {}
        self.buses: list[BusTable] = []
        self.places: list[str] = []
        self.problems: list[str] = []

    def read(self, content: Mapping[str, Any]) -> None:
        """Take every key that can be used; note what is wrong with the others."""
        for key, value in content.items():
            if key == "bus":
                self._read_buses(value)
            elif key in self._options:
                self._read_option(key, self._options[key], value)
            else:
                self._unknown(key, key, [*self._options, "bus"])
        if self.buses and "channels" in self.values:
            self._problem("channel", "is not for all buses; write one in each [[bus]]")

    def _read_option(self, key: str, option: click.Option, value: object) -> None:
        kind = _kind(key, option)
        fits = self._fits(key, kind, value)
        if not fits and option.multiple and isinstance(value, str):
            # What is wrong with the text itself is told too.
            value = [value]
        elif not fits:
            return
        words = self._as_typed(option, value)
        good = True
        for each in [[word] for word in words] if option.multiple else [words]:
            try:
                option.type_cast_value(click.Context(click.Command("record")), each)
            except click.BadParameter as error:
                self._problem(key, error.message)
                good = False
        if good and option.name is not None:
            self.values[option.name] = words

    def _as_typed(self, option: click.Option, value: Any) -> Any:
        """The value as the command line would give it; files are looked for beside this one."""
        base = self._path.parent
        if isinstance(value, dict):
            return [f"{key}={_word(each)}" for key, each in value.items()]
        if isinstance(option.type, click.Path):
            return str(base / value)
        if option.name == "devices":
            return [_beside(word, base) for word in value]
        return value

    def _read_buses(self, tables: object) -> None:
        if not isinstance(tables, list) or not all(isinstance(each, dict) for each in tables):
            self._problem("bus", "write each bus as a table that begins with [[bus]]")
            return
        for number, table in enumerate(tables, 1):
            name = table.get("name")
            place = f"bus {number}" + (f" ({name})" if isinstance(name, str) else "")
            self.buses.append(self._read_bus(place, table))
            self.places.append(place)

    def _read_bus(self, place: str, table: Mapping[str, Any]) -> BusTable:
        good = {}
        for key, value in table.items():
            kind = BUS_KEYS.get(key)
            if kind is None and key in self._options:
                self._problem(
                    f"{place}: {key}", "is no key of a bus; write it above the first [[bus]]"
                )
            elif kind is None:
                self._unknown(f"{place}: {key}", key, BUS_KEYS)
            elif self._fits(f"{place}: {key}", kind, value):
                good[key] = value
        if "interface" not in good and "interface" not in table and "interface" not in self.values:
            self._problem(place, 'has no interface; write interface = "socketcan"')
        interface = table.get("interface", self.values.get("interface"))
        if "channel" not in table and interface not in WITHOUT_CHANNEL:
            self._problem(place, 'has no channel; write channel = "can0"')
        if isinstance(name := good.get("name"), str) and not _NAME.fullmatch(name):
            self._problem(
                f"{place}: name", f"'{name}' is no name; write letters, digits and _ . - only"
            )
        return good

    def _fits(self, place: str, kind: str, value: Any) -> bool:
        if not _is(kind, value):
            example = place.rpartition(" ")[2]
            listed = isinstance(value, str) and kind in ("texts", "filters")
            right = f"[{_shown(value)}]" if listed else _example(kind)
            self._problem(
                place, f"{_shown(value)} is not {_WORDS[kind]}; write {example} = {right}"
            )
            return False
        problems = list(_wrong_with(kind, value))
        for problem in problems:
            self._problem(place, problem)
        return not problems

    def _unknown(self, place: str, key: str, known: Any) -> None:
        near = difflib.get_close_matches(key.replace("-", "_"), list(known), 1)
        hint = f"write {near[0]}" if near else f"there are {', '.join(sorted(known))}"
        self._problem(place, f"is no key; {hint}")

    def _problem(self, place: str, text: str) -> None:
        self.problems.append(f"{self._path}: {place}: {text}")


def long_name(option: click.Option) -> str:
    """An option's key in the file.

    >>> long_name(click.Option(["-o", "--split-size"]))
    'split_size'
    """
    longest = max(option.opts, key=len)
    return longest.lstrip("-").replace("-", "_")


def _kind(key: str, option: click.Option) -> str:
    """What a key of the file must hold."""
    if key in BUS_KEYS:
        # An interface has as many channels as it likes on the command line; so it has here.
        return "texts" if key == "channel" else BUS_KEYS[key]
    convert = getattr(option.type, "func", None)
    if convert in (duration_ns, size_bytes):
        return "time" if convert is duration_ns else "size"
    if option.is_flag:
        return "switch"
    if option.multiple:
        return "texts"
    return "number" if isinstance(option.type, click.types.IntParamType) else "text"


def _is(kind: str, value: Any) -> bool:
    whole = type(value) is int
    match kind:
        case "number":
            return whole
        case "switch":
            return isinstance(value, bool)
        case "text or number":
            return whole or isinstance(value, str)
        case "texts" | "filters":
            return isinstance(value, list) and all(isinstance(each, str) for each in value)
        case "table":
            return isinstance(value, dict)
        case "table of numbers":
            return isinstance(value, dict) and all(type(each) is int for each in value.values())
    return isinstance(value, str)


def _wrong_with(kind: str, value: Any) -> Iterator[str]:
    """Words where a value of the right type makes no sense."""
    if kind == "number" and value <= 0:
        yield f"{value} is not more than 0; write 1 or more"
    for word in value if kind == "filters" else ():
        try:
            parse_filter(word)
        except UsageError as error:
            yield str(error).removeprefix("--filter: ")


def _example(kind: str) -> str:
    return {
        "text": '"..."',
        "text or number": '"can0"',
        "number": "500000",
        "switch": "true",
        "texts": '["..."]',
        "filters": '["180:780"]',
        "table": "{ serial = 12 }",
        "table of numbers": "{ f_clock = 8000000, brp = 1, tseg1 = 13, tseg2 = 2, sjw = 1 }",
        "time": '"10s"',
        "size": '"256MB"',
    }[kind]


def _shown(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_shown(each)}" for key, each in value.items()) + " }"
    return f'"{value}"' if isinstance(value, str) else _word(value)


def _word(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _beside(word: str, base: Path) -> str:
    """A NODE=NAME_OR_EDS word whose EDS file is looked for in a folder."""
    node, equals, device = word.partition("=")
    return f"{node}{equals}{base / device}" if equals and is_path(device) else word
