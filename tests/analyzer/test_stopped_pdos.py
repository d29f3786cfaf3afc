"""What stops with a PDO: its master's guarding, the requests for it, SYNC, or a node's heartbeat."""

from pathlib import Path

import pytest

from syncline_schemas.batch import Gap
from tests.analyzer.control_runs import MS, Row, frame, remote
from tests.analyzer.traps.script import Script
from tests.analyzer.whole_run import beats, every, found, ids, whole, write

OWN_EDS = """
[FileInfo]
FileName=own.eds
[DeviceInfo]
VendorName=Own
ProductName=Own
[OptionalObjects]
SupportedObjects=2
1=0x1400
2=0x1800
[1400]
ParameterName=RPDO1
ObjectType=0x9
SubNumber=3
[1400sub1]
ParameterName=COB-ID
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x200
[1400sub2]
ParameterName=type
DataType=0x0005
AccessType=rw
DefaultValue=255
[1400sub5]
ParameterName=timer
DataType=0x0006
AccessType=rw
DefaultValue=100
[1800]
ParameterName=TPDO1
ObjectType=0x9
SubNumber=3
[1800sub1]
ParameterName=COB-ID
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x180
[1800sub2]
ParameterName=type
DataType=0x0005
AccessType=rw
DefaultValue=255
[1800sub5]
ParameterName=timer
DataType=0x0006
AccessType=rw
DefaultValue=100
"""
"""A device of which only its EDS is known: event timers of 100 ms."""
COUNTING = b"\x01\x02"


def asked(start_ms: float, stop_ms: float, can_id: int = 0x185) -> list[Row]:
    """Remote frames for a PDO, and the answers."""
    requests = [remote(row[0] / MS, can_id) for row in every(can_id, start_ms, stop_ms, 200)]
    return [*requests, *every(can_id, start_ms + 1, stop_ms, 200, COUNTING)]


@pytest.mark.near_miss("pdo.stopped")
@pytest.mark.parametrize("sync", [False, True])
def test_a_pdo_that_remote_frames_ask_for_is_never_due(sync: bool) -> None:
    syncs = every(0x080, 0, 60_000, 20) if sync else []
    analysis = whole(beats(5, 0, 60_000), beats(6, 7, 60_000), syncs, asked(2_000, 30_000))
    assert analysis.findings == []


@pytest.mark.triggers("pdo.stopped")
def test_a_pdo_that_was_asked_for_once_and_comes_by_itself_is_due() -> None:
    rows = [remote(5_010, 0x185), *every(0x185, 0, 30_000, 50, COUNTING)]
    analysis = whole(beats(5, 0, 60_000), beats(6, 7, 60_000), rows)
    assert [f.id for f in analysis.findings] == ["pdo.stopped"]


