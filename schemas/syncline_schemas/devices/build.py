"""A device from the bytes of its files."""

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any, cast

from syncline_schemas.devices.model import Device, Key, Kind, ObjectFacts
from syncline_schemas.devices.profile import Profile, emcy_fields, read_profile, with_profile
from syncline_schemas.devices.standard import standard_profile
from syncline_schemas.eds import LoadedEds, load_eds, variables
from syncline_schemas.errors import DescriptionError

EDS_SUFFIXES = (".eds", ".dcf", ".xdd", ".xdc")


def device_from_files(name: str, files: Mapping[str, bytes]) -> Device:
    """Device from its EDS, DCF or TOML file in `files`; a TOML file names its EDS, or has its name.

    Raises:
        DescriptionError: a file is missing or unusable.
    """
    path = PurePath(name)
    if path.suffix.lower() in EDS_SUFFIXES:
        return _from_eds(path.stem, load_eds(files[name]), {name: files[name]})
    profile = read_profile(_decoded(name, files[name]), name)
    eds_name = eds_beside(name, profile, files)
    loaded = load_eds(files[eds_name])
    return _from_pair(path.stem, loaded, profile, {name: files[name], eds_name: files[eds_name]})


def eds_beside(name: str, profile: Profile, files: Mapping[str, bytes]) -> str:
    """Name of the EDS that belongs to a device's TOML file."""
    path = PurePath(name)
    wanted = [profile.eds] if profile.eds else [path.stem + suffix for suffix in EDS_SUFFIXES]
    for file_name in wanted:
        beside = path.with_name(file_name)
        for spelling in (str(beside), beside.as_posix()):
            if spelling in files:
                return spelling
    raise DescriptionError(
        f"{name} needs an EDS file beside it: {' or '.join(wanted)} is missing; "
        "name it with the key eds"
    )


def _decoded(name: str, data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DescriptionError(f"{name} is not UTF-8: {error}") from error


def _from_pair(
    name: str, loaded: LoadedEds, profile: Profile, files: Mapping[str, bytes]
) -> Device:
    codes = profile.emcy
    facts = with_profile(facts_of(loaded), profile)
    more: dict[str, Any] = {"emcy_register_names": codes["register"]} if "register" in codes else {}
    return Device(
        name=name,
        title=profile.title or _title(name, loaded),
        vendor=profile.vendor or loaded.info.get("deviceinfo.vendorname", ""),
        kind=cast("Kind", profile.kind),
        od=loaded.od,
        facts=facts,
        quirks=profile.quirks,
        default_node=profile.default_node,
        default_bitrate=profile.default_bitrate,
        identity=profile.identity,
        emcy_codes=codes.get("codes", {}),
        emcy_groups=codes.get("groups", {}),
        emcy_registers=codes.get("register_codes", {}),
        emcy_fields=emcy_fields(profile),
        measurement=profile.measurement,
        limits=profile.limits,
        health={what: key for what, key in profile.health.items() if key in facts},
        overrides=profile.overrides,
        notes=profile.notes,
        contradictions=profile.contradictions,
        warnings=tuple(loaded.warnings),
        files=files,
        **more,
    )


def _from_eds(name: str, loaded: LoadedEds, files: Mapping[str, bytes]) -> Device:
    """Device of which nothing is known but its EDS: the device profile's measurement, no quirks."""
    device_type = getattr(loaded.od.indices.get(0x1000), "default", None)
    number = device_type & 0xFFFF if isinstance(device_type, int) else 0
    profile = standard_profile(number) or Profile()
    objects = {
        key: {k: v for k, v in more.items() if k != "name"} for key, more in profile.objects.items()
    }
    plain = Profile(
        kind=profile.kind,
        measurement=profile.measurement,
        overrides=profile.overrides,
        health=profile.health,
        objects=objects,
    )
    plain.identity = _eds_identity(loaded)
    return _from_pair(name, loaded, plain, files)


def _eds_identity(loaded: LoadedEds) -> dict[str, Any]:
    """Vendor and product number: only both together tell a device."""
    identity = loaded.od.indices.get(0x1018)
    subs = getattr(identity, "subindices", {})
    values = [subs[sub].default if sub in subs else None for sub in (1, 2)]
    info = loaded.od.device_information
    vendor, product = values[0] or info.vendor_number, values[1] or info.product_number
    if not (isinstance(vendor, int) and isinstance(product, int) and vendor and product):
        return {}
    return {"vendor": vendor, "product": (product,)}


def _title(name: str, loaded: LoadedEds) -> str:
    return loaded.info.get("deviceinfo.productname") or name


def facts_of(loaded: LoadedEds) -> dict[Key, ObjectFacts]:
    """Facts of every variable as the EDS tells them."""
    facts: dict[Key, ObjectFacts] = {}
    for variable in variables(loaded.od):
        parent: Any = variable.parent
        facts[variable.index, variable.subindex] = ObjectFacts(
            index=variable.index,
            sub=variable.subindex,
            name=variable.name,
            data_type=variable.data_type,
            access=variable.access_type,
            mappable=variable.pdo_mappable,
            unit=variable.unit,
            scale=variable.factor,
            meaning=variable.description,
            low=variable.min,
            high=variable.max,
            record=parent.name if hasattr(parent, "subindices") else "",
        )
    return facts
