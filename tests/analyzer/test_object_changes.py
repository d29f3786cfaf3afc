"""The change log: who changed which parameter, when, from what to what, and what that means."""

from pathlib import Path
from random import Random

import canopen
import pytest
from canopen.sdo.client import SdoClient
from canopen.sdo.server import SdoServer

from syncline_analyzer.results import Analysis, ObjectChangeRow
from syncline_analyzer.session import open_session
from syncline_samples.scenarios import bad_day, healthy_line
from syncline_schemas.devices import load_device
from tests.analyzer.log_builder import CAPTURES
from tests.analyzer.test_objects import acknowledged_writes
from tests.analyzer.test_sdo_library import Wire
from tests.analyzer.traps.script import T0, Script, Told

SAMPLES = Path(__file__).parents[2] / "samples"
OWN = SAMPLES / "own_devices"


def changes(told: Told | Analysis, index: int | None = None) -> list[ObjectChangeRow]:
    analysis = told.analysis if isinstance(told, Told) else told
    return [row for row in analysis.object_changes if index in (None, row.index)]


def quiet(device: str | None = None, node: int = 5, stop: float = 3000) -> Script:
    return Script(device, node).heartbeat(0, stop, 0x7F)


@pytest.mark.parametrize(
    ("device", "index", "sub", "value", "size", "words"),
    [
        ("lir-da158a", 0x6003, 0, 1000, None, "preset to 1000"),
        ("lir-918", 0x6001, 0, 8192, 4, "8192 counts per turn"),
        ("lir-da158a", 0x6000, 0, 1, 2, "counting counter-clockwise"),
        ("lir-918", 0x6000, 0, 0x1001, 2, "counting counter-clockwise, Gray to binary on"),
        ("haomiao-38", 0x6000, 0, 4, 2, "scaling on"),
        ("haomiao-38", 0x3001, 0, 5, 1, "bit rate 500 kbit/s, after a reset"),
        ("lir-da158", 0x2100, 0, 6, None, "bit rate 500 kbit/s, after a save and a reset"),
        ("lir-da158", 0x2101, 0, 10, None, "node id 10, after a save and a reset"),
        ("lir-da158", 0x2800, 0, 5, 1, "TPDO1 repeats a value: 5 frames"),
        ("jn2100", 0x2043, 0, 3, 1, "angle filter 1 Hz"),
        ("jn2100", 0x2044, 0, 1, 1, "angle definition Euler"),
        ("jn2100", 0x2040, 0, 1, 1, "quadrant correction +/-180 deg"),
        ("jn2100", 0x2046, 0, 1, 1, "zero point: set zero (relative)"),
        ("jn2100", 0x2042, 0, 2, 1, "axes: cancel (absolute)"),
        ("jn2100", 0x2049, 0, 5, 1, "vibration filter 10-400 Hz"),
        ("jn2100", 0x6000, 0, 10, 2, "resolution 0.01 deg"),
        ("jn2100", 0x1800, 2, 0xFE, 1, "TPDO1 type 254: cyclic by the event timer"),
        (None, 0x1017, 0, 100, 2, "heartbeat every 100 ms"),
        (None, 0x1017, 0, 0, 2, "heartbeat off"),
        (None, 0x1801, 1, 0x80000285, 4, "TPDO2 off"),
        (None, 0x1801, 1, 0x285, 4, "TPDO2 on 285h"),
        (None, 0x1400, 2, 3, 1, "RPDO1 type 3: every 3rd SYNC"),
        (None, 0x1800, 3, 50, 2, "TPDO1 inhibit time 5 ms"),
        (None, 0x1A00, 0, 2, 1, "TPDO1 maps 2 objects"),
        (None, 0x1A00, 1, 0x60040020, 4, "TPDO1 object 1: 6004h:00, 32 bits"),
        (None, 0x1016, 1, 0x000701F4, 4, "waits for the heartbeat of node 7 within 500 ms"),
        (None, 0x1029, 1, 2, 1, "after a communication error it goes to Stopped"),
        (None, 0x1003, 0, 0, 1, "error list cleared"),
        (None, 0x2345, 1, 7, 1, "2345h:01 7"),
    ],
)
def test_a_change_in_the_words_of_who_makes_it(
    device: str | None, index: int, sub: int, value: int, size: int | None, words: str
) -> None:
    (row,) = changes(quiet(device).write(100, index, sub, value, size=size).told())
    assert (row.index, row.sub, row.words) == (index, sub, words)
    assert (row.who, row.client, row.cause) == ("SDO client on 605h", 0x605, "sdo-write")
    assert row.t_ns == T0 + 101_000_000


