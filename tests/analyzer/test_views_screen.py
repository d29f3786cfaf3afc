"""The summary on one screen: what is on it whatever the bus, and that it fits."""

import io
import re
from functools import cache
from pathlib import Path

import pytest
from rich.cells import cell_len
from rich.console import Console

from syncline_analyzer.bundle.place import finding_at
from syncline_analyzer.results import Analysis
from syncline_analyzer.session import open_session
from syncline_analyzer.views.report_html import report
from syncline_analyzer.views.screen import FEWEST, MOST, print_screen, screen
from syncline_analyzer.views.text import print_summary
from syncline_samples.forty_nodes import forty_nodes
from syncline_samples.generate import mcap_capture
from tests.analyzer.analysis_builder import (
    analysis,
    bad_day,
    capture_row,
    finding,
    many_nodes,
    measured,
    node_row,
    untimed,
    usual_states,
)
from tests.analyzer.busy_bus import busy_bus

SAMPLES = Path(__file__).parents[2] / "samples"
NAMES = ("bad_day.mcap", "healthy_line.mcap", "jittery_sync.log", "forty")


@cache
def sample(name: str, folder: Path) -> Analysis:
    path = SAMPLES / name
    if name == "forty":
        path = folder / "forty.mcap"
        path.write_bytes(mcap_capture(forty_nodes().run()))
    return open_session(path).analysis


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("screen")


@pytest.mark.parametrize("width", [40, 60, 80, 120])
@pytest.mark.parametrize("height", [24, 40])
@pytest.mark.parametrize("name", NAMES)
def test_the_samples_fit_one_screen(name: str, width: int, height: int, folder: Path) -> None:
    text = screen(sample(name, folder), width=width, height=height, whole_texts=False)
    assert len(text.splitlines()) <= max(height, FEWEST)
    assert max(map(len, text.splitlines())) <= width


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    for shown in (bad_day(), many_nodes(), untimed(), measured(), busy_bus(40)):
        for whole in (False, True):
            text = screen(shown, width=width, whole_texts=whole)
            assert max(map(len, text.splitlines())) <= width


def test_the_bad_day_shows_every_error_when_and_on_which_bars(folder: Path) -> None:
    told = sample("bad_day.mcap", folder)
    text = screen(told, width=80, height=40, whole_texts=False)
    first = text.index("ERROR")
    assert text.index("5 errors, 9 warnings, 1 note") < first < text.index("can0: 500 kbit/s")
    assert text.count("ERROR ") == 5
    assert text.count("WARNING ") == 9
    for row in told.findings:
        if row.severity == "error":
            assert row.text[:30] in text
    bars = [line for line in text.splitlines() if re.search(r"[IPOSL?]{30}", line)]
    press = next(line for line in bars if line.startswith("3 press drive"))
    assert "OLL" in press
    assert "the recorder was blind 1 time for 1.5 s" in text
    assert "-v: everything" in text


def test_a_healthy_line_is_said_to_be_healthy(folder: Path) -> None:
    text = screen(sample("healthy_line.mcap", folder), width=80)
    assert "Nothing found" in text
    assert "\n\n\n" not in text
    assert "ERROR" not in text


def test_of_forty_nodes_those_in_trouble_have_a_bar(folder: Path) -> None:
    text = screen(sample("forty", folder), width=100, height=24, whole_texts=False)
    labels = [line[:20] for line in text.splitlines() if re.search(r"[IPOSL?]{30}", line)]
    assert 3 <= len(labels) <= 12
    troubled = {row.node for row in sample("forty", folder).findings if row.severity == "error"}
    assert troubled <= {int(label.split()[0]) for label in labels} | {None}
    assert re.search(r"\d+ more nodes, at the end \d+ OPERATIONAL", text)


def test_a_pipe_gets_whole_texts_and_no_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    long = "The text of a finding " * 12
    shown = analysis(nodes=[node_row()], findings=[finding(text=long)], nmt_states=usual_states(10))
    pipe = io.StringIO()
    print_screen(shown, Console(file=pipe, width=120))
    assert "\x1b" not in pipe.getvalue()
    words = " ".join(pipe.getvalue().split())
    assert long.strip() in words
    assert "check: " in words
    crowded = analysis(findings=[finding(text=long)] * 30, nodes=[node_row()])
    monkeypatch.delenv("NO_COLOR", raising=False)
    terminal = io.StringIO()
    console = Console(
        file=terminal, width=80, height=24, force_terminal=True, color_system="truecolor"
    )
    print_screen(crowded, console)
    assert " ..." in terminal.getvalue()
    assert "more: -v" in terminal.getvalue()
    assert len(terminal.getvalue().splitlines()) <= FEWEST


def test_no_color_is_obeyed_and_letters_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    out = io.StringIO()
    print_screen(bad_day(), Console(file=out, width=100, height=40, force_terminal=True))
    assert "38;" not in out.getvalue()
    assert "48;" not in out.getvalue()
    assert "OLO" in out.getvalue()


