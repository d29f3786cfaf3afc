"""Bus description: which devices are on which bus, and what is known of them beforehand."""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import field
from math import isfinite
from pathlib import Path
from typing import Any, Self

from syncline_schemas.devices import (
    EDS_SUFFIXES,
    Device,
    check_numbers,
    configured,
    device_from_files,
    is_path,
    load_device,
    stated_objects,
)
from syncline_schemas.devices.convert import integer, object_key
from syncline_schemas.errors import DescriptionError
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class NodeEntry:
    """What the user says of one node.

    Attributes:
        name: name for people, None when not given.
        device: the device, already loaded, with the overrides in its quirks and limits.
        objects: (index, sub) -> value that holds on this node unless the bus says otherwise.
        overrides: settings of the device (`Device.overrides`), only those that were given.
        same_shaft_as: node of the same bus whose encoder sits on the same shaft.
        ratio: how many turns this encoder makes for one of that one; negative the other way round.
        tolerance_deg: how far both may part at standstill, None for the usual.
    """

    name: str | None = None
    device: Device | None = None
    objects: Mapping[tuple[int, int], int] = field(default_factory=dict)
    overrides: Mapping[str, Any] = field(default_factory=dict)
    same_shaft_as: int | None = None
    ratio: float = 1.0
    tolerance_deg: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class BusDescription:
    """Buses, bit rates and nodes as a user describes them in TOML; empty by default.

        [bus.can0]
        bitrate = 500000
        data_bitrate = 2000000         # of CAN FD frames with bit rate switch
        [bus.can0.node.5]
        name = "main shaft"
        device = "lir-da158a"          # or eds = "x.eds", relative to this file
        [bus.can0.node.5.objects]
        "6001" = 131072
        "1800:2" = 254
        [bus.can0.node.5.overrides]
        max_rpm = 1500
        [bus.can0.node.6]
        same_shaft_as = 5              # redundant encoders are compared
        ratio = -1                     # it turns the other way round; 1 where not given
        tolerance_deg = 2.0
        [node.7]                       # on any bus
        device = "jn2100"

    Attributes:
        bitrates: [bit/s] by bus name.
        data_bitrates: of the data phase of FD frames [bit/s] by bus name.
        nodes: entries by (bus name, node); bus None = on any bus.
        text: the TOML as it was read ("" for the empty one).
        files: every EDS, DCF and device file used, by name, for the attachments of a capture.
    """

    bitrates: Mapping[str, int] = field(default_factory=dict)
    nodes: Mapping[tuple[str | None, int], NodeEntry] = field(default_factory=dict)
    text: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    data_bitrates: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Description from a TOML file.

        Raises:
            DescriptionError: the file cannot be read or is wrong; names all mistakes at once.
        """
        try:
            text = Path(path).read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise DescriptionError(f"{path} cannot be read: {reason}") from error
        try:
            return cls.loads(text, Path(path).parent)
        except DescriptionError as error:
            raise DescriptionError(f"{path}: {error}") from error

    @classmethod
    def loads(
        cls, text: str, base: Path | None = None, files: Mapping[str, bytes] | None = None
    ) -> Self:
        """Description from text; device files are looked up in `files`, then relative to `base`.

        Raises:
            DescriptionError: the text is wrong; names all mistakes at once.
        """
        import tomllib

        try:
            data = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise DescriptionError(f"the bus description is no TOML: {error}") from error
        reader = _Reader(base, files or {})
        reader.read(data)
        if reader.errors:
            raise DescriptionError(";\n".join(reader.errors))
        return cls(reader.bitrates, reader.nodes, text, reader.used, reader.data_bitrates)

    def node(self, bus_name: str, node: int) -> NodeEntry | None:
        """Entry of a node on a bus; [node.N] entries hold on any bus that has none of its own."""
        return self.nodes.get((bus_name, node)) or self.nodes.get((None, node))

    def bitrate(self, bus_name: str) -> int | None:
        """Bit rate of a bus [bit/s], None when not given."""
        return self.bitrates.get(bus_name)

    def data_bitrate(self, bus_name: str) -> int | None:
        """Bit rate of the data phase of FD frames [bit/s], None when not given."""
        return self.data_bitrates.get(bus_name)

    def described(self, bus_name: str) -> dict[int, NodeEntry]:
        """All entries that hold on a bus, by node."""
        anywhere = {n: entry for (bus, n), entry in self.nodes.items() if bus is None}
        return anywhere | {n: entry for (bus, n), entry in self.nodes.items() if bus == bus_name}


def _files_of(name: str) -> list[str]:
    """Files that may describe a device of the catalogue, the one that says most first."""
    return [name + suffix for suffix in (".toml", *EDS_SUFFIXES)]


BUS_KEYS: dict[str, str] = {
    "bitrate": "bit rate [bit/s]; not told, it is estimated from the frames, and said to be so",
    "data_bitrate": "bit rate of the data phase of CAN FD frames with bit rate switch [bit/s]",
    "node": "one table per node: `[bus.NAME.node.5]`",
}
"""Keys of `[bus.NAME]` with their meaning."""
NODE_KEYS: dict[str, str] = {
    "name": "name for people, used in every text",
    "device": "what it is: a name of `syncline devices`, or a path to a .toml, .eds, .dcf or .xdd"
    " file, relative to this file",
    "eds": "the same as `device`, where the path to an EDS reads better",
    "objects": "values that hold unless the bus says otherwise, by object in hexadecimal digits:"
    ' `"6001"`, `"1800:2"`',
    "overrides": "settings of the device, by the names of the tables below",
    "same_shaft_as": "node of the same bus whose encoder sits on the same shaft: both are compared"
    " (`angle.shafts_parted`)",
    "ratio": "how many turns this encoder makes for one of that one, negative the other way round;"
    " 1 where not told",
    "tolerance_deg": "how far both may part at standstill [deg]; 2 where not told",
}
"""Keys of `[bus.NAME.node.N]` and `[node.N]` with their meaning."""


class _Reader:
    """Reads the tables and collects every mistake."""

    def __init__(self, base: Path | None, files: Mapping[str, bytes]) -> None:
        self.errors: list[str] = []
        self.bitrates: dict[str, int] = {}
        self.data_bitrates: dict[str, int] = {}
        self.nodes: dict[tuple[str | None, int], NodeEntry] = {}
        self.used: dict[str, bytes] = {}
        self._base = base
        self._files = files

    def read(self, data: Mapping[str, Any]) -> None:
        self._only(data, "", {"bus", "node"})
        for bus, table in self._tables(data.get("bus", {}), "bus"):
            where = f"bus.{bus}"
            self._only(table, where, BUS_KEYS.keys())
            for key, rates in (("bitrate", self.bitrates), ("data_bitrate", self.data_bitrates)):
                if key in table:
                    self._bitrate(rates, bus, table[key], f"{where}.{key}")
            self._nodes(bus, table.get("node", {}), f"{where}.node")
        self._nodes(None, data.get("node", {}), "node")

    def _bitrate(self, rates: dict[str, int], bus: str, value: Any, where: str) -> None:
        if isinstance(value, int) and not isinstance(value, bool) and 0 < value <= 20_000_000:
            rates[bus] = value
        else:
            self.errors.append(f"{where}: {value!r} is no bit rate in bit/s, like 500000")

    def _nodes(self, bus: str | None, data: Any, where: str) -> None:
        for text, table in self._tables(data, where):
            try:
                node = integer(text)
            except ValueError:
                node = 0
            if 1 <= node <= 127:
                self.nodes[bus, node] = self._entry(table, f"{where}.{text}", node)
            else:
                self.errors.append(f"{where}.{text}: a node id is a number from 1 to 127")

    def _entry(self, table: Mapping[str, Any], where: str, node: int) -> NodeEntry:
        self._only(table, where, NODE_KEYS.keys())
        name = table.get("name")
        if name is not None and not isinstance(name, str):
            self.errors.append(f"{where}.name: {name!r} is no text")
        device = self._device(table, where)
        overrides = dict(self._pairs(table.get("overrides", {}), f"{where}.overrides"))
        if device is None:
            self.errors += [f"{where}.overrides: {each}" for each in check_numbers(overrides)]
        stated: dict[tuple[int, int], int] = {}
        try:
            if device is not None:
                device = configured(self._variant(device, overrides), overrides)
                stated = stated_objects(device, overrides, node)
        except DescriptionError as error:
            self.errors.append(f"{where}.overrides: {error}")
        return NodeEntry(
            name if isinstance(name, str) else None,
            device,
            stated | self._objects(table.get("objects", {}), f"{where}.objects"),
            overrides,
            *self._shaft(table, where),
        )

    def _shaft(
        self, table: Mapping[str, Any], where: str
    ) -> tuple[int | None, float, float | None]:
        """Which encoder shares the shaft, by what ratio, within what tolerance."""
        other = table.get("same_shaft_as")
        if other is not None and (type(other) is not int or not 1 <= other <= 127):
            self.errors.append(f"{where}.same_shaft_as: {other!r} is no node id from 1 to 127")
            other = None
        if other is not None and where.endswith(f".{other}"):
            self.errors.append(f"{where}.same_shaft_as: {other} is the node itself")
        elif other is None and "same_shaft_as" not in table:
            self.errors.extend(
                f"{where}.{key}: means nothing without same_shaft_as"
                for key in ("ratio", "tolerance_deg")
                if key in table
            )
        ratio = table.get("ratio", 1.0)
        if not _is_number(ratio) or not ratio:
            self.errors.append(f"{where}.ratio: {ratio!r} is no ratio, like 1 or -2.5")
            ratio = 1.0
        tolerance = table.get("tolerance_deg")
        if tolerance is not None and (not _is_number(tolerance) or tolerance <= 0):
            self.errors.append(
                f"{where}.tolerance_deg: {tolerance!r} is no angle in degrees above 0"
            )
            tolerance = None
        return other, float(ratio), tolerance

    def _device(self, table: Mapping[str, Any], where: str) -> Device | None:
        given = [key for key in ("device", "eds") if key in table]
        if len(given) == 2:
            self.errors.append(f"{where}: device and eds are both given, one is enough")
        if not given:
            return None
        name = table[given[0]]
        try:
            if not isinstance(name, str):
                raise DescriptionError(f"{name!r} is no text")
            return self._loaded(name)
        except DescriptionError as error:
            self.errors.append(f"{where}.{given[0]}: {error}")
            return None

    def _variant(self, device: Device, overrides: Mapping[str, Any]) -> Device:
        """The device that a setting names instead, where one does."""
        for name, value in overrides.items():
            setting = device.overrides.get(name)
            if setting is not None and setting.loads and str(value) in setting.means:
                return self._loaded(setting.means[str(value)])
        return device

    def _loaded(self, name: str) -> Device:
        if name in self._files:
            device = device_from_files(name, self._files)
            self.used |= device.files
            return device
        if not is_path(name):
            device = self._of_catalogue(name)
            self.used |= device.files
            return device
        device = load_device((self._base or Path()) / name)
        own, folder = Path(name).name, Path(name).parent
        for file, data in device.files.items():
            self.used[name if file == own else (folder / file).as_posix()] = data
        return device

    def _of_catalogue(self, name: str) -> Device:
        """A device by its name; one that only the capture's recorder knew from the files given."""
        try:
            return load_device(name)
        except DescriptionError:
            attached = next((file for file in _files_of(name) if file in self._files), None)
            if attached is None:
                raise
            return device_from_files(attached, self._files)

    def _objects(self, data: Any, where: str) -> dict[tuple[int, int], int]:
        found: dict[tuple[int, int], int] = {}
        for text, value in self._pairs(data, where):
            try:
                found[object_key(text)] = integer(value)
            except ValueError as error:
                self.errors.append(f"{where}.{text}: {error}")
        return found

    def _only(self, table: Mapping[str, Any], where: str, known: AbstractSet[str]) -> None:
        for key in sorted(table.keys() - known):
            path = f"{where}.{key}" if where else key
            self.errors.append(f"{path}: unknown key; known are {', '.join(sorted(known))}")

    def _pairs(self, data: Any, where: str) -> list[tuple[str, Any]]:
        if isinstance(data, dict):
            return list(data.items())
        self.errors.append(f"{where}: is no table")
        return []

    def _tables(self, data: Any, where: str) -> list[tuple[str, dict[str, Any]]]:
        pairs = self._pairs(data, where)
        for name, value in pairs:
            if not isinstance(value, dict):
                self.errors.append(f"{where}.{name}: is no table")
        return [(name, value) for name, value in pairs if isinstance(value, dict)]


def _is_number(value: Any) -> bool:
    """Whether a TOML value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
