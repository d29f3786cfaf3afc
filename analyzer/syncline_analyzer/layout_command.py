"""`syncline layout`: how other viewers show the decoded channels of captures."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from syncline_schemas.errors import UsageError

if TYPE_CHECKING:
    from syncline_analyzer.layouts.channels import DecodedChannel


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline layout line3.mcap line3.json\n"
    "  syncline layout monday-0001.mcap monday-0002.mcap channels.rrd"
)
@click.argument("captures", nargs=-1, required=True, metavar="CAPTURE.mcap...",
                type=click.Path(path_type=Path))  # fmt: skip
@click.argument("output", metavar="OUT", type=click.Path(path_type=Path))
def layout(captures: tuple[Path, ...], output: Path) -> None:
    """Make a layout of decoded channels for other viewers.

    OUT.json is a layout to import in Foxglove, beside the capture. OUT.rrd is the capture as Rerun
    itself reads it, with a layout that plots its decoded channels. For the analysis see
    'syncline view'.
    """
    from syncline_analyzer.layouts.channels import decoded_channels

    channels = decoded_channels(captures)
    if not output.parent.is_dir():
        raise UsageError(f"{output}: there is no folder {output.parent}; make it first")
    try:
        _write(captures, channels, output)
    except OSError as error:
        raise UsageError(f"{output}: cannot be written: {error.strerror or error}") from error
    click.echo(f"{output}: {len(channels)} decoded channels", err=True)


def _write(captures: tuple[Path, ...], channels: "list[DecodedChannel]", output: Path) -> None:
    match output.suffix.lower():
        case ".json":
            from syncline_analyzer.layouts.foxglove import foxglove_layout

            output.write_text(foxglove_layout(channels), encoding="utf-8", newline="\n")
        case ".rrd":
            from syncline_analyzer.layouts.plain_rerun import write_plain

            write_plain(captures, channels, output)
        case _:
            raise UsageError(f"{output}: name it .json for Foxglove or .rrd for Rerun")
