"""Who is not to blame for late answers, and that no more is claimed than the frames prove."""

import numpy as np
import pytest

from syncline_analyzer.results import Analysis
from tests.analyzer.waiting_runs import MS, PERIOD, US, Wish, answers, burst, lateness, run, syncs
from tests.analyzer.whole_run import found, ids

COUNT = 200
BURSTS = [20, 40, 41, 60, 90, 120, 150]
LOW = [0x181, 0x281, 0x381] * 5
EVENTS = {0x181: 0xFE, 0x281: 0xFE, 0x381: 0xFE}


def severities(analysis: Analysis, rule_id: str) -> list[str]:
    return [finding.severity for finding in found(analysis, rule_id)]


def texts(analysis: Analysis, rule_id: str) -> str:
    """What a rule says, as a finding or as part of a story."""
    links = [link.text for f in analysis.findings for link in f.chain if link.id == rule_id]
    return " ".join([*(finding.text for finding in found(analysis, rule_id)), *links])


def reads(numbers: list[int], node: int, after_us: int) -> list[Wish]:
    """An expedited upload of 1000h so long after SYNCs."""
    request, answer = bytes([0x40, 0, 0x10, 0]) + bytes(4), bytes([0x43, 0, 0x10, 0, 1, 0, 0, 0])
    times = [k * PERIOD + after_us * US for k in numbers]
    return [
        *(Wish(t_ns, 0x600 + node, 0, request) for t_ns in times),
        *(Wish(t_ns + 400 * US, 0x580 + node, node, answer) for t_ns in times),
    ]


