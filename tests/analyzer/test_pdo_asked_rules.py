"""Rules on the counter of SYNC, on requests and on deadlines, from the frames to the finding."""

import pytest

from syncline_schemas.batch import FrameFlag, Gap
from tests.analyzer.control_runs import MS, Row
from tests.analyzer.whole_run import T0, beats, every, found, ids, whole, write

NODE = 5
TPDO, RPDO = 0x185, 0x205
STOP_MS = 30_000.0


def counting(end: int, stop_ms: float = STOP_MS, start_ms: float = 50.0) -> list[Row]:
    """SYNCs with a counter that ends at a number."""
    rows = every(0x80, start_ms, stop_ms, 10)
    return [
        (t, bus, can_id, flags, 1, bytes([k % end + 1]))
        for k, (t, bus, can_id, flags, _, _) in enumerate(rows)
    ]


def alive() -> list[Row]:
    return [*beats(NODE, 7, STOP_MS), *beats(9, 12, STOP_MS)]


@pytest.mark.triggers("sync.counter_setting")
def test_sync_counts_further_than_the_node_was_told() -> None:
    told = whole(write(1, NODE, 0x1019, 0, 10, 1), counting(20), alive())
    (finding,) = found(told, "sync.counter_setting")
    assert (finding.severity, finding.node) == ("warning", NODE)
    assert "SYNC 080h counts from 1 to 20, but node 5 (10) was told another end" in finding.text


@pytest.mark.triggers("sync.counter_setting")
def test_sync_has_no_counter_though_nodes_expect_one() -> None:
    setup = [*write(1, NODE, 0x1019, 0, 10, 1), *write(5, 9, 0x1019, 0, 10, 1)]
    (finding,) = found(whole(setup, every(0x80, 50, STOP_MS, 10), alive()), "sync.counter_setting")
    assert finding.node is None
    assert "has no counter, but node 5 (10), node 9 (10) were told" in finding.text


@pytest.mark.triggers("sync.counter_setting")
def test_a_counter_that_a_node_does_not_expect() -> None:
    told = whole(write(1, NODE, 0x1019, 0, 0, 1), counting(20), alive())
    (finding,) = found(told, "sync.counter_setting")
    assert "node 5 (0)" in finding.text


@pytest.mark.near_miss("sync.counter_setting")
@pytest.mark.parametrize("end", [10, 240])
def test_a_counter_as_it_was_set(end: int) -> None:
    setup = [*write(1, NODE, 0x1019, 0, end, 1), *write(5, 9, 0x1019, 0, end, 1)]
    assert "sync.counter_setting" not in ids(whole(setup, counting(end), alive()))


@pytest.mark.near_miss("sync.counter_setting")
def test_a_counter_that_was_set_anew_in_the_capture() -> None:
    """First 240, then 10 on both sides; and a setting just before the end proves nothing."""
    setup = [*write(1, NODE, 0x1019, 0, 240, 1), *write(10_000, NODE, 0x1019, 0, 10, 1)]
    frames = [*counting(240, 9_990), *counting(10, STOP_MS, 10_100)]
    assert "sync.counter_setting" not in ids(whole(setup, frames, alive()))
    late = [*write(1, NODE, 0x1019, 0, 10, 1), *write(STOP_MS - 100, NODE, 0x1019, 0, 20, 1)]
    assert "sync.counter_setting" not in ids(whole(late, counting(10), alive()))


def requests(can_id: int, start_ms: float, stop_ms: float, step_ms: float = 500) -> list[Row]:
    rows = every(can_id, start_ms, stop_ms, step_ms)
    return [(t, bus, each, int(FrameFlag.REMOTE), 0, b"") for t, bus, each, *_ in rows]


def bound(*more: Row) -> list[Row]:
    """TPDO1 of the node, sent on remote frames."""
    return [*write(1, NODE, 0x1800, 1, TPDO), *write(4, NODE, 0x1800, 2, 0xFD, 1), *more]


