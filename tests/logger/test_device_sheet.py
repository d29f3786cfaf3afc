"""What is said of a device: every quirk has words, and the makers' tables are in it."""

import json
from dataclasses import fields
from pathlib import Path

import pytest

from syncline_logger.device_sheet import HANDLED, Section, objects, sections
from syncline_schemas.devices import GENERIC_QUIRKS, Quirks, device_names, load_device
from syncline_schemas.devices.profile import known_keys

SHEETS = Path(__file__).parents[3] / "shared" / "devices" / "od"
OWN = Path(__file__).parents[2] / "samples" / "own_devices" / "generic-406.toml"


def section(name: str, title: str) -> Section:
    return next(part for part in sections(load_device(name)) if part.title == title)


def test_every_quirk_says_what_syncline_makes_of_it() -> None:
    assert set(HANDLED) == {field.name for field in fields(Quirks)}
    assert set(known_keys()["quirks"]) == set(HANDLED)


@pytest.mark.parametrize("name", [*device_names(()), str(OWN)])
def test_every_row_has_as_many_cells_as_heads(name: str) -> None:
    device = load_device(name)
    parts = [objects(device), *sections(device)]
    assert {part.title for part in parts} >= {"Objects", "Recognised by", "Shown", "Quirks"}
    for part in parts:
        assert {len(row) for row in part.rows} == {len(part.heads)}
        assert all(isinstance(cell, str) for row in part.rows for cell in row)


@pytest.mark.parametrize("name", device_names(()))
def test_quirks_of_a_device_are_those_that_differ_from_cia_301(name: str) -> None:
    quirks = load_device(name).quirks
    wanted = {
        field.name.replace("_", " ")
        for field in fields(Quirks)
        if getattr(quirks, field.name) != getattr(GENERIC_QUIRKS, field.name)
    }
    assert {row[0] for row in section(name, "Quirks").rows} == wanted


@pytest.mark.skipif(not SHEETS.is_dir(), reason="shared/devices is not here")
@pytest.mark.parametrize("name", device_names(()))
def test_every_object_of_the_makers_table_is_in_the_sheet(name: str) -> None:
    table = json.loads((SHEETS / f"{name}.json").read_text(encoding="utf-8"))
    shown = {(row[0], row[3]) for row in objects(load_device(name)).rows}
    for row in table["objects"]:
        index, sub = int(row["index"], 16), row["sub"]
        places = {f"{index:04X}h:{sub or 0:02X}", *([] if sub else [f"{index:04X}h"])}
        access = {row["access"], row["access"].replace("const", "ro")}
        assert any((place, kind) in shown for place in places for kind in access), row


def test_the_settings_are_those_of_the_sheets() -> None:
    """Section 8 of the sheets ifm-jn2100, haomiao-38 and skbis-lir-canopen."""
    jn2100 = {"res", "quad", "angle_def", "i16_unsigned", "perp_formula", "temp_scale", "output",
              "guard_reaction", "rtr_any_state", "pdo_owner", "vendor_ids", "profile_version"}  # fmt: skip
    haomiao = {"cpr", "turns", "scaling", "direction", "alias_2100", "node_id_offset", "max_rpm",
               "follow_cobid_writes", "follow_mapping_writes", "hw_preset", "bootup_bytes"}  # fmt: skip
    lir = {"type0", "cpr", "turns", "range", "direction", "reset_quiet_s", "bootup_bytes",
           "empty_hb", "emcy_layout", "max_rpm", "max_rpm_mech", "fixed_cobids", "u32_1003"}  # fmt: skip
    for name, wanted in (("jn2100", jn2100), ("haomiao-38", haomiao), ("lir-da158", lir)):
        assert {row[0] for row in section(name, "Settings per node").rows} == wanted


def test_what_tells_how_a_device_is() -> None:
    shown = {(row[0], row[1]) for row in section("lir-da158", "Shown").rows}
    assert {("EEPROM writes", "1011h:04"), ("operating time", "6508h")} <= shown
    assert ("temperature", "4080h") in {row[:2] for row in section("jn2100", "Shown").rows}
