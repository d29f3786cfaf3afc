"""`syncline fleet`: many captures of many machines as one data set."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from syncline_analyzer.fleet_look_command import report, view
from syncline_analyzer.fleet_options import (
    MACHINE,
    NO_DATA,
    STORAGE,
    fleet_extra,
    storage_options,
)
from syncline_analyzer.fleet_trends_command import trends
from syncline_schemas.errors import UsageError
from syncline_schemas.wording import counted

if TYPE_CHECKING:
    from syncline_analyzer.fleet.storage import Storage
    from syncline_analyzer.fleet.task import Settings

NOT_REACHED = 1


@click.group(
    epilog="\b\nExamples:\n"
    "  syncline fleet analyze captures --out fleet\n"
    "  syncline fleet query fleet --question changes --after 2026-11-01\n"
    "  syncline fleet view fleet"
)
def fleet() -> None:
    """Analyze the captures of many machines and ask about all of them."""


fleet.add_command(view)
fleet.add_command(report)
fleet.add_command(trends)


@fleet.command(
    short_help="Analyze the captures of many machines into one data set.",
    epilog="\b\nExamples:\n"
    "  syncline fleet analyze /data/captures --out /data/fleet --workers 8\n"
    '  syncline fleet analyze "s3://line/**" --out s3://fleet/a --machine-from "{machine}/{date}"',
)
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE...")
@click.option(
    "--out", required=True, metavar="DEST", help="Folder or URL of the data set; made if need be."
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Work on the Dask cluster of this scheduler, tcp://host:8786. Its workers must reach"
    " SOURCE and DEST by the same names.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Worker processes on this machine; by default one for each processor.",
)
@click.option(
    "--machine-from",
    metavar="RULE",
    help="Where the name of the machine stands in a capture's path: a template such as"
    ' "{machine}/{date}", a regular expression with (?P<machine>...), or host for the name of the'
    " recording gateway. By default what the recorder was told, else the name of the folder.",
)
@click.option(
    "--description",
    type=click.Path(path_type=Path, exists=True),
    metavar="BUS.toml|FOLDER",
    help="Bus description of all machines, or a folder with one MACHINE.toml each; by default the"
    " one that a capture carries.",
)
@click.option(
    "--bitrate",
    type=click.IntRange(min=1),
    metavar="BIT/S",
    help="Bit rate of buses of which neither description nor capture tells it.",
)
@click.option("--with-traces", is_flag=True, help="Write every sample and every PDO answer too.")
@click.option("--reports", is_flag=True, help="Write a report.html of each capture, and of all.")
@click.option("--rrd", is_flag=True, help="Write a Rerun recording of each capture.")
@click.option(
    "--storage-option",
    "storage_pairs",
    multiple=True,
    metavar="KEY=VALUE",
    help="Option of the object store, as fsspec takes it; a value may be JSON. May be repeated."
    " By default the environment tells (AWS_ENDPOINT_URL, FSSPEC_S3_KEY ...).",
)
@click.option("--retry-failed", is_flag=True, help="Try again what failed, though nothing changed.")
@click.option("--check", is_flag=True, help="Exit with 1 when a capture failed.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    help="What to print: a summary for people, or one JSON object a line for each capture.",
)
@click.pass_context
def analyze(
    ctx: click.Context,
    sources: tuple[str, ...],
    out: str,
    scheduler: str | None,
    workers: int | None,
    machine_from: str | None,
    description: Path | None,
    bitrate: int | None,
    with_traces: bool,
    reports: bool,
    rrd: bool,
    storage_pairs: tuple[str, ...],
    retry_failed: bool,
    check: bool,
    form: str,
) -> None:
    """Analyze all captures of folders, globs and object stores into one parquet data set.

    Segments of one recording are one capture. Running it again does what is new or changed; what
    cannot be analyzed becomes a row of 'failures' and stops nothing. Whoever reads the data set
    meanwhile sees whole captures only.
    """
    if scheduler is not None and workers is not None:
        raise UsageError("--workers starts processes here, --scheduler uses others: name one")
    with fleet_extra():
        from syncline_analyzer.fleet.machine import MachineRule
        from syncline_analyzer.fleet.plan import Order
        from syncline_analyzer.fleet.progress import summary_json, summary_lines, watching
        from syncline_analyzer.fleet.run import run
        from syncline_analyzer.fleet.source import find_captures
        from syncline_analyzer.fleet.storage import open_storage

        options = storage_options(storage_pairs)
        storage = open_storage(out, options)
        order = Order(
            find_captures(sources, storage, options),
            storage,
            MachineRule.of(machine_from),
            _settings(description, bitrate, with_traces, reports, rrd),
            options,
            retry_failed,
        )
        with watching(as_json=form == "json") as watcher:
            summary = run(order, watcher, scheduler=scheduler, workers=workers)
        if reports:
            _report_of_all(storage)
    if form == "json":
        click.echo(summary_json(summary, storage.url))
    else:
        for line in summary_lines(summary, storage.url):
            click.echo(line)
    if check and summary.failed:
        ctx.exit(NOT_REACHED)


@fleet.command(
    short_help="Ask the data set, by SQL or a ready-made question.",
    epilog="\b\nExamples:\n"
    "  syncline fleet query /data/fleet --question emcy --code 7320h --since 2026-11-01\n"
    '  syncline fleet query /data/fleet "SELECT machine, count(*) FROM findings GROUP BY 1"',
)
@click.argument("dest", metavar="DEST")
@click.argument("sql", required=False)
@click.option(
    "--question",
    metavar="NAME",
    help="A ready-made question instead of SQL; without both, questions and tables are listed.",
)
@click.option("--code", help="EMCY code, 7320h; x stands for any digit, 73xxh.")
@click.option(
    "--since", metavar="DATE", help="Captures that began, or EMCYs sent, then or later (UTC)."
)
@click.option("--until", metavar="DATE", help="Captures that began, or EMCYs sent, before it.")
@click.option("--after", metavar="DATE", help="Compare what began before with what began after it.")
@MACHINE
@click.option("--bus", metavar="NAME", help="Of this bus.")
@click.option("--node", type=click.IntRange(1, 127), metavar="ID", help="Of this node.")
@click.option("--quantity", metavar="NAME", help="For outliers and changes; all by default.")
@click.option(
    "--every", type=click.Choice(["day", "week", "month"]), help="One value for each; a week."
)
@click.option("--min-samples", type=click.IntRange(min=0), help="In a capture; 10.")
@click.option("--min-captures", type=click.IntRange(min=1), help="Of a machine, on either side.")
@click.option("--min-machines", type=click.IntRange(min=3), help="That are compared; 5.")
@click.option("--threshold", type=click.FloatRange(min=0), help="How many spreads off counts.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", "csv", "jsonl", "parquet"]),
    default="text",
    show_default=True,
    help="How to answer; parquet needs -o.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write there instead of printing.",
)
@STORAGE
def query(
    dest: str,
    sql: str | None,
    question: str | None,
    form: str,
    output: Path | None,
    storage_pairs: tuple[str, ...],
    **options: Any,
) -> None:
    """Ask the data set DEST: by SQL (DuckDB), or a ready-made question with its options.

    Each table has machine, date and capture_id before its columns; only captures that stand are
    seen. SQL reads these tables and nothing else: no other file, and nothing is written.
    """
    given = {name: value for name, value in options.items() if value is not None}
    if sql is not None and (question is not None or given):
        named = "--question" if question is not None else f"--{next(iter(given))}"
        raise UsageError(
            f"{named.replace('_', '-')} is for ready-made questions: leave out the SQL"
        )
    if form == "parquet" and output is None:
        raise UsageError("--format parquet needs -o FILE")
    with fleet_extra():
        from syncline_analyzer.fleet.ask import Fleet
        from syncline_analyzer.fleet.database import Query
        from syncline_analyzer.fleet.questions import question as question_named
        from syncline_analyzer.views.fleet_answer import overview_lines, write_answer

        asked: Query | None = None
        if question is not None:
            asked = question_named(question, given)
        elif given:
            raise UsageError(f"--{next(iter(given)).replace('_', '-')}: name the --question")
        elif sql is not None:
            asked = Query(sql, {})
        opened = Fleet.open(dest, storage_options(storage_pairs))
        if not opened.database.data.captures and not opened.database.data.failures:
            raise UsageError(NO_DATA.format(dest))
        if asked is None:
            for line in overview_lines(opened.tables):
                click.echo(line)
            return
        with opened.database.ask(asked) as reader:
            write_answer(reader, form, output)
    if question is not None and opened.undated:
        undated = counted(opened.undated, "capture")
        click.echo(f"{undated} without a date: not in what questions say of a time", err=True)


def _report_of_all(storage: "Storage") -> None:
    """Write the report of the fleet; a data set that somebody changes meanwhile gets it later."""
    from syncline_analyzer.fleet.dataset import Dataset
    from syncline_analyzer.fleet.report import write_fleet_report

    try:
        click.echo(f"Wrote {write_fleet_report(Dataset.of(storage))}.", err=True)
    except UsageError as error:
        click.echo(f"No report of the fleet: {error}", err=True)


def _settings(
    description: Path | None, bitrate: int | None, with_traces: bool, reports: bool, rrd: bool
) -> "Settings":
    """What is asked of each analysis. Raises: DescriptionError."""
    from syncline_analyzer.fleet.task import Extra, Settings
    from syncline_schemas.description import BusDescription

    wanted: tuple[tuple[bool, Extra], ...] = (
        (with_traces, "samples"),
        (reports, "report"),
        (rrd, "recording"),
    )
    if description is None:
        paths = {}
    elif description.is_dir():
        paths = {path.stem: path for path in sorted(description.glob("*.toml"))}
    else:
        paths = {"": description}
    loaded = {machine: BusDescription.load(path) for machine, path in paths.items()}
    return Settings(
        {machine: each.text for machine, each in loaded.items()},
        {name: content for each in loaded.values() for name, content in each.files.items()},
        bitrate,
        tuple(extra for asked, extra in wanted if asked),
    )
