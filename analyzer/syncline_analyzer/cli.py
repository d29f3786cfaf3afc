"""The commands that read captures: `analyze`, `view`, `convert` and `info`."""

import sys
import tempfile
from collections.abc import Callable
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import click

from syncline_schemas.errors import SynclineError, UsageError

if TYPE_CHECKING:
    from syncline_analyzer.results import Analysis

NOT_REACHED = 1
"""Exit code: the command ran, but what was wanted is not so (`--check`, damaged capture)."""


class Selection(TypedDict):
    """Options of every command that analyzes."""

    captures: tuple[Path, ...]
    description: Path | None
    devices: tuple[str, ...]
    bitrate: int | None
    data_bitrate: int | None
    start: str | None
    end: str | None


_CAPTURES = click.argument(
    "captures", nargs=-1, required=True, metavar="CAPTURE...", type=click.Path(path_type=Path)
)
_SELECTION = (
    _CAPTURES,
    click.option(
        "--description",
        metavar="BUS.toml",
        type=click.Path(path_type=Path),
        help="Bus description; by default the one that the capture carries.",
    ),
    click.option(
        "--device",
        "devices",
        multiple=True,
        metavar="NODE=NAME_OR_EDS",
        help="What a node is: a device of 'syncline devices' or an EDS file. May be repeated.",
    ),
    click.option(
        "--bitrate",
        type=click.IntRange(min=1),
        metavar="BIT/S",
        help="Bit rate of buses of which neither description nor capture tells it; else it is"
        " estimated from the frames.",
    ),
    click.option(
        "--data-bitrate",
        type=click.IntRange(min=1),
        metavar="BIT/S",
        help="The same of the data phase of CAN FD frames, which is never estimated.",
    ),
    click.option(
        "--from",
        "start",
        metavar="TIME",
        help="Start here: 90s or 1m30s into the capture, or UTC as 2026-03-01T12:00:00Z.",
    ),
    click.option("--to", "end", metavar="TIME", help="Stop before this time, written alike."),
)


