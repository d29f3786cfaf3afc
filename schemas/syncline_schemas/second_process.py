"""A Python beside this one: when there is room for it, and its start.

It may start before it is known what it is to do. Little is imported here, and nothing heavy.
"""

import os
import subprocess
import sys

from syncline_schemas.collecting import YOUNG
from syncline_schemas.processors import processors

LEAST_BYTES = 16 << 20
"""Captures of fewer bytes together are read in the process that analyzes them."""
_NO_THREADS = {"OPENBLAS_NUM_THREADS": "1"}
"""numpy's threads for linear algebra, of which reading needs none, cost 50 ms of a processor."""
_CODE = (
    f"import gc, sys; gc.set_threshold({YOUNG}); module = sys.argv[1];"
    " sys.path[:] = sys.argv[2:]; __import__(module, fromlist=['main']).main()"
)

_waiting: "dict[str, subprocess.Popen[bytes]]" = {}
"""Processes that nobody has taken yet, by module."""


def has_room() -> bool:
    """Whether there is a second processor, and a Python to start."""
    # A program that Python is built into cannot be started as a Python.
    interpreter = os.path.basename(sys.executable or "").lower()
    return interpreter.startswith(("python", "pypy")) and processors() > 1


def begin(module: str) -> None:
    """Start a process that `process` gives away later, and `end_waiting` ends."""
    if (started := _started(module)) is not None:
        _waiting[module] = started


def process(module: str) -> "subprocess.Popen[bytes] | None":
    """A process that calls `main` of a module, with pipes; None where none can be started."""
    waiting = _waiting.pop(module, None)
    if waiting is not None and waiting.poll() is None:
        return waiting
    return _started(module)


def end_waiting() -> None:
    """End the processes that nobody has taken."""
    while _waiting:
        _, waiting = _waiting.popitem()
        with waiting:
            waiting.kill()


def _started(module: str) -> "subprocess.Popen[bytes] | None":
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-c", _CODE, module, *map(str, sys.path)],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **_NO_THREADS},
            # Windows: no console window of its own.
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError:
        return None
