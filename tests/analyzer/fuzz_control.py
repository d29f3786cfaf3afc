"""Counts, NMT commands and error control: the tables against the truth."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from syncline_samples.faults import BusPowerOff, SecondSyncProducer
from syncline_samples.truth import BootUpTruth
from syncline_schemas.batch import FrameFlag
from tests.analyzer.fuzz_case import Case
from tests.analyzer.fuzz_rows import boot_ups, clear, differences, falls

MASTER = 127
COMMANDS = {
    0x01: "start",
    0x02: "stop",
    0x80: "enter pre-operational",
    0x81: "reset node",
    0x82: "reset communication",
}


def capture_counts(case: Case) -> Iterator[str]:
    """Frames of each kind are counted."""
    row, truth = case.analysis.capture, case.truth
    data = truth.frames - truth.remote_frames - truth.error_frames
    told = (row.frames, row.data_frames, row.remote_frames, row.error_frames, row.extended_frames)
    if told != (truth.frames, data, truth.remote_frames, truth.error_frames, 0):
        yield f"frames, data, remote, error, extended: {told}"


def commands(case: Case) -> Iterator[str]:
    """Every NMT command that was heard is a row."""
    true = [
        (each.t_ns, (COMMANDS[each.specifier], each.node))
        for each in case.truth.commands
        if case.heard(each.t_ns) and each.specifier in COMMANDS and each.node <= MASTER
    ]
    told = [
        (row.t_ns, (row.command, row.node))
        for row in case.analysis.nmt_commands
        if row.command in COMMANDS.values() and row.node <= MASTER
    ]
    yield from differences("NMT command", case, true, told)


def confirmations(case: Case) -> Iterator[str]:
    """A reset of one node is confirmed by the boot-up that follows it."""
    resets = [c for c in case.truth.commands if c.specifier in (0x81, 0x82)]
    told = {row.t_ns: row.confirmed_ms for row in case.analysis.nmt_commands}
    for command, later in zip(resets, [*resets[1:], None], strict=True):
        boots = [b for b in case.truth.boot_ups if b.node == command.node]
        first = next((b for b in boots if b.t_ns > command.t_ns), None)
        if first is None or not clear(case, command.t_ns, first.t_ns) or case.steps:
            continue
        if later is not None and later.t_ns < first.t_ns:
            continue
        near = [t_ns for t_ns in told if abs(t_ns - command.t_ns) <= case.slack_ns]
        took_ms = (first.t_ns - command.t_ns) / 1e6
        confirmed_ms = told[near[0]] if near else None
        if confirmed_ms is None or abs(confirmed_ms - took_ms) > 2 * case.slack_ns / 1e6:
            yield f"reset of node {command.node} confirmed in {confirmed_ms}, not {took_ms} ms"


def nodes(case: Case) -> Iterator[str]:
    """The nodes that were heard are listed, and no other."""
    known = {spec.node_id for spec in case.scenario.devices}
    known |= {boot_up.node for boot_up in case.truth.boot_ups}
    true = sorted(node for node in known if len(case.signs(node)))
    if (told := [row.node for row in case.analysis.nodes]) != true:
        yield f"nodes {told} instead of {true}"


def error_control(case: Case) -> Iterator[str]:
    """Boot-ups, heartbeats, guard requests and answers of each node.

    The first 7Fh of a node may as well be a heartbeat, if nothing was heard of it before; and so
    may a guard answer whose request the recorder did not hear. A 00h after empty heartbeats may be
    one more of them, unless the node tells something else before it is reset.
    """
    for row in case.analysis.nodes:
        counts = case.truth.counts
        boots = boot_ups(case, row.node)
        unsure_answers = len(case.deaf) if counts["guard_requests", row.node] else 0
        odd = counts["empty_heartbeats", row.node] + counts["unknown_states", row.node]
        beats = counts["heartbeats", row.node] - odd
        answers = counts["guard_answers", row.node]
        unsure = sum(boot.byte != 0 for boot in boots if _first(case, boot))
        like_empty = sum(_like_empty(case, boot) for boot in boots)
        if (
            not len(boots) - unsure - like_empty
            <= row.boot_ups
            <= len(boots) + falls(case, row.node)
        ):
            yield f"node {row.node}: {row.boot_ups} boot-ups instead of {len(boots)}"
        elif abs(row.boot_ups + row.heartbeats - len(boots) - beats) > unsure_answers + like_empty:
            yield f"node {row.node}: {row.heartbeats} heartbeats instead of {beats}"
        requests = counts["guard_requests", row.node]
        answers_off = abs(row.guard_answers - answers)
        if row.guard_requests != requests or answers_off > unsure_answers:
            yield (
                f"node {row.node}: {row.guard_answers} of {row.guard_requests} guard requests"
                f" answered instead of {answers} of {counts['guard_requests', row.node]}"
            )
        if row.toggle_errors != counts["toggle_errors", row.node]:
            yield (
                f"node {row.node}: {row.toggle_errors} toggle errors instead of"
                f" {counts['toggle_errors', row.node]}"
            )


def _first(case: Case, boot: BootUpTruth) -> bool:
    """Whether a boot-up is the first that is heard of a node, at the start or after a gap."""
    signs = case.signs(boot.node)
    begun = max((case.stamp(end) for _, end in case.deaf if end <= boot.t_ns), default=0)
    own = np.abs(signs - case.stamp(boot.t_ns)) <= case.slack_ns
    # In their order: where the clock is set back, later ones have earlier stamps.
    before = signs[: int(own.argmax())] if own.any() else signs
    return not (before >= begun).any()


def _like_empty(case: Case, boot: BootUpTruth) -> bool:
    """Whether a boot-up 00h follows an empty heartbeat, and nothing but the next boot-up follows."""
    frames = case.frames
    other = (frames.flags & (FrameFlag.REMOTE | FrameFlag.ERROR)) != 0
    beats = frames[(frames.can_id == 0x700 + boot.node) & ~other]
    starts = np.array([case.stamp(each.t_ns) for each in boot_ups(case, boot.node)])
    booting = (np.abs(beats.t_ns[:, np.newaxis] - starts) <= case.slack_ns).any(axis=1)
    own = np.flatnonzero(np.abs(beats.t_ns - case.stamp(boot.t_ns)) <= case.slack_ns)
    if boot.byte or not len(own) or not own[0]:
        return False
    at = int(own[0])
    empty = not booting[at - 1] and not beats.data[at - 1, : beats.dlc[at - 1]].any()
    return empty and bool(booting[at + 1 :][:1].all())


def syncs(case: Case) -> Iterator[str]:
    """SYNCs are counted, and those that were left out between others."""
    true = case.truth.counts["syncs", 0]
    told = sum(row.count for row in case.analysis.sync)
    if told != true:
        yield f"{told} SYNCs instead of {true}"
    left_out = sum(_left_out(case))
    missing = sum(row.missing for row in case.analysis.sync)
    mixed = any(isinstance(f, BusPowerOff | SecondSyncProducer) for f in case.scenario.faults)
    if missing != left_out and not case.steps and not mixed:
        yield f"{missing} missing SYNCs instead of {left_out}"


def _left_out(case: Case) -> Iterator[int]:
    """SYNCs that did not come between two others, where the recorder heard the bus throughout."""
    period_ns = case.scenario.sync_us * 1000
    for before_ns, after_ns in pairwise(case.truth.sync_ns):
        blind = any(start < after_ns and end > before_ns for start, end in case.deaf)
        if after_ns - before_ns > 1.5 * period_ns and not blind:
            yield round((after_ns - before_ns) / period_ns) - 1
