"""EDS and DCF loading: what is broken in the wild loads with warnings, and nothing is lost."""

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas.canopen.datatypes import DATA_TYPES
from syncline_schemas.devices import device_names, load_device
from syncline_schemas.eds import LoadedEds, assumed_value, load_eds, variables
from syncline_schemas.eds_text import parse
from syncline_schemas.errors import DescriptionError

WILD = Path(__file__).parents[3] / "shared" / "eds-in-the-wild"
WILD_FILES = sorted(WILD.glob("*")) if WILD.is_dir() else []


def variable(
    section: str = "2000",
    *,
    name: str = "Thing",
    object_type: str = "0x7",
    data_type: str = "0x0007",
    access: str = "rw",
    default: str = "",
    more: str = "",
) -> str:
    return (
        f"[{section}]\nParameterName={name}\nObjectType={object_type}\nDataType={data_type}\n"
        f"AccessType={access}\nDefaultValue={default}\nPDOMapping=0\n{more}\n"
    )


def eds(*sections: str, head: str = "[FileInfo]\n[DeviceInfo]\n") -> bytes:
    dummies = "[DummyUsage]\n" + "".join(f"Dummy000{n}=0\n" for n in range(1, 8))
    return (head + dummies + "\n".join(sections)).encode("utf-8")


def thing(loaded: LoadedEds, index: int = 0x2000) -> Any:
    return loaded.od[index]


def words(loaded: LoadedEds) -> str:
    return "\n".join(str(warning) for warning in loaded.warnings)


def test_a_clean_file_has_no_warnings() -> None:
    loaded = load_eds(eds(variable(default="0x10")))
    assert loaded.warnings == []
    assert thing(loaded).default == 16


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0x10", 16),
        ("10", 10),
        ("0x 00 10", 16),
        ("10h", 16),
        ("017", 15),
        ("08", 8),
        ('"5"', 5),
        ("0x10 ; comment", 16),
        ("0x10;", 16),
        ("$NODEID+0x180", 0x185),
        ("$NodeID + 0x180", 0x185),
        ("0x180+$NODEID", 0x185),
        ("NODEID+384", 0x185),
        ("$NODEID", 5),
        ("0x80000000 + $NODEID + 0x180", 0x80000185),
        ("", None),
        ("nonsense", None),
    ],
)
def test_default_values_in_every_spelling(text: str, expected: int | None) -> None:
    loaded = load_eds(eds(variable(default=text)))
    assert assumed_value(loaded.od, 0x2000, 0, 5) == expected


@pytest.mark.parametrize(
    ("data_type", "text", "expected"),
    [
        ("0x0003", "0xFFFE", -2),
        ("0x0003", "-2", -2),
        ("0x0001", "TRUE", 1),
        ("0x0008", "1.5", b"\x00\x00\xc0\x3f"),
        ("0x0008", "1,5", b"\x00\x00\xc0\x3f"),
        ("0x0011", "1.5", b"\x00\x00\x00\x00\x00\x00\xf8\x3f"),
        ("0x0009", "L158", b"L158"),
        ("0x000A", "01 02 0a", b"\x01\x02\x0a"),
        ("0x000F", "0x0102", b"\x01\x02"),
        ("0x0015", "0xFFFFFFFFFFFFFFFF", -1),
    ],
)
def test_default_values_by_type(data_type: str, text: str, expected: int | bytes) -> None:
    loaded = load_eds(eds(variable(data_type=data_type, default=text)))
    assert assumed_value(loaded.od, 0x2000, 0, 5) == expected


@pytest.mark.parametrize("spelling", ["DeviceComissioning", "DeviceCommissioning"])
def test_a_dcf_says_what_is_really_set(spelling: str) -> None:
    text = variable(default="0x10", more="ParameterValue=$NODEID+0x20")
    commissioning = f"[{spelling}]\nNodeID=0x07\nBaudrate=125\n[FileInfo]\n[DeviceInfo]\n"
    loaded = load_eds(eds(text, head=commissioning))
    assert assumed_value(loaded.od, 0x2000, 0, 7) == 0x27
    assert loaded.node_id == 7
    assert loaded.bitrate == 125_000
    assert loaded.warnings == []


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (variable(data_type=""), "DataType is missing"),
        (variable(data_type="0x00FF"), "DataType 0x00FF is not known"),
        (variable(access=""), "AccessType is missing"),
        (variable(object_type="x"), "ObjectType 'x' is no number"),
        (variable(default="0125"), "DefaultValue 0125 is octal by its leading 0: 85"),
        (variable(default="nonsense"), "DefaultValue 'nonsense' is no number"),
        (variable() + variable(name="Other"), "section [2000] again"),
        (variable(more="ParameterName=Other"), "ParameterName in [2000] again"),
        (variable(more="this is garbage"), "neither section nor key"),
        (variable(more="PDOMapping : 1"), "separated by a colon"),
        (variable("2000sub1"), "only its subindexes are described"),
        (variable() + variable("2000sub1"), "has subindexes: taken as a record"),
        (variable().replace("[2000]", "[2000"), "no closing bracket"),
        (variable() + variable("2000sub1FF"), "unknown section"),
        (variable() + "[OptionalObjects]\nSupportedObjects=1\n1=0x3000\n", "not described: 3000h"),
    ],
)
def test_a_fault_is_told_and_the_object_stays(broken: str, said: str) -> None:
    loaded = load_eds(eds(broken))
    assert said in words(loaded)
    assert 0x2000 in loaded.od.indices


