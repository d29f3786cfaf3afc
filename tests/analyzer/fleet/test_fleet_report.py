"""The report of a fleet: what it says of machines, findings, trends, devices and failures."""

import re
from html import unescape
from pathlib import Path
from urllib.parse import unquote

import pytest

pytest.importorskip("duckdb")
pytest.importorskip("fsspec")

from click.testing import CliRunner, Result

from syncline_analyzer.fleet.overview import MAX_COLUMNS, Overview, overview
from syncline_analyzer.fleet.task import Settings
from syncline_analyzer.fleet.trend_lines import trend_lines
from syncline_analyzer.fleet_command import fleet as command
from syncline_analyzer.views.fleet_links import Links
from syncline_analyzer.views.fleet_map import MAX_ROWS
from syncline_analyzer.views.fleet_report import fleet_page
from tests.analyzer.fleet.fleet_builder import T0_NS, analyze, small_log, small_mcap
from tests.analyzer.fleet.overview_builder import (
    DAY_NS,
    FIRST_NS,
    Row,
    Tables,
    big_fleet,
    capture,
    drifting_fleet,
    failure,
    finding,
    node,
    said,
)
from tests.analyzer.report_page import Dom

EVIL = "<script>alert('machine')</script>"


def told(found: Overview) -> str:
    """The page of a fleet, where all reports are beside it."""
    return fleet_page(found, [], Links("reports", found.reports), "/data/fleet")


def words(page: str) -> str:
    """Text of a page."""
    return re.sub(r"\s+", " ", "".join(Dom(page).text))


def table(page: str, caption: str) -> list[list[str]]:
    """Cells of the rows of a table of a page."""
    found = re.search(rf"<caption>{caption}[^<]*</caption>(.*?)</table>", page, flags=re.DOTALL)
    assert found is not None, f"no table {caption}"
    return [
        [
            unescape(re.sub("<[^>]*>", "", cell))
            for cell in re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row, flags=re.DOTALL)
        ]
        for row in re.findall(r"<tr[^>]*>(.*?)</tr>", found[1], flags=re.DOTALL)
    ]


def trouble() -> dict[str, list[Row]]:
    """Three machines over a week: one in trouble still, one that was, one that is healthy."""
    now = [capture("now", day, errors=int(day >= 4), warnings=1) for day in range(7)]
    once = [capture("once", day, errors=3 * (day == 1)) for day in range(7)]
    never = [capture("never", day) for day in range(7)]
    lost = [finding(of) for of in (*now[4:], once[1], once[1], once[1])]
    late = [finding(of, "pdo.late", "warning", node=None) for of in now]
    return {"captures": [*never, *once, *now], "findings": [*lost, *late]}


def test_machines_come_in_the_order_in_which_they_need_help() -> None:
    found = overview(Tables(trouble()), [failure("gone")])
    assert [machine.name for machine in found.machines] == ["now", "once", "gone", "never"]
    page = told(found)
    assert "2 of 3 machines with errors, 1 healthy" in words(page)
    assert "By their latest captures: 1 machine with errors." in words(page)
    assert "1 recording could not be analyzed" in words(page)
    _, _, first, second, gone, last = table(page, "The worst of each machine")
    assert first == ["now", *["W1"] * 4, *["E1"] * 3]
    assert second == ["once", "✓", "E3", *["✓"] * 5]
    assert gone == ["gone 1 failed", *[""] * 7]
    assert last == ["never", *["✓"] * 7]


def test_a_story_says_since_when_how_often_and_where_to_read() -> None:
    rows = trouble()
    found = overview(Tables(rows))
    story = found.machines[0].stories[0]
    assert (story.id, story.node, story.findings, story.captures) == ("nmt.node_lost", 5, 3, 3)
    assert (story.first_ns, story.last_ns) == (FIRST_NS + 4 * DAY_NS, FIRST_NS + 6 * DAY_NS)
    of_now = [row["capture_id"] for row in rows["captures"] if row["machine"] == "now"]
    assert (story.first_capture, story.last_capture) == (of_now[4], of_now[6])
    page = words(told(found))
    assert "3 times in 3 of 7 captures, since 2026-03-06, last on 2026-03-08." in page
    assert "3 times in 1 of 7 captures, on 2026-03-03." in page


