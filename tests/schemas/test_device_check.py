"""What a check says of description files: every kind of fault once, and nothing of a sound file."""

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas.devices import device_names, load_device
from syncline_schemas.devices.check import Fault, check_eds, check_file
from syncline_schemas.devices.check.kinds import KINDS, SEVERITIES
from syncline_schemas.errors import DescriptionError
from tests.schemas.test_xdd import XDC

WILD = Path(__file__).parents[3] / "shared" / "eds-in-the-wild"
CHECK = Path(__file__).parents[2] / "schemas" / "syncline_schemas"


def variable(
    name: str, data_type: int, access: str = "rw", *, mappable: int = 0, **keys: str
) -> str:
    lines = [f"[{name}]", f"ParameterName=Object {name}", "ObjectType=0x7",
             f"DataType=0x{data_type:04X}", f"AccessType={access}", f"PDOMapping={mappable}"]  # fmt: skip
    return "\n".join([*lines, *(f"{key}={value}" for key, value in keys.items())]) + "\n\n"


def record(index: str, *entries: tuple[int, str]) -> str:
    head = (
        f"[{index}]\nParameterName=Record {index}\nObjectType=0x9\nSubNumber={len(entries) + 1}\n\n"
    )
    first = variable(f"{index}sub0", 5, "ro", DefaultValue=f"{len(entries)}")
    rest = "".join(
        variable(f"{index}sub{sub}", data_type, "rw", DefaultValue=value)
        for sub, (data_type, value) in enumerate(entries, 1)
    )
    return head + first + rest


GENERAL = """[FileInfo]
FileName=drive.eds
FileVersion=1
FileRevision=1
EDSVersion=4.0
CreationTime=09:45AM
CreationDate=05-15-2024

[DeviceInfo]
VendorName=Acme
VendorNumber=0x147
ProductName=Drive
ProductNumber=0x30
RevisionNumber=1
OrderCode=4711
BaudRate_10=0
BaudRate_20=0
BaudRate_50=0
BaudRate_125=1
BaudRate_250=1
BaudRate_500=1
BaudRate_800=0
BaudRate_1000=1
SimpleBootUpMaster=0
SimpleBootUpSlave=1
Granularity=8
DynamicChannelsSupported=0
GroupMessaging=0
NrOfRXPDO=1
NrOfTXPDO=1
LSS_Supported=0

[DummyUsage]
Dummy0001=0
Dummy0002=0
Dummy0003=0
Dummy0004=0
Dummy0005=1
Dummy0006=0
Dummy0007=0

[Comments]
Lines=1
Line1=sound

[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=0x1001
3=0x1018

[OptionalObjects]
SupportedObjects=9
1=0x1003
2=0x1014
3=0x1017
4=0x1400
5=0x1600
6=0x1800
7=0x1A00
8=0x6040
9=0x6041

[ManufacturerObjects]
SupportedObjects=1
1=0x2000

"""
SOUND = (
    GENERAL
    + variable("1000", 7, "ro", DefaultValue="0x20192")
    + variable("1001", 5, "ro", mappable=1)
    + record("1003", (7, ""))
    + variable("1014", 7, DefaultValue="$NODEID+0x80")
    + variable("1017", 6, DefaultValue="0")
    + record("1018", (7, "0x147"), (7, "0x30"), (7, "1")).replace("=rw", "=ro")
    + record("1400", (7, "$NODEID+0x200"), (5, "255"))
    + record("1600", (7, "0x60400010"), (7, "0x00050008"))
    + record("1800", (7, "$NODEID+0x40000180"), (5, "1"))
    + record("1A00", (7, "0x60410010"), (7, "0x20000020"))
    + variable("2000", 4, "ro", mappable=1, LowLimit="-5", HighLimit="5", DefaultValue="-5")
    + variable("6040", 6, "rww", mappable=1)
    + variable("6041", 6, "ro", mappable=1)
)


def kinds(data: str | bytes, suffix: str = ".eds") -> set[str]:
    return {fault.kind for fault in faults(data, suffix)}


def faults(data: str | bytes, suffix: str = ".eds") -> tuple[Fault, ...]:
    return check_eds(data.encode() if isinstance(data, str) else data, suffix)


def test_a_sound_file_has_no_faults() -> None:
    assert faults(SOUND) == ()
    assert faults(SOUND.replace("\n", "\r\n")) == ()


