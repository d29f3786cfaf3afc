"""Files about a running recording that other programs read; each is replaced as a whole."""

import logging
from collections.abc import Callable
from pathlib import Path

from syncline_logger.live_status import StatusSnapshot
from syncline_logger.small_file import replace_file

LOG = logging.getLogger("syncline.status")

Text = Callable[[StatusSnapshot, bool], str]
"""A file's content from a snapshot and whether the recorder still runs."""


class StatusFile:
    """A file with the latest status. What goes wrong with it never stops the recording."""

    def __init__(self, path: Path, text: Text) -> None:
        self.path = path
        self._text = text
        self._failed = False

    def show(self, snapshot: StatusSnapshot, *, running: bool = True) -> None:
        """Write the status, or log once why that cannot be done."""
        try:
            replace_file(self.path, self._text(snapshot, running))
        except OSError as error:
            if not self._failed:
                LOG.warning("%s cannot be written: %s", self.path, error.strerror or error)
            self._failed = True
        else:
            self._failed = False
