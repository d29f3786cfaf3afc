"""`report.html` in a real browser: no complaint, plots drawn, links and keys work, open to everybody."""

import re
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_analyzer import open_session
from syncline_analyzer.results import Analysis
from syncline_analyzer.views.report_html import report, write_report
from tests.analyzer.analysis_builder import bad_day, many_nodes, shaft, tilt, untimed
from tests.analyzer.busy_bus import busy_bus
from tests.analyzer.report_page import AUDIT, asked, browse, figures, in_browser, paths
from tests.analyzer.test_views_html import evil

SAMPLES = Path(__file__).parents[2] / "samples"
USE = Path(__file__).with_name("report_use.js")
WIDE, PHONE = (
    ("--window-size=1280,900",),
    ("--window-size=600,1350", "--force-device-scale-factor=1.6"),
)
LIGHT, DARK = (f"--blink-settings=preferredColorScheme={scheme}" for scheme in (1, 0))

pytestmark = in_browser


@cache
def sample(name: str) -> Analysis:
    return open_session(SAMPLES / name).analysis


@cache
def forty() -> Analysis:
    """The bus with forty nodes, as the simulator plays it."""
    nodes = pytest.importorskip("syncline_samples.forty_nodes")
    generate = pytest.importorskip("syncline_samples.generate")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "forty.mcap"
        path.write_bytes(generate.mcap_capture(nodes.forty_nodes().run()))
        return open_session(path).analysis


@cache
def used() -> tuple[Any, Any]:
    """What the page of the bad day showed step by step, and its faults, in one start."""
    with tempfile.TemporaryDirectory() as folder:
        return used_and_audited(sample("bad_day.mcap"), Path(folder), *WIDE, DARK)


def used_and_audited(shown: Analysis, folder: Path, *flags: str) -> tuple[Any, Any]:
    """What a page showed step by step, and its faults, from one start of the browser."""
    page = write_report(shown, folder / "report.html")
    script = USE.read_text(encoding="utf-8") + _apart(AUDIT.read_text(encoding="utf-8"))
    (told, audit), console = asked(page, script, *flags)
    assert console == []
    return told, audit


def _apart(audit: str) -> str:
    """The audit after the use, in one answer."""
    last = audit.rindex("answer(")
    return f"{{{audit[:last]}answer([told, {audit[last + len('answer(') :].strip()[:-2]}]);}}"


def audited(shown: Analysis, folder: Path, *flags: str) -> Any:
    page = write_report(shown, folder / "report.html")
    audit, console = asked(page, AUDIT.read_text(encoding="utf-8"), *flags)
    assert console == []
    return audit


def test_an_engineer_finds_the_moment_of_each_finding() -> None:
    told, audit = used()
    whole = "All: 0:00.000 to 1:59.633, 06:00:00.300 to 06:01:59.933 UTC"
    assert audit["faults"] == []
    assert (told["whole"], told["all"], told["double"]) == (whole, whole, whole)
    assert told["finding"] == "Shown: 0:12.182 to 0:13.378, 06:00:12.482 to 06:00:13.678 UTC"
    assert told["hash"] == "#timeline"
    assert told["cursor"].startswith("Cursor 0:12.780 (06:00:13.080 UTC)")
    assert told["flag_shown"]
    assert told["flags_hidden"] > 10
    assert told["bars"] == 1, "the lane of node 127 was OPERATIONAL all that time"
    assert told["ticks"][:2] == ["0:12.200", "0:12.400"]
    assert told["out"] == "Shown: 0:11.584 to 0:13.976, 06:00:11.884 to 06:00:14.276 UTC"
    assert told["later"] == "Shown: 0:12.780 to 0:15.173, 06:00:13.080 to 06:00:15.473 UTC"