TRIGGERS: list[tuple[str, str, str]] = [
    # kind, what is replaced in the sound file (in regular expressions), by what
    ("stray_line", r"\[FileInfo\]\n", "[FileInfo]\nnothing here\n"),
    ("bracket", r"\[Comments\]", "[Comments"),
    ("section_tail", r"\[Comments\]", "[Comments] x"),
    ("duplicate_section", r"\Z", "[1017]\nParameterName=Again\nDataType=7\n"),
    ("duplicate_key", r"VendorName=Acme", "VendorName=Acme\nVendorName=Other"),
    ("colon", r"VendorName=Acme", "VendorName:Acme"),
    ("inline_comment", r"VendorName=Acme", "VendorName=Acme ; who"),
    ("unknown_section", r"\Z", "[Whatever]\nx=1\n"),
    ("missing_section", r"\[FileInfo\][^\[]*", ""),
    ("missing_section", r"\[ManufacturerObjects\][^\[]*", ""),
    ("device_info_number", r"VendorNumber=0x147", "VendorNumber=Acme"),
    ("device_info_empty", r"VendorNumber=0x147", "VendorNumber="),
    ("device_info_missing", r"OrderCode=4711\n", ""),
    ("baud_rates", r"(BaudRate_\d+)=1", r"\1=0"),
    ("baud_rates", r"BaudRate_125=1", "BaudRate_125=125"),
    ("baud_rate_set", r"\Z", "[DeviceComissioning]\nNodeID=2\nBaudrate=800\n"),
    ("granularity", r"Granularity=8", "Granularity=128"),
    ("pdo_count", r"NrOfTXPDO=1", "NrOfTXPDO=4"),
    ("identity", r"VendorNumber=0x147", "VendorNumber=0x148"),
    ("identity", r"ProductNumber=0x30", "ProductNumber=30"),
    ("revision", r"RevisionNumber=1", "RevisionNumber=2"),
    ("file_info", r"05-15-2024", "15.5.2024"),
    ("file_info", r"09:45AM", "9:45"),
    ("dummy_missing", r"Dummy0003=0\n", ""),
    ("dummy_unknown", r"Dummy0003=0", "Dummy0003=0\nDummy0030=0"),
    ("commissioning", r"\Z", "[DeviceComissioning]\nNodeID=200\nBaudrate=250\n"),
    ("commissioning", r"\Z", "[DeviceComissioning]\nNodeID=2\nBaudrate=250000\n"),
    ("commissioning_name", r"\Z", "[DeviceCommissioning]\nNodeID=2\nBaudrate=250\n"),
    ("value_in_eds", r"\[2000\]", "[2000]\nParameterValue=1"),
    ("comment_lines", r"Lines=1", "Lines=2"),
    ("list_count", r"SupportedObjects=9", "SupportedObjects=8"),
    ("list_numbers", r"9=0x6041", "10=0x6041"),
    ("list_wrong", r"SupportedObjects=1\n", "SupportedObjects=2\n2=0x6041\n"),
    ("list_twice", r"SupportedObjects=1\n", "SupportedObjects=2\n2=0x2000\n"),
    ("listed_missing", r"\[6041\][^\[]*", ""),
    ("unlisted", r"\Z", variable("2001", 7)),
    ("mandatory", r"\[1001\][^\[]*", ""),
    ("identity_missing", r"\[1018.*?(?=\[1400\])", ""),
    ("error_control", r"\[1017\][^\[]*", ""),
    ("head_missing", r"\[1018\][^\[]*", ""),
    ("sub_number", r"SubNumber=4", "SubNumber=3"),
    ("sub_number", r"SubNumber=4\n", ""),
    ("sub_number", r"SubNumber=4", "SubNumber=four"),
    ("sub0_missing", r"\[1018sub0\][^\[]*", ""),
    ("sub0_type", r"(\[1018sub0\][^\[]*?DataType=)0x0005", r"\g<1>0x0007"),
    ("sub0_value", r"(\[1018sub0\][^\[]*?DefaultValue=)3", r"\g<1>4"),
    ("object_type", r"(\[2000\][^\[]*?ObjectType=)0x7", r"\g<1>VARIABLE"),
    ("object_type_subs", r"(\[1018\][^\[]*?ObjectType=)0x9", r"\g<1>0x7"),
    ("no_subs", r"(\[2000\][^\[]*?ObjectType=)0x7", r"\g<1>0x8"),
    ("object_kind", r"\[1017\][^\[]*", record("1017", (6, "0"))),
    ("name_missing", r"ParameterName=Object 2000\n", ""),
    ("name_missing", r"ParameterName=Object 1018sub1\n", ""),
    ("data_type", r"(\[2000\][^\[]*?)DataType=0x0004\n", r"\1"),
    ("data_type_unknown", r"(\[2000\][^\[]*?DataType=)0x0004", r"\g<1>0x0E00"),
    ("standard_type", r"(\[1017\][^\[]*?DataType=)0x0006", r"\g<1>0x0007"),
    ("standard_type", r"(\[1800sub1\][^\[]*?DataType=)0x0007", r"\g<1>0x0006"),
    ("standard_access", r"(\[1000\][^\[]*?AccessType=)ro", r"\g<1>rw"),
    ("access_type", r"AccessType=rww", "AccessType=readwrite"),
    ("value", r"DefaultValue=0x20192", "DefaultValue=drive"),
    ("value_range", r"(\[1800sub2\][^\[]*?DefaultValue=)1", r"\g<1>256"),
    ("octal", r"(\[1017\][^\[]*?DefaultValue=)0", r"\g<1>0100"),
    ("limits_order", r"LowLimit=-5", "LowLimit=6"),
    ("outside_limits", r"DefaultValue=-5", "DefaultValue=-6"),
    ("mappable_type", r"\Z", variable("2001", 9, mappable=1)),
    ("node_id", r"\$NODEID\+0x80", "$NODEID*2"),
    ("node_id_form", r"\$NODEID\+0x80", "0x80+$NODEID"),
    ("node_id_form", r"\$NODEID\+0x80", "$NodeId+0x80"),
    ("node_id_form", r"\$NODEID\+0x80", "$NODEID+0x70+0x10"),
    ("cob_id_node", r"\$NODEID\+0x200", "0x200"),
    ("cob_id_node", r"\$NODEID\+0x40000180", "0x40000180"),
    ("cob_id_node", r"\$NODEID\+0x80", "0x80"),
    ("cob_id_fixed", r"\$NODEID\+0x200", "0x205"),
    ("cob_id_unusual", r"\$NODEID\+0x200", "$NODEID+0x300"),
    ("cob_id_unusual", r"\[1017\]", variable("1005", 7, DefaultValue="0x81") + "[1017]"),
    ("cob_id_restricted", r"\$NODEID\+0x200", "$NODEID+0x700"),
    ("cob_id_restricted", r"\$NODEID\+0x200", "0x0"),
    ("cob_id_bits", r"\$NODEID\+0x200", "0x1200"),
    ("cob_id_twice", r"\$NODEID\+0x200", "$NODEID+0x180"),
    ("pdo_pair", r"\[1A00.*?(?=\[2000\])", ""),
    ("pdo_pair", r"\[1400.*?(?=\[1600\])", ""),
    ("transmission", r"(\[1800sub2\][^\[]*?DefaultValue=)1", r"\g<1>242"),
    ("mapping_missing", r"0x20000020", "0x20000120"),
    ("mapping_missing", r"0x20000020", "0x30000020"),
    ("mapping_length", r"0x20000020", "0x20000010"),
    ("mapping_length", r"0x20000020", "0x20000032"),
    ("mapping_too_long", r"0x60410010", "0x60410030"),
    ("mapping_count", r"(\[1A00sub0\][^\[]*?DefaultValue=)2", r"\g<1>3"),
    ("mapping_empty", r"0x20000020", "0"),
    ("mapping_not_allowed", r"(\[2000\][^\[]*?PDOMapping=)1", r"\g<1>0"),
    ("mapping_direction", r"AccessType=rww", "AccessType=ro"),
    ("mapping_direction", r"(\[2000\][^\[]*?AccessType=)ro", r"\g<1>wo"),
    ("mapping_granularity", r"Granularity=8", "Granularity=64"),
    ("dummy_tpdo", r"0x20000020", "0x00050008"),
    ("dummy_forbidden", r"Dummy0005=1", "Dummy0005=0"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "pattern", "by"), TRIGGERS)
