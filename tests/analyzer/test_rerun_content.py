"""What the Rerun layout puts first, and that nothing is left out without a word."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from syncline_analyzer.results import Analysis, NmtStateRow, SyncRow
from syncline_analyzer.session import open_session
from syncline_analyzer.views import events
from syncline_analyzer.views.histogram import period_bars
from syncline_analyzer.views.markdown import findings_markdown
from syncline_analyzer.views.rerun_lanes import lanes_of
from syncline_analyzer.views.rerun_logs import logs_of
from syncline_analyzer.views.rerun_plots import devices_of, panels_of
from syncline_analyzer.views.rerun_sink import Axis
from syncline_analyzer.views.rerun_view import write_rrd
from syncline_analyzer.views.rerun_world import MAX_SHAPES, worlds_of
from syncline_analyzer.views.words import Clock
from syncline_samples.forty_nodes import forty_nodes
from syncline_samples.generate import mcap_capture
from tests.analyzer.analysis_builder import (
    analysis,
    at,
    capture_row,
    finding,
    many_nodes,
    node_row,
    series,
    usual_states,
)
from tests.analyzer.whole_run import whole


@pytest.fixture(scope="module")
def forty(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    path = tmp_path_factory.mktemp("forty") / "forty.mcap"
    path.write_bytes(mcap_capture(forty_nodes().run()))
    return open_session(path).analysis


def test_nodes_with_faults_come_first_and_all_are_there(forty: Analysis) -> None:
    first, everything = lanes_of(forty)
    assert [entity.split("/")[-1] for entity in first.entities] == [
        "007_winder_A", "012_guide_roller_B", "023_winder_C", "040_cabinet_E",
    ]  # fmt: skip
    assert len(everything.entities) == 41
    assert first.title == "NMT states: 4 nodes of 41 with events"
    devices = devices_of(forty, panels_of(forty, Axis(Clock.of(forty.capture))))
    assert [device.title for device in devices[:3]] == [
        "12 guide roller B",
        "23 winder C",
        "7 winder A",
    ]
    assert len(devices) == 35
    assert {len(device.plots) for device in devices} == {2}, "angle and speed"


def test_every_device_is_in_a_3d_view(forty: Analysis, tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    worlds = worlds_of(forty)
    assert [world.title for world in worlds] == [f"3D at the cursor, {n} of 3" for n in (1, 2, 3)]
    path = write_rrd(forty, tmp_path / "s.rrd")
    found = {chunk.entity_path for chunk in RrdReader(path).stream()}
    names = [name for name in found if name.startswith("/world/") and name.endswith("/name")]
    assert len(names) == 35 > MAX_SHAPES


def test_few_lanes_and_a_healthy_bus_have_one_view() -> None:
    assert len(lanes_of(many_nodes(40))) == 1
    few = analysis(nodes=[node_row(5)], nmt_states=usual_states(5), findings=[finding()])
    assert [lanes.title for lanes in lanes_of(few)] == ["NMT states of 1 node"]
    assert lanes_of(analysis()) == []


def test_a_node_without_a_name_is_called_by_its_device(tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    shown = analysis(nodes=[node_row(5, device="jn2100")], nmt_states=usual_states(5))
    path = write_rrd(shown, tmp_path / "s.rrd")
    assert "/nmt/can0/005_jn2100" in {chunk.entity_path for chunk in RrdReader(path).stream()}


def test_logs_that_tell_something_come_first_and_silent_ones_say_so(tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    shown = analysis(findings=[finding()])
    titles = [log.title for log in logs_of(shown)]
    assert titles[:2] == ["NMT log", "Finding log"]
    path = write_rrd(shown, tmp_path / "s.rrd")
    told = {
        chunk.entity_path: chunk.to_record_batch().column("TextLog:text").to_pylist()
        for chunk in RrdReader(path).stream()
        if chunk.entity_path.startswith("/log/")
    }
    assert told["/log/emcy"] == [["0:00.000  No EMCY message in this capture."]]
    assert told["/log/sdo"] == [["0:00.000  No SDO transfer in this capture."]]


def test_sdo_log_counts_what_it_does_not_list(
    forty: Analysis, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events, "MAX_TRANSFERS", 5)
    told = list(events.sdo_events(forty))
    left = [event.text for event in told if "not listed" in event.text]
    writes, reads = len(forty.sdo.ok.writes), len(forty.sdo.ok.reads)
    assert left == [f"{n - 5} further transfers like this not listed" for n in (writes, reads)]


def test_histogram_of_syncs_needs_every_period() -> None:
    period = 10_000 + np.random.default_rng(3).normal(0, 5, 1_000)
    period[500] = 20_000
    shown = analysis(
        series=[series("SYNC 080h period", "us", period)],
        sync=[SyncRow("can0", 0x80, 1_001, None, 1, 0)],
    )
    ((bus, bars),) = period_bars(shown)
    assert (bus, bars.left_out) == ("can0", 1)
    assert (bars.per_us * bars.width_us).sum() == pytest.approx(999)
    assert bars.label == "can0 080h SYNC period, 1 outlier left out"
    thinned = replace(shown, sync=[SyncRow("can0", 0x80, 90_000, None, 1, 0)])
    assert period_bars(thinned) == []


def test_histogram_of_a_long_capture_counts_the_syncs_that_no_plot_has_room_for() -> None:
    count, gap = 60_000, 30_000
    jitter = np.random.default_rng(5).normal(0, 20_000, count).astype(np.int64)
    times = [n * 10_000_000 + int(jitter[n]) for n in range(1, count) if n != gap]
    told = whole([(t_ns, 0, 0x80, 0, 0, b"") for t_ns in times])
    assert len(told.series[0].value) < 0.9 * count
    ((_, bars),) = period_bars(told)
    assert bars.label == "can0 080h SYNC period, middle 99 %"
    assert (bars.per_us * bars.width_us).sum() == pytest.approx(0.99 * count, rel=0.002)
    assert bars.middle_us.min() > 9_800
    assert bars.middle_us.max() < 10_200


def test_findings_are_listed_before_they_are_told_and_name_the_bus() -> None:
    rows = [finding(second=float(n), start_ns=at(n), end_ns=at(n)) for n in range(1, 40)]
    text = findings_markdown(analysis(capture=capture_row(buses=["can0", "can1"]), findings=rows))
    lines = text.splitlines()
    assert lines[0] == "### 39 errors"
    assert lines[2].startswith("- **1 ERROR** 0:01.000 can0: ")
    assert "- and 9 more, told below" in lines
    assert text.count("**Check next**") == 39


def test_a_state_of_a_millisecond_has_a_marker_and_a_line(tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    rows = [
        NmtStateRow("can0", 5, "OPERATIONAL", at(0), at(300), "heartbeat", "observed", 1),
        NmtStateRow("can0", 5, "LOST", at(300), at(300.001), "silence", "implied", 2),
        NmtStateRow("can0", 5, "OPERATIONAL", at(300.001), at(600), "heartbeat", "observed", 3),
    ]
    path = write_rrd(analysis(nodes=[node_row(5)], nmt_states=rows), tmp_path / "s.rrd")
    times = {
        chunk.entity_path: chunk.to_record_batch().column("utc").cast("int64").to_pylist()
        for chunk in RrdReader(path).stream()
        if chunk.entity_path in ("/events/6_node_lost", "/log/nmt")
        and "utc" in chunk.timeline_names
    }
    assert times["/events/6_node_lost"] == [at(300)]
    assert at(300) in times["/log/nmt"]
