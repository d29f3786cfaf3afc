"""What a capture holds whose clock was set back while it was recorded: nothing of it vanishes."""

from itertools import pairwise
from pathlib import Path

import pytest

from syncline_analyzer.extent import MOST_STEPS, Extent, Stretch
from syncline_analyzer.info import inspect
from syncline_analyzer.results import Analysis
from syncline_analyzer.session import open_session
from syncline_analyzer.views.info_text import info_text
from syncline_analyzer.views.json_view import to_object
from syncline_analyzer.views.report_html import report
from syncline_analyzer.views.screen import screen
from syncline_schemas.batch import FrameBatch, Gap
from tests.analyzer.control_runs import MS, Row, frame
from tests.analyzer.whole_run import T0, beats, found, ids, whole

SECOND = 1000 * MS
HOUR = -3_600 * SECOND


def set_back(rows: list[Row], by_ns: int = HOUR, at_ms: float = 30_000) -> list[Row]:
    """Rows as a recorder stamps them whose clock is set at that moment."""
    rows = sorted(rows, key=lambda row: row[0])
    return [(t + by_ns * (t >= at_ms * MS), *rest) for t, *rest in rows]  # type: ignore[misc]


def extent(*batches: list[tuple[int, int]]) -> list[Stretch]:
    """Stretches of frames given as (s, bus), in one batch each."""
    found = Extent()
    for rows in batches:
        frames = [(s * SECOND, bus, 0x123, 0, 0, b"") for s, bus in rows]
        found.update(FrameBatch.from_rows(frames))
    return [Stretch(start // SECOND, end // SECOND) for start, end in found.stretches]


@pytest.fixture(scope="module")
def summer_time() -> Analysis:
    """Two nodes for 80 s; after 30 s the recorder's clock goes back by an hour."""
    return whole(set_back([*beats(5, 0, 80_000), *beats(6, 50, 80_000)]), in_order=False)


def test_steps_back_cut_a_capture_into_stretches() -> None:
    rows = [(50, 0), (60, 0), (10, 0), (30, 0)]
    assert extent(rows) == extent(rows[:2], rows[2:]) == [(50, 60), (10, 30)]
    assert extent([(1, 0), (2, 0), (2, 0), (3, 0)]) == []


def test_buses_of_one_clock_step_once() -> None:
    rows = [(50, 0), (51, 1), (10, 1), (11, 0), (12, 1)]
    assert extent(rows) == [(50, 51), (10, 12)]


def test_buses_written_one_after_the_other_are_no_step() -> None:
    assert extent([(1, 0), (2, 1), (9, 0), (3, 1), (10, 1), (20, 0), (11, 1), (20, 1)]) == []


def test_a_bus_that_is_heard_first_after_the_step_hides_it_not() -> None:
    assert extent([(50, 0), (60, 0), (10, 1), (11, 0)]) == [(50, 60), (10, 11)]


def test_stamps_that_run_back_again_and_again_are_disorder() -> None:
    assert extent([(s, 0) for _ in range(MOST_STEPS + 2) for s in (5, 1)]) == []


def test_what_was_recorded_counts_whole(summer_time: Analysis) -> None:
    capture = summer_time.capture
    assert capture.duration_ns == pytest.approx(80 * SECOND, abs=SECOND)
    assert capture.end_ns == pytest.approx(T0 + 30 * SECOND, abs=SECOND)
    assert ids(summer_time) == {"clock.step_back"}
    stretches = to_object(summer_time, ())["capture"]["stretches"]
    assert [set(each) for each in stretches] == [{"start_ns", "end_ns"}] * 2
    assert "stretches" not in to_object(whole(beats(5, 0, 9_000)), ())["capture"]


def test_states_last_on_both_sides_of_the_step(summer_time: Analysis) -> None:
    of_5 = [row for row in summer_time.nmt_states if row.node == 5]
    assert [row.state for row in of_5] == ["OPERATIONAL", "OPERATIONAL"]
    lasted = [(row.end_ns - row.start_ns) / SECOND for row in of_5]
    assert lasted == pytest.approx([30, 50], abs=1)
    assert "step back of the clock" in of_5[1].cause
    assert summer_time.nodes[0].state_share == {"OPERATIONAL": 1.0}


def test_a_change_after_the_step_leaves_the_state_before_it() -> None:
    stopped = [(t, *r[:4], b"\x04") for t, *r in beats(5, 60_000, 80_000)]
    rows = [*beats(5, 0, 60_000), *stopped, *beats(6, 50, 80_000)]
    told = whole(set_back(rows), in_order=False)  # type: ignore[arg-type]
    of_5 = [row for row in told.nmt_states if row.node == 5]
    assert [row.state for row in of_5] == ["OPERATIONAL", "OPERATIONAL", "STOPPED"]
    assert told.nodes[0].state_share["STOPPED"] == pytest.approx(0.25, abs=0.01)
    assert screen(told, width=60).count("5 " + "O" * 20) == 1
    assert 'class="letter"' not in report(told)


@pytest.mark.parametrize(("byte", "state"), [(0x7F, "PRE-OPERATIONAL"), (0x05, "OPERATIONAL")])
def test_a_start_just_before_the_step_hides_no_state_after_it(byte: int, state: str) -> None:
    idle = [(t, *r[:4], b"\x7f") for t, *r in beats(6, 50, 29_900)]
    then = [(t, *r[:4], bytes([byte])) for t, *r in beats(6, 30_050, 80_000)]
    rows = [*beats(5, 0, 80_000), *idle, frame(29_950, 0, "0106"), *then]
    told = whole(set_back(rows), in_order=False)  # type: ignore[arg-type]
    last = [row for row in told.nmt_states if row.node == 6][-1]
    assert (last.state, last.certainty) == (state, "observed")


def test_a_node_that_boots_some_time_after_the_step_is_not_told_before_it() -> None:
    beaten = [(t, *r[:4], b"\x7f") for t, *r in beats(6, 51_000, 80_000)]
    rows = [*beats(5, 0, 80_000), *beats(6, 50, 20_000), frame(50_000, 0x706, "00"), *beaten]
    told = whole(set_back(rows), in_order=False)  # type: ignore[arg-type]
    last = [row for row in told.nmt_states if row.node == 6][-1]
    assert last.state == "PRE-OPERATIONAL"
    assert (last.end_ns - last.start_ns) / SECOND == pytest.approx(30, abs=1)


def test_a_number_that_its_device_left_before_the_step_goes_on_unknown() -> None:
    given = [(20_000, 0x7E5, "1106"), (20_002, 0x7E4, "1100")]
    lss = [frame(t, can_id, data.ljust(16, "0")) for t, can_id, data in given]
    reset = [frame(20_100, 0, "8107"), frame(20_400, 0x706, "00")]
    nodes = [*beats(5, 0, 80_000), *beats(7, 50, 20_050), *beats(6, 20_500, 80_000)]
    told = whole(set_back([*nodes, *lss, *reset]), in_order=False)
    of_7 = [row for row in told.nmt_states if row.node == 7]
    assert [row.state for row in of_7][-2:] == ["UNKNOWN", "UNKNOWN"]
    lasted = [(row.end_ns - row.start_ns) / SECOND for row in of_7[-2:]]
    assert lasted == pytest.approx([10, 50], abs=1)
    assert "step back of the clock" in of_7[-1].cause


@pytest.mark.parametrize(("until_ms", "state"), [(29_800, "UNKNOWN"), (80_000, "OPERATIONAL")])
def test_the_state_of_a_node_that_is_not_heard_after_the_step(until_ms: int, state: str) -> None:
    rows = set_back([*beats(5, 0, 80_000), *beats(6, 50, until_ms)])
    last = [row for row in whole(rows, in_order=False).nmt_states if row.node == 6][-1]
    assert last.state == state
    assert (last.end_ns - last.start_ns) / SECOND == pytest.approx(50, abs=1)


@pytest.mark.parametrize(
    ("again_ms", "states"),
    [(60_000, ["OPERATIONAL", "UNKNOWN", "OPERATIONAL"]), (30_000, ["OPERATIONAL"])],
)
def test_the_state_of_a_node_that_is_heard_long_after_the_step(
    again_ms: int, states: list[str]
) -> None:
    rows = set_back([*beats(5, 0, 80_000), *beats(6, 50, 29_900), *beats(6, again_ms + 50, 80_000)])
    told = whole(rows, in_order=False)
    of_6 = [row for row in told.nmt_states if row.node == 6 and row.start_ns < T0]
    assert [row.state for row in of_6] == states
    assert of_6[0].start_ns == T0 + 30 * SECOND + HOUR
    assert all(a.end_ns == b.start_ns for a, b in pairwise(of_6))
    if len(of_6) > 1:
        assert (of_6[1].end_ns - of_6[1].start_ns) / SECOND == pytest.approx(30, abs=1)


def test_a_moment_before_the_begin_says_how_long_after_the_step_it_is() -> None:
    lost = [*beats(5, 0, 80_000), *beats(6, 50, 50_000)]
    (finding,) = found(whole(set_back(lost), in_order=False), "nmt.node_lost")
    assert "from -3550.050 s (19.950 s after the clock was set back) on" in finding.text
    once = set_back(lost)
    twice = [(t + HOUR * (n >= len(once) - 500), *rest) for n, (t, *rest) in enumerate(once)]
    again: list[Row] = twice  # type: ignore[assignment]
    (finding,) = found(whole(again, in_order=False), "nmt.node_lost")
    assert "(9.950 s after step back 2 of the clock) on" in finding.text


def test_a_node_that_sends_pdos_after_the_step_is_heard() -> None:
    """Its heartbeat comes again 30 s after the step."""
    pdos = [frame(t, 0x186, "01") for t in range(20, 80_000, 100)]
    rows = [*beats(5, 0, 80_000), *beats(6, 50, 29_900), *beats(6, 60_050, 80_000), *pdos]
    told = whole(set_back(rows), in_order=False)
    of_6 = [row for row in told.nmt_states if row.node == 6 and row.start_ns < T0]
    assert [row.state for row in of_6] == ["OPERATIONAL"]


def test_silences_before_the_step_are_told_of_no_time_after_it() -> None:
    """Node 7, without error control, is reset; node 6 is silent up to a gap."""
    bound = [frame(t, 0x187, "01") for t in range(10, 20_000, 100)]
    nodes = [*beats(5, 0, 80_000), *beats(6, 50, 20_000), *beats(6, 30_050, 79_000)]
    rows = set_back([*nodes, *beats(8, 70, 29_900), *bound, frame(20_000, 0, "8107")])
    assert not [each for each in whole(rows, in_order=False).findings if "for -" in each.text]
    told = whole(rows, Gap(24_000 * MS, 24_100 * MS, "overrun"), in_order=False)
    (finding,) = [each for each in told.findings if each.id == "nmt.node_lost"]
    assert "Node 6 is silent from +19.950 s on" in finding.text


def test_pictures_say_what_they_do_not_show(summer_time: Analysis) -> None:
    told = "The clock stepped back: 50 s stamped before the first frame are not drawn."
    shown = screen(summer_time, width=120)
    assert told in shown
    assert "; then the clock stepped back: " in shown
    assert "5 " + "O" * 100 in shown
    assert told in report(summer_time)
    again = screen(whole(set_back(beats(5, 0, 80_000), -10 * SECOND), in_order=False), width=120)
    assert "what comes at the same times again is drawn over what was there" in again
    assert "stepped back" not in screen(whole(beats(5, 0, 9_000)), width=120)


def test_info_and_the_analysis_tell_the_same_extent(tmp_path: Path) -> None:
    path = tmp_path / "set.log"
    lines = (
        f"({(T0 + t) / 1e9:.6f}) can0 {can_id:03X}#{data.hex()}\n"
        for t, _, can_id, _, _, data in set_back([*beats(5, 0, 80_000), *beats(6, 50, 80_000)])
    )
    path.write_text("".join(lines))
    info, capture = inspect(path), open_session(path).analysis.capture
    assert info.stretches == capture.stretches
    assert info.duration_ns == capture.duration_ns == pytest.approx(80 * SECOND, abs=SECOND)
    assert "2026-09-21 14:13:20.000000 UTC to 2026-09-21 14:13:49.9" in info_text(info)
    assert "; then the clock stepped back: 2026-09-21 13:13:50" in info_text(info)
