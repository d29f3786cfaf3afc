"""The report of a fleet in a real browser: no complaint, keys and filter work, open to everybody."""

from functools import cache
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("duckdb")
pytest.importorskip("fsspec")

from syncline_analyzer.fleet.overview import Overview, overview
from syncline_analyzer.fleet.trend_lines import trend_lines
from syncline_analyzer.views.fleet_links import Links
from syncline_analyzer.views.fleet_report import fleet_page
from tests.analyzer.fleet.overview_builder import (
    Tables,
    big_fleet,
    capture,
    drifting_fleet,
    failure,
    finding,
)
from tests.analyzer.report_page import AUDIT, asked, browse, in_browser

USE = Path(__file__).with_name("fleet_use.js")
WIDE = ("--window-size=1280,900",)
PHONE = ("--window-size=600,1350", "--force-device-scale-factor=1.54")
"""390 pixels wide."""
LIGHT, DARK = (f"--blink-settings=preferredColorScheme={scheme}" for scheme in (1, 0))
EVIL = "<script>document.title = 'run'</script><img src=x onerror=alert(1)>"

pytestmark = in_browser


@cache
def many() -> Overview:
    return overview(big_fleet(60, 9), [failure("machine-000")])


def evil() -> Overview:
    """A fleet whose names and texts would like to be markup."""
    of = capture(EVIL, 0, errors=1)
    rows = {"captures": [of], "findings": [finding(of, EVIL, text=EVIL)]}
    return overview(Tables(rows), [failure(EVIL, EVIL, EVIL)])


def written(found: Overview, folder: Path) -> Path:
    page = folder / "report.html"
    text = fleet_page(found, [], Links("reports", found.reports), "/data/fleet")
    page.write_text(text, encoding="utf-8")
    return page


def audited(page: Path, *flags: str) -> Any:
    audit, console = asked(page, AUDIT.read_text(encoding="utf-8"), *flags)
    assert console == []
    return audit


def test_keys_pointer_and_filter(tmp_path: Path) -> None:
    script = USE.read_text(encoding="utf-8") + "\nanswer(told);"
    told, console = asked(written(many(), tmp_path), script, *WIDE, LIGHT)
    assert console == []
    assert told["stops"] == [1, 1]
    first, second = [machine.name for machine in many().machines[:2]]
    assert told["first"][0] == f"{first}, 2026-03-02: healthy"
    assert told["first"][1].startswith("reports/c")
    assert told["ArrowRight"][0].startswith(f"{first}, 2026-03-03: ")
    assert told["ArrowDown"][0].startswith(f"{second}, 2026-03-03: ")
    assert told["End"][0].startswith(f"{second}, 2026-03-10: ")
    assert told["at_the_edge"] == told["Home"]
    assert told["Home"][0] == f"{second}, 2026-03-02: healthy"
    assert told["still_one"] == 1
    assert told["pointer"].startswith(f"{first}, 2026-03-10: ")
    errors = sum(machine.verdict == "error" for machine in many().machines)
    assert told["all"] == told["again"] == [61, 60, ""]
    assert told["named"] == [10, 10, "10 of 61 machines"]
    assert told["opened"]
    assert told["without_errors"][:2] == [61 - errors, 60 - errors]
    assert told["card_shown"]
    assert told["closed"] == 0


@pytest.mark.parametrize("flags", [(*WIDE, LIGHT), (*PHONE, DARK)], ids=["wide", "phone"])
def test_page_has_no_fault(flags: tuple[str, ...], tmp_path: Path) -> None:
    audit = audited(written(many(), tmp_path), *flags)
    assert audit["faults"] == []
    assert audit["ready"] == "true"


def test_trends_are_drawn(tmp_path: Path) -> None:
    tables, page = drifting_fleet(), tmp_path / "r.html"
    found = overview(tables)
    links = Links("reports", found.reports)
    page.write_text(fleet_page(found, trend_lines(tables), links, "x"), encoding="utf-8")
    assert audited(page, *PHONE, LIGHT)["faults"] == []


def test_names_and_texts_run_nowhere(tmp_path: Path) -> None:
    page = written(evil(), tmp_path)
    audit = audited(page, *PHONE, LIGHT)
    assert audit["faults"] == []
    assert audit["ready"] == "true"
    title, _ = asked(page, "answer([document.title, document.images.length]);", *WIDE)
    assert title == ["Fleet: 1 of 1 machine with errors", 0]


def test_colours_of_the_map_are_seen_by_day_and_night(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    for scheme, healthy in ((LIGHT, (207, 232, 208)), (DARK, (31, 58, 35))):
        picture = tmp_path / "r.png"
        browse(written(many(), tmp_path), f"--screenshot={picture}", "--window-size=1280,1400", scheme)  # fmt: skip
        pixels = image.open(picture).convert("RGB")
        counts = {colour: count for count, colour in pixels.getcolors(1 << 24)}
        for colour in ((183, 28, 28), (255, 183, 77), healthy):
            assert counts.get(colour, 0) > 3000, (scheme, colour)
