"""What makes synchronous PDOs late: the bus, its identifiers, one node, SDO traffic, the device."""

from dataclasses import replace

import pytest

from syncline_analyzer.results import Analysis
from tests.analyzer.waiting_runs import (
    MS,
    PERIOD,
    US,
    Wish,
    answers,
    burst,
    lateness,
    run,
    syncs,
)
from tests.analyzer.whole_run import found, ids, severe

COUNT = 200
MBIT = 1_000_000
BURSTS = [20, 40, 41, 60, 90, 120, 150]
LOW = [0x181, 0x281, 0x381] * 5
"""15 frames of node 1: 3.8 ms on the wire."""
EVENTS = {0x181: 0xFE, 0x281: 0xFE, 0x381: 0xFE, 0x481: 0xFE}


def bursts(can_ids: list[int] | None = None, node: int = 1) -> list[Wish]:
    return [wish for k in BURSTS for wish in burst(k, can_ids or LOW, node)]


def told(analysis: Analysis, rule_id: str) -> set[str]:
    """Severities of all findings and links of a rule."""
    return {f.severity for f in found(analysis, rule_id)} | (
        {"link"}
        if any(link.id == rule_id for f in analysis.findings for link in f.chain)
        else set()
    )


@pytest.mark.triggers("pdo.outranked", "pdo.delaying_node")
def test_events_with_lower_identifiers_make_an_answer_late() -> None:
    analysis = run(syncs(COUNT), answers(COUNT, 0x485, 5), bursts(), types={0x485: 1, **EVENTS})
    row = lateness(analysis, 0x485)
    assert (row.late, row.late_by_bus, row.late_by_device) == (7, 7, 0)
    (story,) = (f for f in analysis.findings if f.severity == "warning")
    assert (story.id, story.node) == ("pdo.delaying_node", 1)
    assert [link.id for link in story.chain] == ["pdo.late", "pdo.outranked"]
    late, outranked = story.chain
    assert (outranked.node, late.node) == (5, 5)
    assert "late 7 times" in outranked.text
    assert "TPDO1 of node 1 (181h)" in outranked.text
    assert "485h late" in story.text


@pytest.mark.near_miss("pdo.outranked")
def test_events_with_higher_identifiers_hold_back_one_frame_at_most() -> None:
    high = [0x4A1, 0x4A2, 0x4A3] * 5
    types = {0x485: 1, 0x4A1: 0xFE, 0x4A2: 0xFE, 0x4A3: 0xFE}
    analysis = run(syncs(COUNT), answers(COUNT, 0x485, 5), bursts(high, 0x21), types=types)
    row = lateness(analysis, 0x485)
    assert (row.waited, row.late) == (7, 0)
    assert ids(analysis).isdisjoint({"pdo.outranked", "pdo.delaying_node", "pdo.late"})


@pytest.mark.near_miss("pdo.outranked")
def test_late_answers_of_a_slow_device_are_its_own() -> None:
    """The bursts come at other SYNCs; the device is late without them."""
    slow = [Wish(k * PERIOD + 4 * MS, 0x485, 5) for k in range(7, COUNT, 20)]
    usual = [w for k, w in enumerate(answers(COUNT, 0x485, 5)) if k % 20 != 7]
    analysis = run(syncs(COUNT), usual, slow, bursts(), types={0x485: 1, **EVENTS}, window_us=3500)
    row = lateness(analysis, 0x485)
    assert row.late_by_device == 10
    (late,) = (f for f in analysis.findings if f.id == "pdo.late")
    assert late.cause.startswith("The device itself")
    assert row.late_by_bus == 0


def test_without_a_window_long_waits_are_a_note() -> None:
    analysis = run(
        syncs(COUNT),
        answers(COUNT, 0x485, 5),
        bursts(),
        types={0x485: 1, **EVENTS},
        window_us=None,
    )
    assert told(analysis, "pdo.outranked") == {"info"}
    assert severe(analysis) == []


@pytest.mark.near_miss("pdo.delaying_node")
def test_no_node_stands_out_where_many_wait_for_many() -> None:
    """Eight nodes answer each SYNC at once, one after the other."""
    all_of_them = [answers(COUNT, 0x180 + node, node) for node in range(1, 9)]
    types = {0x180 + node: 1 for node in range(1, 9)}
    analysis = run(syncs(COUNT), *all_of_them, types=types, node=8, window_us=5000)
    assert lateness(analysis, 0x188).waited > COUNT / 2
    assert len([row for row in analysis.delays if row.cob_id is None]) >= 7
    assert ids(analysis).isdisjoint({"pdo.outranked", "pdo.delaying_node"})
    assert severe(analysis) == []


def sdo_read(at_ns: int, node: int, answer_ns: int) -> list[Wish]:
    """An expedited upload of 1000h."""
    request = bytes([0x40, 0, 0x10, 0]) + bytes(4)
    answer = bytes([0x43, 0, 0x10, 0, 0x91, 1, 0, 0])
    return [
        Wish(at_ns, 0x600 + node, 0, request),
        Wish(at_ns + answer_ns, 0x580 + node, node, answer),
    ]


