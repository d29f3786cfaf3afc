"""Standard output whose reader may go away."""

import os
import sys


def discard_stdout() -> None:
    """Point stdout nowhere: its reader is gone, and Python's own flush at exit shall not fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
