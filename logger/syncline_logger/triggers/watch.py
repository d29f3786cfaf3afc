"""Waiting for what somebody wants to be told: frames, gaps and bus states in, triggers out."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_logger.triggers.bus_watch import BusWatch
from syncline_logger.triggers.conditions import Condition
from syncline_logger.triggers.event import Event, Trigger
from syncline_logger.triggers.hold_off import HOLD_OFF_NS, HoldOff
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.gap_message import DID_NOT_RUN
from syncline_schemas.description import BusDescription

_OF_FRAMES = ("emcy", "node-lost", "boot-up", "nmt", "sdo-abort")


class TriggerWatch:
    """Pure state machine; what is known later than it happened has a later `log_ns`.

    Args:
        conditions: what to wait for; with none only `ask` triggers.
        buses: names by bus number.
        hold_off_ns: the same event is counted, not told, so soon after the last one.
    """

    def __init__(
        self,
        conditions: Sequence[Condition],
        buses: Sequence[str],
        description: BusDescription | None = None,
        hold_off_ns: int = HOLD_OFF_NS,
    ) -> None:
        self._conditions = tuple(conditions)
        self._names = list(buses)
        known = description or BusDescription()
        follows = any(each.kind in _OF_FRAMES for each in self._conditions)
        self._buses = (
            {n: BusWatch(n, known.described(name)) for n, name in enumerate(buses)}
            if follows
            else {}
        )
        self._hold_off = HoldOff(hold_off_ns)
        self._gaps: list[Gap] = []
        self._found: list[Trigger] = []

    def update(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> None:
        """Take in frames of all buses; log_ns: (n,) int64, never decreasing."""
        gaps, self._gaps = self._gaps, []
        for number, watch in self._buses.items():
            rows = np.flatnonzero(frames.bus == number)
            own = [gap for gap in gaps if gap.bus in (None, number)]
            for part in _between(frames.t_ns[rows], own):
                if part is None:
                    watch.gap()
                elif len(part):
                    self.events(watch.update(frames[rows[part]], log_ns[rows[part]]))

    def gap(self, gap: Gap, log_ns: int) -> None:
        """Take in a stretch in which nothing was heard; it is told before the frames after it."""
        if self._buses:
            self._gaps.append(gap)
        if gap.reason != DID_NOT_RUN:
            lost = f", {gap.lost_frames} frames lost" if gap.lost_frames else ""
            text = f"gap of {(gap.end_ns - gap.start_ns) / 1e9:.3f} s: {gap.reason}{lost}"
            self.events([Event("gap", gap.start_ns, log_ns, text, gap.bus, None, gap.reason)])

    def bus_state(self, bus: int, state: str, log_ns: int) -> None:
        """Take in a new state of a bus's controller."""
        if state == "off":
            text = f"{self._name(bus)}: the controller is bus-off"
            self.events([Event("bus-off", log_ns, log_ns, text, bus)])

    def ask(self, text: str, log_ns: int) -> None:
        """Somebody asks for a trigger."""
        self._take(Event("asked", log_ns, log_ns, text))

    def events(self, events: Iterable[Event]) -> None:
        """Take those that somebody waits for."""
        for event in events:
            if any(each.takes(event, self._name(event.bus)) for each in self._conditions):
                self._take(event)

    def finish(self, log_ns: int) -> None:
        """The end: what only it makes sure."""
        self.update(FrameBatch.empty(), np.zeros(0, np.int64))
        for watch in self._buses.values():
            self.events(watch.finish(log_ns))

    def take(self) -> list[Trigger]:
        """The triggers since the last call, in the order in which they became known."""
        found, self._found = self._found, []
        return found

    def uncounted(self) -> list[str]:
        """Words on repetitions that no trigger told."""
        return list(self._hold_off.rest())

    def _take(self, event: Event) -> None:
        trigger = self._hold_off.take(event)
        if trigger is not None:
            self._found.append(trigger)

    def _name(self, bus: int | None) -> str | None:
        return self._names[bus] if bus is not None and bus < len(self._names) else None


def _between(t_ns: NDArray[np.int64], gaps: Sequence[Gap]) -> Iterator[NDArray[np.intp] | None]:
    """Rows before, between and after gaps; None stands for each gap."""
    rows, begin = np.arange(len(t_ns)), 0
    for gap in sorted(gaps, key=lambda each: each.end_ns):
        after = np.flatnonzero(t_ns[begin:] >= gap.end_ns)
        end = begin + int(after[0]) if len(after) else len(t_ns)
        yield rows[begin:end]
        yield None
        begin = end
    yield rows[begin:]
