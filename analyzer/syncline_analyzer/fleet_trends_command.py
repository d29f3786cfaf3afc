"""`syncline fleet trends`: what drifts, steps or comes more often."""

from typing import Any

import click

from syncline_analyzer.fleet_options import (
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

FOUND = 1


@click.command(
    short_help="Tell what drifts, steps or comes more often.",
    epilog="\b\nExamples:\n"
    "  syncline fleet trends /data/fleet\n"
    '  syncline fleet trends /data/fleet --machine "press-*" --quantity encoder-noise --check',
)
@click.argument("dest", metavar="DEST")
@click.option(
    "--machine",
    metavar="NAME",
    help="Tell of this machine; * and ? stand for others. It is still compared with all.",
)
@click.option("--bus", metavar="NAME", help="Of this bus.")
@click.option("--node", type=click.IntRange(1, 127), metavar="ID", help="Of this node.")
@click.option(
    "--quantity",
    metavar="NAME",
    help="pdo-latency, sync-jitter, heartbeat, resets, emcy, eeprom-wear, encoder-noise or bus-load;"
    " all by default.",
)
@SINCE
@UNTIL
@click.option("--min-samples", type=click.IntRange(min=0), help="In a capture; 10.")
@click.option("--check", is_flag=True, help="Exit with 1 when there is a warning or an error.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", "json", "csv"]),
    default="text",
    show_default=True,
    help="How to answer: for people, one JSON object, or a table.",
)
@STORAGE
@click.pass_context
def trends(
    ctx: click.Context,
    /,
    dest: str,
    check: bool,
    form: str,
    storage_pairs: tuple[str, ...],
    **options: Any,
) -> None:
    """Tell what drifts, steps or comes more often in the data set DEST, over the days of its captures.

    What many machines show from the same days on is told once. A machine is judged against the
    machines with the same node; small changes, single bad days and storms are no trends.
    """
    given = {name: value for name, value in options.items() if value is not None}
    with fleet_extra():
        from syncline_analyzer.fleet.ask import Fleet
        from syncline_analyzer.fleet.trends import trend_findings
        from syncline_analyzer.views.fleet_trend_list import write_trends

        with progress_line() as line:
            if line:
                line.say("reading the data set")
            opened = Fleet.open(dest, storage_options(storage_pairs))
            if not opened.database.data.captures:
                raise UsageError(NO_DATA.format(dest))
            found = trend_findings(opened.database, **given)
        write_trends(found, form)
    if opened.undated:
        undated = counted(opened.undated, "capture")
        click.echo(f"{undated} without a date: in no trend", err=True)
    if check and any(each.severity != "info" for each in found):
        ctx.exit(FOUND)
