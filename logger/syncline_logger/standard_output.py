"""Standard output whose reader may go away."""

import os
import sys

import click


def discard_stdout() -> None:
    """Point stdout nowhere: its reader is gone, and Python's own flush at exit shall not fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_line(line: str) -> None:
    """Print, unless nobody reads any more: that is no reason to stop what is told about."""
    try:
        click.echo(line)
    except OSError:
        discard_stdout()
