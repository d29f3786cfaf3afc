"""Late answers of a PDO that frames of others explain, and which frames these were."""

from collections.abc import Callable
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import Ahead
from syncline_schemas.records import dataclass

MAX_KEPT = 1000
"""Late answers of a PDO of which the frames ahead are kept."""

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(slots=True)
class LateBehind:
    """Late answers that would have been in time without the frames of others ahead of them.

    Attributes:
        total: how many there were.
        kept: how many of them are known one by one, the first `MAX_KEPT`.
    """

    total: int = 0
    kept: int = 0
    _over_ns: list[Floats] = field(default_factory=list)
    _answer: list[Ints] = field(default_factory=list)
    _name: list[Ints] = field(default_factory=list)
    _ns: list[Floats] = field(default_factory=list)
    _names: list[Ahead] = field(default_factory=list)
    _place: dict[tuple[int, int | None, str], int] = field(default_factory=dict)

    def add(
        self, over_ns: Floats, answer: Ints, place: Ints, ns: Floats, named: Callable[[int], Ahead]
    ) -> None:
        """Take in more of them.

        Args:
            over_ns: (k,) by how much each answer was late.
            answer: (a,) of each frame of others ahead, which of these it kept waiting; ascending.
            place, ns: (a,) its identifier, as `named` knows it, and its time on the wire.
            named: identifier, node and service of a place.
        """
        self.total += len(over_ns)
        room = MAX_KEPT - self.kept
        if room <= 0:
            return
        stop = int(np.searchsorted(answer, room))
        places, inverse = np.unique(place[:stop], return_inverse=True)
        names = np.array([self._number(named(at)) for at in places.tolist()], np.int64)
        self._over_ns.append(over_ns[:room])
        self._answer.append(answer[:stop] + self.kept)
        self._name.append(names[inverse])
        self._ns.append(ns[:stop])
        self.kept += min(len(over_ns), room)

    def without(self, chosen: Callable[[Ahead], bool]) -> tuple[int, list[Ahead]]:
        """How many of the answers would have been in time without the frames of some identifiers.

        Returns: their number, and those frames ahead of them by identifier, the longest first.
        """
        picked = np.array([chosen(each) for each in self._names], np.bool_)
        if not picked.any():
            return 0, []
        answer, name = np.concatenate(self._answer), np.concatenate(self._name)
        ns, over_ns = np.concatenate(self._ns), np.concatenate(self._over_ns)
        rows = picked[name]
        in_time = np.bincount(answer[rows], ns[rows], minlength=len(over_ns)) >= over_ns
        rows &= in_time[answer]
        frames = np.bincount(name[rows], minlength=len(picked)).tolist()
        us = (np.bincount(name[rows], ns[rows], minlength=len(picked)) / 1000).tolist()
        found = [
            Ahead(each.cob_id, each.node, each.service, frames[at], us[at], [])
            for at, each in enumerate(self._names)
            if frames[at]
        ]
        return int(np.count_nonzero(in_time)), sorted(found, key=lambda each: -each.us)

    def _number(self, name: Ahead) -> int:
        key = (name.cob_id, name.node, name.service)
        if key not in self._place:
            self._place[key] = len(self._names)
            self._names.append(name)
        return self._place[key]
