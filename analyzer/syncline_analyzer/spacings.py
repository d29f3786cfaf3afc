"""How far apart the first frames of each bus are, beside how long they are on the wire."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.echo import COPY
from syncline_analyzer.fold import IndexedBatch
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass
from syncline_schemas.wire_length import data_phase_bits, wire_bits

SPACINGS = 1 << 17
"""Spacings that are measured of a bus at most."""
SPAN_FRAMES = 1 << 16
"""Frames of a stream, of all buses, that are looked at together, however they are cut."""
_NO_SPACING = -1

Ints = NDArray[np.int64]


class Spacings(NamedTuple):
    """Spacings of frames of one bus that follow one another: (n,) [ns], and (n,) lengths [bit].

    The spacing is -1 where two frames do not count. `span` numbers the `SPAN_FRAMES` frames of the
    stream in which they lie.
    """

    bus: int
    span: int
    apart_ns: Ints
    bits: Ints


@dataclass(slots=True)
class SpacingGauge:
    """Measures the spacings of every bus of a stream until there are enough.

    Args:
        timed: whether the stamps mean anything; nothing is measured where they do not.
    """

    timed: bool
    _frames: int = 0
    """Frames of the stream so far."""
    _counts: dict[int, int] = field(default_factory=dict)
    _last_ns: dict[int, int] = field(default_factory=dict)
    """Stamp of the last frame of each bus; none where the next one is measured from nothing."""

    def gap(self, gap: Gap) -> None:
        """Take in that nothing was heard for a while."""
        if gap.bus is None:
            self._last_ns.clear()
        else:
            self._last_ns.pop(gap.bus, None)

    def measured(self, batch: IndexedBatch) -> list[Spacings]:
        """The spacings of the next frames, of each bus with too few of them so far."""
        if not self.timed:
            return []
        found, begin = [], 0
        while begin < len(batch):
            span, within = divmod(self._frames, SPAN_FRAMES)
            part = batch.part(slice(begin, min(len(batch), begin + SPAN_FRAMES - within)))
            begin += len(part)
            self._frames += len(part)
            wanted = [bus for bus in part.buses if self._counts.get(bus, 0) < SPACINGS]
            found += [self._of_bus(bus, span, part.of_bus(bus).frames) for bus in wanted]
        return found

    def _of_bus(self, bus: int, span: int, frames: FrameBatch) -> Spacings:
        copied = (frames.flags & COPY) != 0
        known = self._counts.get(bus, 0)
        sent = (frames[~copied] if copied.any() else frames)[: SPACINGS - known]
        self._counts[bus] = known + len(sent)
        if not len(sent):
            return Spacings(bus, span, np.zeros(0, np.int64), np.zeros(0, np.int64))
        # A frame of the recording computer itself may be stamped when it was asked for.
        strange = (sent.flags & (FrameFlag.ERROR | FrameFlag.TX)) != 0
        bits = wire_bits(sent)
        alone = strange | (data_phase_bits(sent) > 0)
        alone[1:] |= strange[:-1]
        alone[0] |= bus not in self._last_ns
        apart_ns = np.diff(sent.t_ns, prepend=self._last_ns.get(bus, int(sent.t_ns[0])))
        if strange[-1]:
            self._last_ns.pop(bus, None)
        else:
            self._last_ns[bus] = int(sent.t_ns[-1])
        apart_ns = np.where(alone | (apart_ns < 0), _NO_SPACING, apart_ns)
        return Spacings(bus, span, apart_ns, bits)
