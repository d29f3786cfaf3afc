"""Ctrl-C and the service manager's signals as a wish to stop, not as an exception."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

_NAMES = ("SIGINT", "SIGTERM", "SIGBREAK", "SIGHUP")


@contextlib.contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """An event that is set by SIGINT, SIGTERM, SIGHUP or Ctrl-Break; the second SIGINT interrupts.

    Only in the main thread, as Python delivers signals there.
    """
    stop = threading.Event()

    def on_signal(number: int, frame: FrameType | None) -> None:
        if stop.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        stop.set()

    known = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    # Under nohup SIGHUP is ignored already, and shall stay so.
    handled = [number for number in known if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, on_signal) for number in handled}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