def test_each_fault_is_named(kind: str, pattern: str, by: str) -> None:
    text, count = re.subn(pattern, by, SOUND, flags=re.DOTALL)
    assert count
    found = kinds(text)
    assert kind in found
    extra = found - {kind} - CONSEQUENCES
    assert not extra, "nothing else is wrong with it"


CONSEQUENCES = {
    "listed_missing", "unlisted", "list_wrong", "list_twice", "mapping_missing", "pdo_count",
    "sub_number", "mapping_length", "missing_section", "cob_id_unusual", "sub0_value", "mandatory",
    "identity_missing", "mapping_too_long", "error_control", "mapping_empty", "commissioning_name",
    "comment_lines", "device_info_missing", "standard_access", "value", "head_missing",
    "name_missing", "no_subs", "mapping_direction", "object_type", "duplicate_key", "mapping_granularity",
}  # fmt: skip
"""Kinds that may come with another fault because they follow from it."""


@pytest.mark.parametrize(
    ("written", "why"),
    [
        ("0x80+$NODEID", "$NODEID does not stand first"),
        ("$NodeId+0x80", "$NODEID is not written in capitals"),
        ("NODEID+0x80", "NODEID has no $ before it"),
        ("$NODEID+0x7F+1", "what follows $NODEID is not + and one number"),
        ("$NODEID-0x10+0x90", "what follows $NODEID is not + and one number"),
    ],
)
def test_what_is_unusual_about_an_expression_is_told(written: str, why: str) -> None:
    text = SOUND.replace("$NODEID+0x80", written)
    [fault] = [each for each in faults(text) if each.kind == "node_id_form"]
    assert fault.text == f"'{written}': {why}"


