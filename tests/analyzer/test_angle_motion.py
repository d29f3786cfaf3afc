"""Steps, spikes, twin encoders and noise: what triggers each rule, and what comes near."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_analyzer.results import Analysis, ShaftRow
from syncline_schemas.batch import Gap
from syncline_schemas.description import BusDescription
from tests.analyzer.control_runs import MS, Row
from tests.analyzer.traps.script import Script
from tests.analyzer.whole_run import beats, found, severe, whole, write

TURN = 8192
TOTAL = TURN * 4096
Motion = Callable[[Any], Any]
"""Turns of a shaft at times [s]."""


def resting(t_s: Any) -> Any:
    return np.full(len(t_s), 100.25)


def turning(t_s: Any, rpm: float = 30.0) -> Any:
    return 100 + rpm / 60 * t_s


def swinging(t_s: Any) -> Any:
    """To and fro by two turns, and rests in between."""
    return 100 + 2 * np.clip(np.sin(t_s / 4), -0.8, 0.8)


def encoder(
    motion: Motion,
    *,
    node: int = 5,
    seconds: float = 20.0,
    period_ms: float = 20.0,
    pdo: int = 0x180,
    per_turn: int = TURN,
    total: int = TOTAL,
    lead_ms: float = 0.0,
    begin_ms: float = 20.0,
) -> list[Row]:
    """A TPDO and heartbeats; `lead_ms` is how old a value is when it is sent."""
    t_ms = np.arange(begin_ms, seconds * 1000, period_ms)
    counts = np.round(motion((t_ms - lead_ms) / 1000) * per_turn).astype(int) % total
    return [
        (round(t * MS), 0, pdo + node, 0, 4, int(c).to_bytes(4, "little"))
        for t, c in zip(t_ms, counts, strict=True)
    ] + beats(node, 10, seconds * 1000)


def described(*nodes: int, device: str = "lir-ma158k", more: str = "") -> BusDescription:
    objects = {
        "lir-ma158k": f'"6001" = {TURN}\n"6002" = {TOTAL}\n',
        "haomiao-38": '"6000" = 0\n"6003" = 819200\n',
    }
    text = "".join(
        f'[node.{node}]\ndevice = "{device}"\n[node.{node}.objects]\n{objects[device]}'
        for node in nodes
    )
    return BusDescription.loads(text + more)


def run(*parts: list[Row] | Gap, description: BusDescription | None = None) -> Analysis:
    return whole(*parts, description=description or described(5))


def moved(rows: list[Row], from_ms: float, by: int, until_ms: float = 1e9) -> list[Row]:
    """The same with other counts for a while."""
    return [
        (*row[:5], ((int.from_bytes(row[5], "little") + by) % TOTAL).to_bytes(4, "little"))
        if row[2] < 0x700 and from_ms <= row[0] / MS < until_ms
        else row
        for row in rows
    ]


@pytest.mark.triggers("angle.step")
@pytest.mark.parametrize("motion", [resting, turning], ids=["at rest", "turning"])
def test_a_position_that_is_moved_at_once_is_told(motion: Motion) -> None:
    """Half a turn in 20 ms is 1500 rpm, which a LIR may turn: no jump by its limit."""
    analysis = run(moved(encoder(motion), 10_010, TURN // 2))
    assert found(analysis, "angle.jump") == []
    (finding,) = found(analysis, "angle.step")
    assert (finding.severity, finding.node) == ("warning", 5)
    assert abs(finding.start_ns - analysis.capture.first_ns - 10_010 * MS) < 30 * MS
    assert "without a command on the bus" in finding.text


@pytest.mark.triggers("angle.step")
def test_two_pdos_that_show_one_step_tell_it_once() -> None:
    both = encoder(turning) + encoder(turning, pdo=0x280, begin_ms=27.0)
    (finding,) = found(run(moved(both, 10_010, TURN // 2)), "angle.step")
    assert "steps)" not in finding.text


@pytest.mark.near_miss("angle.step")
def test_a_hard_start_and_stop_is_no_step() -> None:
    """A servo: half a turn in 100 ms and back, 0 to 600 rpm within 50 ms."""

    def servo(t_s: Any) -> Any:
        phase = np.clip((t_s % 1.0) / 0.1, 0, 1)
        there = np.where(phase < 0.5, 2 * phase**2, 1 - 2 * (1 - phase) ** 2)
        return 100 + 0.5 * (np.floor(t_s) + there)

    for period_ms in (2.0, 10.0, 20.0, 50.0, 100.0, 250.0):
        analysis = run(encoder(servo, period_ms=period_ms))
        assert found(analysis, "angle.step") == found(analysis, "angle.spike") == []


@pytest.mark.near_miss("angle.jump")
@pytest.mark.near_miss("angle.step")
@pytest.mark.parametrize("measured_ms", [10, 50, 100])
def test_a_device_that_measures_less_often_than_it_sends_makes_no_steps(measured_ms: int) -> None:
    def held(t_s: Any) -> Any:
        return running_up(1500)(np.floor(t_s * 1000 / measured_ms) * measured_ms / 1000)

    for period_ms in (2.0, 5.0, 10.0):
        assert severe(run(encoder(held, period_ms=period_ms, seconds=10.0))) == []


@pytest.mark.triggers("angle.jump")
def test_an_encoder_that_jumps_again_and_again_at_rest_is_told() -> None:
    rows = encoder(resting)
    for second in range(2, 18, 2):
        rows = moved(rows, second * 1000 + 5, 700 * TURN)
    assert [f.id for f in run(rows).findings if f.severity != "info"] == ["angle.jump"] * 1


@pytest.mark.parametrize("batch", [31, 500])
def test_batches_do_not_change_the_steps(batch: int) -> None:
    rows = moved(encoder(turning), 10_010, TURN // 2)
    once = whole(rows, description=described(5), batch=batch)
    assert once.trace_events == run(rows).trace_events


@pytest.mark.near_miss("angle.step")
def test_a_preset_by_sdo_is_no_step() -> None:
    rows = moved(encoder(resting), 10_010, TURN // 2)
    preset = write(10_000, 5, 0x6003, 0, round(100.75 * TURN))
    analysis = run(rows, preset)
    assert severe(analysis) == []
    assert [e.text for e in analysis.trace_events if e.kind == "cut"] == ["preset (6003h written)"]


@pytest.mark.near_miss("angle.step")
def test_a_gap_or_lost_frames_are_no_step() -> None:
    rows = moved(encoder(turning), 10_010, TURN // 2)
    gap = Gap(9_990 * MS, 10_030 * MS, "adapter lost")
    rows = [row for row in rows if not 9_990 * MS <= row[0] < 10_030 * MS]
    assert found(run(rows, gap), "angle.step") == []


@pytest.mark.triggers("angle.spike")
def test_a_single_sample_far_off_is_told() -> None:
    rows = moved(encoder(turning), 10_010, TURN // 2, 10_025)
    analysis = run(moved(rows, 14_010, TURN // 2, 14_025))
    (finding,) = found(analysis, "angle.spike")
    assert "2 such samples" in finding.text
    assert found(analysis, "angle.step") == []


@pytest.mark.near_miss("angle.spike")
def test_vibration_and_noise_are_no_spikes() -> None:
    rng = np.random.default_rng(3)

    def noisy(t_s: Any) -> Any:
        return 100 + rng.normal(0, 0.01, len(t_s)) + 0.02 * np.sin(300 * t_s)

    assert found(run(encoder(noisy)), "angle.spike") == []


@pytest.mark.triggers("angle.preset_by_wire")
@pytest.mark.parametrize("turns", [0.6, 3.0])
@pytest.mark.parametrize("period_ms", [20.0, 100.0])
def test_the_set_input_is_known_also_where_it_moves_the_position_little(
    turns: float, period_ms: float
) -> None:
    rows = encoder(lambda t_s: np.full(len(t_s), 100 + turns), period_ms=period_ms)
    analysis = run(
        moved(rows, 10_010, -round(turns * TURN)), description=described(5, device="haomiao-38")
    )
    (finding,) = found(analysis, "angle.preset_by_wire")
    assert "preset value 819200" in finding.text
    assert found(analysis, "angle.jump") == found(analysis, "angle.step") == []


@pytest.mark.near_miss("angle.preset_by_wire")
def test_a_move_to_the_preset_value_is_no_wire() -> None:
    def homing(t_s: Any) -> Any:
        return 100 + 0.6 * np.clip((10.5 - t_s) / 0.4, 0, 1)

    for period_ms in (20.0, 100.0):
        analysis = run(
            encoder(homing, period_ms=period_ms), description=described(5, device="haomiao-38")
        )
        assert severe(analysis) == []


def running_up(rpm: float) -> Motion:
    """From standstill to a speed in 4 s, and on."""

    def motion(t_s: Any) -> Any:
        return 100 + rpm / 60 * np.where(t_s < 4, t_s**2 / 8, t_s - 2)

    return motion


@pytest.mark.triggers("angle.overspeed")
@pytest.mark.parametrize("batch", [97, 100_000])
def test_a_shaft_that_turns_too_fast_is_no_jump(batch: int) -> None:
    rows = encoder(running_up(3600), period_ms=5.0) + encoder(
        running_up(3600), pdo=0x280, period_ms=20.0, begin_ms=27.0
    )
    analysis = whole(rows, description=described(5), batch=batch)
    (finding,) = found(analysis, "angle.overspeed")
    assert found(analysis, "angle.jump") == found(analysis, "angle.step") == []
    assert finding.start_ns - analysis.capture.first_ns == pytest.approx(3.33e9, rel=0.1)
    assert "up to 3600 rpm within 16." in finding.text
    assert analysis.traces[0].speed_max_rpm == pytest.approx(3600, rel=0.01)


@pytest.mark.triggers("angle.overspeed")
@pytest.mark.parametrize(("rpm", "beyond"), [(9000, False), (12_000, True)])
def test_the_mechanical_limit_is_told_where_it_was_passed(rpm: float, beyond: bool) -> None:
    """Sheet skbis-lir-da158, 8: 3000 rpm working, 10 000 rpm mechanical."""
    (finding,) = found(run(encoder(running_up(rpm), period_ms=2.0)), "angle.overspeed")
    assert ("mechanical limit is 10000 rpm" in finding.text) is beyond


@pytest.mark.triggers("angle.overspeed")
@pytest.mark.parametrize(("period_ms", "rpm"), [(1.0, 3500), (2.0, 4000), (5.0, 3400)])
def test_a_fast_pdo_shows_steady_turning_beyond_the_limit(period_ms: float, rpm: float) -> None:
    """A slack of 1 ms for every single span would hide it for good."""
    rows = encoder(lambda t_s: turning(t_s, rpm), period_ms=period_ms, seconds=6.0)
    (finding,) = found(run(rows), "angle.overspeed")
    assert f"up to {rpm:.0f} rpm within 5.9" in finding.text


@pytest.mark.near_miss("angle.overspeed")
@pytest.mark.parametrize("late_us", [0, 300, 2000])
def test_stamps_that_are_late_are_no_overspeed(late_us: int) -> None:
    """2900 rpm every 1 ms; some stamps come late, one by one and in bundles of 50 ms."""
    rng = np.random.default_rng(11)
    rows = encoder(lambda t_s: turning(t_s, 2900), period_ms=1.0, seconds=6.0)
    late = [(row[0] + int(rng.integers(0, late_us + 1)) * 1000, *row[1:]) for row in rows]
    assert found(run(sorted(late)), "angle.overspeed") == []
    bundled = [(-(-row[0] // (50 * MS)) * 50 * MS + k % 50, *row[1:]) for k, row in enumerate(rows)]
    assert found(run(sorted(bundled)), "angle.overspeed") == []


@pytest.mark.near_miss("angle.overspeed")
def test_a_jump_and_a_shaft_at_its_limit_are_no_overspeed() -> None:
    jump = moved(encoder(turning), 10_010, 700 * TURN)
    analysis = run(jump)
    assert [f.id for f in analysis.findings if f.severity != "info"] == ["angle.jump"]
    assert severe(run(encoder(running_up(2980), period_ms=5.0))) == []


@pytest.mark.triggers("angle.sampled_too_seldom")
def test_a_single_turn_encoder_every_515_ms_is_told_to_be_too_slow() -> None:
    lir = BusDescription.loads(
        '[node.1]\ndevice = "lir-da158"\n[node.1.objects]\n"6001" = 131072\n"6002" = 131072\n'
    )
    fast = lambda t_s: turning(t_s, 40.0)
    slow = encoder(fast, node=1, period_ms=515, per_turn=131072, total=131072)
    (finding,) = found(run(slow, description=lir), "angle.sampled_too_seldom")
    assert "58.25 rpm" in finding.text
    assert finding.severity == "info"


@pytest.mark.triggers("angle.sampled_too_seldom")
@pytest.mark.parametrize("seldom_first", [False, True])
def test_the_time_of_an_ambiguous_trace_is_that_of_its_rare_samples(seldom_first: bool) -> None:
    """30 rpm every 20 ms, and every 515 ms after a reset, or the other way about."""
    spacings = (515, 20) if seldom_first else (20, 515)
    script = Script("lir-da158a", 5).read(-90, 0x6001, 0, 131_072).read(-80, 0x6002, 0, 131_072)
    for start_ms, period in zip((0, 25_000), spacings, strict=True):
        counts = [round(k * period * 131_072 / 2000) % 131_072 for k in range(1000)]
        script.nmt(start_ms - 10, 1)
        script.pdo(start_ms, start_ms + 20_000, period, counts.__getitem__)
    told = script.nmt(20_000, 0x81).boot(20_400).told()
    finding = told.finding("angle.sampled_too_seldom")
    assert "samples every 515 ms" in finding.text
    assert "58.25 rpm" in finding.text
    times = (finding.start_ns, finding.end_ns)
    start, end = ((t_ns - told.analysis.capture.begin_ns) / 1e9 for t_ns in times)
    begins, ends = (0.0, 20.0) if seldom_first else (25.0, 45.0)
    assert begins <= start - 0.09 <= begins + 1.1
    assert ends - 1.1 <= end - 0.09 <= ends


@pytest.mark.near_miss("angle.sampled_too_seldom")
def test_a_second_pdo_that_comes_often_or_a_slow_shaft_is_not_told() -> None:
    lir = BusDescription.loads(
        '[node.1]\ndevice = "lir-da158"\n[node.1.objects]\n"6001" = 131072\n"6002" = 131072\n'
    )
    kind: dict[str, Any] = {"node": 1, "per_turn": 131072, "total": 131072}
    slow = encoder(turning, period_ms=515, **kind)
    often = encoder(turning, period_ms=5, pdo=0x280, **kind)
    still = encoder(resting, period_ms=515, **kind)
    calm = encoder(lambda t_s: turning(t_s, 25.0), period_ms=515, **kind)
    assert found(run(slow, often, description=lir), "angle.sampled_too_seldom") == []
    assert found(run(still, description=lir), "angle.sampled_too_seldom") == []
    assert found(run(calm, description=lir), "angle.sampled_too_seldom") == []


@pytest.mark.triggers("angle.noise")
def test_a_value_that_scatters_at_rest_is_told() -> None:
    rng = np.random.default_rng(3)

    def noisy(t_s: Any) -> Any:
        return 100 + rng.normal(0, 1 / 360, len(t_s))

    analysis = run(encoder(noisy))
    (finding,) = found(analysis, "angle.noise")
    assert finding.severity == "info"
    assert analysis.traces[0].noise_deg == pytest.approx(1.0, rel=0.1)


@pytest.mark.near_miss("angle.noise")
def test_a_frozen_pdo_beside_a_turning_one_is_no_noise() -> None:
    rows = encoder(turning, period_ms=10.0)
    stuck = encoder(lambda t_s: turning(np.minimum(t_s, 8.0)), pdo=0x280, begin_ms=24.3)
    analysis = run(rows, stuck)
    assert [f.id for f in analysis.findings if f.severity != "info"] == ["angle.frozen"]
    assert found(analysis, "angle.noise") == []


@pytest.mark.near_miss("angle.noise")
def test_a_few_counts_and_motion_are_no_noise() -> None:
    rng = np.random.default_rng(3)

    def flicker(t_s: Any) -> Any:
        return swinging(t_s) + rng.integers(-1, 2, len(t_s)) / TURN

    for motion in (flicker, turning, swinging):
        assert found(run(encoder(motion)), "angle.noise") == []


TWINS = '[node.6]\ndevice = "lir-ma158k"\nsame_shaft_as = 5\n{more}[node.6.objects]\n' + (
    f'"6001" = {TURN}\n"6002" = {TOTAL}\n'
)


def twins(
    one: list[Row], two: list[Row], *more: list[Row] | Gap, line: str = ""
) -> tuple[Analysis, ShaftRow]:
    analysis = run(one, two, *more, description=described(5, more=TWINS.format(more=line)))
    (shaft,) = analysis.shafts
    return analysis, shaft


def other(motion: Motion = swinging, **changes: Any) -> list[Row]:
    plain: dict[str, Any] = {"node": 6, "period_ms": 25.0, "begin_ms": 31.0, "seconds": 60.0}
    return encoder(motion, **plain | changes)


@pytest.mark.triggers("angle.shafts_parted")
def test_a_coupling_that_slips_is_told() -> None:
    analysis, shaft = twins(
        encoder(swinging, seconds=60.0), moved(other(), 30_000, round(TURN * 12 / 360))
    )
    assert (shaft.bus, shaft.node, shaft.other, shaft.ratio) == ("can0", 6, 5, 1.0)
    assert shaft.parted == 1
    assert shaft.parted_deg == pytest.approx(12, abs=0.3)
    (finding,) = found(analysis, "angle.shafts_parted")
    assert (finding.severity, finding.node) == ("error", 6)
    assert abs(finding.start_ns - analysis.capture.first_ns - 30_000 * MS) < 3_000 * MS
    assert "12 deg further ahead" in finding.text


def travelling(seconds: list[float], revs: list[float]) -> Motion:
    """Turns with speeds [rev/s] that change evenly between moments."""
    clock = np.arange(0, 60, 0.001)
    turns = 100 + np.cumsum(np.interp(clock, seconds, revs)) * 0.001
    return lambda t_s: np.interp(t_s, clock, turns)


def slipping(rpm: float, slip_deg: float, stop_s: float = 1e9) -> Motion:
    """Geared 2.5 to 1 the other way round; slips from 20 s on by 10 deg/s."""

    def motion(t_s: Any) -> Any:
        slip = np.clip((t_s - 20) * 10, 0, slip_deg) / 360
        return 1000 - 2.5 * rpm / 60 * np.minimum(t_s, stop_s) + slip

    return motion


@pytest.mark.triggers("angle.shafts_parted")
@pytest.mark.parametrize(
    ("rpm", "slip_deg", "stop_s"),
    [(60.0, 30.0, 30.0), (60.0, 30.0, 1e9), (18.0, 15.0, 1e9), (18.0, 15.0, 30.0)],
)
def test_a_slip_while_turning_is_told(rpm: float, slip_deg: float, stop_s: float) -> None:
    """A lag that does not change excuses no step at an even speed, nor what is left at rest."""
    one = encoder(lambda t_s: 100 + rpm / 60 * np.minimum(t_s, stop_s), seconds=45.0)
    two = other(slipping(rpm, slip_deg, stop_s), seconds=45.0)
    analysis, shaft = twins(one, two, line="ratio = -2.5\n")
    (finding,) = found(analysis, "angle.shafts_parted")
    assert finding.severity == "error"
    assert shaft.parted_ns is not None
    assert abs(shaft.parted_ns - analysis.capture.first_ns - 20_500 * MS) < 1_000 * MS
    assert shaft.shifted_deg == pytest.approx(slip_deg, abs=3)


@pytest.mark.triggers("angle.shafts_parted")
def test_a_slip_while_it_speeds_up_is_told_once_it_stands_again() -> None:
    """At 900 deg/s a lag of 50 ms may be 45 deg; at rest it is none."""

    trip = travelling([0, 10, 12, 18, 20, 99], [0, 0, 2.5, 2.5, 0, 0])
    slipped = lambda t_s: trip(t_s) + np.clip((t_s - 10.5), 0, 1) * 20 / 360
    analysis, shaft = twins(encoder(trip, seconds=45.0), other(slipped, seconds=45.0))
    assert shaft.parted >= 1
    assert shaft.shifted_deg == pytest.approx(20, abs=3)
    assert len(found(analysis, "angle.shafts_parted")) == 1


@pytest.mark.near_miss("angle.shafts_parted")
@pytest.mark.parametrize("lag_s", [0.03, -0.03])
def test_a_lag_is_no_slip_at_any_speed(lag_s: float) -> None:
    trip = travelling([0, 10, 12, 18, 20, 30, 31, 99], [0, 0, 2.5, 2.5, -1, -1, 0, 0])
    analysis, shaft = twins(
        encoder(trip, seconds=45.0), other(lambda t_s: trip(t_s - lag_s), seconds=45.0)
    )
    assert (shaft.parted, severe(analysis)) == (0, [])


@pytest.mark.triggers("angle.shafts_parted")
def test_a_wrong_ratio_is_told_as_such() -> None:
    analysis, shaft = twins(
        encoder(turning, seconds=60.0),
        other(lambda t_s: 7 + 2 * turning(t_s)),
        line="ratio = -2\n",
    )
    (finding,) = found(analysis, "angle.shafts_parted")
    assert shaft.parted >= 5
    assert finding.severity == "warning"
    assert "ratio" in finding.cause


@pytest.mark.near_miss("angle.shafts_parted")
@pytest.mark.parametrize(
    ("motion", "line"),
    [
        (lambda t_s: swinging(t_s) + 1, ""),
        (lambda t_s: 5 - swinging(t_s), "ratio = -1\n"),
        (lambda t_s: 2.5 * swinging(t_s) - 200, "ratio = 2.5\n"),
        (lambda t_s: swinging(t_s - 0.02), ""),
        (lambda t_s: swinging(t_s) + 1 / 360 * np.sin(50 * t_s), ""),
    ],
    ids=["offset", "opposite", "geared", "late", "trembling"],
)
def test_encoders_that_follow_one_another_are_left_in_peace(motion: Motion, line: str) -> None:
    analysis, shaft = twins(encoder(swinging, seconds=60.0), other(motion), line=line)
    assert severe(analysis) == []
    assert shaft.parted == 0
    assert shaft.left_out <= 5
    assert shaft.compared > 2300
    assert shaft.spread_deg is not None
    truth = (
        (
            motion(np.array([40.0]))
            - float(line.rsplit("=", maxsplit=1)[-1] or 1) * swinging(np.array([40.0]))
        )
        if line
        else None
    )
    if truth is not None:
        assert shaft.difference_deg is not None
        assert (shaft.difference_deg - truth[0] * 360 + 180) % 360 - 180 == pytest.approx(0, abs=1)


@pytest.mark.near_miss("angle.shafts_parted")
def test_a_fast_shaft_allows_more() -> None:
    fast = lambda t_s: turning(t_s, 2500.0)
    analysis, shaft = twins(encoder(fast, seconds=30.0), other(fast, seconds=30.0, lead_ms=12))
    assert severe(analysis) == []
    assert shaft.parted == 0


@pytest.mark.near_miss("angle.shafts_parted")
def test_a_preset_of_one_of_them_begins_a_new_comparison() -> None:
    rows = moved(other(), 30_010, round(TURN * 12 / 360))
    target = int(np.round(swinging(np.array([30.0]))[0] * TURN)) + round(TURN * 12 / 360)
    analysis, shaft = twins(
        encoder(swinging, seconds=60.0), rows, write(30_000, 6, 0x6003, 0, target)
    )
    assert shaft.parted == 0
    assert severe(analysis) == []


@pytest.mark.near_miss("angle.shafts_parted")
def test_the_wrap_of_a_single_turn_twin_is_no_difference() -> None:
    """One counts turns, the other wraps at each, and comes every 515 ms: only the circle counts."""
    text = (
        '[node.1]\ndevice = "lir-da158"\nsame_shaft_as = 5\n'
        '[node.1.objects]\n"6001" = 131072\n"6002" = 131072\n'
    )
    single = encoder(
        lambda t_s: turning(t_s, 200.0),
        node=1,
        period_ms=515.0,
        seconds=60.0,
        per_turn=131072,
        total=131072,
    )
    multi = encoder(lambda t_s: turning(t_s, 200.0), seconds=60.0)
    analysis = run(multi, single, description=described(5, more=text))
    assert analysis.shafts[0].parted == 0
    assert analysis.shafts[0].compared > 100
    assert severe(analysis) == []


@pytest.mark.near_miss("angle.shafts_parted")
def test_single_samples_and_gaps_are_no_parting() -> None:
    rows = moved(other(), 30_000, round(TURN * 12 / 360), 30_300)
    rows = [row for row in rows if not 40_000 * MS <= row[0] < 42_000 * MS]
    _, shaft = twins(encoder(swinging, seconds=60.0), rows)
    assert shaft.parted == 0


@pytest.mark.parametrize("batch", [37, 1000])
def test_batches_do_not_change_who_parted(batch: int) -> None:
    rows = (encoder(swinging, seconds=60.0), moved(other(), 30_000, round(TURN * 12 / 360)))
    description = described(5, more=TWINS.format(more=""))
    shafts = whole(*rows, description=description, batch=batch).shafts
    assert shafts == whole(*rows, description=description).shafts


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("same_shaft_as = 0", "no node id"),
        ('same_shaft_as = "5"', "no node id"),
        ("same_shaft_as = 6", "the node itself"),
        ("same_shaft_as = 5\nratio = 0", "no ratio"),
        ("same_shaft_as = 5\ntolerance_deg = -1", "no angle"),
        ("ratio = 2", "means nothing without same_shaft_as"),
    ],
)
def test_a_shaft_that_cannot_be_is_a_users_mistake(line: str, words: str) -> None:
    from syncline_schemas.errors import DescriptionError

    with pytest.raises(DescriptionError, match=words):
        BusDescription.loads(f"[node.6]\n{line}\n")


def test_the_shaft_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "bus.toml"
    path.write_text(
        "[node.6]\nsame_shaft_as = 5\nratio = -2.5\ntolerance_deg = 1\n", encoding="utf-8"
    )
    entry = BusDescription.load(path).node("can0", 6)
    assert entry is not None
    assert (entry.same_shaft_as, entry.ratio, entry.tolerance_deg) == (5, -2.5, 1.0)


@pytest.mark.near_miss("angle.sampled_too_seldom")
def test_pauses_of_a_faster_rhythm_are_no_spacing_of_samples() -> None:
    """Every 40 ms at 30 rpm; three times a second is missing, in which it may have turned."""
    script = Script("lir-da158a", 5).read(-90, 0x6001, 0, 131_072).read(-80, 0x6002, 0, 131_072)
    counts = [round(k * 40 * 131_072 / 2000) % 131_072 for k in range(1000)]
    script.nmt(-10, 1).pdo(0, 40_000, 40, counts.__getitem__)
    pauses = (10_000, 17_000, 31_000)
    script.rows = [row for row in script.rows if not any(p < row[0] < p + 1_020 for p in pauses)]
    for event in script.told().events("ambiguous"):
        assert "samples every 4" in event.text
        assert event.seq < 10
