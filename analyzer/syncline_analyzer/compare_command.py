"""`syncline compare`: what is different from a healthy capture of the same machine."""

import sys
from io import TextIOWrapper
from pathlib import Path

import click

from syncline_analyzer.cli import NOT_REACHED, device_option
from syncline_schemas.errors import UsageError

_PATH = click.Path(path_type=Path)


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline compare healthy.mcap today.mcap\n"
    "  syncline compare healthy.mcap night.log.gz --description line3.toml --out diff.html"
)
@click.argument("golden", type=_PATH, metavar="GOLDEN")
@click.argument("captures", nargs=-1, required=True, type=_PATH, metavar="CAPTURE...")
@click.option(
    "--description",
    type=_PATH,
    metavar="BUS.toml",
    help="Bus description of both; by default the one that each carries.",
)
@click.option(
    "--device",
    "devices",
    multiple=True,
    metavar="NODE=NAME_OR_EDS",
    help="What a node is in both: a device of 'syncline devices' or an EDS file. May be repeated.",
)
@click.option(
    "--bitrate",
    type=click.IntRange(min=1),
    metavar="BIT/S",
    help="Bit rate of buses of which neither description nor capture tells it.",
)
@click.option("--from", "start", metavar="TIME", help="Start here in CAPTURE: 90s, or UTC.")
@click.option("--to", "end", metavar="TIME", help="Stop before this time in CAPTURE.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    help="What to print: differences in words, or all of it as one JSON object.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="PAGE.html",
    help="Write the differences as a page that opens anywhere.",
)
@click.option(
    "--check",
    type=click.Choice(["error", "warning"]),
    help="Exit with 1 when there is a difference of this severity or worse.",
)
@click.pass_context
def compare(
    ctx: click.Context,
    golden: Path,
    captures: tuple[Path, ...],
    description: Path | None,
    devices: tuple[str, ...],
    bitrate: int | None,
    start: str | None,
    end: str | None,
    form: str,
    out: Path | None,
    check: str | None,
) -> None:
    """Tell what is different from a healthy capture of the same machine.

    Nodes, states, periods, bus load, EMCYs, parameters, SDO failures, PDOs, angle sensors and
    findings, ranked by what matters, each with the numbers of both. Captures of different length
    are compared by rates; what one of both could not have shown is not seen, never gone.
    """
    from syncline_analyzer.comparison import compare as compared
    from syncline_analyzer.session import open_session

    named = dict(device_option(text) for text in devices)
    shared = {"description": description, "devices": named, "bitrate": bitrate}
    healthy = open_session(golden, **shared)  # type: ignore[arg-type]
    suspect = open_session(list(captures), start=start, end=end, **shared)  # type: ignore[arg-type]
    found = compared(healthy.analysis, suspect.analysis)
    if form == "json":
        from syncline_analyzer.views.comparison_table import comparison_json

        click.echo(comparison_json(found))
    else:
        from syncline_analyzer.views.comparison_text import print_comparison
        from syncline_analyzer.views.text import console_for

        if isinstance(sys.stdout, TextIOWrapper):
            sys.stdout.reconfigure(errors="replace")
        print_comparison(found, console_for(sys.stdout))
    if out is not None:
        from syncline_analyzer.views.comparison_html import comparison_page

        _write(out, comparison_page(found))
    wanted = {None: (), "error": ("error",), "warning": ("error", "warning")}[check]
    damaged = found.golden.damage or found.capture.damage
    if damaged or any(row.severity in wanted for row in found.rows):
        ctx.exit(NOT_REACHED)


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"--out {path}: cannot be written: {error.strerror or error}") from error
    click.echo(f"Wrote {path}.", err=True)
