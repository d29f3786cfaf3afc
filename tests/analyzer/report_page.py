"""What tests ask of a report: its elements, its numbers, and what a real browser makes of it."""

import json
import re
import shutil
import subprocess
import tempfile
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.report_html import report

VOID = {"meta", "br"}
AUDIT = Path(__file__).with_name("report_audit.js")

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
    """The page without its scripts."""
    return re.sub(r"<script>.*?</script>", "", report(shown), flags=re.DOTALL)


def figures(page: str) -> dict[str, str]:
    """Plots of a page by title."""
    found = re.findall(r'<figure class="plot".*?</figure>', page, flags=re.DOTALL)
    return {unescape(re.findall("<figcaption>(.*?)</figcaption>", each)[0]): each for each in found}


def paths(figure: str, kind: str) -> list[str]:
    """Paths of a plot whose class starts so."""
    return re.findall(rf'<path d="([^"]*)" class="{kind}[^"]*"/>', figure)


def points(path: str) -> list[tuple[float, float]]:
    """Points of a path without its interruptions."""
    numbers = [float(each) for each in path.replace("M", " ").split()]
    return list(zip(numbers[::2], numbers[1::2], strict=True))


def browse(page: Path, *flags: str) -> tuple[str, list[str]]:
    """DOM after scripts, and what the page wrote to the console."""
    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        done = subprocess.run(
            [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", *flags, page.as_uri()],
            capture_output=True, encoding="utf-8", errors="replace", timeout=120, check=True,
        )  # fmt: skip
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def asked(page: Path, script: str, *flags: str) -> tuple[Any, list[str]]:
    """What a script answers that runs in a page at the end, as `answer(value)`; and the console."""
    told = "const answer = (value) => { document.body.dataset.told = JSON.stringify(value); };"
    html = page.read_text(encoding="utf-8")
    at = html.rindex("</body>")
    probe = page.with_name(f"asked-{page.name}")
    probe.write_text(f"{html[:at]}<script>{told}{script}</script>{html[at:]}", encoding="utf-8")
    dom, console = browse(probe, "--dump-dom", *flags)
    found = re.search(r'data-told="(.*?)"', dom, flags=re.DOTALL)
    assert found is not None, console or "the script did not answer"
    return json.loads(unescape(found[1])), console
