"""The live view in the real Rerun viewer: what stands on the screen while a recording runs."""

from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest

from syncline_logger.live_view.scene import Scene
from syncline_logger.live_view.taken import Begun, Heard, Taken
from syncline_logger.live_view.viewer_sink import ViewerSink
from syncline_samples.forty_nodes import forty_nodes
from syncline_samples.machine import Scenario
from syncline_samples.scenarios import bad_day, healthy_line, jittery_sync
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.description import BusDescription
from tests.analyzer.viewer import Shown, shot, tool

__all__ = ["tool"]

OPERATIONAL, LOST, ERROR = (53, 125, 56), (180, 45, 42), (171, 1, 22)
"""Colours as the viewer shades them in lanes and in the log."""
BLUE = (80, 160, 255)
LOG = (0.66, 0.08, 1.0, 0.94)
PLOTS = (0.0, 0.35, 0.6, 1.0)
LANES = (0.0, 0.04, 0.6, 0.4)
STEP_NS = 500_000_000

SCENARIOS: dict[str, tuple[Scenario, str]] = {
    "healthy_line": (healthy_line(40.0), "30s"),
    "bad_day": (bad_day(58.0), "53s"),
    "jittery_sync": (jittery_sync(30.0), "25s"),
    "forty_nodes": (forty_nodes(), "25s"),
}
"""What is played, and a moment of it."""


def taken_of(frames: FrameBatch) -> Iterator[Taken]:
    """Frames as a recorder takes them in."""
    begin_ns, end_ns = int(frames.t_ns[0]), int(frames.t_ns[-1]) + 1
    for at_ns in range(begin_ns, end_ns, STEP_NS):
        until_ns = at_ns + STEP_NS
        part = frames[np.flatnonzero((frames.t_ns >= at_ns) & (frames.t_ns < until_ns))]
        yield Taken(part, part.t_ns, (Heard(0, begin_ns, until_ns),))


@pytest.fixture(scope="module", params=SCENARIOS)
def opened(
    request: pytest.FixtureRequest, tool: ModuleType, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Shown]:
    scenario, moment = SCENARIOS[request.param]
    run = scenario.start()
    path = tmp_path_factory.mktemp("live") / "live.rrd"
    frames = FrameBatch.concat([item for item in run.stream() if isinstance(item, FrameBatch)])
    description = BusDescription.loads(run.description_toml)
    begin_ns = int(frames.t_ns[0])
    bus = BusInfo("can0", 0, scenario.bitrate)
    scene = Scene(Begun(begin_ns, (bus,), description.text, dict(description.files)))
    sink = ViewerSink(str(path), begin_ns)
    for taken in taken_of(frames):
        sink.show(scene.take(taken))
    sink.close()
    return request.param, shot(tool, path, moment)


def test_states_values_load_and_log_are_on_the_screen(opened: tuple[str, Shown]) -> None:
    _, shown = opened
    assert shown.problems == []
    assert {"NMT states", "deg", "Bus load", "EMCY, commands, lost nodes"} <= shown.views
    assert shown.count(OPERATIONAL, LANES) > 10_000, "lanes"
    assert shown.count(BLUE, PLOTS) > 50, "values"
    assert (shown.part(LOG).min(-1) > 180).sum() > 500, "words of the log"


def test_a_lost_node_is_seen_at_once(opened: tuple[str, Shown]) -> None:
    """In its lane where all lanes have room, and in the log, which follows the cursor."""
    name, shown = opened
    assert (shown.count(LOST, LANES) > 200) == (name == "bad_day")
    assert (shown.count(ERROR, LOG) > 20) == (name in ("bad_day", "forty_nodes"))
