"""`syncline fleet view` and `syncline fleet report`: looking at the captures of all machines."""

import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import click

from syncline_analyzer.fleet_options import (
    MACHINE,
    NO_DATA,
    SINCE,
    STORAGE,
    UNTIL,
    fleet_extra,
    storage_options,
)
from syncline_schemas.errors import UsageError
from syncline_schemas.progress_line import progress_line
from syncline_schemas.wording import counted

_LONG_S = 3600.0
_SHOWN = 3


@click.command(
    short_help="Open the Rerun viewer on all captures.",
    epilog="\b\nExamples:\n"
    "  syncline fleet view /data/fleet\n"
    '  syncline fleet view /data/fleet --machine "press-*" --since 2026-11-01 --web',
)
@click.argument("dest", metavar="DEST")
@MACHINE
@SINCE
@UNTIL
@click.option(
    "--port",
    type=click.IntRange(1, 65_535),
    metavar="N",
    help="Port of the catalog on this machine; by default a free one.",
)
@click.option(
    "--limit",
    type=click.IntRange(min=1),
    default=1000,
    show_default=True,
    metavar="N",
    help="At most so many captures, the latest; each takes about 1.5 MB of memory.",
)
@click.option("--web", is_flag=True, help="Show it in a browser on this machine.")
@click.option("--no-open", is_flag=True, help="Serve the catalog, without a viewer, until Ctrl-C.")
@STORAGE
@click.pass_context
def view(
    ctx: click.Context,
    dest: str,
    machine: str | None,
    since: str | None,
    until: str | None,
    port: int | None,
    limit: int,
    web: bool,
    no_open: bool,
    storage_pairs: tuple[str, ...],
) -> None:
    """Open the Rerun viewer on the recordings of all captures in DEST.

    The table of the captures can be filtered and sorted by machine, date, verdict and number of
    findings; a click opens a capture. 'syncline fleet analyze --rrd' makes the recordings. The
    catalog is reachable from this machine only; the command ends when the viewer is closed.
    """
    if web and no_open:
        raise UsageError("--web opens a viewer, --no-open none: name one")
    with fleet_extra():
        from syncline_analyzer.fleet.catalog import recorded, recordings, served
        from syncline_analyzer.fleet.dataset import Dataset
        from syncline_analyzer.fleet.scope import Scope
        from syncline_analyzer.viewer import show

        with progress_line() as line:
            if line:
                line.say("looking for recordings")
            data = Dataset.open(dest, storage_options(storage_pairs))
            wanted = recorded(data, Scope.of(machine, since, until))
        if not data.captures:
            raise UsageError(NO_DATA.format(dest))
        if not wanted:
            raise UsageError(_nothing(dest, any_recording=bool(recorded(data))))
        if len(wanted) > limit:
            told = f"{counted(len(wanted) - limit, 'older capture')} left out: --machine, --since"
            click.echo(f"{told} and --limit choose", err=True)
        with ExitStack() as stack:
            files = stack.enter_context(recordings(data.storage, wanted[:limit]))
            if not files:
                raise UsageError(_nothing(dest, any_recording=False))
            catalog = stack.enter_context(served(files, port))
            click.echo(f"{counted(catalog.captures, 'capture')} at {catalog.url}", err=True)
            if catalog.unread:
                click.echo(_unread(catalog.unread), err=True)
            if no_open:
                click.echo(catalog.table_url)
                _wait()
            else:
                ctx.exit(show(catalog.table_url, web=web))


@click.command(
    short_help="Write one page about all machines.",
    epilog="\b\nExamples:\n"
    "  syncline fleet report /data/fleet\n"
    "  syncline fleet report s3://fleet/a --out november.html --since 2026-11-01",
)
@click.argument("dest", metavar="DEST")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write there instead of DEST/report.html.",
)
@MACHINE
@SINCE
@UNTIL
@STORAGE
def report(
    dest: str,
    out: Path | None,
    machine: str | None,
    since: str | None,
    until: str | None,
    storage_pairs: tuple[str, ...],
) -> None:
    """Write one page about all machines in DEST: which are in trouble, since when, and what drifts.

    It opens in any browser without a network, and leads to the reports of the captures, which
    'syncline fleet analyze --reports' makes; then this page is written too.
    """
    if out is None and (machine or since or until):
        raise UsageError("DEST/report.html is of all captures: name another file by --out")
    with fleet_extra():
        from syncline_analyzer.fleet.dataset import Dataset
        from syncline_analyzer.fleet.report import write_fleet_report
        from syncline_analyzer.fleet.scope import Scope

        with progress_line() as line:
            if line:
                line.say("reading the data set")
            data = Dataset.open(dest, storage_options(storage_pairs))
            if not data.captures and not data.failures:
                raise UsageError(NO_DATA.format(dest))
            click.echo(write_fleet_report(data, Scope.of(machine, since, until), out))


def _unread(names: Sequence[str]) -> str:
    some = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
    return f"{counted(len(names), 'recording')} cannot be read: {some}"


def _nothing(dest: str, *, any_recording: bool) -> str:
    if any_recording:
        return f"{dest}: no capture of this machine and time has a recording"
    return (
        f"{dest}: no capture has a recording yet; make them:"
        f" syncline fleet analyze SOURCE... --out {dest} --rrd"
    )


def _wait() -> None:
    """Until somebody types Ctrl-C, which is how it is meant to end."""
    with suppress(KeyboardInterrupt):
        while True:
            time.sleep(_LONG_S)
