"""Everything that is told of a running recording: view, files, own log, service manager."""

import logging
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from syncline_logger.live_status import StatusSnapshot
from syncline_logger.prometheus import prometheus_text
from syncline_logger.sd_notify import ServiceManager
from syncline_logger.status_changes import status_changes
from syncline_logger.status_file import StatusFile
from syncline_logger.status_view import plain_line, status_file_text

LOG = logging.getLogger("syncline.record")


class View(Protocol):
    """What shows a recording to who started it."""

    def started(self, path: Path) -> None:
        """The recording has begun."""
        ...

    def status(self, snapshot: StatusSnapshot) -> None:
        """Show the state of the recorder."""
        ...


class RecordOutputs:
    """Passes what the recorder tells to everyone who wants to know; ends with the recording."""

    def __init__(
        self,
        view: View,
        status_file: Path | None = None,
        prometheus: Path | None = None,
        manager: ServiceManager | None = None,
    ) -> None:
        self._view = view
        self._manager = manager or ServiceManager()
        self._last: StatusSnapshot | None = None
        wanted = ((status_file, status_file_text), (prometheus, prometheus_text))
        self._files = [StatusFile(path, text) for path, text in wanted if path is not None]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Say how it ended; the files say from now on that nobody records."""
        if error is None:
            LOG.info("stopped")
        else:
            LOG.error("ended by %s: %s", type(error).__name__, error)
        if self._last is not None:
            for file in self._files:
                file.show(self._last, running=False)
        self._manager.stopping()
        self._manager.close()

    def started(self, path: Path) -> None:
        """The recorder listens and the file is open."""
        LOG.info("started: syncline %s, recording to %s", version("syncline"), path)
        self._view.started(path)
        self._manager.ready(f"recording to {path}")

    def status(self, snapshot: StatusSnapshot) -> None:
        """A period has passed."""
        for change in status_changes(self._last, snapshot):
            LOG.info(change)
        self._last = snapshot
        self._view.status(snapshot)
        for file in self._files:
            file.show(snapshot)
        self._manager.status(plain_line(snapshot))

    def alive(self) -> None:
        """The writing loop has done its work once more."""
        self._manager.alive()
