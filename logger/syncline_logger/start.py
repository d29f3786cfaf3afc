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
        sys.exit(INTERRUPTED)
    finally:
        if module is not None:
            _end_waiting()


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


def _bytes(words: list[str]) -> int:
    """Bytes of the files among the words of a command line."""
    count = 0
    for word in words:
        try:
            count += os.stat(word).st_size
        except (OSError, ValueError):  # no file, or no name of one
            continue
    return count
