"""Text lines of many frames at once: characters as columns, lines put together by their offsets."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag

Chars = NDArray[np.uint8]
"""(n, width) characters."""
Piece = Chars | bytes
LineBuilder = Callable[[FrameBatch], Sequence[Piece]]
"""The pieces of the lines of frames that agree in bus, flags and length; never of none."""

_HEX_PAIRS = np.frombuffer("".join(f"{i:02X}" for i in range(256)).encode(), "<u2")
_FOUR_DIGITS = np.frombuffer("".join(f"{i:04d}" for i in range(10_000)).encode(), "<u4")


def decimal(values: NDArray[np.int64], width: int, *, pad: bytes = b"0") -> Chars:
    """(n, width) decimal digits of numbers that are not negative."""
    groups = -(-width // 4)
    words = np.empty((len(values), groups), np.uint32)
    rest = values
    for group in range(groups - 1, -1, -1):
        rest, part = np.divmod(rest, 10_000)
        words[:, group] = _FOUR_DIGITS[part]
    digits = words.view(np.uint8).reshape(len(values), -1)[:, 4 * groups - width :]
    if pad == b"0":
        return digits
    leading = np.logical_and.accumulate(digits[:, :-1] == ord("0"), axis=1)
    digits = digits.copy()
    digits[:, :-1][leading] = pad[0]
    return digits


def hexadecimal(values: NDArray[np.uint32], digits: int) -> Chars:
    """(n, digits) hexadecimal digits, up to eight."""
    raw = values.astype(">u4").view(np.uint8).reshape(len(values), 4)
    return _HEX_PAIRS[raw].view(np.uint8).reshape(len(values), 8)[:, 8 - digits :]


def data_digits(data: Chars, count: int, *, before: bytes = b"") -> Chars:
    """(n, ...) the first `count` data bytes in hexadecimal, each after `before`."""
    pairs = _HEX_PAIRS[data[:, :count]].view(np.uint8).reshape(len(data), count, 2)
    if not before:
        return pairs.reshape(len(data), 2 * count)
    out = np.empty((len(data), count, 3), np.uint8)
    out[:, :, 0] = before[0]
    out[:, :, 1:] = pairs
    return out.reshape(len(data), 3 * count)


def compose(batch: FrameBatch, lines: LineBuilder) -> bytes:
    """The lines of a batch in its order; `lines` is asked once for each kind of frame."""
    return interleave([(rows, _joined(lines(batch[rows]), len(rows))) for rows in kinds_of(batch)])


def kinds_of(batch: FrameBatch) -> list[NDArray[np.intp]]:
    """Rows of the frames that agree in bus, flags and length, for each such kind."""
    kind = (
        (batch.bus.astype(np.uint32) << 24)
        | (batch.flags.astype(np.uint32) << 8)
        | batch.dlc.astype(np.uint32)
    )
    order = np.argsort(kind, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(kind[order])) + 1) if len(batch) else []


def interleave(parts: Sequence[tuple[NDArray[np.intp], Chars]]) -> bytes:
    """Records of several widths in the order of their row numbers, which are 0, 1, 2 ... in all."""
    lengths = np.zeros(sum(len(rows) for rows, _ in parts), np.intp)
    for rows, text in parts:
        lengths[rows] = text.shape[1]
    ends = np.cumsum(lengths)
    out = bytearray(int(ends[-1]) if len(ends) else 0)
    for rows, text in parts:
        width = text.shape[1]
        view = np.ndarray((len(out) - width + 1,), f"V{width}", out, 0, (1,))
        view[ends[rows] - width] = text.view(f"V{width}").reshape(-1)
    return bytes(out)


def _joined(pieces: Sequence[Piece], n: int) -> Chars:
    columns = [
        np.broadcast_to(np.frombuffer(piece, np.uint8), (n, len(piece)))
        if isinstance(piece, bytes)
        else piece
        for piece in pieces
        if len(piece)
    ]
    return np.ascontiguousarray(np.concatenate(columns, axis=1))


def has(batch: FrameBatch, flag: FrameFlag) -> bool:
    """Whether the frames of one kind carry a flag."""
    return bool(batch.flags[0] & flag)


def payload_length(batch: FrameBatch) -> int:
    """Data bytes in each frame of one kind."""
    return 0 if has(batch, FrameFlag.REMOTE) else int(batch.dlc[0])
