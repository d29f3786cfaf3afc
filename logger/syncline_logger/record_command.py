"""`syncline record`."""

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from syncline_logger.bus_options import (
    BusOptions,
    bus_name,
    parse_arguments,
    parse_bus,
    parse_filter,
    parse_timing,
    parse_value,
    with_unique_names,
)
from syncline_logger.option_types import SeveralWordsCommand
from syncline_logger.option_types import duration_ns as parse_duration
from syncline_logger.standard_output import discard_stdout

if TYPE_CHECKING:
    from syncline_logger.live_status import StatusSnapshot
    from syncline_logger.recording import RecordResult
    from syncline_schemas.description import BusDescription

TERMINAL_PERIOD_NS = 1_000_000_000
JSON_PERIOD_NS = 10_000_000_000

EPILOG = """\b
Examples:
  syncline record -i socketcan -c can0 -b 500000 -o captures/
  syncline record --bus press=socketcan:can0 --bus robot=pcan:PCAN_USBBUS1 --for 8h
"""


@click.command(cls=SeveralWordsCommand, epilog=EPILOG)
@click.option(
    "-i", "--interface", metavar="NAME", help="Interface as python-can calls it (socketcan, pcan)."
)
@click.option(
    "-c", "--channel", "channels", multiple=True, metavar="CHANNEL", help="Channel; repeatable."
)
@click.option("-b", "--bitrate", type=int, metavar="BIT/S", help="Bit rate of the bus.")
@click.option("--fd", is_flag=True, help="Receive CAN FD frames too.")
@click.option("--data-bitrate", type=int, metavar="BIT/S", help="Bit rate of the FD data phase.")
@click.option("--timing", multiple=True, metavar="KEY=NUMBER...", help="Bit timing.")
@click.option("--filter", "filters", multiple=True, metavar="ID:MASK...", help="Take only these.")
@click.option(
    "--bus-kwargs", multiple=True, metavar="KEY=VALUE...", help="Further arguments of python-can."
)
@click.option(
    "--bus",
    "buses",
    multiple=True,
    metavar="[NAME=]INTERFACE:CHANNEL[,KEY=VALUE...]",
    help="A bus with all its options in one word; repeatable, mixes interfaces.",
)
@click.option(
    "--acknowledge",
    is_flag=True,
    help="Let the adapter acknowledge frames: needed where only one other node is on the bus.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path(),
    show_default="this folder",
    metavar="DIR|FILE.mcap",
    help="Where to write; in a folder the name is UTC start time and recording id.",
)
@click.option(
    "--for", "duration_ns", type=parse_duration, metavar="TIME", help="Stop after this time."
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
@click.option("--no-decode", is_flag=True, help="Write raw frames and status alone.")
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
def record(
    interface: str | None,
    channels: tuple[str, ...],
    bitrate: int | None,
    fd: bool,
    data_bitrate: int | None,
    timing: tuple[str, ...],
    filters: tuple[str, ...],
    bus_kwargs: tuple[str, ...],
    buses: tuple[str, ...],
    acknowledge: bool,
    output: Path,
    duration_ns: int | None,
    description: Path | None,
    devices: tuple[str, ...],
    no_decode: bool,
    flush_ns: int,
    status_period_ns: int | None,
) -> None:
    """Record CAN buses until stopped: raw frames, bus status, decoded CANopen.

    The bus options are those of python-can's own tools; without any, python-can's configuration
    files decide. Frames are only received, never sent, and adapters are opened in listen-only
    mode where python-can can ask for it. Stopping with Ctrl-C or SIGTERM is the normal end:
    the file is closed and the exit code is 0.

    On a terminal one line shows frames per second, bus load and the nodes with their states;
    elsewhere stdout gets one JSON object per line: the file first, then the status.
    """
    common = BusOptions(
        name="",
        interface=interface,
        bitrate=bitrate,
        fd=fd,
        data_bitrate=data_bitrate,
        timing=parse_timing(timing),
        filters=tuple(parse_filter(word) for word in filters),
        arguments=parse_arguments(bus_kwargs, "--bus-kwargs"),
        acknowledge=acknowledge,
    )
    chosen = choose_buses(common, channels, buses)

    from syncline_logger.bus_devices import load_description
    from syncline_logger.recorder import record as record_sources
    from syncline_logger.recording import RecordOptions
    from syncline_logger.sources.python_can import PythonCanSource, quiet_python_can
    from syncline_logger.stop_signals import stop_on_signals

    known = load_description(description, devices)
    chosen = [_with_bit_rates(bus, known) for bus in chosen]
    options = RecordOptions(flush_ns=flush_ns, decode=not no_decode, description=known)
    quiet_python_can()
    _mention_cut_files(output)
    with stop_on_signals() as stop, ExitStack() as stack:
        terminal = sys.stderr.isatty()
        result = record_sources(
            [PythonCanSource(bus) for bus in chosen],
            output,
            options,
            stop=stop,
            duration_ns=duration_ns,
            on_start=_say_start if terminal else _print_start,
            on_status=_terminal_line(stack) if terminal else _print_json,
            status_period_ns=status_period_ns
            or (TERMINAL_PERIOD_NS if terminal else JSON_PERIOD_NS),
        )
    _say_result(result)


def choose_buses(
    common: BusOptions, channels: Sequence[str], buses: Sequence[str]
) -> list[BusOptions]:
    """The buses that the options name; one bus of python-can's configuration when none does."""
    chosen = []
    for word in channels:
        value = parse_value(word)
        channel = value if isinstance(value, int) else word
        chosen.append(replace(common, name=bus_name(channel), channel=channel))
    chosen += [parse_bus(word, common) for word in buses]
    if not chosen:
        chosen = [replace(common, name=common.interface or "can")]
    return with_unique_names(chosen)


def _with_bit_rates(bus: BusOptions, known: "BusDescription") -> BusOptions:
    """The bus with the bit rates of the description, where the options give none."""
    data_bitrate = known.data_bitrate(bus.name) if bus.fd else None
    return replace(
        bus,
        bitrate=bus.bitrate or known.bitrate(bus.name),
        data_bitrate=bus.data_bitrate or data_bitrate,
    )


def _mention_cut_files(folder: Path) -> None:
    from syncline_schemas.capture.recover import is_whole

    for path in sorted(folder.glob("*.mcap")) if folder.is_dir() else ():
        if not is_whole(path):
            click.echo(
                f"{path} has no end: its recorder was killed, or still runs;"
                f" 'syncline recover {path}' makes a regular file of it",
                err=True,
            )


def _print_start(path: Path) -> None:
    import json

    _print_line(json.dumps({"path": str(path)}))


def _say_start(path: Path) -> None:
    click.echo(f"recording to {path}; Ctrl-C stops", err=True)


def _print_json(snapshot: "StatusSnapshot") -> None:
    from syncline_logger.status_view import status_json

    _print_line(status_json(snapshot))


def _print_line(line: str) -> None:
    """Print, unless nobody reads any more: that is no reason to stop recording."""
    try:
        click.echo(line)
    except OSError:
        discard_stdout()


def _terminal_line(stack: ExitStack) -> "Callable[[StatusSnapshot], None]":
    from rich.console import Console
    from rich.live import Live

    from syncline_logger.status_view import status_line

    live = stack.enter_context(Live(console=Console(stderr=True), auto_refresh=False))

    def show(snapshot: "StatusSnapshot") -> None:
        with suppress(OSError):  # the terminal may be gone; the recording goes on
            live.update(status_line(snapshot), refresh=True)

    return show


def _say_result(result: "RecordResult") -> None:
    from syncline_schemas.wording import counted

    for problem in result.problems:
        click.echo(problem, err=True)
    for bus, count in result.frames.items():
        if count == 0:
            click.echo(f"{bus}: nothing was heard; check the bit rate and the wiring", err=True)
    frames, gaps = counted(result.frame_count, "frame"), counted(result.gap_count, "gap")
    lost = f", {counted(result.lost_frames, 'frame')} lost" if result.lost_frames else ""
    click.echo(f"{result.path}: {frames}, {gaps}{lost}", err=True)
