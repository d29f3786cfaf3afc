"""Decoded values against the bounds of conditions, column by column."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_logger.pdo_values import PdoValues
from syncline_logger.triggers.conditions import Condition, ValueTest
from syncline_logger.triggers.event import Event
from syncline_schemas.decoder import MappedObject

_COMPARE = {">": np.greater, "<": np.less, ">=": np.greater_equal, "<=": np.less_equal}
Numbers = NDArray[np.int64] | NDArray[np.uint64] | NDArray[np.float64]


@dataclass(slots=True)
class ValueWatch:
    """Tells where a value crosses a bound; values that stay beyond it are no new event.

    Runs where PDOs are decoded, in any one thread.
    """

    conditions: Sequence[Condition]
    _beyond: dict[tuple[str, int, int], bool] = field(default_factory=dict)
    _told: set[str] = field(default_factory=set)

    def update(self, pdo: PdoValues) -> tuple[list[Event], list[str]]:
        """Events of the values of one PDO, and words on conditions that can never be met."""
        events: list[Event] = []
        problems: list[str] = []
        for condition in self.conditions:
            test = condition.value
            if test is None or not self._concerns(condition, pdo.node, pdo.bus_name):
                continue
            for column in pdo.columns:
                if not _names(test, column.entry):
                    continue
                if not _fits(test, column.entry):
                    problems += self._once(condition.word, column.entry)
                    continue
                values = column.raw if test.raw else column.value
                found = self._crossed(condition, test, pdo.bus, pdo.node, values)
                if found is not None:
                    value = f"{float(values[found]):g} {column.entry.unit if not test.raw else ''}"
                    text = f"node {pdo.node}: {column.entry.name} is {value.strip()} ({condition.word})"
                    at, taken = int(pdo.t_ns[found]), int(pdo.log_ns[found])
                    events.append(
                        Event("value", at, taken, text, pdo.bus, pdo.node, condition.word)
                    )
        return events, problems

    def _crossed(
        self, condition: Condition, test: ValueTest, bus: int, node: int, values: Numbers
    ) -> int | None:
        """The first row that is beyond the bound while the one before was not."""
        if not len(values):
            return None
        key = (condition.word, bus, node)
        beyond = _COMPARE[test.than](values, test.bound)
        before = np.concatenate(([self._beyond.get(key, False)], beyond[:-1]))
        self._beyond[key] = bool(beyond[-1])
        rows = np.flatnonzero(beyond & ~before)
        return int(rows[0]) if len(rows) else None

    def _once(self, word: str, entry: MappedObject) -> list[str]:
        if word in self._told:
            return []
        self._told.add(word)
        unit = entry.unit or "no unit"
        return [f"trigger '{word}' never comes: {entry.name} has {unit}; write that, or the object"]

    @staticmethod
    def _concerns(condition: Condition, node: int, bus_name: str) -> bool:
        return condition.node in (None, node) and condition.bus in (None, bus_name)


def _names(test: ValueTest, entry: MappedObject) -> bool:
    if test.key is not None:
        return test.key == (entry.index, entry.sub)
    return _plain(test.name) in (_plain(entry.name), _plain(entry.name).split(":")[-1])


def _fits(test: ValueTest, entry: MappedObject) -> bool:
    return not test.unit or test.unit.casefold() == entry.unit.casefold()


def _plain(name: str) -> str:
    return " ".join(name.replace("_", " ").casefold().split())
