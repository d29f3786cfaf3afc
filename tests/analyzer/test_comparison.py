"""Golden against capture: scripted changes are told, near misses and healthy pairs are not."""

from dataclasses import replace
from random import Random

import numpy as np
import pytest

from syncline_analyzer.comparison import compare
from syncline_analyzer.comparison.chance import at_least, more_often
from syncline_samples.faults import (
    Emcy,
    ErrorFrames,
    LeavesOperational,
    MissedPdos,
    PowerLoss,
    RemapPdo,
    SdoAccess,
    SdoRefused,
    SecondSyncProducer,
    WrongLengthPdos,
)
from syncline_samples.fuzz import random_scenario
from syncline_samples.scenarios import GUIDE, LIFT, PLATFORM, lir_stored_heartbeat
from syncline_samples.sdo_client import read, write
from syncline_samples.world import Delay
from syncline_schemas.batch import Gap
from tests.analyzer.comparison_runs import (
    PATTERN,
    SECONDS,
    against,
    against_frames,
    answering,
    golden,
    golden_case,
    kinds,
    machine,
    serious,
    the_row,
    with_device,
    with_faults,
)
from tests.analyzer.fuzz_case import analyzed, make
from tests.analyzer.whole_run import beats, every, whole


def test_capture_with_itself_has_no_difference() -> None:
    found = compare(golden(), golden())
    assert (found.rows, found.unseen) == ([], [])


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_parts_of_one_healthy_capture_have_no_difference(share: float) -> None:
    case = golden_case()
    cut_ns = case.at(SECONDS * share)
    early, late = (
        analyzed(case.scenario, [case.frames[rows]], case.description)
        for rows in (case.frames.t_ns < cut_ns, case.frames.t_ns >= cut_ns)
    )
    for pair in ((early, late), (late, early), (golden(), late), (early, golden())):
        assert compare(*pair).rows == []


def test_longer_run_of_the_same_machine_has_no_difference() -> None:
    longer = make(machine(seconds=150.0, seed=5)).analysis
    assert compare(golden(), longer).rows == []
    assert compare(longer, golden()).rows == []


@pytest.mark.parametrize("seed", range(300, 312))
def test_random_machine_under_other_chance_has_no_difference(seed: int) -> None:
    scenario = random_scenario(Random(seed), most_faults=0)
    pair = (make(scenario).analysis, make(replace(scenario, seed=scenario.seed + 1)).analysis)
    assert serious(compare(*pair)) == []


def test_missing_node() -> None:
    base = machine()
    found = against(replace(base, devices=base.devices[:2]))
    row = the_row(found, "node.missing", LIFT)
    assert row.severity == "error"
    assert "not one message" in row.text
    assert row.golden_seq
    # What hangs on it is not told once more.
    assert len(found.rows) == 1
    new = compare(make(replace(base, devices=base.devices[:2])).analysis, golden())
    assert the_row(new, "node.new", LIFT).capture_seq


def test_node_is_not_seen_where_nothing_of_it_was_due() -> None:
    case = golden_case()
    frames = case.frames[(case.frames.can_id & 0x7F) != LIFT]
    short = frames[frames.t_ns < case.at(3.0)]
    found = against_frames(short)
    assert kinds(found) == set()
    assert any(row.node == LIFT and row.not_seen_in == "capture" for row in found.unseen)


def test_node_is_not_missing_in_a_gap() -> None:
    """The recorder was blind nearly all the time: what it heard before tells nothing of the rest."""
    case = golden_case()
    frames = case.frames[(case.frames.can_id & 0x7F) != LIFT]
    assert "node.missing" in kinds(against_frames(frames))
    found = against_frames(frames, Gap(case.at(4.0), case.at(44.5), "blind"))
    assert "node.missing" not in kinds(found)
    assert any(row.node == LIFT for row in found.unseen)


@pytest.mark.parametrize("cut_s", [1.0, 1.6, 4.9, 5.05])
def test_capture_that_ends_while_the_machine_starts(cut_s: float) -> None:
    case = golden_case()
    assert serious(against_frames(case.frames[case.frames.t_ns < case.at(cut_s)])) == []


