"""`syncline trigger`."""

import signal
from pathlib import Path

import click

from syncline_logger.option_types import duration_ns

SIGNAL_ASKS = hasattr(signal, "SIGUSR1")
EPILOG = """\b
Examples:
  syncline trigger captures/
  syncline trigger captures/ --text "the gripper dropped the part"
"""


@click.command(epilog=EPILOG)
@click.argument("folder", type=click.Path(path_type=Path), default=Path())
@click.option("--text", default="", metavar="WORDS", help="What happened; stands in the mark.")
@click.option(
    "--wait",
    "wait_ns",
    type=duration_ns,
    metavar="TIME",
    default="5s",
    show_default=True,
    help="How long to wait for a recorder to take it.",
)
def trigger(folder: Path, text: str, wait_ns: int) -> None:
    """Mark this moment in what a recorder writes into FOLDER (this folder, if none is given).

    Works on every system: a small file is put into the folder, which the recorder takes away
    within a second. Exit code 1 when no recorder took it.
    """
    from syncline_logger.triggers.requests import ask
    from syncline_schemas.errors import UsageError

    if not folder.is_dir():
        raise UsageError(f"{folder} is no folder; name the one into which the recorder writes")
    try:
        taken = ask(folder, text, wait_ns / 1e9)
    except OSError as error:
        hint = "; 'kill -USR1 PID' of the recorder asks without a file" if SIGNAL_ASKS else ""
        reason = error.strerror or error
        raise UsageError(f"a request cannot be put into {folder}: {reason}{hint}") from error
    if not taken:
        click.echo(f"syncline: no recorder that writes into {folder} took the request", err=True)
        raise SystemExit(1)
    click.echo("the recorder has taken it", err=True)
