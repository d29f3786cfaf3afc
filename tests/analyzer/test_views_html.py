"""`report.html`: its structure by DOM, escaping, and what a real browser makes of it."""

import json
import re
import shutil
import subprocess
import tempfile
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_analyzer.results import Analysis, Link
from syncline_analyzer.views.report_html import report, write_report
from tests.analyzer.analysis_builder import (
    SECOND,
    T0,
    analysis,
    bad_day,
    capture_row,
    emcy_row,
    finding,
    many_nodes,
    measured,
    node_row,
    pdo_row,
    sdo_row,
    services,
    shaft,
    state_rows,
    tilt,
    trace_row,
    untimed,
    usual_states,
)
from tests.analyzer.busy_bus import busy_bus

VOID = {"meta", "br"}


class Dom(HTMLParser):
    """Elements with their attributes, and the text outside of scripts and styles."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("script", "style"):
            self.text.append(data)

    def all(self, tag: str, **attributes: str) -> list[dict[str, str | None]]:
        wanted = {key.rstrip("_").replace("_", "-"): value for key, value in attributes.items()}
        return [a for t, a in self.elements if t == tag and wanted.items() <= a.items()]


def markup(shown: Analysis) -> str:
    """The page without plotly, which is not ours."""
    return re.sub(r"<script>.*?</script>", "", report(shown), flags=re.DOTALL)


def test_findings_are_stories_that_lead_to_their_place_in_the_timeline() -> None:
    dom = Dom(markup(bad_day()))
    stories = [a for a in dom.all("article") if "story" in str(a["class"])]
    assert [s["class"] for s in stories] == [
        "story error",
        "story error",
        "story warning",
        "story info",
    ]
    links = [a for a in dom.all("a", href="#timeline") if "data-from" in a]
    assert [(a["data-from"], a["data-to"]) for a in links[:2]] == [("250", "281"), ("520", "600")]
    text = " ".join(dom.text)
    for word in (
        "2 errors, 1 warning, 1 note",
        "Supply or wiring",
        "Connector and supply",
        "nmt.node_lost",
    ):
        assert word in text
    assert text.index("nmt.node_lost") < text.index("Nodes on the bus")


def test_every_inner_link_has_its_target() -> None:
    for shown in (bad_day(), many_nodes(), analysis(), untimed()):
        dom = Dom(markup(shown))
        targets = {a["id"] for _, a in dom.elements if "id" in a}
        links = {str(a["href"])[1:] for a in dom.all("a")}
        assert links <= targets, links - targets


def test_page_is_landmarked_and_labelled() -> None:
    dom = Dom(markup(bad_day()))
    assert dom.all("html", lang="en")
    for landmark in ("header", "nav", "main", "footer", "h1"):
        assert len(dom.all(landmark)) == 1, landmark
    assert all(a.get("aria-label") for a in dom.all("svg") + dom.all("nav"))
    assert all(a.get("scope") == "col" for a in dom.all("th"))
    assert len(dom.all("caption")) == len(dom.all("table")) > 5
    identities = [a["id"] for _, a in dom.elements if "id" in a]
    assert len(identities) == len(set(identities))


def test_node_section_tells_its_history() -> None:
    text = " ".join(Dom(markup(bad_day())).text)
    for word in ("3100h", "lost at reset", "all cleared", "18Ah", "402/655/902/1480", "abort 06020000h",
                 "silent longer than 150 ms", "6010h:00", "500 kbit/s", "adapter lost"):  # fmt: skip
        assert word in text, word


def test_services_and_what_was_around_an_emcy_are_shown() -> None:
    text = " ".join(Dom(report(services())).text)
    assert "OPERATIONAL; recorder's controller passive; written: 6003h:00 = 5 (Preset)" in text
    assert "Slope 5.25, then 5.5 deg" in text
    assert "alarms 1 (code)" in text
    assert "Error list 1003h and register 1001h" in text
    assert "EMCY, frame 60" in text
    assert "What is known of its settings, and from where" in text
    assert "Producer heartbeat time = 200 ms (sdo-write, seq 3)" in text
    for shown in (
        "State of the recorder's controller",
        "stuff error",
        "LSS (1 frame)",
        "500 ms to 1 s",
    ):
        assert shown in text
    plain = " ".join(Dom(report(analysis(nodes=[node_row(10)]))).text)
    assert not [word for word in ("LSS", "TIME", "Error list 1003h", "Settings") if word in plain]


def test_a_chain_says_what_came_before() -> None:
    links = [
        Link(
            "error.frames", "can0", None, T0 + 9 * SECOND, T0 + 9 * SECOND, "32 error frames.", [1]
        ),
        Link("pdo.missed", "can0", 10, T0 + 251 * SECOND, T0 + 252 * SECOND, "No TPDO1.", [2]),
    ]
    text = " ".join(Dom(report(analysis(findings=[finding(second=250.0, chain=links)]))).text)
    assert re.search(r"before it\s+0:09.000: 32 error frames", text)
    assert re.search(r"followed by\s+4:11.000: No TPDO1", text)


def test_loss_of_two_milliseconds_is_drawn_last_and_at_least_a_pixel_wide() -> None:
    page = markup(bad_day())
    lost = re.findall(r'<g class="s-lost">.*?<rect x="([\d.]+)"[^>]* width="([\d.]+)"', page)
    assert lost == [("250", "31"), ("500", "0.002")]
    lane = page[page.index("NMT states of node 10") : page.index("NMT states of node 16")]
    assert lane.rindex('class="s-operational"') < lane.index('class="s-lost"')
    assert "non-scaling-stroke" in page
    assert re.search(r"\.s-lost rect\{fill:#e53935;stroke:#e53935\}", page)


def test_lanes_of_a_part_begin_at_the_cut_in_capture_time() -> None:
    page = markup(bad_day(capture=capture_row(first_ns=T0 - 60 * SECOND)))
    assert 'viewBox="60 0 600 20"' in page
    assert '"begin":60.0' in page.replace(" ", "")
    undated = capture_row(first_ns=T0 - 60 * SECOND, start_utc_ns=None, cut_ns=T0)
    assert 'viewBox="60 0 600 20"' in markup(bad_day(capture=undated))


def test_thousands_of_changes_stay_a_small_picture() -> None:
    changes = [(i / 100, "LOST" if i % 2 else "OPERATIONAL", "") for i in range(20_000)]
    shown = analysis(nodes=[node_row()], nmt_states=state_rows(10, *changes))
    assert len(markup(shown)) < 600_000


def test_no_text_of_bus_or_file_becomes_markup() -> None:
    evil = "\"><script>alert(1)</script><img src=x onerror=alert(2)>'&amp;"
    slope = tilt(0x601000, evil, 40.0, count=50)
    shown = analysis(
        capture=capture_row(files=[evil], buses=[evil], notes=[evil]),
        nodes=[node_row(name=evil, device=evil, proof=[evil], bus=evil, final_state=evil)],
        nmt_states=usual_states(10, bus=evil),
        pdos=[pdo_row(pdo=evil, type_source=evil)],
        emcy=[emcy_row(meaning=evil, details={evil: evil}, registers=[evil])],
        sdo=[sdo_row(name=evil, result="abort")],
        traces=[trace_row(slope)],
        trace_data=[slope],
        findings=[finding(text=evil, cause=evil, check_next=evil, bus=evil)],
    )
    dom = Dom(report(shown))
    assert [a for t, a in dom.elements if t == "img"] == []
    assert len(dom.all("script")) == 3
    assert all("onerror" not in a for _, a in dom.elements)
    assert "alert(1)" in " ".join(dom.text)
    data = re.search(
        r'<script type="application/json" id="report-data">(.*?)</script>', report(shown)
    )
    assert data is not None
    assert evil in json.loads(data[1])["plots"][0]["lines"][0]


@pytest.mark.parametrize("shown", [bad_day(), many_nodes(), analysis(), untimed()])
def test_page_needs_nothing_from_a_network(shown: Analysis) -> None:
    page = report(shown)
    assert len(page.encode()) < 8_000_000
    dom = Dom(markup(shown))
    assert [a for _, a in dom.elements if "src" in a] == []
    assert dom.all("link") == []
    policy = dom.all("meta", http_equiv="Content-Security-Policy")
    assert str(policy[0]["content"]).startswith("default-src 'none'")


def test_captures_without_times_draw_nothing_over_time() -> None:
    page = markup(untimed())
    assert "The log has no times" in page
    assert "<svg" not in page
    assert "untimed" not in page


def node_part(page: str, node: int) -> str:
    """The section of one node."""
    (found,) = re.findall(
        rf'<details id="node-can0-{node}".*?(?=<details id="node-|</section>)', page
    )
    return str(found)


def page_section(page: str, name: str) -> str:
    (found,) = re.findall(rf'<section id="{name}".*?</section>', page)
    return str(found)


def test_node_section_tells_what_its_traces_rest_on() -> None:
    drum = node_part(markup(measured()), 5)
    assert row_of(drum, "Traces", "6004h:00")["Cut at"] == "gap"
    motion = row_of(drum, "Motion of the traces", "6004h:00")
    assert (motion["Mean [deg]"], motion["Fastest [rpm]"]) == ("all round", "40")
    assert motion["Noise at rest [deg] std/peak"] == "0.012/0.05"
    assert "node 5 6004h:00: measuring range only assumed" in drum
    assert row_of(drum, "Health of the devices", "EEPROM writes")["Value"] == "1204"
    assert row_of(drum, "Changes of parameters (1)", "4:10.000")["Change"] == "preset to 1000"
    assert "Device: lir-da158a: 1008h = &quot;L158&quot; (frame 12)." in drum
    values = page_section(markup(measured()), "plots")
    for part in (drum, node_part(markup(measured()), 6), values):
        assert row_of(part, "Shafts compared", "6 brake")["Parted"].startswith("2 times, first at")


def test_a_node_has_no_table_about_what_it_does_not_have() -> None:
    boom = node_part(markup(measured()), 10)
    assert "<caption>Tilts in space</caption>" in boom
    assert "<caption>Encoders that follow one another</caption>" in boom
    for title in ("Shafts compared", "Health of the devices", "Changes of parameters"):
        assert title not in boom


def test_plot_of_a_node_has_the_bands_of_its_own_findings() -> None:
    plots = {plot["title"]: plot["bands"] for plot in data_of(report(bad_day()))["plots"]}
    starts = {title: [start for start, _, _ in bands] for title, bands in plots.items()}
    assert starts["Angle [deg] of node 5 shaft"] == [420.0]
    assert starts["Angle [deg] of node 10 boom tilt"] == [250.0, 300.0, 420.0]
    assert starts["Bus load [%]"] == [250.0, 520.0, 300.0, 420.0]


# -- timing


def cells(page: str, caption: str) -> list[list[str]]:
    """Rows of the table with a caption, as text."""
    (table,) = re.findall(rf"<caption>{re.escape(caption)}</caption>(.*?)</table>", page)[:1]
    rows = re.findall(r"<tr>(.*?)</tr>", table)
    return [
        [re.sub("<.*?>", "", cell) for cell in re.findall(r"<t[hd].*?>(.*?)</t[hd]>", row)]
        for row in rows
    ]


def row_of(page: str, caption: str, first: str) -> dict[str, str]:
    """The row of a table that starts with a word, by the heads of its columns."""
    heads, *rows = cells(page, caption)
    (row,) = [row for row in rows if row[0] == first]
    return dict(zip(heads, row, strict=True))


def test_answers_are_taken_apart_into_device_and_waiting() -> None:
    page = markup(busy_bus())
    row = row_of(page, "Answers to SYNC: response, and what of it is the device&#x27;s", "183h")
    assert row["Response min/median/p99/max [us]"] == "402/655/902/1483"
    assert row["Jitter std/p99-p1 [us]"] == "71.5/410"
    assert row["Device between (medians) [us]"] == "310 to 450"
    assert row["Device at least, by arbitration median/max [us]"] == "333/900"
    assert row["Waited at most median/max [us]"] == "120/777"
    pdo = row_of(page, "PDOs of all nodes", "183h")
    assert pdo["Faults"] == "4 late (3 bus)"
    assert pdo["Due"] == "every SYNC, within 1.4 ms of it (1007h)"


def test_sync_heartbeats_shares_and_waits_are_listed() -> None:
    page = markup(busy_bus())
    sync = row_of(page, "SYNC", "080h")
    assert (sync["Expected"], sync["Drift [ppm]"]) == (
        "10000 us (1006h of node 1 (sdo-read))",
        "+12.5",
    )
    heartbeat = row_of(page, "Heartbeats and guarding", "1 drive 1")
    assert (heartbeat["Told"], heartbeat["Median off it [us]"]) == ("100 ms (sdo-write)", "+18")
    share = row_of(page, "Traffic of can0 by node", "master and others")
    assert (share["Share of the traffic"], share["Load"]) == ("40.00 %", "16.00 %")
    assert row_of(page, "Traffic of can0 by identifier", "181h")["Service"] == "TPDO1"
    waits = " ".join(cells(page, "Longest wait of every PDO")[1])
    for words in (
        "TPDO1 of node 7 (187h)",
        "TPDO1 of node 1: 2 frames 91, 93, 508 us",
        "605h SDO request",
    ):
        assert words in waits
    delay = row_of(page, "Frames that answers waited for (at most)", "can0")
    assert (delay["Of node"], delay["In all"], delay["Worst of"]) == (
        "1 drive 1",
        "95 ms",
        "TPDO1 of node 7 (187h)",
    )
    worst = row_of(page, "Longest and shortest", "sync period")
    assert (worst["[us]"], worst["Frame"]) == ("19987", "4711")


def test_figures_below_the_step_of_the_stamps_are_not_printed() -> None:
    page = markup(busy_bus(step_us=1000.0))
    row = row_of(page, "Answers to SYNC: response, and what of it is the device&#x27;s", "183h")
    assert row["Jitter std/p99-p1 [us]"] == "&lt; 1 ms"
    assert row["Response min/median/p99/max [us]"] == "&lt;1000/1000/1000/1000"
    assert row_of(page, "SYNC", "080h")["Jitter std/p99-p1 [us]"] == "&lt; 1 ms"
    assert "std &lt; 1 ms" in page
    assert "The stamps have steps of 1 ms" in page


def test_an_estimated_bit_rate_is_said_over_the_tables_and_in_the_plots() -> None:
    page = markup(busy_bus(source="estimated"))
    assert "estimated with high confidence from the spacing of the frames" in page
    plots = {plot["title"]: plot["lines"] for plot in data_of(page)["plots"]}
    assert plots["Bus load [%]"][1] == "bus load in 1 s, bit rate estimated"
    assert plots["PDO response [us] of node 3 drive 3"][0].endswith(
        "waited at most, bit rate estimated"
    )


def data_of(page: str) -> Any:
    found = re.search(r'<script type="application/json" id="report-data">(.*?)</script>', page)
    assert found is not None
    return json.loads(found[1])


def test_what_is_left_out_or_not_exact_is_said() -> None:
    many = busy_bus(40, pdos=1)
    page = markup(many)
    assert "Without a plot here: 28 nodes that answer more evenly." in page
    assert "Response histograms of 28 more PDOs" in page
    assert "minima and maxima are exact" not in page
    long = replace(many, pdos=[replace(row, quantile_error=0.0048) for row in many.pdos])
    assert "Medians and percentiles are within 0.48 %" in markup(long)


def test_every_pdo_that_answers_has_a_histogram() -> None:
    dom = Dom(markup(busy_bus(7)))
    pictures = [str(a["aria-label"]) for a in dom.all("svg") if "histogram" in str(a["aria-label"])]
    assert len(pictures) == 14
    assert pictures[4].startswith(
        "Response histogram of 183h TPDO1 of node 3 drive 3: 500 answers, median 655 us"
    )
    for kind in ("hist", "median", "p99"):
        assert len(dom.all("path", class_=kind)) == 14, kind
    outline = str(dom.all("path", class_="hist")[0]["d"])
    heights = [90 - float(top) for top in re.findall(r"V([\d.]+)H", outline)]
    assert max(heights) == pytest.approx(86)
    assert "nan" not in outline


def test_load_of_a_long_capture_is_a_band_from_the_least_to_the_most() -> None:
    load = next(p for p in data_of(report(busy_bus()))["plots"] if p["title"] == "Bus load [%]")
    band, line = load["traces"]
    assert (band["fill"], line.get("fill")) == ("toself", None)
    assert (min(band["y"]), max(band["y"])) == (41.0, 50.0)
    assert len(band["x"]) == len(band["y"]) < 6_000


@pytest.mark.parametrize(("nodes", "pdos"), [(127, 4), (40, 8)])
def test_page_of_a_full_line_stays_below_8_mb(nodes: int, pdos: int) -> None:
    shown = busy_bus(nodes, pdos, answers=6_000)
    assert len(report(shown).encode()) < 8_000_000


def test_page_without_plots_does_without_the_library() -> None:
    assert len(report(untimed()).encode()) < 60_000


# -- in a real browser

CHROMIUM = shutil.which("chromium")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--hide-scrollbars",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--force-device-scale-factor=1",
    "--virtual-time-budget=10000",
]

in_browser = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")


def browse(page: Path, *flags: str) -> tuple[str, list[str]]:
    """DOM after scripts, and what the page wrote to the console."""
    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        done = subprocess.run(
            [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", *flags, page.as_uri()],
            capture_output=True, encoding="utf-8", errors="replace", timeout=120, check=True,
        )  # fmt: skip
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@in_browser
@pytest.mark.parametrize(
    "shown",
    [bad_day(), many_nodes(), busy_bus(), untimed()],
    ids=["bad day", "many", "busy", "untimed"],
)
def test_browser_draws_all_plots_without_a_complaint(shown: Analysis, tmp_path: Path) -> None:
    page = write_report(shown, tmp_path / "report.html")
    dom, console = browse(page, "--dump-dom")
    assert console == []
    assert 'data-ready="true"' in dom
    drawn = dom.count('class="main-svg"')
    assert drawn >= dom.count('class="plot')
    assert (drawn > 0) == ('class="plot' in dom)


@in_browser
def test_browser_reports_a_script_that_fails(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text(report(bad_day()).replace("  draw();\n", "  nothing();\n"), encoding="utf-8")
    dom, console = browse(page, "--dump-dom")
    assert any("nothing is not defined" in line for line in console)
    assert 'data-ready="true"' not in dom


@in_browser
def test_story_opens_its_stretch_in_lanes_and_plots(tmp_path: Path) -> None:
    click = "<script>document.querySelector('[data-from]').click()</script></body>"
    page = tmp_path / "report.html"
    page.write_text(report(bad_day()).replace("</body>", click), encoding="utf-8")
    dom, console = browse(page, "--dump-dom")
    assert console == []
    assert 'viewBox="234.5 0 62 20"' in dom
    assert 'viewBox="0 0 600 20"' not in dom
    assert ">3:54.500<" in dom
    assert ">14:17:20<" in dom


@in_browser
@pytest.mark.parametrize(
    ("scheme", "background"), [(1, (255, 255, 255)), (0, (20, 23, 27))], ids=["light", "dark"]
)
def test_browser_shows_lanes_traces_and_markers(
    scheme: int, background: tuple[int, int, int], tmp_path: Path
) -> None:
    image = pytest.importorskip("PIL.Image")
    page, picture = write_report(bad_day(), tmp_path / "r.html"), tmp_path / "r.png"
    browse(page, f"--screenshot={picture}", "--window-size=1280,3000",
           f"--blink-settings=preferredColorScheme={scheme}")  # fmt: skip
    pixels = image.open(picture).convert("RGB")
    counts = {colour: count for count, colour in pixels.getcolors(1 << 24)}
    assert pixels.getpixel((2, 2)) == background
    for what, colour, least in (
        ("OPERATIONAL lane", (67, 160, 71), 20_000),
        ("LOST lane", (229, 57, 53), 500),
        ("STOPPED lane", (30, 136, 229), 2_000),
        ("shaft angle", (80, 160, 255), 300),
        ("EMCY marker", (255, 45, 120), 100),
    ):
        assert counts.get(colour, 0) >= least, f"{what}: {counts.get(colour, 0)} pixels"


@in_browser
def test_browser_draws_cut_angles_and_the_bands_of_each_node(tmp_path: Path) -> None:
    """Lines and shapes as plotly drew them: one path for each stretch between cuts and wraps."""
    told = """<script>
    const seen = [...document.querySelectorAll(".plot")].map((div) => [
      div.getAttribute("aria-label"),
      div.querySelectorAll(".scatterlayer .js-line").length,
      div.querySelectorAll(".shapelayer path, .shapelayer rect").length]);
    document.body.dataset.seen = JSON.stringify(seen);
    </script></body>"""
    signed = tilt(0x601000, "Slope", 40.0)
    sent = replace(signed, columns={"angle_deg": signed.value % 360, "unwrapped_deg": signed.value})
    shown = bad_day(trace_data=[shaft(600), sent], responses=[], series=[])
    page = tmp_path / "report.html"
    page.write_text(report(shown).replace("</body>", told), encoding="utf-8")
    dom, console = browse(page, "--dump-dom")
    assert console == []
    found = re.search(r'data-seen="(.*?)"', dom)
    assert found is not None
    seen = {label.partition(":")[0]: rest for label, *rest in json.loads(unescape(found[1]))}
    wraps = int(np.sum(np.abs(np.diff(shaft(600).columns["angle_deg"])) > 180))
    cut_and_gap = 2
    assert seen["Angle [deg] of node 5 shaft"] == [wraps + cut_and_gap + 1, 1]
    assert seen["Angle [deg] of node 10 boom tilt"] == [cut_and_gap + 1, 3]