def test_timer_of_whole_syncs_is_no_other_type() -> None:
    """200 ms beside a SYNC of 50 ms: without 1800h the frames alone look like every fourth SYNC."""
    press = lir_stored_heartbeat(3, "lir-ma158k", "press drive", PATTERN, 500)
    case = make(machine(devices=(press,)))
    late = case.frames[case.frames.t_ns >= case.at(15.0)]
    half = analyzed(case.scenario, [late], case.description)
    assert {row.every for row in half.pdos} != {row.every for row in case.analysis.pdos}
    assert compare(case.analysis, half).rows == []


def test_other_device_under_the_same_number() -> None:
    frames = answering(golden_case().frames, LIFT, 0x1018, 2, 0x777)
    assert the_row(against_frames(frames), "node.identity", LIFT).capture == "777h"
    frames = answering(golden_case().frames, LIFT, 0x1018, 4, 0x777)
    assert the_row(against_frames(frames), "node.serial", LIFT).severity == "warning"
    frames = answering(golden_case().frames, LIFT, 0x1018, 3, 0x20000)
    row = the_row(against_frames(frames), "node.firmware", LIFT)
    assert (row.capture_seq, row.golden_seq) != ([], [])


def test_node_in_another_state_at_the_end() -> None:
    found = against(with_faults(LeavesOperational(GUIDE, 30.0, for_s=60.0)))
    row = the_row(found, "node.state", GUIDE)
    assert (row.golden, row.capture) == ("OPERATIONAL", "PRE-OPERATIONAL")


def test_sync_of_another_period() -> None:
    row = the_row(against(machine(sync_us=52_000)), "sync.period")
    assert row.severity == "warning"
    assert row.capture_value == pytest.approx(52_000, abs=10)
    # Synchronous PDOs follow it: they are no differences of their own.
    assert len(against(machine(sync_us=52_000)).rows) == 1
    assert the_row(against(machine(sync_us=30_000)), "sync.period").severity == "error"


def test_sync_clocks_differ_by_less_than_a_hundredth() -> None:
    assert "sync.period" not in kinds(against(machine(sync_us=50_200)))


def test_sync_that_is_gone() -> None:
    found = against(machine(sync_us=0))
    assert the_row(found, "sync.gone").severity == "error"


def test_sync_of_a_stamp_step_is_no_other_period() -> None:
    """10 ms stamps of a 50 ms SYNC: medians may be a step apart."""
    coarse = make(machine(stamp_resolution_ns=10_000_000, sync_us=54_000, seed=3)).analysis
    assert "sync.period" not in kinds(compare(golden(), coarse))


def test_heartbeat_and_timer_of_another_period() -> None:
    def slower(spec):  # type: ignore[no-untyped-def]
        jobs = tuple(
            job for job in spec.jobs if (job.index, job.sub) not in ((0x1017, 0), (0x1800, 5))
        )
        return replace(
            spec, heartbeat_ms=800, jobs=(*jobs, write(0x1017, 0, 800, 2), write(0x1800, 5, 400, 2))
        )

    found = against(with_device(LIFT, slower))
    rows = [row for row in found.rows if row.kind == "period"]
    assert {round(row.capture_value or 0, -4) for row in rows} == {800_000, 400_000}
    objects = {row.object for row in found.rows if row.kind == "object"}
    assert objects == {0x101700, 0x180005}
    assert all(row.golden_seq and row.capture_seq for row in found.rows if row.kind == "object")


def test_scale_of_an_encoder() -> None:
    frames = answering(golden_case().frames, GUIDE, 0x6001, 0, 0x4000)
    row = the_row(against_frames(frames), "angle.setting", GUIDE)
    assert (row.severity, row.capture_value) == ("error", 0x4000)
    assert "Measuring units per revolution" in row.subject


def test_measured_value_that_was_read_is_no_parameter() -> None:
    case = golden_case()
    access = with_faults(SdoAccess(LIFT, 30.0, (read(0x6004),)))
    scenario = replace(access, seed=3)
    pair = make(access), make(scenario)
    moved = answering(pair[1].frames, LIFT, 0x6004, 0, 77)
    other = analyzed(scenario, [moved], case.description)
    told = [row for row in other.objects if (row.node, row.index) == (LIFT, 0x6004)]
    assert told[0].value == 77
    assert compare(pair[0].analysis, other).rows == []


