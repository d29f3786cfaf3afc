"""`syncline probe`."""

import re
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import click

from syncline_logger.command_options import one_bus_options, output_option
from syncline_logger.option_types import SeveralWordsCommand
from syncline_logger.option_types import duration_ns as parse_duration
from syncline_logger.standard_output import print_line
from syncline_schemas.wording import counted

if TYPE_CHECKING:
    from syncline_logger.probe import NodeProbe
    from syncline_logger.probe_bus import ProbeSource

MANY_NODES = 10
"""Of so many and more only those that answer are shown."""

EPILOG = """\b
Examples:
  syncline probe -i socketcan -c can0 --nodes 5,6 -o captures/
  syncline probe -i pcan -c PCAN_USBBUS1 -b 500000 --nodes 1-127
"""


def parse_nodes(text: str) -> list[int]:
    """Node ids from 5,6,10-12.

    >>> parse_nodes("5,10-12")
    [5, 10, 11, 12]
    """
    nodes: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= first <= last <= 127:
            raise click.BadParameter(f"'{part}' is no node or range of 1..127; write 5,6 or 10-12")
        nodes += range(first, last + 1)
    return list(dict.fromkeys(nodes))


@click.command(cls=SeveralWordsCommand, epilog=EPILOG)
@one_bus_options
@click.option(
    "--nodes",
    type=parse_nodes,
    required=True,
    metavar="5,6,10-12",
    help="Nodes that are asked, and no others.",
)
@output_option("Where to write the capture of it.")
@click.option(
    "--timeout",
    "timeout_ns",
    type=parse_duration,
    metavar="TIME",
    default="300ms",
    show_default=True,
    help="How long an answer is waited for.",
)
@click.option(
    "--pace",
    "pace_ns",
    type=parse_duration,
    metavar="TIME",
    default="20ms",
    show_default=True,
    help="Pause before each request.",
)
def probe(
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    bus_kwargs: tuple[str, ...],
    nodes: list[int],
    output: Path,
    timeout_ns: int,
    pace_ns: int,
) -> None:
    """Ask nodes what they are, and record the answers. THIS SENDS on the bus.

    Reads identity, communication and PDO parameters and the objects that give scales (1000h,
    1008h, 1018h, 1800h, 6000h ...) by SDO, one request at a time, so that captures of the same
    machine can be understood without guessing. Nothing is written, no NMT command, no remote
    frame, no guard request is sent. Do not use it while another tool or master reads or writes the
    same nodes by SDO: a node has one SDO channel, and both would get the other's answers.
    Exit code 1 when no node answered.
    """
    from syncline_logger.bus_options import BusOptions, bus_name, parse_arguments, parse_value
    from syncline_logger.probe_bus import ProbeSource
    from syncline_logger.sources.python_can import quiet_python_can

    value = None if channel is None else parse_value(channel)
    options = BusOptions(
        bus_name(channel if channel is not None else interface or "can"),
        interface,
        value if isinstance(value, int) else channel,
        bitrate,
        arguments=parse_arguments(bus_kwargs, "--bus-kwargs"),
        acknowledge=True,
    )
    quiet_python_can()
    source = ProbeSource(options)
    source.check_interface()
    click.echo(
        f"this sends SDO read requests on {options.name} to"
        f" {'node' if len(nodes) == 1 else 'nodes'} {', '.join(map(str, nodes))};"
        " no other tool or master may use their SDO channels meanwhile. Ctrl-C stops",
        err=True,
    )
    _probe(source, nodes, output, timeout_ns / 1e9, pace_ns / 1e9)


def _probe(
    source: "ProbeSource", nodes: list[int], output: Path, timeout_s: float, pace_s: float
) -> None:
    from syncline_logger.recorder import record
    from syncline_logger.stop_signals import stop_on_signals

    failures: list[Exception] = []
    silent: list[int] = []
    asked_all = threading.Event()
    with stop_on_signals() as interrupted:

        def ask() -> None:
            try:
                silent.extend(_ask(source, nodes, timeout_s, pace_s, interrupted))
            except Exception as error:  # noqa: BLE001 - raised again where it can be told
                failures.append(error)
            finally:
                # The recording ends after the last answer, also where somebody interrupts.
                asked_all.set()

        asking = threading.Thread(target=ask, name="syncline probe", daemon=True)
        result = record([source], output, stop=asked_all, on_start=lambda path: asking.start())
        if interrupted.is_set():
            click.echo("interrupted: not every node was asked for everything", err=True)
    if failures:
        raise failures[0]
    click.echo(f"{result.path}: {result.frame_count} frames", err=True)
    if len(silent) == len(nodes):
        who = "the node" if len(nodes) == 1 else f"any of the {len(nodes)} nodes"
        click.echo(
            f"syncline: no answer from {who}; check the bit rate, the wiring and the node ids",
            err=True,
        )
        raise SystemExit(1)
    if silent and len(nodes) >= MANY_NODES:
        click.echo(f"{counted(len(silent), 'node')} gave no answer", err=True)


def _ask(
    source: "ProbeSource",
    nodes: list[int],
    timeout_s: float,
    pace_s: float,
    interrupted: threading.Event,
) -> list[int]:
    """Ask one node after the other and say what each is; those that gave no answer."""
    from syncline_logger.probe import probe_node
    from syncline_logger.probe_bus import SdoReader

    silent = []
    for node in nodes:
        if interrupted.is_set():
            break
        reader = SdoReader(source.network, node, timeout_s=timeout_s, pace_s=pace_s)
        found = probe_node(node, reader.read, interrupted.is_set)
        reader.close()
        if not found.answered:
            silent.append(node)
        if found.answered or len(nodes) < MANY_NODES:
            print_line(summary(found))
    return silent


def summary(found: "NodeProbe") -> str:
    """One line about a node."""
    if not found.answered:
        return f"node {found.node}: no answer"
    kind = found.number((0x1000, 0))
    words = [f"'{found.name}'"] if found.name else []
    words += [found.device.title if found.device else "no device that is known here"]
    words += [f"device type {kind:08X}h"] if kind is not None else []
    words += [f"{len(found.values)} objects read, {len(found.refused)} refused"]
    return f"node {found.node}: {', '.join(words)}"
