"""Writing the report of a fleet into its data set, or elsewhere."""

import os
from dataclasses import replace
from pathlib import Path

from syncline_analyzer.fleet.database import Database
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.layout import REPORTS
from syncline_analyzer.fleet.overview import overview
from syncline_analyzer.fleet.scope import EVERYTHING, Scope
from syncline_analyzer.fleet.storage import Storage
from syncline_analyzer.fleet.trend_lines import trend_lines
from syncline_analyzer.views.fleet_links import Links
from syncline_analyzer.views.fleet_report import fleet_page
from syncline_schemas.errors import UsageError

REPORT_FILE = "report.html"
"""Below the root of the data set."""


def write_fleet_report(data: Dataset, scope: Scope = EVERYTHING, out: Path | None = None) -> str:
    """Write the report of a data set; where it is now.

    Args:
        scope: which captures it tells of.
        out: the file; by default `report.html` in the data set.

    Raises:
        UsageError: the data set cannot be read, or the file not be written.
    """
    wanted = replace(data, captures=scope.of_these(data.captures))
    found = overview(Database(wanted), scope.of_failures(data.failures))
    links = Links(_folder(data.storage, out), found.reports)
    # Trends of some machines are judged beside all others.
    all_machines = replace(scope, machine=None)
    compared = Database(replace(data, captures=all_machines.of_these(data.captures)))
    trends = trend_lines(compared, scope.machine)
    page = fleet_page(found, trends, links, data.storage.url, scope.words)
    return _write(data.storage, page, out)


def _folder(storage: Storage, out: Path | None) -> str | None:
    """Where the captures' reports are, as a page sees it; None where no link leads there."""
    if out is None:
        return REPORTS
    if not storage.local:
        return None
    try:
        return Path(os.path.relpath(storage.folder(REPORTS), out.absolute().parent)).as_posix()
    except ValueError:  # Another drive.
        return None


def _write(storage: Storage, page: str, out: Path | None) -> str:
    if out is None:
        storage.write(REPORT_FILE, page.encode())
        return storage.url_of(REPORT_FILE)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(page, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{out}: cannot be written: {error.strerror or error}") from error
    return str(out)
