"""The decoded values of one PDO, for those who watch them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.decoder.pdo import PdoColumn


@dataclass(frozen=True, slots=True, eq=False)
class PdoValues:
    """Frames of one PDO of a batch, decoded.

    Attributes:
        bus, bus_name, node: whose PDO it is.
        columns: a column of (n,) values by mapped object.
        t_ns, log_ns: (n,) int64, when the frames were on the bus and when they were taken in.
    """

    bus: int
    bus_name: str
    node: int
    columns: Sequence[PdoColumn]
    t_ns: NDArray[np.int64]
    log_ns: NDArray[np.int64]
