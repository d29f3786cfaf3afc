"""The commands that read captures: `analyze`, `view`, `convert` and `info`."""

import sys
from functools import partial
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

from syncline_analyzer.command_options import (
    CAPTURES,
    CHECK,
    NOT_REACHED,
    OFFSET,
    PATH,
    Selection,
    as_bad_as,
    format_option,
    named_offsets,
    reading_progress,
    selecting,
    session_of,
)
from syncline_schemas.collecting import rare_collections
from syncline_schemas.errors import SynclineError, UsageError
from syncline_schemas.progress_line import progress_line

if TYPE_CHECKING:
    from syncline_analyzer.results import Analysis
    from syncline_analyzer.session import Session


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline analyze line3.mcap --out report\n"
    "  syncline analyze night.log.gz --device 10=jn2100 --format json --check error"
)
@selecting
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write report.html, session.rrd, tables/*.parquet and findings.json into this folder.",
)
@format_option("a summary for people", "everything")
@click.option(
    "-v",
    "--all",
    "everything",
    is_flag=True,
    help="Print everything as text: each finding with cause and evidence, and all tables.",
)
@CHECK
@click.pass_context
@rare_collections()
def analyze(
    ctx: click.Context,
    out: Path | None,
    form: str,
    everything: bool,
    check: str | None,
    **selection: Unpack[Selection],
) -> None:
    """Reconstruct what happened on a bus from captures.

    Prints one screen: what was found, the NMT states of the nodes, how full the buses are; -v
    prints everything. Several captures are one session of one machine; gzip files are read as they are. Exits with 1
    when a capture is damaged and could be read only in part, or when --check is not passed.
    """
    if out is not None:
        _make_folder(out)
    view = "json_view" if form == "json" else "screen"
    session = _analyzed(selection, f"syncline_analyzer.views.{view}")
    analysis = session.analysis
    if form == "json":
        _print_json(analysis)
    else:
        _print_text(analysis, everything=everything)
    if out is not None:
        _write(session, out)
    if analysis.capture.damage or _worse_than(check, analysis):
        ctx.exit(NOT_REACHED)


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline view line3.mcap\n"
    "  syncline view monday.log tuesday.log --description bus.toml --web"
)
@selecting
@click.option("--web", is_flag=True, help="Show it in a browser on this machine.")
@click.pass_context
def view(ctx: click.Context, web: bool, **selection: Unpack[Selection]) -> None:
    """Analyze captures and open the Rerun viewer on them.

    The viewer is reachable from this machine only; the command ends when it is closed.
    """
    import tempfile

    from syncline_analyzer.viewer import show

    session = _analyzed(selection, "syncline_analyzer.views.rerun_view")
    from syncline_analyzer.views.rerun_view import write_rrd

    with tempfile.TemporaryDirectory(prefix="syncline-") as folder:
        with progress_line() as line:
            if line:
                line.say("drawing the session")
            recording = Path(folder, "session.rrd")
            write_rrd(session.analysis, recording, session.frames, decode=session.decoding)
        ctx.exit(show(recording, web=web))


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline convert night.asc night.mcap\n"
    "  syncline convert monday.mcap tuesday.mcap week.log.gz"
)
@click.argument("inputs", nargs=-1, required=True, metavar="IN...", type=PATH)
@click.argument("output", metavar="OUT", type=PATH)
@OFFSET
@click.pass_context
def convert(
    ctx: click.Context, inputs: tuple[Path, ...], output: Path, offsets: tuple[str, ...]
) -> None:
    """Convert between everything that can be read and written.

    The ending of OUT tells the format: .mcap .log .asc .blf .trc .pcapng .csv .parquet, all but
    .mcap, .blf and .parquet also with .gz or .zst behind.
    What the format of OUT cannot hold is said; exits with 1 when an input is damaged.
    """
    from syncline_analyzer.convert import convert as run

    with reading_progress(inputs, times=2) as shown:
        result = run(inputs, output, offsets=named_offsets(offsets), progress=shown)
    click.echo(f"{result.output}: {result.frames:,} frames as {result.format}", err=True)
    for what, count in result.lost.items():
        click.echo(f"  {result.format} cannot hold: {what} ({count:,})", err=True)
    if result.unparsed_lines:
        click.echo(
            f"  {result.unparsed_lines:,} line{'s' * (result.unparsed_lines != 1)} could not be read",
            err=True,
        )
    for line in (*result.damage, *result.notes):
        click.echo(f"  {line}", err=True)
    if result.damage:
        ctx.exit(NOT_REACHED)


@click.command(
    epilog="\b\nExamples:\n  syncline info line3.mcap\n  syncline info captures/*.log.gz"
)
@CAPTURES
@click.pass_context
def info(ctx: click.Context, captures: tuple[Path, ...]) -> None:
    """Say what is in a capture and whether it is whole.

    Exits with 1 when a capture is damaged and 2 when one cannot be read at all.
    """
    from syncline_analyzer.info import inspect
    from syncline_analyzer.views.info_text import info_text

    code = 0
    for path in captures:
        try:
            with reading_progress([path]) as line:
                found = inspect(path, line)
        except SynclineError as error:
            click.echo(f"syncline: {error}", err=True)
            code = max(code, error.exit_code)
            continue
        click.echo(info_text(found))
        code = max(code, 0 if found.whole else NOT_REACHED)
    ctx.exit(code)


def _analyzed(selection: Selection, view: str) -> "Session":
    """The session, analyzed; the module `view` is imported while another process begins to read."""
    session = session_of(selection)
    with reading_progress(selection["captures"]) as line:
        session.analyze(line, partial(import_module, view))
    return session


def _make_folder(folder: Path) -> None:
    """Make the folder for the results before anything is read. Raises: UsageError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {folder}: cannot be made: {error.strerror or error}") from error


def _print_json(analysis: "Analysis") -> None:
    from syncline_analyzer.views.json_view import json_parts

    sys.stdout.writelines(json_parts(analysis))
    click.echo()


def _print_text(analysis: "Analysis", *, everything: bool) -> None:
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    if everything:
        from syncline_analyzer.views.terminal import console_for
        from syncline_analyzer.views.text import print_summary

        print_summary(analysis, console_for(sys.stdout))
    else:
        from syncline_analyzer.views.screen import write_screen

        write_screen(analysis, sys.stdout)


def _write(session: "Session", folder: Path) -> None:
    from syncline_analyzer.views.files import write_all

    with progress_line() as line:
        if line:
            line.say("writing the report, the session and the tables")
        try:
            write_all(session.analysis, folder, session.frames, session.decoding)
        except OSError as error:
            reason = error.strerror or error
            raise UsageError(f"--out {folder}: cannot be written: {reason}") from error
    click.echo(f"Wrote {folder / 'report.html'}, session.rrd, findings.json and tables.", err=True)


def _worse_than(check: str | None, analysis: "Analysis") -> bool:
    return any(finding.severity in as_bad_as(check) for finding in analysis.findings)
