"""Findings against what the script asks for, and the frames on which they rest."""

from collections.abc import Iterator

import numpy as np

from syncline_analyzer.results import Finding, Link
from syncline_samples.comparison import compare
from syncline_samples.faults import MoveEmcy, MovePdo, MoveSdo
from syncline_samples.truth import ExpectedFinding
from tests.analyzer.fuzz_case import Case, S
from tests.analyzer.fuzz_rows import twins

_MOVES = (MoveEmcy, MovePdo, MoveSdo)
_LSS_IDS = (0x7E4, 0x7E5)
_SHOWN_BY_OTHERS = ("pdo.delaying_node",)
"""Findings on what a node does to others: the frames that came late because of it are theirs."""
_LOOP = "nmt.boot_loop"


def findings(case: Case) -> Iterator[str]:
    """All that must be found is, and nothing else above `info`."""
    outcome = compare(_shifted(case), case.analysis.findings)
    for missing in outcome.missing:
        back = bool((np.diff(case.frames.t_ns) < 0).any())
        if missing.id == "clock.step_back" and not back:
            continue
        if missing.id.startswith("pdo.") and missing.node in twins(case):
            continue
        if missing.id == "nmt.node_lost" and _alone(case, missing):
            continue
        unasked = "nmt.unexpected_reset" in (missing.id, *missing.or_as)
        if unasked and _reset_before(case, missing):
            continue
        yield f"{missing.id} of node {missing.node} not found ({missing.what})"
    mild = {id(f) for f in case.analysis.findings if f.severity == "info" and not f.chain}
    for told in outcome.unexpected:
        if id(told) not in mild:
            yield f"{told.id} of node {told.node} invented: {told.text}"


def _alone(case: Case, missing: ExpectedFinding) -> bool:
    """Whether nobody else was on the bus for a while: then it may as well have been off."""
    since = case.stamp(missing.at_ns)
    during = (case.frames.t_ns > since) & (case.frames.t_ns < since + S // 4)
    return not during.any()


def _reset_before(case: Case, missing: ExpectedFinding) -> bool:
    """Whether a command may explain a reset: one in the 10 s before it (analysis.md 4)."""
    return any(
        each.specifier in (0x81, 0x82)
        and each.node in (0, missing.node)
        and 0 <= missing.at_ns - each.t_ns <= 10 * S
        for each in case.truth.commands
    )


def _shifted(case: Case) -> list[ExpectedFinding]:
    """What is expected, in the recorder's time."""
    earlier = sum(min(0, step) for _, step in case.steps)
    later = sum(max(0, step) for _, step in case.steps)
    return [
        each._replace(
            start_ns=each.start_ns + earlier,
            end_ns=each.end_ns + later,
            or_as=(*each.or_as, _LOOP) if _beside_loop(case, each) else each.or_as,
        )
        for each in (*case.truth.findings, *_also_true(case))
    ]


def _beside_loop(case: Case, expected: ExpectedFinding) -> bool:
    """Whether a restart is one more of a loop, if that was not a minute ago."""
    restart = "nmt.unexpected_reset" in (expected.id, *expected.or_as)
    loops = (each for each in case.truth.findings if each.id == _LOOP)
    return restart and any(
        each.node == expected.node and abs(each.at_ns - expected.at_ns) <= 60 * S for each in loops
    )


def _also_true(case: Case) -> Iterator[ExpectedFinding]:
    """What an analyzer may say of a run besides what the script asks for, because it is so."""
    for emcy in case.truth.emcy:
        if emcy.code == 0 and emcy.active:
            yield _allowed("emcy.partly_cleared", emcy.node, emcy.t_ns)

    for spec in case.scenario.devices:
        yield _allowed("device.lost_at_reset", spec.node_id, case.at(0))._replace(end_ns=1 << 62)
    for node in twins(case):
        told = {finding.id for finding in case.analysis.findings}
        told |= {link.id for finding in case.analysis.findings for link in finding.chain}
        for reported in sorted(told):
            yield _allowed(reported, node, case.at(0))._replace(end_ns=1 << 62)
    for emcy in case.truth.emcy:
        if emcy.code in (0x7510, 0x8140):
            yield _allowed("error.bus_off", emcy.node, emcy.t_ns)
    for transfer in case.truth.sdo:
        if transfer.result != "ok":
            finding = "sdo.abort" if transfer.result == "abort" else "sdo.no_answer"
            yield _allowed(finding, transfer.node, transfer.start_ns)
    for at_ns, step in case.steps:
        for finding in ("clock.step_forward", "bus.silent") if step > 0 else ():
            yield _allowed(finding, None, at_ns)
    if case.truth.error_frames:
        yield _allowed("error.frames", None, case.at(0))._replace(end_ns=1 << 62)
    for spec in case.scenario.devices if not case.scenario.sync_us else ():
        yield _allowed("config.no_sync", spec.node_id, case.at(0))._replace(end_ns=1 << 62)


def _allowed(finding: str, node: int | None, at_ns: int) -> ExpectedFinding:
    return ExpectedFinding(finding, node, at_ns, at_ns - S, at_ns + 5 * S, False, "")


def evidence(case: Case) -> Iterator[str]:
    """Evidence exists, lies around its finding, and some of it concerns the node."""
    for finding in case.analysis.findings:
        yield from _evidence_of(case, finding)
        for link in finding.chain:
            yield from _evidence_of(case, link)


def _evidence_of(case: Case, piece: Finding | Link) -> Iterator[str]:
    frames, near = case.frames, 11 * S
    name = f"{piece.id} of node {piece.node}"
    if piece.end_ns < piece.start_ns:
        yield f"{name} ends before it starts"
    if any(not 0 <= seq < len(frames) for seq in piece.evidence):
        yield f"{name} rests on frames that do not exist"
        return
    stamps, ids = frames.t_ns[piece.evidence], frames.can_id[piece.evidence]
    if ((stamps < piece.start_ns - near) | (stamps > piece.end_ns + near)).any():
        yield f"{name} rests on frames far from it"
    if piece.id in _SHOWN_BY_OTHERS or any(
        isinstance(f, _MOVES) and f.node == piece.node for f in case.scenario.faults
    ):
        return
    about = ((ids & 0x7F) == piece.node) | np.isin(ids, (0, 0x80, *_LSS_IDS))
    if piece.node is not None and piece.evidence and not about.any():
        yield f"{name} rests on frames of others"
