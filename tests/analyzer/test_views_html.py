"""`report.html`: its structure by DOM, escaping, and what a real browser makes of it."""

import json
import re
import shutil
import subprocess
import tempfile
from html.parser import HTMLParser
from pathlib import Path

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
    node_row,
    pdo_row,
    sdo_row,
    services,
    state_rows,
    tilt,
    trace_row,
    untimed,
    usual_states,
)

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
    "shown", [bad_day(), many_nodes(), untimed()], ids=["bad day", "many", "untimed"]
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