def test_faults_of_encodings() -> None:
    assert kinds(b"\xef\xbb\xbf" + SOUND.encode()) == {"byte_order_mark"}
    assert kinds(SOUND.replace("Acme", "Füße").encode("cp1252")) == {"encoding"}
    assert kinds(SOUND.encode("utf-16")) == {"encoding"}


def test_a_file_full_of_faults_is_bounded() -> None:
    found = faults(SOUND + "nonsense\n" * 30_000)
    assert len(found) == 10_001
    assert "and 20000 more" in [each.text for each in found]


def test_faults_of_xdd_files() -> None:
    assert kinds(XDC, ".xdc") == {"mandatory", "identity_missing", "error_control"}
    assert "value_in_eds" in kinds(XDC, ".xdd")
    assert "no_parameter" in kinds(XDC.replace('uniqueID="UID_P_2001"', 'uniqueID="other"'))
    assert "duplicate_section" in kinds(XDC.replace('index="2002"', 'index="2001"'))
    twice = XDC.replace("<dummyUsage>", "<CANopenObjectList/><dummyUsage>")
    assert "several_devices" in kinds(twice, ".xdc")
    line = next(n for n, text in enumerate(XDC.split("\n"), 1) if "0x20010010" in text) - 1
    longer = faults(XDC.replace("0x20010010", "0x20010020"), ".xdc")
    assert [each.line for each in longer if each.kind == "mapping_length"] == [line]


def test_a_dcf_needs_its_node_id() -> None:
    assert kinds(SOUND, ".dcf") == {"commissioning_missing"}
    configured = SOUND + "[DeviceComissioning]\nNodeID=5\nBaudrate=250\n"
    assert (
        kinds(configured.replace("$NODEID+0x200", "$NODEID+0x200\nParameterValue=0x321"), ".dcf")
        == set()
    )


def test_what_is_only_unusual_is_no_fault() -> None:
    """Near misses: mapping switched off, 29-bit identifiers, MPDOs, limits left at 0, PDO 5 and up."""
    for pattern, by in (
        (r"\$NODEID\+0x200", "0x80000000"),
        (r"\$NODEID\+0x200", "0xA0001234"),
        (r"\$NODEID\+0x200", "0x20001234"),
        (r"(\[1A00sub0\][^\[]*?DefaultValue=)2", r"\g<1>0"),
        (r"(\[1A00sub0\][^\[]*?DefaultValue=)2", r"\g<1>255"),
        (r"LowLimit=-5\nHighLimit=5", "LowLimit=0\nHighLimit=0"),
        (r"LowLimit=-5\nHighLimit=5", "LowLimit=0x80000000\nHighLimit=0x7FFFFFFF"),
        (r"DefaultValue=0x30", "DefaultValue="),
        (r"VendorNumber=0x147", "VendorNumber=327"),
        (r"Granularity=8", "Granularity=0"),
    ):
        text, count = re.subn(pattern, by, SOUND, flags=re.DOTALL)
        assert count
        assert kinds(text) == set(), by


