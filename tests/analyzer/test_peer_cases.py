"""What another analyzer gets wrong on the same frames (canopen-lens 0.5.1, measured), and we do not.

The numbers are those of `research/peers.md` 4.1.
"""

import binascii
import gzip
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.convert import convert
from syncline_analyzer.engine import analyze
from syncline_analyzer.session import open_session
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.description import BusDescription
from tests.analyzer.log_builder import message
from tests.analyzer.traps.script import (
    OPERATIONAL,
    PRE_OPERATIONAL,
    STOPPED,
    T0,
    Script,
    little,
    says,
)

ERROR = int(FrameFlag.ERROR)


def node5() -> Script:
    """A node of which nothing is known, with a heartbeat every 100 ms for 5 s."""
    return Script(None, 5).heartbeat(0, 5000)


def block_upload(script: Script, at: float, data: bytes) -> Script:
    """A block upload of 1008h whose last segment looks like an abort by its first byte."""
    crc = little(binascii.crc_hqx(data, 0), bits=16)
    segments = [data[k : k + 7].ljust(7, b"\0") for k in range(0, len(data), 7)]
    unused = len(segments) * 7 - len(data)
    script.frame(at, "605#A4081000FF000000".replace("FF", "7F"))
    script.frame(at + 1, f"585#C6081000{little(len(data))}").frame(at + 2, "605#A300000000000000")
    for number, segment in enumerate(segments, start=1):
        last = 0x80 if number == len(segments) else 0
        script.frame(at + 2 + number, f"585#{number | last:02X}{segment.hex()}")
    end = at + 4 + len(segments)
    script.frame(end, f"605#A2{len(segments):02X}7F0000000000")
    script.frame(end + 1, f"585#{0xC1 | unused << 2:02X}{crc}0000000000")
    return script.frame(end + 2, "605#A100000000000000")


def test_case_01_the_last_segment_of_a_block_upload_is_no_abort() -> None:
    data = b"a rather long name" + b" it is one"
    told = block_upload(node5(), 1000, data).told()
    (row,) = told.analysis.sdo
    assert (row.index, row.kind, row.direction, row.result) == (0x1008, "block", "upload", "ok")
    assert (row.data, row.abort_code) == (data, None)
    assert told.accusations == []


def test_case_02_a_moved_tpdo_makes_no_phantom_node() -> None:
    script = node5().write(100, 0x1800, 1, 0x1E5, size=4)
    told = script.every(200, 5000, 20, "1E5#0102030405060708").told()
    assert told.nodes == [5]
    assert (told.pdo(0x1E5).node, told.pdo(0x1E5).pdo) == (5, "TPDO1")


def test_case_02_tpdo1_at_385h_is_tpdo1_and_decoded() -> None:
    script = Script(None, 5).heartbeat(0, 5000).read(10, 0x1000, 0, 0x00020196)
    script.write(100, 0x1800, 1, 0x385, size=4).write(110, 0x1A00, 1, 0x60040020, size=4)
    script.write(120, 0x1A00, 0, 1, size=1)
    told = script.every(200, 5000, 20, lambda k: f"385#{little(1000 + k)}").told()
    assert (told.pdo(0x385).node, told.pdo(0x385).pdo) == (5, "TPDO1")
    assert told.trace().raw[0] == 1000


def test_case_02_a_moved_emcy_is_not_charged_to_another_node() -> None:
    script = node5().write(100, 0x1014, 0, 0x90, size=4).frame(1000, "090#1081110000000000")
    told = script.told()
    assert [(row.node, row.code) for row in told.emcy] == [(5, 0x8110)]
    assert told.nodes == [5]


def test_case_03_two_buses_with_the_same_node_id() -> None:
    script = Script(None, 5, buses=("can0", "can1")).heartbeat(0, 3000)
    for k in range(100):
        script.frame(k * 100 + 7, "705#05", bus=1)
    script.frame(1000, "085#1081110000000000").heartbeat(3000, 10_000)
    told = script.told()
    assert "nmt.node_lost" not in told.ids
    assert "nmt.duplicate_node_id" not in told.ids
    assert [(row.bus, row.node) for row in told.analysis.nodes] == [("can0", 5), ("can1", 5)]
    assert [row.bus for row in told.emcy] == ["can0"]
    assert {f.bus for f in told.analysis.findings} <= {"can0"}


