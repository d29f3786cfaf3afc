"""What is plotted: lines by quantity, interrupted where nothing is known, with all their peaks."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from syncline_analyzer.results import TRACE_FLAGS, BusLoadRow, GapRow, ShaftTrace, Trace
from syncline_analyzer.views.events import marks
from syncline_analyzer.views.histogram import MAX_HISTOGRAMS, bars_of, histograms
from syncline_analyzer.views.palette import paler
from syncline_analyzer.views.plots import (
    NODES_APART,
    RESPONSES_APART,
    Line,
    Panel,
    panels,
    shown_at_once,
)
from syncline_analyzer.views.thin import envelope, extremes
from tests.analyzer.analysis_builder import (
    SECOND,
    T0,
    analysis,
    at,
    bad_day,
    capture_row,
    emcy_row,
    finding,
    node_row,
    responses,
    series,
    shaft,
    tilt,
)

VALUES = arrays(
    np.float64,
    st.integers(0, 300),
    elements=st.one_of(st.just(np.nan), st.floats(-1e6, 1e6, allow_nan=False)),
)


@given(VALUES, st.integers(2, 100))
@settings(max_examples=200, deadline=None)
def test_thinning_keeps_extremes_ends_of_runs_and_holes(value: np.ndarray, points: int) -> None:
    rows = extremes(value, points)
    kept = value[rows]
    assert (np.diff(rows) > 0).all()
    assert len(rows) <= 2 * points + 1
    assert np.isnan(kept).any() == np.isnan(value).any()
    for one, next_one in pairwise(rows[~np.isnan(kept)].tolist()):
        assert (
            np.isnan(value[one:next_one]).any()
            == np.isnan(value[one:next_one][np.isin(np.arange(one, next_one), rows)]).any()
        )
    if np.isfinite(value).any():
        assert np.nanmin(kept) == np.nanmin(value)
        assert np.nanmax(kept) == np.nanmax(value)


def test_panels_go_by_quantity_angles_first() -> None:
    found = panels(bad_day())
    assert [panel.label for panel in found] == [
        "Angle [deg] of node 5 shaft",
        "Angle [deg] of node 10 boom tilt",
        "Speed [rpm] of node 5 shaft",
        "Bus load [%]",
        "SYNC period [us]",
        "PDO response [us] of node 5 shaft",
        "PDO response [us] of node 10 boom tilt",
    ]
    names = [line.name for line in found[1].lines]
    assert names == ["Slope long (6010h:00)", "Slope lateral (6020h:00)"]
    assert len({line.colour for line in found[1].lines}) == 2


def test_line_is_interrupted_at_cut_and_wrap_but_loses_no_sample() -> None:
    trace = shaft(1000)
    line = panels(analysis(trace_data=[trace]))[0].lines[0]
    holes = np.isnan(line.value)
    cuts = np.flatnonzero(np.diff(trace.segment)) + 1
    wraps = np.flatnonzero(np.abs(np.diff(trace.columns["angle_deg"])) > 180) + 1
    np.testing.assert_array_equal(line.value[~holes], trace.columns["angle_deg"])
    np.testing.assert_array_equal(
        line.t_ns[holes], np.sort(trace.t_ns[np.union1d(cuts, wraps)]) - 1
    )


def turning(rpm: float, count: int, spacing_ms: float = 10.0) -> Trace:
    """A shaft that turns evenly, so slowly sampled as one likes."""
    t_ns = T0 + (np.arange(count) * spacing_ms * 1e6).astype(np.int64)
    unwrapped = (t_ns - T0) / 60e9 * rpm * 360
    columns = {"position": unwrapped, "angle_deg": unwrapped % 360, "unwrapped_deg": unwrapped}
    plain = shaft(count)
    return replace(plain, t_ns=t_ns, columns=columns, segment=np.zeros(count, np.int32))


def holes(line: Line) -> list[int]:
    return [int(t_ns) for t_ns in line.t_ns[np.isnan(line.value)]]


def test_line_is_interrupted_where_the_node_was_lost_or_silent() -> None:
    trace = turning(0.1, 100, 1000.0)
    trace.segment[40:] = 1
    trace.flags[:] = 0
    trace.flags[70] = 1 << TRACE_FLAGS.index("silence")
    line = panels(analysis(trace_data=[trace]))[0].lines[0]
    assert holes(line) == [at(40) - 1, at(70) - 1]
    assert len(line.wraps) == 0


def test_a_step_of_more_than_half_a_turn_is_no_wrap_and_less_may_be_one() -> None:
    """From 50 to 290 it stays within the turn; from 300 to 600 it does not, though it reads 240."""
    way = np.concatenate([np.linspace(first, first + 10, 20) for first in (40.0, 290.0, 600.0)])
    columns = {"position": way, "angle_deg": way % 360, "unwrapped_deg": way}
    trace = replace(turning(1, 60, 1000.0), columns=columns)
    (line,) = panels(analysis(trace_data=[trace]))[0].lines
    assert holes(line) == [at(40) - 1]


def test_where_hardly_a_sample_is_in_the_turn_of_the_one_before_the_line_is_whole() -> None:
    """Less than two samples a turn: broken at each wrap, nothing of the line would be left."""
    trace = turning(200 / 6, 30, 1000.0)
    line = panels(analysis(trace_data=[trace]))[0].lines[0]
    assert len(line.value) == 30
    slower = turning(60 / 6, 60, 1000.0)
    (line,) = panels(analysis(trace_data=[slower]))[0].lines
    assert holes(line) == [at(6 * turn) - 1 for turn in range(1, 10)]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(line.value)), line.wraps)


def test_a_shaft_that_turns_many_times_fills_its_plot_but_is_cut_where_it_is_cut() -> None:
    trace = turning(600, 40_000)
    trace.segment[20_000:] = 1
    line = panels(analysis(trace_data=[trace]))[0].lines[0]
    rows = extremes(line.value, 1_000, line.wraps)
    shown = line.value[rows]
    assert np.isnan(shown).sum() == 1
    assert line.t_ns[rows][np.isnan(shown)].tolist() == [int(trace.t_ns[20_000]) - 1]
    few = turning(1, 40_000)
    line = panels(analysis(trace_data=[few]))[0].lines[0]
    shown = line.value[extremes(line.value, 1_000, line.wraps)]
    assert np.isnan(shown).sum() == 6
    assert np.nanmax(np.abs(np.diff(shown))) < 5


def test_a_tilt_about_level_is_drawn_in_one_piece() -> None:
    signed = tilt(0x601000, "Slope", 40.0)
    sent = replace(signed, value=signed.value % 360,
                   columns={"angle_deg": signed.value % 360, "unwrapped_deg": signed.value})  # fmt: skip
    (line,) = panels(analysis(trace_data=[sent]))[0].lines
    assert line.name == "Slope (6010h:00), -180 to 180"
    np.testing.assert_allclose(line.value[~np.isnan(line.value)], signed.value)
    assert len(holes(line)) == 1
    steep = replace(sent, columns={"angle_deg": signed.value + 200})
    (line,) = panels(analysis(trace_data=[steep]))[0].lines
    assert line.name == "Slope (6010h:00)"
    assert np.nanmin(line.value) > 179


def apart(*stretches: float) -> ShaftTrace:
    """Two encoders, 100 samples in each stretch at so many degrees from one another."""
    count = 100 * len(stretches)
    return ShaftTrace(
        "can0", 6, "can0", 5, T0 + np.arange(count) * SECOND // 10, np.arange(count),
        np.repeat(np.array(stretches), 100), np.repeat(np.arange(len(stretches)), 100).astype(np.int32),
    )  # fmt: skip


def test_difference_of_two_encoders_counts_from_the_start_without_whole_turns() -> None:
    nodes = [node_row(5, name="drum"), node_row(6, name="brake")]
    shown = analysis(nodes=nodes, shaft_data=[apart(12.5, 24.5, 72_013.0)],
                     emcy=[emcy_row(5), emcy_row(6), emcy_row(7)])  # fmt: skip
    (panel,) = panels(shown)
    assert panel.label == "Encoders apart [deg] of node 6 brake against node 5 drum"
    (line,) = panel.lines
    assert line.name == "node 6 brake ahead of node 5 drum since the start, presets included"
    assert np.unique(line.value[~np.isnan(line.value)]).tolist() == [0.0, 0.5, 12.0]
    assert holes(line) == [at(10) - 1, at(20) - 1]
    assert [row.node for row in panel.told(shown).emcy] == [5, 6]
    assert not panel.is_timing


def test_no_line_is_drawn_across_a_capture_gap() -> None:
    capture = capture_row(gaps=[GapRow(at(100), at(200), "adapter lost", None)])
    load = series("bus load", "%", np.full(601, 30.0))
    keep = (load.t_ns < at(100)) | (load.t_ns >= at(200))
    cut = type(load)(load.bus, load.name, load.unit, load.t_ns[keep], load.value[keep])
    line = panels(analysis(capture=capture, series=[cut]))[0].lines[0]
    assert line.t_ns[np.isnan(line.value)].tolist() == [at(200) - 1]


def test_one_outlier_does_not_flatten_the_jitter_but_angles_show_all() -> None:
    period = 10_000 + np.random.default_rng(1).normal(0, 10, 1000)
    period[500] = 90e6
    panel = panels(analysis(series=[series("SYNC 080h period", "us", period)]))[0]
    low, high = panel.limits()
    assert 9_000 < low < 9_990
    assert 10_010 < high < 11_000
    slope = tilt(0x601000, "Slope", 40.0)
    slope.value[7] = 89.0
    assert panels(analysis(trace_data=[slope]))[0].limits()[1] > 89.0


@pytest.mark.parametrize("value", [[], [np.nan], [5.0], [0.0, 0.0]])
def test_limits_leave_room_also_around_nothing(value: list[float]) -> None:
    panel = panels(analysis(series=[series("SYNC 080h period", "us", np.array(value))]))[0]
    low, high = panel.limits()
    assert low < high
    assert low <= panel.markers_height() <= high


def test_names_tell_the_bus_where_there_are_several() -> None:
    shown = analysis(capture=capture_row(buses=["can0", "can1"]), responses=[responses(count=10)])
    assert panels(shown)[0].label == "PDO response [us] of can0 node 10"


def test_what_an_answer_waited_lies_behind_it_in_a_paler_colour() -> None:
    waited, answer = panels(analysis(responses=[responses(count=50)]))[0].lines
    assert (waited.band, answer.band) == (True, False)
    assert (waited.name, answer.name) == ("TPDO1 (18Ah) waited at most", "TPDO1 (18Ah)")
    assert waited.value.max() == 100.0
    assert waited.colour == paler(answer.colour)
    without = replace(responses(count=50), waiting_us=np.full(50, np.nan))
    (alone,) = panels(analysis(responses=[without]))[0].lines
    assert alone.name == "TPDO1 (18Ah)"


@pytest.mark.parametrize(("source", "marked"), [("estimated", True), ("recorded", False)])
def test_figures_that_rest_on_an_estimated_bit_rate_say_so(source: Any, marked: bool) -> None:
    load = BusLoadRow("can0", 250_000, 20.0, 30.0, 500.0, bitrate_source=source)
    shown = analysis(bus_load=[load], series=[series("bus load", "%", np.full(9, 20.0))],
                     responses=[responses(count=50)])  # fmt: skip
    bus, answers = panels(shown)
    assert ("estimated" in bus.lines[0].name) == marked
    assert ("estimated" in answers.lines[0].name) == marked
    assert "estimated" not in answers.lines[1].name


def test_short_windows_of_the_load_lie_behind_the_seconds_in_one_plot() -> None:
    load = [series("bus load", "%", np.full(600, 20.0)),
            series("bus load in 100 ms", "%", np.full(6_000, 21.0))]  # fmt: skip
    (panel,) = panels(analysis(series=load))
    assert [(line.name, line.band) for line in panel.lines] == [
        ("bus load in 100 ms", True),
        ("bus load in 1 s", False),
    ]
    assert panel.limits()[0] <= 0.0


def test_of_many_nodes_those_that_answer_least_evenly_have_a_plot() -> None:
    steady = [replace(responses(0x180 + n, n, 100), response_us=np.full(100, 500.0))
              for n in range(1, 41)]  # fmt: skip
    steady[29] = responses(0x180 + 30, 30, 100)
    found = panels(analysis(responses=steady))
    kept = shown_at_once(found, analysis())
    assert (len(found), len(kept)) == (40, RESPONSES_APART)
    assert "PDO response [us] of node 30" in [panel.label for panel in kept]


def test_of_many_nodes_those_in_trouble_have_a_plot_however_evenly_they_answer() -> None:
    uneven = [responses(0x180 + n, n, 100) for n in range(1, 41)]
    uneven[6] = replace(uneven[6], response_us=np.full(100, 500.0))
    told = analysis(responses=uneven, findings=[finding(node=7, severity="warning")])
    kept = shown_at_once(panels(told), told)
    assert len(kept) == RESPONSES_APART
    assert "PDO response [us] of node 7" in [panel.label for panel in kept]


def test_of_many_pdos_those_of_nodes_in_trouble_have_a_histogram() -> None:
    answers = [responses(0x180 + n, n, 100) for n in range(1, 41)]
    lost = finding(node=30, severity="error")
    found = [each.node for each, _ in histograms(analysis(responses=answers, findings=[lost]))]
    assert found == [*range(1, MAX_HISTOGRAMS), 30]


@given(VALUES, st.integers(2, 100))
@settings(max_examples=200, deadline=None)
def test_envelope_holds_every_value_and_is_open_at_the_holes(
    value: np.ndarray, points: int
) -> None:
    t_ns = np.arange(len(value)) * 10
    at_ns, outline = envelope(t_ns, value, points)
    stretches = np.split(outline, np.flatnonzero(np.isnan(outline)))
    known = np.isfinite(value)
    edges = np.flatnonzero(np.diff(known.astype(int), prepend=0) == 1)
    assert len([s for s in stretches if np.isfinite(s).any()]) == len(edges)
    if known.any():
        assert (np.nanmin(outline), np.nanmax(outline)) == (np.nanmin(value), np.nanmax(value))
        assert (at_ns.min(), at_ns.max()) == (t_ns[known].min(), t_ns[known].max())
    assert len(at_ns) == len(outline)


def test_bars_have_the_area_of_the_answers_and_leave_out_far_ones_openly() -> None:
    shown = responses()
    counts = np.array([0, 0, 9_000, 2_000, 4_000, 0, 0, 0, 1])
    edges = np.array([0.0, 1, 100, 110, 120, 160, 200, 1_000, 10_000, 6_000_000])
    bars = bars_of(replace(shown, histogram=counts, edges_us=edges))
    assert bars.middle_us.tolist() == [105.0, 115.0, 140.0]
    assert (bars.per_us * bars.width_us).tolist() == [9_000.0, 2_000.0, 4_000.0]
    assert bars.left_out == 1
    assert "1 outlier left out" in bars.label


def test_bars_of_one_answer_show_it() -> None:
    bars = bars_of(replace(responses(), histogram=np.array([0, 1, 0]), edges_us=np.arange(4.0)))
    assert bars.middle_us.tolist() == [1.5]
    assert bars.left_out == 0


def test_answers_are_not_joined_across_a_silence() -> None:
    shown = responses(count=1_000)
    keep = (shown.t_ns < at(100)) | (shown.t_ns > at(200))
    cut = replace(
        shown,
        t_ns=shown.t_ns[keep],
        seq=shown.seq[keep],
        response_us=shown.response_us[keep],
        waiting_us=np.where(np.arange(keep.sum()) % 5, np.nan, 100.0),
    )
    for line in panels(analysis(responses=[cut]))[0].lines:
        assert np.isnan(line.value).sum() == 1, line.name
    for line in panels(analysis(responses=[shown]))[0].lines:
        assert np.isnan(line.value).sum() == 0, line.name


def test_a_bar_far_from_all_others_is_left_out_and_counted() -> None:
    edges = np.array([0.0, 10, 20, 30, 5_000_000, 6_000_000])
    counts = np.array([100, 500, 300, 0, 5])
    bars = bars_of(replace(responses(), histogram=counts, edges_us=edges))
    assert bars.middle_us.tolist() == [5.0, 15.0, 25.0]
    assert bars.left_out == 5


def test_many_nodes_share_one_plot_that_names_them() -> None:
    many = [tilt(0x601000, "Slope", 40.0, count=10, node=n) for n in range(1, NODES_APART + 2)]
    (panel,) = panels(analysis(trace_data=many))
    assert panel.label == "Angle [deg]"
    assert panel.lines[2].name == "node 3 Slope (6010h:00)"


def test_plot_of_a_node_is_marked_with_its_own_emcy_only() -> None:
    shaft_plot, tilt_plot, _, load_plot, *_ = panels(bad_day())
    assert marked(shaft_plot, "EMCY") == 0
    assert marked(tilt_plot, "EMCY") == 3
    assert marked(load_plot, "EMCY") == 6
    assert marked(shaft_plot, "finding: info") == 1


def marked(panel: Panel, name: str) -> int:
    return sum(len(mark.moments) for mark in marks(panel.told(bad_day())) if mark.name == name)