@pytest.mark.parametrize(
    "data",
    [
        eds(variable(name="Größe")).decode().encode("cp1252"),
        b"\xef\xbb\xbf" + eds(variable(name="Größe")),
        eds(variable(name="Größe")).decode().encode("utf-16"),
        eds(variable(name="Größe")).decode().encode("utf-16-le"),
        eds(variable(name="Größe")).replace(b"\n", b"\r\n"),
        eds(variable(name="Größe")).replace(b"\n", b"\r"),
    ],
    ids=["cp1252", "utf-8 mark", "utf-16 mark", "utf-16", "crlf", "cr"],
)
def test_encodings_and_line_ends(data: bytes) -> None:
    assert load_eds(data).od[0x2000].name == "Größe"


def test_odd_case_of_sections_and_keys() -> None:
    data = eds(variable("2A0B")).decode().upper().replace("0X", "0x").encode()
    loaded = load_eds(data + variable("2a0csUB1").lower().encode())
    assert {0x2A0B, 0x2A0C} <= loaded.od.indices.keys()


def test_compact_arrays_are_written_out() -> None:
    head = variable("2000", object_type="0x8", default="7", more="CompactSubObj=3")
    names = "[2000Name]\nNrOfEntries=1\n2=Second\n[2000Value]\nNrOfEntries=1\n3=9\n"
    loaded = load_eds(eds(head, names))
    subs = thing(loaded).subindices
    assert [subs[sub].name for sub in (0, 1, 2, 3)] == [
        "Number of entries", "Thing 1", "Second", "Thing 3",
    ]  # fmt: skip
    assert [assumed_value(loaded.od, 0x2000, sub, 1) for sub in range(4)] == [3, 7, 7, 9]


@pytest.mark.parametrize(("mask", "implied"), [("0x3F", True), ("0", False), ("", False)])
def test_compact_pdos_are_written_out(mask: str, implied: bool) -> None:
    """Three TPDOs of which the file describes the second: 1 and 3 are to be understood."""
    info = f"[DeviceInfo]\nNrOfRXPDO=0\nNrOfTXPDO=3\nCompactPDO={mask}\n"
    described = "[1801]\nParameterName=Mine\nObjectType=9\nSubNumber=1\n" + variable(
        "1801sub1", data_type="0x7", default="0x222"
    )
    data = f"[FileInfo]\nFileName=x.eds\n{info}\n{described}".encode()
    loaded = load_eds(data)
    found = {variable.index for variable in variables(loaded.od) if variable.index >= 0x1000}
    assert found == ({0x1800, 0x1801, 0x1802, 0x1A00, 0x1A01, 0x1A02} if implied else {0x1801})
    if implied:
        ids = [assumed_value(loaded.od, index, 1, 5) for index in (0x1800, 0x1801, 0x1802)]
        assert ids == [0x185, 0x222, 0x385]
        assert assumed_value(loaded.od, 0x1802, 2, 5) is None


def test_data_types_defined_in_the_file_are_followed() -> None:
    limited = "[A0]\nObjectType=6\n[A0sub1]\nDefaultValue=0x0006\n"
    loaded = load_eds(eds(limited, variable(data_type="0xA0", default="5")))
    assert thing(loaded).data_type == 0x06


def test_types_by_name() -> None:
    data = eds(variable(object_type="VAR", data_type="Integer16", default="0xFFFF"))
    loaded = load_eds(data)
    assert (loaded.warnings, thing(loaded).default) == ([], -1)