def test_findings_are_counted_over_the_fleet() -> None:
    lost, late = table(told(overview(Tables(trouble()))), "Findings by kind")[1:]
    assert lost[:7] == ["ERROR", "nmt.node_lost", "2", "4", "6", "2026-03-03", "2026-03-08"]
    assert late[:5] == ["WARNING", "pdo.late", "1", "7", "7"]
    assert "fell silent" in lost[-1]


def test_a_cell_leads_to_the_worst_capture_of_its_day() -> None:
    good, bad = capture("a", 0, frames=1), capture("a", 0, errors=2)
    page = told(overview(Tables({"captures": [good, bad, capture("a", 1, report=False)]})))
    cells = re.findall(r'<td class="[ewh]".*?</td>', page)
    assert cells == [
        f'<td class="e" data-n="2"><a href="reports/{bad["capture_id"]}.html">E2</a></td>',
        '<td class="h">✓</td>',
    ]


@pytest.mark.parametrize(
    ("days", "every", "columns"),
    [((0, 61), "day", 62), ((0, 62), "week", 9), ((0, 900), "month", 30), ((0, 9000), "month", 62)],
)
def test_a_long_time_is_shown_by_weeks_or_months(
    days: tuple[int, ...], every: str, columns: int
) -> None:
    found = overview(Tables({"captures": [capture("a", day, errors=1) for day in days]}))
    assert (found.every, len(found.columns)) == (every, columns)
    assert columns <= MAX_COLUMNS
    assert told(found).count(">E1</a></td>") == (2 if days[1] < 9000 else 1)


def test_captures_without_a_date_have_a_column() -> None:
    rows = {"captures": [capture("a", None, errors=1)], "findings": []}
    rows["findings"] = [finding(rows["captures"][0])]
    found = overview(Tables(rows))
    assert found.columns == ["undated"]
    assert "1 time in 1 of 1 captures, in captures without a date." in words(told(found))
    assert "Without a date 1 capture" in words(told(found)).replace("date1", "date 1")


def test_devices_are_listed_by_version_with_their_machines() -> None:
    captures = [capture(f"m{n}", day) for n in range(3) for day in range(2)]
    rows = {
        "captures": captures,
        "nodes": [node(of) for of in captures],
        "objects": [
            said(
                of, 0x100A, "2.0" if of["machine"] == "m2" and of["date"] > "2026-03-02" else "1.0"
            )
            for of in captures
        ]
        + [said(captures[0], 0x1018, "262144", 3)],
    }
    page = told(overview(Tables(rows)))
    assert "In several versions: jn2100 (3)." in words(page)
    listed = {(row[3], row[4]): row[6:] for row in table(page, "Devices by version")[1:]}
    assert listed == {
        ("1.0", "00040000h"): ["1", "m0"],
        ("1.0", "-"): ["1", "m1"],
        ("2.0", "-"): ["1", "m2"],
    }


def test_flaws_of_recordings_are_listed() -> None:
    captures = [
        capture("whole"),
        capture("blind", blind_ns=36 * 10**9, damage=["cut off"]),
        capture("noisy", error_frames=7),
    ]
    place = {name: captures[1][name] for name in ("machine", "date", "capture_id")}
    page = told(overview(Tables({"captures": captures, "gaps": [{**place, "lost_frames": 12}]})))
    assert table(page, "Machines whose recordings")[1:] == [
        ["blind", "1", "36 s (1 %)", "at least 12", "1", "-", "-"],
        ["noisy", "1", "-", "-", "-", "7", "-"],
    ]


def test_failures_are_told_with_their_reason() -> None:
    failures = [failure("a"), failure("a", "note.txt", "no frames", "no capture")]
    found = overview(Tables({"captures": [capture("a")]}), failures)
    page = told(found)
    assert table(page, "Recordings that could not")[1:] == [
        ["night.log", "a", "cut off", "/data/a/night.log"]
    ]
    assert "1 more file with an ending of captures that are none." in words(page)
    assert "No capture was analyzed" in words(told(overview(Tables({}), failures)))


