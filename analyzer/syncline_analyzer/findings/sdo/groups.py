"""SDO transfers as rules read them: of nodes that are there, in groups, with what was going on."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator
from itertools import groupby, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.results import NmtStateRow, SdoRow, SdoTransfers
from syncline_analyzer.results.sdo_records import NONE, RESULTS, SIDES

_Node = tuple[str, int]

TIMED_OUT = 0x05040000
"""Abort code with which a client gives up waiting."""
TOGETHER_NS = 60_000_000_000
"""Events closer than this are told as one [ns]."""
MAX_EVIDENCE = 20
LISTED = 5
"""Objects that a text names one by one."""


def object_words(row: SdoRow) -> str:
    """Index, subindex and name of a transfer's object."""
    name = f" ({row.name})" if row.name else ""
    return f"{row.index or 0:04X}h:{row.sub or 0:02X}{name}"


def objects_words(rows: Iterable[SdoRow]) -> str:
    """The objects of several transfers, the first few of them."""
    named = {(row.index or 0, row.sub or 0): row.name or "" for row in rows}
    objects = [f"{i:04X}h:{sub:02X} {name}".rstrip() for (i, sub), name in sorted(named.items())]
    more = f" and {len(objects) - LISTED} more" if len(objects) > LISTED else ""
    return ", ".join(objects[:LISTED]) + more


def evidence(rows: Iterable[SdoRow]) -> list[int]:
    """`seq` of the first requests."""
    return [row.seq for row in islice(rows, MAX_EVIDENCE)]


def times(count: int) -> str:
    """How often, where it was more than once.

    >>> times(1), times(3)
    ('', ', 3 times')
    """
    return f", {count} times" if count > 1 else ""


def alike(transfers: SdoTransfers, *names: str) -> list[NDArray[np.intp]]:
    """Places of transfers that are equal in these fields of their records, by the first of each."""
    number = np.zeros(len(transfers), np.int64)
    for name in names:
        distinct, of = np.unique(transfers.records[name], return_inverse=True)
        number = number * len(distinct) + of
    order = np.argsort(number, kind="stable")
    cuts = np.flatnonzero(np.diff(number[order])) + 1
    parts = np.split(order, cuts) if len(order) else []
    return sorted(parts, key=lambda part: int(part[0]))


def grouped(rows: Iterable[SdoRow], key: Callable[[SdoRow], Any]) -> Iterator[list[SdoRow]]:
    """Transfers with equal keys, each group in order of `seq`."""
    ordered = sorted(rows, key=lambda row: (key(row), row.seq))
    for _, group in groupby(ordered, key=key):
        yield list(group)


def by_node(rows: Iterable[SdoRow]) -> Iterator[list[SdoRow]]:
    """Transfers of each node."""
    return grouped(rows, lambda row: (row.bus, row.node))


def by_object(rows: Iterable[SdoRow]) -> Iterator[list[SdoRow]]:
    """Transfers of each object, reads and writes apart."""
    return grouped(rows, lambda row: (row.bus, row.node, row.index, row.sub, row.direction))


def stretches(rows: Iterable[SdoRow], apart_ns: int = TOGETHER_NS) -> Iterator[list[SdoRow]]:
    """Transfers that follow one another within `apart_ns`."""
    part: list[SdoRow] = []
    for row in sorted(rows, key=lambda row: (row.start_ns, row.seq)):
        if part and row.start_ns - part[-1].start_ns > apart_ns:
            yield part
            part = []
        part.append(row)
    if part:
        yield part


def unanswered_of(transfers: SdoTransfers) -> SdoTransfers:
    """Requests that the server left without an answer, or that the client gave up with an abort."""
    failed = transfers.failed
    silent = failed.records["result"] == RESULTS.index("no answer")
    return failed.part(timed_out_of(failed) | silent)


def timed_out_of(transfers: SdoTransfers) -> NDArray[np.bool_]:
    """(n,) Whether the client gave up waiting, with an abort."""
    code, by = (transfers.records[name] for name in ("abort_code", "abort_by"))
    gave_up: NDArray[np.bool_] = (code == TIMED_OUT) & (by == SIDES.index("client"))
    return gave_up


class History:
    """What is known of nodes at the time of their transfers, by (bus, node)."""

    def __init__(self, facts: Facts) -> None:
        self._sdo = facts.analysis.sdo
        self._answers: dict[_Node, NDArray[np.int64]] = {}
        self._states: dict[_Node, list[NmtStateRow]] = {}
        self._restarts: dict[_Node, list[int]] = {}
        self._resets: dict[str, list[tuple[int, int]]] = {}
        self._gaps = facts.analysis.capture.gaps
        self._timed = facts.context.timed
        for state in facts.analysis.nmt_states:
            self._states.setdefault((state.bus, state.node), []).append(state)
        for boot in facts.control.nmt.boot_ups:
            self._restarts.setdefault((boot.bus, boot.node), []).append(boot.t_ns)
        for command in facts.analysis.nmt_commands:
            if command.command.startswith("reset"):
                self._resets.setdefault(command.bus, []).append((command.t_ns, command.node))
        for times_ns in self._restarts.values():
            times_ns.sort()

    def answers(self, node: _Node, start_ns: int, end_ns: int) -> int:
        """Requests of a half-open stretch of time that the node answered."""
        if node not in self._answers:
            records = self._sdo.of_node(*node).records
            answered = records["answer_ns"] != NONE if self._timed else np.zeros(0, np.intp)
            self._answers[node] = np.sort(records["start_ns"][answered])
        first, stop = np.searchsorted(self._answers[node], (start_ns, end_ns))
        return int(stop - first)

    def first_boot_ns(self, node: _Node) -> int | None:
        """Time of the first boot-up."""
        return next(iter(self._restarts.get(node, [])), None)

    def states(self, node: _Node, start_ns: int, end_ns: int) -> Iterator[str]:
        """NMT states that overlap a stretch of time, its end included."""
        rows = self._states.get(node, [])
        first = bisect_right(rows, start_ns, key=lambda row: row.end_ns)
        for row in rows[first:]:
            if row.start_ns > end_ns:
                return
            yield row.state

    def undisturbed(self, node: _Node, start_ns: int, end_ns: int) -> bool:
        """Whether a node was neither reset nor lost in between, nor the recorder blind."""
        bus, number = node
        blind = any(
            gap.bus in (None, bus) and gap.start_ns < end_ns and start_ns < gap.end_ns
            for gap in self._gaps
        )
        boots = self._restarts.get(node, [])
        booted = bisect_right(boots, end_ns) > bisect_left(boots, start_ns)
        reset = any(
            start_ns <= t_ns <= end_ns and to in (0, number)
            for t_ns, to in self._resets.get(bus, [])
        )
        away = {"LOST", "INITIALISING"} & set(self.states(node, start_ns, end_ns))
        return not (blind or booted or reset or away)
