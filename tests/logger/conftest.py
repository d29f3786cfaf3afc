"""What every test of the logger starts from."""

import signal
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

STOPS: dict[str, Any] = {"SIGINT": signal.default_int_handler, "SIGHUP": signal.SIG_DFL}


@pytest.fixture(scope="session", autouse=True)
def _signals_of_a_terminal() -> Iterator[None]:
    """Recorders started by tests obey the signals that a job in the background ignores."""
    with ExitStack() as undo:
        for name, handler in STOPS.items():
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is signal.SIG_IGN:
                undo.callback(signal.signal, number, signal.signal(number, handler))
        yield
