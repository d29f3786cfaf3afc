"""The recorder's own log: what happened to it, in a file of bounded size."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from logging.handlers import RotatingFileHandler
from pathlib import Path

from syncline_logger.notes import utc_text
from syncline_schemas.errors import UsageError

ROOT = "syncline"

# Without a log file nothing is printed: the status and the capture tell it all.
logging.getLogger(ROOT).addHandler(logging.NullHandler())


class _QuietHandler(RotatingFileHandler):
    """A full disk is no reason to stop recording, nor to fill the journal with tracebacks."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Lose the line."""


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
        handler = _QuietHandler(path, maxBytes=size, backupCount=keep, encoding="utf-8")
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
