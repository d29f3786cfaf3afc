"""Files about a running recording that other programs read; each is replaced as a whole."""

import logging
import os
from collections.abc import Callable
from pathlib import Path

from syncline_logger.live_status import StatusSnapshot

LOG = logging.getLogger("syncline.status")

Text = Callable[[StatusSnapshot, bool], str]
"""A file's content from a snapshot and whether the recorder still runs."""


class StatusFile:
    """A file with the latest status. What goes wrong with it never stops the recording."""

    def __init__(self, path: Path, text: Text) -> None:
        self._path = path
        self._text = text
        self._failed = False

    def show(self, snapshot: StatusSnapshot, *, running: bool = True) -> None:
        """Write the status, or log once why that cannot be done."""
        try:
            replace_file(self._path, self._text(snapshot, running))
        except OSError as error:
            if not self._failed:
                LOG.warning("%s cannot be written: %s", self._path, error.strerror or error)
            self._failed = True
        else:
            self._failed = False


def replace_file(path: Path, text: str) -> None:
    """Write a file so that a reader sees the old content or the new one, never a part.

    Raises OSError.
    """
    # A name that node_exporter (*.prom) and people's patterns (*.json) do not take.
    draft = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        draft.write_text(text, encoding="utf-8", newline="\n")
        draft.replace(path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise
