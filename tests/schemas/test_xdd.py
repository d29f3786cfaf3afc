"""XDD and XDC files: the same device as its EDS tells, and nothing that XML allows does harm."""

import configparser
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas.devices import device_names, load_device
from syncline_schemas.eds import MAX_BYTES, assumed_value, load_eds, variables
from syncline_schemas.errors import DescriptionError
from syncline_schemas.xml_tree import MAX_ELEMENTS

WILD = Path(__file__).parents[3] / "shared" / "eds-in-the-wild"
NAMESPACE = 'xmlns="http://www.canopen.org/xml/1.0"'

XDC = """<?xml version="1.0" encoding="utf-8"?>
<ISO15745ProfileContainer xmlns="http://www.canopen.org/xml/1.1"
  xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">
<ISO15745Profile><ProfileHeader><ProfileClassID>Device</ProfileClassID></ProfileHeader>
<ProfileBody xsi:type="ProfileBody_Device_CANopen" fileName="drive.xdc" fileCreator="Somebody"
  fileCreationDate="2024-05-06" fileVersion="2">
<DeviceIdentity><vendorName readOnly="true">Acme &amp; Sons</vendorName><vendorID>327</vendorID>
<productFamily>Drives</productFamily><productName>D 1</productName><productID>48</productID>
<orderNumber>4711</orderNumber></DeviceIdentity>
<ApplicationProcess><dataTypeList>
<derived name="Percent" uniqueID="UID_T_1"><baseType><INT/></baseType></derived>
</dataTypeList><templateList>
<parameterTemplate uniqueID="UID_TEMPLATE" access="readWrite"><UINT/>
<defaultValue value="5"/></parameterTemplate>
</templateList><parameterList>
<parameter uniqueID="UID_P_2001" access="readWriteInput" multiplier="0.1">
<label lang="de">Strom</label><label lang="en">Current</label>
<description lang="en">Through the motor</description><INT/>
<unit multiplier="1" unitURI=""><label lang="en">A</label></unit>
<actualValue value="7"/><defaultValue value="-3"/>
<allowedValues><range><minValue value="-100"/><maxValue value="100"/></range></allowedValues>
</parameter>
<parameter uniqueID="UID_P_2002" templateIDRef="UID_TEMPLATE"><label lang="en">Time</label></parameter>
<parameter uniqueID="UID_P_2003" access="read"><dataTypeIDRef uniqueIDRef="UID_T_1"/></parameter>
</parameterList></ApplicationProcess></ProfileBody></ISO15745Profile>
<ISO15745Profile><ProfileBody xsi:type="ProfileBody_CommunicationNetwork_CANopen">
<ApplicationLayers><CANopenObjectList>
<CANopenObject index="1000" name="Device type" objectType="7" dataType="07" accessType="ro"
  defaultValue="" PDOmapping="no" actualValue="0x00020192"/>
<CANopenObject index="1800" name="TPDO 1" objectType="9" subNumber="2">
<CANopenSubObject subIndex="00" name="n" objectType="7" dataType="0005" accessType="ro" defaultValue="1"/>
<CANopenSubObject subIndex="01" name="COB-ID" objectType="7" dataType="0007" accessType="rw"
  defaultValue="$NODEID+0x180" actualValue="0x181"/>
</CANopenObject>
<CANopenObject index="0x1A00" name="Map 1" objectType="0x09" subNumber="2">
<CANopenSubObject subIndex="0x00" name="n" objectType="7" dataType="0x0005" accessType="rw" defaultValue="1"/>
<CANopenSubObject subIndex="0x01" name="1" objectType="7" dataType="UNSIGNED32" accessType="rw"
  defaultValue="0x20010010" PDOmapping="no"/>
</CANopenObject>
<CANopenObject index="2001" name="Current" objectType="7" PDOmapping="RPDO" uniqueIDRef="UID_P_2001"/>
<CANopenObject index="2002" name="Time" objectType="7" uniqueIDRef="UID_P_2002"/>
<CANopenObject index="2003" name="Share" objectType="7" uniqueIDRef="UID_P_2003"/>
</CANopenObjectList>
<dummyUsage><dummy entry="Dummy0005=1"/><dummy entry="Dummy0007=0"/></dummyUsage></ApplicationLayers>
<TransportLayers><PhysicalLayer><baudRate defaultValue="250 Kbps">
<supportedBaudRate value="250 Kbps"/><supportedBaudRate value="1000 Kbps"/></baudRate></PhysicalLayer>
</TransportLayers><NetworkManagement>
<CANopenGeneralFeatures groupMessaging="false" dynamicChannels="0" granularity="8" nrOfRxPDO="0"
  nrOfTxPDO="1" bootUpSlave="true" layerSettingServiceSlave="true"/>
<CANopenMasterFeatures bootUpMaster="false"/>
<deviceCommissioning nodeID="1" nodeName="Left" actualBaudRate="250" networkNumber="0"/>
</NetworkManagement></ProfileBody></ISO15745Profile></ISO15745ProfileContainer>
"""