def test_a_trend_is_told_with_its_values_and_marks_its_machine() -> None:
    tables = drifting_fleet()
    lines = trend_lines(tables)
    assert [line.finding.machine for line in lines] == ["press 3"]
    assert len(trend_lines(tables, "press [23]")) == 1
    assert trend_lines(tables, "press 4") == []
    assert lines[0].t_ns[14] == lines[0].finding.onset_ns == FIRST_NS + 14 * DAY_NS
    assert max(lines[0].value[:14]) < 950
    assert min(lines[0].value[14:]) > 1150
    found = overview(tables)
    page = fleet_page(found, lines, Links("reports", found.reports), "/data/fleet")
    assert "All 12 machines healthy; 1 trend" in words(page)
    assert 'class="verdict warning"' in page
    row = next(row for row in page.split("<tr") if 'data-name="press 3"' in row)
    assert '<a href="#trend-1">trend</a>' in row
    drawn = re.findall(r'<path d="M([^"]*)" class="line"/>', page)
    assert len(drawn[0].split("L")) == 28
    (onset,) = re.findall(r'<path d="M([\d.]+) 0V60" class="onset"/>', page)
    assert drawn[0].split("L")[14].split()[0] == onset
    ends = re.findall(r'<a href="reports/(\w+)\.html">(?:last before|first after)</a>', page)
    assert ends == lines[0].finding.evidence[1:3]


def test_page_of_a_thousand_machines_is_small_and_says_what_it_leaves_out() -> None:
    found = overview(big_fleet(MAX_ROWS, 30), [failure("left out")])
    page = told(found)
    assert len(page.encode()) < 8_000_000
    assert len(re.findall('<td class="[ewh]"', page)) == 30 * MAX_ROWS
    assert "1 more machine, none of them worse than these, left out here" in page
    assert "800 more machines only in the map." in page


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set with reports of two machines, one of which would like to be a program."""
    folder = tmp_path_factory.mktemp("looked at")
    source = folder / "in"
    small_mcap(source / "a" / "a.mcap", recording_id="a", machine=EVIL)
    small_mcap(source / "b" / "b.mcap", recording_id="b", start_ns=T0_NS + DAY_NS)
    small_log(source / "c" / "c.log")
    (source / "c" / "broken.mcap").write_bytes(b"\x89MCAP but no more")
    analyze(source, folder / "out", settings=Settings(extras=("report",)))
    return folder / "out"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(command, ["report", *map(str, arguments)])


def test_links_lead_to_the_reports_wherever_the_page_is(data: Path, tmp_path: Path) -> None:
    done = run(data)
    assert (done.exit_code, done.stdout) == (0, f"{data.as_posix()}/report.html\n"), done.output
    elsewhere = tmp_path / "deep" / "page.html"
    assert run(data, "--out", elsewhere).exit_code == 0
    for page in (data / "report.html", elsewhere):
        links = Dom(page.read_text(encoding="utf-8")).all("a")
        files = [str(a["href"]) for a in links if not str(a["href"]).startswith("#")]
        assert len(set(files)) == 3
        assert all((page.parent / unquote(file)).is_file() for file in files)
        assert not any(file.startswith(("/", "file:", "http")) for file in files)


def test_names_from_captures_are_never_markup(data: Path, tmp_path: Path) -> None:
    run(data, "--out", tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert EVIL not in page
    assert EVIL in words(page)
    assert len(Dom(page).all("script")) == 1


def test_a_report_of_some_machines_and_days(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    assert run(data, "--machine", "b", "--out", out).exit_code == 0
    page = words(out.read_text(encoding="utf-8"))
    assert "/out, machine b" in page
    assert "1 capture of 1 machine" in page
    assert "All recordings were analyzed." in page
    assert run(data, "--since", "2026-03-03", "--out", out).exit_code == 0
    assert "1 capture of 1 machine, 2026-03-03 to 2026-03-03" in words(out.read_text("utf-8"))


def test_what_cannot_be_reported_is_said(data: Path, tmp_path: Path) -> None:
    missing = run(tmp_path / "nothing")
    assert "no data set is here" in str(missing.exception)
    assert "name another file by --out" in str(run(data, "--machine", "b").exception)
    (tmp_path / "file").touch()
    assert "cannot be written" in str(run(data, "-o", tmp_path / "file" / "r.html").exception)
