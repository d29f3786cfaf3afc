"""Makes the picture of a fleet's report: `python -m docs.fleet_picture`; it needs a browser.

Eight machines over twelve days: on one a node restarts by itself, on another one answers later.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import click

from docs.picture import PICTURES, page
from syncline_samples.fleet import Planted, Template, fleet_captures

MACHINES, DAYS = 8, 12
LATE_FROM, RESETS_FROM = 6, 8
LATE, RESTARTING, IDLE = 5, 2, 6
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def plan(machine: int, day: int) -> Planted | None:
    """What is wrong on a machine on a day; None where it did not run."""
    if machine == IDLE and day % 7 in (5, 6):
        return None
    late_us = 400.0 if machine == LATE and day >= LATE_FROM else 0.0
    resets = day % 3 if machine == RESTARTING and day >= RESETS_FROM else 0
    return Planted(late_us=late_us, resets=resets)


@click.command()
def main() -> None:
    """Make the picture `fleet.png`."""
    browser = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        raise click.UsageError("no browser is here")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        source, out = folder / "captures", folder / "fleet"
        for _ in fleet_captures(source, MACHINES, DAYS, plan, Template(12.0)):
            pass
        program = "from syncline_logger.cli import main; main()"
        arguments = ["fleet", "analyze", str(source), "--out", str(out), "--reports"]
        subprocess.run([sys.executable, "-c", program, *arguments], check=True)
        shown = out / "report.html"
        named = shown.read_text(encoding="utf-8").replace(out.as_posix(), "/data/fleet")
        shown.write_text(named, encoding="utf-8")
        page(browser, shown, PICTURES / "fleet.png")


if __name__ == "__main__":
    main()