def test_emcy_that_golden_does_not_have() -> None:
    found = against(with_faults(Emcy(GUIDE, 20.0, 0x7320, 0x21, alarms=1, for_s=2.0)))
    # The finding tells of the message: it is not told twice.
    assert kinds(found) == {"finding.new"}
    assert "7320h" in found.rows[0].text
    both = with_faults(Emcy(GUIDE, 20.0, 0x7320, 0x21, alarms=1, for_s=2.0))
    again = compare(make(both).analysis, make(replace(both, seed=9)).analysis)
    assert again.rows == []


def test_sdo_request_that_fails_now() -> None:
    """The master reads what it read before, and the node refuses."""
    case = golden_case()
    data = case.frames.data.copy()
    rows = (case.frames.can_id == 0x580 + LIFT) & (data[:, 1] == 0x01) & (data[:, 2] == 0x60)
    assert np.count_nonzero(rows) == 1
    data[rows] = np.frombuffer(bytes.fromhex("8001600000000208"), np.uint8)
    found = against_frames(replace(case.frames, data=data))
    row = the_row(found, "sdo.new_failure", LIFT)
    assert "08020000h" in row.capture
    assert row.capture_seq


def test_refused_request_that_golden_never_made_is_no_regression() -> None:
    found = against(with_faults(SdoRefused(GUIDE, 20.0)))
    assert "sdo.new_failure" not in kinds(found)
    assert any(row.node == GUIDE and row.not_seen_in == "golden" for row in found.unseen)


def test_mapping_and_length() -> None:
    remapped = with_faults(RemapPdo(LIFT, 20.0, (0x60040020, 0x65000010), pdo=2))
    assert the_row(against(remapped), "pdo.length", LIFT).capture == "4 or 6 bytes"
    swapped = with_faults(RemapPdo(LIFT, 20.0, (0x65000010, 0x60040020), pdo=2))
    found = compare(make(remapped).analysis, make(swapped).analysis)
    mapping = the_row(found, "pdo.mapping", LIFT)
    assert mapping.golden.startswith("6004h:00")
    assert mapping.capture.startswith("6500h:00")
    row = the_row(against(with_faults(WrongLengthPdos(GUIDE, 20.0, dlc=2))), "pdo.length", GUIDE)
    assert row.capture_seq
    assert "2 or" in row.capture


def test_response_that_the_device_makes_slower() -> None:
    slow = with_device(PLATFORM, lambda spec: replace(spec, response=Delay(5_000_000, 300_000)))
    rows = [row for row in against(slow).rows if row.kind == "pdo.response"]
    assert {row.node for row in rows} == {PLATFORM}
    assert all(row.severity == "warning" and "device takes at least" in row.text for row in rows)


def test_response_a_little_slower_is_no_difference() -> None:
    near = with_device(PLATFORM, lambda spec: replace(spec, response=Delay(950_000, 250_000)))
    assert "pdo.response" not in kinds(against(near))


def test_jitter_of_the_sync() -> None:
    found = against(machine(sync_jitter_us=9_000))
    assert "jitter" in kinds(found) or "sync.jitter" in {row.subject for row in found.rows}
    assert kinds(against(machine(sync_jitter_us=300))) == set()


def test_error_frames() -> None:
    found = against(with_faults(ErrorFrames(20.0, count=30)))
    row = the_row(found, "error_frames.more")
    assert row.capture_seq
    assert row.severity == "warning"


def test_missed_pdos_and_lost_node_are_new_findings() -> None:
    found = against(with_faults(MissedPdos(GUIDE, 20.0, count=8), PowerLoss(LIFT, 30.0, 3.0)))
    ids = {row.subject for row in found.rows if row.kind == "finding.new"}
    assert "pdo.missed" in ids
    assert any(subject.startswith("nmt.") for subject in ids)
    severities = [row.severity for row in found.rows]
    assert severities == sorted(severities, key=["error", "warning", "info"].index)


def test_bit_rate() -> None:
    found = against(machine(bitrate=250_000))
    assert the_row(found, "bus.bitrate").severity == "error"