@pytest.mark.near_miss("pdo.stopped")
def test_pdos_that_stop_after_the_life_guarding_error_are_part_of_that_story() -> None:
    life = [*write(600, 5, 0x100C, 0, 100, 2), *write(610, 5, 0x100D, 0, 3, 1)]
    guarding = [remote(t, 0x705) for t in range(1_000, 30_000, 100)]
    answers = [
        frame(t + 1, 0x705, "85" if (t // 100) % 2 else "05") for t in range(1_000, 30_000, 100)
    ]
    pdos = every(0x185, 2_000, 30_400, 50, COUNTING)
    error = [frame(30_200, 0x085, "3081110000000000")]
    analysis = whole(
        [frame(500, 0x705, "00"), frame(900, 0x000, "0105")],
        *(life, guarding, answers, pdos, error, beats(6, 7, 90_000)),
    )
    assert found(analysis, "pdo.stopped") == []
    (story,) = found(analysis, "nmt.guarding_lost")
    (link,) = [link for link in story.chain if link.id == "pdo.stopped"]
    assert "stayed OPERATIONAL" not in link.text
    assert "was not heard" in link.text


@pytest.mark.triggers("pdo.stopped")
def test_no_state_is_claimed_for_a_node_that_tells_none() -> None:
    start = [frame(500, 0x705, "00"), frame(900, 0x000, "0105")]
    pdos = every(0x185, 1_000, 30_000, 50, COUNTING)
    (finding,) = found(whole(start, pdos, beats(6, 7, 60_000)), "pdo.stopped")
    assert finding.severity == "warning"
    assert "stayed" not in finding.text
    assert "replace" not in finding.check_next
    assert "nmt.node_lost" not in ids(whole(start, pdos, beats(6, 7, 60_000)))


def running(stop_ms: float, sync_stop_ms: float) -> list[Row]:
    """Nodes 5 and 6 that answer SYNC, and tell OPERATIONAL."""
    syncs = every(0x080, 0, sync_stop_ms, 20)
    answers = [
        row for node in (5, 6) for row in every(0x180 + node, node / 10, sync_stop_ms, 20, COUNTING)
    ]
    return [*syncs, *answers, *beats(5, 1, stop_ms), *beats(6, 7, stop_ms)]


@pytest.mark.triggers("sync.stopped")
def test_sync_that_ends_for_good_is_one_finding() -> None:
    analysis = whole(running(60_000, 30_000))
    (finding,) = analysis.findings
    assert (finding.id, finding.severity, finding.node) == ("sync.stopped", "warning", None)
    assert "nodes 5, 6 stayed OPERATIONAL" in finding.text
    assert "185h, 186h" in finding.text


@pytest.mark.triggers("sync.stopped")
def test_the_producer_that_is_lost_with_sync_is_the_root() -> None:
    analysis = whole(running(60_000, 30_000), beats(1, 3, 30_000))
    (finding,) = analysis.findings
    assert (finding.id, finding.node) == ("nmt.node_lost", 1)
    assert [(link.id, link.node) for link in finding.chain] == [("sync.stopped", 1)]
    assert any("only the common moment" in text for text in finding.assumed)


@pytest.mark.near_miss("sync.stopped")
@pytest.mark.parametrize("command", ["0200", "8000", "8100"])
def test_sync_may_end_with_a_command_to_all_nodes(command: str) -> None:
    rows = running(60_000, 30_000)
    analysis = whole(rows, [frame(29_990, 0x000, command)])
    assert "sync.stopped" not in ids(analysis)


@pytest.mark.near_miss("sync.stopped")
def test_sync_that_ends_with_the_capture_or_its_setting_is_no_fault() -> None:
    assert whole(running(60_000, 57_000)).findings == []
    assert "sync.stopped" not in ids(whole(running(60_000, 30_000), write(29_995, 1, 0x1006, 0, 0)))


@pytest.mark.triggers("nmt.heartbeat_ended")
def test_a_heartbeat_that_ends_while_the_pdos_go_on_is_told() -> None:
    pdos = every(0x185, 0, 60_000, 50, COUNTING)
    (finding,) = whole(beats(5, 0, 30_000), beats(6, 7, 60_000), pdos).findings
    assert (finding.id, finding.severity, finding.node) == ("nmt.heartbeat_ended", "warning", 5)
    assert "went on for 30.05 s" in finding.text
    assert finding.assumed


@pytest.mark.near_miss("nmt.heartbeat_ended")
def test_a_heartbeat_that_somebody_ended_is_no_fault() -> None:
    pdos = every(0x185, 0, 60_000, 50, COUNTING)
    rows = [*beats(5, 0, 30_000), *beats(6, 7, 60_000), *pdos]
    assert "nmt.heartbeat_ended" not in ids(whole(rows, write(29_950, 5, 0x1017, 0, 0, 2)))
    again = [frame(30_500, 0x705, "00")]
    assert "nmt.heartbeat_ended" not in ids(whole(rows, again))
    gap = Gap(29_980 * MS, 31_000 * MS, "overrun", 0, None)
    assert "nmt.heartbeat_ended" not in ids(whole(outside(rows, gap), gap))


def outside(rows: list[Row], gap: Gap) -> list[Row]:
    return [row for row in rows if not gap.start_ns <= row[0] < gap.end_ns]


@pytest.mark.triggers("nmt.missing_after_gap")
def test_a_node_that_is_not_heard_after_a_gap_is_told() -> None:
    gap = Gap(30_000 * MS, 35_000 * MS, "adapter lost", 0, None)
    rows = outside([*beats(5, 0, 32_000), *beats(6, 7, 60_000)], gap)
    (finding,) = found(whole(rows, gap), "nmt.missing_after_gap")
    assert (finding.severity, finding.node) == ("warning", 5)
    assert "lies in the gap" in finding.text
    new = outside([*beats(5, 0, 32_000), *beats(6, 7, 60_000), *beats(8, 36_000, 60_000)], gap)
    (finding,) = found(whole(new, gap), "nmt.missing_after_gap")
    assert finding.text.endswith("Node 8 was heard for the first time after it.")
    assert finding.cause.startswith("It carries another number since then (8), or ")


@pytest.mark.near_miss("nmt.missing_after_gap")
def test_nobody_is_missed_after_a_gap_where_nobody_is_heard_or_it_was_silent_before() -> None:
    gap = Gap(30_000 * MS, 35_000 * MS, "adapter lost", 0, None)
    short = outside([*beats(5, 0, 32_000), *beats(6, 7, 38_000)], gap)
    assert found(whole(short, gap), "nmt.missing_after_gap") == []
    before = outside([*beats(5, 0, 20_000), *beats(6, 7, 60_000)], gap)
    assert found(whole(before, gap), "nmt.missing_after_gap") == []


def lir(stop_ms: float, *, end_ms: float = 60_000, data: str = "") -> Script:
    """A LIR of factory settings that turns and that nobody watches, beside a node with a heartbeat."""
    script = Script("lir-da158a", 5).nmt(-1_000, 1)
    if data:
        script.every(0, stop_ms, 515, data)
    else:
        script.pdo(0, stop_ms, 515, lambda k: 1_000 * k)
    return script.every(7, end_ms, 1_000, "714#05")


@pytest.mark.triggers("pdo.stopped")
@pytest.mark.parametrize("batch", [1 << 20, 17])
def test_a_node_that_nothing_watches_is_told_when_its_pdos_end(batch: int) -> None:
    """No heartbeat, no guarding, and a timer that only the maker's EDS tells: its frames keep to it."""
    told = lir(30_000).told(batch)
    (finding,) = told.findings("pdo.stopped")
    assert (finding.severity, finding.node) == ("warning", 5)
    assert "Nothing at all was heard of it from then on, and nothing watches it" in finding.text
    assert "its repeat counter (2800h) was not read" in finding.cause
    assert "heartbeat (1017h)" in finding.check_next
    assert "1800h:05 = 515 (eds-default)" in finding.assumed
    assert told.findings("nmt.node_lost") == []


@pytest.mark.triggers("pdo.stopped")
def test_a_repeat_counter_explains_nothing_where_more_equal_frames_came() -> None:
    told = lir(180_000, end_ms=220_000, data="185#01020304").told()
    assert "2800h" not in told.finding("pdo.stopped").cause
    few = lir(100_000, end_ms=140_000, data="185#01020304").told()
    assert "2800h" in few.finding("pdo.stopped").cause


@pytest.mark.near_miss("pdo.stopped")
def test_an_unwatched_node_may_fall_silent_for_many_reasons() -> None:
    assert "pdo.stopped" not in lir(30_000).read(-500, 0x2800, 0, 3, size=1).told().ids
    assert "pdo.stopped" not in lir(30_000).nmt(30_100, 0x02).told().ids
    assert "pdo.stopped" not in lir(30_000).write(29_000, 0x1800, 5, 0, size=2).told().ids
    assert "pdo.stopped" not in lir(30_000).write(29_000, 0x1800, 2, 0, size=1).told().ids
    assert "pdo.stopped" not in lir(30_000, end_ms=36_000).told().ids
    silent = lir(30_000, end_ms=30_000)
    assert "pdo.stopped" not in silent.every(60_007, 62_000, 1_000, "714#05").told().ids
    blind = lir(30_000)
    blind.rows = [row for row in blind.rows if not 30_000 <= row[0] < 40_000]
    blind.gaps.append((30_000, 40_000))
    assert "pdo.stopped" not in blind.told().ids


@pytest.mark.near_miss("pdo.stopped")
def test_a_shaft_that_stood_still_may_have_paused_an_unread_repeat_counter() -> None:
    script = lir(30_000).pdo(45_000, 60_000, 515, lambda k: 58_000 + 1_000 * k)
    assert "pdo.stopped" not in script.told().ids


@pytest.mark.near_miss("pdo.stopped")
def test_a_rhythm_beside_the_default_timer_is_that_of_the_value() -> None:
    script = Script("lir-da158a", 5).nmt(-1_000, 1).pdo(0, 30_000, 480, lambda k: 1_000 * k)
    assert "pdo.stopped" not in script.every(7, 60_000, 1_000, "714#05").told().ids


@pytest.mark.near_miss("pdo.stopped")
@pytest.mark.parametrize("command", [0x02, 0x80, 0x81, 0x82])
@pytest.mark.parametrize("at", [29_900, 30_100])
def test_a_command_to_all_nodes_may_stop_a_node_that_tells_no_state(command: int, at: int) -> None:
    assert "pdo.stopped" not in lir(30_000).nmt(at, command, 0).told().ids


@pytest.mark.triggers("pdo.stopped")
def test_pdos_that_end_without_a_command_or_after_a_start_are_told() -> None:
    assert "pdo.stopped" in lir(30_000).nmt(25_000, 2, 0).nmt(26_000, 1, 0).told().ids
    assert "pdo.stopped" in lir(30_000).nmt(35_000, 2, 0).told().ids
    assert "pdo.stopped" in lir(30_000).nmt(30_100, 0x80, 0).nmt(32_000, 1, 0).told().ids
    soon = lir(30_000).nmt(30_100, 0x80, 0).nmt(55_000, 1, 0)
    assert "pdo.stopped" not in soon.told().ids


@pytest.mark.near_miss("pdo.stopped")
def test_a_node_that_receives_a_pdo_does_not_stop_sending_it(tmp_path: Path) -> None:
    """The default of 1400h:5 is a deadline for whoever sends the RPDO."""
    path = tmp_path / "own.eds"
    path.write_text(OWN_EDS, encoding="utf-8")
    script = Script(str(path), 5).nmt(-1_000, 1).heartbeat(0, 60_000)
    script.every(0, 30_000, 100, lambda k: f"205#{k:04X}")
    assert "pdo.stopped" not in script.told().ids


def paced(path: Path, *, still: bool) -> Script:
    """A node of the user's EDS whose frames keep to the timer of the EDS, and that lives on."""
    path.write_text(OWN_EDS, encoding="utf-8")
    script = Script(str(path), 5).nmt(-1_000, 1).heartbeat(0, 90_000)
    return script.pdo(0, 30_000, 100.3, lambda k: min(k, 280) if still else k)


@pytest.mark.triggers("pdo.stopped")
def test_changes_that_an_inhibit_time_paces_look_like_a_timer(tmp_path: Path) -> None:
    """Equal frames prove the timer; without any, the value may stand still and send nothing."""
    sure = paced(tmp_path / "own.eds", still=True).told().finding("pdo.stopped")
    assert sure.severity == "error"
    assert "stands still" not in sure.cause
    unsure = paced(tmp_path / "own.eds", still=False).told().finding("pdo.stopped")
    assert unsure.severity == "warning"
    assert "its event timer was not read, and each frame brought another value" in unsure.cause


@pytest.mark.near_miss("pdo.stopped")
def test_a_value_that_stood_still_and_moved_again_sent_no_changes(tmp_path: Path) -> None:
    path = tmp_path / "own.eds"
    again = paced(path, still=False).pdo(60_000, 90_000, 100.3, lambda k: 500 + k)
    assert "pdo.stopped" not in again.told().ids
    proven = paced(path, still=True).pdo(60_000, 90_000, 100.3, lambda k: 500 + k)
    assert proven.told().finding("pdo.stopped").severity == "warning"


@pytest.mark.triggers("pdo.stopped")
def test_a_counter_of_one_pdo_explains_nothing_where_another_stopped_with_it() -> None:
    script = lir(30_000).heartbeat(0, 60_000).sync(0, 60_000, 100).read(-500, 0x2801, 0, 0, size=1)
    finding = script.every(5, 30_000, 200, lambda k: f"285#{k:04X}").told().finding("pdo.stopped")
    assert "TPDO1 (185h)" in finding.text
    assert "TPDO2 (285h)" in finding.text
    assert finding.severity == "error"
    assert "stands still" not in finding.cause


@pytest.mark.triggers("pdo.stopped")
def test_an_rpdo_that_ends_is_laid_to_its_sender() -> None:
    script = Script(None, 5).nmt(-1_000, 1).heartbeat(0, 60_000).read(-500, 0x1400, 1, 0x205)
    script.pdo(3, 60_000, 100, lambda k: k)
    finding = script.every(0, 30_000, 100, "205#0102").told().finding("pdo.stopped")
    assert finding.severity == "warning"
    assert finding.text.startswith("Nobody sent RPDO1 (205h) to node 5 any more from +30.9")
    assert "node 5 only receives it" in finding.cause