def test_a_node_id_fills_in_the_dictionary() -> None:
    data = eds(variable(default="$NODEID+0x180"))
    assert thing(load_eds(data, node_id=5)).default == 0x185
    assert thing(load_eds(data)).default is None


def test_limits_of_every_integer_type() -> None:
    more = "LowLimit=-5\nHighLimit=0x7FFFFF"
    limited = thing(load_eds(eds(variable(data_type="0x10", more=more))))
    assert (limited.min, limited.max) == (-5, 0x7FFFFF)


def test_the_warnings_of_the_importer_go_nowhere_else(caplog: pytest.LogCaptureFixture) -> None:
    load_eds(eds(variable(data_type="0xFF"), head=""))
    assert caplog.records == []


@pytest.mark.parametrize("data", [b"", b"\x00\xff" * 40, b"<xml/>", b"[FileInfo]\nFileName=x\n"])
def test_what_holds_no_object_is_refused_with_a_reason(data: bytes) -> None:
    with pytest.raises(DescriptionError, match="holds no object"):
        load_eds(data)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"no\.eds cannot be read"):
        load_eds(tmp_path / "no.eds")


def described(text: str) -> set[tuple[int, int]]:
    """Variables that a file describes, counted without any of our code."""
    top = {int(m, 16) for m in re.findall(r"(?mi)^\[([0-9a-f]{4})\]", text)}
    subs = {
        (int(i, 16), int(s, 16))
        for i, s in re.findall(r"(?mi)^\[([0-9a-f]{4})sub([0-9a-f]+)\]", text)
    }
    return subs | {(index, 0) for index in top - {index for index, _ in subs}}


COMPACT = re.compile(r"(?mis)^\[([0-9a-f]{4})\][^\[]*?CompactSubObj=(\w+)")


@pytest.mark.skipif(not WILD_FILES, reason="shared/eds-in-the-wild is not here")
@pytest.mark.parametrize("path", WILD_FILES, ids=lambda path: path.name)
def test_files_of_the_wild_load_and_lose_nothing(path: Path) -> None:
    text = path.read_bytes().decode("cp1252").replace("\r\n", "\n")
    loaded = load_eds(path)
    compact = {int(i, 16): int(n, 0) for i, n in COMPACT.findall(text)}
    expected = described(text) | {(i, s) for i, n in compact.items() for s in range(n + 1)}
    found = {(v.index, v.subindex) for v in variables(loaded.od)}
    assert expected - found == set()
    extra = found - expected
    implied = {index for index, _ in extra if 0x1400 <= index < 0x1C00}
    assert bool(implied) == ("lely" in path.name), "the only one with CompactPDO and no PDOs"
    assert all(index in DATA_TYPES for index, _ in extra if index not in implied), "only dummies"
    assert text.count("$NODEID") == sum(
        "$NODEID" in getattr(v, "default_raw", "")
        for v in variables(loaded.od)
        if v.index not in implied
    )


@pytest.mark.skipif(not WILD_FILES, reason="shared/eds-in-the-wild is not here")
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("canopennode_DS301_profile_EMPTYVALS.eds", "VendorNumber is empty"),
        ("faulhaber_605.3150.51-V-EK-2-60_CP1252.eds", "Windows-1252"),
        ("lely_coctl_NODUMMY.dcf", "Dummy0001 missing"),
        ("sevcon_espAC_rev6_NODATATYPE.eds", "[290A]: ObjectType 7 has subindexes"),
    ],
)
def test_what_breaks_the_importer_is_a_warning(name: str, said: str) -> None:
    assert said in words(load_eds(WILD / name))


def mutated(data: bytes, draw: Any) -> bytes:
    """A file with a few faults: bytes changed, pieces dropped, doubled, moved or cut off."""
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        length = draw(st.integers(0, 200))
        piece = data[at : at + length]
        match draw(st.integers(0, 5)):
            case 0:
                data = data[:at] + draw(st.binary(max_size=20)) + data[at:]
            case 1:
                data = data[:at] + data[at + length :]
            case 2:
                data = data[:at] + piece + piece + data[at + length :]
            case 3:
                data = data[: at + 1]
            case 4:
                data = data.replace(
                    b"=", draw(st.sampled_from([b":", b"", b"==", b"=;", b" = "])), 40
                )
            case _:
                noise = draw(st.sampled_from([b"$NODEID", b"0x", b"-", b"]", b"[", b"\x85", b"%s"]))
                data = data[:at] + noise + data[at + length :]
    return data