def _selecting(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the captures and the options of `Selection`."""
    for option in reversed(_SELECTION):
        command = option(command)
    return command


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline analyze line3.mcap --out report\n"
    "  syncline analyze night.log.gz --device 10=jn2100 --format json --check error"
)
@_selecting
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write report.html, session.rrd, tables/*.parquet and findings.json into this folder.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    help="What to print: a summary for people, or everything as one JSON object.",
)
@click.option(
    "--check",
    type=click.Choice(["error", "warning"]),
    help="Exit with 1 when there is a finding of this severity or worse.",
)
@click.pass_context
def analyze(
    ctx: click.Context,
    out: Path | None,
    form: str,
    check: str | None,
    **selection: Unpack[Selection],
) -> None:
    """Reconstruct what happened on a bus from captures.

    Several captures are one session of one machine; gzip files are read as they are. Exits with 1
    when a capture is damaged and could be read only in part, or when --check is not passed.
    """
    if out is not None:
        _make_folder(out)
    analysis = _analyzed(selection)
    if form == "json":
        _print_json(analysis)
    else:
        _print_text(analysis)
    if out is not None:
        _write(analysis, out)
    if analysis.capture.damage or _worse_than(check, analysis):
        ctx.exit(NOT_REACHED)


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline view line3.mcap\n"
    "  syncline view monday.log tuesday.log --description bus.toml --web"
)
@_selecting
@click.option("--web", is_flag=True, help="Show it in a browser on this machine.")
@click.pass_context
def view(ctx: click.Context, web: bool, **selection: Unpack[Selection]) -> None:
    """Analyze captures and open the Rerun viewer on them.

    The viewer is reachable from this machine only; the command ends when it is closed.
    """
    from syncline_analyzer.viewer import show
    from syncline_analyzer.views.rerun_view import write_rrd

    analysis = _analyzed(selection)
    with tempfile.TemporaryDirectory(prefix="syncline-") as folder:
        recording = write_rrd(analysis, Path(folder, "session.rrd"))
        ctx.exit(show(recording, web=web))


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline convert night.asc night.mcap\n"
    "  syncline convert monday.mcap tuesday.mcap week.log.gz"
)
@click.argument("inputs", nargs=-1, required=True, metavar="IN...", type=click.Path(path_type=Path))
@click.argument("output", metavar="OUT", type=click.Path(path_type=Path))
@click.pass_context
def convert(ctx: click.Context, inputs: tuple[Path, ...], output: Path) -> None:
    """Convert between everything that can be read and written.

    The ending of OUT tells the format: .mcap .log .asc .blf .trc .pcapng .csv .parquet, all but
    .mcap, .blf and .parquet also with .gz or .zst behind.
    What the format of OUT cannot hold is said; exits with 1 when an input is damaged.
    """
    from syncline_analyzer.convert import convert as run

    result = run(inputs, output)
    click.echo(f"{result.output}: {result.frames:,} frames as {result.format}", err=True)
    for what, count in result.lost.items():
        click.echo(f"  {result.format} cannot hold: {what} ({count:,})", err=True)
    if result.unparsed_lines:
        click.echo(f"  {result.unparsed_lines:,} lines could not be read", err=True)
    for line in (*result.damage, *result.notes):
        click.echo(f"  {line}", err=True)
    if result.damage:
        ctx.exit(NOT_REACHED)


@click.command(
    epilog="\b\nExamples:\n  syncline info line3.mcap\n  syncline info captures/*.log.gz"
)
@_CAPTURES
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
            found = inspect(path)
        except SynclineError as error:
            click.echo(f"syncline: {error}", err=True)
            code = max(code, error.exit_code)
            continue
        click.echo(info_text(found))
        code = max(code, 0 if found.whole else NOT_REACHED)
    ctx.exit(code)


def _analyzed(selection: Selection) -> "Analysis":
    from syncline_analyzer.session import open_session

    session = open_session(
        selection["captures"],
        description=selection["description"],
        devices=dict(device_option(text) for text in selection["devices"]),
        bitrate=selection["bitrate"],
        data_bitrate=selection["data_bitrate"],
        start=selection["start"],
        end=selection["end"],
    )
    if not sys.stderr.isatty():
        return session.analyze(None)
    try:
        return session.analyze(_tell_frames)
    finally:
        click.echo("\r\x1b[K", err=True, nl=False)


def _tell_frames(frames: int) -> None:
    click.echo(f"\r{frames:,} frames", err=True, nl=False)


def device_option(text: str) -> tuple[int, str]:
    """Node and device of "10=jn2100"; the node also as 0x0A. Raises: UsageError."""
    node, _, name = text.partition("=")
    try:
        number = int(node, 0)
    except ValueError:
        number = 0
    if not (name and 1 <= number <= 127):
        raise UsageError(
            f"--device {text}: write it as NODE=NAME_OR_EDS with a node from 1 to 127,"
            " for example 10=jn2100"
        )
    return number, name


def _make_folder(folder: Path) -> None:
    """Make the folder for the results before anything is read. Raises: UsageError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {folder}: cannot be made: {error.strerror or error}") from error


def _print_json(analysis: "Analysis") -> None:
    from syncline_analyzer.views.json_view import to_json

    click.echo(to_json(analysis))


def _print_text(analysis: "Analysis") -> None:
    from syncline_analyzer.views.text import console_for, print_summary

    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    print_summary(analysis, console_for(sys.stdout))


def _write(analysis: "Analysis", folder: Path) -> None:
    from syncline_analyzer.views.files import write_all

    write_all(analysis, folder)
    click.echo(f"Wrote {folder / 'report.html'}, session.rrd, findings.json and tables.", err=True)


def _worse_than(check: str | None, analysis: "Analysis") -> bool:
    wanted = {None: (), "error": ("error",), "warning": ("error", "warning")}[check]
    return any(finding.severity in wanted for finding in analysis.findings)
