"""Values of one series: `histogram.c`, `extremes.c`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, FLOAT, INT, Loop, begins, check, column_of

_HISTOGRAM = Loop("histogram", INT, AT, AT, FLOAT, FLOAT, INT, AT, INT, INT, INT, AT, AT)
_TALLY = Loop("tally", INT, AT, AT, AT, INT, AT, AT)
_EXTREMES = Loop("extremes", INT, AT, INT, AT)
_THINNED = Loop("thinned", *[INT] * 3, AT, *[INT] * 3, AT, AT)
_EIGHT_BYTES = (np.dtype(np.int64), np.dtype(np.float64))


def histogram(
    values: NDArray[np.int64] | NDArray[np.float64],
    low: float,
    width: float,
    fine: NDArray[np.int64],
    shift: int,
    first_key: int,
    coarse: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Add values to the counts of bins of equal width, and those in none of them to coarse ones.

    A value's coarse bin are the bits of value + 1, shifted to the right, less the first key.

    Returns: (n,) by how much each value exceeds `low`.
    """
    for counts in (fine, coarse):
        check(counts.dtype == np.int64 and counts.flags.carray and len(counts) > 0)
    check(0 <= shift < 64 and first_key >= 0)
    bins, count = (shift, first_key, len(coarse)), len(values)
    given = _either(values)
    above = np.empty(count, np.float64)
    _HISTOGRAM(count, *given, low, width, len(fine), fine, *bins, coarse, above)
    return above


def tally(
    keys: NDArray[np.integer[Any]],
    weights: NDArray[np.int64] | NDArray[np.float64],
    counts: NDArray[np.int64],
    sums: NDArray[np.float64],
) -> None:
    """Add to counts and sums by key how often each key comes, and all that it weighs."""
    count = len(keys)
    check(counts.dtype == np.int64 and counts.flags.carray)
    check(sums.dtype == np.float64 and sums.flags.carray and len(sums) == len(counts))
    check(len(weights) == count)
    columns = column_of(keys, np.uint32, count), *_either(weights)
    check(_TALLY(count, *columns, len(counts), counts, sums) == 0)


def extremes(values: NDArray[np.float64], run: int) -> NDArray[np.intp]:
    """Rows of the smallest and the largest value of each run, ascending."""
    count = len(values)
    rows = np.empty(2 * -(-count // run), np.int64)
    found = _EXTREMES(count, column_of(values, np.float64, count), run, rows)
    return rows[:found]


def thinned(
    blocks: Sequence[Mapping[str, NDArray[Any]]], key: str, run: int, count: int
) -> dict[str, NDArray[Any]] | None:
    """The first `count` rows of blocks, of which those stay that are `extremes` of the column `key`.

    None where blocks are not of the same columns, or one is neither of int64 nor of float64.
    """
    types = {name: column.dtype for name, column in blocks[0].items()}
    for block in blocks:
        if {name: column.dtype for name, column in block.items()} != types:
            return None
    if any(dtype not in _EIGHT_BYTES for dtype in types.values()):
        return None
    lengths = np.array([len(block[key]) for block in blocks], np.int64)
    check(run > 0 and 0 <= count <= lengths.sum())
    sizes = lengths.tolist()
    sources = [
        column_of(block[name], dtype, size)
        for name, dtype in types.items()
        for block, size in zip(blocks, sizes, strict=True)
    ]
    kept = {name: np.empty(2 * -(-count // run), dtype) for name, dtype in types.items()}
    columns = len(types), list(types).index(key), types[key] == np.int64
    places = begins(sources), begins(list(kept.values()))
    found = _THINNED(count, run, len(blocks), lengths, *columns, *places)
    return {name: column[:found] for name, column in kept.items()}


def _either(
    values: NDArray[np.int64] | NDArray[np.float64],
) -> tuple[NDArray[Any] | int, NDArray[Any] | int]:
    """A column as whole numbers or as others, and nothing for what it is not."""
    if values.dtype == np.int64:
        return column_of(values, np.int64, len(values)), 0
    return 0, column_of(values, np.float64, len(values))