def beside_sdo(slow_us: int) -> list[list[Wish]]:
    """Every eighth SYNC an SDO request comes right behind it; then the answer takes longer."""
    busy = set(range(0, COUNT, 8))
    usual = answers(COUNT, 0x185, 5)
    slow = answers(COUNT, 0x185, 5, after_us=slow_us)
    chosen = [slow[k] if k in busy else usual[k] for k in range(COUNT)]
    reads = [sdo_read(k * PERIOD + 100 * US, 5, 400 * US) for k in sorted(busy)]
    return [chosen, *reads]


@pytest.mark.triggers("sdo.delays_pdo")
def test_a_device_that_answers_sdo_first_is_late_beside_transfers() -> None:
    analysis = run(syncs(COUNT), *beside_sdo(3000), types={0x185: 1})
    row = lateness(analysis, 0x185)
    assert (row.late, row.late_by_device, row.late_beside_sdo) == (25, 25, 25)
    (finding,) = found(analysis, "sdo.delays_pdo")
    assert (finding.severity, finding.node) == ("warning", 5)
    assert [link.id for link in finding.chain] == ["pdo.late"]
    assert "25 of 25 answers that the device itself made late" in finding.text


@pytest.mark.near_miss("sdo.delays_pdo")
def test_transfers_that_change_nothing_are_not_told() -> None:
    analysis = run(syncs(COUNT), *beside_sdo(400), types={0x185: 1})
    assert lateness(analysis, 0x185).beside_sdo >= 25
    assert "sdo.delays_pdo" not in ids(analysis)
    assert severe(analysis) == []


def test_sdo_ahead_of_a_pdo_with_a_higher_identifier_makes_it_late() -> None:
    """The PDO was moved to 6E0h; a program reads in a burst from 14 nodes at once."""
    reads = [
        Wish(k * PERIOD + 200 * US, 0x601 + n, 0, bytes([0x40, 0, 0x10, 0]) + bytes(4))
        for k in BURSTS
        for n in range(16)
    ]
    pdo = answers(COUNT, 0x6E0, 0x60)
    analysis = run(syncs(COUNT), pdo, reads, node=0x60, types={}, moved={0x60: (0x6E0, 1)})
    row = lateness(analysis, 0x6E0)
    assert row.late_by_bus == len(BURSTS)
    severities = told(analysis, "sdo.delays_pdo")
    assert severities == {"warning"}


def test_a_missed_answer_is_the_devices_where_the_bus_was_free_for_it() -> None:
    without = [w for k, w in enumerate(answers(COUNT, 0x485, 5)) if k not in (50, 51, 120)]
    analysis = run(syncs(COUNT), without, types={0x485: 1})
    row = lateness(analysis, 0x485)
    assert (row.missed, row.missed_by_device, row.missed_by_bus) == (3, 3, 0)
    missed = found(analysis, "pdo.missed")
    assert missed
    assert all("The device did not have it ready" in each.cause for each in missed)


def test_a_missed_answer_is_the_buss_where_it_never_became_free() -> None:
    """40 frames take all of the 10 ms: the answer to one SYNC comes after the next one."""
    frames = [0x181, 0x281, 0x381, 0x481] * 10
    flood = [wish for k in (50, 120) for wish in burst(k, frames, 1, after_us=10)]
    analysis = run(
        syncs(COUNT), answers(COUNT, 0x485, 5), flood, types={0x485: 1, **EVENTS}, window_us=None
    )
    row = lateness(analysis, 0x485)
    assert row.missed_by_device == 0
    assert row.missed_by_bus == row.missed == 2
    (missed,) = found(analysis, "pdo.missed")
    assert "The bus was not free for it until the next SYNC" in missed.cause


def test_without_a_bit_rate_and_with_coarse_stamps_nothing_is_told() -> None:
    frames = [syncs(COUNT), answers(COUNT, 0x485, 5), bursts()]
    types = {0x485: 1, **EVENTS}
    for analysis in (
        run(*frames, types=types, bitrate=None, step_ns=1_000_000),
        run(*frames, types=types, step_ns=1_000_000),
    ):
        tables = [*analysis.delays, *analysis.waits, *analysis.lateness]
        assert tables == []
        assert all(row.waiting_us is None for row in analysis.pdos)
        assert ids(analysis).isdisjoint({"pdo.outranked", "pdo.delaying_node"})


def test_a_bit_rate_that_the_frames_rule_out_tells_nothing() -> None:
    """Told is 1 Mbit/s: at that rate there would be pauses between frames that had none."""
    frames = [
        wish for k in range(COUNT) for wish in burst(k, [0x181, 0x281, 0x381], 1, after_us=600)
    ]
    varied = [replace(w, data=bytes(range(k % 9))) for k, w in enumerate(frames)]
    analysis = run(syncs(COUNT), answers(COUNT, 0x485, 5), varied, types={0x485: 1}, bitrate=MBIT)
    assert "bus.bitrate_contradicted" in ids(analysis)
    assert analysis.lateness == []


def test_what_only_identifiers_and_types_of_a_file_tell_is_said() -> None:
    """Nobody wrote 180xh:1 of node 1; its events are PDOs of node 1 by their identifiers alone."""
    analysis = run(syncs(COUNT), answers(COUNT, 0x485, 5), bursts(), types={0x485: 1})
    (story,) = found(analysis, "pdo.delaying_node")
    assert "181h comes from node 1 (by its identifier alone)" in story.assumed
    (outranked,) = (link for link in story.chain if link.id == "pdo.outranked")
    assert "TPDO1 of node 1 (181h, by its identifier alone)" in outranked.text