def test_keys_alone_move_and_zoom_and_say_what_is_there() -> None:
    told, _ = used()
    assert told["focused"]
    assert re.fullmatch(
        r"0:48\.670 \(06:00:48\.970 UTC\): Position value \(6004h:00\) [\d.]+ deg", told["slider"]
    )
    assert told["slider_blind"] == "1:00.633 (06:01:00.933 UTC)", "no value where nothing was heard"
    assert told["key_zoom"] == "Shown: 0:24.335 to 1:24.152, 06:00:24.635 to 06:01:24.452 UTC"
    assert told["states"].startswith("0:00.000 (06:00:00.300 UTC): 1 entry roller ")
    assert told["chosen"]
    assert not told["chosen_after"]
    assert told["dragged"] == "Shown: 0:29.908 to 0:59.817, 06:00:30.208 to 06:01:00.117 UTC"
    assert told["hidden"] == ["false", True]
    assert told["all_stories"] == 15
    assert told["no_warnings"]
    assert told["flags_off"] == 0
    count, words, rest = told["of_node"]
    assert words == f"{count} of 15 findings"
    assert 0 < count < 15
    assert rest
    assert told["searched"] == ["finding-5"]
    assert told["node_opened"]
    assert told["closed_left"] == 0


def test_forty_nodes_on_a_phone_in_the_dark(tmp_path: Path) -> None:
    told, audit = used_and_audited(forty(), tmp_path, *PHONE, DARK)
    assert audit["faults"] == []
    assert audit["lanes"] == 43
    assert audit["plots"] > 5
    assert told["lanes_left"] == 2 + 4, "lanes of errors and warnings, four nodes in trouble"
    assert told["node_opened"]
    assert (tmp_path / "report.html").stat().st_size < 4_000_000


@pytest.mark.parametrize("name", ["healthy_line.mcap", "jittery_sync.log"])
def test_other_samples_have_no_fault_on_a_phone_by_day(name: str, tmp_path: Path) -> None:
    audit = audited(sample(name), tmp_path, *PHONE, LIGHT)
    assert audit["faults"] == []
    assert audit["ink"] >= audit["plots"] > 5


def test_a_capture_of_one_instant_fills_its_lanes(tmp_path: Path) -> None:
    log = tmp_path / "one.log"
    log.write_text("(1700000000.000000) can0 705#05\n", encoding="utf-8")
    audit = audited(open_session(log).analysis, tmp_path, *WIDE, LIGHT)
    assert audit["faults"] == []
    assert audit["lanes"] == 1


def test_a_very_long_name_fits_on_a_phone(tmp_path: Path) -> None:
    plain = bad_day()
    names = ("NonSeparableNameOfADrive" * 8, "boom tilt of the second platform " * 8)
    nodes = [replace(row, name=names[place % 2]) for place, row in enumerate(plain.nodes)]
    audit = audited(replace(plain, nodes=nodes), tmp_path, *PHONE, LIGHT)
    assert audit["faults"] == []


def test_texts_from_the_bus_run_nowhere(tmp_path: Path) -> None:
    audit = audited(evil(), tmp_path, *WIDE, LIGHT)
    assert audit["faults"] == []
    assert audit["ready"] == "true"


@pytest.mark.parametrize(
    "shown", [many_nodes(), busy_bus(), untimed()], ids=["many", "busy", "untimed"]
)
def test_browser_draws_all_plots_without_a_complaint(shown: Analysis, tmp_path: Path) -> None:
    audit = audited(shown, tmp_path, *WIDE, LIGHT)
    assert audit["faults"] == []
    assert audit["ready"] == "true"
    assert audit["ink"] >= audit["plots"]


