"""`syncline recover`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from syncline_schemas.errors import UsageError

if TYPE_CHECKING:
    from syncline_schemas.capture.recover import RecoverResult

LOST = 1

EPILOG = """\b
Examples:
  syncline recover captures/20261122T031500Z_3f2a91bc.mcap
  syncline recover broken.mcap -o whole.mcap
"""


@click.command(epilog=EPILOG)
@click.argument(
    "captures",
    nargs=-1,
    required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="DIR|FILE.mcap",
    help="Where to write; without it CAPTURE.recovered.mcap beside the capture.",
)
@click.pass_context
def recover(ctx: click.Context, captures: tuple[Path, ...], output: Path | None) -> None:
    """Make regular files of captures that were cut off or damaged.

    The captures themselves are left as they are. Exit code 0 when nothing was lost, 1 when some
    data could not be saved; stderr says what.
    """
    from syncline_schemas.capture.recover import recover as recover_file
    from syncline_schemas.progress_line import progress_line

    lost = False
    for capture, target in zip(captures, targets(captures, output), strict=True):
        with progress_line() as line:
            result = recover_file(capture, target, line)
        lost |= bool(result.lost_chunks or result.lost_frames)
        click.echo(str(target))
        _say(capture, result)
    if lost:
        ctx.exit(LOST)


def targets(captures: tuple[Path, ...], output: Path | None) -> list[Path]:
    """Where each capture's regular file goes; raises UsageError where a file is in the way."""
    if output is None:
        chosen = [capture.with_name(f"{capture.stem}.recovered.mcap") for capture in captures]
    elif output.is_dir() or len(captures) > 1:
        chosen = [output / capture.with_suffix(".mcap").name for capture in captures]
    else:
        chosen = [output]
    for target in chosen:
        if target.exists():
            raise UsageError(f"{target} exists; say another place with -o")
    if len(set(chosen)) < len(chosen):
        raise UsageError("two captures would get the same name; recover them one by one")
    return chosen


def _say(capture: Path, result: "RecoverResult") -> None:
    from syncline_schemas.wording import counted

    state = "was whole" if result.whole else "repaired"
    click.echo(f"{capture}: {state}, {counted(result.frames, 'frame')} saved", err=True)
    for damage in result.damage:
        click.echo(f"  {damage}", err=True)
    if result.lost_chunks or result.lost_frames:
        click.echo(
            f"  lost: {counted(result.lost_chunks, 'chunk')},"
            f" at least {counted(result.lost_frames, 'frame')}",
            err=True,
        )
