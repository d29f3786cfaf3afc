"""Trends of fleets: what is planted is found, and what only looks like it is not told."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("duckdb")
pytest.importorskip("fsspec")

import numpy as np
from click.testing import CliRunner

from benchmarks.fleet_trends import Score, bounds, tell
from syncline_analyzer.fleet import open_fleet
from syncline_analyzer.fleet.trends.fleets import common
from syncline_analyzer.fleet.trends.limits import LIMITS
from syncline_analyzer.fleet.trends.rows import MEANINGS, TrendFinding
from syncline_analyzer.fleet.trends.statistics import (
    persistence,
    rising_share,
    slopes,
    spreads,
    weighted_medians,
)
from syncline_analyzer.fleet_command import fleet as command
from syncline_samples.fleet import Planted
from syncline_samples.fleet_weeks import simulate
from syncline_schemas.errors import UsageError
from tests.analyzer.fleet.fleet_builder import analyze, capture
from tests.analyzer.fleet.trend_builder import LEVEL_US, brief, counts, rows, told

Rate = Callable[[int, int], float]


def latency(change: Callable[[int, int], float], **options: Any) -> list[TrendFinding]:
    return told(("pdo-latency", rows(change=change, **options)))


def test_a_step_of_one_machine_is_told_with_its_day_and_size() -> None:
    (found,) = latency(lambda machine, day: 80.0 * (machine == 4 and day >= 17))
    assert brief([found]) == [("trend.step", "press-4", 17)]
    assert (found.node, found.part, found.name, found.severity) == (
        3,
        "TPDO2",
        "press drive",
        "warning",
    )
    assert found.change == pytest.approx(80, abs=3)
    assert found.before == pytest.approx(LEVEL_US, abs=3)
    assert (found.captures_before, found.captures_after) == (17, 13)
    assert found.evidence == ["c4-0", "c4-16", "c4-17", "c4-29"]
    assert found.q < 1e-6
    assert "rose on 2026-03-19" in found.text


def test_a_drift_is_told_with_its_slope_and_what_it_reaches() -> None:
    (found,) = latency(lambda machine, day: 6.0 * day * (machine == 4))
    assert brief([found]) == [("trend.drift", "press-4", 0)]
    assert found.slope_per_day == pytest.approx(6.0, abs=0.2)
    # From 814 us on to 20 ms at 6 us a day: after some 3200 days, which nobody plans for.
    assert found.reaches == ""
    (fast,) = latency(lambda machine, day: 60.0 * day * (machine == 4))
    assert fast.reaches == "the SYNC period of 20000 us"
    assert fast.reaches_ns is not None
    assert (fast.reaches_ns - fast.last_ns) / 86_400e9 == pytest.approx(
        (20_000 - 2380) / 60, rel=0.02
    )


def test_a_drift_that_begins_in_the_middle_is_told_from_then_on() -> None:
    (found,) = latency(lambda machine, day: 10.0 * max(day - 12, 0) * (machine == 4))
    assert found.id == "trend.drift"
    assert abs(brief([found])[0][2] - 12) <= 2  # type: ignore[operator]


def test_a_fall_is_a_note() -> None:
    (found,) = latency(lambda machine, day: -80.0 * (machine == 4 and day >= 17))
    assert (found.severity, found.change < 0) == ("info", True)
    assert "fell on" in found.text


def test_the_same_step_on_all_machines_is_one_finding() -> None:
    (found,) = latency(lambda _machine, day: 60.0 * (day >= 11))
    assert brief([found]) == [("trend.fleet_step", None, 11)]
    assert found.machines == 20
    assert found.text.startswith("All 20 machines, node 3")


def test_a_roll_out_on_some_machines_within_days_is_one_finding() -> None:
    (found,) = latency(lambda machine, day: 60.0 * (machine < 7 and day >= 11 + machine % 2))
    assert found.id == "trend.fleet_step"
    assert sorted(found.machine_names) == sorted(f"press-{machine}" for machine in range(7))


def test_a_machine_that_drifts_away_from_a_drifting_fleet_is_its_own() -> None:
    found = latency(lambda machine, day: 3.0 * day * (3.0 if machine == 4 else 1.0))
    assert [(each.id, each.machine) for each in found] == [
        ("trend.fleet_drift", None),
        ("trend.drift", "press-4"),
    ]
    assert found[0].slope_per_day == pytest.approx(3.0, abs=0.2)


def test_a_machine_that_stays_while_the_fleet_moves_is_not_accused() -> None:
    found = latency(lambda machine, day: 60.0 * (day >= 11 and machine != 4))
    assert [(each.id, each.machine) for each in found] == [("trend.fleet_step", None)]
    assert "press-4" not in found[0].machine_names


def test_all_nodes_of_a_machine_are_one_finding() -> None:
    frame = rows(change=lambda machine, day: 80.0 * (machine == 4 and day >= 17))
    other = frame.assign(node=5, amount=frame["amount"] + 300).astype({"node": "Int64"})
    import pandas as pd

    (found,) = told(("pdo-latency", pd.concat([frame, other])))
    assert (found.node, found.nodes, found.parts) == (
        None,
        [3, 5],
        ["node 3 TPDO2", "node 5 TPDO2"],
    )


NOISY = {"noise": 8.0}
LURES: dict[str, tuple[Callable[[int, int], float], dict[str, Any]]] = {
    "nothing": (lambda _m, _d: 0.0, {}),
    "one bad day": (lambda m, d: 500.0 * (m == 4 and d == 20), {}),
    "bad days": (lambda m, d: 500.0 * (m == 4 and d in (5, 19, 20, 27)), {}),
    "a bad week that is over": (lambda m, d: 100.0 * (m == 4 and 10 <= d < 17), {}),
    "the last days": (lambda m, d: 100.0 * (m == 4 and d >= 27), {}),
    "weekends": (lambda m, d: 100.0 * (m == 4 and d % 7 >= 5), {}),
    "weekends of all": (lambda _m, d: 100.0 * (d % 7 >= 5), {}),
    "too small": (lambda m, d: 15.0 * (m == 4 and d >= 15), {}),
    "small, of all": (lambda _m, d: 15.0 * (d >= 15), {}),
    "within what days differ": (lambda m, d: 40.0 * (m == 4 and d >= 15), {"noise": 40.0}),
    "a gap of ten days": (lambda _m, _d: 0.0, {"recorded": lambda m, d: m != 4 or not 10 <= d < 20}),
    "another recorder": (
        lambda m, d: 100.0 * (m == 4 and d >= 15),
        {"more": lambda m, d: {"recorder": "new"} if m == 4 and d >= 15 else {}},
    ),
    "other stamps": (
        lambda m, d: 100.0 * (m == 4 and d >= 15),
        {"more": lambda m, d: {"resolution_us": 1000.0} if m == 4 and d >= 15 else {}},
    ),
    "another device": (
        lambda m, d: 100.0 * (m == 4 and d >= 15),
        {"more": lambda m, d: {"serial": "new"} if m == 4 and d >= 15 else {}},
    ),
    "few captures": (lambda m, d: 100.0 * (m == 4 and d >= 15), {"recorded": lambda _m, d: d % 8 == 0}),
    "many that wander": (lambda m, d: (m - 9.5) * 4.0 * d, {}),
    "many that wander, more of them down": (lambda m, d: (m - 11) * 4.0 * d, {}),
}  # fmt: skip


@pytest.mark.parametrize("what", LURES)
def test_what_only_looks_like_a_trend_is_not_told(what: str) -> None:
    change, options = LURES[what]
    assert brief(latency(change, **options)) == []


def test_shorter_captures_are_no_trend_of_the_load() -> None:
    def length(machine: int, day: int) -> dict[str, Any]:
        return {"duration_ns": 10**11} if machine == 4 and day >= 15 else {}

    def load(machine: int, day: int) -> float:
        return 9.0 * (machine == 4 and day >= 15)

    assert told(("bus-load", rows("bus-load", change=load, base=30, noise=0.3, more=length))) == []
    (found,) = told(("bus-load", rows("bus-load", change=load, base=30, noise=0.3)))
    assert found.id == "trend.step"


def test_a_trend_beside_another_recorder_is_found_all_the_same() -> None:
    def recorder(machine: int, day: int) -> dict[str, Any]:
        return {"recorder": "new"} if machine == 4 and day >= 24 else {}

    found = latency(
        lambda m, d: 100.0 * (m == 4 and d >= 12) + 60.0 * (m == 4 and d >= 24), more=recorder
    )
    assert brief(found) == [("trend.step", "press-4", 12)]
    found = latency(lambda m, d: 8.0 * d * (m == 4), more=recorder)
    assert [each.id for each in found] == ["trend.drift"]


def test_trends_do_not_depend_on_gaps_and_the_number_of_captures() -> None:
    import pandas as pd

    frame = rows(
        change=lambda machine, day: 80.0 * (machine == 4 and day >= 17),
        recorded=lambda machine, day: (machine * 7 + day * 5) % 4 != 0,
    )
    often = frame.sample(frac=0.5, random_state=1)
    often = often.assign(capture_id=often["capture_id"] + "b", begun_ns=often["begun_ns"] + 10**12)
    found = told(("pdo-latency", pd.concat([frame, often])))
    assert [(each.id, each.machine) for each in found] == [("trend.step", "press-4")]


def test_a_step_is_found_beside_the_rhythm_of_the_week() -> None:
    found = latency(lambda m, day: (m == 4) * (100.0 * (day % 7 >= 5) + 60.0 * (day >= 15)))
    assert brief(found) == [("trend.step", "press-4", 15)]


def test_few_machines_are_judged_each_alone() -> None:
    found = latency(lambda _machine, day: 80.0 * (day >= 17), machines=2)
    assert brief(found) == [("trend.step", "press-0", 17), ("trend.step", "press-1", 17)]


def events(rate: Rate, quantity: str = "emcy", **options: Any) -> list[TrendFinding]:
    return told((quantity, counts(quantity, rate, **options)))


def test_a_rate_that_rises_is_told() -> None:
    (found,) = events(lambda machine, day: 0.2 + 3.0 * (machine == 4 and day >= 15))
    assert (found.id, found.machine, found.severity) == ("trend.rate_rising", "press-4", "warning")
    assert abs(brief([found])[0][2] - 15) <= 3  # type: ignore[operator]
    assert found.after == pytest.approx(3.2 / 8, rel=0.3)
    assert found.unit == "1/h"


def test_a_rate_that_rises_on_all_machines_is_one_finding() -> None:
    found = events(lambda _machine, day: 0.3 * (1 + 4 * (day >= 15)))
    assert [(each.id, each.machine) for each in found] == [("trend.fleet_rate_rising", None)]
    assert found[0].machines > 10


def _storm(machine: int, day: int) -> float:
    return 300.0 if machine == 4 and day == 22 else 0.2


RATE_LURES: dict[str, tuple[Rate, dict[str, Any]]] = {
    "nothing": (lambda _m, _d: 0.3, {}),
    "one storm": (_storm, {}),
    "two storms": (lambda m, d: 200.0 if m == 4 and d in (17, 25) else 0.2, {}),
    "often, as ever": (lambda m, _d: 20.0 if m == 4 else 0.2, {}),
    "longer captures": (
        lambda m, d: 6.0 if m == 4 and d >= 15 else 0.6,
        {"more": lambda m, d: {"over": 80.0} if m == 4 and d >= 15 else {}},
    ),
    "less often": (lambda m, d: 6.0 if m == 4 and d < 15 else 0.2, {}),
    "a site without power": (lambda m, d: 3.0 if m < 6 and d == 20 else 0.0, {}),
    "a few": (lambda m, d: 0.3 * (m == 4 and d >= 15), {}),
}


@pytest.mark.parametrize("what", RATE_LURES)
def test_storms_and_long_captures_are_no_rising_rate(what: str) -> None:
    rate, options = RATE_LURES[what]
    assert brief(events(rate, **options)) == []


def wear(pace: Callable[[int, int], float], days: int = 30, **options: Any) -> list[TrendFinding]:
    def columns(machine: int, day: int) -> dict[str, Any]:
        grown = sum(pace(machine, each) for each in range(1, day + 1))
        reading = 10_000 + grown
        amount = pace(machine, day) if day else None
        return {"amount": amount, "over": 1.0 if day else None, "reading": reading}

    frame = rows("eeprom-wear", machines=10, days=days, more=columns, **options)
    return told(("eeprom-wear", frame))


def test_an_eeprom_that_wears_out_within_a_year_is_told_with_the_day() -> None:
    (found,) = wear(lambda machine, _day: 400.0 if machine == 4 else 5.0)
    assert (found.id, found.machine, found.severity) == ("trend.wear_out", "press-4", "warning")
    assert found.reaches == "100000 writes"
    left_days = (100_000 - (10_000 + 29 * 400)) / 400
    assert found.reaches_ns is not None
    assert (found.reaches_ns - found.last_ns) / 86_400e9 == pytest.approx(left_days, rel=0.01)
    assert found.assumed == []
    (guess,) = wear(lambda machine, _day: 400.0 if machine == 4 else 5.0, device="lir-da158")
    assert guess.assumed == ["rated for 100000 writes, as EEPROMs usually are"]


def test_an_eeprom_that_is_nearly_worn_is_an_error() -> None:
    (found,) = wear(lambda machine, _day: 3000.0 if machine == 4 else 5.0)
    assert found.severity == "error"


def test_saves_that_become_frequent_are_a_rising_rate() -> None:
    found = wear(lambda machine, day: 5.0 + 100.0 * (machine == 4 and day >= 15))
    assert [each.id for each in found] == ["trend.rate_rising"]
    assert found[0].change == pytest.approx(100, abs=2)


def test_an_eeprom_wears_at_the_pace_that_it_has_now() -> None:
    found = wear(lambda machine, day: 5.0 + 400.0 * (machine == 4 and day >= 20))
    assert {each.id for each in found} == {"trend.rate_rising", "trend.wear_out"}


@pytest.mark.parametrize(
    "pace",
    [
        lambda machine, day: 5.0 + 5000.0 * (machine == 4 and day == 3),
        lambda machine, day: 5.0 + 10.0 * (machine == 4 and day >= 15),
        lambda machine, day: -9000.0 if machine == 4 and day == 15 else 5.0,
    ],
    ids=["set up once", "a little more", "set back by another device"],
)
def test_a_burst_and_another_device_wear_nothing_out(pace: Rate) -> None:
    assert brief(wear(pace)) == []


def test_statistics_against_values_worked_out_by_hand() -> None:
    nan = np.nan
    value = np.array([[1.0, 2.0, nan, 4.0, 100.0]])
    one = np.zeros((1, 5), np.int64)
    # Slopes 1, 1, 1, 24.75, 32.67, 96 (per bin): the middle of the third and the fourth.
    assert slopes(value, one)[0] == pytest.approx((1 + 24.75) / 2)
    assert rising_share(value, one)[0] == 1.0
    assert rising_share(value, np.array([[0, 0, 0, 1, 1]]))[0] == 1.0
    assert rising_share(-value, one)[0] == -1.0
    assert weighted_medians(np.array([[5.0, 1.0, nan, 3.0]]), np.array([[1.0, 9, 9, 1]]))[0] == 1.0
    rng = np.random.default_rng(3)
    noise = rng.normal(0, 2.0, (200, 400))
    assert spreads(noise).mean() == pytest.approx(2.0, rel=0.05)
    assert np.median(persistence(noise, spreads(noise), 0.01)) < 1.1
    walk = np.zeros((200, 400))
    for step in range(1, 400):
        walk[:, step] = 0.5 * walk[:, step - 1] + noise[:, step]
    # An autoregression of 0.5: the variance of its mean is (1 + 0.5) / (1 - 0.5) times as large.
    assert np.median(persistence(walk, spreads(walk), 0.01)) == pytest.approx(3.0, rel=0.15)


def test_what_all_have_in_common_is_found_beside_what_some_have() -> None:
    rng = np.random.default_rng(4)
    season = np.sin(np.arange(30) / 5) * 10
    value = rng.normal(0, 1, (20, 30)) + season + np.arange(20)[:, None] * 50
    value[:6, 12:] += 500
    value[rng.random(value.shape) < 0.2] = np.nan
    off = common(value) - season
    assert np.abs(off - np.median(off)).max() < 1.5


def test_simulated_fleets_are_judged_right() -> None:
    score = Score()
    for seed in (1, 2, 3, 4):
        weeks = simulate(60, 30, seed)
        score.add(weeks.truths, weeks.lures, tell(weeks), weeks.either)
    assert score.planted.total() > 100
    assert score.precision >= 0.95, score.false
    assert score.recall >= 0.9, score.missed
    assert bounds(score.found.total(), score.planted.total())[0] > 0.85
    assert all(score.found[f"{kind} of fleet"] == 4 for kind in ("step", "drift", "rate"))


def test_healthy_fleets_have_no_trends() -> None:
    fleets = [simulate(60, 30, seed, planted=0.0, fleet_wide=False) for seed in range(11, 15)]
    assert sum(len(weeks.lures) for weeks in fleets) > 100
    assert [tell(weeks) for weeks in fleets] == [[], [], [], []]


def test_limits_and_meanings_are_complete() -> None:
    from syncline_analyzer.fleet.quantities import QUANTITIES
    from syncline_analyzer.fleet.trends.wording import WORDS

    assert set(LIMITS) == set(QUANTITIES) == set(WORDS)
    page = (Path(__file__).parents[3] / "docs" / "fleet.md").read_text(encoding="utf-8")
    assert all(each in page for each in MEANINGS)
    for name, limits in LIMITS.items():
        (line,) = (
            each
            for each in page.partition("Least change")[2].splitlines()
            if each.startswith(f"| `{name}` |")
        )
        assert f" {limits.floor:g} " in line, name
        assert not limits.share or f"| {limits.share * 100:g} % |" in line, name


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of two machines and twelve days; the second answers later from the seventh on."""
    folder = tmp_path_factory.mktemp("trends")
    for machine in range(2):
        for day in range(12):
            late_us = 400.0 * (machine == 1 and day >= 6)
            capture(folder / "in", machine, day, Planted(late_us=late_us, eeprom_writes=100 + day))
    analyze(folder / "in", folder / "out")
    return folder / "out"


