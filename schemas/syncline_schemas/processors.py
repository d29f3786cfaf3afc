"""How much work can be done at once."""

import os

_taken = 0


def processors() -> int:
    """Processors that this process may use, but for those that another one of ours is to have."""
    return max(1, _usable() - _taken)


def leave(count: int) -> None:
    """Leave so many processors to another process of ours, from here on."""
    global _taken
    _taken = count


def _usable() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # only Linux tells which ones may be used
        return os.cpu_count() or 1