def test_an_encoder_that_is_known_by_its_profile_only_has_the_profile_s_words() -> None:
    script = quiet().read(10, 0x1000, 0, 0x00020196).write(100, 0x6003, 0, 77)
    (row,) = changes(script.write(200, 0x6000, 0, 4, size=2).told(), 0x6003)
    assert (row.name, row.words) == ("preset value", "preset to 77")
    (bits,) = changes(script.told(), 0x6000)
    assert bits.words == "counting clockwise, scaling on"


def test_only_the_bits_that_change_are_told() -> None:
    script = quiet("haomiao-38").read(10, 0x6000, 0, 1, size=2)
    (row,) = changes(script.write(100, 0x6000, 0, 5, size=2).told())
    assert (row.old, row.new, row.words, row.changed) == (1, 5, "scaling on", True)


def test_a_value_that_only_the_eds_tells_may_have_been_the_same() -> None:
    (row,) = changes(quiet("lir-da158a").write(100, 0x1800, 5, 20, size=2).told())
    assert (row.old, row.old_source, row.old_words) == (515, "eds-default", "515 ms")
    assert (row.changed, row.new) == (None, 20)


def test_writing_a_value_again_is_counted_and_no_change() -> None:
    script = quiet().read(10, 0x1017, 0, 500, size=2).write(50, 0x1017, 0, 500, size=2)
    for at in (100, 200, 300):
        script.write(at, 0x1017, 0, 100, size=2)
    (row,) = changes(script.told())
    assert (row.old, row.new, row.repeats, row.changed) == (500, 100, 2, True)


def test_a_preset_is_told_each_time_it_is_made() -> None:
    script = quiet("lir-da158a").write(100, 0x6003, 0, 0).write(200, 0x6003, 0, 0)
    assert [row.words for row in changes(script.told())] == ["preset to 0"] * 2


def test_whether_a_save_keeps_it() -> None:
    script = quiet("lir-da158a").write(100, 0x6003, 0, 5).write(110, 0x1017, 0, 100, size=2)
    script.save(200).write(300, 0x1017, 0, 200, size=2).write(310, 0x1800, 1, 0x80000185)
    told = script.save(400).write(500, 0x1800, 5, 33, size=2).told()
    found = {(row.index, row.sub, row.new): row.saved for row in changes(told)}
    assert found[0x6003, 0, 5] is True  # its offset 6509h is kept
    assert found[0x1017, 0, 100] is True
    assert found[0x1017, 0, 200] is True
    assert found[0x1800, 1, 0x80000185] is False  # sheet skbis-lir-da158, trap 12: not storable
    assert found[0x1800, 5, 33] is False
    assert [row.words for row in changes(told, 0x1010)] == ["saved: all parameters"] * 2
    first, second = changes(told, 0x1010)
    kept = {(row.index, row.new): row.saved_seq for row in changes(told)}
    assert (kept[0x1017, 100], kept[0x1017, 200]) == (first.seq, second.seq)


def test_what_the_maker_stores_at_once_and_what_he_does_not_say() -> None:
    script = quiet("jn2100", 10).write(100, 0x2046, 0, 1, size=1)
    told = script.write(200, 0x2043, 0, 3, size=1).told()
    assert [(row.index, row.saved) for row in changes(told)] == [(0x2046, True), (0x2043, None)]


def test_a_reset_takes_back_what_was_not_saved() -> None:
    script = quiet("lir-da158a").read(50, 0x1800, 5, 515, size=2)
    script.write(100, 0x1800, 5, 20, size=2).nmt(3000, 0x81).boot(7000)
    write, back = changes(script.told())
    assert (write.new, write.saved) == (20, False)
    assert (back.cause, back.who) == ("reset", "the device itself (reset)")
    assert (back.old, back.new, back.t_ns) == (20, 515, T0 + 3_000_000_000)
    assert back.words == "TPDO1 event timer 515 ms"


def test_where_nobody_knows_what_a_reset_does_the_next_read_tells() -> None:
    script = quiet().read(50, 0x1017, 0, 500, size=2).write(100, 0x2005, 0, 7, size=2)
    script.nmt(3000, 0x81).boot(3500)
    assert [row.cause for row in changes(script.told(), 0x2005)] == ["sdo-write"]
    again = script.write(4000, 0x2005, 0, 7, size=2).told()
    (row,) = changes(again, 0x2005)
    assert row.repeats == 1


