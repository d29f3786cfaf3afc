"""What triggers do in a recording."""

from dataclasses import dataclass

from syncline_logger.triggers.conditions import Condition

MINUTE_NS = 60_000_000_000
BEFORE_NS = 5 * MINUTE_NS
AFTER_NS = 2 * MINUTE_NS
RING_BYTES = 100_000_000


@dataclass(frozen=True, slots=True)
class TriggerPlan:
    """Which events are marked, and what is written around them.

    Attributes:
        conditions: events that become marks.
        only: write nothing until a trigger; then what lies around it.
        before_ns, after_ns: how much of the time around a trigger is kept [ns].
        ring_bytes: memory for the time before a trigger, compressed.
    """

    conditions: tuple[Condition, ...] = ()
    only: bool = False
    before_ns: int = BEFORE_NS
    after_ns: int = AFTER_NS
    ring_bytes: int = RING_BYTES

    @property
    def values(self) -> tuple[Condition, ...]:
        """The conditions on decoded values."""
        return tuple(each for each in self.conditions if each.value is not None)
