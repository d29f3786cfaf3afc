"""Steps and spikes near the end of a capture or a cut: judged as far as they can be."""

from typing import Any

import numpy as np
import pytest

from syncline_analyzer.results import Analysis
from syncline_schemas.batch import Gap
from tests.analyzer.control_runs import MS, Row
from tests.analyzer.test_angle_motion import (
    TURN,
    encoder,
    moved,
    resting,
    run,
    turning,
)
from tests.analyzer.whole_run import T0, found, severe, write

END_MS = 20_000


def ids(analysis: Analysis) -> list[str]:
    return [f.id for f in analysis.findings if f.id.startswith("angle.")]


def starting(at_s: float, rpm: float) -> Any:
    """At rest, then turning; the encoder measures every 100 ms and sends every 20 ms."""

    def motion(t_s: Any) -> Any:
        measured = np.floor(t_s * 10) / 10
        return 100.25 + np.maximum(measured - at_s, 0) * rpm / 60

    return motion


@pytest.mark.triggers("angle.spike")
@pytest.mark.parametrize("motion", [resting, turning], ids=["at rest", "turning"])
@pytest.mark.parametrize("left", [5, 10, 20])
def test_a_spike_near_the_end_is_told(motion: Any, left: int) -> None:
    at = END_MS - 20 * left
    analysis = run(moved(encoder(motion), at - 10, TURN // 2, at + 10))
    assert ids(analysis) == ["angle.spike"]


@pytest.mark.triggers("angle.step")
@pytest.mark.parametrize("left", [5, 10, 20])
def test_a_step_of_a_turning_shaft_near_the_end_is_told(left: int) -> None:
    analysis = run(moved(encoder(turning), END_MS - 20 * left - 10, TURN // 2))
    assert ids(analysis) == ["angle.step"]


@pytest.mark.triggers("angle.step_unsure")
@pytest.mark.parametrize("left", [1, 2, 4, 10, 20])
def test_a_step_at_rest_near_the_end_is_said_to_be_open(left: int) -> None:
    analysis = run(moved(encoder(resting), END_MS - 20 * left - 10, TURN // 2))
    (finding,) = found(analysis, "angle.step_unsure")
    assert ids(analysis) == ["angle.step_unsure"]
    assert finding.severity == "info"
    assert "cannot be told" in finding.text
    assert abs(finding.start_ns - T0 - (END_MS - 20 * left) * MS) <= 25 * MS


@pytest.mark.triggers("angle.step_unsure")
def test_a_step_before_a_gap_is_said_to_be_open() -> None:
    gap = Gap(T0 + 10_100 * MS, T0 + 12_000 * MS, "adapter lost")
    rows = moved(encoder(resting), 9_900, TURN // 2)
    rows = [row for row in rows if not 10_100 <= row[0] / MS < 12_000]
    analysis = run(rows, gap)
    assert ids(analysis) == ["angle.step_unsure"]


@pytest.mark.near_miss("angle.step_unsure")
@pytest.mark.near_miss("angle.step")
@pytest.mark.near_miss("angle.spike")
@pytest.mark.parametrize("stop_ms", range(10_000, 10_500, 60))
def test_a_shaft_that_starts_near_the_end_is_no_accusation(stop_ms: int) -> None:
    """It measures every 100 ms, so that it stands for some samples and then steps."""
    rows = [row for row in encoder(starting(10.0, 300)) if row[0] / MS < stop_ms]
    analysis = run(rows)
    assert severe(analysis) == []
    gentle = [row for row in encoder(starting(10.0, 20)) if row[0] / MS < stop_ms]
    assert ids(run(gentle)) == []


@pytest.mark.near_miss("angle.step_unsure")
@pytest.mark.parametrize("answer_ms", [-5.0, 5.0, 30.0])
def test_a_preset_near_the_end_is_explained(answer_ms: float) -> None:
    at = END_MS - 150
    rows = moved(encoder(resting), at - 10, TURN // 2) + write(at + answer_ms, 5, 0x6003, 0, 0)
    assert ids(run(rows)) == []


@pytest.mark.near_miss("angle.step_unsure")
def test_a_step_that_a_whole_second_follows_is_judged() -> None:
    analysis = run(moved(encoder(resting), END_MS - 1_010, TURN // 2))
    assert ids(analysis) == ["angle.step"]


@pytest.mark.parametrize("batch", [1, 7, 300])
def test_batches_do_not_change_what_is_told_of_the_end(batch: int) -> None:
    from tests.analyzer.test_angle_motion import described
    from tests.analyzer.whole_run import whole

    rows: list[Row] = moved(encoder(resting), END_MS - 90, TURN // 2)
    one = whole(rows, description=described(5), batch=batch)
    assert ids(one) == ids(run(rows)) == ["angle.step_unsure"]
