"""A bus on paper: requests to send, and what arbitration makes of them; written for the tests."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from syncline_analyzer.folds.timing.waiting import Arbitration, noise_of

BIT_NS = 2000
"""500 kbit/s."""


@dataclass(frozen=True, slots=True)
class Request:
    """A frame that its node wants to send from a moment on; `bits` with intermission."""

    ready_ns: int
    can_id: int
    node: int
    bits: int = 111


@dataclass(frozen=True, slots=True)
class Sent:
    """A frame on the wire."""

    request: Request
    start_ns: int
    end_ns: int


@dataclass(slots=True)
class Line:
    """The nodes named in `in_turn` put one frame after the other into arbitration."""

    requests: Iterable[Request]
    in_turn: frozenset[int] = frozenset()
    bit_ns: int = BIT_NS
    sent: list[Sent] = field(default_factory=list)

    def run(self) -> list[Sent]:
        """The frames in the order of the wire."""
        waiting = sorted(self.requests, key=lambda each: each.ready_ns)
        now = 0
        while waiting:
            now = max(now, waiting[0].ready_ns)
            ready = [each for each in waiting if each.ready_ns <= now]
            heads = [
                each
                for place, each in enumerate(ready)
                if each.node not in self.in_turn
                or all(other.node != each.node for other in ready[:place])
            ]
            winner = min(heads, key=lambda each: each.can_id)
            waiting.remove(winner)
            end = now + (winner.bits - 3) * self.bit_ns
            self.sent.append(Sent(winner, now, end))
            now = end + 3 * self.bit_ns
        return self.sent


def seen(sent: Sequence[Sent], *, step_ns: int = 1, bit_ns: int = BIT_NS) -> Arbitration:
    """What a recorder with stamps of this step makes of the frames."""
    return arbitration(
        [each.end_ns // step_ns * step_ns for each in sent], sent, step_ns=step_ns, bit_ns=bit_ns
    )


def arbitration(
    stamps: Sequence[int], sent: Sequence[Sent], *, step_ns: int = 1, bit_ns: int = BIT_NS
) -> Arbitration:
    """The frames under other stamps."""
    requests = [each.request for each in sent]
    t_ns = np.array(stamps, np.int64)
    wire_ns = np.array([each.bits * bit_ns for each in requests], np.float64)
    return Arbitration(
        t_ns,
        wire_ns,
        np.array([each.can_id << 21 for each in requests], np.int64),
        np.array([each.node for each in requests], np.int16),
        bit_ns=bit_ns,
        resolution_ns=step_ns,
        noise_ns=noise_of(t_ns, wire_ns, bit_ns=bit_ns, resolution_ns=step_ns),
    )
