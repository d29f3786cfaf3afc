"""What is known of a node's objects: values with their source, since when, and what they were."""

from pathlib import Path

import canopen
import pytest

from syncline_analyzer.change_words import shortened
from syncline_analyzer.results import ObjectHistoryRow
from syncline_analyzer.session import open_session
from syncline_analyzer.shadow import Shadow
from syncline_analyzer.views.known import known_lines
from syncline_schemas.devices import load_device
from tests.analyzer.log_builder import CAPTURES
from tests.analyzer.traps.script import T0, Script, Told

S = 1000


def history(told: Told, index: int, sub: int = 0) -> list[ObjectHistoryRow]:
    rows = told.analysis.object_history
    return [row for row in rows if (row.node, row.index, row.sub) == (told.node, index, sub)]


def configured() -> Told:
    """Node 5 without a description: 1017h read, written, and lost by a restart."""
    script = Script(node=5).boot(10).heartbeat(100, 3 * S, 0x7F)
    script.read(200, 0x1017, 0, 1000, size=2).write(300, 0x1017, 0, 100, size=2)
    return script.nmt(1000, 0x81).boot(1500).told()


def test_a_value_is_told_with_its_source_and_since_when() -> None:
    told = configured()
    row = told.object(0x1017)
    assert (row.name, row.unit, row.value) == ("producer heartbeat time", "ms", 1000)
    assert (row.source, row.cause, row.saved) == ("sdo-read", "reset", None)
    assert (row.t_ns, row.since_ns) == (T0 + 201_000_000, T0 + 1_000_000_000)


def test_the_history_leaves_no_stretch_out() -> None:
    rows = history(configured(), 0x1017)
    assert [(row.value, row.cause) for row in rows] == [
        (1000, "sdo-read"),
        (100, "sdo-write"),
        (1000, "reset"),
    ]
    assert [row.until_seq for row in rows] == [rows[1].start_seq, rows[2].start_seq, None]
    assert rows[2].seq == rows[0].seq


def test_what_a_reset_leaves_unknown_is_unknown() -> None:
    script = Script(node=5).boot(10).heartbeat(100, 900, 0x7F).write(300, 0x1017, 0, 100, size=2)
    told = script.nmt(1000, 0x81).boot(1500).told()
    assert [(row.value, row.source) for row in history(told, 0x1017)] == [
        (100, "sdo-write"),
        (None, "unknown"),
    ]
    assert not [row for row in told.analysis.objects if row.index == 0x1017]


@pytest.mark.parametrize(
    ("index", "sub", "value", "name", "meaning"),
    [
        (0x1800, 1, 0x80000185, "TPDO1 COB-ID", "185h, off"),
        (0x1902, 2, 10, "TPDO259 transmission type", "every 10th SYNC"),
        (0x15FF, 1, 0x333, "RPDO512 COB-ID", "333h"),
        (0x1A03, 2, 0x60040020, "TPDO4 mapped object 2", "6004h:00, 32 bits"),
        (0x1016, 1, 0x000701F4, "consumer heartbeat time: entry 1", "node 7 within 500 ms"),
        (0x1005, 0, 0x40000080, "COB-ID SYNC", "080h, produced here"),
        (0x1018, 4, 7, "identity: serial number", ""),
        (0x2345, 1, 7, None, ""),
    ],
)
def test_objects_of_unknown_devices_have_the_names_of_cia_301(
    index: int, sub: int, value: int, name: str | None, meaning: str
) -> None:
    told = Script(node=5).boot(10).read(100, index, sub, value).told()
    row = told.object(index, sub)
    assert (row.name, row.meaning, row.value) == (name, meaning, value)


def test_objects_of_drives_have_their_names_where_1000h_says_so() -> None:
    drive = Script(node=5).boot(10).read(50, 0x1000, 0, 0x00020192).read(100, 0x6040, 0, 15)
    assert drive.told().object(0x6040).name == "controlword"
    other = Script(node=5).boot(10).read(50, 0x1000, 0, 0x00030191).read(100, 0x6040, 0, 15)
    assert other.told().object(0x6040).name is None


def test_the_devices_words_come_first_and_what_is_assumed_is_there_too() -> None:
    told = Script("lir-da158a", 1).boot(10).read(100, 0x1800, 2, 254).told()
    row = told.object(0x1800, 2)
    assert row.meaning == "cyclic by the event timer"
    assumed = told.object(0x1800, 5)
    assert (assumed.value, assumed.source, assumed.seq) == (515, "eds-default", None)
    assert (assumed.since_seq, assumed.cause) == (None, "")


def test_written_values_say_whether_they_were_saved() -> None:
    script = Script("lir-da158a", 1).boot(10).write(100, 0x1017, 0, 100).save(200)
    told = script.write(300, 0x1800, 5, 20).told()
    assert told.object(0x1017).saved is True
    assert told.object(0x1800, 5).saved is False


def lines(told: Told) -> dict[str, str]:
    return {line.what: line.text for line in known_lines(told.analysis)}


