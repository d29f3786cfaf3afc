"""How far two encoders on one shaft are apart over time, as it is plotted."""

import numpy as np

from tests.analyzer.test_angle_motion import TURN, encoder, moved, other, swinging, twins
from tests.analyzer.whole_run import write


def test_a_coupling_that_slips_shows_as_a_step_in_the_difference() -> None:
    slipped = moved(other(), 30_000, round(TURN * 12 / 360))
    analysis, row = twins(encoder(swinging, seconds=60.0), slipped)
    (pair,) = analysis.shaft_data
    assert (pair.node, pair.other) == (6, 5)
    assert len(pair.t_ns) == row.compared
    since_s = (pair.t_ns - analysis.capture.first_ns) / 1e9
    before, after = pair.difference_deg[since_s < 29.9], pair.difference_deg[since_s > 30.1]
    assert np.abs(before - (row.difference_deg or 0.0)).max() < 1.0
    assert abs(np.median(after) - np.median(before) - 12.0) < 0.3
    assert set(pair.segment.tolist()) == {pair.segment[0]}


def test_a_preset_begins_a_new_stretch_of_the_difference() -> None:
    rows = moved(other(), 30_010, round(TURN * 12 / 360))
    target = int(np.round(swinging(np.array([30.0]))[0] * TURN)) + round(TURN * 12 / 360)
    analysis, _ = twins(encoder(swinging, seconds=60.0), rows, write(30_000, 6, 0x6003, 0, target))
    (pair,) = analysis.shaft_data
    (edge,) = np.flatnonzero(np.diff(pair.segment))
    assert abs((pair.t_ns[edge + 1] - analysis.capture.first_ns) / 1e9 - 30.0) < 0.2
