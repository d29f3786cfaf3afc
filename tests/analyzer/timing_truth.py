"""Loaded buses with their truth, what the analyzer makes of them, and what is wrong with that.

What to expect is computed here from the truth and the definitions of PDO timing alone: by loops over
frames, with no help of the analyzer's code.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.engine import analyze
from syncline_analyzer.results import Analysis, PdoRow, Responses
from syncline_samples.loaded import LoadedBus, LoadedPdo
from syncline_samples.loaded_run import SYNC_ID, run_loaded
from syncline_samples.loaded_truth import LoadedTruth, SentFrame, SentPdo
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.description import BusDescription

SECOND_NS = 1_000_000_000
SETTLE_NS = 20_000_000
"""After a node began to work, nothing is missed for so long."""
ROUNDING_US = 1e-3
MAX_TOLD = 100
"""SYNCs without an answer of which the analyzer lists each one."""


@dataclass(frozen=True)
class Measured:
    """A loaded bus, its truth, and the analysis of what was recorded."""

    plan: LoadedBus
    truth: LoadedTruth
    batches: list[FrameBatch | Gap]
    analysis: Analysis

    @cached_property
    def recorded(self) -> list[SentFrame]:
        """The data frames that the recorder took."""
        return [frame for frame in self.truth.frames if frame.seq is not None]

    @cached_property
    def pdo_of(self) -> dict[int, SentPdo]:
        """PDOs by their `seq`."""
        return {pdo.seq: pdo for pdo in self.truth.pdos if pdo.seq is not None}

    @cached_property
    def plan_of(self) -> dict[int, LoadedPdo]:
        """Plans by identifier."""
        return {pdo.can_id: pdo for pdo in self.plan.pdos}

    @cached_property
    def rows(self) -> dict[int, PdoRow]:
        """The analyzer's rows by identifier."""
        return {row.cob_id: row for row in self.analysis.pdos}

    @cached_property
    def last_sync(self) -> dict[int, SentFrame]:
        """The last SYNC before each recorded frame, by its `seq`."""
        found: dict[int, SentFrame] = {}
        sync = None
        for frame in self.recorded:
            if frame.can_id == SYNC_ID:
                sync = frame
            elif sync is not None and frame.seq is not None:
                found[frame.seq] = sync
        return found

    @property
    def load(self) -> float:
        """True share of the time in which the bus was busy while all nodes were at work, 0..1."""
        sent = [f for f in self.truth.frames if f.start_ns >= self.truth.started_ns]
        passed_ns = self.truth.frames[-1].end_ns - self.truth.started_ns
        return sum(frame.bits for frame in sent) * SECOND_NS / self.plan.bitrate / passed_ns

    @cached_property
    def usual_period_ns(self) -> float:
        """Median SYNC period."""
        times = [frame.end_ns for frame in self.truth.syncs]
        return median(later - earlier for earlier, later in pairwise(times))

    @cached_property
    def steady(self) -> bool:
        """Whether each SYNC period is a single one: where SYNC waits, one may have been lost."""
        times = [self.stamp(frame.end_ns) for frame in self.truth.syncs]
        shares = [(b - a) / self.usual_period_ns for a, b in pairwise(times)]
        return all(0.5 < share < 1.5 for share in shares)

    def stamp(self, t_ns: int) -> int:
        """What the recorder makes of a time."""
        return t_ns // self.plan.stamp_resolution_ns * self.plan.stamp_resolution_ns


def measured(plan: LoadedBus, *, bitrate_known: bool = True) -> Measured:
    """Let a loaded bus run, and analyze what was recorded."""
    run = run_loaded(plan)
    bitrates = {plan.name: plan.bitrate} if bitrate_known else {}
    analysis = analyzed(
        run.batches, [plan.name], plan.description_toml, plan.stamp_resolution_ns, bitrates
    )
    return Measured(plan, run.truth, run.batches, analysis)


def analyzed(
    batches: list[FrameBatch | Gap],
    buses: list[str],
    description_toml: str,
    resolution_ns: int,
    bitrates: dict[str, int],
) -> Analysis:
    """The analysis of what was recorded."""
    facts = CaptureFacts(Path("loaded.log"), "test", buses)
    facts.resolution_ns = resolution_ns
    facts.bitrates = bitrates
    return analyze(
        _numbered(batches),
        [facts],
        buses,
        description=BusDescription.loads(description_toml),
        devices={},
    )


