"""The captures of a simulated fleet show what was planted in them, and nothing else."""

from pathlib import Path

import numpy as np
import pytest

from syncline_analyzer import open_session
from syncline_analyzer.results import Analysis
from syncline_samples.fleet import (
    EMCY_NODE,
    HEALTHY,
    HEARTBEAT_NODE,
    LATE_NODE,
    NOISY_NODE,
    RESET_NODE,
    WORN_NODE,
    Planted,
    Template,
    fleet_captures,
    write_capture,
)

DAY_NS = 86_400 * 10**9


@pytest.fixture(scope="module")
def template() -> Template:
    return Template(20.0)


def analysis(folder: Path, template: Template, planted: Planted) -> Analysis:
    return open_session(write_capture(folder, template, 0, 0, planted)).analysis


def alarms(found: Analysis) -> list[tuple[str, int | None]]:
    return [(each.id, each.node) for each in found.findings if each.severity != "info"]


def late_us(found: Analysis) -> float:
    row = next(row for row in found.pdos if row.cob_id == 0x280 + LATE_NODE)
    assert row.response_us is not None
    return row.response_us.median


def test_a_healthy_capture_has_no_alarms_on_any_day(tmp_path: Path, template: Template) -> None:
    plan = {(0, 0): HEALTHY, (0, 2): HEALTHY, (1, 0): Planted(share=0.5)}
    paths = list(fleet_captures(tmp_path, 2, 3, lambda *at: plan.get(at), template))
    found = [open_session(path).analysis for path in paths]
    assert [path.parent.name for path in paths] == ["machine-000"] * 2 + ["machine-001"]
    assert [alarms(each) for each in found] == [[], [], []]
    starts = [each.capture.start_utc_ns or 0 for each in found]
    assert starts[1] - starts[0] == 2 * DAY_NS
    assert found[2].capture.frames == round(len(template.frames) / 2)


def test_what_is_planted_shows_on_its_node(tmp_path: Path, template: Template) -> None:
    healthy = analysis(tmp_path, template, HEALTHY)
    found = analysis(tmp_path, template, Planted(resets=2, emcys=3, eeprom_writes=1234))
    assert alarms(found).count(("nmt.unexpected_reset", RESET_NODE)) == 2
    raised = [row for row in found.emcy if row.transition == "raised"]
    assert [row.node for row in raised] == [EMCY_NODE] * 3
    (wear,) = found.device_health
    assert (wear.node, wear.last_value) == (WORN_NODE, 1234)
    late = analysis(tmp_path, template, Planted(late_us=500))
    assert late_us(late) == pytest.approx(late_us(healthy) + 500, abs=100)
    slow = analysis(tmp_path, template, Planted(slower_heartbeat=0.1))
    beat = next(row for row in slow.error_control_periods if row.node == HEARTBEAT_NODE)
    assert beat.period_us is not None
    assert beat.period_us.median == pytest.approx(550_000, rel=0.01)
    assert not [each.id for each in slow.findings], "a slow heartbeat is no restart"
    jittery = analysis(tmp_path, template, Planted(sync_jitter_us=300))
    assert jittery.sync[0].jitter_us is not None
    # The period is the difference of two stamps.
    assert jittery.sync[0].jitter_us.std == pytest.approx(300 * 2**0.5, rel=0.2)
    noisy = analysis(tmp_path, template, Planted(noise_counts=5))
    assert all(alarms(each) == [] for each in (late, slow, jittery))
    assert _noise(noisy) > 2 * _noise(healthy)


def _noise(found: Analysis) -> float:
    """How far neighbouring positions of the noisy encoder are apart while it stands still."""
    trace = next(each for each in found.trace_data if each.node == NOISY_NODE)
    return float(np.median(np.abs(np.diff(trace.raw.astype(np.int64), 2)[:200])))


def test_no_frame_ends_sooner_than_it_can_be_sent(template: Template) -> None:
    planted = Planted(resets=1, emcys=5, late_us=900, sync_jitter_us=400, slower_heartbeat=0.1)
    frames = template.capture(0, planted, 3)
    least_ns = (47 + 8 * frames.dlc[1:].astype(np.int64)) * 2000
    assert (np.diff(frames.t_ns) >= least_ns).all()
