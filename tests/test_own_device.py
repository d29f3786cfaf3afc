"""A device is data: one more encoder in a folder of the user's, from recording to report."""

import json
import struct
from pathlib import Path

import canopen
import pytest
from canopen.sdo.client import SdoClient
from canopen.sdo.server import SdoServer

from syncline_logger.cli import main
from syncline_logger.node_objects import NodeObjects
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import identify, load_device
from syncline_schemas.errors import DescriptionError

pytest.importorskip("pandas")
FOLDER = Path(__file__).parent.parent / "samples" / "own_devices"
NODE, CPR, TURNS = 5, 3600, 4096


class Bus:
    """Frames of node 5 by the canopen library's server, and those that a test adds."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.ms = 0.0
        od = canopen.import_od(str(FOLDER / "generic-406.eds"), node_id=NODE)
        self.local = canopen.LocalNode(NODE, od)
        self.server = SdoServer(0x600 + NODE, 0x580 + NODE, self.local)
        self.client = SdoClient(0x600 + NODE, 0x580 + NODE, od)
        self.server.network = self.client.network = self  # type: ignore[assignment]

    def frame(self, can_id: int, data: bytes, after_ms: float = 1.0) -> None:
        self.ms += after_ms
        self.lines.append(f"({1_700_000_000 + self.ms / 1000:.6f}) can0 {can_id:03X}#{data.hex()}")

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.frame(can_id, bytes(data))
        if can_id == 0x600 + NODE:
            self.server.on_request(can_id, bytearray(data), 0.0)
        else:
            self.client.on_response(can_id, bytearray(data), 0.0)


def position(k: int) -> int:
    return (7 * CPR + 900 + 36 * k) % (CPR * TURNS)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """The master asks and presets the encoder, which then turns at 12 rpm."""
    bus = Bus()
    bus.frame(0x700 + NODE, b"\0")
    bus.local.set_data(0x2010, 0, struct.pack("<h", 43))
    bus.local.set_data(0x6508, 0, struct.pack("<I", 12_345))
    for index in (0x1000, 0x1008, 0x2010, 0x6000, 0x6001, 0x6002, 0x6508):
        bus.client.upload(index, 0)
    bus.client.download(0x6003, 0, struct.pack("<I", 26_100))
    bus.client.download(0x1010, 1, b"save")
    bus.frame(0x000, bytes((1, NODE)))
    for k in range(100):
        bus.frame(0x180 + NODE, struct.pack("<I", position(k)), 50)
    bus.frame(0x280 + NODE, struct.pack("<IH", position(99), 1))
    bus.frame(0x080 + NODE, bytes.fromhex("10FF010000000000"))
    path = tmp_path / "own.log"
    path.write_text("\n".join(bus.lines) + "\n", encoding="ascii")
    return path


def run(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as caught:
        main(list(words))
    out, err = capsys.readouterr()
    assert caught.value.code == 0, err
    return out


def test_the_folder_holds_data_only() -> None:
    assert sorted(path.suffix for path in FOLDER.iterdir()) == [".eds", ".toml"]


def test_the_commands_know_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SYNCLINE_DEVICES", str(FOLDER))
    assert " generic-406 " in run(capsys, "devices")
    shown = run(capsys, "devices", "generic-406")
    for part in ("GEN406", "disc dirty", "max_rpm", "0.5 degC", "counting direction"):
        assert part in shown
    assert run(capsys, "devices", "--check", str(FOLDER / "generic-406.toml")) == ""


def test_a_log_of_it_is_told_like_one_of_a_built_in_device(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SYNCLINE_DEVICES", str(FOLDER))
    told = json.loads(run(capsys, "analyze", str(log), "--format", "json"))
    (node,) = told["nodes"]
    assert (node["device"], node["device_source"]) == ("generic-406", "objects")
    assert '1008h = "GEN406"' in node["device_reason"]
    assert "2010h" in node["device_reason"]
    trace = next(row for row in told["traces"] if row["object"] == 0x600400)
    assert (trace["samples"], trace["unit"]) == (101, "counts")
    assert (trace["min"], trace["max"]) == (position(0), position(99))
    assert trace["assumed"] == []
    words = [row["words"] for row in told["object_changes"]]
    assert words == ["preset to 26100", "saved: all parameters"]
    assert told["object_changes"][0]["saved"] is True
    health = {row["what"]: (row["last_value"], row["unit"]) for row in told["device_health"]}
    assert health == {"temperature": (21.5, "degC"), "operating time": (1234.5, "h")}
    (emcy,) = told["emcy"]
    assert emcy["meaning"] == "disc dirty"
    assert "6503h = 0001h" in json.dumps(told["findings"])


def test_its_angles_are_those_of_its_own_counts_per_turn(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from syncline_analyzer.session import open_session

    monkeypatch.setenv("SYNCLINE_DEVICES", str(FOLDER))
    traces = open_session(log).traces()
    frame = traces[traces["object"] == 0x600400].head(100)
    expected = [position(k) % CPR * 360 / CPR for k in range(100)]
    assert frame["angle_deg"].tolist() == pytest.approx(expected)
    assert frame["turn"].tolist() == [position(k) // CPR for k in range(100)]
    # 36 of 3600 counts in 50 ms are 12 turns a minute.
    assert frame["speed_rpm"].iloc[50] == pytest.approx(12.0, rel=1e-6)


def test_without_the_folder_its_eds_alone_gives_the_same_angles(log: Path) -> None:
    from syncline_analyzer.session import open_session

    session = open_session(log, devices={NODE: str(FOLDER / "generic-406.eds")})
    traces = session.traces()
    frame = traces[traces["object"] == 0x600400].head(100)
    assert frame["angle_deg"].tolist() == pytest.approx(
        [position(k) % CPR * 360 / CPR for k in range(100)]
    )
    assert session.object_changes()["words"].tolist()[0] == "preset to 26100"


def test_without_folder_and_eds_nothing_is_claimed_but_the_profile(log: Path) -> None:
    from syncline_analyzer.session import open_session

    (node,) = open_session(log).analysis.nodes
    assert (node.device, node.device_source) == (None, None)
    assert "CiA 406 encoder" in node.device_reason


def test_the_recorder_knows_it_by_its_own_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SYNCLINE_DEVICES", str(FOLDER))
    node = NodeObjects(NODE)
    node.learn((0x1008, 0), b"GEN406", written=False)
    assert identify(node.identity()) is None
    assert node.shapes_pdos((0x2010, 0))
    node.learn((0x2010, 0), b"\x2b\0", written=False)
    found = identify(node.identity())
    assert found is load_device("generic-406")


def recorded(log: Path, description: str = "") -> Path:
    """The same frames as a capture that carries the files of the device."""
    from syncline_analyzer.session import open_session
    from syncline_schemas.capture.layout import (
        BusInfo,
        CaptureMetadata,
        description_attachment,
        device_attachment,
    )
    from syncline_schemas.capture.writer import CaptureWriter

    files = [device_attachment(path.name, path.read_bytes()) for path in FOLDER.iterdir()]
    told = [description_attachment(description)] if description else []
    path = log.with_suffix(".mcap")
    with path.open("wb") as stream:
        writer = CaptureWriter(
            stream, CaptureMetadata("0.1", "id"), [BusInfo("can0", 0)], attachments=[*told, *files]
        )
        for batch in open_session(log).frames():
            writer.write_chunk(batch)
        writer.finish()
    return path


@pytest.mark.parametrize("description", ["", '[node.5]\ndevice = "generic-406"\n'])
def test_a_capture_explains_itself_where_nobody_has_the_device(
    log: Path, description: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded(log, description)
    told = json.loads(run(capsys, "analyze", str(path), "--format", "json"))
    (node,) = told["nodes"]
    assert node["device"] == "generic-406"
    assert node["device_source"] == ("bus description" if description else "objects")
    assert told["emcy"][0]["meaning"] == "disc dirty"
    assert "generic-406.toml" in run(capsys, "info", str(path))
    copy = path.with_name("copy.mcap")
    run(capsys, "convert", str(path), str(copy))
    again = json.loads(run(capsys, "analyze", str(copy), "--format", "json"))
    assert again["nodes"][0]["device"] == "generic-406"


def test_a_name_that_neither_the_machine_nor_the_capture_knows_is_told() -> None:
    with pytest.raises(DescriptionError, match="no device is called 'generic-407'"):
        BusDescription.loads('[node.5]\ndevice = "generic-407"\n', files={"generic-406.toml": b""})


XDD = """<?xml version="1.0" encoding="utf-8"?>
<ISO15745ProfileContainer xmlns="http://www.canopen.org/xml/1.1"><ISO15745Profile><ProfileBody>
<DeviceIdentity><vendorName>Acme</vendorName><vendorID>7</vendorID><productName>Gauge</productName>
<productID>8</productID></DeviceIdentity><ApplicationLayers><CANopenObjectList>
<CANopenObject index="1800" name="TPDO1" objectType="9" subNumber="3">
<CANopenSubObject subIndex="00" name="n" objectType="7" dataType="0005" accessType="ro" defaultValue="2"/>
<CANopenSubObject subIndex="01" name="COB-ID" objectType="7" dataType="0007" accessType="rw"
 defaultValue="$NODEID+0x3A0"/>
