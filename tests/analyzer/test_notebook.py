"""What a notebook shows of sessions, and that the example notebook runs."""

import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from syncline_analyzer.session import open_session
from syncline_analyzer.views.notebook import analysis_html, finding_html
from tests.analyzer.analysis_builder import (
    analysis,
    bad_day,
    finding,
    many_nodes,
    node_row,
    untimed,
    usual_states,
)

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs" / "notebook.ipynb"


class Page(HTMLParser):
    """Text of a page, and whether its tags close in order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.add(tag)
        if tag != "br":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_a_session_says_what_it_holds() -> None:
    session = open_session(ROOT / "samples" / "bad_day.mcap")
    assert repr(session) == "<syncline session of bad_day.mcap, not analyzed yet>"
    assert "not analyzed yet" in Page(session._repr_html_()).text
    told = session.analysis
    assert repr(session) == (
        "<syncline session of bad_day.mcap: 11,545 frames in 2 min on can0, 8 nodes:"
        " 5 errors, 9 warnings, 1 note>"
    )
    assert repr(told).startswith("<analysis of bad_day.mcap: 11,545 frames")
    page = Page(session._repr_html_())
    assert not page.open
    assert "5 errors, 9 warnings, 1 note" in page.text
    assert "platform tilt" in page.text
    assert all(each.text in page.text for each in told.findings[:5])


def test_a_finding_shows_its_cause_and_evidence() -> None:
    shown = finding(text="Node 10 was lost.", cause="Supply.", check_next="Plug.")
    assert repr(shown).startswith(f"<{shown.severity} {shown.id} on can0 node 10, frames ")
    assert str(shown) == f"{shown.severity}: Node 10 was lost. [{shown.id}]"
    page = Page(finding_html(shown))
    assert not page.open
    for words in ("Node 10 was lost.", "Supply.", "Plug.", "175000"):
        assert words in page.text


@pytest.mark.parametrize("shown", [analysis(), untimed(), many_nodes(), bad_day()])
def test_every_analysis_can_be_shown(shown: object) -> None:
    assert not Page(shown._repr_html_()).open  # type: ignore[attr-defined]


def test_what_devices_say_is_escaped() -> None:
    evil = "<script>alert(1)</script>\x1b"
    shown = analysis(
        nodes=[node_row(name=evil)],
        nmt_states=usual_states(10),
        findings=[finding(text=evil, cause=evil, check_next=evil)],
    )
    for html in (analysis_html(shown), finding_html(shown.findings[0])):
        page = Page(html)
        assert "script" not in page.tags
        assert "<script>alert(1)</script>" in page.text
        assert "\x1b" not in html


def test_the_example_notebook_runs_and_holds_no_outputs() -> None:
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    if sys.platform == "win32":
        pytest.skip("the kernel's event loop warns on Windows")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not [cell for cell in code if cell.outputs or cell.execution_count]
    done = nbclient.NotebookClient(
        notebook, timeout=120, resources={"metadata": {"path": str(NOTEBOOK.parent)}}
    ).execute()
    shown = [out for cell in done.cells for out in cell.get("outputs", ())]
    assert not [out for out in shown if out.output_type in ("error", "stream")]
    assert any("5 errors, 9 warnings" in str(out.get("data", "")) for out in shown)