def test_a_setting_that_reads_otherwise_was_changed_unseen() -> None:
    script = quiet("jn2100", 10).read(100, 0x6000, 0, 100, size=2)
    (row,) = changes(script.read(2000, 0x6000, 0, 10, size=2).told())
    assert (row.old, row.new, row.words) == (100, 10, "resolution 0.01 deg")
    assert (row.cause, row.who, row.client) == ("seen by a read", "not seen in this capture", None)


def test_measured_values_and_counters_are_no_changes() -> None:
    script = quiet("lir-da158", 1)
    for at in range(10):
        script.read(100 + at * 10, 0x6004, 0, at).read(105 + at * 10, 0x6508, 0, at)
        script.read(300 + at * 10, 0x1001, 0, at, size=1).read(400 + at * 5, 0x1003, 1, at + 1)
    assert changes(script.told()) == []


def test_a_refused_write_changes_nothing() -> None:
    script = quiet("lir-da158a").write(100, 0x6001, 0, 5, abort=0x06010002)
    assert changes(script.told()) == []


def test_a_write_to_6000h_zeroes_the_offset_as_its_side_effect() -> None:
    script = quiet("lir-da158a").read(50, 0x6509, 0, 1234)
    write, offset = changes(script.write(100, 0x6000, 0, 1, size=2).told())
    assert (offset.index, offset.old, offset.new) == (0x6509, 1234, 0)
    assert (offset.cause, offset.written, offset.words) == ("side effect", 0x600000, "offset 0")
    assert offset.seq == write.seq


def test_an_alias_says_what_was_written() -> None:
    (row,) = changes(quiet("lir-da158").write(100, 0x6200, 0, 30, size=2).told())
    assert (row.index, row.sub, row.written) == (0x1800, 5, 0x620000)
    assert row.words == "TPDO1 event timer 30 ms"


def test_restored_defaults_and_a_factory_reset_are_orders() -> None:
    (load,) = changes(quiet("lir-da158a").load(100).told())
    assert load.words == "defaults for all parameters, from the next reset on"
    script = quiet("jn2100", 10).write(100, 0x2043, 0, 3, size=1)
    told = script.write(200, 0x207F, 0, 1, size=1).told()
    assert [row.words for row in changes(told)][:2] == ["angle filter 1 Hz", "factory reset"]
    (back,) = [row for row in changes(told, 0x2043) if row.cause == "factory reset"]
    assert (back.old, back.new_source) == (3, "eds-default")


def test_another_server_and_a_known_client_are_named() -> None:
    """Node 5 has a second server on 6A5h and 5A5h; node 3 says that it is the client of it."""
    script = quiet().write(50, 0x1201, 1, 0x625).write(60, 0x1201, 2, 0x5A5)
    script.frame(200, "625#2B17100064000000").frame(201, "5A5#6017100000000000")
    (row,) = changes(script.told(), 0x1017)
    assert (row.client, row.who) == (0x625, "SDO client on 625h")
    script.node = 3
    script.heartbeat(0, 3000).read(70, 0x1280, 1, 0x625)
    script.node = 5
    (named,) = changes(script.told(), 0x1017)
    assert named.who == "node 3 (SDO client on 625h)"


def test_lss_changes_a_node_id_too() -> None:
    """CiA 305: configure node-ID 8, answered without an error."""
    script = quiet().frame(100, "7E5#1108000000000000").frame(110, "7E4#1100000000000000")
    (row,) = changes(script.told())
    assert (row.who, row.cause, row.new, row.index) == ("LSS master", "lss", 8, None)


@pytest.mark.parametrize("seed", range(5))
def test_against_the_writes_that_the_canopen_library_made(seed: int) -> None:
    """The library's client and server with an EDS of its own; a dictionary says what changed."""
    random, eds = Random(seed), OWN / "generic-406.eds"
    od = canopen.import_od(str(eds), node_id=5)
    local, wire = canopen.LocalNode(5, od), Wire(5)
    server = SdoServer(0x605, 0x585, local)
    client = SdoClient(0x605, 0x585, od)
    server.network = client.network = wire  # type: ignore[assignment]
    wire.server = lambda data: server.on_request(0x605, bytearray(data), 0.0)
    wire.client = lambda data: client.on_response(0x585, bytearray(data), 0.0)
    objects = [(0x6000, 0), (0x6002, 0), (0x6001, 0), (0x1800, 5), (0x1800, 2), (0x1801, 3)]
    known = {key: int.from_bytes(client.upload(*key), "little") for key in objects}
    expected = []
    for _ in range(60):
        key, value = random.choice(objects), random.randrange(1, 4)
        if random.random() < 0.3:
            client.upload(*key)
            continue
        size = 4 if key == (0x6001, 0) or key == (0x6002, 0) else 1 if key == (0x1800, 2) else 2
        client.download(*key, value.to_bytes(size, "little"))
        if known[key] != value:
            expected.append((*key, known[key], value))
            known[key] = value
    found = [
        (row.index, row.sub, row.old, row.new)
        for row in analysed(wire, {5: load_device(eds)}).object_changes
    ]
    assert found == expected
    assert len(expected) > 10