def test_case_03_a_node_lost_on_one_bus_only() -> None:
    script = Script(None, 5, buses=("can0", "can1")).heartbeat(0, 3000)
    for k in range(100):
        script.frame(k * 100 + 7, "705#05", bus=1)
        script.frame(k * 100 + 9, "706#05")
    lost = script.told().findings("nmt.node_lost")
    assert [(f.bus, f.node) for f in lost] == [("can0", 5)]


@pytest.mark.parametrize("step_s", [-3600, 7200])
def test_case_04_a_step_of_the_clock_is_no_silence(step_s: int) -> None:
    script = node5()
    script.node = 6
    script.heartbeat(3, 5000)
    frames = [
        (T0 + round((t + step_s * 1000 * (t > 2500)) * 1e6), bus, can_id, flags, len(data), data)
        for t, bus, can_id, flags, data in sorted(script.rows)
    ]
    facts = CaptureFacts(Path("stepped.log"), "candump", ["can0"])
    analysis = analyze(
        iter([(0, FrameBatch.from_rows(frames))]),
        [facts],
        ["can0"],
        description=BusDescription(),
        devices={},
    )
    assert analysis.capture.duration_ns >= 0
    accused = [f for f in analysis.findings if f.id == "nmt.node_lost" and f.node is not None]
    assert accused == []
    for row in analysis.nmt_states:
        assert row.end_ns - row.start_ns < 8_000_000_000 or row.state in ("UNKNOWN", "LOST")
    if step_s < 0:
        assert "clock.step_back" in [f.id for f in analysis.findings]


def test_case_04_a_hole_in_the_recording_is_told_once() -> None:
    script = Script(None, 5)
    for node in (5, 6, 7, 8):
        script.node = node
        script.heartbeat(node, 4000).heartbeat(9000 + node, 14_000)
    told = script.told()
    about = [f for f in told.analysis.findings if f.severity != "info"]
    assert len(about) <= 1
    assert [f.node for f in told.analysis.findings if f.node is not None] == []
    assert says(told.text, "whole bus") or says(told.text, "nothing", "heard")


def test_case_05_stopped_without_a_command() -> None:
    told = Script(None, 5).heartbeat(0, 3000).heartbeat(3000, 8000, STOPPED).told()
    found = told.finding("nmt.left_operational")
    assert says(found.text, "node 5", "STOPPED", "without a")


def test_case_05_a_stuck_guard_toggle() -> None:
    script = Script(None, 5)
    for k in range(40):
        script.frame(k * 100, "705#R").frame(k * 100 + 1, f"705#{OPERATIONAL:02X}")
    told = script.told()
    assert told.row().toggle_errors >= 35
    assert told.finding("nmt.guard_toggle").node == 5


def test_case_05_sync_out_for_300_ms() -> None:
    script = node5().sync(0, 2000, 10).sync(2300, 5000, 10)
    found = script.told().finding("sync.missing")
    assert says(found.text, "080h", "310 ms")


def test_case_05_sync_jitter_of_4_ms() -> None:
    generator = np.random.default_rng(7)
    script = node5()
    for k in range(500):
        script.frame(10 * k + 4 * float(generator.random()), "080#")
    assert "sync.jitter" in script.told().ids


def test_case_05_a_tpdo_stops_while_the_heartbeat_goes_on() -> None:
    script = Script(None, 5).heartbeat(0, 20_000).read(1, 0x1800, 2, 0xFE, size=1)
    script.read(4, 0x1800, 5, 20, size=2).read(7, 0x1800, 1, 0x185)
    told = script.every(20, 10_000, 20, lambda k: f"185#{little(k)}").told()
    found = told.finding("pdo.stopped")
    assert found.node == 5
    assert says(found.text, "185h")
    assert "nmt.node_lost" not in told.ids


