"""The real Rerun viewer on whole captures: what it shows is counted in pixels."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from syncline_analyzer.results import Analysis, NmtStateRow
from syncline_analyzer.session import Session, open_session
from syncline_analyzer.views.palette import (
    EMCY_COLOUR,
    LINE_COLOURS,
    SEVERITY_COLOURS,
    STATE_COLOURS,
)
from syncline_analyzer.views.rerun_view import write_rrd
from syncline_samples.forty_nodes import forty_nodes
from syncline_samples.generate import mcap_capture
from tests.analyzer.analysis_builder import SECOND, T0, analysis, capture_row, node_row
from tests.analyzer.viewer import Shown, shot, tool

SAMPLES = Path(__file__).parents[2] / "samples"

__all__ = ["tool"]

OPERATIONAL, LOST = (53, 125, 56), (180, 45, 42)
"""Colours of `STATE_COLOURS` as the viewer shades them in a lane."""
BAR = (81, 163, 103)
ERROR, WARNING = SEVERITY_COLOURS["error"], SEVERITY_COLOURS["warning"]
BLUE = LINE_COLOURS[0]


def sample(name: str) -> Callable[[Path], Path]:
    return lambda folder: SAMPLES / name


def forty(folder: Path) -> Path:
    path = folder / "forty.mcap"
    path.write_bytes(mcap_capture(forty_nodes().run()))
    return path


CAPTURES = {
    "healthy_line": sample("healthy_line.mcap"),
    "bad_day": sample("bad_day.mcap"),
    "jittery_sync": sample("jittery_sync.log"),
    "forty_nodes": forty,
}


@pytest.fixture(scope="module", params=CAPTURES)
def opened(
    request: pytest.FixtureRequest, tool: ModuleType, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Shown]:
    folder = tmp_path_factory.mktemp("rrd")
    session: Session = open_session(CAPTURES[request.param](folder))
    path = write_rrd(session.analysis, folder / "session.rrd", session.frames)
    return request.param, shot(tool, path)


LEFT, RIGHT = (0.0, 0.04, 0.62, 1.0), (0.63, 0.04, 1.0, 1.0)
FINDINGS = (0.0, 0.05, 0.62, 0.20)
WORLD = (0.63, 0.74, 1.0, 0.96)


def test_every_part_of_the_layout_is_there_and_drawn(opened: tuple[str, Shown]) -> None:
    _, shown = opened
    assert shown.problems == []
    assert {"Findings", "EMCY log", "SDO log", "Change log", "Frames around the cursor"} <= (
        shown.views
    )
    for start in ("NMT states", "Events", "Bus load", "Angle", "Speed", "SYNC period", "3D at"):
        assert any(view.startswith(start) for view in shown.views), start
    assert shown.count(OPERATIONAL, LEFT) > 20_000, "lanes"
    assert shown.count(BLUE, LEFT) > 1_500, "bus load, angle and speed"
    assert shown.count(BLUE, RIGHT) > 300, "SYNC period and pointers"
    assert shown.count(BAR, RIGHT) > 500, "histogram"
    world = shown.part(WORLD)
    assert (world[..., 0] - world[..., 2] > 60).sum() > 300, "box, in orange lines"
    assert (shown.part(FINDINGS).min(-1) > 180).sum() > 800, "words of the findings"


def test_faults_are_seen_at_once_and_health_as_well(opened: tuple[str, Shown]) -> None:
    name, shown = opened
    loud = {
        "healthy_line": (),
        "bad_day": (ERROR, WARNING, EMCY_COLOUR, STATE_COLOURS["LOST"]),
        "jittery_sync": (WARNING,),
        "forty_nodes": (ERROR, WARNING, EMCY_COLOUR, STATE_COLOURS["LOST"]),
    }[name]
    for colour in (ERROR, WARNING, EMCY_COLOUR, STATE_COLOURS["LOST"]):
        found = shown.count(colour, LEFT)
        assert (found >= 20) == (colour in loud), (colour, found)
    lost = shown.count(LOST, LEFT)
    assert (lost > 300) == (name in ("bad_day", "forty_nodes"))


def a_day() -> Analysis:
    """A day of one node that was lost for a millisecond."""
    t = [T0, T0 + 3_600 * SECOND, T0 + 50_000 * SECOND, T0 + 50_000 * SECOND + 10**6]
    ends = [*t[1:], T0 + 86_400 * SECOND]
    states = ["PRE-OPERATIONAL", "OPERATIONAL", "LOST", "OPERATIONAL"]
    rows = [
        NmtStateRow("can0", 5, state, start, end, "heartbeat", "observed", 1)
        for state, start, end in zip(states, t, ends, strict=True)
    ]
    whole = replace(capture_row(), duration_ns=86_400 * SECOND)
    return analysis(capture=whole, nodes=[node_row(5, name="shaft")], nmt_states=rows)


def test_a_millisecond_of_a_day_is_seen(tool: ModuleType, tmp_path: Path) -> None:
    shown = shot(tool, write_rrd(a_day(), tmp_path / "day.rrd"))
    assert shown.problems == []
    assert shown.count(STATE_COLOURS["LOST"], LEFT) >= 30
    marker = np.abs(shown.pixels[:, :990] - np.array(STATE_COLOURS["LOST"])).max(-1) <= 4
    assert abs(np.nonzero(marker)[1].mean() / 1000 - 50 / 86.4) < 0.02, "the marker is in its place"