def test_definitions_of_data_types_are_no_faults() -> None:
    structure = record("0040", (7, ""), (5, "")).replace("ObjectType=0x9", "ObjectType=0x6")
    simple = variable("0007", 7).replace("ObjectType=0x7", "ObjectType=0x5")
    assert kinds(SOUND + structure + simple) == set()


def test_every_kind_has_a_trigger_and_the_reader_knows_no_other() -> None:
    triggered = {kind for kind, *_ in TRIGGERS}
    elsewhere = {"byte_order_mark", "encoding", "no_parameter", "several_devices",
                 "commissioning_missing", "untold"}  # fmt: skip
    assert triggered | elsewhere | {"xml"} == set(KINDS)


def test_places_advice_and_what_the_reader_made_of_it() -> None:
    text = SOUND.replace("0x20000020", "0x20000010").replace("AccessType=rww", "AccessType=yes")
    length, access = faults(text)
    assert (length.severity, length.where, length.write) == (
        "error", "[1A00sub2]", "write 0x20000020",
    )  # fmt: skip
    lines = text.split("\n")
    assert length.line is not None
    assert access.line is not None
    assert lines[length.line - 1] == "DefaultValue=0x20000010"
    assert lines[access.line - 1] == "AccessType=yes"
    assert access.reading == "taken as rw"


def test_a_file_of_any_name_is_checked_by_its_content(tmp_path: Path) -> None:
    for name, content in (("drive.eds.bak", SOUND), ("drive.xml", XDC)):
        (tmp_path / name).write_text(content, encoding="utf-8")
        assert check_file(tmp_path / name).usable
    assert "cannot be read" in str(check_file(tmp_path).problem)
    (tmp_path / "drive.txt").write_text("hello", encoding="utf-8")
    assert f"{tmp_path / 'drive.txt'} holds no object" in str(
        check_file(tmp_path / "drive.txt").problem
    )


def test_the_worst_comes_first() -> None:
    text = SOUND.replace("OrderCode=4711\n", "").replace("0x20000020", "0x30000020")
    found = [fault.severity for fault in faults(text.replace("LowLimit=-5", "LowLimit=6"))]
    assert found == sorted(found, key=SEVERITIES.index)
    assert set(found) == set(SEVERITIES)


@pytest.mark.parametrize("name", device_names())
def test_the_devices_of_ours_are_sound(name: str) -> None:
    files = load_device(name).files
    assert [check_eds(data, ".eds") for file, data in files.items() if file.endswith(".eds")] == [
        ()
    ]


@pytest.mark.skipif(not WILD.is_dir(), reason="the collected EDS files are not here")
@pytest.mark.parametrize("path", sorted(WILD.glob("*")), ids=lambda p: p.stem)
def test_files_from_the_wild_are_checked(path: Path) -> None:
    """What is said of them was looked at by hand, kind by kind."""
    said = {
        "canopennode_DS301_profile_EMPTYVALS": {"file_info", "device_info_missing", "device_info_empty"},
        "cia406_profile_kacanopen": {"list_count", "file_info"},
        "deltaq_IQ3K3": {"mappable_type"},
        "faulhaber_605.3150.51-V-EK-2-60_CP1252": {"encoding", "limits_order"},
        "ifm_JN2100_V2.5.4_edited_default8": set(),
        "lely_coctl_NODUMMY": {"missing_section", "commissioning_missing", "device_info_missing",
                               "dummy_missing"},
        "roboteq_motor_controllers_v80": {"mapping_length"},
        "sevcon_espAC_rev6_NODATATYPE": {
            "object_type_subs", "identity", "revision", "sub0_value", "outside_limits", "limits_order",
            "value_range", "mapping_granularity", "cob_id_fixed"},
    }  # fmt: skip
    result = check_file(path)
    assert result.usable
    assert {fault.kind for fault in result.faults} == said.get(path.stem, set())


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_no_file_makes_a_check_raise(data: st.DataObject) -> None:
    content = bytearray(SOUND.encode())
    for _ in range(data.draw(st.integers(1, 8))):
        place = data.draw(st.integers(0, len(content) - 1))
        width = data.draw(st.integers(0, 12))
        content[place : place + width] = data.draw(
            st.one_of(
                st.binary(max_size=9), st.sampled_from([b"0xFFFFFFFFF", b"$NODEID", b"-1", b"]"])
            )
        )
    try:
        found = check_eds(bytes(content), ".dcf")
    except DescriptionError:
        return
    assert all(fault.kind in KINDS for fault in found)
