"""How far a run is: a line on a terminal, or one JSON object a line."""

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from syncline_analyzer.fleet.plan import Plan
from syncline_analyzer.fleet.run import Summary
from syncline_analyzer.fleet.task import Outcome, Task
from syncline_analyzer.views.words import duration
from syncline_schemas.wording import counted

_SHOWN_FAILURES = 10


class Silent:
    """Tells nothing."""

    def planned(self, planned: Plan) -> None:
        """See `Watcher`."""

    def done(self, task: Task, outcome: Outcome) -> None:
        """See `Watcher`."""

    def lost(self, reason: str) -> None:
        """See `Watcher`."""

    def packing(self, captures: int) -> None:
        """See `Watcher`."""


class JsonLines(Silent):
    """One JSON object a line on stdout: of each capture that is done."""

    def done(self, task: Task, outcome: Outcome) -> None:
        """Print what came of a task."""
        click.echo(json.dumps(_event(task, outcome)))

    def lost(self, reason: str) -> None:
        """Say that the scheduler is gone."""
        click.echo(json.dumps({"event": "scheduler lost", "reason": reason}))

    def packing(self, captures: int) -> None:
        """Say that tables are packed."""
        click.echo(json.dumps({"event": "packing", "captures": captures}))


class Line(Silent):
    """A line on a terminal: captures done, frames a second, time left."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._id: TaskID | None = None
        self._begun_s = time.monotonic()
        self._frames = self._done_bytes = self._all_bytes = 0

    def planned(self, planned: Plan) -> None:
        """Show what is to be done."""
        self._begun_s = time.monotonic()
        self._all_bytes = planned.size_bytes
        self._id = self._progress.add_task("", total=len(planned.tasks), speed="", left="")

    def done(self, task: Task, outcome: Outcome) -> None:
        """Show that one more is done."""
        self._frames += outcome.frames
        self._done_bytes += task.recording.size_bytes
        passed_s = max(time.monotonic() - self._begun_s, 1e-3)
        share = self._done_bytes / max(self._all_bytes, 1)
        # By bytes: captures are of unequal length, and the largest are done first.
        left_ns = round(passed_s * (1 - share) / max(share, 1e-9)) * 10**9
        assert self._id is not None
        self._progress.update(
            self._id,
            advance=1,
            speed=f"{self._frames / passed_s:,.0f} frames/s",
            left=f"{duration(left_ns)} left" if left_ns else "",
        )

    def lost(self, reason: str) -> None:
        """Say that the scheduler is gone."""
        self._progress.console.print(f"The scheduler is lost ({reason}); waiting for it.")

    def packing(self, captures: int) -> None:
        """Say what takes a while after the last capture."""
        self._progress.console.print(f"Packing the tables of {counted(captures, 'capture')}.")


@contextmanager
def watching(*, as_json: bool) -> Iterator[Silent]:
    """What shows a run: JSON lines, else a line where there is a terminal, else nothing."""
    if as_json:
        yield JsonLines()
    elif not sys.stderr.isatty():
        yield Silent()
    else:
        columns = (
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("captures {task.fields[speed]} {task.fields[left]}"),
        )
        console = Console(file=sys.stderr)
        with Progress(*columns, console=console, transient=True) as progress:
            yield Line(progress)


def summary_json(summary: Summary, out: str) -> str:
    """The last line of a run."""
    return json.dumps({"event": "summary", "out": out, **asdict(summary)})


def summary_lines(summary: Summary, out: str) -> Iterator[str]:
    """What a run came to, in words."""
    yield (
        f"{summary.captures:,} recordings: {summary.analyzed:,} analyzed,"
        f" {summary.unchanged:,} unchanged, {summary.failed:,} failed"
        + (f", {summary.no_captures:,} files are no captures" if summary.no_captures else "")
    )
    if summary.analyzed:
        verdicts = ", ".join(
            f"{count:,} {each}" for each, count in sorted(summary.verdicts.items())
        )
        speed = summary.frames / max(summary.wall_s, 1e-3)
        yield (
            f"{summary.frames:,} frames in {duration(round(summary.wall_s * 1e9))}"
            f" ({speed:,.0f} frames/s, CPU {duration(round(summary.cpu_s * 1e9))},"
            f" at most {summary.peak_mb:.0f} MB a worker): {verdicts}"
        )
    for url, reason in summary.failures[:_SHOWN_FAILURES]:
        yield f"  failed: {url}: {reason.removeprefix(f'{url}: ')}"
    if summary.failed > _SHOWN_FAILURES:
        yield f"  and {summary.failed - _SHOWN_FAILURES:,} more, all in {out}/failures"


def _event(task: Task, outcome: Outcome) -> dict[str, Any]:
    row = {key: value for key, value in asdict(outcome).items() if key != "partition"}
    partition = outcome.partition._asdict() if outcome.partition else {}
    urls = [file.url for file in task.recording.files]
    return {"event": "capture", "urls": urls, "machine": task.recording.machine, **partition, **row}
