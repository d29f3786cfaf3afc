"""Calling others' code beside the recording, which must not suffer by it."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class Guard:
    """Makes callbacks that never raise: the first exception of each is told, and it is called again.

    Args:
        tell: takes words for what went wrong.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._told: set[str] = set()

    def call(self, name: str, act: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
        """What `act` returns; None where it raised."""
        try:
            return act(*args, **kwargs)
        except Exception as error:  # noqa: BLE001 - whatever it is, the recording goes on
            if name not in self._told:
                self._told.add(name)
                self._tell(f"{name}: {type(error).__name__}: {error}; the recording goes on")
            return None