def test_case_05_a_duplicate_node_id() -> None:
    script = Script(None, 5).heartbeat(0, 10_000, period=100).heartbeat(33, 10_000, period=170)
    assert script.told().finding("nmt.duplicate_node_id").node == 5


def test_case_05_a_heartbeat_slower_than_1017h() -> None:
    script = Script(None, 5).read(1, 0x1017, 0, 100, size=2).heartbeat(10, 20_000, period=500)
    found = script.told().finding("nmt.heartbeat_slow")
    assert says(found.text, "500 ms", "100 ms")


def test_case_06_bus_off_and_restart_are_told_as_such() -> None:
    script = node5()
    script.frame(2000, "040#0000000000000000", flags=ERROR)
    script.frame(2500, "100#0000000000000000", flags=ERROR)
    told = script.told()
    found = told.finding("error.bus_off")
    assert says(found.text, "can0", "bus-off", "500 ms")
    states = [row.state for row in told.analysis.bus_states]
    assert states.index("bus-off") < states.index("restarted")


def test_case_07_time_is_decoded() -> None:
    days = (1_750_000_000 - 441_763_200) // 86_400
    script = node5().frame(1000, f"100#{little(36_000_000)}{little(days, bits=16)}")
    (row,) = script.told().analysis.time_stamps
    assert row.utc_ns == (441_763_200 + days * 86_400 + 36_000) * 1_000_000_000


def test_case_07_lss_is_told_in_words() -> None:
    script = node5().frame(1000, "7E5#0401000000000000").frame(1010, "7E5#110A000000000000")
    told = script.frame(1011, "7E4#1100000000000000").told()
    rows = told.analysis.lss
    assert [row.sender for row in rows] == ["master", "master", "slave"]
    assert says(rows[0].text, "configuration")
    assert says(rows[1].text, "node", "10")


@pytest.mark.parametrize(
    ("device_type", "mapping", "name", "unit"),
    [(0x00020196, 0x60040020, "position", "counts"), (0x0004019A, 0x61100020, "slope", "deg")],
)
def test_case_07_profiles_bring_names_and_scales(
    device_type: int, mapping: int, name: str, unit: str
) -> None:
    script = Script(None, 5).heartbeat(0, 3000).read(1, 0x1000, 0, device_type)
    script.read(4, 0x1A00, 0, 1, size=1).read(7, 0x1A00, 1, mapping)
    script.read(10, 0x6000, 0, 100 if unit == "deg" else 0, size=2).read(13, 0x6001, 0, 4096)
    told = script.every(20, 3000, 20, lambda k: f"185#{little(100 + k)}").told()
    index = mapping >> 16
    assert says(told.trace(index).name, name)
    assert told.trace(index).unit == unit
    if unit == "deg":
        assert told.trace(index).value[0] == pytest.approx(10.0)
    else:
        assert told.trace(index).columns["angle_deg"][0] == pytest.approx(100 * 360 / 4096)


def plain_log() -> list[tuple[int, int, int, int, int, bytes]]:
    script = node5().emcy(1500, 0x8110, 0x11).read(200, 0x1017, 0, 100, size=2)
    script.every(30, 5000, 25, lambda k: f"185#{little(k)}").frame(4990, "705#04")
    return [
        (T0 + round(t * 1e6), bus, can_id, flags, len(data), data)
        for t, bus, can_id, flags, data in sorted(script.rows)
    ]


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".csv", ".log", ".log.gz", ".mcap"])
def test_case_08_other_formats_tell_the_same(suffix: str, tmp_path: Path) -> None:
    candump = tmp_path / "first.log"
    with can.CanutilsLogWriter(candump, channel="can0") as writer:
        for row in plain_log():
            writer.on_message_received(message(row))
    path = tmp_path / f"other{suffix}"
    if suffix == ".log.gz":
        path.write_bytes(gzip.compress(candump.read_bytes()))
    elif suffix in (".mcap", ".log"):
        convert([candump], path)
    else:
        with can.Logger(path) as logger:
            for row in plain_log():
                logger.on_message_received(message(row))
    one, other = (open_session(p).analysis for p in (candump, path))
    assert [(r.node, r.heartbeats, r.emcy) for r in one.nodes] == [
        (r.node, r.heartbeats, r.emcy) for r in other.nodes
    ]
    assert [f.id for f in one.findings] == [f.id for f in other.findings]
    assert [(r.index, r.value) for r in one.sdo] == [(r.index, r.value) for r in other.sdo]


