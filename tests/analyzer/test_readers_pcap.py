"""pcap and pcapng: against Wireshark's own tools, and what only some files have."""

import json
import shutil
import struct
import subprocess
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from syncline_analyzer.convert import convert
from syncline_schemas.batch import FrameFlag, Gap
from tests.analyzer import binary_files, text_files
from tests.analyzer.binary_files import socketcan
from tests.analyzer.log_builder import T0_NS, Row, frame_rows, read, row, rows
from tests.analyzer.log_frames import FRAMES, Encoder, everything, without_direction

needs_tshark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not here")
T0_US = T0_NS // 1000


def _written(tmp_path: Path, raw: bytes, name: str = "x.pcapng") -> Path:
    path = tmp_path / name
    path.write_bytes(raw)
    return path


def _ran(*command: str | Path) -> str:
    done = subprocess.run(list(map(str, command)), capture_output=True, check=True, text=True)
    return done.stdout


Told = tuple[int, int | None, str, bool, bool, bool]


def _tshark(path: Path) -> list[Told]:
    """(t_ns, id, data, extended, remote, error) as tshark tells them; of error frames no id."""
    fields = ("frame.time_epoch", "can.id", "can.flags.xtd", "can.flags.rtr", "can.flags.err")
    wanted = [part for name in fields for part in ("-e", name)]
    packets = json.loads(_ran("tshark", "-r", path, "-T", "json", "-x"))
    table = _ran("tshark", "-r", path, "-T", "fields", *wanted).splitlines()
    found = []
    for packet, line in zip(packets, table, strict=True):
        time, can_id, *marks = line.split("\t")
        seconds, fraction = time.split(".")
        raw = bytes.fromhex(packet["_source"]["layers"]["frame_raw"][0])
        flags = [mark in ("1", "True") for mark in marks]
        data = raw[8 : 8 + (0 if flags[1] else raw[4])]
        t_ns = int(seconds) * 10**9 + int(fraction.ljust(9, "0"))
        number = int(can_id, 0) if can_id else None
        found.append((t_ns, number, data.hex(), flags[0], flags[1], flags[2]))
    return found


def _told(frame: Row) -> Told:
    flags = FrameFlag(frame[3])
    error = FrameFlag.ERROR in flags
    extended, remote = FrameFlag.EXTENDED in flags, FrameFlag.REMOTE in flags
    return frame[0], None if error else frame[2], frame[5].hex(), extended, remote, error


@needs_tshark
def test_tshark_reads_what_we_write(tmp_path: Path) -> None:
    source = _written(tmp_path, text_files.candump(FRAMES), "a.log")
    convert([source], tmp_path / "x.pcapng")
    assert _tshark(tmp_path / "x.pcapng") == [_told(frame) for frame in FRAMES]


@needs_tshark
def test_capinfos_finds_nothing_wrong(tmp_path: Path) -> None:
    source = _written(tmp_path, text_files.candump(FRAMES), "a.log")
    convert([source], tmp_path / "x.pcapng")
    told = _ran("capinfos", tmp_path / "x.pcapng")
    assert "SocketCAN" in told
    assert "Name = can1" in told
    assert "Time ticks per second = 1000000000" in told


@needs_tshark
@pytest.mark.parametrize("form", ["pcap", "nsecpcap", "pcapng"])
def test_we_read_what_editcap_makes_of_ours(tmp_path: Path, form: str) -> None:
    one_bus = [(t, 0, *rest) for t, _, *rest in FRAMES]
    source = _written(tmp_path, text_files.candump(one_bus), "a.log")  # type: ignore[arg-type]
    convert([source], tmp_path / "x.pcapng")
    _ran("editcap", "-F", form, tmp_path / "x.pcapng", tmp_path / "y")
    found, facts, _ = read(tmp_path / "y")
    keep = everything if form == "pcapng" else without_direction
    assert rows(found) == [keep(frame) for frame in one_bus]  # type: ignore[arg-type]
    assert facts.buses == ["can0"]


@needs_tshark
@pytest.mark.parametrize(
    "encode", [binary_files.pcap, binary_files.pcap_big, binary_files.pcapng_big]
)
def test_we_read_what_tshark_reads(tmp_path: Path, encode: Encoder) -> None:
    path = _written(tmp_path, encode(FRAMES))
    found = rows(read(path)[0])
    assert [_told(frame) for frame in found] == _tshark(path)


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(frames=frame_rows(), order=st.sampled_from("<>"))
def test_any_frames_come_out_as_they_went_in(tmp_path: Path, frames: list[Row], order: str) -> None:
    batch, facts, _ = read(_written(tmp_path, binary_files.pcapng(frames, order)))
    names = [int(name.removeprefix("can")) for name in facts.buses]
    assert [(t, names[bus], *rest) for t, bus, *rest in rows(batch)] == frames


