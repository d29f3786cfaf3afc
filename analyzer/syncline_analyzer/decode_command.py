"""`syncline decode`."""

import errno
import os
import sys
from collections.abc import Iterable, Iterator
from functools import partial
from io import TextIOWrapper
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Protocol

import click

from syncline_analyzer.command_options import (
    CAPTURES,
    NOT_REACHED,
    OFFSET,
    named_devices,
    named_offsets,
    node_options,
    range_options,
    reading_progress,
)
from syncline_analyzer.decode.part import FAMILIES
from syncline_schemas.errors import UsageError

if TYPE_CHECKING:
    from syncline_analyzer.decode.choice import Choice
    from syncline_analyzer.decode.stream import DecodedBatch, Decoding
    from syncline_analyzer.readers.live import LiveReader
    from syncline_schemas.batch import Gap
    from syncline_schemas.progress_line import Tell

STDIN = "-"
_PIECE = 1 << 20


class Lines(Protocol):
    """Puts decoded frames into lines."""

    def lines(self, item: "DecodedBatch | Gap") -> list[str]:
        """The lines of a batch, or that of a gap."""
        ...


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline decode line3.mcap --node 10 --service emcy,sdo --from 4m\n"
    "  syncline decode night.log.gz --device 5=lir-da158a | less"
)
@CAPTURES
@node_options()
@range_options()
@OFFSET
@click.option(
    "--frames", "seqs", metavar="A-B", help="Only these, by the numbers that findings give."
)
@click.option(
    "--node",
    "nodes",
    multiple=True,
    metavar="NODE",
    help="Only what is of this node or for it. May be repeated.",
)
@click.option(
    "--service",
    "services",
    multiple=True,
    metavar="NAME",
    help=f"Only these services: {', '.join(FAMILIES)}. May be repeated.",
)
@click.option(
    "--cob-id",
    "ids",
    multiple=True,
    metavar="HEX",
    help="Only these identifiers: 18A, 180-1FF. May be repeated.",
)
@click.option("-f", "--follow", is_flag=True, help="Go on with what is appended to a candump log.")
@click.option("-n", "--limit", type=click.IntRange(min=1), help="Stop after so many frames.")
@click.option("--utc", is_flag=True, help="Write times as UTC instead of capture time.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", "jsonl"]),
    default="text",
    show_default=True,
    help="Lines for people, or one JSON object per frame.",
)
@click.pass_context
def decode(
    ctx: click.Context,
    captures: tuple[Path, ...],
    description: Path | None,
    devices: tuple[str, ...],
    start: str | None,
    end: str | None,
    offsets: tuple[str, ...],
    seqs: str | None,
    nodes: tuple[str, ...],
    services: tuple[str, ...],
    ids: tuple[str, ...],
    follow: bool,
    limit: int | None,
    utc: bool,
    form: str,
) -> None:
    """Print frames as people read CANopen: one line a frame.

    Time, COB-ID, service, node and what the frame says: NMT commands and states, SDO transfers with
    the names and values of objects, EMCY in words, PDOs with their mapped objects and units. What a
    frame means follows from what was seen before it: mappings and moved identifiers hold from the
    very frame on that changed them, so everything is read, whatever is chosen to be printed. A ~
    before a value says that its scale is only assumed, a ? behind a PDO's name that only its
    identifier says whose it is.

    CAPTURE may be - for standard input: what candump prints is decoded while it comes (candump -L
    can0 | syncline decode -), until it ends or Ctrl-C; anything else is read to its end first. Mappings that were told before that are
    unknown: --description or --device tell them. Exits with 1 when a capture is damaged and could
    be read only in part.
    """
    from syncline_analyzer.decode.stream import Decoding
    from syncline_analyzer.session import open_session

    choice = _choice(seqs, nodes, services, ids)
    paths, reader = _sources(ctx, captures, follow=follow, offset=bool(offsets))
    session = open_session(
        paths,
        description=description,
        devices=named_devices(devices),
        start=start,
        end=end,
        offsets=named_offsets(offsets),
    )
    opened = session.opened() if reader is None else session.opened_live(reader)
    decoding = Decoding(opened, choice)
    lines = _layout(decoding, form, utc and decoding.dated, opened.first_ns)
    if sys.stdout.isatty() or reader is not None:
        _print(lines, decoding, limit, None)
    else:
        with reading_progress(paths) as line:
            _print(lines, decoding, limit, line)
    damage = [each.damage for each in opened.facts if each.damage]
    for text in damage:
        click.echo(f"syncline: damaged, read in part: {text}", err=True)
    if damage:
        ctx.exit(NOT_REACHED)


