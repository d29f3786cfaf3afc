"""The recorder's own log: what happened to it, in a file of bounded size."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from logging.handlers import RotatingFileHandler
from pathlib import Path

from syncline_logger.notes import utc_text
from syncline_schemas.errors import UsageError

ROOT = "syncline"

# Without a log file nothing is printed: the status and the capture tell it all.
logging.getLogger(ROOT).addHandler(logging.NullHandler())


LAST_LINES_S = 2.0
"""How long the end waits for a log file that stands still."""


class _LogFile(RotatingFileHandler):
    """A file that may be full or stand still (a disk that hangs, a pipe that nobody reads).

    Neither is a reason to stop recording, nor to go on for ever. logging's own lock is never held
    while something is written: logging takes it at the end of the process, whatever it costs.
    """

    def __init__(self, path: Path, size: int, keep: int) -> None:
        self._writing = threading.Lock()
        self._given_up = False
        super().__init__(path, maxBytes=size, backupCount=keep, encoding="utf-8")

    def handle(self, record: logging.LogRecord) -> bool:
        """Write a line; one at a time."""
        with self._writing:
            self.emit(record)
        return True

    def handleError(self, record: logging.LogRecord) -> None:
        """Lose the line: no reason to fill the journal with tracebacks."""

    def flush(self) -> None:
        """Nothing waits unless the file stands still; then nothing helps."""
        if self.stream and not self._given_up:
            self.stream.flush()

    def close(self) -> None:
        """Close the file after the line that is being written; leave it alone if that hangs."""
        if self._given_up or not self._writing.acquire(timeout=LAST_LINES_S):
            self._given_up = True
            return
        try:
            super().close()
        finally:
            self._writing.release()


class _Formatter(logging.Formatter):
    """A line begins with when it happened, which may be before it is written."""

    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:
        """UTC."""
        t_ns: int = getattr(record, "t_ns", round(record.created * 1e9))
        return utc_text(t_ns)


@contextmanager
def own_log(path: Path | None, size: int, keep: int) -> Iterator[None]:
    """Log to a file, UTC first; at `size` bytes it is renamed to FILE.1 and so on up to `keep`.

    Raises UsageError when the file cannot be opened.
    """
    if path is None:
        yield
        return
    logger = logging.getLogger(ROOT)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler = _LogFile(path, size, keep)
    except OSError as error:
        raise UsageError(f"--log {path}: cannot be written: {error.strerror or error}") from error
    handler.setFormatter(_Formatter("%(asctime)s %(levelname)s %(message)s"))
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        handler.close()
