"""What `syncline record` prints: the start, the status, the result."""

import json
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from syncline_logger.standard_output import print_line

if TYPE_CHECKING:
    from syncline_logger.live_status import StatusSnapshot
    from syncline_logger.recording import RecordResult

TERMINAL_PERIOD_NS = 1_000_000_000
JSON_PERIOD_NS = 10_000_000_000


class RecordView:
    """One live line on a terminal; elsewhere one JSON object per line on stdout.

    Attributes:
        period_ns: how often the status is shown unless the user says otherwise.
    """

    def __init__(self, stack: ExitStack) -> None:
        self._terminal = sys.stderr.isatty()
        self._show = _terminal_line(stack) if self._terminal else _print_json
        self.period_ns = TERMINAL_PERIOD_NS if self._terminal else JSON_PERIOD_NS

    def started(self, path: Path) -> None:
        """Tell where the recording goes."""
        if self._terminal:
            click.echo(f"recording to {path}; Ctrl-C stops", err=True)
        else:
            print_line(json.dumps({"path": str(path)}))

    def status(self, snapshot: "StatusSnapshot") -> None:
        """Show the state of the recorder."""
        self._show(snapshot)

    def words(self, text: str) -> None:
        """Say something beside the status."""
        with suppress(OSError):
            click.echo(text, err=True)


def say_result(result: "RecordResult", *, triggered_only: bool = False) -> None:
    """Words about a finished recording, of which only what lies around triggers may be written."""
    from syncline_schemas.wording import counted

    for problem in result.problems:
        click.echo(problem, err=True)
    for bus, count in result.frames.items():
        if count == 0:
            click.echo(f"{bus}: nothing was heard; check the bit rate and the wiring", err=True)
    frames, gaps = counted(result.frame_count, "frame"), counted(result.gap_count, "gap")
    lost = f", {counted(result.lost_frames, 'frame')} lost" if result.lost_frames else ""
    more = f" and {counted(result.files - 1, 'more file')}" if result.files > 1 else ""
    where = f"{result.path}{more}"
    if triggered_only:
        where = where if result.files else "nothing was written"
        frames = f"{result.frames_written} of {frames} received"
    click.echo(f"{where}: {frames}, {gaps}{lost}", err=True)


def mention_cut_files(folder: Path) -> None:
    """Tell of captures without an end that the recorder does not finish by itself."""
    from syncline_logger.recording_folder import strangers_without_end

    for path in strangers_without_end(folder) if folder.is_dir() else ():
        click.echo(
            f"{path} has no end: its recorder was killed, or still runs;"
            f" 'syncline recover {path}' makes a regular file of it",
            err=True,
        )


def _print_json(snapshot: "StatusSnapshot") -> None:
    from syncline_logger.status_view import status_json

    print_line(status_json(snapshot))


def _terminal_line(stack: ExitStack) -> "Callable[[StatusSnapshot], None]":
    from rich.console import Console
    from rich.live import Live

    from syncline_logger.status_view import status_line

    live = stack.enter_context(Live(console=Console(stderr=True), auto_refresh=False))

    def show(snapshot: "StatusSnapshot") -> None:
        with suppress(OSError):  # the terminal may be gone; the recording goes on
            live.update(status_line(snapshot), refresh=True)

    return show