def _numbered(batches: list[FrameBatch | Gap]) -> Iterator[tuple[int, FrameBatch | Gap]]:
    seq = 0
    for item in batches:
        yield seq, item
        seq += len(item) if isinstance(item, FrameBatch) else 0


class Due(NamedTuple):
    """What the definitions say of one synchronous PDO: numbers of SYNCs, and counts."""

    first_of: dict[int, SentPdo]
    """By number of the SYNC, the first PDO after it."""
    extra: int
    missed: list[int]


def by_definition(case: Measured, can_id: int) -> Due:
    """Which SYNCs got an answer before the next one, which due ones did not, and second answers.

    The phase of every n-th is that of the last answer, as nothing but the answers tells it.
    """
    first_of: dict[int, SentPdo] = {}
    extra, number, last_seen = 0, -1, -1
    syncs: list[SentFrame] = []
    for frame in case.truth.frames:
        if frame.can_id == SYNC_ID:
            syncs.append(frame)
            number = len(syncs) - 1
            last_seen = number if frame.seq is not None else -1
        elif frame.can_id == can_id and frame.seq is not None and last_seen >= 0:
            extra += number in first_of
            first_of.setdefault(number, case.pdo_of[frame.seq])
    return Due(first_of, extra, _missed(case, sorted(first_of), case.plan_of[can_id].kind))


def _missed(case: Measured, answered: list[int], every: int) -> list[int]:
    """Numbers of the due SYNCs between two answers, and after the last one."""
    syncs = case.truth.syncs
    ends = [*answered[1:], len(syncs) - 1] if answered else []
    found: list[int] = []
    for number, end in zip(answered, ends, strict=True):
        for due in range(number + every, end, every):
            if all(syncs[k].seq is not None for k in range(number, due + 2)):
                found.append(due)
    return found


def wrong(case: Measured) -> Iterator[str]:
    """What is wrong with the analysis, one line each."""
    yield from wrong_load(case)
    yield from wrong_syncs(case)
    for responses in case.analysis.responses:
        yield from wrong_bounds(case, responses)
        yield from wrong_waiting(case, responses)
    for can_id in case.plan_of:
        yield from wrong_counts(case, can_id)


def wrong_bounds(case: Measured, responses: Responses) -> Iterator[str]:
    """Responses that are not the time since the last SYNC, or bounds that miss the truth."""
    last_sync = case.last_sync
    plan = case.plan_of.get(responses.cob_id)
    if plan is None or not plan.synchronous:
        return
    columns = (responses.seq, responses.response_us)
    bounds = (responses.device_low_us, responses.device_high_us)
    for seq, response, low, high in zip(*columns, *bounds, strict=True):
        pdo, sync = case.pdo_of[int(seq)], last_sync[int(seq)]
        expected_us = (case.stamp(pdo.end_ns) - case.stamp(sync.end_ns)) / 1000
        if abs(response - expected_us) > ROUNDING_US:
            yield f"{responses.cob_id:03X}h seq {seq}: response {response}, not {expected_us}"
        for name, t_ns in (("ready", pdo.ready_ns), ("asked", pdo.asked_ns)):
            true_us = max(t_ns - sync.end_ns, 0) / 1000
            if not low - ROUNDING_US <= true_us <= high + ROUNDING_US:
                yield (
                    f"{responses.cob_id:03X}h seq {seq}: {name} after {true_us} us, not within"
                    f" {low}..{high}"
                )


def wrong_waiting(case: Measured, responses: Responses) -> Iterator[str]:
    """Bounds by arbitration that miss when the sender began to take part in it."""
    syncs = case.last_sync
    plan = case.plan_of.get(responses.cob_id)
    if plan is None or not plan.synchronous:
        return
    columns = (responses.device_least_us, responses.waiting_us, responses.device_low_us)
    for seq, least, waiting, low in zip(responses.seq, *columns, strict=True):
        if math.isnan(least):
            continue
        pdo, sync = case.pdo_of[int(seq)], syncs[int(seq)]
        asked_ns = max(pdo.asked_ns, sync.end_ns)
        true_us, waited_us = (asked_ns - sync.end_ns) / 1000, (pdo.start_ns - asked_ns) / 1000
        place = f"{responses.cob_id:03X}h seq {seq}"
        if least > true_us + ROUNDING_US:
            yield f"least of {place}: {least} us, but asked after {true_us}"
        if waiting < waited_us - ROUNDING_US:
            yield f"waiting of {place}: {waiting} us at most, but waited {waited_us}"
        if least < low - ROUNDING_US:
            yield f"least of {place}: {least} us, below {low}"


