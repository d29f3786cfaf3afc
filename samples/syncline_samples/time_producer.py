"""A TIME producer (CiA 301 7.2.6): TIME_OF_DAY on 100h."""

from functools import partial

from syncline_samples.bus import Frame
from syncline_samples.truth import TimeTruth
from syncline_samples.world import World

_FIRST_DAY_NS = 441_763_200_000_000_000
"""1984-01-01 00:00 UTC."""
_DAY_MS = 86_400_000
_MS = 1_000_000


class TimeProducer:
    """Tells the time again and again, by a clock that may be wrong.

    Attributes:
        offset_ns: how much its clock is ahead.
    """

    def __init__(self, world: World, every_ns: int, offset_ns: int = 0) -> None:
        self._world = world
        self._every_ns = every_ns
        self.offset_ns = offset_ns
        self.running = True

    def start(self) -> None:
        """Begin now."""
        self._world.simulation.at(self._world.simulation.now_ns + self._every_ns, self.start)
        if not self.running:
            return
        now_ns = self._world.utc_ns(self._world.simulation.now_ns) + self.offset_ns
        days, ms = divmod((now_ns - _FIRST_DAY_NS) // _MS, _DAY_MS)
        told_ns = (days * _DAY_MS + ms) * _MS + _FIRST_DAY_NS
        data = ms.to_bytes(4, "little") + days.to_bytes(2, "little")
        self._world.bus.send(Frame(0x100, data), self, partial(self._sent, told_ns))

    def _sent(self, told_ns: int, t_ns: int) -> None:
        self._world.truth.time.append(TimeTruth(self._world.utc_ns(t_ns), told_ns))
        self._world.truth.count("time", 0)
