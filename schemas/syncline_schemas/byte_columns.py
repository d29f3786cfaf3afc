"""Numbers at many places of the same bytes at once."""

from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

Column = NDArray[np.integer[Any]]
"""(n,) uint64 numbers."""
Places = NDArray[np.intp]
"""(n,) offsets into the bytes."""
ByteOrder = Literal["<", ">"]

_ROOM: Final = 160
"""Spare bytes behind, so that a column may be taken from a record that is cut off."""


class ByteColumns:
    """Bytes, of which columns of numbers are taken; what lies beyond their end is 0."""

    def __init__(self, data: bytes, order: ByteOrder = "<") -> None:
        self._data = data + bytes(_ROOM)
        self._order = order

    def ordered(self, order: ByteOrder) -> "ByteColumns":
        """The same bytes with their numbers in another order."""
        other = ByteColumns.__new__(ByteColumns)
        other._data, other._order = self._data, order
        return other

    def _at(self, at: Places, offset: int, dtype: str) -> Column:
        width = np.dtype(dtype).itemsize
        view = np.ndarray((len(self._data) - width + 1,), dtype, self._data, 0, (1,))
        taken: Column = view[np.minimum(at + offset, len(view) - 1)].astype(np.uint64)
        return taken

    def u8(self, at: Places, offset: int) -> Column:
        """One byte each."""
        return self._at(at, offset, "u1")

    def u16(self, at: Places, offset: int) -> Column:
        """Two bytes each."""
        return self._at(at, offset, f"{self._order}u2")

    def u32(self, at: Places, offset: int) -> Column:
        """Four bytes each."""
        return self._at(at, offset, f"{self._order}u4")

    def u64(self, at: Places, offset: int) -> Column:
        """Eight bytes each."""
        return self._at(at, offset, f"{self._order}u8")

    def block(self, at: Places, offset: int, width: int) -> NDArray[np.uint8]:
        """(n, width) bytes."""
        view = np.ndarray((len(self._data) - width + 1,), f"V{width}", self._data, 0, (1,))
        taken = view[np.minimum(at + offset, len(view) - 1)]
        return taken.view(np.uint8).reshape(len(at), width)

    def words(self, start: int, end: int, offset: int = 0, step: int = 4) -> NDArray[np.int64]:
        """(m,) the four bytes at `offset` behind each `step`-th place of [start, end), int64."""
        count = max(0, -(-(end - start) // step))
        view = np.ndarray((count,), f"{self._order}u4", self._data, start + offset, (step,))
        return view.astype(np.int64)
