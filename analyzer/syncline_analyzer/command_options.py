"""Options that several commands about captures have, each written once."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import click

from syncline_schemas.errors import UsageError
from syncline_schemas.progress_line import ProgressLine, progress_line

if TYPE_CHECKING:
    from syncline_analyzer.results import Severity
    from syncline_analyzer.session import Session

Command = Callable[..., Any]

NOT_REACHED = 1
"""Exit code: the command ran, but what was wanted is not so (`--check`, damaged capture)."""

PATH = click.Path(path_type=Path)


class Selection(TypedDict):
    """Options of every command that analyzes."""

    captures: tuple[Path, ...]
    description: Path | None
    devices: tuple[str, ...]
    bitrate: int | None
    data_bitrate: int | None
    start: str | None
    end: str | None
    offsets: tuple[str, ...]


CAPTURES = click.argument("captures", nargs=-1, required=True, metavar="CAPTURE...", type=PATH)
CHECK = click.option(
    "--check",
    type=click.Choice(["error", "warning"]),
    help="Exit with 1 when there is a finding of this severity or worse.",
)
OFFSET = click.option(
    "--offset",
    "offsets",
    multiple=True,
    metavar="FILE=SECONDS|TIME",
    help="Move the times of one file: by +3600 or -2.5 seconds, or so that its first frame is at"
    " 2026-03-01T12:00:00Z, which also gives a date to a log that has none. May be repeated.",
)


def selecting(command: Command) -> Command:
    """Give a command the captures and the options of `Selection`."""
    return _all(command, CAPTURES, machine_options(), range_options(), OFFSET)


def machine_options(
    of: str = "of which neither description nor capture tells it; else it is estimated from the"
    " frames",
) -> Callable[[Command], Command]:
    """--description, --device, --bitrate and --data-bitrate. of: which buses the bit rate is for."""
    options = (
        node_options(),
        click.option(
            "--bitrate",
            type=click.IntRange(min=1),
            metavar="BIT/S",
            help=f"Bit rate of buses {of}.",
        ),
        click.option(
            "--data-bitrate",
            type=click.IntRange(min=1),
            metavar="BIT/S",
            help="The same of the data phase of CAN FD frames, which is never estimated.",
        ),
    )
    return lambda command: _all(command, *options)


def node_options() -> Callable[[Command], Command]:
    """--description and --device: what the nodes are."""
    options = (
        click.option(
            "--description",
            metavar="BUS.toml",
            type=PATH,
            help="Bus description; by default the one that the capture carries.",
        ),
        click.option(
            "--device",
            "devices",
            multiple=True,
            metavar="NODE=NAME_OR_EDS",
            help="What a node is: a device of 'syncline devices' or an EDS file. May be repeated.",
        ),
    )
    return lambda command: _all(command, *options)


def range_options(what: str = "Start here", until: str = "Stop") -> Callable[[Command], Command]:
    """--from and --to. what: happens at the one, and until the other."""
    options = (
        click.option(
            "--from",
            "start",
            metavar="TIME",
            help=f"{what}: 90s, 1m30s or 1:30.5 into the capture, or UTC as 2026-03-01T12:00:00Z.",
        ),
        click.option(
            "--to", "end", metavar="TIME", help=f"{until} before this time, written alike."
        ),
    )
    return lambda command: _all(command, *options)


def format_option(text: str, json: str) -> Callable[[Command], Command]:
    """--format, as `form`: what is printed as text and what as JSON."""
    return click.option(
        "--format",
        "form",
        type=click.Choice(["text", "json"]),
        default="text",
        show_default=True,
        help=f"What to print: {text}, or {json} as one JSON object.",
    )


def session_of(selection: Selection) -> "Session":
    """The session that the options of a command ask for."""
    from syncline_analyzer.session import open_session

    return open_session(
        selection["captures"],
        description=selection["description"],
        devices=named_devices(selection["devices"]),
        bitrate=selection["bitrate"],
        data_bitrate=selection["data_bitrate"],
        start=selection["start"],
        end=selection["end"],
        offsets=named_offsets(selection["offsets"]),
    )


@contextmanager
def reading_progress(captures: Sequence[Path], times: int = 1) -> Iterator[ProgressLine | None]:
    """A line on a terminal that tells how far the reading of captures is; else None.

    times: how often each is read.
    """

    def expected() -> int | None:
        from syncline_analyzer.frame_estimate import frames_expected

        count = frames_expected(captures)
        return None if count is None else times * count

    with progress_line(expected) as line:
        yield line


def as_bad_as(check: str | None) -> tuple["Severity", ...]:
    """The severities at which --check exits with 1."""
    severities: dict[str | None, tuple[Severity, ...]] = {
        None: (),
        "error": ("error",),
        "warning": ("error", "warning"),
    }
    return severities[check]


def named_devices(texts: tuple[str, ...]) -> dict[int, str]:
    """Device name by node, from several --device. Raises: UsageError."""
    return dict(device_option(text) for text in texts)


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


def named_offsets(texts: tuple[str, ...]) -> dict[str, str]:
    """Offset by file, from several --offset. Raises: UsageError."""
    offsets: dict[str, str] = {}
    for text in texts:
        name, equals, offset = text.rpartition("=")
        if not (equals and name and offset):
            raise UsageError(
                f"--offset {text}: write it as FILE=SECONDS or FILE=TIME,"
                " for example night.trc=+3600"
            )
        offsets[name] = offset
    return offsets


def _all(command: Command, *options: Callable[[Command], Command]) -> Command:
    for option in reversed(options):
        command = option(command)
    return command