@pytest.mark.triggers("pdo.not_answered")
def test_requests_that_are_sometimes_not_answered() -> None:
    asked = requests(TPDO, 1000, STOP_MS)
    answers = [
        (t + 2 * MS, 0, TPDO, 0, 2, b"\1\2")
        for k, (t, *_) in enumerate(asked)
        if k not in (20, 21, 22, 23)
    ]
    (finding,) = found(whole(bound(), asked, answers, alive()), "pdo.not_answered")
    assert (finding.severity, finding.node, len(finding.evidence)) == ("warning", NODE, 4)
    assert finding.start_ns == T0 + asked[20][0]
    assert "was asked for by 58 remote frames, 4 times in vain" in finding.text


@pytest.mark.triggers("pdo.not_answered")
def test_requests_that_are_never_answered_are_a_setting() -> None:
    (finding,) = found(whole(bound(), requests(TPDO, 1000, STOP_MS), alive()), "pdo.not_answered")
    assert finding.severity == "info"
    assert "and answered none of them" in finding.text


@pytest.mark.near_miss("pdo.not_answered")
def test_requests_that_are_answered() -> None:
    asked = requests(TPDO, 1000, STOP_MS)
    answers = [(t + 2 * MS, 0, TPDO, 0, 2, b"\1\2") for t, *_ in asked]
    assert "pdo.not_answered" not in ids(whole(bound(), asked, answers, alive()))


@pytest.mark.near_miss("pdo.not_answered")
def test_a_gap_or_a_node_that_is_not_operational_leaves_requests_open() -> None:
    asked = requests(TPDO, 1000, STOP_MS)
    answers = [(t + 2 * MS, 0, TPDO, 0, 2, b"\1\2") for t, *_ in asked]
    gap = Gap(T0 + 5_001 * MS, T0 + 9_001 * MS, "test", None, 0)
    rows = [
        row
        for row in [*bound(), *asked, *answers, *alive()]
        if not 5_001 * MS <= row[0] < 9_001 * MS
    ]
    assert "pdo.not_answered" not in ids(whole(rows, gap))
    stopped = [(t, bus, can_id, flags, n, b"\x04") for t, bus, can_id, flags, n, _ in alive()]
    assert "pdo.not_answered" not in ids(whole(bound(), requests(TPDO, 1000, STOP_MS), stopped))


def watched(deadline_ms: int = 100) -> list[Row]:
    rows = [*write(1, NODE, 0x1400, 1, RPDO), *write(4, NODE, 0x1400, 2, 0xFF, 1)]
    return [*rows, *write(7, NODE, 0x1400, 5, deadline_ms, 2)]


def sent(step_ms: float = 80) -> list[Row]:
    """The RPDO, with a pause of 400 ms."""
    return [
        *every(RPDO, 50, 10_000, step_ms, b"\1"),
        *every(RPDO, 10_400, STOP_MS, step_ms, b"\1"),
    ]


@pytest.mark.triggers("pdo.deadline")
def test_an_rpdo_later_than_its_node_allows() -> None:
    (finding,) = found(whole(watched(), sent(), alive()), "pdo.deadline")
    assert (finding.severity, finding.node) == ("info", NODE)
    assert "was to come every 100 ms at most (140xh:5) and took longer 1 time" in finding.text
    emcy = [(10_300 * MS, 0, 0x80 + NODE, 0, 8, bytes([0x50, 0x82, 0x11, 0, 0, 0, 0, 0]))]
    told = whole(watched(), sent(), alive(), emcy)
    every_id = {finding.id for finding in told.findings} | {
        link.id for finding in told.findings for link in finding.chain
    }
    assert "pdo.deadline" in every_id


@pytest.mark.near_miss("pdo.deadline")
def test_an_rpdo_within_its_deadline_or_of_a_node_that_waits() -> None:
    assert "pdo.deadline" not in ids(whole(watched(500), sent(), alive()))
    assert "pdo.deadline" not in ids(
        whole(watched(100), every(RPDO, 50, STOP_MS, 104, b"\1"), alive())
    )
    stopped = [(t, bus, can_id, flags, n, b"\x04") for t, bus, can_id, flags, n, _ in alive()]
    assert "pdo.deadline" not in ids(whole(watched(), sent(), stopped))