def wrong_counts(case: Measured, can_id: int) -> Iterator[str]:
    """Counts of a PDO that are not those of the definitions; only where its type is told."""
    plan, row = case.plan_of[can_id], case.rows.get(can_id)
    if row is None:
        if any(frame.can_id == can_id for frame in case.recorded):
            yield f"{can_id:03X}h has no row"
        return
    if not plan.synchronous:
        yield from _wrong_others(case, plan, row)
    elif case.plan.told != "nothing" and not plan.sent_by_master:
        yield from _wrong_answers(case, row)
    elif row.type_source.startswith("inferred") and row.transmission_type not in (None, plan.kind):
        yield f"inferred type of {can_id:03X}h: {row.transmission_type}, not {plan.kind}"


def _wrong_others(case: Measured, plan: LoadedPdo, row: PdoRow) -> Iterator[str]:
    kind = row.transmission_type
    if plan.cyclic and not plan.period_ns % (1000 * case.plan.sync_us):
        return  # A timer of n SYNC periods looks the same.
    if kind is not None and kind <= 0xF0:
        yield (
            f"no answer to SYNC: {row.cob_id:03X}h, but told to be of type {kind}"
            f" ({row.type_source}), cyclic {plan.cyclic} {plan.period_ns}"
        )
    unsent = sum(each.can_id == row.cob_id for each in case.truth.unsent)
    # Where some are late and some not sent, none of the two can be told from the other exactly.
    if row.missed > unsent + unsent // 4 + bool(unsent):
        what = "cyclic" if plan.cyclic else "event-driven"
        yield (
            f"missed {what}: {row.cob_id:03X}h {row.missed}, not {unsent} of {row.frames}, every"
            f" {plan.period_ns} ns"
        )


def _wrong_answers(case: Measured, row: PdoRow) -> Iterator[str]:
    due = by_definition(case, row.cob_id)
    yield from _wrong_missed(case, row, due)
    if not case.steady:
        return
    if row.extra != due.extra:
        yield f"extra of {row.cob_id:03X}h: {row.extra}, not {due.extra}"
    node = next(each for each in case.plan.nodes if each.node_id == row.node)
    late = sum(_response_us(case, n, pdo) > node.window_us for n, pdo in due.first_of.items())
    if row.late != (late if node.window_us else 0):
        yield f"late of {row.cob_id:03X}h: {row.late}, not {late} (window {node.window_us} us)"
    count = sum(len(r.seq) for r in case.analysis.responses if r.cob_id == row.cob_id)
    if count != len(due.first_of):
        yield f"responses of {row.cob_id:03X}h: {count}, not {len(due.first_of)}"


def _wrong_missed(case: Measured, row: PdoRow, due: Due) -> Iterator[str]:
    """SYNCs without an answer; nothing has to be told of those where the node may have been away."""
    syncs = case.truth.syncs
    present = _present(case, row, syncs[min(due.first_of, default=0)].end_ns)
    step_ns = 1100 * case.plan_of[row.cob_id].kind * case.plan.sync_us
    told = {
        seq
        for hole in case.analysis.holes
        if (hole.service, hole.cob_id) == ("pdo", row.cob_id)
        for seq in hole.evidence
    }
    possible = {syncs[n].seq for n in due.missed}
    expected = {
        syncs[n].seq
        for n in due.missed
        if _leaves_time(case, n)
        and any(
            start_ns + SETTLE_NS + step_ns <= syncs[n].end_ns <= end_ns - 2 * step_ns
            for start_ns, end_ns in present
        )
    }
    if told - possible or row.missed > len(possible):
        yield f"missed of {row.cob_id:03X}h: {row.missed} with {sorted(map(str, told - possible))}"
    unsaid = expected - told if max(len(possible), row.missed) < MAX_TOLD else set()
    if unsaid or row.missed < len(expected):
        yield f"missed of {row.cob_id:03X}h: {row.missed} without {sorted(map(str, unsaid))}"