def _ng(*blocks: bytes, resolution: bytes = b"\x06", more: bytes = b"") -> bytes:
    section = binary_files.block("<", 0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    options = binary_files.option("<", 9, resolution) + more + bytes(4)
    interface = binary_files.block("<", 1, struct.pack("<HHI", 227, 0, 0) + options)
    return section + interface + b"".join(blocks)


def _packet(ticks: int, frame: Row | None = None, options: bytes = b"") -> bytes:
    packet = socketcan(frame or row(0, 0x123, b"\5"))
    head = struct.pack("<IIIII", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(packet), len(packet))
    return binary_files.block("<", 6, head + packet + options)


def test_frames_lost_before_a_packet_are_a_gap(tmp_path: Path) -> None:
    lost = binary_files.option("<", 4, struct.pack("<Q", 7)) + bytes(4)
    raw = _ng(_packet(T0_US), _packet(T0_US + 50, options=lost), _packet(T0_US + 60))
    batch, _, gaps = read(_written(tmp_path, raw))
    assert len(batch) == 3
    assert gaps == [Gap(T0_NS, T0_NS + 50_000, "frames dropped by the capture tool", 7, 0)]


def test_frames_that_an_interface_lost_are_a_note(tmp_path: Path) -> None:
    options = binary_files.option("<", 5, struct.pack("<Q", 12)) + bytes(4)
    statistics = binary_files.block("<", 5, bytes(12) + options)
    _, facts, gaps = read(_written(tmp_path, _ng(_packet(T0_US), statistics)))
    assert gaps == []
    assert "12 frame(s) of can0 were dropped while it was captured" in facts.notes


@pytest.mark.parametrize(
    ("resolution", "ticks"),
    [
        (b"\x03", T0_NS // 10**6),
        (b"\x09", T0_NS),
        (b"\x0a", T0_NS * 10 + 9),
        (b"\x94", (T0_NS // 10**9) << 20),
        (b"\xa0", (T0_NS // 10**9) << 32),
    ],
)
def test_stamps_of_any_resolution(tmp_path: Path, resolution: bytes, ticks: int) -> None:
    batch, _, _ = read(_written(tmp_path, _ng(_packet(ticks), resolution=resolution)))
    assert batch.t_ns.tolist() == [T0_NS]


def test_a_time_offset_is_added(tmp_path: Path) -> None:
    more = binary_files.option("<", 14, struct.pack("<q", T0_NS // 10**9))
    batch, facts, _ = read(_written(tmp_path, _ng(_packet(5), more=more)))
    assert batch.t_ns.tolist() == [T0_NS + 5000]
    assert facts.time_base == "utc"


def test_packets_without_a_time_take_the_one_before(tmp_path: Path) -> None:
    body = socketcan(row(0, 0x321, b"\7"))
    simple = binary_files.block("<", 3, struct.pack("<I", len(body)) + body)
    old = struct.pack("<HHIIII", 0, 0xFFFF, T0_US >> 32, T0_US & 0xFFFFFFFF, len(body), len(body))
    raw = _ng(_packet(T0_US), simple, binary_files.block("<", 2, old + body))
    batch, _, gaps = read(_written(tmp_path, raw))
    assert batch.can_id.tolist() == [0x123, 0x321, 0x321]
    assert batch.t_ns.tolist() == [T0_NS] * 3
    assert gaps == []


def test_what_is_no_can_frame_is_counted(tmp_path: Path) -> None:
    ethernet = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    ethernet += struct.pack("<IIII", 1, 2, 60, 60) + bytes(60)
    batch, facts, _ = read(_written(tmp_path, ethernet))
    assert len(batch) == 0
    assert facts.notes == ["1 packet(s) of link type 1 are no CAN frames"]
    xl = struct.pack(">IBBHI", 0x123, 0x80, 3, 12, 0) + bytes(12)
    head = struct.pack("<IIIII", 0, T0_US >> 32, T0_US & 0xFFFFFFFF, len(xl), len(xl))
    _, facts, _ = read(
        _written(tmp_path, _ng(_packet(T0_US), binary_files.block("<", 6, head + xl)))
    )
    assert facts.unparsed_count == 1


def test_a_packet_cut_by_the_capture_keeps_what_is_there(tmp_path: Path) -> None:
    whole = socketcan(row(0, 0x123, bytes(range(8))))[:12]
    head = struct.pack("<IIIII", 0, T0_US >> 32, T0_US & 0xFFFFFFFF, 12, 16)
    batch, _, _ = read(_written(tmp_path, _ng(binary_files.block("<", 6, head + whole))))
    assert rows(batch) == [row(0, 0x123, bytes(range(4)), flags=FrameFlag.DLC_INVALID)]


def test_a_damaged_block_costs_only_itself(tmp_path: Path) -> None:
    packets = [_packet(T0_US + i) for i in range(9)]
    packets[4] = packets[4][:4] + b"\xff\xff" + packets[4][6:]
    batch, facts, _ = read(_written(tmp_path, _ng(*packets)))
    assert batch.t_ns.tolist() == [T0_NS + 1000 * i for i in range(9) if i != 4]
    assert facts.damage == "a block does not start where the one before it ends"


def test_a_file_that_changes_again_and_again_is_given_up(tmp_path: Path) -> None:
    sections = (binary_files.pcapng(FRAMES[:1], order) for order in "<>" * 600)
    batch, facts, _ = read(_written(tmp_path, b"".join(sections)))
    assert 900 < len(batch) < 1200
    assert facts.damage == "the byte order changes again and again"


@settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_broken_bytes_never_raise(tmp_path: Path, data: st.DataObject) -> None:
    encode = data.draw(
        st.sampled_from([binary_files.pcap_big, binary_files.sll2, binary_files.pcapng_big])
    )
    raw = bytearray(encode(FRAMES))
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(4, len(raw) - 1))
        raw[place : place + 1] = data.draw(st.binary(max_size=5))
    batch, _, _ = read(_written(tmp_path, bytes(raw)))
    assert len(batch) <= len(FRAMES) + 1
