"""What devices are told by, without reading their EDS: of the built-in ones it is kept in one file.

`data/index.json` is made of the device files by `python -m syncline_schemas.devices.index`.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from syncline_schemas.devices.build import device_from_files
from syncline_schemas.devices.factory import FactoryPdo, factory_tpdos
from syncline_schemas.devices.model import Device
from syncline_schemas.records import dataclass

DATA = Path(__file__).parent / "data"
INDEX = DATA / "index.json"
_RULES = ("needs_one_of", "excluded_by")


@dataclass(frozen=True, slots=True)
class Hallmarks:
    """What tells a device from others.

    Attributes:
        identity: rules on the objects that it answers, see `Device.identity`.
        tpdos: as it leaves the factory, by the identifier that node 0 would have.
    """

    identity: Mapping[str, Any]
    tpdos: Mapping[int, FactoryPdo]

    @classmethod
    def of(cls, device: Device) -> "Hallmarks":
        """Those of a device that is loaded."""
        return cls(device.identity, factory_tpdos(device))


@cache
def built_in_hallmarks() -> dict[str, Hallmarks]:
    """Those of the built-in devices by name."""
    import json

    listed = json.loads(INDEX.read_text(encoding="utf-8"))
    return {name: _read(entry) for name, entry in listed.items()}


def index_text() -> str:
    """The index as the device files make it."""
    import json

    found = {}
    for path in sorted(DATA.glob("*.toml")):
        names = [p for p in DATA.iterdir() if p.suffix != INDEX.suffix]
        device = device_from_files(path.name, {p.name: p.read_bytes() for p in names})
        own = Hallmarks.of(device)
        found[path.stem] = {"identity": own.identity, "tpdos": own.tpdos}
    return json.dumps(found, indent=1) + "\n"


def _read(entry: Mapping[str, Any]) -> Hallmarks:
    identity = {
        key: tuple(map(_rule, value))
        if key in _RULES
        else tuple(value)
        if isinstance(value, list)
        else value
        for key, value in entry["identity"].items()
    }
    tpdos = {int(can_id): FactoryPdo(*pdo) for can_id, pdo in entry["tpdos"].items()}
    return Hallmarks(identity, tpdos)


def _rule(rule: Mapping[str, Any]) -> dict[str, Any]:
    told = rule["is"]
    return {"object": tuple(rule["object"]), "is": told if isinstance(told, str) else tuple(told)}


if __name__ == "__main__":
    INDEX.write_text(index_text(), encoding="utf-8", newline="\n")
