"""How long the frames of each PDO identifier are: what a device's PDOs look like from outside."""

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
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
            lengths, first = np.unique(batch.frames.dlc[rows], return_index=True)
            found = self._found.setdefault((bus, can_id), {})
            for length, at in zip(lengths.tolist(), first.tolist(), strict=True):
                found.setdefault(length, batch.seq(rows[at]))

    def gap(self, gap: Gap) -> None:
        """A gap changes nothing of it."""
