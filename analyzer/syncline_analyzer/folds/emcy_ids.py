"""Which frames on the predefined EMCY identifiers 081h..0FFh are something else."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_schemas.canopen.services import Service

SYNC_BYTES = 1
"""A SYNC is empty or carries its counter (CiA 301 7.2.5); an EMCY has eight bytes."""
RHYTHM = 8
"""Empty frames from which on a steady rhythm is believed."""
STEADY_SHARE = 0.9
"""Part of their intervals that lie within half of the median."""
_EXTENDED = 0x20000000


class EmcyIds:
    """Tells EMCYs from a SYNC that 1005h put on their identifiers, and from PDOs bound to them."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._bindings = PdoBindings(context.shadow)

    def rows(self, batch: IndexedBatch) -> NDArray[np.intp]:
        """(n,) rows of the batch that are EMCYs by their predefined identifiers, in order."""
        found = batch.rows_of(Service.EMCY)
        if not len(found):
            return found
        other = np.zeros(len(batch), np.bool_)
        for bus in {bus for bus, can_id in batch.ids() if 0x80 < can_id <= 0xFF}:
            self._bindings.refresh(bus)
        for bus, can_id in batch.ids():
            if 0x80 < can_id <= 0xFF:
                rows = batch.rows(bus, can_id)
                other[rows] = self._others(batch, bus, can_id, rows)
        return found[~other[found]]

    def _others(
        self, batch: IndexedBatch, bus: int, can_id: int, rows: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        """(n,) whether the rows of an identifier are SYNCs or PDOs."""
        last = batch.seq0 + len(batch)
        cuts = {seq for node in self._nodes(bus) for seq in self._changes(bus, node)}
        cuts |= set(self._bindings.cuts(bus, can_id, batch.seq0, last))
        moments = [batch.seq0, *sorted(seq for seq in cuts if batch.seq0 < seq <= last)]
        sync = np.array([self._is_sync(bus, can_id, seq) for seq in moments])
        pdo = np.array([self._is_pdo(bus, can_id, seq) for seq in moments])
        at = np.searchsorted(moments, rows + batch.seq0, side="right") - 1
        others: NDArray[np.bool_] = pdo[at] | (sync[at] & (batch.frames.dlc[rows] <= SYNC_BYTES))
        return others

    def _changes(self, bus: int, node: int) -> list[int]:
        return self._context.shadow.changes(bus, node, 0x1005)

    def _nodes(self, bus: int) -> Iterator[int]:
        """Nodes of which the bus or its description tells objects."""
        name = self._context.bus_name(bus)
        yield from (node for on, node in self._context.shadow.nodes() if on == bus)
        yield from (node for on, node in self._context.description.nodes if on in (None, name))

    def _is_sync(self, bus: int, can_id: int, seq: int) -> bool:
        values = (self._context.shadow.number(bus, n, 0x1005, 0, seq) for n in self._nodes(bus))
        return any(v is not None and not v & _EXTENDED and v & 0x7FF == can_id for v in values)

    def _is_pdo(self, bus: int, can_id: int, seq: int) -> bool:
        pdo = self._bindings.owner(bus, can_id, seq)
        return pdo is not None and not pdo.guess


def beats_like_sync(times_ns: Sequence[int], lengths: Sequence[int]) -> bool:
    """Whether frames without content come in a steady rhythm, which no error does.

    Times [ns] are all equal in a capture without times: there the number of frames decides.

    >>> beats_like_sync([10 * n for n in range(20)], [0] * 20)
    True
    >>> beats_like_sync([10, 20, 900, 910, 2000, 2010, 2020, 9000], [0] * 8)
    False
    """
    if len(times_ns) < RHYTHM or any(length > SYNC_BYTES for length in lengths):
        return False
    periods = np.diff(np.asarray(times_ns, np.float64))
    median = float(np.median(periods))
    steady = np.abs(periods - median) <= median / 2
    return float(np.mean(steady)) >= STEADY_SHARE