def test_second_sync_producer_is_told() -> None:
    assert serious(against(with_faults(SecondSyncProducer(10.0))))


def test_supervision_that_ends() -> None:
    unwatched = with_device(
        PLATFORM,
        lambda spec: replace(spec, guard_ms=0, jobs=spec.jobs[:-2]),
    )
    row = the_row(against(unwatched), "error_control.gone", PLATFORM)
    assert "guard requests" in row.text


def test_silent_bus_is_not_a_bus_that_was_not_recorded() -> None:
    golden_run = whole(beats(5, 0, 20_000), buses=("can0", "can1"))
    swapped = whole(beats(5, 0, 20_000, bus=1), buses=("can0", "can1"))
    assert "bus.silent" in kinds(compare(golden_run, swapped))
    two = whole([*beats(5, 0, 20_000), *beats(6, 0, 20_000, bus=1)], buses=("can0", "can1"))
    one = whole(beats(5, 0, 20_000), buses=("can0",))
    found = compare(two, one)
    assert found.rows == []
    assert [row.bus for row in found.unseen] == ["can1"]


def test_bus_under_another_name_is_the_same_bus() -> None:
    named = whole(beats(5, 0, 20_000), buses=("PCAN_USBBUS1",))
    assert compare(whole(beats(5, 0, 20_000)), named).rows == []


def test_logs_without_times_are_compared_by_what_needs_none() -> None:
    both = [*beats(5, 0, 20_000), *beats(6, 0, 20_000)]
    found = compare(whole(both, base="none"), whole(beats(5, 0, 20_000), base="none"))
    assert kinds(found) == {"node.missing"}
    assert compare(whole(both), whole(both, base="none")).rows == []


def test_identifier_of_nobody_known() -> None:
    noise = every(0x6F0, 0, 20_000, 50, b"\1")
    found = compare(whole(beats(5, 0, 20_000)), whole(beats(5, 0, 20_000), noise))
    assert the_row(found, "identifier.new").cob_id == 0x6F0
    few = every(0x6F0, 0, 500, 50, b"\1")
    assert compare(whole(beats(5, 0, 20_000)), whole(beats(5, 0, 20_000), few)).rows == []


def test_empty_captures_are_compared() -> None:
    nothing = whole()
    assert compare(nothing, nothing).rows == []
    assert kinds(compare(golden(), nothing)) == {"bus.silent"}
    assert compare(nothing, golden()).rows == []


def test_rates_against_the_binomial_distribution() -> None:
    """14 of 14 events in one of two equal halves happen by chance once in 2 ** 14."""
    assert at_least(14, 14, 0.5) == pytest.approx(2**-14)
    assert at_least(600, 1100, 0.5) == pytest.approx(at_least(500, 900, 0.5), rel=2)
    assert more_often(14, 10, 0, 10)
    assert not more_often(13, 10, 0, 10)
    # Ten times the capture, ten times the events: the same rate.
    assert not more_often(100, 1000, 10, 100)


def test_moved_pdo_whose_settings_were_not_seen_is_not_gone() -> None:
    """122h is TPDO2 of node 1 by 1801h:01, which the master writes at the start only."""
    moved = [
        (20 * 1_000_000, 0, 0x601, 0, 8, bytes.fromhex("2301180122010000")),
        (21 * 1_000_000, 0, 0x581, 0, 8, bytes.fromhex("6001180100000000")),
    ]
    pdo = every(0x122, 100, 40_000, 20, b"\1\2")
    sync = every(0x080, 90, 40_000, 20)
    golden_run = whole(beats(1, 0, 40_000), moved, pdo, sync)
    assert 0x122 in {row.cob_id for row in golden_run.pdos}
    later = whole(beats(1, 0, 40_000), pdo, sync)
    assert 0x122 not in {row.cob_id for row in later.pdos}
    for pair in ((golden_run, later), (later, golden_run)):
        found = compare(*pair)
        assert found.rows == []
        assert any("122h" in row.subject for row in found.unseen)
    silent = whole(beats(1, 0, 40_000), moved, sync)
    assert "pdo.gone" in kinds(compare(golden_run, silent))