def _present(case: Measured, row: PdoRow, first_ns: int) -> list[tuple[int, int]]:
    """When the analyzer knew the node to be at work.

    It takes a node for lost that it has not heard for 1.5 of its periods, whatever the reason; when
    that began is not known.
    """
    if any((state.node, state.state) == (row.node, "LOST") for state in case.analysis.nmt_states):
        return []
    return [
        (max(state.start_ns, first_ns), state.end_ns)
        for state in case.analysis.nmt_states
        if (state.node, state.state) == (row.node, "OPERATIONAL")
    ]


def _leaves_time(case: Measured, number: int) -> bool:
    """Whether the next SYNC did not come at once: then nobody expects an answer."""
    syncs = case.truth.syncs
    apart_ns = case.stamp(syncs[number + 1].end_ns) - case.stamp(syncs[number].end_ns)
    return 0.5 < apart_ns / case.usual_period_ns < 10


def _response_us(case: Measured, number: int, pdo: SentPdo) -> float:
    return (case.stamp(pdo.end_ns) - case.stamp(case.truth.syncs[number].end_ns)) / 1000


def wrong_syncs(case: Measured) -> Iterator[str]:
    """SYNCs that are not all counted, or missing although all were sent."""
    (row,) = case.analysis.sync
    heard = sum(frame.seq is not None for frame in case.truth.syncs)
    if row.count != heard:
        yield f"SYNC: {row.count}, not {heard}"
    if row.missing or row.counter_jumps:
        yield f"SYNC: {row.missing} missing, {row.counter_jumps} jumps of the counter"


def wrong_load(case: Measured) -> Iterator[str]:
    """Bus load that is not the sum of what was sent."""
    (row,) = case.analysis.bus_load
    expected = mean_percent(case)
    step_ns = case.plan.stamp_resolution_ns
    passed_ns = case.recorded[-1].end_ns - case.recorded[0].end_ns
    share = 2 * step_ns / passed_ns * (1 + len(case.truth.blind)) + 1e-9
    if row.mean_percent is None or abs(row.mean_percent - expected) > expected * share:
        yield f"mean load {row.mean_percent} %, not {expected}"


def mean_percent(case: Measured) -> float:
    """Load while the recorder listened, from its first frame on [%]."""
    bits = passed_ns = 0
    before: SentFrame | None = None
    for frame in case.recorded:
        if before is not None and not _blind_between(case, before, frame):
            bits += frame.bits
            passed_ns += frame.end_ns - before.end_ns
        before = frame
    return 100 * bits * SECOND_NS / case.plan.bitrate / passed_ns


def _blind_between(case: Measured, before: SentFrame, after: SentFrame) -> bool:
    return any(before.end_ns < end and start < after.end_ns for start, end in case.truth.blind)


def widths_us(case: Measured) -> dict[str, NDArray[np.float64]]:
    """Widths of the bounds of all responses [us], by the column of the lower bound."""
    found: dict[str, list[NDArray[np.float64]]] = {}
    for each in case.analysis.responses:
        plan = case.plan_of.get(each.cob_id)
        if plan is not None and plan.synchronous:
            found.setdefault("low", []).append(each.device_high_us - each.device_low_us)
            found.setdefault("least", []).append(each.device_high_us - each.device_least_us)
    return {name: np.concatenate(columns) for name, columns in found.items()}


def carried(case: Measured) -> int:
    """Responses that answer an earlier SYNC than the last one before them."""
    last_sync = case.last_sync
    return sum(
        pdo.sync_ns is not None and pdo.sync_ns != last_sync[seq].end_ns
        for seq, pdo in case.pdo_of.items()
        if seq in last_sync
    )


def kind(problem: str) -> str:
    """A problem without what is peculiar to one bus.

    >>> kind("missed cyclic: 3C5h 3, not 0 of 600, every 2000000 ns")
    'missed cyclic'
    """
    words = problem.split(":", maxsplit=1)[0].split()
    return " ".join(word for word in words if not any(c.isdigit() for c in word))
