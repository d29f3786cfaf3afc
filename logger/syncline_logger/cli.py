"""The `syncline` command."""

import gc
import os
import sys
from collections.abc import Sequence

import click

from syncline_logger.lazy_group import LazyCommand, LazyGroup, import_from, missing_extra
from syncline_logger.standard_output import discard_stdout, open_missing_streams
from syncline_logger.start import INTERRUPTED
from syncline_schemas.errors import SeveralErrors, SynclineError

FAILED = 1

_EXTRA = 'pip install "syncline[analyzer]"'

OWN_COMMANDS = {
    name: LazyCommand(short_help, import_from(target), "pip install syncline")
    for name, target, short_help in (
        ("record", "syncline_logger.record_command:record", "Record buses until stopped."),
        (
            "probe",
            "syncline_logger.probe_command:probe",
            "Ask nodes what they are and record it. Sends on the bus.",
        ),
        (
            "recover",
            "syncline_logger.recover_command:recover",
            "Make a regular file of a damaged capture.",
        ),
        (
            "trigger",
            "syncline_logger.trigger_command:trigger",
            "Ask a running recorder for a mark.",
        ),
        (
            "devices",
            "syncline_logger.devices_command:devices",
            "Show known devices, their objects, scales and quirks.",
        ),
    )
}


@click.group(
    cls=LazyGroup,
    own=OWN_COMMANDS,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="\b\nExamples:\n  syncline demo\n  syncline record -i socketcan -c can0 -b 500000",
)
@click.version_option(package_name="syncline", prog_name="syncline")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """Record CANopen buses and find out what happened on them."""


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line and exit: the one place where errors become words and exit codes."""
    # Numpy starts a thread of linear algebra for each processor, and nothing here needs one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_missing_streams()
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        code = cli.main(words, prog_name="syncline", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except (click.Abort, KeyboardInterrupt):
        code = INTERRUPTED
    except BrokenPipeError:
        discard_stdout()
        code = FAILED
    except Exception as error:  # noqa: BLE001 - the last place where it can become words
        code = _explain(error, words)
    # Python would search all modules for cycles once more, though the process ends. DuckDB's own
    # objects complain about it.
    if "duckdb" not in sys.modules:
        gc.freeze()
    sys.exit(code if isinstance(code, int) else 0)


def _explain(error: Exception, words: Sequence[str]) -> int:
    debug = "--debug" in words
    if debug:
        import traceback

        traceback.print_exception(error)
    if isinstance(error, ModuleNotFoundError) and not str(error.name).startswith("syncline"):
        command = next((word for word in words if not word.startswith("-")), "")
        error = missing_extra(command, error, _EXTRA)
    if isinstance(error, SynclineError):
        text, code = str(error), error.exit_code
    elif isinstance(error, OSError):
        text, code = str(error), SynclineError.exit_code
    else:
        text, code = f"internal error: {type(error).__name__}: {error}", FAILED
        text += "" if debug else " (please report it with the output of 'syncline --debug ...')"
    for line in error.problems if isinstance(error, SeveralErrors) else [text]:
        click.echo("syncline: " + " ".join(line.split()), err=True)
    return code
