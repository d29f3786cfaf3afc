"""Triggers beside the analysis of the same frames: what one tells and the other does not."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from syncline_analyzer.results import Analysis
from syncline_logger.triggers.conditions import parse_conditions
from syncline_logger.triggers.event import Event
from syncline_logger.triggers.watch import TriggerWatch
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.description import BusDescription

S = 1_000_000_000
PERIOD_NS = 900_000_000
WORDS = ("emcy", "node-lost", "boot-up", "sdo-abort")
KNOWN_AFTER_NS = 11 * S
"""A loss is known when the node can no longer come back by a restart, and the next chunk is due."""
LOST = ("nmt.node_lost", "nmt.no_boot_up")
ALSO_LOST = ("error.bus_off", "error.node_bus_off", "emcy.bus_off", "nmt.heartbeat_waited")
RESTARTED = ("nmt.unexpected_reset", "nmt.boot_loop")


@dataclass(frozen=True)
class Told:
    """What the analysis tells of one kind, bus and node, in a stretch of time.

    `needed`: a trigger must tell it; else it may.
    """

    kind: str
    bus: str | None
    node: int | None
    detail: int | None
    start_ns: int
    end_ns: int
    needed: bool = True

    def is_of(self, event: Event, bus: str | None) -> bool:
        """Whether a trigger tells the same."""
        same = (event.kind, bus, event.node) == (self.kind, self.bus, self.node)
        detail = self.detail is None or event.detail == self.detail
        return same and detail and self.start_ns <= event.t_ns <= self.end_ns


def events_of(
    items: Iterable[FrameBatch | Gap], buses: Sequence[str], description: BusDescription
) -> list[Event]:
    """All events, in chunks as a recorder would take the frames."""
    seen: list[Event] = []

    class Watch(TriggerWatch):
        def _take(self, event: Event) -> None:
            seen.append(event)

    watch = Watch(parse_conditions(WORDS), buses, description)
    now_ns = 0
    for item in items:
        if isinstance(item, Gap):
            now_ns = max(now_ns, item.end_ns)
            watch.gap(item, now_ns)
        elif len(item):
            log_ns = np.maximum.accumulate(np.maximum(item.t_ns, now_ns))
            now_ns = int(log_ns[-1])
            ends = np.arange(int(log_ns[0]) + PERIOD_NS, now_ns + PERIOD_NS, PERIOD_NS)
            cuts = [0, *np.searchsorted(log_ns, ends).tolist(), len(item)]
            for begin, end in itertools.pairwise(cuts):
                if end > begin:
                    watch.update(item[begin:end], log_ns[begin:end])
    watch.finish(now_ns)
    return seen


def told_by(analysis: Analysis) -> list[Told]:
    """What triggers should tell too: errors raised, aborts, losses, restarts."""
    told = [
        Told("emcy", row.bus, row.node, row.code, row.raised_ns, row.raised_ns)
        for row in analysis.errors
    ]
    told += [
        Told("sdo-abort", row.bus, row.node, row.abort_code, row.start_ns, row.end_ns)
        for row in analysis.sdo
        if row.result == "abort"
    ]
    for finding in analysis.findings:
        stretch = finding.start_ns, finding.end_ns
        who = finding.bus, finding.node, None
        if finding.id in LOST:
            told.append(Told("node-lost", *who, *stretch))
        elif finding.id in RESTARTED:
            told.append(Told("boot-up", *who, *stretch))
        elif finding.node is not None and finding.id in ALSO_LOST:
            told.append(Told("node-lost", *who, *stretch, needed=False))
    told += [
        Told("node-lost", row.bus, row.node, None, row.start_ns, row.end_ns, needed=False)
        for row in analysis.nmt_states
        if row.state == "LOST"
    ]
    return told


def differences(
    items: Iterable[FrameBatch | Gap],
    analysis: Analysis,
    buses: Sequence[str],
    description: BusDescription,
) -> list[str]:
    """Words for each event that only one of them tells; several of one finding are one."""
    events = events_of(items, buses, description)
    told = told_by(analysis)
    found = []
    missing = [each for each in told if each.needed]
    for event in events:
        bus = buses[event.bus] if event.bus is not None else None
        alike = [each for each in told if each.is_of(event, bus)]
        if not alike:
            found.append(f"only a trigger: {event.kind} of node {event.node}")
        missing = [each for each in missing if each not in alike]
        if not 0 <= event.log_ns - event.t_ns <= KNOWN_AFTER_NS:
            found.append(f"known after {event.log_ns - event.t_ns} ns: {event.text}")
    return found + [f"only the analysis: {each.kind} of node {each.node}" for each in missing]
