"""The summary for a terminal: what it says, in which order, and that nothing can take it over."""

import io
from typing import Any

import pytest
from rich.console import Console

from syncline_analyzer.results import Link, NmtStateRow
from syncline_analyzer.views.lanes import cells
from syncline_analyzer.views.markdown import findings_markdown
from syncline_analyzer.views.terminal import console_for
from syncline_analyzer.views.text import print_summary, summary
from tests.analyzer.analysis_builder import (
    SECOND,
    T0,
    analysis,
    at,
    bad_day,
    capture_row,
    emcy_row,
    finding,
    many_nodes,
    measured,
    node_row,
    services,
    state_rows,
    untimed,
    usual_states,
)
from tests.analyzer.busy_bus import busy_bus


def line_with(text: str, *words: str) -> str:
    found = [line for line in text.splitlines() if all(word in line for word in words)]
    assert found, f"no line with {words}"
    return found[0]


def test_findings_come_first_with_cause_and_evidence() -> None:
    text = summary(bad_day())
    assert "2 errors, 1 warning, 1 note" in text
    assert line_with(text, "ERROR", "node 10 boom tilt", "4:10.000 to 4:41.000 (31 s)")
    assert line_with(text, "likely cause", "Supply or wiring")
    assert line_with(text, "check next", "Connector")
    assert line_with(text, "frames 175000, 196700", "nmt.node_lost")
    assert text.index("nmt.node_lost") < text.index("Nodes\n")


def test_tables_write_codes_in_hexadecimal() -> None:
    text = summary(bad_day())
    assert line_with(text, "18Ah", "node 10 TPDO1", "402/655/1480", "3 missed, 2 late")
    assert line_with(text, "080h", "SYNC", "1 missing")
    assert line_with(text, "4:41.200", "8130h", "life guard", "register 11h")
    assert line_with(text, "6002h:00", "abort 06020000h")
    assert line_with(text, "6004h:00", "1 jump")
    assert line_with(text, "500 kbit/s", "33.1 %", "61.7 %")
    assert line_with(text, "blind 7:00.000 to 7:01.500", "adapter lost")


def test_what_jitter_and_device_stand_for_is_said_where_they_are_shown() -> None:
    said = (
        "jitter: standard deviation of the answers, else of single periods; device: medians of both"
    )
    wide, narrow = summary(busy_bus(), width=140), summary(busy_bus(), width=80)
    assert said in wide
    assert "medians" not in narrow


def test_lane_shows_a_loss_of_two_milliseconds_in_ten_minutes() -> None:
    lane = line_with(summary(bad_day(), width=100), "10 boom tilt", "OOO")
    assert lane.count("L") > 1
    assert "OLO" in lane


def test_cells_cover_exactly_the_stretch_of_a_state() -> None:
    rows = state_rows(
        7, (0.0, "UNKNOWN", ""), (25.0, "OPERATIONAL", ""), (50.0, "STOPPED", ""), end=100.0
    )
    assert cells(rows, at(0), at(100), 4) == ["UNKNOWN", "OPERATIONAL", "STOPPED", "STOPPED"]
    assert cells(rows[1:], at(0), at(100), 4)[0] == ""
    assert cells([], at(0), at(0), 3) == ["", "", ""]


def test_cells_of_no_duration_show_the_most_urgent_state() -> None:
    rows = [NmtStateRow("can0", 1, s, 0, 0, "", "observed", 1) for s in ("OPERATIONAL", "LOST")]
    assert cells(rows, 0, 0, 2)[0] == "LOST"


@pytest.mark.parametrize("width", [40, 60, 80, 100, 200])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    for shown in (bad_day(), many_nodes(), untimed(), measured()):
        assert max(map(len, summary(shown, width=width).splitlines())) <= width


def test_captures_without_times_nodes_or_frames_say_so() -> None:
    assert "The log has no times" in summary(untimed())
    assert "4:10" not in summary(untimed())
    assert "No frame proves a CANopen node" in summary(analysis())
    empty = summary(analysis(capture=capture_row(frames=0, start_utc_ns=None)))
    assert "No frames in this capture" in empty
    assert "no frames." in empty
    assert "no date" not in empty
    assert "resolution" not in empty
    undated = analysis(capture=capture_row(start_utc_ns=None), nodes=[node_row()])
    assert "The log has no date" in summary(undated)
    assert "1970" not in summary(undated)


