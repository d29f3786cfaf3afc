"""`syncline bundle`: one file for the supplier, and whether such a file is still what it was."""

from pathlib import Path

import click

from syncline_analyzer.command_options import (
    CAPTURES,
    NOT_REACHED,
    OFFSET,
    machine_options,
    named_devices,
    named_offsets,
    range_options,
    reading_progress,
)
from syncline_schemas.description import BusDescription
from syncline_schemas.errors import UsageError


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline bundle line3.mcap -o case.zip --around nmt.node_lost@5 --redact 180-1FF\n"
    "  syncline bundle --check case.zip"
)
@CAPTURES
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="CASE.zip",
    help="The bundle to write.",
)
@click.option(
    "--around",
    metavar="FINDING",
    help="Keep a minute before a finding to half a minute after it: its place in the report"
    " (1 is the first), its id, or id@node.",
)
@range_options("Keep from here", "Keep what is")
@click.option(
    "--redact",
    multiple=True,
    metavar="ID,...",
    help="Drop the payload of identifiers: 18A, 180-1FF, or node:5 for all of a node. Report and"
    " analysis are made afterwards. May be repeated.",
)
@machine_options("of which the capture does not tell it")
@OFFSET
@click.option("--check", is_flag=True, help="Check the hashes of bundles instead of making one.")
@click.pass_context
def bundle(
    ctx: click.Context,
    captures: tuple[Path, ...],
    output: Path | None,
    around: str | None,
    start: str | None,
    end: str | None,
    redact: tuple[str, ...],
    description: Path | None,
    devices: tuple[str, ...],
    bitrate: int | None,
    data_bitrate: int | None,
    offsets: tuple[str, ...],
    check: bool,
) -> None:
    """Make one file for the supplier: capture, report, EDS files, bus description, hashes.

    The zip file holds the capture or a part of it, report.html, the analysis as JSON, all device
    files, a README and a manifest with the SHA-256 of each; the same input gives the same file.
    'syncline analyze CASE.zip' reads it as it is. With --check: exits with 1 when something in a
    bundle is not what was put in.
    """
    if check:
        ctx.exit(_checked(captures))
    if output is None:
        raise UsageError("name the file to write: -o case.zip")
    from syncline_analyzer.bundle.make import Case, make_bundle

    case = Case(
        captures,
        BusDescription.load(description) if description else None,
        named_devices(devices),
        bitrate,
        data_bitrate,
        around,
        start,
        end,
        redact,
        named_offsets(offsets),
    )
    with reading_progress(captures) as line:
        result = make_bundle(case, output, line)
    done = result.written
    click.echo(f"{output}: {done.frames:,} frames, {len(result.members)} files", err=True)
    if done.before or done.after:
        left = f"{done.before:,} frames before and {done.after:,} after them"
        click.echo(f"  left out: {left}", err=True)
    if done.redacted:
        click.echo(f"  redacted: the payload of {done.redacted:,} frames", err=True)
    elif redact:
        click.echo("  redacted: nothing, no frame has such an identifier", err=True)
    for note in result.notes:
        click.echo(f"  {note}", err=True)


def _checked(paths: tuple[Path, ...]) -> int:
    """Say of each bundle whether it is whole; the exit code."""
    from syncline_analyzer.bundle.archive import check_bundle

    code = 0
    for path in paths:
        wrong = check_bundle(path)
        click.echo(f"{path}: {'everything is as it was put in' if not wrong else 'changed'}")
        for line in wrong:
            click.echo(f"  {line}")
            code = NOT_REACHED
    return code
