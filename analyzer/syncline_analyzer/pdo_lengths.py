"""How long the frames of each PDO identifier are: what a device's PDOs look like from outside."""

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.results import PdoLengthRow
from syncline_schemas.batch import Gap
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service


class PdoLengths:
    """Notes every length that the frames of a PDO identifier have, in `context.pdo_lengths`."""

    def __init__(self, context: Context) -> None:
        self._found = context.pdo_lengths

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        for bus, can_id in batch.ids():
            if SERVICE_OF_ID[can_id] != Service.PDO:
                continue
            rows = batch.rows(bus, can_id)
            dlc = batch.frames.dlc[rows]
            found = self._found.setdefault((bus, can_id), {})
            low, high = int(dlc.min()), int(dlc.max())
            for length in (low,) if low == high else np.flatnonzero(np.bincount(dlc)).tolist():
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
