"""Which numbers there are in a column."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def distinct(numbers: NDArray[np.integer[Any]], most: int | None = None) -> list[int]:
    """Each number of (n,) once, ascending; the lowest ones only, where there are more than `most`.

    `np.unique` would ask whether the array is a masked one, and import a megabyte for that.

    >>> distinct(np.array([3, 1, 3, 2]))
    [1, 2, 3]
    """
    ordered = np.sort(numbers)
    later = ordered[1:][ordered[1:] != ordered[:-1]]
    return [*ordered[:1].tolist(), *later[:most].tolist()][:most]