def test_the_summary_says_what_is_known_and_from_where() -> None:
    script = Script("lir-da158a", 1).boot(10).write(100, 0x1017, 0, 500)
    told = script.read(200, 0x1800, 2, 254).every(1000, 1200, 100, "181#00000000").told()
    known = lines(told)
    assert known["1017h"] == "Producer heartbeat time = 500 ms (sdo-write, seq 2)"
    assert known["TPDO1"] == (
        "type 254 cyclic by the event timer (sdo-read, seq 4); "
        "181h, event timer 515 ms, 6004h:00/32 (eds-default, assumed)"
    )
    assert "1017h" in told.summary
    assert "sdo-write, seq 2" in told.summary


def test_a_mapping_that_is_known_in_part_says_so() -> None:
    script = Script(node=5).boot(10).read(100, 0x1A00, 0, 3).read(200, 0x1A00, 1, 0x20000008)
    assert lines(script.told())["TPDO1"] == "2000h:00/8, 2 not known (sdo-read, seq 4)"


def test_what_is_no_parameter_is_not_missed_in_the_stored_ones() -> None:
    """Neither a cleared error list nor a program (1F51h) is what 1010h stores."""
    script = Script(node=5).boot(10).write(100, 0x1003, 0, 0, size=1)
    script.write(200, 0x1F51, 1, 1, size=1)
    assert "not saved" not in lines(script.told())
    unsaved = lines(script.write(300, 0x1017, 0, 500, size=2).told())["not saved"]
    assert unsaved.startswith("1 written value not saved")


def test_a_long_value_is_told_by_its_beginning_and_its_length() -> None:
    assert shortened("00 01 02") == "00 01 02"
    program = bytes(range(256)) * 20
    assert shortened(program.hex(" ").upper()) == (
        f"{program[:16].hex(' ').upper()} ... (5120 bytes)"
    )
    assert (
        shortened("a name " * 40)
        == "a name a name a name a name a name a name a name... (280 characters)"
    )


def test_the_summary_stays_short() -> None:
    script = Script(node=1)
    for node in range(1, 100):
        script.node = node
        script.boot(node)
        for number in range(30):
            script.write(200 + node * 100 + number * 3, 0x2000 + number, 0, 1)
    found = known_lines(script.told().analysis)
    assert len(found) <= 20 * 13 + 1
    assert "and 79 more nodes" in found[-1].text


def test_session_tables(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(
        "(1700000000.000000) can0 705#00\n"
        "(1700000001.000000) can0 605#2B1710006400\n"
        "(1700000001.001000) can0 585#6017100000000000\n"
        "(1700000002.000000) can0 605#2B171000C800\n"
        "(1700000002.001000) can0 585#6017100000000000\n",
        encoding="ascii",
    )
    session = open_session(path)
    table = session.object_history(5)
    assert table["value_number"].tolist() == [100.0, 200.0]
    assert table["until_seq"].iloc[0] == 4
    assert str(table["start"].iloc[1]) == "2023-11-14 22:13:22.001000+00:00"
    last = session.objects(5)
    assert last["value_number"].tolist() == [200.0]
    assert len(session.object_history(6)) == 0


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the real captures are not here")
def test_a_real_master_configures_three_pdos() -> None:
    """Checked against the log by hand: expedited writes that were acknowledged, the last of each."""
    path = CAPTURES / "hilch_pcan2.trc"
    told = {
        (row.index, row.sub): row.value
        for row in open_session(path).analysis.object_history
        if row.node == 15 and row.cause == "sdo-write"
    }
    wanted = acknowledged_writes(path, 15)
    assert {key: told.get(key) for key in wanted} == wanted
    assert len(wanted) > 30


def acknowledged_writes(path: Path, node: int) -> dict[tuple[int, int], int]:
    """Last acknowledged expedited write of each object, by splitting the lines of a .trc log."""
    pending: tuple[tuple[int, int], int] | None = None
    found: dict[tuple[int, int], int] = {}
    for line in path.read_text(encoding="latin-1").splitlines():
        words = line.split()
        ids = [word for word in words if word in (f"{0x600 + node:04X}", f"{0x580 + node:04X}")]
        if line.startswith(";") or not ids:
            continue
        data = bytes(int(word, 16) for word in words[-8:] if len(word) == 2)
        key = (int.from_bytes(data[1:3], "little"), data[3])
        if ids[0] == f"{0x600 + node:04X}" and data[0] & 0xE3 in (0x22, 0x23):
            size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
            pending = (key, int.from_bytes(data[4 : 4 + size], "little"))
        elif data[0] == 0x60 and pending is not None and pending[0] == key:
            found[key] = pending[1]
            pending = None
    return found


DEVICES = ("haomiao-38", "jn2100", "lir-918", "lir-da158", "lir-da158a", "lir-ma158k")


@pytest.mark.parametrize("name", DEVICES)
def test_assumed_values_are_those_that_canopen_reads(name: str, tmp_path: Path) -> None:
    """python-canopen reads the same EDS with its own resolution of $NODEID."""
    device = load_device(name)
    eds = next(data for file, data in device.files.items() if file.endswith(".eds"))
    path = tmp_path / "device.eds"
    path.write_bytes(eds)
    od = canopen.import_od(str(path), node_id=9)
    store = Shadow(lambda _: "can0", None, {9: device})
    compared = 0
    for index, thing in od.indices.items():
        parts = thing.subindices.items() if hasattr(thing, "subindices") else [(0, thing)]
        for sub, variable in parts:
            if isinstance(variable.default, int):
                assert store.number(0, 9, index, sub) == variable.default, f"{index:04X}h:{sub}"
                compared += 1
    assert compared > 20
