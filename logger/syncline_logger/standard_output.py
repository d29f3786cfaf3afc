"""Standard output that may be missing, or whose reader may go away."""

import os
import sys

import click


def open_missing_streams() -> None:
    """Open what was closed before the start (`>&-`, a program without a console), to nowhere."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115


def discard_stdout() -> None:
    """Point stdout nowhere: its reader is gone, and Python's own flush at exit shall not fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_line(line: str) -> None:
    """Print, unless nobody reads any more: that is no reason to stop what is told about."""
    try:
        click.echo(line)
    except OSError:
        discard_stdout()
