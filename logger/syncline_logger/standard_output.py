"""Standard output whose reader may go away."""

import os
import sys
from pathlib import Path


def discard_stdout() -> None:
    """Point stdout nowhere: its reader is gone, and Python's own flush at exit shall not fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def forget_stdout() -> None:
    """Leave stdout alone: a thread hangs in a write to it, and Python's own flush at exit would too."""
    sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - used until the end
