"""SDO transfers as rules read them: of nodes that are there, in groups, with what was going on."""

from collections.abc import Callable, Iterable, Iterator
from itertools import groupby
from typing import Any

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.findings.stretch import Stretch
from syncline_analyzer.results import SdoRow

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
    objects = sorted({object_words(row) for row in rows})
    return ", ".join(objects[:LISTED]) + (" ..." if len(objects) > LISTED else "")


def evidence(rows: Iterable[SdoRow]) -> list[int]:
    """`seq` of the first requests."""
    return [row.seq for row in rows][:MAX_EVIDENCE]


def times(count: int) -> str:
    """How often, where it was more than once.

    >>> times(1), times(3)
    ('', ', 3 times')
    """
    return f", {count} times" if count > 1 else ""


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


def stretches(rows: list[SdoRow], apart_ns: int = TOGETHER_NS) -> Iterator[list[SdoRow]]:
    """Transfers that follow one another within `apart_ns`."""
    for start, end in Stretch.of([row.start_ns for row in rows], apart_ns):
        yield [row for row in rows if start <= row.start_ns <= end]


def timed_out(row: SdoRow) -> bool:
    """Whether the client gave up waiting, with an abort."""
    return row.abort_code == TIMED_OUT and row.abort_by == "client"


def unanswered(row: SdoRow) -> bool:
    """Whether the server left a request without an answer."""
    return row.result == "no answer" or timed_out(row)


def state_at(facts: Facts, bus: str, node: int, t_ns: int) -> str | None:
    """NMT state of a node at a moment, None where nothing tells it."""
    for row in facts.analysis.nmt_states:
        if row.bus == bus and row.node == node and row.start_ns <= t_ns < row.end_ns:
            return row.state
    return None


def undisturbed(facts: Facts, bus: str, node: int, start_ns: int, end_ns: int) -> bool:
    """Whether a node was neither reset nor lost in between, nor the recorder blind."""
    analysis = facts.analysis
    if any(
        gap.bus in (None, bus) and gap.start_ns < end_ns and start_ns < gap.end_ns
        for gap in analysis.capture.gaps
    ):
        return False
    if any(
        boot.bus == bus and boot.node == node and start_ns <= boot.t_ns <= end_ns
        for boot in facts.control.nmt.boot_ups
    ):
        return False
    if any(
        command.bus == bus
        and command.node in (0, node)
        and command.command.startswith("reset")
        and start_ns <= command.t_ns <= end_ns
        for command in analysis.nmt_commands
    ):
        return False
    return not any(
        row.bus == bus
        and row.node == node
        and row.state in ("LOST", "INITIALISING")
        and row.start_ns < end_ns
        and start_ns < row.end_ns
        for row in analysis.nmt_states
    )
