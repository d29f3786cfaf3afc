"""Why PDOs really were late or missing on a loaded bus, against what the analyzer says of it."""

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from syncline_analyzer.results import LatenessRow
from syncline_samples.loaded import PDO_BASES
from syncline_samples.loaded_truth import SentPdo
from tests.analyzer.timing_truth import SECOND_NS, Due, Measured, by_definition

_OWN = (*PDO_BASES, 0x580, 0x700)
_TOLERANCE = 1e-9


class Causes(NamedTuple):
    """How many were late, or missing, because of the device or the bus.

    `missed_by_both` are those that were never sent, where the bus may have been full meanwhile, and
    those that were ready just before the next SYNC, far later than usual.
    """

    late_by_device: int
    late_by_bus: int
    missed_by_device: int
    missed_by_bus: int
    missed_by_both: int


def causes(case: Measured, row: LatenessRow) -> Causes:
    """What really made the answers of one PDO late or missing.

    The device did where even a bus without other frames would not have made up for it.
    """
    due, syncs = by_definition(case, row.cob_id), case.last_sync
    window_ns = 1000 * (row.window_us or 0)
    late = [pdo for pdo in due.first_of.values() if _is_late(case, pdo, window_ns)]
    by_device = sum(
        pdo.seq is not None and _alone_ns(pdo, syncs[pdo.seq].end_ns) > window_ns for pdo in late
    )
    missed_by_device, missed_by_bus, both = _missed(case, row.cob_id, due)
    return Causes(by_device, len(late) - by_device, missed_by_device, missed_by_bus, both)


def _is_late(case: Measured, pdo: SentPdo, window_ns: int) -> bool:
    sync = case.last_sync[pdo.seq] if pdo.seq is not None else None
    if not window_ns or sync is None:
        return False
    return case.stamp(pdo.end_ns) - case.stamp(sync.end_ns) > window_ns


def _alone_ns(pdo: SentPdo, since_ns: int) -> int:
    """From the SYNC to the end of the frame if no other frame had been on the bus."""
    return max(pdo.asked_ns - since_ns, 0) + pdo.end_ns - pdo.start_ns


def _missed(case: Measured, can_id: int, due: Due) -> tuple[int, int, int]:
    """(by the device, by the bus, by both) of the SYNCs that went unanswered."""
    usual = case.plan_of[can_id].delay
    usual_ns = usual.base_ns + usual.jitter_ns
    answers = {pdo.sync_number: pdo for pdo in case.truth.pdos if pdo.can_id == can_id}
    syncs = case.truth.syncs
    device = bus = both = 0
    for number in due.missed:
        pdo, sync_ns = answers.get(number), syncs[number].end_ns
        if pdo is None:
            both += 1
        elif sync_ns + _alone_ns(pdo, sync_ns) > syncs[number + 1].end_ns:
            device += 1
        elif pdo.asked_ns - sync_ns > usual_ns:
            both += 1
        else:
            bus += 1
    return device, bus, both


def wrong_causes(case: Measured, row: LatenessRow) -> Iterator[str]:
    """Causes that are told more often than they are true."""
    plan = case.plan_of.get(row.cob_id)
    if plan is None or not plan.synchronous:
        return
    true = causes(case, row)
    if row.late_by_device > true.late_by_device:
        yield f"late by device, {row.cob_id:03X}h: {row.late_by_device}, but {true}"
    if row.late_by_bus > true.late_by_bus:
        yield f"late by bus, {row.cob_id:03X}h: {row.late_by_bus}, but {true}"
    if row.missed_by_device > true.missed_by_device + true.missed_by_both:
        yield f"missed by device, {row.cob_id:03X}h: {row.missed_by_device}, but {true}"
    if row.missed_by_bus > true.missed_by_bus + true.missed_by_both:
        yield f"missed by bus, {row.cob_id:03X}h: {row.missed_by_bus}, but {true}"


def wrong_delays(case: Measured) -> Iterator[str]:
    """Identifiers for which PDOs waited longer than the analyzer says they did at most."""
    told_us = {row.cob_id: row.us for row in case.analysis.delays if row.cob_id is not None}
    for can_id, waited_ns in waited_for(case).items():
        if waited_ns / 1000 > told_us.get(can_id, 0.0) + _TOLERANCE * waited_ns / 1000:
            yield f"delayed by {can_id:03X}h: {told_us.get(can_id)} us, but {waited_ns / 1000}"


def waited_for(case: Measured) -> Counter[int]:
    """How long answers really waited for the frames of each TPDO, SDO server and heartbeat [ns]."""
    waited: Counter[int] = Counter()
    bit_ns = SECOND_NS // case.plan.bitrate
    own = {base + node.node_id: node.node_id for node in case.plan.nodes for base in _OWN}
    places = {frame.seq: place for place, frame in enumerate(case.truth.frames)}
    for responses in case.analysis.responses:
        plan = case.plan_of.get(responses.cob_id)
        known = responses.seq[np.isfinite(responses.waiting_us)]
        for seq in known.tolist() if plan is not None and plan.synchronous else ():
            pdo = case.pdo_of[seq]
            asked_ns = max(pdo.asked_ns, case.last_sync[seq].end_ns)
            victim = None if pdo.can_id not in own else pdo.node
            place = places[seq] - 1
            while place >= 0 and case.truth.frames[place].end_ns + 3 * bit_ns > asked_ns:
                ahead = case.truth.frames[place]
                if own.get(ahead.can_id, victim) != victim:
                    waited[ahead.can_id] += (
                        ahead.end_ns + 3 * bit_ns - max(ahead.start_ns, asked_ns)
                    )
                place -= 1
    return waited
