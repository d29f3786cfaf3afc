"""The time that the frames of each bus took on the wire, and how exact their stamps are."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.waiting import ENOUGH_CLOSE, close_ns, noise_of


class OnWire:
    """Learns block by block, ahead of those who reason about when the bus was free.

    Nothing is learned without times, or of a bus whose bit rate is not known.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._noise_ns: dict[int, float] = {}
        self._close: dict[int, int] = {}

    def listen(self, block: Block) -> None:
        """Learn from a whole block how exact the stamps of each bus are."""
        for bus, places in block.by_bus.items():
            bit_ns = self.bit_ns(bus)
            if bit_ns is None or not self._context.timed:
                continue
            t_ns, wire_ns = block.frames.t_ns[places], self.times_ns(block, bus, bit_ns)
            self._count_close(bus, t_ns, wire_ns, bit_ns)
            self._noise_ns[bus] = noise_of(
                t_ns,
                wire_ns,
                bit_ns=bit_ns,
                resolution_ns=self._context.resolution_ns,
                before_ns=self.noise_ns(bus),
            )

    def bit_ns(self, bus: int) -> float | None:
        """Length of a bit, None where the bit rate is not known."""
        bitrate = self._context.bitrates.get(self._context.bus_name(bus))
        return 1e9 / bitrate if bitrate else None

    def times_ns(self, block: Block, bus: int, bit_ns: float) -> NDArray[np.float64]:
        """(k,) time on the wire of the frames of a bus; NaN where it is not known."""
        rate = self._context.data_bitrates.get(self._context.bus_name(bus))
        return block.wire_ns(bus, bit_ns, 1e9 / rate if rate else None)

    def noise_ns(self, bus: int) -> float:
        """What the stamps of a bus are off beyond their step."""
        return self._noise_ns.get(bus, 0.0)

    def _count_close(
        self,
        bus: int,
        t_ns: NDArray[np.int64],
        wire_ns: NDArray[np.float64],
        bit_ns: float,
    ) -> None:
        """Note on which buses too few frames follow one another to tell how exact the stamps are."""
        close = self._close.get(bus, 0)
        if close < ENOUGH_CLOSE:
            close = self._close[bus] = close + len(close_ns(t_ns, wire_ns, bit_ns))
        name, unproven = self._context.bus_name(bus), self._context.unproven_stamps
        (unproven.add if close < ENOUGH_CLOSE else unproven.discard)(name)
