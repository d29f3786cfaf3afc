"""Stretches without samples in which nobody knows what the shaft did."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.samples import SDO_SOURCE
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_analyzer.shadow import Shadow
from syncline_schemas.devices import quirks
from syncline_schemas.records import dataclass

LEAST_NS = 500_000_000
"""A shorter silence is none."""
TIMES = 5.0
"""So many times the usual time between samples."""
LEARNED = 16
"""Times between samples from which the usual one is taken."""
REPEATED = 50
"""Equal samples in a row: who sends them sends at standstill, too."""
_ACYCLIC = 0
_BY_TIMER = (0xFE, 0xFF)


@dataclass(slots=True)
class Pauses:
    """The usual time between the samples of a trace, and the silences beyond it."""

    _last_ns: int | None = None
    _spans: list[int] = field(default_factory=list)
    _raw: int | None = None
    _run: int = 0
    _longest: int = 0

    @property
    def repeats(self) -> bool:
        """Whether the trace goes on while its value stands."""
        return self._longest >= REPEATED

    def compare(self, raw: NDArray[np.int64]) -> None:
        """Count how often one value (n,) came in a row."""
        edges = np.flatnonzero(np.diff(raw)) + 1
        runs = np.diff(np.concatenate(([0], edges, [len(raw)])))
        if self._raw == int(raw[0]):
            runs[0] += self._run
        self._raw, self._run = int(raw[-1]), int(runs[-1])
        self._longest = max(self._longest, int(runs.max()))

    def cut(self) -> None:
        """What comes next does not go on from here."""
        self._last_ns = None

    def silent(self, t_ns: NDArray[np.int64]) -> list[tuple[int, int]]:
        """(row, length [ns]) of the samples (n,) that come after a silence.

        After each the usual time is learned anew: the rhythm may be another one.
        """
        before = [] if self._last_ns is None else [self._last_ns]
        # An empty list alone would be one of floats, which hold no ns of today.
        spans = np.diff(np.concatenate((np.array(before, np.int64), t_ns)))
        offset = len(t_ns) - len(spans)
        self._last_ns = int(t_ns[-1])
        found: list[tuple[int, int]] = []
        begin = 0
        while begin < len(spans):
            wanted = LEARNED - len(self._spans)
            learned = spans[begin : begin + wanted]
            self._spans += learned[learned >= 0].tolist()
            begin += max(wanted, 0)
            if len(self._spans) < LEARNED or begin >= len(spans):
                continue
            # One silence among those that are learned must not make silence usual.
            usual_ns = sum(sorted(self._spans)[:-1]) / (LEARNED - 1)
            limit_ns = round(max(LEAST_NS, TIMES * usual_ns))
            long = np.flatnonzero(spans[begin:] > limit_ns)
            if not len(long):
                break
            at = begin + int(long[0])
            found.append((at + offset, int(spans[at])))
            self._spans.clear()
            begin = at + 1
        return found


def held_by_design(
    shadow: Shadow, bindings: PdoBindings, bus: int, source: int, seq: int
) -> bool | None:
    """Whether a source is silent while its value stands; None where its settings are not known.

    So it is with a repeat counter, with transmission type 0, and with an event-driven PDO without
    event timer (CiA 301 7.5.2.37; the device sheets on 2800h).
    """
    owner = None if source == SDO_SOURCE else bindings.owner(bus, source, seq)
    if owner is None:
        return None
    index = 0x17FF + owner.number
    counter = quirks(shadow.device(bus, owner.node)).repeat_counters.get(owner.number)
    if counter is not None and shadow.confirmed(bus, owner.node, *counter, seq):
        return True
    kind = shadow.confirmed(bus, owner.node, index, 2, seq)
    if kind == _ACYCLIC:
        return True
    timer = shadow.confirmed(bus, owner.node, index, 5, seq)
    if kind in _BY_TIMER:
        return None if timer is None else timer == 0
    return None if kind is None else False