def test_trends_of_captures_are_told_by_the_command(line: Path) -> None:
    def run(*arguments: str) -> tuple[int, str]:
        done = CliRunner().invoke(command, ["trends", str(line), *arguments])
        return done.exit_code, done.output

    code, text = run("--check", "--quantity", "pdo-latency")
    assert code == 1
    assert "warning: Machine machine-001" in text
    assert "check next: " in text
    code, text = run("--format", "json")
    found = json.loads(text)["trends"]
    assert (code, found[0]["id"], found[0]["machine"]) == (0, "trend.step", "machine-001")
    assert 3 in found[0]["nodes"]
    table = list(csv.DictReader(run("--format", "csv")[1].splitlines()))
    assert [each["id"] for each in table] == [each["id"] for each in found]
    for nothing in (
        ["--machine", "machine-000"],
        ["--until", "2026-03-08"],
        ["--quantity", "resets"],
    ):
        code, text = run("--check", *nothing)
        assert (code, text.startswith("Nothing drifts")) == (0, True), text


def test_trends_of_captures_are_a_frame(line: Path) -> None:
    fleet = open_fleet(str(line))
    frame = fleet.trends(quantity="pdo-latency", machine="machine-00*")
    first = frame.iloc[0]
    assert (first["machine"], str(first["onset"])[:10]) == ("machine-001", "2026-03-08")
    captures = fleet.query("SELECT capture_id FROM captures WHERE machine = 'machine-001'")
    assert set(first["evidence"]) <= set(captures["capture_id"])
    assert fleet.trends(quantity="resets").empty
    with pytest.raises(UsageError, match="there is no quantity 'speed'"):
        fleet.trends(quantity="speed")
    with pytest.raises(UsageError, match="is no date"):
        fleet.trends(since="yesterday")