def test_healthy_capture_has_nothing_to_report() -> None:
    text = summary(analysis(nodes=[node_row()], nmt_states=usual_states(10)))
    assert "Nothing found" in text
    assert "ERROR" not in text


def test_text_from_the_bus_cannot_command_the_terminal() -> None:
    evil = "\x1b[2J[red]tilt[/red]\r\n\x07"
    shown = analysis(
        nodes=[node_row(name=evil, device=evil)],
        emcy=[emcy_row(meaning=evil)],
        findings=[finding(text=evil, cause=evil, check_next=evil)],
    )
    out = io.StringIO()
    print_summary(shown, Console(file=out, width=200, force_terminal=True, color_system=None))
    assert "\x1b" not in out.getvalue()
    assert "\x07" not in out.getvalue()
    assert "[red]tilt[/red]" in out.getvalue()


def test_pipe_gets_plain_text_and_a_terminal_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.delenv("COLUMNS", raising=False)
    pipe = io.StringIO()
    print_summary(bad_day(), console_for(pipe))
    assert "\x1b[" not in pipe.getvalue()
    terminal = io.StringIO()
    print_summary(bad_day(), Console(file=terminal, force_terminal=True, color_system="truecolor"))
    assert "\x1b[30;48;2;229;57;53m" in terminal.getvalue()


def test_no_color_is_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    out = io.StringIO()
    print_summary(bad_day(), Console(file=out, force_terminal=True))
    assert "48;2;" not in out.getvalue()
    assert "LLL" in out.getvalue()


def test_long_lists_say_how_much_is_left_out() -> None:
    storm = [emcy_row(second=10 + i / 100) for i in range(500)]
    assert line_with(summary(analysis(nodes=[node_row()], emcy=storm)), "and 480 more")


def test_damage_is_said_at_the_top_and_under_recording() -> None:
    text = summary(analysis(capture=capture_row(damage=["a.mcap: no footer"]), nodes=[node_row()]))
    assert text.index("Damaged, read in part: a.mcap: no footer") < text.index("Nothing found")


def test_boot_up_that_takes_the_error_list_is_no_emcy_message() -> None:
    gone = emcy_row(
        second=260, code=None, meaning="boot-up", transition="reset", error_register=None
    )
    text = summary(analysis(nodes=[node_row()], emcy=[emcy_row(), gone]))
    assert line_with(text, "EMCY (1)")
    assert line_with(text, "4:20.000", "boot-up, reset")


def test_a_part_of_a_capture_keeps_its_capture_time_and_fills_the_lanes() -> None:
    cut = bad_day(capture=capture_row(first_ns=T0 - 60 * SECOND))
    whole, part = summary(bad_day()), summary(cut)
    lanes = [
        [line for line in text.splitlines() if "PPPO" in line or "OOOO" in line]
        for text in (whole, part)
    ]
    assert lanes[0] == lanes[1]
    assert "4:10.000" in whole
    assert "5:10.000" in part
    assert whole.splitlines()[1] == part.splitlines()[1]


def test_a_story_says_what_came_before_and_what_followed() -> None:
    links = [
        Link("error.frames", "can0", None, at(249.0), at(249.5), "32 error frames.", [1]),
        Link("pdo.missed", "can0", 10, at(251.0), at(252.0), "TPDO1 did not come.", [2]),
        Link("nmt.no_boot_up", "can0", 10, at(260.0), at(260.0), "No boot-up came.", [3]),
    ]
    shown = analysis(findings=[finding(second=250.0, chain=links)])
    text = summary(shown)
    assert line_with(text, "before it", "4:09.000: 32 error frames.")
    assert line_with(text, "followed by", "4:11.000: TPDO1 did not come.")
    assert text.count("followed by") == 1
    markdown = findings_markdown(shown)
    assert "- before it 4:09.000: 32 error frames." in markdown
    assert "- followed by 4:20.000: No boot-up came." in markdown


def test_services_are_told_where_there_is_something_to_tell() -> None:
    text = summary(services())
    assert line_with(text, "can0", "passive", "0:10.000", "128")
    assert "can1  active" not in text
    assert line_with(text, "20", "0:09.000", "stuff error")
    assert line_with(text, "LSS (1 frame)")
    assert line_with(text, "0:08.000", "master", "switch mode: configuration")
    assert line_with(text, "100h", "2026-03-02 06:00:09.500", "500 ms to 1 s")
    assert line_with(text, "1003h:01", "mains voltage (3100h)", "EMCY, frame 60")
    assert line_with(text, "1003h:02", "older", "from before the capture")
    assert "1001h:00" not in text
    empty = summary(bad_day())
    titles = ("LSS", "TIME", "Error list 1003h", "Error frames", "recorder's controller")
    assert not [title for title in titles if title in empty]


