"""Bus descriptions: what they say, and all that is wrong in one message."""

import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas.description import BusDescription, NodeEntry
from syncline_schemas.devices import Device
from syncline_schemas.errors import DescriptionError

WHOLE = """
[bus.can0]
bitrate = 500000
[bus.can0.node.5]
name = "main shaft"
device = "lir-da158a"
[bus.can0.node.5.objects]
"6001" = 131072
"1800:2" = 0xFE
"6000h" = "0x1"
[bus.can0.node.5.overrides]
max_rpm = 1500
[bus.can1.node.0x0A]
eds = "parts/widget.eds"
[node.7]
device = "jn2100"
[node.5]
name = "elsewhere"
"""
EDS = b"[FileInfo]\n[DeviceInfo]\nProductName=Widget\n[2000]\nParameterName=T\nDataType=7\nAccessType=rw\n"


def described(tmp_path: Path, text: str = WHOLE) -> BusDescription:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "widget.eds").write_bytes(EDS)
    (tmp_path / "bus.toml").write_text(text, encoding="utf-8")
    return BusDescription.load(tmp_path / "bus.toml")


def test_the_empty_description_says_nothing() -> None:
    empty = BusDescription()
    assert empty.node("can0", 5) is None
    assert empty.bitrate("can0") is None
    assert empty.described("can0") == {}
    assert BusDescription.loads("").text == ""


def test_a_whole_description(tmp_path: Path) -> None:
    description = described(tmp_path)
    assert description.bitrate("can0") == 500_000
    assert description.bitrate("can1") is None
    entry = description.node("can0", 5)
    assert entry is not None
    assert entry.device is not None
    assert (entry.name, entry.device.name) == ("main shaft", "lir-da158a")
    assert entry.objects == {(0x6001, 0): 131072, (0x1800, 2): 0xFE, (0x6000, 0): 1}
    assert entry.overrides == {"max_rpm": 1500}
    assert entry.device.limits["max_rpm"] == 1500
    assert entry.device.settings(entry.overrides)["max_rpm"] == 1500
    assert entry.device.settings()["max_rpm"] == 3000


def test_a_node_of_no_bus_holds_on_every_bus_that_has_none_of_its_own(tmp_path: Path) -> None:
    description = described(tmp_path)
    found = [description.node(bus, node) for bus in ("can0", "can9") for node in (5, 7)]
    assert [entry.name if entry else "" for entry in found] == [
        "main shaft", None, "elsewhere", None,
    ]  # fmt: skip
    assert sorted(description.described("can0")) == [5, 7]
    assert description.described("can0")[5].name == "main shaft"


def test_a_capture_keeps_what_is_needed_to_read_it_again(tmp_path: Path) -> None:
    description = described(tmp_path)
    assert "parts/widget.eds" in description.files
    assert {"lir-da158a.eds", "lir-da158a.toml", "jn2100.eds"} <= description.files.keys()
    again = BusDescription.loads(description.text, None, description.files)
    entry = again.node("can1", 10)
    assert entry is not None
    assert entry.device is not None
    assert entry.device.title == "Widget"
    assert again.files.keys() == description.files.keys()


def test_a_device_of_ones_own_brings_both_files(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text('title = "Own"\neds = "base.eds"\n', encoding="utf-8")
    (tmp_path / "base.eds").write_bytes(EDS)
    description = BusDescription.loads('[node.3]\ndevice = "own.toml"\n', tmp_path)
    assert sorted(description.files) == ["base.eds", "own.toml"]
    again = BusDescription.loads(description.text, files=description.files)
    entry = again.node("x", 3)
    assert entry is not None
    assert entry.device is not None
    assert entry.device.title == "Own"


def test_the_data_phase_has_a_bit_rate_of_its_own() -> None:
    text = "[bus.can0]\nbitrate = 500000\ndata_bitrate = 2000000\n[bus.can1]\nbitrate = 250000\n"
    description = BusDescription.loads(text)
    assert description.bitrate("can0") == 500_000
    assert description.data_bitrate("can0") == 2_000_000
    assert description.data_bitrate("can1") is None


def test_all_mistakes_are_told_at_once() -> None:
    text = """
speed = 3
[bus.can0]
bitrate = "fast"
data_bitrate = -1
nodes = 1
[bus.can0.node.300]
[bus.can0.node.5]
device = "lir-da1589"
colour = "red"
[bus.can0.node.5.objects]
"xyz" = 1
"6001" = "many"
[bus.can0.node.6]
device = "jn2100"
eds = "x.eds"
overrides = { quad = 9, cpr = 1 }
[node]
8 = 3
"""
    with pytest.raises(DescriptionError) as caught:
        BusDescription.loads(text)
    said = str(caught.value)
    for part in (
        "speed: unknown key", "bus.can0.bitrate: 'fast'", "bus.can0.data_bitrate: -1",
        "bus.can0.nodes: unknown key",
        "node.300: a node id", "did you mean lir-da158", "colour: unknown key",
        "'xyz' is no object", "'many' is no whole number", "device and eds are both given",
        "quad: 9 is none of", "cpr: there is no such setting", "node.8: is no table",
    ):  # fmt: skip
        assert part in said, part
    assert said.count("\n") == 11


@pytest.mark.parametrize("device", ['device = "lir-da158a"', ""])
@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("range = 1.5", "range: 1.5 is no whole number from 1 to"),
        ("range = 4096.0", "range: 4096.0 is no whole number"),
        ("cpr = 0", "cpr: 0 is no whole number from 1 to 4294967295"),
        ("cpr = true", "cpr: True is no "),
        ("turns = -1", "turns: -1 is no whole number"),
        ("max_rpm = 0", "max_rpm: 0 is no number from 0.001 to 1e+06"),
        ("max_rpm = nan", "max_rpm: nan is no number"),
        ("reset_quiet_s = -1", "reset_quiet_s: -1 is no number from 0 to 3600"),
        ("bootup_bytes = [300]", "bootup_bytes: [300] is no list of numbers from 0 to 255"),
    ],
)
def test_numbers_of_settings_must_make_sense(device: str, setting: str, said: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        BusDescription.loads(f"[node.1]\n{device}\n[node.1.overrides]\n{setting}\n")
    assert f"node.1.overrides: {'settings of lir-da158a: ' if device else ''}{said}" in str(
        caught.value
    )


def test_every_wrong_number_is_told_at_once() -> None:
    text = '[node.1]\ndevice = "lir-da158a"\n[node.1.overrides]\ncpr = 0\nturns = -1\nrange = 1.5'
    with pytest.raises(DescriptionError) as caught:
        BusDescription.loads(text)
    assert all(name in str(caught.value) for name in ("cpr: 0", "turns: -1", "range: 1.5"))


def test_what_is_no_toml_or_not_there(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="is no TOML"):
        BusDescription.loads("[bus")
    with pytest.raises(DescriptionError, match=r"no\.toml cannot be read"):
        BusDescription.load(tmp_path / "no.toml")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DescriptionError, match=r"b\.toml cannot be read"):
        BusDescription.load(tmp_path / "b.toml")


