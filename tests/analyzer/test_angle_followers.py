"""Encoders that follow one another: the hint that they may sit on one shaft."""

from typing import Any

import numpy as np
import pytest

from syncline_analyzer.folds.angle import followers
from syncline_analyzer.results import Analysis, FollowerRow
from syncline_schemas.batch import Gap
from tests.analyzer.control_runs import MS, Row
from tests.analyzer.test_angle_motion import TWINS, described, encoder, swinging, turning
from tests.analyzer.whole_run import T0, found, severe, whole

SECONDS = 120.0


def jogging(t_s: Any) -> Any:
    """Runs of different length and speed, to and fro, with rests between them."""
    rpm = np.array([30, 0, -45, 0, 60, 10, 0, -25, 0, 80, -80, 0])
    second = np.arange(0, 400)
    speed = rpm[(second // 7) % len(rpm)] / 60
    return 100 + np.interp(t_s, second, np.concatenate(([0], np.cumsum(speed[:-1]))))


def one(motion: Any = jogging, **changes: Any) -> list[Row]:
    return encoder(motion, **{"seconds": SECONDS, **changes})


def other(motion: Any = jogging, *, ratio: float = 1.0, node: int = 6, **changes: Any) -> list[Row]:
    """A second encoder, sampled at other times, geared and elsewhere at the start."""
    plain: dict[str, Any] = {"period_ms": 25.0, "begin_ms": 31.0, "seconds": SECONDS}
    return encoder(
        lambda t_s: 2000.3 + ratio * (motion(t_s) - 100), node=node, **{**plain, **changes}
    )


def run(*parts: list[Row] | Gap, more: str = "", nodes: tuple[int, ...] = (5, 6)) -> Analysis:
    return whole(*parts, description=described(*nodes, more=more))


def only(analysis: Analysis) -> FollowerRow:
    (row,) = analysis.followers
    return row


@pytest.mark.triggers("angle.follow_one_another")
@pytest.mark.parametrize("ratio", [1.0, -1.0, -2.5, 0.4, 19 / 7])
@pytest.mark.parametrize("motion", [jogging, swinging])
def test_encoders_that_are_geared_are_told(ratio: float, motion: Any) -> None:
    analysis = run(one(motion), other(motion, ratio=ratio))
    row = only(analysis)
    assert (row.bus, row.node, row.other) == ("can0", 6, 5)
    assert row.ratio == pytest.approx(ratio, rel=1e-9)
    assert row.spread_deg < 3
    (finding,) = found(analysis, "angle.follow_one_another")
    assert (finding.severity, finding.node) == ("info", 6)
    assert "same_shaft_as = 5" in finding.check_next
    assert ("ratio" in finding.check_next) is (ratio != 1)
    assert severe(analysis) == []


@pytest.mark.triggers("angle.follow_one_another")
def test_what_is_hinted_at_can_be_said_and_is_then_compared() -> None:
    more = TWINS.format(more="ratio = -2.5\n")
    analysis = run(one(), other(ratio=-2.5), nodes=(5,), more=more)
    assert analysis.followers == []
    assert analysis.shafts[0].parted == 0
    assert analysis.shafts[0].compared > 1000


@pytest.mark.triggers("angle.follow_one_another")
def test_gaps_and_presets_do_not_hide_it() -> None:
    gap = Gap(T0 + 40_000 * MS, T0 + 47_000 * MS, "adapter lost")
    rows = [row for row in one() + other() if not 40_000 <= row[0] / MS < 47_000]
    assert only(run(rows, gap)).ratio == 1


@pytest.mark.triggers("angle.follow_one_another")
def test_of_three_on_one_shaft_two_pairs_are_told() -> None:
    third = other(ratio=-1.0, node=7, period_ms=50.0)
    analysis = run(one(), other(), third, nodes=(5, 6, 7))
    assert [(row.node, row.other, row.ratio) for row in analysis.followers] == [
        (6, 5, 1.0),
        (7, 5, -1.0),
    ]


def shifted(t_s: Any) -> Any:
    return jogging(t_s + 3.0)


def wandering(t_s: Any) -> Any:
    """The same runs, and a slow drift beside them: a slipping belt."""
    return jogging(t_s) + t_s / 60


@pytest.mark.near_miss("angle.follow_one_another")
@pytest.mark.parametrize(
    ("motion", "its"),
    [
        (turning, turning),
        (turning, lambda t_s: 2 * turning(t_s)),
        (jogging, shifted),
        (jogging, swinging),
        (jogging, wandering),
        (jogging, lambda t_s: 100.25 + 0 * t_s),
        (
            lambda t_s: 100 + (jogging(t_s) - 100) / 200,
            lambda t_s: 100 + (jogging(t_s) - 100) / 200,
        ),
    ],
    ids=["even", "even and geared", "later", "another motion", "slipping", "at rest", "small"],
)
def test_encoders_that_do_not_or_not_tellingly_follow_are_left_alone(motion: Any, its: Any) -> None:
    assert run(one(motion), other(its)).followers == []


@pytest.mark.near_miss("angle.follow_one_another")
def test_half_a_minute_is_too_short() -> None:
    assert run(one(seconds=50.0), other(seconds=50.0)).followers == []


@pytest.mark.near_miss("angle.follow_one_another")
def test_encoders_of_two_buses_cannot_be_compared() -> None:
    far = [(row[0], 1, *row[2:]) for row in other()]
    analysis = whole(one(), far, buses=("can0", "can1"), description=described(5, 6))
    assert analysis.followers == []


@pytest.mark.near_miss("angle.follow_one_another")
def test_a_shaft_that_is_described_over_a_third_encoder_is_not_told_again() -> None:
    lines = "".join(
        TWINS.format(more="").replace("node.6", f"node.{node}").replace("= 5", f"= {base}", 1)
        for node, base in ((6, 5), (7, 6))
    )
    third = other(node=7, period_ms=50.0)
    assert run(one(), other(), third, nodes=(5,), more=lines).followers == []


@pytest.mark.near_miss("angle.follow_one_another")
def test_single_turn_encoders_sampled_too_seldom_are_not_compared() -> None:
    """Every 515 ms a single turn tells nothing of a shaft of 80 rpm."""
    few: dict[str, Any] = {"period_ms": 515.0, "total": 8192}
    rows = one(**few), other(**few)
    text = "".join(
        f'[node.{node}]\ndevice = "lir-ma158k"\n[node.{node}.objects]\n'
        '"6001" = 8192\n"6002" = 8192\n'
        for node in (5, 6)
    )
    from syncline_schemas.description import BusDescription

    assert whole(*rows, description=BusDescription.loads(text)).followers == []


def test_a_clock_that_steps_back_repeats_no_moment() -> None:
    """All stamps after 60 s are 5 s too early, in both encoders alike."""
    rows = [
        (row[0] - (5_000 * MS if row[0] > 60_000 * MS else 0), *row[1:])
        for row in sorted(one() + other(ratio=-2.5))
    ]
    row = only(whole(rows, description=described(5, 6), in_order=False))
    assert row.ratio == -2.5
    assert row.compared == pytest.approx(1150, abs=5)
    assert row.end_ns - T0 == pytest.approx(115e9, abs=0.3e9)


def test_a_long_capture_is_looked_at_on_a_wider_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(followers, "MAX_TICKS", 256)
    row = only(run(one(), other(ratio=-2.5)))
    assert row.compared <= 256
    assert row.ratio == -2.5


@pytest.mark.parametrize("batch", [50, 999])
def test_batches_do_not_change_it(batch: int) -> None:
    rows = one() + other(ratio=-2.5)
    part = whole(rows, description=described(5, 6), batch=batch)
    assert part.followers == run(rows).followers
