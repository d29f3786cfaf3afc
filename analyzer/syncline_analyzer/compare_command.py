"""`syncline compare`: what is different from a healthy capture of the same machine."""

import sys
from functools import partial
from io import TextIOWrapper
from pathlib import Path

import click

from syncline_analyzer.command_options import (
    CHECK,
    NOT_REACHED,
    OFFSET,
    PATH,
    as_bad_as,
    format_option,
    machine_options,
    named_devices,
    named_offsets,
    range_options,
    reading_progress,
)
from syncline_schemas.errors import UsageError


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline compare healthy.mcap today.mcap\n"
    "  syncline compare healthy.mcap night.log.gz --description line3.toml --out diff.html"
)
@click.argument("golden", type=PATH, metavar="GOLDEN")
@click.argument("captures", nargs=-1, required=True, type=PATH, metavar="CAPTURE...")
@machine_options("of which neither description nor capture tells it, in both")
@range_options("Start here in CAPTURE", "Stop")
@OFFSET
@format_option("differences in words", "all of them")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="PAGE.html",
    help="Write the differences as a page that opens anywhere.",
)
@CHECK
@click.pass_context
def compare(
    ctx: click.Context,
    golden: Path,
    captures: tuple[Path, ...],
    description: Path | None,
    devices: tuple[str, ...],
    bitrate: int | None,
    data_bitrate: int | None,
    start: str | None,
    end: str | None,
    offsets: tuple[str, ...],
    form: str,
    out: Path | None,
    check: str | None,
) -> None:
    """Tell what is different from a healthy capture of the same machine.

    Nodes, states, periods, bus load, EMCYs, parameters, SDO failures, PDOs, angle sensors and
    findings, ranked by what matters, each with the numbers of both. Captures of different length
    are compared by rates; what one of both could not have shown is not seen, never gone. Exits
    with 1 when a capture is damaged or holds no frames.
    """
    from syncline_analyzer.comparison import compare as compared
    from syncline_analyzer.session import open_session

    opened = partial(
        open_session,
        description=description,
        devices=named_devices(devices),
        bitrate=bitrate,
        data_bitrate=data_bitrate,
    )
    healthy = opened(golden)
    suspect = opened(captures, start=start, end=end, offsets=named_offsets(offsets))
    with reading_progress([golden]) as line:
        healthy.analyze(line)
    with reading_progress(captures) as line:
        suspect.analyze(line)
    found = compared(healthy.analysis, suspect.analysis)
    if form == "json":
        from syncline_analyzer.views.comparison_table import comparison_json

        click.echo(comparison_json(found))
    else:
        from syncline_analyzer.views.comparison_text import print_comparison
        from syncline_analyzer.views.terminal import console_for

        if isinstance(sys.stdout, TextIOWrapper):
            sys.stdout.reconfigure(errors="replace")
        print_comparison(found, console_for(sys.stdout))
    if out is not None:
        from syncline_analyzer.views.comparison_html import comparison_page

        _write(out, comparison_page(found))
    unfit = any(each.damage or not each.frames for each in (found.golden, found.capture))
    if unfit or any(row.severity in as_bad_as(check) for row in found.rows):
        ctx.exit(NOT_REACHED)


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"--out {path}: cannot be written: {error.strerror or error}") from error
    click.echo(f"Wrote {path}.", err=True)
