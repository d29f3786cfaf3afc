"""Options that several commands have: which bus, and where to write."""

from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import Any, Protocol, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


class Decorator(Protocol):
    """Gives a command an option."""

    def __call__(self, command: F, /) -> F:
        """The same command."""
        ...


INTERFACE = click.option(
    "-i", "--interface", metavar="NAME", help="Interface as python-can calls it (socketcan, pcan)."
)
BITRATE = click.option("-b", "--bitrate", type=int, metavar="BIT/S", help="Bit rate of the bus.")
BUS_KWARGS = click.option(
    "--bus-kwargs", multiple=True, metavar="KEY=VALUE...", help="Further arguments of python-can."
)


def one_bus_options(command: F) -> F:
    """-i, -c, -b and --bus-kwargs of a command that opens one bus."""
    channel = click.option("-c", "--channel", metavar="CHANNEL", help="Channel.")
    return _all(command, INTERFACE, channel, BITRATE, BUS_KWARGS)


def bus_options(command: F) -> F:
    """All options about buses of a command that opens several."""
    return _all(
        command,
        INTERFACE,
        click.option(
            "-c",
            "--channel",
            "channels",
            multiple=True,
            metavar="CHANNEL",
            help="Channel; repeatable.",
        ),
        BITRATE,
        click.option("--fd", is_flag=True, help="Receive CAN FD frames too."),
        click.option(
            "--data-bitrate", type=int, metavar="BIT/S", help="Bit rate of the FD data phase."
        ),
        click.option("--timing", multiple=True, metavar="KEY=NUMBER...", help="Bit timing."),
        click.option(
            "--filter", "filters", multiple=True, metavar="ID:MASK...", help="Take only these."
        ),
        BUS_KWARGS,
        click.option(
            "--bus",
            "buses",
            multiple=True,
            metavar="[NAME=]INTERFACE:CHANNEL[,KEY=VALUE...]",
            help="A bus with all its options in one word; repeatable, mixes interfaces.",
        ),
        click.option(
            "--acknowledge",
            is_flag=True,
            help="Let the adapter acknowledge frames:"
            " needed where only one other node is on the bus.",
        ),
        click.option(
            "--wait-for-bus",
            is_flag=True,
            help="Begin even if an adapter or interface is not there yet, and wait for it.",
        ),
    )


def output_option(text: str) -> Decorator:
    """-o, with this help."""
    return click.option(
        "-o",
        "--output",
        type=click.Path(path_type=Path),
        default=Path(),
        show_default="this folder",
        metavar="DIR|FILE.mcap",
        help=text,
    )


def _all(command: F, *decorators: Decorator) -> F:
    """With these options, the first one first in the help."""
    return reduce(lambda made, decorate: decorate(made), reversed(decorators), command)
