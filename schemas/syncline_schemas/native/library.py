"""The library of compiled loops: whether it is there, and how one of its functions is called."""

import ctypes
import os
import sys
from collections.abc import Sequence
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from syncline_schemas.native.build import LIBRARY, fingerprint

SWITCH = "SYNCLINE_NATIVE"
"""Environment variable; with 0 the library is not used."""
INT, U32, AT, FLOAT = ctypes.c_int64, ctypes.c_uint32, ctypes.c_void_p, ctypes.c_double
"""Types of arguments; `AT` is where a column begins."""


def available() -> bool:
    """Whether there is a library made of the C files that stand here, and it is wanted."""
    return _library() is not None


@cache
def _library() -> ctypes.CDLL | None:
    little = sys.byteorder == "little" and sys.maxsize > 1 << 32
    if os.environ.get(SWITCH) == "0" or not little or not LIBRARY.is_file():
        return None
    try:
        library = ctypes.CDLL(str(LIBRARY))
        library.syncline_fingerprint.restype = U32
        return library if library.syncline_fingerprint() == fingerprint() else None
    except (OSError, AttributeError):  # of another machine, or another version
        return None


class Loop:
    """A function of the library that takes numbers and columns and returns an int64.

    Args:
        name: without the prefix that all have.
        arguments: types as in C.
    """

    def __init__(self, name: str, *arguments: type[Any]) -> None:
        self._name = f"syncline_{name}"
        self._arguments = list(arguments)

    @cached_property
    def _function(self) -> Any:
        function = getattr(_library(), self._name)
        function.restype, function.argtypes = INT, self._arguments
        return function

    def __call__(self, *arguments: float | bytes | NDArray[Any]) -> int:
        """Run it; arrays are contiguous, of the type and length that it takes."""
        given = [_begin(each) if isinstance(each, np.ndarray) else each for each in arguments]
        return int(self._function(*given))


_NOTHING = ctypes.c_char * 0


def _begin(column: NDArray[Any]) -> int:
    """Where a column begins in memory."""
    if column.flags.writeable:  # by a quarter of the time that numpy takes to tell
        return ctypes.addressof(_NOTHING.from_buffer(column))  # type: ignore[arg-type]
    return column.ctypes.data


def begins(columns: Sequence[NDArray[Any]]) -> NDArray[np.uint64]:
    """(c,) where each column begins; they must be held as long as that is used."""
    return np.array([_begin(column) for column in columns], np.uint64)


def column_of(values: NDArray[Any], dtype: DTypeLike, size: int) -> NDArray[Any]:
    """So many numbers of a type, one behind the other; a copy only where they are not."""
    check(values.size == size)
    if values.dtype == dtype and values.flags.c_contiguous and values.flags.aligned:
        return values
    return np.require(values, dtype, ["C", "A"])


def check(kept: bool) -> None:
    """Raises: ValueError, a caller's mistake, before C reads or writes anywhere else."""
    if not kept:
        raise ValueError("columns of other lengths or types than a compiled loop takes")
