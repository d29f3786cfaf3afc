"""Finding devices: by name, by file, or by what a node answered."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from syncline_schemas.devices.build import EDS_SUFFIXES, device_from_files
from syncline_schemas.devices.index import DATA, Hallmarks, built_in_hallmarks
from syncline_schemas.devices.model import Device, Key
from syncline_schemas.errors import DescriptionError

FOLDER_VARIABLE = "SYNCLINE_DEVICES"
"""Environment variable that names folders of the user's own device files."""
_SUFFIXES = (".toml", *EDS_SUFFIXES)


_MANUFACTURER_SPECIFIC = range(0x2000, 0x6000)
"""CiA 301 7.4.1, table 38."""
ABSENT = b"absent"
"""In the evidence of `identify`: the node refused the object as not existing (0602 0000)."""


def user_folders() -> tuple[Path, ...]:
    """Folders of the user's own device files."""
    named = os.environ.get(FOLDER_VARIABLE, "")
    return tuple(Path(part) for part in named.split(os.pathsep) if part)


def device_names(folders: tuple[Path, ...] | None = None) -> list[str]:
    """Names of all devices: the built-in ones, then those of the user's folders."""
    return list(_catalog(user_folders() if folders is None else folders))


def load_device(
    name_or_path: str | os.PathLike[str] | Device, folders: tuple[Path, ...] | None = None
) -> Device:
    """Device by catalogue name or from an .eds, .dcf or .toml file; a Device is returned as it is.

    Raises:
        DescriptionError: there is no such device (with the nearest names), or its files are
            unusable.
    """
    if isinstance(name_or_path, Device):
        return name_or_path
    if is_path(os.fspath(name_or_path)):
        return _from_path(Path(name_or_path))
    catalog = _catalog(user_folders() if folders is None else folders)
    name = str(name_or_path)
    found = catalog.get(name) or catalog.get(name.lower())
    if found is None:
        raise DescriptionError(_unknown(name, catalog))
    return _from_path(found)


def is_path(name: str) -> bool:
    """Whether a device is named by a file instead of its catalogue name."""
    return Path(name).suffix.lower() in _SUFFIXES


def _unknown(name: str, catalog: Iterable[str]) -> str:
    import difflib

    names = list(catalog)
    near = difflib.get_close_matches(name.lower(), names, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(names)}."
    return f"no device is called {name!r}: {hint} A path to an .eds, .dcf, .xdd or .toml file works too."


def _catalog(folders: tuple[Path, ...]) -> dict[str, Path]:
    """File by device name; a user's file hides a built-in one of the same name."""
    return _built_in() | _own(folders) if folders else _built_in()


@cache
def _built_in() -> dict[str, Path]:
    return {name: DATA / f"{name}.toml" for name in built_in_hallmarks()}


def _own(folders: tuple[Path, ...]) -> dict[str, Path]:
    """File by device name in the user's folders; a TOML file hides its EDS."""
    found: dict[str, Path] = {}
    for folder in folders:
        for suffix in reversed(_SUFFIXES):
            found |= {path.stem: path for path in sorted(folder.glob(f"*{suffix}"))}
    return found


def _catalogs(folders: tuple[Path, ...] | None) -> tuple[dict[str, Path], dict[str, Path]]:
    """Files by device name: the user's, then the built-in ones."""
    return _own(user_folders() if folders is None else folders), _catalog(())


def hallmarks(folders: tuple[Path, ...] | None = None) -> Iterator[tuple[str, Hallmarks]]:
    """What tells each device from others, by name; a user's hides a built-in one of its name."""
    catalog = _catalog(user_folders() if folders is None else folders)
    for name, path in catalog.items():
        with suppress(DescriptionError):
            yield name, _indexed(path) or Hallmarks.of(_from_path(path))


def _indexed(path: Path) -> Hallmarks | None:
    """Those of a built-in device; a user's file has to be read for them."""
    return built_in_hallmarks().get(path.stem) if path.parent == DATA else None


def _those(paths: Iterable[Path], fits: Callable[[Mapping[str, Any]], bool]) -> list[Device]:
    """Devices of files whose rules fit; a user's file that is broken is told when it is asked for."""
    found = []
    for path in paths:
        with suppress(DescriptionError):
            if fits((_indexed(path) or _from_path(path)).identity):
                found.append(_from_path(path))
    return found


