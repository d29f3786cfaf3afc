"""`syncline compare` and what it shows: text, JSON, page, frame, exit codes."""

import json
from html.parser import HTMLParser
from pathlib import Path

import pytest
from click.testing import CliRunner

import syncline_analyzer
from syncline_analyzer.compare_command import compare as command
from syncline_analyzer.comparison import Comparison, compare
from syncline_analyzer.comparison.kinds import KINDS
from syncline_analyzer.results import Analysis
from syncline_analyzer.views.comparison_html import comparison_page
from syncline_analyzer.views.comparison_table import comparison_object
from syncline_analyzer.views.comparison_text import comparison_text
from syncline_schemas.description import BusDescription
from tests.analyzer.whole_run import beats, every, whole

NAMES = '[bus.can0.node.5]\nname = "<b>boom\\u001b[31m"\n'


def pair() -> tuple[Analysis, Analysis]:
    """Node 6 is missing, node 5 beats half as fast, and has a name that somebody chose badly."""
    described = BusDescription.loads(NAMES)
    golden = whole(beats(5, 0, 30_000), beats(6, 0, 30_000), description=described)
    return golden, whole(beats(5, 0, 60_000, every_ms=200), description=described)


def found() -> Comparison:
    return compare(*pair())


class Tags(HTMLParser):
    """Open tags of a page, and what it would load."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.loads: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.loads += [str(value) for key, value in attrs if key in ("src", "href")]


def test_text_tells_both_sides_and_why() -> None:
    text = comparison_text(found())
    assert "Different from the golden capture: 1 error, 1 warning" in text
    assert text.index("Node 6 is missing") < text.index(
        "every 200 ms, +100.0%; golden: every 100 ms"
    )
    assert "[node.missing]" in text
    assert "\x1b" not in text
    assert "Nothing differs" in comparison_text(compare(*2 * [pair()[0]]))


@pytest.mark.parametrize("name", ["golden", "capture"])
def test_an_empty_side_is_told_before_anything_else(name: str) -> None:
    full, empty = pair()[0], whole()
    told = compare(*((empty, full) if name == "golden" else (full, empty)))
    what = "golden capture" if name == "golden" else "capture"
    verdict = f"The {what} holds no frames: nothing can be compared"
    assert verdict in comparison_text(told)
    assert "Nothing differs" not in comparison_text(told)
    page = comparison_page(told)
    assert f">{verdict}</h1>" in page
    assert "are those of golden" not in page


def test_an_empty_golden_capture_is_no_success(tmp_path: Path) -> None:
    empty, other = tmp_path / "empty.asc", tmp_path / "other.log"
    empty.write_text("date Mon Mar 2 06:00:00 am 2026\nbase hex timestamps absolute\n", "utf-8")
    other.write_text("(1700000000.000000) can0 705#05\n", encoding="utf-8")
    assert CliRunner().invoke(command, [str(empty), str(other)]).exit_code == 1
    assert CliRunner().invoke(command, [str(other), str(other)]).exit_code == 0


def test_page_is_one_file_in_which_names_are_text() -> None:
    page = comparison_page(found())
    tags = Tags()
    tags.feed(page)
    assert tags.loads == []
    assert tags.tags.count("article") == 2
    assert {"script", "b", "link", "img"}.isdisjoint(tags.tags)
    assert "&lt;b&gt;boom" in page
    assert "Nothing differs" in comparison_page(compare(*2 * [pair()[0]]))


def test_json_holds_the_rows() -> None:
    told = comparison_object(found())
    assert told["schema"] == "syncline.comparison/1"
    assert [row["kind"] for row in told["differences"]] == ["node.missing", "period"]
    assert told["golden"]["heard_s"] == pytest.approx(29.9)
    json.dumps(told, allow_nan=False)


def test_frame_has_one_row_per_difference() -> None:
    frame = syncline_analyzer.compare(*pair()).to_frame()
    assert frame["kind"].tolist() == ["node.missing", "period"]
    assert frame["golden_value"].dtype == "Float64"
    assert frame.loc[1, "capture_value"] == 200_000
    empty = compare(*2 * [pair()[0]])
    assert list(empty.to_frame().columns) == list(frame.columns)
    assert len(empty.unseen_frame()) == 0


def test_every_kind_says_why_it_matters() -> None:
    assert all(why.endswith(".") for why in KINDS.values())


def log(path: Path, *nodes: int) -> Path:
    rows = sorted(row for node in nodes for row in beats(node, 0, 30_000))
    lines = [f"({1_700_000_000 + t / 1e9:.6f}) can0 {can_id:03X}#05" for t, _, can_id, *_ in rows]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def test_command(tmp_path: Path) -> None:
    golden, capture = log(tmp_path / "healthy.log", 5, 6), log(tmp_path / "today.log", 5)
    page = tmp_path / "diff.html"
    run = CliRunner().invoke(
        command, [str(golden), str(capture), "--out", str(page), "--check", "error"]
    )
    assert run.exit_code == 1
    assert "Node 6 is missing" in run.stdout
    assert "Node 6 is missing" in page.read_text(encoding="utf-8")
    told = CliRunner().invoke(command, [str(golden), str(capture), "--format", "json"])
    assert told.exit_code == 0
    assert json.loads(told.stdout)["differences"][0]["node"] == 6
    same = CliRunner().invoke(command, [str(golden), str(golden), "--check", "warning"])
    assert (same.exit_code, "Nothing differs" in same.stdout) == (0, True)
    part = CliRunner().invoke(command, [str(golden), str(golden), "--from", "10s", "--to", "20s"])
    assert "Nothing differs" in part.stdout


def test_paths_and_sessions_are_compared_alike(tmp_path: Path) -> None:
    golden, capture = log(tmp_path / "healthy.log", 5, 6), log(tmp_path / "today.log", 5)
    by_path = syncline_analyzer.compare(golden, capture)
    by_session = syncline_analyzer.compare(
        syncline_analyzer.open_session(golden), syncline_analyzer.open_session(capture)
    )
    assert by_path.rows == by_session.rows
    assert "1 difference," in repr(by_path)


def test_a_burst_identifier_is_told_as_not_seen() -> None:
    burst = every(0x6F0, 0, 500, 50, b"\1")
    text = comparison_text(compare(whole(beats(5, 0, 9_000)), whole(beats(5, 0, 9_000), burst)))
    assert "identifier 6F0h: not seen in the golden capture; it is too rare to be due" in text


ROOT = Path(__file__).parents[2]


def test_page_shows_what_the_samples_give() -> None:
    """The example and the kinds of docs/comparing.md."""
    page = (ROOT / "docs" / "comparing.md").read_text(encoding="utf-8")
    golden, capture = (ROOT / "samples" / f"{name}.mcap" for name in ("healthy_line", "bad_day"))
    text = comparison_text(syncline_analyzer.compare(golden, capture))
    told = {line.rstrip() for line in text.splitlines()}
    example = page.split("```\n")[2].splitlines()
    assert len(example) > 8
    assert [line for line in example if line not in told] == []
    assert [kind for kind in KINDS if f"`{kind}`" not in page] == []