<CANopenSubObject subIndex="02" name="type" objectType="7" dataType="0005" accessType="rw" defaultValue="255"/>
</CANopenObject>
<CANopenObject index="1A00" name="TPDO1 mapping" objectType="9" subNumber="2">
<CANopenSubObject subIndex="00" name="n" objectType="7" dataType="0005" accessType="rw" defaultValue="1"/>
<CANopenSubObject subIndex="01" name="1" objectType="7" dataType="0007" accessType="rw" defaultValue="0x21000010"/>
</CANopenObject>
<CANopenObject index="2100" name="Pressure in the line" objectType="7" dataType="0003" accessType="ro"
 PDOmapping="TPDO"/>
</CANopenObjectList></ApplicationLayers></ProfileBody></ISO15745Profile></ISO15745ProfileContainer>
"""


def test_a_device_by_its_xdd_alone_is_decoded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """3A5h is no predefined TPDO: only the description binds it to node 5."""
    path, log = tmp_path / "gauge.xdd", tmp_path / "a.log"
    path.write_text(XDD, encoding="utf-8")
    times = [1_700_000_000 + k * 0.1 for k in range(40)]
    beats = "".join(f"({t:.6f}) can0 705#05\n({t:.6f}) can0 3A5#6400\n" for t in times)
    log.write_text(beats, encoding="ascii")
    out = run(capsys, "analyze", str(log), "--device", f"5={path}", "--format", "json")
    found = json.loads(out)
    assert [(pdo["cob_id"], pdo["node"]) for pdo in found["pdos"]] == [(0x3A5, 5)]
    assert [node["device"] for node in found["nodes"] if node["node"] == 5] == ["gauge"]