def test_case_08_several_files_are_one_session(tmp_path: Path) -> None:
    rows = plain_log()
    paths = []
    for k, part in enumerate((rows[: len(rows) // 2], rows[len(rows) // 2 :])):
        path = tmp_path / f"part{k}.log"
        with can.CanutilsLogWriter(path, channel="can0") as writer:
            for row in part:
                writer.on_message_received(message(row))
        paths.append(path)
    analysis = open_session(paths[::-1]).analysis
    assert analysis.capture.frames == len(rows)
    assert "nmt.node_lost" not in [f.id for f in analysis.findings]


def test_case_09_times_are_utc() -> None:
    told = node5().told()
    assert told.analysis.capture.start_utc_ns == T0
    assert "2025-06-15" in told.summary


def test_case_09_tpdo5_and_timing_are_there() -> None:
    script = Script(None, 5, bitrate=125_000).heartbeat(0, 5000).sync(1, 5000, 10)
    script.read(2.2, 0x1804, 1, 0x1C5).read(4.4, 0x1804, 2, 1, size=1)
    script.more = "[bus.can0]\nbitrate = 125000\n"
    told = script.every(12.5, 5000, 10, "1C5#01020304").told()
    row = told.pdo(0x1C5)
    assert (row.node, row.pdo, row.transmission_type) == (5, "TPDO5", 1)
    assert row.response_us is not None
    assert row.response_us.median == pytest.approx(1500, abs=1)
    assert row.response_us.std is not None
    (load,) = told.analysis.bus_load
    assert load.mean_percent is not None
    assert 10 < load.mean_percent < 20
    assert [s.answer_us for s in told.analysis.sdo] == [pytest.approx(1000)] * 2
    assert told.analysis.responses[0].histogram.sum() == row.frames


def test_case_10_memory_does_not_grow_with_the_capture() -> None:
    def peak(batches: int) -> int:
        def stream() -> Iterator[tuple[int, FrameBatch]]:
            for k in range(batches):
                yield k * 4000, _busy(k)

        facts = CaptureFacts(Path("long.log"), "candump", ["can0"])
        tracemalloc.start()
        # Told, so that nothing is held back to estimate it.
        told = BusDescription(bitrates={"can0": 1_000_000})
        analyze(stream(), [facts], ["can0"], description=told, devices={})
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    peak(2)
    # Batches are joined to 131,072 frames: 33 of these are one.
    assert peak(200) < 2.0 * peak(70)


def _busy(number: int) -> FrameBatch:
    """4000 frames of a bus with SYNC, four PDOs and four heartbeats."""
    ids = np.array([0x80, 0x181, 0x182, 0x183, 0x184, 0x701, 0x702, 0x703], np.uint32)
    lengths = np.array([0, 8, 8, 8, 8, 1, 1, 1], np.uint8)
    count = 4000
    at = np.arange(count)
    data = np.zeros((count, 8), np.uint8)
    data[:, 0] = np.where(at % 8 >= 5, OPERATIONAL, at % 251)
    return FrameBatch(
        T0 + (number * count + at) * 250_000,
        np.zeros(count, np.uint8),
        ids[at % 8],
        np.zeros(count, np.uint16),
        lengths[at % 8],
        data,
    )


def test_every_case_is_here() -> None:
    cases = {name.split("_")[2] for name in globals() if name.startswith("test_case_")}
    assert cases == {f"{number:02}" for number in range(1, 11)}


def test_a_healthy_node_is_left_in_peace() -> None:
    told = Script(None, 5).heartbeat(0, 3000, PRE_OPERATIONAL).told()
    assert told.accusations == []