def _sources(
    ctx: click.Context, captures: tuple[Path, ...], *, follow: bool, offset: bool
) -> "tuple[list[Path], LiveReader | None]":
    """The files to read; with a reader where they are one log that is still being written."""
    alone = len(captures) == 1 and not offset
    if follow:
        if not alone or str(captures[0]) == STDIN:
            raise UsageError("--follow: give one candump log, and no --offset")
        return list(captures), _followed(ctx, captures[0])
    if alone and str(captures[0]) == STDIN and (descriptor := _stdin_descriptor()) is not None:
        from syncline_analyzer.readers.live import LiveReader, as_it_comes, first_line, is_live

        read = as_it_comes(descriptor)
        head = first_line(read)
        if is_live(head):
            return list(captures), LiveReader(captures[0], head, read)
        return [_stored(ctx, chain((head,), iter(read, b"")))], None
    stdin = iter(partial(sys.stdin.buffer.read, _PIECE), b"")
    return [_stored(ctx, stdin) if str(path) == STDIN else path for path in captures], None


def _followed(ctx: click.Context, path: Path) -> "LiveReader":
    from syncline_analyzer.readers.live import LiveReader, appended, first_line, is_live

    try:
        read = appended(ctx.with_resource(path.open("rb")))
    except OSError as error:
        raise UsageError(f"{path}: cannot be opened: {error.strerror or error}") from error
    head = first_line(read)
    if not is_live(head):
        raise UsageError(
            f"{path}: only candump logs can be followed; a recording is watched with"
            " 'syncline record --view'"
        )
    return LiveReader(path, head, read)


def _stdin_descriptor() -> int | None:
    try:
        return sys.stdin.fileno()
    except (OSError, ValueError):
        return None


def _stored(ctx: click.Context, pieces: Iterable[bytes]) -> Path:
    """What stands on standard input as a file: its format is found by a look at its start."""
    folder = ctx.with_resource(TemporaryDirectory(prefix="syncline-"))
    path = Path(folder, "stdin")
    with path.open("wb") as file:
        file.writelines(pieces)
        if not file.tell():
            raise UsageError("-: nothing came on standard input")
    return path


def _choice(
    seqs: str | None, nodes: tuple[str, ...], services: tuple[str, ...], ids: tuple[str, ...]
) -> "Choice":
    from syncline_analyzer.decode.choice import Choice, families, frame_range, id_ranges
    from syncline_analyzer.decode.choice import node_numbers as numbers

    return Choice(numbers(nodes), families(services), id_ranges(ids), frame_range(seqs))


def _layout(decoding: "Decoding", form: str, utc: bool, first_ns: int | None) -> Lines:
    if form == "jsonl":
        from syncline_analyzer.views.decode_json import DecodedJson

        return DecodedJson(decoding)
    from syncline_analyzer.views.decode_lines import COLOURS, PLAIN, Columns, DecodedLines
    from syncline_analyzer.views.terminal import console_for

    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    console = console_for(sys.stdout)
    colourful = console.color_system is not None and not (
        console.no_color or console.legacy_windows
    )
    columns = Columns(
        width=console.width if console.is_terminal else None,
        utc=utc,
        timed=decoding.timed,
        colours=COLOURS if colourful else PLAIN,
    )
    return DecodedLines(decoding, columns, first_ns or 0, headed=console.is_terminal)


def _print(lines: Lines, decoding: "Decoding", limit: int | None, progress: "Tell | None") -> None:
    write = sys.stdout.write
    try:
        for text in _limited(lines, decoding, limit, progress):
            write(text)
            if decoding.live:
                sys.stdout.flush()
        sys.stdout.flush()
    except OSError as error:
        # Windows tells in this way that nobody reads any more.
        if os.name == "nt" and error.errno == errno.EINVAL:
            raise BrokenPipeError from error
        raise


def _limited(
    lines: Lines, decoding: "Decoding", limit: int | None, progress: "Tell | None"
) -> Iterator[str]:
    left = sys.maxsize if limit is None else limit
    for item in decoding.items(progress):
        found = lines.lines(item)[:left]
        if found:
            yield "\n".join(found) + "\n"
        left -= len(found)
        if left <= 0:
            return
