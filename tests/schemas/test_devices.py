"""The device catalogue: facts against the sheets' own tables, identification, user devices."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas.canopen.datatypes import DATA_TYPES
from syncline_schemas.devices import (
    ABSENT,
    Device,
    configured,
    device_names,
    emcy_details,
    emcy_meaning,
    evidence,
    excluded,
    identify,
    identity_objects,
    load_device,
    quirks,
    register_bits,
    telling_objects,
)
from syncline_schemas.devices.check import check_file
from syncline_schemas.eds import variables
from syncline_schemas.errors import DescriptionError

NAMES = ["haomiao-38", "jn2100", "lir-918", "lir-da158", "lir-da158a", "lir-ma158k"]
SHEETS = Path(__file__).parents[3] / "shared" / "devices" / "od"
TYPE_NAMES = {"U8": 0x05, "U16": 0x06, "U32": 0x07, "I16": 0x03, "I32": 0x04, "VSTR": 0x09}


def eds_text(index: str = "2000", vendor: str = "0x10", product: str = "0x20") -> str:
    return f"""[FileInfo]
FileName=x.eds
[DeviceInfo]
VendorName=Acme
VendorNumber={vendor}
ProductName=Widget
ProductNumber={product}
[{index}]
ParameterName=Thing
ObjectType=7
DataType=7
AccessType=rw
DefaultValue=$NODEID+0x100
"""


def test_the_six_devices_are_there_without_a_fault() -> None:
    assert device_names(()) == NAMES
    assert [load_device(name).warnings for name in NAMES] == [()] * 6


@pytest.mark.parametrize("name", NAMES)
def test_facts_name_only_objects_that_the_eds_describes(name: str) -> None:
    device = load_device(name)
    assert set(device.facts) == {(v.index, v.subindex) for v in variables(device.od)}
    assert all(facts.data_type in DATA_TYPES for facts in device.facts.values())


@pytest.mark.skipif(not SHEETS.is_dir(), reason="shared/devices is not here")
@pytest.mark.parametrize("name", NAMES)
def test_every_row_of_the_object_table_is_in_the_device(name: str) -> None:
    device = load_device(name)
    table = json.loads((SHEETS / f"{name}.json").read_text(encoding="utf-8"))
    assert device.default_node == table["default_node"]
    for row in table["objects"]:
        facts = device.object(int(row["index"], 16), row["sub"] or 0)
        assert facts is not None, row
        assert facts.data_type == TYPE_NAMES[row["type"]], row
        assert facts.persisted == ("" if row["persisted"] == "-" else row["persisted"]), row
        assert bool(facts.unit) == (row["unit"] not in ("", "bits", "index")), row
        assert facts.meaning.split(" (")[0] == row["meaning"].split(" (")[0], row
    assert len(device.facts) >= len(table["objects"])


@pytest.mark.skipif(not SHEETS.is_dir(), reason="shared/devices is not here")
@pytest.mark.parametrize("name", NAMES)
def test_what_a_save_keeps_is_what_the_table_marks_as_kept(name: str) -> None:
    device = load_device(name)
    table = json.loads((SHEETS / f"{name}.json").read_text(encoding="utf-8"))
    kept = {
        (int(row["index"], 16), row["sub"] or 0)
        for row in table["objects"]
        if row["persisted"] == "yes" and "w" in row["access"]
    }
    stored = {key for group in device.quirks.storage.values() for key in group}
    stored |= set(device.quirks.stored_at_once)
    if device.quirks.saves_all:
        assert stored == set()
    else:
        assert kept <= stored


@pytest.mark.parametrize(
    ("name", "index", "sub", "node", "expected"),
    [
        ("lir-da158", 0x1014, 0, 5, 0x85),
        ("lir-da158", 0x1800, 1, 5, 0x185),
        ("lir-da158", 0x1801, 2, 5, 2),
        ("lir-da158", 0x1A00, 1, 5, 0x6004_0020),
        ("lir-da158", 0x1008, 0, 5, b"L158"),
        ("lir-da158", 0x6001, 0, 5, None),
        ("lir-da158", 0x7777, 0, 5, None),
        ("jn2100", 0x1200, 2, 10, 0x58A),
        ("jn2100", 0x1802, 1, 12, 0x38C),
        ("haomiao-38", 0x1800, 5, 1, None),
    ],
)
def test_defaults_of_the_manuals(
    name: str, index: int, sub: int, node: int, expected: int | bytes | None
) -> None:
    assert load_device(name).default(index, sub, node) == expected


def test_scales_and_units() -> None:
    jn2100 = load_device("jn2100")
    angle, temperature = jn2100.object(0x6010), jn2100.object(0x4080)
    assert angle is not None
    assert temperature is not None
    assert (angle.unit, angle.scale, angle.scale_object) == ("deg", 0.001, (0x6000, 0))
    assert (temperature.unit, temperature.scale) == ("degC", 0.1)
    inhibit = load_device("lir-da158a").object(0x1015)
    assert inhibit is not None
    assert (inhibit.unit, inhibit.scale) == ("us", 100)


def test_words_for_values() -> None:
    def words(name: str, index: int, value: int, sub: int = 0) -> str:
        facts = load_device(name).object(index, sub)
        assert facts is not None
        return facts.describe(value)

    assert words("jn2100", 0x2044, 1) == "Euler"
    assert words("jn2100", 0x2048, 6) == "y, x"
    assert words("lir-da158", 0x2100, 3) == "100 kbit/s"
    assert words("haomiao-38", 0x3001, 3) == "125 kbit/s"
    assert words("lir-da158", 0x6507, 0x01050201) == "profile 2.01, software 1.05"
    assert words("lir-918", 0x6000, 0x5001).startswith("counter-clockwise, Gray to binary")
    assert words("lir-da158", 0x6508, 7) == ""


@pytest.mark.parametrize(
    ("name", "code", "expected"),
    [
        ("lir-da158", 0x7320, "position error"),
        ("lir-da158", 0x5530, "EEPROM error"),
        ("jn2100", 0x4210, "device temperature"),
        ("jn2100", 0x3120, "supply voltage"),
        ("haomiao-38", 0x1000, "generic error"),
        ("haomiao-38", 0x6123, "internal software"),
        (None, 0x8130, "life guard or heartbeat error"),
        (None, 0xABCD, "unknown code"),
    ],
)
def test_emcy_words_come_from_the_device_first(name: str | None, code: int, expected: str) -> None:
    assert emcy_meaning(load_device(name) if name else None, code) == expected


def test_error_register_and_manufacturer_bytes() -> None:
    lir = load_device("lir-da158")
    assert register_bits(lir, 0xA0) == ["node-guard", "eeprom"]
    assert register_bits(None, 0xA0) == ["device profile", "manufacturer"]
    assert emcy_details(lir, bytes.fromhex("0100040000")) == {
        "alarms": 1,
        "alarms_bits": ["position code invalid"],
        "warnings": 4,
        "warnings_bits": ["watchdog reset"],
    }
    assert emcy_details(load_device("jn2100"), bytes(5)) == {}
    assert emcy_details(lir, b"") == {
        "alarms": 0, "alarms_bits": [], "warnings": 0, "warnings_bits": [],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("known", "expected"),
    [
        ({}, None),
        ({(0x1000, 0): 0x10196}, None),
        ({(0x1008, 0): b"L158"}, None),
        ({(0x1008, 0): b"L158", (0x6200, 0): 515}, "lir-da158"),
        ({(0x1008, 0): b"L158", (0x6200, 0): ABSENT}, "lir-da158a"),
        ({(0x1008, 0): b"L158", (0x1015, 0): 0}, "lir-da158a"),
        ({(0x1008, 0): b"L158", (0x1015, 0): ABSENT}, "lir-da158"),
        ({(0x1008, 0): b"L158", (0x1010, 0): 3}, "lir-da158"),
        ({(0x1008, 0): b"L158", (0x1010, 0): 1}, "lir-da158a"),
        ({(0x1008, 0): b"L158", (0x1015, 0): 0, (0x6200, 0): 515}, None),
        ({(0x1008, 0): b"L158", (0x1010, 0): 1, (0x1018, 2): 0x000CA001}, "lir-da158a"),
        ({(0x1008, 0): b"L158", (0x1018, 2): 0x000CA001}, None),
        ({(0x1008, 0): int.from_bytes(b"M158", "little")}, "lir-ma158k"),
        ({(0x1008, 0): b"M158", (0x1000, 0): 0x20196}, "lir-ma158k"),
        ({(0x1008, 0): b"M158", (0x1000, 0): 0x192}, None),
        ({(0x1008, 0): b"L918"}, "lir-918"),
        ({(0x1018, 2): 0x000D0001}, "lir-918"),
        ({(0x1008, 0): b"Other", (0x1018, 2): 0x000D0001}, None),
        ({(0x1008, 0): b"JN2100\0\0"}, "jn2100"),
        ({(0x1008, 0): b"JN2100", (0x1000, 0): 0x4019A, (0x1018, 1): 0x159}, "jn2100"),
        ({(0x1000, 0): 0x4019A}, None),
        ({(0x1008, 0): b"MAGA", (0x1000, 0): 0x20196}, None),
        ({(0x1008, 0): b"MAGA", (0x1000, 0): 0x20196, (0x3001, 0): 3}, "haomiao-38"),
        ({(0x1008, 0): -1}, None),
    ],
)
def test_a_node_is_identified_only_by_evidence_that_fits_one_device(
    known: dict[tuple[int, int], int | bytes], expected: str | None
) -> None:
    found = identify(known, ())
    assert (found.name if found else None) == expected


def test_what_tells_the_generations_apart_in_the_quirks() -> None:
    old, new = (load_device(name).quirks for name in ("lir-da158", "lir-da158a"))
    assert (old.bootup_bytes, new.bootup_bytes) == ((0,), (0, 0x7F))
    assert (old.type_0, new.type_0) == ("off", "once_per_change")
    assert old.error_reactions.keys() == {0, 1}
    assert new.error_reactions[2] == "stopped"
    assert new.side_effects == (((0x6000, 0), (0x6509, 0), 0),)
    assert quirks(None).reset_quiet_ms == 0
    assert old.reset_quiet_ms == new.reset_quiet_ms == 4000


def test_settings_of_a_user_change_quirks_and_limits() -> None:
    given = {"reset_quiet_s": 1.5, "empty_hb": "off", "fixed_cobids": False, "max_rpm": 100,
             "bootup_bytes": [0], "type0": "off", "cpr": 1024}  # fmt: skip
    device = configured(load_device("lir-da158a"), given)
    assert device.quirks.reset_quiet_ms == 1500
    assert device.quirks.empty_heartbeat_after_rtr is False
    assert device.quirks.pdo_cob_id_mask == 0xFFFFFFFF
    assert device.quirks.bootup_bytes == (0,)
    assert device.quirks.type_0 == "off"
    assert device.limits["max_rpm"] == 100
    assert load_device("lir-da158a").quirks.reset_quiet_ms == 4000
    assert configured(load_device("lir-da158a"), {"emcy_layout": "none"}).emcy_fields == ()
    warm = configured(load_device("jn2100"), {"temp_scale": 1}).object(0x4080)
    assert warm is not None
    assert warm.scale == 1
    assert configured(load_device("jn2100"), {"guard_reaction": "1029h"}).quirks != quirks(None)


def test_settings_that_make_no_sense_are_told_at_once() -> None:
    with pytest.raises(DescriptionError) as caught:
        configured(load_device("lir-da158"), {"cpr": "many", "type0": 3, "speed": 1, "u32_1003": 2})
    for said in (
        "cpr: 'many' is no number",
        "type0: 3 is none of",
        "speed: there is no",
        "u32_1003",
    ):
        assert said in str(caught.value)


@pytest.mark.parametrize("name", NAMES)
def test_every_setting_takes_its_own_default(name: str) -> None:
    device = load_device(name)
    same = configured(device, device.settings())
    assert same.quirks == device.quirks
    assert same.limits == device.limits


def test_an_unknown_name_gets_its_neighbours() -> None:
    with pytest.raises(DescriptionError, match="did you mean lir-da158"):
        load_device("LIR-DA185")
    with pytest.raises(DescriptionError, match="known are haomiao-38"):
        load_device("zzz")
    with pytest.raises(DescriptionError, match=r"x\.eds cannot be read"):
        load_device("x.eds")


def test_any_eds_is_a_device_without_quirks(tmp_path: Path) -> None:
    path = tmp_path / "widget.eds"
    path.write_text(eds_text(), encoding="utf-8")
    device = load_device(path)
    assert (device.name, device.title, device.vendor, device.kind) == (
        "widget", "Widget", "Acme", "generic",
    )  # fmt: skip
    assert device.default(0x2000, 0, 3) == 0x103
    assert device.emcy_meaning(0x8130) == "life guard or heartbeat error"
    assert device.quirks == quirks(None)
    assert load_device(device) is device


def test_an_encoder_by_its_profile_gets_the_measurement_of_cia_406(tmp_path: Path) -> None:
    path = tmp_path / "enc.eds"
    path.write_text(eds_text("1000").replace("$NODEID+0x100", "0x20196"), encoding="utf-8")
    assert load_device(path).kind == "encoder"
    assert load_device(path).measurement["counts_per_turn"] == (0x6001, 0)


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "widget.eds"
    path.write_text(eds_text(), encoding="utf-8")
    load_device(path)
    path.write_text(eds_text().replace("0x100", "0x2000"), encoding="utf-8")
    os.utime(path, ns=(1, 1))
    assert load_device(path).default(0x2000, 0, 3) == 0x2003


@pytest.fixture
def own_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "widget.eds").write_text(eds_text(), encoding="utf-8")
    (tmp_path / "widget.toml").write_text(
        'title = "My widget"\nkind = "encoder"\n[identity]\nname = "WDG"\n'
        '[quirks]\nreset_quiet_ms = 10\n[objects]\n"2000" = { unit = "mm", scale = 0.5 }\n'
        '[limits]\nmax_rpm = 5\n[emcy.codes]\nFF01 = "widget jammed"\n',
        encoding="utf-8",
    )
    (tmp_path / "plain.eds").write_text(eds_text(product="0x21"), encoding="utf-8")
    monkeypatch.setenv("SYNCLINE_DEVICES", str(tmp_path))
    return tmp_path


@pytest.mark.usefixtures("own_devices")
def test_adding_a_device_is_adding_two_files() -> None:
    assert device_names()[-2:] == ["plain", "widget"]
    device = load_device("widget")
    facts = device.object(0x2000)
    assert facts is not None
    assert (device.title, device.quirks.reset_quiet_ms, facts.unit) == ("My widget", 10, "mm")
    assert device.emcy_meaning(0xFF01) == "widget jammed"
    assert sorted(device.files) == ["widget.eds", "widget.toml"]
    found = identify({(0x1008, 0): b"WDG"})
    assert found is device


@pytest.mark.usefixtures("own_devices")
def test_an_eds_alone_is_identified_by_vendor_and_product() -> None:
    found = identify({(0x1018, 1): 0x10, (0x1018, 2): 0x21})
    assert found is not None
    assert found.name == "plain"
    assert identify({(0x1018, 1): 0x11, (0x1018, 2): 0x21}) is None


def test_a_user_file_hides_a_built_in_device(own_devices: Path) -> None:
    (own_devices / "jn2100.eds").write_text(eds_text(), encoding="utf-8")
    assert load_device("jn2100").title == "Widget"


def test_a_device_of_ones_own_is_identified_before_a_built_in_one(own_devices: Path) -> None:
    text = (own_devices / "widget.toml").read_text(encoding="utf-8").replace("WDG", "JN2100")
    (own_devices / "widget.toml").write_text(text, encoding="utf-8")
    found = identify({(0x1008, 0): b"JN2100"})
    assert found is not None
    assert found.name == "widget"


def test_a_broken_file_of_ones_own_does_not_hinder_the_others(own_devices: Path) -> None:
    (own_devices / "broken.toml").write_text("[", encoding="utf-8")
    assert "broken" in device_names()
    found = identify({(0x1008, 0): b"JN2100"})
    assert found is not None
    assert found.name == "jn2100"


def test_all_mistakes_of_a_device_file_are_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "bad.eds").write_text(eds_text(), encoding="utf-8")
    (tmp_path / "bad.toml").write_text(
        'kind = "boat"\ncolour = "red"\n[quirks]\nreset_quiet_ms = "long"\njumps = [{ object = "x" }]\n'
        '[objects]\n"99" = {}\n"zz" = { unit = 3 }\n"2000" = { text = "{a}" }\n'
        '"2001" = { bits = { 99 = "x" } }\n"2002" = { fields = { a = [5, 3] } }\n',
        encoding="utf-8",
    )
    with pytest.raises(DescriptionError) as caught:
        load_device(tmp_path / "bad.toml")
    for said in ("kind: 'boat'", "colour: unknown key", "reset_quiet_ms: 'long'", "quirks.jumps",
                 "'zz' is no object", "objects.zz.unit", "objects.2000: 'a'", "bit number from 0", "range of bits"):  # fmt: skip
        assert said in str(caught.value)


def test_a_toml_without_its_eds(tmp_path: Path) -> None:
    (tmp_path / "lonely.toml").write_text('title = "x"\n', encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"needs an EDS file beside it: lonely\.eds"):
        load_device(tmp_path / "lonely.toml")


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(NAMES), st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.binary(max_size=9))
def test_no_bytes_of_a_bus_raise(name: str, index: int, sub: int, data: bytes) -> None:
    device = load_device(name)
    value: Any = device.value(index, sub, data)
    facts = device.object(index, sub)
    if facts is not None and isinstance(value, int):
        facts.describe(value)
    device.default(index, sub, 127)
    emcy_details(device, data)
    identify({(0x1008, 0): data, (index, sub): data}, ())


def checked(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "x.eds"
    path.write_text(text, encoding="utf-8")
    result = check_file(path)
    assert result.usable
    return [str(fault) for fault in result.faults]


def test_a_check_tells_what_an_importer_does_not_see(tmp_path: Path) -> None:
    mapping = (
        "[1A00]\nParameterName=Map\nObjectType=9\nSubNumber=3\n"
        "[1A00sub0]\nParameterName=n\nDataType=5\nAccessType=ro\nDefaultValue=2\n"
        "[1A00sub1]\nParameterName=1\nDataType=7\nAccessType=ro\nDefaultValue=0x20000010\n"
        "[1A00sub2]\nParameterName=2\nDataType=7\nAccessType=ro\nDefaultValue=0x30000040\n"
    )
    limits = eds_text("2000").replace("$NODEID+0x100", "7") + "LowLimit=8\nHighLimit=9\n"
    said = "\n".join(checked(tmp_path, limits + mapping))
    assert "mandatory object 1000h (device type) is missing" in said
    assert "[1A00sub1]: maps 16 bits of 2000h:00, which is UNSIGNED32" in said
    assert "[1A00sub2]: maps 3000h:00, which is not described" in said
    assert "[1A00]: maps 80 bits" in said
    assert "[2000]: default 7 is outside its limits 8 .. 9" in said


@pytest.mark.parametrize("name", NAMES)
def test_the_built_in_devices_pass_the_check(name: str, tmp_path: Path) -> None:
    device: Device = load_device(name)
    path = tmp_path / f"{name}.eds"
    path.write_bytes(device.files[path.name])
    assert check_file(path).faults == ()


def test_a_file_with_nothing_in_it_is_not_usable(tmp_path: Path) -> None:
    path = tmp_path / "x.eds"
    path.write_text("hello\n", encoding="utf-8")
    result = check_file(path)
    assert not result.usable
    assert "holds no object" in str(result.problem)


def test_what_an_eds_lacks_comes_from_the_profile_of_its_1000h(tmp_path: Path) -> None:
    """CiA 406: 6000h bit 0 is the code sequence, bit 2 the scaling; the EDS keeps its own names."""
    text = eds_text("1000").replace("$NODEID+0x100", "0x20196")
    text += "[6000]\nParameterName=Mine\nObjectType=7\nDataType=6\nAccessType=rw\nDefaultValue=0\n"
    text += "[6508]\nParameterName=Hours\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=\n"
    path = tmp_path / "enc.eds"
    path.write_text(text, encoding="utf-8")
    device = load_device(path)
    facts, hours = device.object(0x6000), device.object(0x6508)
    assert facts is not None
    assert hours is not None
    assert (facts.name, facts.describe(5)) == ("Mine", "counter-clockwise, scaling on")
    assert (hours.unit, hours.scale, hours.name) == ("h", 0.1, "Hours")
    assert device.health == {"operating time": (0x6508, 0)}


def test_words_of_a_change_must_be_a_format_of_value_words_and_unit(tmp_path: Path) -> None:
    (tmp_path / "x.eds").write_text(eds_text(), encoding="utf-8")
    (tmp_path / "x.toml").write_text(
        '[objects]\n"2000" = { change = "set to {valeu}" }\n[health]\n"wear" = "zz"\n',
        encoding="utf-8",
    )
    with pytest.raises(DescriptionError) as caught:
        load_device(tmp_path / "x.toml")
    assert "objects.2000.change" in str(caught.value)
    assert "health: 'zz' is no object" in str(caught.value)


@pytest.mark.usefixtures("own_devices")
def test_objects_that_tell_ones_own_devices_are_asked_for(own_devices: Path) -> None:
    assert 0x2077 not in identity_objects()
    (own_devices / "more").mkdir()
    (own_devices / "more" / "m.eds").write_text(eds_text(), encoding="utf-8")
    (own_devices / "more" / "m.toml").write_text(
        '[identity]\nname = "M"\nexcluded_by = [{ object = "2077:1", is = "present" }]\n',
        encoding="utf-8",
    )
    assert 0x2077 in identity_objects((own_devices / "more",))


@pytest.mark.parametrize("name", NAMES)
def test_the_built_in_devices_are_told_by_objects_that_are_looked_at(name: str) -> None:
    rules = load_device(name).identity
    named = {
        rule["object"][0] for key in ("needs_one_of", "excluded_by") for rule in rules.get(key, ())
    }
    assert named <= identity_objects(())


def test_what_speaks_for_a_device_and_what_rules_it_out() -> None:
    known: dict[tuple[int, int], int | bytes] = {
        (0x1008, 0): b"L158",
        (0x1000, 0): 0x10196,
        (0x6200, 0): ABSENT,
    }
    assert evidence(load_device("lir-da158a"), known) == [(0x1008, 0), (0x1000, 0), (0x6200, 0)]
    assert excluded(load_device("lir-da158"), known) == [(0x6200, 0)]
    assert excluded(load_device("lir-da158a"), known) == []
    assert telling_objects([load_device("lir-da158")]) == [(0x6200, 0), (0x1015, 0), (0x1010, 0)]
