"""How much work can be done at once."""

import os


def processors() -> int:
    """Processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # only Linux tells which ones may be used
        return os.cpu_count() or 1
