"""Triggers that somebody asks for: a signal, or a file in the folder of the recordings."""

import contextlib
import os
import signal
import stat
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType

from syncline_logger.small_file import replace_file

SUFFIX = ".trigger"
"""Ending of a request; the recorder takes the file away, which is its answer."""
HEAD = b"syncline trigger\n"
"""First line of a request; a file that begins otherwise is somebody else's and stays."""
MAX_TEXT = 200
MAX_REQUESTS = 20
"""Requests that are taken at once."""
SIGNALLED = "asked for by SIGUSR1"
ASKED = "asked for by syncline trigger"


class Requests:
    """What was asked since the last poll; nothing that lies in the folder makes it raise."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._signals: SimpleQueue[str] = SimpleQueue()

    def signal(self) -> None:
        """Somebody sent a signal; may be called from its handler."""
        self._signals.put(SIGNALLED)

    def poll(self) -> list[str]:
        """Words for each request; its file is gone afterwards."""
        found: list[str] = []
        with contextlib.suppress(Empty):
            while len(found) < MAX_REQUESTS:
                found.append(self._signals.get_nowait())
        with contextlib.suppress(OSError):
            # Foreign files stay, so they must not take the place of requests.
            for path in sorted(self._folder.glob(f"*{SUFFIX}")) if self._folder else []:
                if len(found) >= MAX_REQUESTS:
                    break
                if text := _taken(path):
                    found.append(text)
        return found


def _taken(path: Path) -> str:
    """The words of a request that could be taken away; empty for none and for what is no request."""
    try:
        # Opening a FIFO would wait for its writer.
        if not stat.S_ISREG(path.lstat().st_mode):
            return ""
        with path.open("rb") as file:
            raw = file.read(len(HEAD) + 4 * MAX_TEXT)
        if not raw.startswith(HEAD):
            return ""
        path.unlink()
    except OSError:
        return ""
    raw = raw[len(HEAD) :]
    words = "".join(c for c in raw.decode("utf-8", "replace") if c.isprintable())[:MAX_TEXT].strip()
    return f"{ASKED}: {words}" if words else ASKED


@contextlib.contextmanager
def trigger_requests(folder: Path | None) -> Iterator[Requests]:
    """Requests in a folder and, where the system has it, by SIGUSR1.

    Only in the main thread, as Python delivers signals there.
    """
    requests = Requests(folder)
    number = getattr(signal, "SIGUSR1", None)

    def on_signal(number: int, frame: FrameType | None) -> None:
        requests.signal()

    before = None if number is None else signal.signal(number, on_signal)
    try:
        yield requests
    finally:
        if number is not None:
            signal.signal(number, before)


def ask(
    folder: Path,
    text: str = "",
    wait_s: float = 5.0,
    *,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> bool:
    """Ask the recorder of a folder for a trigger; whether one took it.

    The request is withdrawn when nobody took it in time. Raises OSError when the folder cannot be
    written to.
    """
    name = f"{os.getpid()}-{uuid.uuid4().hex[:8]}"
    path = folder / f"{name}{SUFFIX}"
    replace_file(path, HEAD + text[:MAX_TEXT].encode("utf-8", "replace"))
    until = clock() + wait_s
    while path.exists():
        if clock() >= until:
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
                return False
            break
        sleep(0.05)
    return True
