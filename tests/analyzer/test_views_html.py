"""`report.html`: its structure by DOM, escaping, and its size; a browser reads it in test_report_browser."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_analyzer.results import (
    Analysis,
    BusErrorRow,
    BusLoadRow,
    BusSilenceRow,
    ClockStepRow,
    DoubledRow,
    EmcyContextRow,
    ErrorRow,
    GapRow,
    Link,
    MarkRow,
    NmtCommandRow,
    ObjectChangeRow,
    OverloadRow,
    Quantiles,
    SyncRow,
)
from syncline_analyzer.views.report_html import report, write_report
from syncline_analyzer.views.timeline_svg import node_id
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
    pdo_row,
    responses,
    sdo_row,
    series,
    services,
    state_rows,
    tilt,
    trace_row,
    untimed,
    usual_states,
)
from tests.analyzer.busy_bus import busy_bus
from tests.analyzer.report_page import Dom, figures, markup, paths, points


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
    assert {a.get("scope") for a in dom.all("th")} == {"col", "row"}
    assert len(dom.all("caption")) == len(dom.all("table")) > 5
    identities = [a["id"] for _, a in dom.elements if "id" in a]
    assert len(identities) == len(set(identities))


def test_node_section_tells_its_history() -> None:
    text = " ".join(Dom(markup(bad_day())).text)
    for word in ("3100h", "lost at reset", "all cleared", "18Ah", "402/655/902/1480", "abort 06020000h",
                 "silent longer than 150 ms", "6010h:00", "500 kbit/s", "adapter lost", "1 gap, 1.5 s blind"):  # fmt: skip
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
    page = report(analysis(findings=[finding(second=250.0, chain=links)]))
    text = " ".join(Dom(page).text)
    assert re.search(r"before it\s+0:09.000\s+14:13:29.000\s+: 32 error frames", text)
    assert re.search(r"followed by\s+4:11.000\s+14:17:31.000\s+: No TPDO1", text)
    assert 'data-from="251">4:11.000</a>' in page


def test_loss_of_two_milliseconds_is_drawn_last_and_at_least_a_pixel_wide() -> None:
    page = markup(bad_day())
    lost = re.findall(r'<g class="s-lost">.*?<rect x="([\d.]+)"[^>]* width="([\d.]+)"', page)
    assert lost == 2 * [("250", "31"), ("500", "0.002")]
    lane = page[page.index("NMT states of node 10") : page.index("NMT states of node 16")]
    assert lane.rindex('class="s-operational"') < lane.index('class="s-lost"')
    assert "non-scaling-stroke" in page
    assert re.search(r"\.s-lost rect,rect\.s-lost\{fill:#e53935;stroke:#e53935\}", page)


def test_lanes_of_a_part_begin_at_the_cut_in_capture_time() -> None:
    page = markup(bad_day(capture=capture_row(first_ns=T0 - 60 * SECOND)))
    assert 'viewBox="0 0 600 20"' in page
    assert '"begin":60.0' in page.replace(" ", "")
    assert "NMT state" in page
    assert ">2:00<" in page
    assert ">10:00<" in page
    assert 'data-from="250"' in page, "seconds are counted from the left edge"
    undated = capture_row(first_ns=T0 - 60 * SECOND, start_utc_ns=None, cut_ns=T0)
    assert ">10:00<" in markup(bad_day(capture=undated))


def test_thousands_of_changes_stay_a_small_picture() -> None:
    changes = [(i / 100, "LOST" if i % 2 else "OPERATIONAL", "") for i in range(20_000)]
    shown = analysis(nodes=[node_row()], nmt_states=state_rows(10, *changes))
    assert len(markup(shown)) < 600_000


EVIL = "\"><script>alert(1)</script><img src=x onerror=alert(2)>'&amp;</title></style>"


def evil(text: str = EVIL) -> Analysis:
    """A capture in which every text that comes from a bus or a file is the same one."""
    slope = tilt(0x601000, text, 40.0, count=50)
    gap = GapRow(at(420), at(421.5), text, None, text)
    link = Link(text, text, 10, at(9), at(9), text, [1])
    return analysis(
        capture=capture_row(files=[text], buses=[text], notes=[text], damage=[text], gaps=[gap],
                            marks=[MarkRow(at(5), text, text)]),
        nodes=[node_row(name=text, device=text, proof=[text], bus=text, final_state=text,
                        device_reason=text, device_source="objects"),
               node_row(5, name=text)],
        nmt_commands=[NmtCommandRow(text, 300, at(2.4), text, 10, 12.3)],
        nmt_states=usual_states(10, bus=text) + usual_states(5),
        sync=[SyncRow(text, 0x80, 59_990, Quantiles(9_812, 10_000, 10_031, 19_987), 1, 0)],
        pdos=[pdo_row(pdo=text, type_source=text, bus=text)],
        responses=[replace(responses(count=50), bus=text, pdo=text)],
        emcy=[emcy_row(meaning=text, details={text: text}, registers=[text], bus=text)],
        errors=[ErrorRow(text, 10, 0x3100, text, at(249.9), None, "lost at reset", 1, [174_930])],
        emcy_context=[EmcyContextRow(text, 10, 174_930, at(6), 0x3100, text, text, text, 0x6003, 0,
                                     55, 2.0, [text], {text: {"name": text, "unit": text,
                                     "before": 5.25, "after": 5.5}})],
        sdo=[sdo_row(name=text, result="abort", abort_text=text, bus=text)],
        bus_load=[BusLoadRow(text, 500_000, 33.1, 61.7, 687.2)],
        bus_errors=[BusErrorRow(text, text, 20, at(9), at(11), [5])],
        series=[series(text, "%", np.full(10, 3.0), text)],
        traces=[replace(trace_row(slope), bus=text, shows=text, assumed=[text])],
        trace_data=[replace(slope, bus=text, unit=text)],
        object_changes=[ObjectChangeRow(text, 10, 3, at(1), 0x1017, 0, text, text, 0, 200, text,
                                        text, "sdo-write", 0x60A, saved=False, old_words=text)],
        findings=[finding(text=text, cause=text, check_next=text, bus=text, assumed=[text],
                          chain=[link])],
    )  # fmt: skip


def test_no_text_of_bus_or_file_becomes_markup() -> None:
    page = report(evil())
    dom = Dom(page)
    assert [a for t, a in dom.elements if t == "img"] == []
    assert len(dom.all("script")) == 2
    assert len(dom.all("style")) == len(re.findall("</style", page)) == 1
    assert all("onerror" not in a for _, a in dom.elements)
    assert not {key for _, a in dom.elements for key in a if not re.fullmatch("[a-zA-Z-]+", key)}
    assert "alert(1)" in " ".join(dom.text)
    assert len(re.findall("</script", page)) == len(dom.all("script"))
    targets = {a["id"] for _, a in dom.elements if "id" in a}
    assert {str(a["href"])[1:] for a in dom.all("a")} <= targets


@pytest.mark.parametrize(
    "text",
    ["\x00\x1b[31m", "tilt\u202egnp.exe", "\udcff", "%", "a b&#39;", "\u2028</a>", "--><!--"],
)
def test_odd_characters_neither_stop_the_page_nor_steer_it(text: str, tmp_path: Path) -> None:
    page = write_report(evil(text), tmp_path / "report.html").read_text(encoding="utf-8")
    assert not set(page) & {"\x00", "\x1b", "\u202e"}
    dom = Dom(page)
    identities = [a["id"] for _, a in dom.elements if "id" in a]
    assert {str(a["href"])[1:] for a in dom.all("a")} <= set(identities)


def test_anchors_of_buses_with_odd_names_stay_apart() -> None:
    names = ["can 0", "can_0", "can%200", "c\u00e4n", "c\u00f6n"]
    found = {node_id(name, 1) for name in names}
    assert len(found) == len(names)
    assert all(re.fullmatch("[A-Za-z0-9_-]+", name) for name in found)


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
    drawn = figures(report(bad_day()))
    starts = {
        title: re.findall(r'<rect x="([\d.]+)"[^>]* class="band s-(\w+)"', figure)
        for title, figure in drawn.items()
    }
    blind = [("420", "blind")]
    assert starts["Angle [deg] of node 5 shaft"] == [*blind, ("420", "info")]
    own = [("250", "error"), ("300", "warning"), ("420", "info")]
    assert starts["Angle [deg] of node 10 boom tilt"] == [*blind, *own]
    assert starts["Bus load [%]"] == [*blind, own[0], ("520", "error"), *own[1:]]


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
    drawn = figures(page)
    assert "bus load in 1 s, bit rate estimated" in drawn["Bus load [%]"]
    assert "waited at most, bit rate estimated" in drawn["PDO response [us] of node 3 drive 3"]


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
    load = figures(report(busy_bus()))["Bus load [%]"]
    (band,) = paths(load, "area-of l0")
    high = float(re.findall('data-high="(.*?)"', load)[0])
    values = [round(high - down, 6) for _, down in points(band)]
    assert (min(values), max(values)) == (41.0, 50.0)
    assert len(values) < 6_000
    assert len(paths(load, "line l0")) == 1


@pytest.mark.parametrize(("nodes", "pdos"), [(127, 4), (40, 8)])
def test_page_of_a_full_line_stays_below_8_mb(nodes: int, pdos: int) -> None:
    shown = busy_bus(nodes, pdos, answers=6_000)
    assert len(report(shown).encode()) < 8_000_000


def test_page_without_plots_is_small() -> None:
    assert len(report(untimed()).encode()) < 60_000


def test_values_near_a_finding_are_all_there_and_elsewhere_every_peak() -> None:
    day = 86_400
    t_ns = T0 + np.arange(day * 2, dtype=np.int64) * SECOND // 2
    value = np.sin(np.arange(day * 2) / 900.0)
    value[50_001] = 7.0
    line = replace(
        tilt(0x601000, "Slope", 40.0, count=2), t_ns=t_ns, value=value,
        seq=np.arange(len(t_ns)), raw=np.zeros(len(t_ns), np.int64),
        flags=np.zeros(len(t_ns), np.uint16), segment=np.zeros(len(t_ns), np.int32),
    )  # fmt: skip
    lost = finding(second=40_000.0, end_ns=at(40_030))
    capture = capture_row(duration_ns=day * SECOND)
    shown = analysis(capture=capture, nodes=[node_row()], trace_data=[line], findings=[lost])
    figure = figures(report(shown))["Angle [deg] of node 10"]
    (path,) = paths(figure, "line l0")
    drawn = points(path)
    near = [x for x, _ in drawn if 39_985 <= x <= 40_045]
    assert near == [39_985 + k / 2 for k in range(121)]
    assert len(drawn) < 6_000 < len(t_ns)
    assert 25_000.5 in [x for x, _ in drawn], "the only outlier of the day"
    assert f"{len(drawn):,} of 172,800 samples drawn" in figure


# -- time


def test_every_moment_has_its_utc_and_leads_into_the_timeline() -> None:
    page = markup(bad_day())
    row = row_of(node_part(page, 10), "Errors", "3100h")
    assert row["Raised"] == "4:09.900 14:17:29.900"
    assert 'href="#timeline" data-from="249.9">4:09.900</a> <small>14:17:29.900</small>' in page
    story = page[page.index('id="finding-1"') : page.index('id="finding-2"')]
    assert "4:10.000 to 4:41.000</a> <small>14:17:30.000 UTC</small>" in story


def test_captures_over_midnight_have_the_date() -> None:
    long = capture_row(duration_ns=20 * 3600 * SECOND)
    page = markup(analysis(capture=long, findings=[finding(second=50_000.0)]))
    assert "<small>09-22 04:06:40.000 UTC</small>" in page


def test_captures_without_dates_have_capture_time_alone() -> None:
    page = markup(bad_day(capture=capture_row(start_utc_ns=None)))
    assert " UTC" not in page
    assert 'data-from="249.9">4:09.900</a></td>' in page
    week = capture_row(start_utc_ns=None, duration_ns=500_000 * SECOND)
    story = markup(analysis(capture=week, findings=[finding(second=400_000.0)]))
    assert "111:06:40.000 to 111:07:11.000</a></p>" in story


# -- findings


def test_findings_have_numbers_in_list_timeline_and_node_table() -> None:
    page = markup(bad_day())
    dom = Dom(page)
    flags = [a for a in dom.all("a") if str(a.get("class")).startswith("flag")]
    assert [(a["href"], a["aria-label"]) for a in flags] == [
        ("#finding-1", "Finding 1"),
        ("#finding-2", "Finding 2"),
        ("#finding-3", "Finding 3"),
        ("#finding-4", "Finding 4"),
    ]
    assert [a["data-at"] for a in flags] == ["250", "520", "300", "420"]
    assert row_of(page, "Nodes on the bus", "10 boom tilt")["Findings"] == "error 1, warning 3"


def test_findings_in_one_place_have_flags_below_one_another() -> None:
    close = [finding(second=250.0 + k / 10) for k in range(9)]
    page = markup(analysis(findings=close, nodes=[node_row()], nmt_states=usual_states(10)))
    rows = re.findall(r'class="flag error" style="left:[\d.]+%;--row:(\d)"', page)
    assert rows == ["0", "1", "2", "3"]
    assert "9 findings of severity error" in page


def test_few_findings_have_no_filter_and_many_have_one() -> None:
    few = Dom(markup(analysis(findings=[finding()] * 3)))
    assert few.all("form") == []
    many = Dom(markup(bad_day()))
    (form,) = many.all("form")
    assert "hidden" in form, "without the script it would do nothing"
    assert [a["value"] for a in many.all("input", type="checkbox")] == ["error", "warning", "info"]
    options = [a["value"] for a in many.all("option")]
    assert options == ["", "node-can0-10", "node-can0-16"]


def test_five_thousand_findings_stay_a_page_that_opens() -> None:
    many = [finding(second=k / 10) for k in range(5_000)]
    page = markup(analysis(findings=many, nodes=[node_row()], nmt_states=usual_states(10)))
    assert "4500 more findings only in findings.json." in page
    assert len(page) < 4_000_000


# -- nodes and recording


def test_a_node_has_its_parts_in_the_order_of_a_look_into_it() -> None:
    part = node_part(markup(bad_day()), 10)
    order = [
        "Known by",
        "NMT states of node 10",
        "<caption>Errors</caption>",
        "<caption>EMCY history</caption>",
        "<caption>PDOs</caption>",
        "<caption>NMT states</caption>",
    ]
    places = [part.index(each) for each in order]
    assert places == sorted(places)
    assert "response over time: 3" in part, "sparkline of the answers"


def test_sparklines_show_what_a_pdo_carried() -> None:
    carried = bad_day()
    rows = [replace(row, sources={"18Ah": 5_000}) for row in carried.traces if row.node == 10]
    part = node_part(markup(replace(carried, traces=rows)), 10)
    labels = re.findall(r'aria-label="([^"]*) over time: ([^"]*)"', part)
    assert [name for name, _ in labels] == [
        "response", "Slope long (6010h:00)", "Slope lateral (6020h:00)",
    ]  # fmt: skip
    assert dict(labels)["Slope long (6010h:00)"] == "-20 to 20 deg"
    assert "Over time" not in node_part(markup(replace(carried, responses=[], traces=[])), 10)


def test_forty_nodes_are_a_table_and_closed_parts_but_those_with_errors() -> None:
    pairs = [("can1" if n % 2 else "can0", n) for n in range(1, 41)]
    failed = [finding(second=float(n), bus=bus, node=n) for bus, n in pairs[:5]]
    dom = Dom(markup(replace(many_nodes(), findings=failed)))
    parts = [a for a in dom.all("details") if a.get("class") == "node"]
    opened = [a["id"] for a in parts if "open" in a]
    assert len(parts) == 40
    assert opened == ["node-can1-1", "node-can0-2", "node-can1-3"]
    troubled = [a for a in dom.all("div", class_="lane") if "data-trouble" in a]
    assert len(troubled) == 5 + 1, "five nodes and the lane of the errors"
    assert dom.all("input", id="only-trouble")


def test_long_tables_open_on_a_click() -> None:
    page = markup(busy_bus(40, pdos=1))
    assert re.search(r"<summary>PDOs of all nodes: \d+ rows</summary>", page)
    short = markup(bad_day())
    assert "PDOs of all nodes: " not in short
    assert "<caption>PDOs of all nodes</caption>" in short


def test_quality_of_the_recording_is_on_the_first_screen_and_in_its_part() -> None:
    gaps = [GapRow(at(100), at(110), "overrun", 12, "can0"), GapRow(at(105), at(130), "overrun", 3)]
    shown = bad_day(
        capture=capture_row(gaps=gaps, unparsed_lines=3),
        clock_steps=[ClockStepRow("can0", at(30), at(31), 2 * SECOND, 7, [9])],
        bus_silences=[BusSilenceRow("can0", at(200), at(220), [7, 8])],
        overloads=[OverloadRow("can0", at(40), at(44), 97.3)],
        doubled=[DoubledRow("can0", "own", [0x80], 44, at(1), at(9), 80.0, [5])],
    )
    page = markup(shown)
    words = "2 gaps, 30 s blind (5 %), at least 15 frames lost, 3 lines could not be read, 5 error frames, nobody heard for 20 s though heartbeats were due, clock set 1 time"
    assert words in page[: page.index("<main")]
    part = page_section(page, "recording")
    heads, blind, _ = cells(part, "Stretches in which the recorder was blind")
    assert heads == ["Bus", "Blind", "Lasts", "Frames lost", "Reason"]
    assert blind == ["can0", "1:40.000 to 1:50.000 14:15:00.000", "10 s", "12", "overrun"]
    for caption in ("Steps of the recorder's clock", "Nobody heard although heartbeats were due",
                    "Bus nearly full", "Frames that were written twice"):  # fmt: skip
        assert f"<caption>{caption.replace(chr(39), '&#x27;')}</caption>" in part
    healthy = capture_row(error_frames=0)
    assert "whole, without gaps" in markup(analysis(capture=healthy, nodes=[node_row()]))
