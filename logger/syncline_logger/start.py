"""The first instructions of `syncline`: what reads large captures starts before all else.

That process and this one take a tenth of a second to import what they need: at the same time.
"""

import gc
import os
import sys

INTERRUPTED = 130
"""Exit code after Ctrl-C."""
_READERS = dict.fromkeys(("analyze", "view"), "syncline_analyzer.reading_process")
"""The module that reads for a command which goes through all frames of its captures."""
_WITH_ENDS = {"duckdb", "rerun"}
"""Libraries that write or close something when the process ends."""


def main() -> None:
    """Run the command line and exit."""
    words = sys.argv[1:]
    module = _READERS.get(next((word for word in words if not word.startswith("-")), ""))
    try:
        if module is not None:
            _read_ahead(module, words)
        from syncline_logger.cli import main as run

        run(words)
    except KeyboardInterrupt:
        code: object = INTERRUPTED
    except SystemExit as end:
        code = end.code
    finally:
        if module is not None:
            _end_waiting()
    if module is not None and isinstance(code, int):
        _leave(code)
    sys.exit(code)  # type: ignore[arg-type]


def _read_ahead(module: str, words: list[str]) -> None:
    from syncline_schemas.collecting import YOUNG

    # Modules make no cycles that are worth a search.
    gc.set_threshold(YOUNG)
    from syncline_schemas import second_process

    # In the place of a closed stream a pipe to the process would get what is said there.
    streams = None not in (sys.stdin, sys.stdout, sys.stderr)
    large = _bytes(words) >= second_process.LEAST_BYTES
    if streams and large and second_process.has_room():
        second_process.begin(module)


def _end_waiting() -> None:
    from syncline_schemas import second_process

    second_process.end_waiting()


def _leave(code: int) -> None:
    """Exit without taking apart all objects one by one, where nothing but memory hangs on them.

    It returns where another thread runs, a library is loaded that has an end of its own, or what
    was said could not be written: Python knows what to do then.
    """
    import atexit
    import threading

    if threading.active_count() > 1 or not _WITH_ENDS.isdisjoint(sys.modules):
        return
    atexit._run_exitfuncs()
    try:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    except (OSError, ValueError, AttributeError):  # full, closed, none
        return
    os._exit(code)


def _bytes(words: list[str]) -> int:
    """Bytes of the files among the words of a command line."""
    count = 0
    for word in words:
        try:
            count += os.stat(word).st_size
        except (OSError, ValueError):  # no file, or no name of one
            continue
    return count