def test_everything_that_the_model_holds_is_read() -> None:
    loaded = load_eds(XDC.encode())
    assert loaded.warnings == []
    info = loaded.info
    assert (info["deviceinfo.vendorname"], info["deviceinfo.productname"]) == ("Acme & Sons", "D 1")
    assert info["fileinfo.createdby"] == "Somebody"
    assert info["devicecomissioning.nodename"] == "Left"
    device = loaded.od.device_information
    assert (device.vendor_number, device.product_number, device.order_code) == (327, 48, "4711")
    assert device.allowed_baudrates == {250_000, 1_000_000}
    assert (device.nr_of_TXPDO, device.LSS_supported) == (1, True)
    assert info["deviceinfo.granularity"] == "8"
    assert (loaded.node_id, loaded.bitrate) == (1, 250_000)
    assert 5 in loaded.od.indices
    assert 7 not in loaded.od.indices
    things: list[Any] = [loaded.od[index] for index in (0x2001, 0x2002, 0x2003)]
    current, time, share = things
    assert (current.name, current.data_type, current.access_type) == ("Current", 3, "rww")
    assert (current.min, current.max, current.factor, current.unit) == (-100, 100, 0.1, "A")
    assert current.description == "Through the motor"
    assert (current.pdo_mappable, current.default, current.value) == (True, -3, 7)
    assert (time.data_type, time.default, time.access_type) == (6, 5, "rw")
    assert (share.data_type, share.access_type) == (3, "ro")


def test_the_configured_value_of_an_xdc_wins_over_the_default() -> None:
    od = load_eds(XDC.encode()).od
    assert assumed_value(od, 0x2001, 0, 1) == 7
    assert assumed_value(od, 0x1800, 1, 1) == 0x181
    assert assumed_value(od, 0x1000, 0, 1) == 0x20192
    assert assumed_value(od, 0x1A00, 1, 1) == 0x20010010


@pytest.mark.parametrize(
    ("stated", "rate"), [("500 Kbps", 500_000), ("125000", 125_000), ("auto", None), ("", None)]
)
def test_the_bit_rate_of_an_xdc(stated: str, rate: int | None) -> None:
    text = XDC.replace('actualBaudRate="250"', f'actualBaudRate="{stated}"')
    loaded = load_eds(text.encode())
    assert (loaded.bitrate, loaded.warnings) == (rate, [])


def as_xdd(data: bytes) -> bytes:
    """The objects of a clean EDS written as an XDD, by Python's own reader of such files."""
    parser = configparser.RawConfigParser(strict=False, interpolation=None)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("cp1252")
    parser.read_string(text)
    lines = [f'<?xml version="1.0" encoding="utf-8"?><ISO15745ProfileContainer {NAMESPACE}>']
    lines.append("<ISO15745Profile><ProfileBody><ApplicationLayers><CANopenObjectList>")
    parts = {name.lower(): dict(parser[name]) for name in parser.sections()}
    for name in sorted(parts):
        if len(name) == 4 and all(c in "0123456789abcdef" for c in name):
            lines.append(element("CANopenObject", "index", name, parts[name], open_too=True))
            lines += [
                element("CANopenSubObject", "subIndex", sub.partition("sub")[2], values)
                for sub, values in parts.items()
                if sub.startswith(f"{name}sub")
            ]
            lines.append("</CANopenObject>")
    lines.append("</CANopenObjectList></ApplicationLayers></ProfileBody></ISO15745Profile>")
    return "\n".join([*lines, "</ISO15745ProfileContainer>"]).encode()


def element(
    tag: str, key: str, number: str, values: dict[str, str], *, open_too: bool = False
) -> str:
    names = {"parametername": "name", "accesstype": "accessType", "defaultvalue": "defaultValue",
             "lowlimit": "lowLimit", "highlimit": "highLimit", "parametervalue": "actualValue",
             "subnumber": "subNumber"}  # fmt: skip
    said = {key: number, "objectType": str(int(values.get("objecttype") or "7", 0))}
    said |= {names[each]: value for each, value in values.items() if each in names and value}
    if data_type := values.get("datatype"):
        said["dataType"] = f"{int(data_type, 0):04X}"
    said["PDOmapping"] = "optional" if values.get("pdomapping", "0").strip() == "1" else "no"
    attributes = " ".join(f"{name}={quoteattr(value)}" for name, value in said.items())
    return f"<{tag} {attributes}{'>' if open_too else '/>'}"