SOURCES = [
    load_device(name).files[f"{name}.eds"][:6000] for name in device_names(()) if name != "lir-918"
] + [path.read_bytes()[:6000] for path in WILD_FILES]


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_no_mutation_raises_anything_but_our_error(data: st.DataObject) -> None:
    source = mutated(data.draw(st.sampled_from(SOURCES)), data.draw)
    try:
        loaded = load_eds(source)
    except DescriptionError:
        return
    for v in variables(loaded.od):
        assumed_value(loaded.od, v.index, v.subindex, 5)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["ParameterName", "ObjectType", "DataType", "DefaultValue", "LowLimit",
                             "SubNumber", "CompactSubObj", "ParameterValue", "PDOMapping", "Lines"]),
            st.text(max_size=12) | st.sampled_from(["0x8", "9", "$NODEID-", "1e400", "0x1B", "-0x80"]),
        ),
        max_size=8,
    ),
    st.sampled_from(["2000", "2000sub1", "0005", "1A00Name", "Comments", "DeviceComissioning"]),
)  # fmt: skip
def test_no_value_raises_anything_but_our_error(pairs: list[tuple[str, str]], name: str) -> None:
    text = f"[{name}]\n" + "".join(f"{key}={value}\n" for key, value in pairs)
    loaded = load_eds(eds(variable("3000"), text))
    assert 0x3000 in loaded.od.indices
    for v in variables(loaded.od):
        assumed_value(loaded.od, v.index, v.subindex, 5)


XDD = """<?xml version="1.0" encoding="utf-8"?>
<ISO15745ProfileContainer xmlns="http://www.canopen.org/xml/1.0"><ISO15745Profile><ProfileBody>
<DeviceIdentity><vendorName>Acme</vendorName><vendorID>0x10</vendorID></DeviceIdentity>
<ApplicationProcess><parameterList>
<parameter uniqueID="P1" access="read"><label lang="en">Speed</label><INT/>
<defaultValue value="0xFFFE"/></parameter>
</parameterList></ApplicationProcess>
<ApplicationLayers><CANopenObjectList>
<CANopenObject index="1014" name="COB-ID EMCY" objectType="7" dataType="0007" accessType="rw"
  defaultValue="$NODEID+0x80" PDOmapping="no"/>
<CANopenObject index="1018" name="Identity" objectType="9" subNumber="2">
<CANopenSubObject subIndex="00" name="n" objectType="7" dataType="0005" accessType="ro" defaultValue="1"/>
<CANopenSubObject subIndex="01" name="Vendor" objectType="7" dataType="0007" accessType="ro"/>
</CANopenObject>
<CANopenObject index="2000" name="Speed value" objectType="7" uniqueIDRef="P1" PDOmapping="optional"/>
</CANopenObjectList></ApplicationLayers></ProfileBody></ISO15745Profile></ISO15745ProfileContainer>
"""


def test_an_xdd_file_is_read_like_an_eds() -> None:
    loaded = load_eds(XDD.encode())
    assert loaded.warnings == []
    assert loaded.info["deviceinfo.vendorname"] == "Acme"
    assert {(v.index, v.subindex) for v in variables(loaded.od)} == {
        (0x1014, 0), (0x1018, 0), (0x1018, 1), (0x2000, 0),
    }  # fmt: skip
    assert assumed_value(loaded.od, 0x1014, 0, 5) == 0x85
    assert assumed_value(loaded.od, 0x2000, 0, 5) == -2
    speed = thing(loaded)
    assert (speed.name, speed.access_type, speed.pdo_mappable) == ("Speed value", "ro", True)


def test_a_cut_xdd_file_is_refused_with_the_place() -> None:
    with pytest.raises(DescriptionError, match="no well-formed XML"):
        load_eds(XDD[:400].encode())


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_no_mutation_of_an_xdd_raises_anything_but_our_error(data: st.DataObject) -> None:
    words = data.draw(st.lists(st.tuples(st.sampled_from(['"7"', '"0007"', "2000", "name", "01"]),
                                         st.text(alphabet="019aFx$<>-\"' ", max_size=6)), max_size=4))  # fmt: skip
    text = XDD
    for old, new in words:
        text = text.replace(old, new, 1)
    try:
        load_eds(text.encode())
    except DescriptionError:
        return


def test_a_value_of_spaces_does_not_hold_up_the_reader() -> None:
    """Where a comment was sought from each space, this line took minutes."""
    blank = " " * 200_000
    lines = f"[1000]\nParameterName=TPDO1{blank}x ; what it is\n"
    found = parse(lines.encode())
    assert found.sections["1000"].values["parametername"] == f"TPDO1{blank}x"
