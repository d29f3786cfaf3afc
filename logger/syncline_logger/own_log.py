"""The recorder's own log: what happened to it, in a file of bounded size."""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from logging.handlers import RotatingFileHandler
from pathlib import Path

from syncline_schemas.errors import UsageError

ROOT = "syncline"

# Without a log file nothing is printed: the status and the capture tell it all.
logging.getLogger(ROOT).addHandler(logging.NullHandler())


class _QuietHandler(RotatingFileHandler):
    """A full disk is no reason to stop recording, nor to fill the journal with tracebacks."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Lose the line."""


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
        handler = _QuietHandler(path, maxBytes=size, backupCount=keep, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"--log {path}: cannot be written: {error.strerror or error}") from error
    formatter = logging.Formatter("%(asctime)s.%(msecs)03dZ %(levelname)s %(message)s")
    formatter.converter = time.gmtime
    formatter.default_time_format = "%Y-%m-%dT%H:%M:%S"
    formatter.datefmt = "%Y-%m-%dT%H:%M:%S"
    handler.setFormatter(formatter)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        handler.close()
