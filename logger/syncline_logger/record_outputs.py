"""Everything that is told of a running recording: view, files, own log, service manager."""

import logging
import time
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from syncline_logger.aside import Aside
from syncline_logger.live_status import StatusSnapshot
from syncline_logger.notes import Note
from syncline_logger.prometheus import prometheus_text
from syncline_logger.sd_notify import ServiceManager
from syncline_logger.status_file import StatusFile
from syncline_logger.status_view import plain_line, status_file_text

LOG = logging.getLogger("syncline.record")

LAST_OUTPUTS_S = 2.0
"""How long the end waits for outputs that stand still."""


class View(Protocol):
    """What shows a recording to who started it."""

    def started(self, path: Path) -> None:
        """The recording has begun."""
        ...

    def status(self, snapshot: StatusSnapshot) -> None:
        """Show the state of the recorder."""
        ...

    def words(self, text: str) -> None:
        """Say something."""
        ...


class RecordOutputs:
    """Passes what the recorder tells to everyone who wants to know; ends with the recording.

    The view has a thread of its own, and so have the files with the log: what stands still or
    raises there neither holds up nor harms the recording.
    """

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
        self._to_view, self._to_files = Aside(), Aside()
        self._log(logging.INFO, f"syncline {version('syncline')} starts")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Say how it ended; the files say from now on that nobody records."""
        last = self._last
        if error is not None:
            words, level = f"ended by {type(error).__name__}: {error}", logging.ERROR
        else:
            words, level = f"stopped: {plain_line(last)}" if last else "stopped", logging.INFO
        self._to_files.do("the log", lambda: LOG.log(level, "%s", words), wait_s=LAST_OUTPUTS_S)
        if last is not None:
            for file in self._files:
                show = partial(file.show, last, running=False)
                self._to_files.do(str(file.path), show, wait_s=LAST_OUTPUTS_S)
        self._manager.stopping()
        self._manager.close()
        self._to_view.close(LAST_OUTPUTS_S)
        self._to_files.close(LAST_OUTPUTS_S)

    def started(self, path: Path) -> None:
        """The recorder listens and the file is open."""
        self._log(logging.INFO, f"recording to {path}")
        self._to_view.do("the view", partial(self._view.started, path))
        self._manager.ready(f"recording to {path}")

    def note(self, note: Note) -> None:
        """Something happened."""
        level = logging.WARNING if note.serious else logging.INFO
        self._log(level, str(note), note.log_ns)

    def words(self, text: str) -> None:
        """Something happened beside the recording."""
        self._log(logging.WARNING, text)
        self._to_view.do("the view", partial(self._view.words, text))

    def status(self, snapshot: StatusSnapshot) -> None:
        """A period has passed."""
        self._last = snapshot
        self._to_view.do("the view", partial(self._view.status, snapshot))
        for file in self._files:
            self._to_files.do(str(file.path), partial(file.show, snapshot))
        self._manager.status(plain_line(snapshot))

    def alive(self) -> None:
        """The writing loop has done its work once more."""
        self._manager.alive()

    def _log(self, level: int, text: str, t_ns: int | None = None) -> None:
        extra = {"t_ns": time.time_ns() if t_ns is None else t_ns}
        self._to_files.do("the log", lambda: LOG.log(level, "%s", text, extra=extra))