def _from_path(path: Path) -> Device:
    group = [path]
    if path.suffix.lower() == ".toml":
        group += [p for p in path.parent.glob("*") if p.suffix.lower() in EDS_SUFFIXES]
    return _cached(path, tuple((p, *_stamp(p)) for p in sorted(group)))


def _stamp(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DescriptionError(f"{path} cannot be read: {reason}") from error
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=256)
def _cached(path: Path, group: tuple[tuple[Path, int, int], ...]) -> Device:
    """Device of a file; the stamps of the files are part of the key, so that changes are seen."""
    return device_from_files(path.name, _Folder(p for p, _, _ in group))


class _Folder(dict[str, bytes]):
    """Content of files by name, read when asked for."""

    def __init__(self, paths: Iterable[Path]) -> None:
        super().__init__()
        self._paths = {path.name: path for path in paths}

    def __contains__(self, name: object) -> bool:
        return name in self._paths

    def __missing__(self, name: str) -> bytes:
        try:
            return self._paths[name].read_bytes()
        except OSError as error:
            raise DescriptionError(
                f"{self._paths[name]} cannot be read: {error.strerror}"
            ) from error


def identify(
    known: Mapping[Key, int | bytes], folders: tuple[Path, ...] | None = None
) -> Device | None:
    """Device by what a node answered: (index, sub) -> value, or ABSENT.

    A device is named only when the evidence fits one device alone; the user's own come first.
    "L158" in 1008h fits the old LIR-DA158 and the new LIR-DA158A; 1015h, 6200h or 1010h:0 must tell
    which (sheet skbis-lir-canopen, trap 20). "MAGA" needs 3000h or 3001h as well (sheet haomiao-38,
    trap 14).
    """
    name = _text_of(known.get((0x1008, 0)))
    if name is None and (0x1018, 2) not in known:
        return None
    for catalog in _catalogs(folders):
        fitting = _those(catalog.values(), lambda rules: _fits(rules, known, name))
        if fitting:
            return fitting[0] if len(fitting) == 1 else None
    return None


def identify_among(devices: Iterable[Device], known: Mapping[Key, int | bytes]) -> Device | None:
    """The one of `devices` that what a node answered fits, None where none or several do."""
    name = _text_of(known.get((0x1008, 0)))
    fitting = [device for device in devices if _fits(device.identity, known, name)]
    return fitting[0] if len(fitting) == 1 else None


def lookalikes(
    known: Mapping[Key, int | bytes], folders: tuple[Path, ...] | None = None
) -> list[Device]:
    """Devices of the name that a node answered, where nothing seen tells which one it is.

    Empty where `identify` names one device, or where what was seen contradicts all of them.
    """
    name = _text_of(known.get((0x1008, 0)))
    if name is None or identify(known, folders) is not None:
        return []

    def may_fit(rules: Mapping[str, Any]) -> bool:
        named = rules.get("name") == name
        return named and _fits({**rules, "needs_one_of": ()}, known, name)

    for catalog in _catalogs(folders):
        fitting = _those(catalog.values(), may_fit)
        if len(fitting) > 1:
            return fitting
    return []


def suspects(
    known: Mapping[Key, int | bytes], folders: tuple[Path, ...] | None = None
) -> list[Device]:
    """Devices that a node may be where what it answered proves none.

    A name that others carry too ("MAGA", sheet haomiao-38, trap 14), or the kind of the device
    together with an object of its maker's own. Empty where `identify` or `lookalikes` knows more.
    """
    name = _text_of(known.get((0x1008, 0)))
    if identify(known, folders) is not None or lookalikes(known, folders):
        return []
    for catalog in _catalogs(folders):
        found = _those(catalog.values(), lambda rules: _suspected(rules, known, name))
        if found:
            return found
    return []


def _suspected(
    rules: Mapping[str, Any], known: Mapping[Key, int | bytes], name: str | None
) -> bool:
    needed = rules.get("needs_one_of", ())
    if not needed:
        return False
    if name is not None:
        refuted = all(rule["object"] in known for rule in needed)
        return not refuted and _fits({**rules, "needs_one_of": ()}, known, name)
    if any(_holds(rule, known) for rule in rules.get("excluded_by", ())):
        return False
    own = [rule for rule in needed if rule["object"][0] in _MANUFACTURER_SPECIFIC]
    kind = known.get((0x1000, 0))
    return kind in rules.get("device_type", ()) and any(_holds(rule, known) for rule in own)