def test_a_capture_without_times_nodes_or_frames_says_so() -> None:
    assert "The log has no times" in screen(untimed(), width=80)
    assert "No frame proves a CANopen node" in screen(analysis(), width=120)
    empty = screen(analysis(capture=capture_row(frames=0, start_utc_ns=None)), width=80)
    assert "No frames in this capture" in empty


def test_text_from_the_bus_cannot_command_the_terminal() -> None:
    evil = "\x1b[2J[red]tilt[/red]\r\n\x07"
    shown = analysis(
        nodes=[node_row(name=evil)],
        nmt_states=usual_states(10),
        findings=[finding(text=evil, cause=evil, check_next=evil)],
    )
    text = screen(shown, width=100)
    assert "\x1b" not in text
    assert "\x07" not in text
    assert "[red]tilt[/red]" in text


def test_a_screen_is_never_longer_than_promised() -> None:
    shown = analysis(
        findings=[finding(text="x " * 300)] * 50, nodes=[node_row()], nmt_states=usual_states(10)
    )
    assert len(screen(shown, width=80, whole_texts=False).splitlines()) <= MOST


@pytest.mark.parametrize("width", [12, 30])
def test_the_narrowest_terminals_get_whole_lines(width: int) -> None:
    kinds = [finding(severity=kind) for kind in ("error", "warning", "info")]
    shown = analysis(
        findings=kinds * 9, nodes=many_nodes().nodes, nmt_states=many_nodes().nmt_states
    )
    lines = screen(shown, width=width, height=24, whole_texts=False).splitlines()
    assert max(map(len, lines)) <= width
    words = " ".join(lines).split()
    assert "more: -v" in " ".join(words)
    assert "more nodes, at the end" in " ".join(words)


def test_where_nothing_was_found_nothing_more_is_promised() -> None:
    lines = screen(many_nodes(), width=10, height=24, whole_texts=False).splitlines()
    assert "more:" not in " ".join(" ".join(lines).split())


def test_one_frame_is_one() -> None:
    assert ": 1 frame in" in screen(analysis(capture=capture_row(frames=1)), width=80)


@pytest.mark.parametrize("encoding", ["cp1252", "cp437", "ascii"])
def test_a_code_page_gets_plain_characters(encoding: str) -> None:
    for show in (print_screen, print_summary):
        out = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
        show(bad_day(), Console(file=out, width=100))
        out.flush()
        assert "10 boom tilt" in out.buffer.getvalue().decode(encoding)


def test_findings_have_the_numbers_that_bundle_takes() -> None:
    told = analysis(findings=[finding(text=f"Fault {i}.") for i in range(1, 11)])
    text = screen(told, width=100)
    assert re.search(r"^ 1 [A-Z]+ .*Fault 1\.$", text, re.MULTILINE)
    assert re.search(r"^10 [A-Z]+ .*Fault 10\.$", text, re.MULTILINE)
    assert finding_at(told, "10").text == "Fault 10."


def test_a_frame_of_nobody_is_told_without_holes(tmp_path: Path) -> None:
    log = tmp_path / "one.log"
    log.write_text("(1700000000.000000) vcan0 123#05\n", encoding="utf-8")
    assert screen(open_session(log).analysis, width=100).splitlines() == [
        "one.log: 1 frame at one moment on vcan0, 0 nodes.",
        "2023-11-14 22:13:20.000000 UTC",
        "No frame proves a CANopen node; this may be a bus of another protocol.",
        "No CANopen node in this capture",
        "",
        "vcan0: bit rate not known",
        "-v: everything   --out DIR: report, plots, tables",
    ]


@pytest.mark.parametrize("width", [40, 80])
def test_characters_of_two_columns_cost_no_text(width: int) -> None:
    text = "Node 5 (巻取り機の回転角度検出器) was lost at +20.001 s for 6 s."
    shown = bad_day(findings=[finding(text=text)])
    told = screen(shown, width=width)
    assert max(map(cell_len, told.splitlines())) <= width
    assert text.replace(" ", "") in re.sub(r"\s", "", told)


def test_of_several_buses_a_finding_names_its_own() -> None:
    lost = finding(node=5, bus="can1", text="Node 5 was lost.")
    both = many_nodes()
    assert "can1: Node 5 was lost." in screen(
        analysis(capture=both.capture, nodes=both.nodes, findings=[lost]), width=120
    )
    assert "can1: Node" not in screen(bad_day(findings=[lost]), width=120)


def test_a_note_does_not_hide_that_there_are_no_frames() -> None:
    blind = finding("capture.gap", severity="info")
    empty = analysis(capture=capture_row(frames=0), findings=[blind])
    assert "No frames in this capture, 1 note" in screen(empty, width=80)
    assert "another protocol" not in report(empty)


def test_what_was_redacted_is_said() -> None:
    log = "the payload of 181-1FF was dropped before this analysis (redacted)"
    told = screen(bad_day(capture=capture_row(notes=[log])), width=120)
    assert "redacted, nothing is concluded from the payload of 181-1FF" in told
    assert "redacted" not in screen(bad_day(), width=120)
