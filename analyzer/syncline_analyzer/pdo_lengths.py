"""How long the frames of each PDO identifier are: what a device's PDOs look like from outside."""

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.results import PdoLengthRow
from syncline_schemas.batch import Gap
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service

_SERVICES: list[int] = SERVICE_OF_ID.tolist()


class PdoLengths:
    """Notes every length that the frames of a PDO identifier have, in `context.pdo_lengths`."""

    def __init__(self, context: Context) -> None:
        self._found = context.pdo_lengths

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        for key, (low, high) in batch.lengths.items():
            if _SERVICES[key[1]] == Service.PDO:
                found = self._found.setdefault(key, {})
                if low not in found or low != high:
                    self._note(batch, key, found)

    @staticmethod
    def _note(batch: IndexedBatch, key: tuple[int, int], found: dict[int, int]) -> None:
        rows = batch.rows(*key)
        dlc = batch.frames.dlc[rows]
        for length in np.flatnonzero(np.bincount(dlc)).tolist():
            if length not in found:
                found[length] = batch.seq(rows[int(np.argmax(dlc == length))])

    def gap(self, gap: Gap) -> None:
        """A gap changes nothing of it."""


def length_rows(context: Context) -> list[PdoLengthRow]:
    """One row per length of a PDO identifier, by bus, identifier and length."""
    return [
        PdoLengthRow(context.bus_name(bus), can_id, length, seq)
        for (bus, can_id), lengths in sorted(context.pdo_lengths.items())
        for length, seq in sorted(lengths.items())
    ]
