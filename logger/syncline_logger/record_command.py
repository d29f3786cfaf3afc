"""`syncline record`."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from syncline_logger.command_options import bus_options, output_option
from syncline_logger.config import LoadedConfig, load_config
from syncline_logger.option_types import (
    SeveralWordsCommand,
    compression,
    size_bytes,
    size_or_duration,
)
from syncline_logger.option_types import duration_ns as parse_duration

if TYPE_CHECKING:
    from syncline_logger.record_plan import RecordPlan
    from syncline_schemas.capture.layout import Compression

EPILOG = """\b
Examples:
  syncline record -i socketcan -c can0 -b 500000 -o captures/
  syncline record --config logger.toml --for 8h
"""


def _take_config(
    context: click.Context, parameter: click.Parameter, path: Path | None
) -> LoadedConfig | None:
    """Let the file's values stand where the command line gives none."""
    if path is None:
        return None
    config = load_config(path, context.command.params)
    context.default_map = {**(context.default_map or {}), **config.values}
    return config


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the options of `record` say, command line and file together; named as they are."""

    interface: str | None
    channels: tuple[str, ...]
    bitrate: int | None
    fd: bool
    data_bitrate: int | None
    timing: tuple[str, ...]
    filters: tuple[str, ...]
    bus_kwargs: tuple[str, ...]
    buses: tuple[str, ...]
    acknowledge: bool
    wait_for_bus: bool
    output: Path
    split_size: int | None
    split_time: int | None
    keep: tuple[tuple[str, int], ...]
    reserve: int | None
    compression: tuple["Compression", int]
    duration_ns: int | None
    triggers: tuple[str, ...]
    triggered_only: bool
    before_ns: int
    after_ns: int
    ring_size: int
    description: Path | None
    devices: tuple[str, ...]
    decode: bool
    flush_ns: int
    status_period_ns: int | None
    status_file: Path | None
    prometheus: Path | None
    log: Path | None
    log_size: int
    log_keep: int
    view: bool


@click.command(cls=SeveralWordsCommand, epilog=EPILOG)
@click.option(
    "--config",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="LOGGER.toml",
    is_eager=True,
    callback=_take_config,
    help="All of these options from a file, named alike with _ for -; buses as [[bus]] tables."
    " What the command line gives goes before.",
)
@click.option(
    "--check-config", is_flag=True, help="Say what is wrong with the options, and do not record."
)
@bus_options
@output_option("Where to write; in a folder the name is UTC start time and recording id.")
@click.option(
    "--split-size",
    type=size_bytes,
    metavar="SIZE",
    help="Go on in a new file when one is so large; no frame is lost between them.",
)
@click.option(
    "--split-time",
    type=parse_duration,
    metavar="TIME",
    help="Go on in a new file at full periods of UTC: 5m at :00, :05, :10 ...",
)
@click.option(
    "--keep",
    type=size_or_duration,
    multiple=True,
    metavar="SIZE|TIME",
    help="Delete this recorder's oldest files in the folder when they are larger together (20GB)"
    " or older (14d); never marked ones. Repeatable.",
)
@click.option(
    "--reserve",
    type=size_bytes,
    metavar="SIZE",
    help="Delete this recorder's oldest files in the folder to leave so much free on the disk.",
)
@click.option(
    "--compression",
    type=compression,
    metavar="none|lz4|zstd[:LEVEL]",
    default="zstd:1",
    show_default=True,
    help="How the file is compressed.",
)
@click.option(
    "--for", "duration_ns", type=parse_duration, metavar="TIME", help="Stop after this time."
)
@click.option(
    "--trigger",
    "triggers",
    multiple=True,
    metavar="EVENT",
    help="Mark the moment when this happens; repeatable: emcy[:NODE[:CODE]], node-lost[:NODE],"
    " boot-up[:NODE], nmt:NODE:STATE, bus-off[:BUS], sdo-abort[:NODE],"
    " value:NODE:NAME>NUMBER[UNIT], gap[:BUS]. 'syncline trigger' and SIGUSR1 always mark.",
)
@click.option(
    "--triggered-only",
    is_flag=True,
    help="Write nothing until a trigger, then what lies around it; one recording per event.",
)
@click.option(
    "--before",
    "before_ns",
    type=parse_duration,
    metavar="TIME",
    default="5m",
    show_default=True,
    help="How much before a trigger is kept.",
)
@click.option(
    "--after",
    "after_ns",
    type=parse_duration,
    metavar="TIME",
    default="2m",
    show_default=True,
    help="How much after the last trigger is kept.",
)
@click.option(
    "--ring-size",
    type=size_bytes,
    metavar="SIZE",
    default="100MB",
    show_default=True,
    help="Memory for what lies before a trigger, where nothing is written until then.",
)
@click.option(
    "--description",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="BUS.toml",
    help="Which devices are on the bus; attached to the capture with their EDS files.",
)
@click.option(
    "--device",
    "devices",
    multiple=True,
    metavar="NODE=NAME_OR_EDS",
    help="Device of one node; repeatable. See 'syncline devices'.",
)
@click.option(
    "--decode/--no-decode", default=True, help="Write decoded channels beside the raw frames."
)
@click.option(
    "--flush",
    "flush_ns",
    type=parse_duration,
    metavar="TIME",
    default="1s",
    show_default=True,
    help="At most this much is lost when the power goes.",
)
@click.option(
    "--status-period",
    "status_period_ns",
    type=parse_duration,
    metavar="TIME",
    show_default="1s on a terminal, else 10s",
    help="How often the status is shown.",
)
@click.option(
    "--status-file",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.json",
    help="Keep the latest status in this file, as one JSON object; replaced as a whole.",
)
@click.option(
    "--prometheus",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.prom",
    help="Keep the latest status in this file for node_exporter's textfile collector.",
)
@click.option(
    "--log",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.log",
    help="The recorder's own log: starts, stops, lost adapters, lost frames, lost nodes.",
)
@click.option(
    "--log-size",
    type=size_bytes,
    metavar="SIZE",
    default="1MB",
    show_default=True,
    help="The log is rotated when it is so large.",
)
@click.option(
    "--log-keep",
    type=click.IntRange(min=1),
    metavar="COUNT",
    default=3,
    show_default=True,
    help="Rotated logs that are kept.",
)
@click.option(
    "--view",
    is_flag=True,
    help="Show states, EMCYs, decoded values and bus load in a Rerun viewer on this machine while"
    " recording; it can never hold up the recording.",
)
@click.pass_context
def record(
    context: click.Context, /, config: LoadedConfig | None, check_config: bool, **options: Any
) -> None:
    """Record CAN buses until stopped: raw frames, bus status, decoded CANopen.

    The bus options are those of python-can's own tools; without any, python-can's configuration
    files decide. Frames are only received, never sent, and adapters are opened in listen-only
    mode where python-can can ask for it. Stopping with Ctrl-C or SIGTERM is the normal end:
    the file is closed and the exit code is 0.

    On a terminal one line shows frames per second, bus load and the nodes with their states;
    elsewhere stdout gets one JSON object per line: the file first, then the status.
    """
    from syncline_logger.record_plan import plan_recording
    from syncline_schemas.errors import SeveralErrors, UsageError

    given = frozenset(
        name
        for name in options
        if context.get_parameter_source(name) == ParameterSource.COMMANDLINE
    )
    plan = plan_recording(Wanted(**options), config, given, check=check_config)
    if len(plan.problems) > 1:
        raise SeveralErrors(plan.problems)
    if plan.problems:
        raise UsageError(plan.problems[0])
    if check_config:
        click.echo(plan.summary())
    else:
        _run(plan)


def _run(plan: "RecordPlan") -> None:
    from syncline_logger.live_view.feed import LiveView, check_installed
    from syncline_logger.own_log import own_log
    from syncline_logger.record_outputs import RecordOutputs
    from syncline_logger.record_view import RecordView, mention_cut_files, say_result
    from syncline_logger.recorder import record as record_sources
    from syncline_logger.stop_signals import stop_on_signals
    from syncline_logger.triggers.requests import trigger_requests

    wanted = plan.wanted
    if wanted.view:
        check_installed()
    with stop_on_signals() as stop, ExitStack() as stack:
        # First of all: a signal that nobody waits for ends the process.
        requests = stack.enter_context(trigger_requests(_folder(wanted.output)))
        mention_cut_files(wanted.output)
        stack.enter_context(own_log(wanted.log, wanted.log_size, wanted.log_keep))
        view = RecordView(stack)
        outputs = stack.enter_context(RecordOutputs(view, wanted.status_file, wanted.prometheus))
        live = stack.enter_context(LiveView(outputs.words)) if wanted.view else None
        result = record_sources(
            plan.sources,
            wanted.output,
            plan.options,
            stop=stop,
            duration_ns=wanted.duration_ns,
            on_start=outputs.started,
            on_status=outputs.status,
            on_turn=outputs.alive,
            on_note=outputs.note,
            asked=requests.poll,
            status_period_ns=wanted.status_period_ns or view.period_ns,
            view=live,
        )
    say_result(result, triggered_only=wanted.triggered_only)


def _folder(output: Path) -> Path:
    """The folder in which the recordings are."""
    return output.parent if output.suffix == ".mcap" and not output.is_dir() else output
