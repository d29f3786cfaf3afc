"""`session.rrd`: what is in it by its chunks, and what the real viewer shows by pixels."""

from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, ShaftTrace
from syncline_analyzer.views.palette import EMCY_COLOUR, LINE_COLOURS
from syncline_analyzer.views.rerun_plots import OVERVIEW_POINTS
from syncline_analyzer.views.rerun_view import write_rrd
from syncline_schemas.tilt import Angles
from tests.analyzer.analysis_builder import (
    SECOND,
    T0,
    analysis,
    at,
    bad_day,
    capture_row,
    many_nodes,
    measured,
    node_row,
    shaft,
    tilt,
    tilt_of,
    trace_row,
    untimed,
    usual_states,
)
from tests.analyzer.busy_bus import busy_bus
from tests.analyzer.viewer import Picture, pixels_of, tool

__all__ = ["tool"]


def columns(path: Path, entity: str, component: str) -> dict[str, list[Any]]:
    """Timelines [ns] and one component of an entity, in the order of the file."""
    from rerun.chunk import RrdReader

    found: dict[str, list[Any]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and component in batch.schema.names:
            for name in batch.schema.names:
                column = batch.column(name)
                if name in ("capture", "utc", "frame"):
                    found.setdefault(name, []).extend(column.cast("int64").to_pylist())
            found.setdefault(component, []).extend(batch.column(component).to_pylist())
    return found


def entities(path: Path) -> set[str]:
    from rerun.chunk import RrdReader

    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def test_lane_holds_every_state_on_both_timelines_to_the_nanosecond(tmp_path: Path) -> None:
    path = write_rrd(bad_day(), tmp_path / "s.rrd")
    lane = columns(path, "/nmt/can0/010_boom_tilt", "StateChange:state")
    states = [state[0] for state in lane["StateChange:state"]]
    assert states == ["UNKNOWN", "PRE-OPERATIONAL", "OPERATIONAL", "LOST", "INITIALISING",
                      "PRE-OPERATIONAL", "OPERATIONAL", "LOST", "OPERATIONAL", ""]  # fmt: skip
    assert lane["utc"][3] == at(250)
    assert lane["capture"][7] == at(500) - T0


def test_loss_too_short_for_a_lane_has_a_marker_and_a_line_in_the_log(tmp_path: Path) -> None:
    path = write_rrd(bad_day(), tmp_path / "s.rrd")
    marks = columns(path, "/events/6_node_lost", "Scalars:scalars")
    assert marks["utc"] == [at(250), at(500)]
    log = columns(path, "/log/nmt", "TextLog:text")
    told = dict(zip(log["utc"], log["TextLog:text"], strict=True))
    assert "LOST" in told[at(500)][0]
    assert log["utc"] == sorted(log["utc"])


def test_emcy_log_tells_code_meaning_and_level(tmp_path: Path) -> None:
    path = write_rrd(bad_day(), tmp_path / "s.rrd")
    texts = [text[0] for text in columns(path, "/log/emcy", "TextLog:text")["TextLog:text"]]
    levels = [text[0] for text in columns(path, "/log/emcy", "TextLog:level")["TextLog:level"]]
    assert levels == ["ERROR", "ERROR", "INFO", "WARN", "ERROR", "ERROR", "ERROR"]
    assert "8130h life guard error" in texts[1]


def test_overview_is_thinned_with_its_peak_and_detail_holds_every_sample(tmp_path: Path) -> None:
    count = 8 * OVERVIEW_POINTS
    trace = shaft(count)
    path = write_rrd(analysis(trace_data=[trace]), tmp_path / "s.rrd")
    overview = columns(path, "/plots/speed_rpm/node_5/0", "Scalars:scalars")
    detail = columns(path, "/detail/speed_rpm/node_5/0", "Scalars:scalars")
    values = [value[0] for value in detail["Scalars:scalars"] if value is not None]
    assert len(overview["capture"]) <= OVERVIEW_POINTS + 6
    assert np.isfinite(values).sum() == count
    shown = np.array([value[0] for value in overview["Scalars:scalars"]])
    assert np.nanmax(shown) == trace.columns["speed_rpm"].max()


def test_load_and_answers_lie_over_short_windows_and_waits(tmp_path: Path) -> None:
    path = write_rrd(busy_bus(40, pdos=1), tmp_path / "s.rrd")
    load = "/plots/bus_load/all"
    short = columns(path, f"{load}/0", "Scalars:scalars")["Scalars:scalars"]
    assert (len(short), max(short)) == (6_000, [50.0])
    assert len(columns(path, f"{load}/1", "Scalars:scalars")["Scalars:scalars"]) == 600
    answers = [name for name in entities(path) if name.startswith("/plots/pdo_response_us/node_")]
    assert {f"/plots/pdo_response_us/node_40_drive_40/{i}" for i in (0, 1)} <= set(answers)
    assert len({name.rsplit("/", 1)[0] for name in answers}) == 40


@pytest.mark.parametrize(
    ("shown", "timelines"),
    [
        (bad_day(), {"capture", "utc"}),
        (analysis(capture=capture_row(start_utc_ns=None), nodes=[node_row()],
                  nmt_states=usual_states(10)), {"capture"}),
        (untimed(), {"frame"}),
        (analysis(), {"capture", "utc"}),
        (analysis(capture=capture_row(frames=0, files=["\udce9.log"])), {"capture", "utc"}),
        (many_nodes(), {"capture", "utc"}),
    ],
    ids=["bad day", "no date", "no times", "no node", "no frame", "40 nodes"],
)  # fmt: skip
def test_any_capture_makes_a_recording_with_the_timelines_it_has(
    shown: Analysis, timelines: set[str], tmp_path: Path
) -> None:
    from rerun.chunk import RrdReader

    path = write_rrd(shown, tmp_path / "s.rrd")
    found = {name for chunk in RrdReader(path).stream() for name in chunk.timeline_names}
    assert found == timelines
    assert len(RrdReader(path).blueprints()) == 1
    assert "/findings" in entities(path)


def test_buses_keep_their_nodes_apart(tmp_path: Path) -> None:
    both = [node_row(5, bus="can0"), node_row(5, bus="can1")]
    states = usual_states(5, bus="can0") + usual_states(5, bus="can1")
    capture = capture_row(buses=["can0", "can1"])
    shown = analysis(capture=capture, nodes=both, nmt_states=states)
    found = entities(write_rrd(shown, tmp_path / "s.rrd"))
    assert {"/nmt/can0/005", "/nmt/can1/005"} <= found


def still(long_deg: float, lateral_deg: float, angles: Angles | None = Angles.GIMBAL_X) -> Analysis:
    """An inclinometer that holds a pose, but is level in the first second."""
    seconds = np.arange(0.0, 10.0)
    first, second = (
        replace(tilt(object, "Slope", 40.0), t_ns=T0 + (seconds * 1e9).astype(np.int64),
                seq=np.arange(10), value=np.where(seconds > 0, angle, 0.0))
        for object, angle in ((0x601000, long_deg), (0x602000, lateral_deg))
    )  # fmt: skip
    return analysis(tilt_data=[tilt_of(first, second, angles)])


@pytest.mark.parametrize(
    ("pose", "axis", "sense"),
    [((40.0, 0.0), 1, -1), ((0.0, 40.0), 0, 1), ((-40.0, 0.0), 1, -1)],
)
def test_box_turns_about_y_by_the_longitudinal_and_about_x_by_the_lateral_angle(
    pose: tuple[float, float], axis: int, sense: int, tmp_path: Path
) -> None:
    """A positive angle raises x or y, as the exported direction of gravity says."""
    path = write_rrd(still(*pose), tmp_path / "s.rrd")
    turns = columns(path, "/world/0/0/box", "Transform3D:quaternion")["Transform3D:quaternion"]
    wanted = np.zeros(4)
    wanted[axis] = sense * np.sin(np.radians(sum(pose) / 2))
    wanted[3] = np.cos(np.radians(20))
    assert turns[0][0] == pytest.approx([0, 0, 0, 1])
    assert turns[-1][0] == pytest.approx(wanted, abs=1e-6)


def test_angles_that_are_no_pose_are_two_needles_each_by_itself(tmp_path: Path) -> None:
    path = write_rrd(still(40.0, -20.0, None), tmp_path / "s.rrd")
    assert "/world/0/0/box/shape" not in entities(path)
    for name, wanted in {
        "longitudinal": [0, -np.sin(np.radians(20)), 0, np.cos(np.radians(20))],
        "lateral": [np.sin(np.radians(-10)), 0, 0, np.cos(np.radians(10))],
    }.items():
        turns = columns(path, f"/world/0/0/{name}", "Transform3D:quaternion")
        assert turns["Transform3D:quaternion"][-1][0] == pytest.approx(wanted, abs=1e-6)


def test_box_is_there_only_while_there_is_a_pose(tmp_path: Path) -> None:
    shown = still(40.0, -20.0)
    shown.tilt_data[0].gravity[4:7] = np.nan
    path = write_rrd(shown, tmp_path / "s.rrd")
    sizes = columns(path, "/world/0/0/box/shape", "Boxes3D:half_sizes")
    assert [t - T0 for t in sizes["utc"]] == [0, 4 * 10**9, 7 * 10**9]
    assert [len(size) for size in sizes["Boxes3D:half_sizes"] if size is not None] == [1, 0, 1]
    needle = columns(path, "/world/0/0/lateral/as_sent", "Arrows3D:vectors")
    assert [len(v) for v in needle["Arrows3D:vectors"] if v is not None] == [0, 1, 0]


def test_box_is_not_there_while_nothing_is_heard_of_it(tmp_path: Path) -> None:
    shown = still(40.0, -20.0)
    shown.tilt_data[0].t_ns[6:] += 60 * SECOND
    path = write_rrd(shown, tmp_path / "s.rrd")
    sizes = columns(path, "/world/0/0/box/shape", "Boxes3D:half_sizes")
    assert [t - T0 for t in sizes["utc"]] == [0, 6 * SECOND, 66 * SECOND]
    assert [len(size) for size in sizes["Boxes3D:half_sizes"] if size is not None] == [1, 0, 1]


def test_every_encoder_is_a_shaft_with_its_name_and_turns_the_right_way(tmp_path: Path) -> None:
    """Looking at the shaft's end, which is where z points: clockwise is a negative turn about z."""
    traces = [shaft(600), shaft(600, 6), shaft(600, 6, name="Position again")]
    rows = [replace(trace_row(trace), clockwise=trace.node == 5) for trace in traces[:2]]
    nodes = [node_row(5, name="drum"), node_row(6, name="brake")]
    shown = analysis(nodes=nodes, trace_data=traces, traces=rows)
    path = write_rrd(shown, tmp_path / "s.rrd")
    roots = {name for name in entities(path) if name.count("/") == 3 and "/world/0/" in name}
    assert roots == {"/world/0/0", "/world/0/1"}
    labels = [columns(path, f"{root}/name", "Points3D:labels") for root in sorted(roots)]
    assert [told["Points3D:labels"] for told in labels] == [[["5 drum"]], [["6 brake"]]]
    half = np.radians(traces[0].columns["angle_deg"]) / 2
    for root, sign in zip(sorted(roots), (-1, 1), strict=True):
        turns = columns(path, f"{root}/rotor", "Transform3D:quaternion")["Transform3D:quaternion"]
        assert [turn[0][2] for turn in turns] == pytest.approx(list(sign * np.sin(half)), abs=1e-6)


def test_no_pointer_stands_where_the_shaft_is_not_known(tmp_path: Path) -> None:
    whole = shaft(600)
    keep = (whole.t_ns < at(100)) | (whole.t_ns > at(265))
    cut = replace(
        whole,
        t_ns=whole.t_ns[keep],
        seq=whole.seq[keep],
        segment=whole.segment[keep],
        flags=whole.flags[keep],
        columns={name: column[keep] for name, column in whole.columns.items()},
    )
    path = write_rrd(analysis(trace_data=[cut]), tmp_path / "s.rrd")
    pointer = columns(path, "/world/0/0/rotor/pointer", "Arrows3D:vectors")
    seen = [len(vectors) for vectors in pointer["Arrows3D:vectors"] if vectors is not None]
    assert seen == [1, 0, 1]
    last, first = whole.t_ns[whole.t_ns < at(100)][-1], whole.t_ns[whole.t_ns > at(265)][0]
    assert pointer["utc"] == [int(whole.t_ns[0]), int(last) + SECOND, int(first)]


def test_lines_are_cut_in_the_recording_as_well(tmp_path: Path) -> None:
    path = write_rrd(analysis(trace_data=[shaft(1_000)]), tmp_path / "s.rrd")
    for plot in ("angle_deg", "speed_rpm"):
        line = columns(path, f"/plots/{plot}/node_5/0", "Scalars:scalars")
        holes = [t for t, value in zip(line["utc"], line["Scalars:scalars"], strict=True)
                 if np.isnan(value[0])]  # fmt: skip
        assert any(at(265) <= t < at(266) for t in holes), plot
        values = [value[0] for value in line["Scalars:scalars"]]
        assert np.nanmax(np.abs(np.diff(values))) < 180, plot


def test_difference_of_encoders_and_what_was_changed_are_recorded(tmp_path: Path) -> None:
    nodes = [node_row(5, name="drum"), node_row(6, name="brake")]
    pair = ShaftTrace("can0", 6, "can0", 5, np.array([at(1), at(2)]), np.array([3, 9]),
                      np.array([4.0, 16.0]), np.zeros(2, np.int32))  # fmt: skip
    shown = replace(measured(), nodes=nodes, shaft_data=[pair])
    path = write_rrd(shown, tmp_path / "s.rrd")
    entity = "/plots/encoders_apart_deg/node_6_brake_against_node_5_drum/0"
    assert columns(path, entity, "Scalars:scalars")["Scalars:scalars"] == [[0.0], [12.0]]
    (text,) = columns(path, "/log/changes", "TextLog:text")["TextLog:text"]
    assert text == ["4:10.000  node 5 drum: preset to 1000 (6003h:00) by SDO client on 605h, saved"]


def test_emcy_and_findings_of_a_node_are_marked_on_its_angle(tmp_path: Path) -> None:
    path = write_rrd(bad_day(), tmp_path / "s.rrd")
    root = "/plots/angle_deg/node_10_boom_tilt"
    assert columns(path, f"{root}/4_emcy", "Scalars:scalars")["utc"] == [
        at(249.9),
        at(281.2),
        at(500.1),
    ]
    assert columns(path, f"{root}/5_finding_error", "Scalars:scalars")["utc"] == [at(250)]
    assert "/plots/angle_deg/node_5_shaft/4_emcy" not in entities(path)


def test_an_inclinometer_is_no_shaft(tmp_path: Path) -> None:
    assert not any("rotor" in entity for entity in entities(write_rrd(still(1, 2), tmp_path / "s")))


# -- in the real viewer

LOST, OPERATIONAL, STOPPED, UNKNOWN = (180, 45, 42), (53, 125, 56), (24, 107, 180), (122, 122, 122)
"""Colours of `palette.STATE_COLOURS` as the viewer shades them in a lane."""


WHOLE = ""


def pictures(tool: ModuleType, shown: Analysis, path: Path, *views: str) -> dict[str, Picture]:
    """Pixels of the viewer just after opening, and of some views alone; it must not complain."""
    write_rrd(shown, path)
    with tool.Shot(str(path)) as shot:
        shot.seek("capture", "25%")
        found = {WHOLE: pixels_of(shot.settle())}
        numbers = {view["name"]: view["view_id"] for view in shot.state()["views"]}
        found |= {view: pixels_of(shot.maximized(numbers[view])) for view in views}
        assert shot.problems() == []
    return found


def where(pixels: Picture, colour: tuple[int, int, int]) -> tuple[Picture, Picture]:
    rows, columns = np.nonzero(np.abs(pixels - np.array(colour)).max(-1) <= 3)
    return rows, columns


LANES = "NMT states of 6 nodes"
HIDDEN_TAB, TILT = "PDO response [us] of node 5 shaft", "Angle [deg] of node 10 boom tilt"


@pytest.fixture(scope="module")
def opened(tool: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Picture]:
    path = tmp_path_factory.mktemp("rrd") / "bad_day.rrd"
    return pictures(tool, bad_day(), path, LANES, HIDDEN_TAB, TILT)


@pytest.mark.parametrize(
    ("view", "what", "colour", "least"),
    [
        (WHOLE, "OPERATIONAL", OPERATIONAL, 20_000),
        (WHOLE, "LOST", LOST, 500),
        (WHOLE, "STOPPED", STOPPED, 2_000),
        (LANES, "UNKNOWN", UNKNOWN, 5_000),
        (WHOLE, "shaft angle", LINE_COLOURS[0], 900),
        (WHOLE, "EMCY marker", EMCY_COLOUR, 200),
        (WHOLE, "histogram", (81, 163, 103), 5_000),
        (HIDDEN_TAB, "answers of node 5", LINE_COLOURS[0], 2_000),
        (TILT, "slope long", LINE_COLOURS[0], 1_500),
        (TILT, "slope lateral", LINE_COLOURS[1], 1_500),
        (TILT, "EMCY marker", EMCY_COLOUR, 100),
    ],
)
def test_viewer_shows(
    opened: dict[str, Picture], view: str, what: str, colour: tuple[int, int, int], least: int
) -> None:
    assert len(where(opened[view], colour)[0]) >= least, what


def test_viewer_opens_on_the_whole_capture(opened: dict[str, Picture]) -> None:
    lanes = opened[LANES]
    rows, lane = where(lanes, UNKNOWN)
    lane = lane[np.bincount(rows)[rows] > lanes.shape[1] // 2]
    lost = where(lanes, LOST)[1] - lane.min()
    length = lane.max() - lane.min()
    assert abs(lost.min() / length - 250 / 600) < 0.01
    assert abs(lost.max() / length - 281 / 600) < 0.01


WORLD = "3D at the cursor"


def middle(shape: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Row and column of the middle of a shape below the viewer's menu."""
    at = np.argwhere(shape[60:-60])
    assert len(at) > 100
    centre: NDArray[np.float64] = at.mean(axis=0)
    return centre


@pytest.mark.parametrize("long", [30.0, -30.0])
def test_viewer_tilts_the_box_to_the_right_side(
    tool: ModuleType, tmp_path: Path, long: float
) -> None:
    """x points to the right: a positive longitudinal angle raises the arrow."""
    pixels = pictures(tool, still(long, 0.0), tmp_path / "s.rrd", WORLD)[WORLD]
    bluer = pixels[..., 2] - pixels[..., 0]
    box, arrow = middle(bluer < -60), middle(bluer > 60)
    down, right = arrow - box
    assert right > 0
    assert -down / right == pytest.approx(np.tan(np.radians(long)), abs=0.2)
