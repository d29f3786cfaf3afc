"""The recorder's end of the live view: hands frames over, and never waits for anything."""

import importlib.util
import pickle
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import IO, Self

from syncline_logger.live_view.process import NOT_OPENED, VIEWER
from syncline_logger.live_view.taken import Begun, Taken
from syncline_schemas.errors import MissingExtraError
from syncline_schemas.wording import counted

MAX_WAITING = 1 << 17
"""Frames that may wait for the live view; what comes beyond is not shown."""
LAST_S = 5.0
"""How long the end waits for the live view to show the rest."""

CLOSED = "the live view was closed; the recording goes on"
NO_WINDOW = "the live view could not be opened (no screen?); the recording goes on"
BROKEN = "the live view ended by an error; the recording goes on"


def check_installed() -> None:
    """Raises MissingExtraError where there is no viewer to be had."""
    if importlib.util.find_spec("rerun") is None:
        raise MissingExtraError(
            "--view needs the package 'rerun-sdk', which is not installed;"
            ' type: pip install "syncline[analyzer]"'
        )


class LiveView:
    """A process that shows what is recorded, and the thread that feeds it.

    `take` costs the recording next to nothing: it puts frames into a queue of bounded length, or
    drops them where that is full, which is counted and told. A viewer that hangs, is closed or was
    never there changes nothing of the recording; it is told once.

    Args:
        tell: takes words for whoever started the recording; called in any thread.
        target: what shows it: "viewer", the address of one, or a file.
        command: starts the process; its last word will be the target.
    """

    def __init__(
        self,
        tell: Callable[[str], None],
        target: str = VIEWER,
        command: tuple[str, ...] = (sys.executable, "-m", "syncline_logger.live_view.process"),
    ) -> None:
        self._tell = tell
        self._command = (*command, target)
        self._waiting: deque[Begun | Taken | None] = deque()
        self._waiting_frames = 0
        self._changed = threading.Condition()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._run, name="syncline live view", daemon=True)
        self._over = self._closed = False
        self.dropped_frames = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def begin(self, begun: Begun) -> None:
        """Start the process; what is wrong with it is told, and harms nothing."""
        self._put(begun)
        self._thread.start()

    def take(self, taken: Taken) -> None:
        """Have frames shown soon; never waits, never raises."""
        if self._over:
            return
        frames = len(taken.frames)
        if self._waiting_frames + frames > MAX_WAITING:
            if not self.dropped_frames:
                self._tell("the live view is behind; frames are recorded but not shown")
            self.dropped_frames += frames
            return
        self._put(taken)

    def close(self) -> None:
        """End the feeding; the process shows the rest and ends, the viewer stays open."""
        if not self._thread.ident or self._closed:
            return
        self._closed = True
        self._put(None)
        self._thread.join(LAST_S)
        self._over = True
        if self._thread.is_alive() and self._process is not None:
            # It stands still; a thread that writes to it cannot be ended in another way.
            self._process.kill()
            self._thread.join(LAST_S)
        if self.dropped_frames:
            count = counted(self.dropped_frames, "frame")
            self._tell(f"{count} were recorded but not shown in the live view")

    def _put(self, item: Begun | Taken | None) -> None:
        with self._changed:
            self._waiting.append(item)
            self._waiting_frames += len(item.frames) if isinstance(item, Taken) else 0
            self._changed.notify()

    def _next(self) -> Begun | Taken | None:
        with self._changed:
            while not self._waiting:
                self._changed.wait()
            item = self._waiting.popleft()
            self._waiting_frames -= len(item.frames) if isinstance(item, Taken) else 0
            return item

    def _run(self) -> None:
        try:
            self._process = process = _started(self._command)
            assert process.stdin is not None
            with process.stdin as pipe:
                self._feed(pipe)
            process.wait()
        except (OSError, ValueError) as error:
            self._give_up(error)

    def _feed(self, pipe: IO[bytes]) -> None:
        """Write what there is to show until the end; what it raises means that nobody reads."""
        while (item := self._next()) is not None:
            pickle.dump(item, pipe, protocol=pickle.HIGHEST_PROTOCOL)
            pipe.flush()

    def _give_up(self, error: Exception) -> None:
        """Nobody looks any more: say so, unless the recording is over as well."""
        process = self._process
        if process is None:
            words = f"the live view cannot be started: {error}; the recording goes on"
        else:
            words = BROKEN
            with suppress(subprocess.TimeoutExpired):
                words = {0: CLOSED, NOT_OPENED: NO_WINDOW}.get(process.wait(LAST_S), BROKEN)
        if not self._over:
            self._over = True
            self._tell(words)
        with self._changed:
            self._waiting.clear()
            self._waiting_frames = 0


def _started(command: tuple[str, ...]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