def test_the_bus_is_not_to_blame_once_the_device_was_late_itself() -> None:
    """The device is slow at three SYNCs, not ready yet when another node starts a weaker frame."""
    usual = answers(COUNT, 0x485, 5)
    slow = [Wish(k * PERIOD + 4 * MS, 0x485, 5) for k in (7, 77, 107)]
    kept = [wish for k, wish in enumerate(usual) if k not in (7, 77, 107)]
    weaker = [Wish(wish.at_ns - MS // 20, 0x4A1, 0x21) for wish in slow]
    bursts = [wish for k in BURSTS for wish in burst(k, LOW, 1)]
    analysis = run(syncs(COUNT), kept, slow, weaker, bursts, types={0x485: 1, **EVENTS})
    row = lateness(analysis, 0x485)
    assert (row.late, row.late_by_device, row.late_by_bus) == (10, 3, 0)
    (late,) = found(analysis, "pdo.late")
    assert " or the device itself" in late.cause
    assert severities(analysis, "pdo.outranked") == ["info"]
    assert "can have waited" in texts(analysis, "pdo.outranked")
    assert "pdo.delaying_node" not in ids(analysis)


def test_few_answers_on_an_idle_bus_do_not_clear_the_device() -> None:
    """The bus is idle at 25 of 200 SYNCs; the device is slow at 15 of the others."""
    busy = [k for k in range(COUNT) if k % 8]
    slow = set(busy[::12][:15])
    ready = answers(COUNT, 0x485, 5)
    late = answers(COUNT, 0x485, 5, after_us=3500)
    sent = [late[k] if k in slow else ready[k] for k in range(COUNT)]
    bursts = [wish for k in busy for wish in burst(k, LOW + LOW[:5], 1)]
    analysis = run(syncs(COUNT), sent, bursts, types={0x485: 1, **EVENTS}, window_us=3000)
    row = lateness(analysis, 0x485)
    assert (row.late, row.late_by_device) == (175, 0)
    assert row.late_by_bus <= 175 - len(slow)


@pytest.mark.near_miss("sdo.delays_pdo")
def test_reading_a_node_does_not_delay_it_where_the_bus_does() -> None:
    """The node is read 4 ms before each burst of another one, without any effect."""
    bursts = [wish for k in BURSTS for wish in burst(k, LOW, 1)]
    sdo = reads([k - 1 for k in BURSTS], 5, 6000)
    analysis = run(syncs(COUNT), answers(COUNT, 0x485, 5), bursts, sdo, types={0x485: 1, **EVENTS})
    row = lateness(analysis, 0x485)
    assert (row.late, row.late_beside_sdo, row.late_by_device_beside_sdo) == (7, 7, 0)
    assert row.late_by_bus == 7
    assert texts(analysis, "sdo.delays_pdo") == ""
    assert severities(analysis, "pdo.delaying_node") == ["warning"]


@pytest.mark.near_miss("pdo.delaying_node")
def test_a_node_with_one_answer_to_sync_is_not_accused() -> None:
    """Its only frame, of a higher identifier, comes first at every fourth SYNC."""
    first = answers(COUNT, 0x1A0, 0x20, after_us=40)[::4]
    analysis = run(
        syncs(COUNT),
        answers(COUNT, 0x185, 5, after_us=100),
        first,
        types={0x185: 1, 0x1A0: 4},
        window_us=500,
    )
    row = lateness(analysis, 0x185)
    assert row.late == 50
    assert row.late_by_bus >= 40
    assert "pdo.delaying_node" not in ids(analysis)
    (late,) = found(analysis, "pdo.late")
    assert "1A0h" in late.cause
    assert "lower identifier" not in late.check_next


def test_the_one_who_makes_answers_late_is_named_though_another_delays_more() -> None:
    """Node 16 holds the answers up by a frame at every second SYNC; they are in time with that."""
    bursts = [wish for k in (21, 61, 121) for wish in burst(k, LOW, 1)]
    harmless = answers(COUNT, 0x190, 0x10, after_us=250)[::2]
    analysis = run(
        syncs(COUNT),
        answers(COUNT, 0x485, 5),
        bursts,
        harmless,
        types={0x485: 1, 0x190: 2, **EVENTS},
    )
    most = next(row for row in analysis.delays if row.cob_id is None)
    assert most.node == 0x10
    (finding,) = found(analysis, "pdo.delaying_node")
    assert (finding.severity, finding.node) == ("warning", 1)
    assert "485h late 3 times" in finding.text
    assert "On average 15.0 of its frames" in finding.cause
    assert "lower identifiers" in finding.cause


@pytest.mark.near_miss("pdo.outranked")
def test_what_answers_sync_on_change_is_not_called_unbound() -> None:
    """Two PDOs of type 0, which nobody told, come after some SYNCs only."""
    rng = np.random.default_rng(6)
    changed = [
        [
            w
            for w, due in zip(answers(COUNT, i, 1, 60 + n), rng.random(COUNT) < 0.35, strict=True)
            if due
        ]
        for n, i in enumerate((0x181, 0x281))
    ]
    analysis = run(
        syncs(COUNT),
        answers(COUNT, 0x485, 5, after_us=100),
        *changed,
        types={0x485: 1},
        window_us=750,
    )
    types = {row.cob_id: row.type_source for row in analysis.pdos}
    assert types[0x181] == "inferred: event-driven"
    assert lateness(analysis, 0x485).late_by_bus
    assert texts(analysis, "pdo.outranked") == ""


def test_events_that_nobody_told_are_a_note_with_what_it_assumes() -> None:
    rng = np.random.default_rng(6)
    extra = [Wish(int(t), 0x181, 1) for t in rng.uniform(0, COUNT * PERIOD, 60)]
    bursts = [wish for k in BURSTS for wish in burst(k, [0x181] * 10, 1)]
    analysis = run(syncs(COUNT), answers(COUNT, 0x485, 5), bursts, extra, types={0x485: 1})
    assert lateness(analysis, 0x485).late_by_bus == 7
    assert "not bound to SYNC" in texts(analysis, "pdo.outranked")
    (story,) = found(analysis, "pdo.delaying_node")
    assert "181h comes from node 1 (by its identifier alone)" in story.assumed
    assert any("181h is" in each and "by its frames alone" in each for each in story.assumed)


def test_late_answers_count_only_where_the_frames_explain_them() -> None:
    """Of ten late answers four came behind SDO requests, six behind events."""
    events = [wish for k in BURSTS[:6] for wish in burst(k, LOW, 1)]
    sdo = [
        Wish(k * PERIOD + 200 * US, 0x601 + n, 0, bytes([0x40, 0, 0x10, 0]) + bytes(4))
        for k in (25, 75, 125, 175)
        for n in range(16)
    ]
    one_each = [
        Wish(k * PERIOD + 200 * US, 0x601, 0, bytes([0x40, 0, 0x10, 0]) + bytes(4))
        for k in BURSTS[:6]
    ]
    analysis = run(
        syncs(2 * COUNT),
        answers(2 * COUNT, 0x6E0, 0x60),
        events,
        sdo,
        one_each,
        node=0x60,
        types=EVENTS,
        moved={0x60: (0x6E0, 1)},
    )
    row = lateness(analysis, 0x6E0)
    assert (row.late, row.late_by_bus) == (10, 10)
    assert "late 4 of 10 times behind SDO traffic" in texts(analysis, "sdo.delays_pdo")
    assert "late 6 of 10 times behind frames" in texts(analysis, "pdo.outranked")


def test_bounds_of_the_device_time_hold_for_stamps_that_come_late() -> None:
    count, after_us = 400, 300
    bursts = [wish for k in range(0, count, 3) for wish in burst(k, LOW, 1)]
    analysis = run(
        syncs(count),
        answers(count, 0x485, 5, after_us),
        bursts,
        types={0x485: 1, **EVENTS},
        window_us=None,
        noise_us=30,
    )
    (timing,) = (row for row in analysis.responses if row.cob_id == 0x485)
    low, high = timing.device_low_us, timing.device_high_us
    missed = (low > after_us + 20) | (high < after_us)
    assert np.count_nonzero(missed) <= 0.02 * len(missed)


def test_that_stamps_are_exact_is_said_where_no_frames_prove_it() -> None:
    """All frames stand far apart; two answers are far later."""
    sent = answers(40, 0x185, 5, after_us=1000)
    late = [Wish(k * PERIOD + 5 * MS, 0x185, 5) for k in (10, 20)]
    kept = [wish for k, wish in enumerate(sent) if k not in (10, 20)]
    few = run(syncs(40), kept, late, types={0x185: 1}, window_us=3000)
    (finding,) = found(few, "pdo.late")
    assert finding.cause.startswith("The device itself")
    assert any("stamps of can0 are exact" in each for each in finding.assumed)