def analysed(wire: Wire, devices: dict[int, object]) -> Analysis:
    from syncline_analyzer.capture import CaptureFacts
    from syncline_analyzer.engine import analyze
    from syncline_schemas.batch import FrameBatch
    from syncline_schemas.description import BusDescription

    return analyze(
        [(0, FrameBatch.from_rows(wire.rows))],
        [CaptureFacts(Path("wire.log"), "candump", ["can0"])],
        ["can0"],
        description=BusDescription(),
        devices=devices,  # type: ignore[arg-type]
    )


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the real captures are not here")
def test_a_real_configuration_ends_where_the_log_says() -> None:
    """Every object that a real master wrote: its change row, or the value was read before."""
    path = CAPTURES / "hilch_pcan2.trc"
    analysis = open_session(path).analysis
    last: dict[tuple[int, int], object] = {}
    for row in analysis.object_changes:
        if row.node == 15 and row.index is not None and row.cause == "sdo-write":
            last[row.index, row.sub or 0] = row.new
    read = {
        (row.index, row.sub): int.from_bytes(row.data, "little")
        for row in analysis.sdo
        if (row.node, row.direction, row.result) == (15, "upload", "ok")
    }
    wanted = acknowledged_writes(path, 15)
    assert {key: last.get(key, read.get(key)) for key in wanted} == wanted
    assert len(last.keys() & wanted.keys()) > 30


def test_tables_json_and_text_have_them(tmp_path: Path) -> None:
    from syncline_analyzer.views.json_view import to_object
    from syncline_analyzer.views.tables import table, write_tables

    told = quiet("lir-da158a").write(100, 0x6003, 0, 1000).told()
    assert "preset to 1000" in told.summary
    assert to_object(told.analysis)["object_changes"][0]["words"] == "preset to 1000"
    frame = table(told.analysis, "object_changes")
    assert frame["new_number"].tolist() == [1000.0]
    assert frame["who"].tolist() == ["SDO client on 605h"]
    assert (tmp_path / "object_changes.parquet") in write_tables(told.analysis, tmp_path)


def test_a_whole_configuration_is_one_line_of_the_summary() -> None:
    script = quiet()
    for at, (index, sub, value) in enumerate(
        [(0x1017, 0, 100), (0x1800, 2, 1), (0x1800, 5, 20), (0x1801, 2, 3), (0x1801, 5, 7)]
    ):
        script.write(100 + 10 * at, index, sub, value)
    lines = [
        line
        for line in script.write(2500, 0x1017, 0, 0).told().summary.splitlines()
        if "SDO client on 605h" in line
    ]
    assert len(lines) == 2
    assert "TPDO1 event timer 20 ms and 2 more" in lines[0]
    assert "5 objects" in lines[0]
    assert "heartbeat off" in lines[1]


@pytest.mark.parametrize("name", ["bad_day", "healthy_line"])
def test_against_the_writes_that_the_simulated_master_was_told_to_make(name: str) -> None:
    """Every write in the scenario's own list of jobs, and nothing that is not in it."""
    scenario = {"bad_day": bad_day, "healthy_line": healthy_line}[name]()
    wanted = {
        (device.node_id, job.index, job.sub, int.from_bytes(job.data, "little"))
        for device in scenario.devices
        for job in device.jobs
        if job.data
    }
    analysis = open_session(SAMPLES / f"{name}.mcap").analysis
    made = {
        (row.node, row.index, row.sub, row.new)
        for row in analysis.object_changes
        if row.cause == "sdo-write" and isinstance(row.new, int)
    }
    faults = {(3, 0x6003, 0, 5000)} if name == "bad_day" else set()
    assert made == wanted | faults


def test_what_is_written_all_day_long_keeps_its_last_changes() -> None:
    script = quiet()
    for count in range(2100):
        script.write(10 + count, 0x2345, 0, count)
    rows = changes(script.told())
    assert len(rows) == 2000
    assert (rows[0].old, rows[0].new, rows[-1].new) == (99, 100, 2099)