def same_device(eds: bytes) -> None:
    one, other = load_eds(eds), load_eds(as_xdd(eds))
    dummies = set(range(0x20))
    mine = {(v.index, v.subindex): v for v in variables(one.od) if v.index not in dummies}
    theirs = {(v.index, v.subindex): v for v in variables(other.od)}
    assert mine.keys() == theirs.keys()
    for key, variable in mine.items():
        copy = theirs[key]
        assert copy.name.split() == variable.name.split()
        for what in ("data_type", "access_type", "pdo_mappable", "min", "max"):
            assert getattr(copy, what) == getattr(variable, what), (key, what)
        assert assumed_value(other.od, *key, 5) == assumed_value(one.od, *key, 5), key


@pytest.mark.parametrize("name", device_names())
def test_a_device_of_ours_is_the_same_by_its_xdd(name: str) -> None:
    device = load_device(name)
    same_device(next(data for file, data in device.files.items() if file.endswith(".eds")))


@pytest.mark.skipif(not WILD.is_dir(), reason="the collected EDS files are not here")
@pytest.mark.parametrize(
    "path",
    [p for p in sorted(WILD.glob("*")) if "sevcon" not in p.name and "lely" not in p.name],
    ids=lambda p: p.stem,
)
def test_a_file_from_the_wild_is_the_same_by_its_xdd(path: Path) -> None:
    same_device(path.read_bytes())


def test_a_device_by_its_xdd_is_loaded_like_one_by_its_eds(tmp_path: Path) -> None:
    path = tmp_path / "drive.XDC"
    path.write_text(XDC, encoding="utf-8")
    device = load_device(path)
    assert (device.title, device.vendor) == ("D 1", "Acme & Sons")
    assert device.default(0x2001, 0, 1) == 7


def test_an_encoding_that_is_not_the_declared_one_is_repaired() -> None:
    loaded = load_eds(XDC.replace("Left", "Füße").encode("cp1252"))
    assert loaded.info["devicecomissioning.nodename"] == "Füße"
    assert "Windows-1252" in str(loaded.warnings[0])


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_other_encodings_of_xml(encoding: str) -> None:
    text = XDC.replace('encoding="utf-8"', 'encoding="utf-16"') if encoding == "utf-16" else XDC
    assert len(load_eds(text.encode(encoding)).warnings) == 0


ENTITIES = "".join(f'<!ENTITY c{n} "{"&b;" * 10}">' for n in range(9))
BOMB = f'<!DOCTYPE a [<!ENTITY b "{"x" * 50}">{ENTITIES}]>'


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (BOMB, "document type declaration in line 1"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd">', "document type declaration"),
        ('<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/hostname">]>', "document type declaration"),
        ("<a>" * 200, "nested"),
        ("<a>&nothing;</a>", "no well-formed XML"),
        ("<a b='\x01'/>", "no well-formed XML"),
        ("<!-- only a comment -->", "no well-formed XML"),
        ('<?xml version="1.0" encoding="klingon"?><a/>', "XML"),
    ],
)
def test_hostile_xml_is_refused_with_the_reason(head: str, said: str) -> None:
    with pytest.raises(DescriptionError, match=said):
        load_eds(head.encode())


def test_more_elements_than_any_device_has_are_refused() -> None:
    with pytest.raises(DescriptionError, match="too many"):
        load_eds(b"<a>" + b"<b/>" * MAX_ELEMENTS + b"</a>")


def test_long_text_is_read_in_time() -> None:
    """Quadratic, it would take minutes."""
    text = XDC.replace("Drives", "x" * 14_000_000)
    assert load_eds(text.encode()).warnings == []


def test_what_is_far_too_large_is_no_eds(tmp_path: Path) -> None:
    path = tmp_path / "x.eds"
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(DescriptionError, match="larger than 16 MiB"):
        load_eds(path)


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_no_mutation_raises_anything_but_our_error(data: st.DataObject) -> None:
    content = bytearray(XDC.encode())
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, len(content) - 1))
        width = data.draw(st.integers(0, 9))
        content[place : place + width] = data.draw(st.binary(max_size=9))
    try:
        load_eds(bytes(content))
    except DescriptionError:
        return


@given(st.integers(0, len(XDC) - 1))
def test_a_file_cut_anywhere_is_refused(length: int) -> None:
    with pytest.raises(DescriptionError):
        load_eds(XDC[:length].rstrip().removesuffix("</ISO15745ProfileContainer>").encode())