def evidence(device: Device, known: Mapping[Key, int | bytes]) -> list[Key]:
    """Objects of `known` that speak for a device, the most telling first."""
    rules = device.identity
    name = _text_of(known.get((0x1008, 0)))
    keys: list[Key] = []
    if name is not None and name == rules.get("name"):
        keys.append((0x1008, 0))
    if known.get((0x1018, 2)) in rules.get("product", ()):
        keys += [key for key in ((0x1018, 1), (0x1018, 2)) if key in known]
    if known.get((0x1000, 0)) in rules.get("device_type", ()):
        keys.append((0x1000, 0))
    keys += [rule["object"] for rule in rules.get("needs_one_of", ()) if _holds(rule, known)]
    return list(dict.fromkeys(keys))


def excluded(device: Device, known: Mapping[Key, int | bytes]) -> list[Key]:
    """Objects of `known` that rule a device out."""
    rules = device.identity.get("excluded_by", ())
    return [rule["object"] for rule in rules if _holds(rule, known)]


def telling_objects(devices: Iterable[Device]) -> list[Key]:
    """Objects that tell devices apart which answer the same name."""
    rules = (rule for device in devices for rule in device.identity.get("needs_one_of", ()))
    return list(dict.fromkeys(rule["object"] for rule in rules))


def identity_objects(folders: tuple[Path, ...] | None = None) -> frozenset[int]:
    """Indexes of the objects by which devices are told, those of the user's devices included."""
    return _identity_objects(user_folders() if folders is None else folders)


@lru_cache(maxsize=16)
def _identity_objects(folders: tuple[Path, ...]) -> frozenset[int]:
    return _IDENTITY | named_objects(_usable(_own(folders).values()))


def named_objects(devices: Iterable[Device]) -> frozenset[int]:
    """Indexes of the objects that the rules of devices name besides those of CiA 301."""
    return frozenset(
        rule["object"][0]
        for device in devices
        for rules in ("needs_one_of", "excluded_by")
        for rule in device.identity.get(rules, ())
    )


_IDENTITY: frozenset[int] = frozenset(
    {0x1000, 0x1008, 0x1009, 0x100A, 0x1010, 0x1015, 0x1018, 0x3000, 0x3001, 0x6200}
    | set(range(0x6503, 0x6509))
)
"""Indexes by which the built-in devices are told apart."""


def _usable(paths: Iterable[Path]) -> Iterator[Device]:
    """Devices of files; a user's file that is broken is told when it is asked for."""
    for path in paths:
        with suppress(DescriptionError):
            yield _from_path(path)


def _text_of(value: int | bytes | None) -> str | None:
    if isinstance(value, int):
        value = (value & (1 << 64) - 1).to_bytes(8, "little")
    return value.decode("latin-1").rstrip("\0 ") if value is not None else None


def _fits(rules: Mapping[str, Any], known: Mapping[Key, int | bytes], name: str | None) -> bool:
    if not rules:
        return False
    named = "name" in rules and name == rules["name"]
    product = known.get((0x1018, 2))
    produced = product is not None and product in rules.get("product", ())
    if "vendor" in rules:
        produced = produced and known.get((0x1018, 1)) == rules["vendor"]
    if not (named or (produced and (name is None or "name" not in rules))):
        return False
    device_type = known.get((0x1000, 0))
    if device_type is not None and device_type not in rules.get("device_type", (device_type,)):
        return False
    needed = rules.get("needs_one_of", ())
    if needed and not any(_holds(rule, known) for rule in needed):
        return False
    return not any(_holds(rule, known) for rule in rules.get("excluded_by", ()))


def _holds(rule: Mapping[str, Any], known: Mapping[Key, int | bytes]) -> bool:
    if rule["object"] not in known:
        return False
    value = known[rule["object"]]
    if isinstance(rule["is"], str):
        return (value == ABSENT) == (rule["is"] == "absent")
    return value in rule["is"]