def timing_block(text: str) -> list[str]:
    """The lines from the bus load to the heartbeats."""
    lines = text.splitlines()
    first = lines.index("Bus load")
    last = next(i for i, line in enumerate(lines) if line.startswith("Heartbeats and guarding"))
    return lines[first : last + 11]


@pytest.mark.parametrize("width", [80, 120])
@pytest.mark.parametrize("nodes", [7, 40])
def test_timing_fits_one_screen_whatever_the_bus(nodes: int, width: int) -> None:
    text = summary(busy_bus(nodes), width=width)
    block = timing_block(text)
    assert len(block) <= 70
    assert max(map(len, text.splitlines())) <= width
    first = line_with(text, "183h", "402/655/1483", "777", "4 late (3 bus)")
    assert first == first.split("\n")[0]
    assert ("and 60 more" in text) == (nodes == 40)
    assert line_with(text, "1 missing (drift")
    assert line_with(text, "181h x2 (TPDO1 of node 1), 605h" if width == 120 else "181h x2")


def test_figures_below_the_step_of_the_stamps_are_not_printed() -> None:
    text = summary(busy_bus(step_us=1000.0))
    row = line_with(text, "183h", "late")
    assert "< 1 ms" in row
    assert "<1000/1000/1000" in row
    assert "655" not in row
    assert line_with(text, "The stamps have steps of 1 ms")
    assert line_with(text, "080h", "< 1 ms")


@pytest.mark.parametrize("source", ["estimated", "recorded"])
def test_an_estimated_bit_rate_is_said_beside_what_rests_on_it(source: Any) -> None:
    text, told = (
        summary(busy_bus(source=source), width=200),
        findings_markdown(busy_bus(source=source)),
    )
    sentence = "estimated with high confidence from the spacing of the frames"
    assert (sentence in text) == (sentence in told) == (source == "estimated")
    assert ("250 kbit/s (estimated)" in text) == (source == "estimated")


def test_traces_say_what_they_rest_on_and_where_they_are_cut() -> None:
    text = summary(measured(), width=140)
    assert line_with(text, "5 drum", "6004h:00  Position value", "gap", "1 jump, ", " wrap")
    assert line_with(text, "6 brake", "preset, node lost", "9 frozen, 4 wrap")
    assert "scale assumed" not in text
    assert line_with(text, "node 5 6004h:00: measuring range only assumed")
    assert line_with(text, "told only below 118 rpm; 3 samples may have turned the other way")
    assert line_with(text, "5 drum", "all round", "40", "7", "0.012/0.05", "185h 6000")
    assert line_with(text, "10 boom", "359.98", "2.61", "0.2", "18Ah 5000, SDO 2")


def test_shafts_tilts_health_and_changes_are_told() -> None:
    text = summary(measured(), width=160)
    assert line_with(
        text, "6 brake", "5 drum", "2900 (7 left out)", "2 times, first at 5:00.000 by 12 deg"
    )
    assert line_with(text, "10 boom", "5 drum", "-2.5", "800", "1440", "0.4")
    assert line_with(text, "10 boom", "perpendicular", "0 of 5000", "resolution only assumed")
    assert line_with(text, "EEPROM writes", "1204", "1200", "+4 between the first and")
    assert line_with(text, "4:10.000", "preset to 1000", "SDO client on 605h", "yes")


def test_each_node_says_how_its_device_was_identified() -> None:
    text = summary(measured(), width=140)
    assert line_with(text, "node 5 drum", 'lir-da158a: 1008h = "L158" (frame 12)')
    assert line_with(text, "node 6 brake", "looks like lir-ma158k: 8 bytes in 186h")
    assert line_with(text, "can0  6 brake", "lir-ma158k?")


def test_of_a_healthy_bus_without_traces_nothing_is_told_of_traces() -> None:
    text = summary(analysis(nodes=[node_row()], nmt_states=usual_states(10)))
    titles = ("Traces", "Motion", "Shafts", "Tilts in space", "Health of the devices", "Changes")
    assert not [title for title in titles if title in text]