def test_audit_finds_what_is_wrong(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    broken = report(bad_day())
    for good, bad in (
        ("<h3", "<h5"),
        ("</h3>", "</h5>"),
        ('role="img"', ""),
        ('scope="row"', ""),
        ("--dim:#56606b", "--dim:#a9a9a9"),
        ('<section id="nodes"', '<section id="nowhere"'),
        ("body{margin:0;", "body{margin:0;min-width:2000px;"),
    ):
        assert good in broken, good
        broken = broken.replace(good, bad)
    page.write_text(broken, encoding="utf-8")
    audit, _ = asked(page, AUDIT.read_text(encoding="utf-8"), *WIDE, LIGHT)
    kinds = {re.split("[:0-9]", fault)[0].strip() for fault in audit["faults"]}
    assert kinds >= {
        "heading after level", "picture without a name", "row without a head", "contrast",
        "dead link", "wider than the screen",
    }  # fmt: skip


def test_browser_reports_a_script_that_fails(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text(report(bad_day()).replace("  say();\n  document", "  nothing();\n  document"), encoding="utf-8")  # fmt: skip
    dom, console = browse(page, "--dump-dom")
    assert any("nothing is not defined" in line for line in console)
    assert 'data-ready="true"' not in dom


@pytest.mark.parametrize(
    ("scheme", "background", "line"),
    [(LIGHT, (255, 255, 255), (31, 111, 209)), (DARK, (20, 23, 27), (109, 179, 255))],
    ids=["light", "dark"],
)
def test_browser_shows_lanes_traces_and_markers(
    scheme: str, background: tuple[int, int, int], line: tuple[int, int, int], tmp_path: Path
) -> None:
    image = pytest.importorskip("PIL.Image")
    page, picture = tmp_path / "r.html", tmp_path / "r.png"
    short = report(bad_day()).replace('class="node" open', 'class="node"')
    page.write_text(short, encoding="utf-8")
    browse(page, f"--screenshot={picture}", "--window-size=1280,3000", scheme)
    pixels = image.open(picture).convert("RGB")
    counts = {colour: count for count, colour in pixels.getcolors(1 << 24)}
    assert pixels.getpixel((2, 2)) == background
    for what, colour, least in (
        ("OPERATIONAL lane", (67, 160, 71), 20_000),
        ("LOST lane", (229, 57, 53), 500),
        ("STOPPED lane", (30, 136, 229), 2_000),
        ("lines of plots", line, 1_000),
        ("flag of an error", (183, 28, 28), 300),
    ):
        assert counts.get(colour, 0) >= least, f"{what}: {counts.get(colour, 0)} pixels"


def test_angles_are_cut_and_plots_have_the_bands_of_their_node() -> None:
    """One stretch of a path between cuts and wraps."""
    signed = tilt(0x601000, "Slope", 40.0)
    sent = replace(signed, columns={"angle_deg": signed.value % 360, "unwrapped_deg": signed.value})
    shown = bad_day(trace_data=[shaft(600), sent], responses=[], series=[])
    drawn = {
        title: (paths(figure, "line l0")[0].count("M"), figure.count('class="band s-'))
        for title, figure in figures(report(shown)).items()
    }
    wraps = int(np.sum(np.abs(np.diff(shaft(600).columns["angle_deg"])) > 180))
    cut_and_gap = 2
    assert drawn["Angle [deg] of node 5 shaft"] == (wraps + cut_and_gap + 1, 2)
    assert drawn["Angle [deg] of node 10 boom tilt"] == (cut_and_gap + 1, 4)


def test_paper_has_all_findings_and_a_few_pages(tmp_path: Path) -> None:
    page, paper = write_report(sample("bad_day.mcap"), tmp_path / "r.html"), tmp_path / "r.pdf"
    browse(page, f"--print-to-pdf={paper}", "--no-pdf-header-footer")
    count = len(re.findall(rb"/Type\s*/Page\b", paper.read_bytes()))
    assert 4 <= count <= 40
    script = """dispatchEvent(new Event("beforeprint"));
    const before = document.querySelectorAll("details.rest:not([open])").length;
    dispatchEvent(new Event("afterprint"));
    answer([before, document.querySelectorAll("details.rest:not([open])").length]);"""
    assert asked(page, script, *WIDE)[0] == [0, 1]