VALUES = st.recursive(
    st.integers(-5, 300) | st.booleans() | st.text(max_size=8) | st.floats(allow_nan=False),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["5", "can0", "node", "device", "eds", "objects"]), inner)
    ),
    max_leaves=8,
)


def toml(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(toml(part) for part in value) + "]"
    return json.dumps(value).replace("Infinity", "inf")


@settings(max_examples=150, deadline=None)
@given(
    VALUES, st.sampled_from(["bus", "node", "node.5", "bus.x.node.5.objects", "node.5.overrides"])
)
def test_nothing_in_a_description_raises_anything_but_our_error(value: Any, place: str) -> None:
    with suppress(DescriptionError):
        BusDescription.loads(f"{place} = {toml(value)}\n")


@pytest.mark.parametrize("name", ["a\\u0000.eds", "a\\u0000", "", ".", "x.toml", "/", "..eds"])
def test_names_that_no_file_can_have(name: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError):
        BusDescription.loads(f'[node.5]\ndevice = "{name}"\n', tmp_path)


def only(text: str) -> NodeEntry:
    entry = BusDescription.loads(text).node("can0", 12)
    assert entry is not None
    return entry


def test_settings_that_state_a_value_are_values_of_objects() -> None:
    """JN2100 sheet, 8: output, pdo_owner; an object that is told as well counts more."""
    entry = only('[node.12]\ndevice = "jn2100"\n[node.12.overrides]\noutput = "vibration"\n')
    assert entry.objects == {(0x2047, 0): 1}
    text = '[node.12]\ndevice = "jn2100"\n[node.12.overrides]\npdo_owner = { 18A = 12, 28A = 12 }\n'
    assert only(text).objects == {(0x1800, 1): 0x18A, (0x1801, 1): 0x28A}
    both = text + '[node.12.objects]\n"1800:1" = 0x18B\n'
    assert only(both).objects[0x1800, 1] == 0x18B


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("{ 18A = 10 }", "say at node 10"),
        ("{ 701 = 12 }", "'701' is no identifier of a TPDO"),
        ("7", "7 is no table"),
    ],
)
def test_identifiers_that_cannot_be_the_nodes(value: str, words: str) -> None:
    with pytest.raises(DescriptionError, match=re.escape(words)):
        only(f'[node.12]\ndevice = "jn2100"\n[node.12.overrides]\npdo_owner = {value}\n')


def test_a_variant_is_another_device() -> None:
    """Sheet skbis-lir-canopen, 8."""
    entry = only('[node.12]\ndevice = "lir-ma158k"\n[node.12.overrides]\nvariant = "918"\n')
    assert entry.device is not None
    assert entry.device.name == "lir-918"
    same = only('[node.12]\ndevice = "lir-ma158k"\n[node.12.overrides]\nvariant = "auto"\n')
    assert same.device is not None
    assert same.device.name == "lir-ma158k"


def test_settings_that_change_what_a_device_does() -> None:
    def device(name: str, line: str) -> Device:
        found = only(f'[node.12]\ndevice = "{name}"\n[node.12.overrides]\n{line}\n').device
        assert found is not None
        return found

    assert device("lir-ma158k", "offset_reset_on_6000 = false").quirks.side_effects == ()
    assert device("lir-ma158k", "offset_reset_on_6000 = true").quirks.side_effects
    assert device("haomiao-38", "alias_2100 = false").quirks.undocumented == {}
    assert device("jn2100", "vendor_ids = [1]").identity["vendors"] == (1,)
    assert device("lir-da158", "max_rpm_mech = 8000").limits["max_rpm_mech"] == 8000
