"""Stretches without SYNC, told from those in which it may have been there."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from syncline_analyzer.capture import Unread
from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.held import held
from syncline_analyzer.folds.timing.silence import Silence
from syncline_analyzer.folds.timing.sync_settings import PERIOD, producers
from syncline_analyzer.folds.timing.sync_state import SyncHole
from syncline_analyzer.folds.timing.sync_table import SyncTable
from syncline_analyzer.results import HoleRow, NmtCommandRow, NmtStateRow, SyncRow
from syncline_analyzer.service_ids import SYNC

MAX_HOLES = 1000
LONG_HOLE_NS = 1_000_000_000
"""A stretch without SYNC as long as a node's restart."""


def judged(
    context: Context,
    table: SyncTable,
    nmt_states: Sequence[NmtStateRow],
    silences: Sequence[Silence],
    commands: Sequence[NmtCommandRow],
    unread: Sequence[Unread],
) -> SyncTable:
    """The table without the holes in which the producer itself may have been off, or unheard."""
    bus = table.row.bus
    off = [
        row
        for row in nmt_states
        if row.bus == bus and row.state in ("LOST", "INITIALISING", "UNKNOWN")
    ]
    mine = [command for command in commands if command.bus == bus]
    period_ns = table.row.period_us.median * 1000 if table.row.period_us else 0.0
    holes = [
        hole
        for hole in table.holes
        if not _explained(hole, off)
        and not _unheard(hole, silences)
        and not held(hole, mine, period_ns)
        and not _switched_off(context, table.row, hole, period_ns)
        and hole.missing > _unread_within(hole, unread)
    ]
    missing = (
        table.row.missing - sum(h.missing for h in table.holes) + sum(h.missing for h in holes)
    )
    return replace(table, row=replace(table.row, missing=missing), holes=holes)


def _switched_off(context: Context, row: SyncRow, hole: SyncHole, period_ns: float) -> bool:
    """Whether a client switched the producer off just then (1005h bit 30, or 1006h = 0)."""
    shadow, bus = context.shadow, context.buses.index(row.bus)
    earliest_ns = hole.start_ns - 2 * period_ns
    for node, index in product(shadow.nodes_of(bus), (SYNC, PERIOD)):
        for seq in shadow.changes(bus, node, index):
            known = shadow.get(bus, node, index, 0, seq)
            if known is None or known.source != "sdo-write" or known.t_ns is None:
                continue
            if not earliest_ns <= known.t_ns <= hole.end_ns:
                continue
            sends = bool(known.value) and node in producers(shadow, bus, row.cob_id, seq)
            if not sends and node in producers(shadow, bus, row.cob_id, seq - 1):
                return True
    return False


def _explained(hole: SyncHole, off: Sequence[NmtStateRow]) -> bool:
    """Whether a node was off for most of a long hole, or nobody at all was heard: the NMT tells it.

    Only an UNKNOWN that begins within the hole comes from a silence of the whole bus.
    """
    length = hole.end_ns - hole.start_ns
    return length >= LONG_HOLE_NS and any(
        2 * (min(row.end_ns, hole.end_ns) - max(row.start_ns, hole.start_ns)) > length
        and (row.state != "UNKNOWN" or row.start_ns > hole.start_ns)
        for row in off
    )


def _unread_within(hole: SyncHole, unread: Sequence[Unread]) -> int:
    """How many lines of the log could not be read around a hole."""
    return sum(
        each.lines
        for each in unread
        if each.start_ns <= hole.end_ns and hole.start_ns <= each.end_ns
    )


def _unheard(hole: SyncHole, silences: Sequence[Silence]) -> bool:
    """Whether nothing at all was heard of the bus for most of a hole."""
    length = hole.end_ns - hole.start_ns
    return any(
        2 * (min(each.end_ns, hole.end_ns) - max(each.start_ns, hole.start_ns)) > length
        for each in silences
    )


def sync_holes(table: SyncTable) -> list[HoleRow]:
    row = table.row
    return [
        HoleRow(row.bus, row.cob_id, "sync", h.start_ns, h.end_ns, h.missing, list(h.seq))
        for h in table.holes[:MAX_HOLES]
    ]
