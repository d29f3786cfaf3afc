"""What must agree between the tables of an analysis and the truth of its scenario.

Each check gives one sentence for each thing that is wrong; none for an analysis that is right.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

from syncline_analyzer.results import Finding, Link, SdoRow
from syncline_samples.comparison import compare
from syncline_samples.devices.errors import ERRORS
from syncline_samples.emcy import ActiveError
from syncline_samples.faults import (
    BusPowerOff,
    CommandIgnored,
    DuplicateNode,
    LeavesOperational,
    MoveEmcy,
    RemoteOnHeartbeat,
    SecondSyncProducer,
)
from syncline_samples.truth import BootUpTruth, EmcyTruth, ExpectedFinding
from tests.analyzer.fuzz_case import MS, Case, S

MASTER = 127
COMMANDS = {
    0x01: "start",
    0x02: "stop",
    0x80: "enter pre-operational",
    0x81: "reset node",
    0x82: "reset communication",
}
Row = tuple[object, ...]
Timed = tuple[int, Row]
"""Stamp and what happened then."""


def differences(
    what: str, case: Case, true: Sequence[Timed], told: Sequence[Timed]
) -> Iterator[str]:
    """Rows that only one side has, and rows whose times lie further apart than stamps may."""
    left, right = Counter(row for _, row in true), Counter(row for _, row in told)
    for row in left - right:
        yield f"{what} not told: {row}"
    for row in right - left:
        yield f"{what} invented: {row}"
    if left != right:
        return
    stamped = [(case.stamp(t_ns), row) for t_ns, row in true]
    for (true_ns, row), (told_ns, _) in zip(_in_order(stamped), _in_order(told), strict=True):
        if abs(told_ns - true_ns) > case.slack_ns:
            yield f"{what} {row} is told {(told_ns - true_ns) / 1000:.0f} us off"


def _in_order(rows: Sequence[Timed]) -> list[Timed]:
    return sorted(rows, key=lambda each: (repr(each[1]), each[0]))


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
    may a guard answer whose request the recorder did not hear.
    """
    for row in case.analysis.nodes:
        counts = case.truth.counts
        boots = _boot_ups(case, row.node)
        unsure_answers = len(case.deaf) if counts["guard_requests", row.node] else 0
        beats = counts["heartbeats", row.node] - counts["empty_heartbeats", row.node]
        answers = counts["guard_answers", row.node]
        unsure = sum(boot.byte != 0 for boot in boots if _first(case, boot))
        if not len(boots) - unsure <= row.boot_ups <= len(boots) + _falls(case, row.node):
            yield f"node {row.node}: {row.boot_ups} boot-ups instead of {len(boots)}"
        elif abs(row.boot_ups + row.heartbeats - len(boots) - beats) > unsure_answers:
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


def _falls(case: Case, node: int) -> int:
    """Falls to PRE-OPERATIONAL of a device that boots with 7Fh: they look like restarts."""
    stored = any(s.node_id == node and s.stored_heartbeat_ms for s in case.scenario.devices)
    return stored * sum(
        isinstance(fault, LeavesOperational) and fault.node == node
        for fault in case.scenario.faults
    )


def _boot_ups(case: Case, node: int) -> list[BootUpTruth]:
    return [boot for boot in case.truth.boot_ups if boot.node == node and case.heard(boot.t_ns)]


def _first(case: Case, boot: BootUpTruth) -> bool:
    """Whether a boot-up is the first that is heard of a node, at the start or after a gap."""
    signs = case.signs(boot.node)
    begun = max((case.stamp(end) for _, end in case.deaf if end <= boot.t_ns), default=0)
    known = (signs >= begun) & (signs < case.stamp(boot.t_ns) - case.slack_ns)
    return not known.any()


def emcys(case: Case) -> Iterator[str]:
    """Every EMCY is a row with its code, register, bits and transition."""
    true = [(t_ns, row) for t_ns, row in _emcy_rows(case) if case.heard(t_ns)]
    told = [
        (row.t_ns, (row.node, row.code, row.error_register, row.transition))
        for row in case.analysis.emcy
    ]
    yield from differences("EMCY", case, true, told)


def _emcy_rows(case: Case) -> Iterator[Timed]:
    """The error state machine of CiA 301 7.2.7.2, fed with what the recorder heard."""
    active: dict[int, set[int]] = {}
    for event in _error_events(case):
        errors = active.setdefault(event.node, set())
        if isinstance(event, BootUpTruth):
            if errors:
                yield event.t_ns, (event.node, None, None, "reset")
            errors.clear()
            continue
        if event.dlc < 8:
            code = event.code if event.dlc >= 2 else None
            yield event.t_ns, (event.node, code, None, "malformed")
            continue
        if event.code:
            transition = "further" if errors else "raised"
            errors.add(event.code)
        else:
            left = event.register or event.alarms or event.warnings
            transition = "partly cleared" if left else "all cleared"
            errors.intersection_update(event.active)
        yield event.t_ns, (event.node, event.code, event.register, transition)


def _error_events(case: Case) -> list[EmcyTruth | BootUpTruth]:
    events: list[EmcyTruth | BootUpTruth] = [*case.truth.emcy, *case.truth.boot_ups]
    heard = [event for event in events if case.heard(event.t_ns)]
    return sorted(heard, key=lambda event: event.t_ns)


def errors(case: Case) -> Iterator[str]:
    """Every error is a row with when it was raised and how it ended.

    Not of nodes with errors that share their bits, where a clear does not tell which it ends.
    """
    rows = case.analysis.errors
    open_ = {row.node for row in rows if not row.certain}
    true = [entry for entry in _error_rows(case) if entry[1][0] not in open_]
    told = [(r.raised_ns, (r.node, r.code, r.status)) for r in rows if r.node not in open_]
    yield from differences("error", case, true, told)


def _ambiguous(case: Case) -> set[int]:
    """Nodes on which an error went whose bits were all set by another one that stayed."""
    found: set[int] = set()
    active: dict[int, tuple[int, ...]] = {}
    for event in case.truth.emcy:
        before = active.get(event.node, ())
        left = _bits(case, event.node, event.active)
        gone = [code for code in before if code not in event.active]
        if event.active and any(_bits(case, event.node, (code,)) & ~left == 0 for code in gone):
            found.add(event.node)
        active[event.node] = event.active if event.dlc == 8 else before
    return found


def _bits(case: Case, node: int, codes: Sequence[int]) -> int:
    """Bits of the register, the alarms and the warnings that errors of a node set."""
    device = next(spec.device for spec in case.scenario.devices if spec.node_id == node)
    guarding = ActiveError(0x11 if device == "jn2100" else 0x20)
    found = 0
    for code in codes:
        error = ERRORS[device].get(code, guarding)
        found |= error.register | error.alarms << 8 | error.warnings << 24
    return found


def _error_rows(case: Case) -> Iterator[Timed]:
    active: dict[int, dict[int, int]] = {}
    for event in _error_events(case):
        errors = active.setdefault(event.node, {})
        if isinstance(event, BootUpTruth):
            gone, status = list(errors), "lost at reset"
        elif event.dlc < 8:
            continue
        elif event.code:
            errors.setdefault(event.code, event.t_ns)
            continue
        else:
            gone, status = [code for code in errors if code not in event.active], "cleared"
        for code in gone:
            yield errors.pop(code), (event.node, code, status)
    for node, left in active.items():
        for code, raised_ns in left.items():
            yield raised_ns, (node, code, "still active")


def sdo(case: Case) -> Iterator[str]:
    """Every transfer that was heard whole is a row; those around a gap are not looked at."""
    if case.deaf and case.steps:
        return
    true = [
        (
            each.start_ns,
            _sdo_row(
                each.node,
                each.index,
                each.sub,
                each.direction,
                each.kind,
                each.result,
                each.abort_code,
                each.data,
            ),
        )
        for each in case.truth.sdo
        if _clear(case, each.start_ns, each.end_ns) and each.node not in _twins(case)
    ]
    told = [
        (
            row.start_ns,
            _sdo_row(
                row.node,
                row.index,
                row.sub,
                row.direction,
                row.kind,
                row.result,
                row.abort_code,
                row.data,
            ),
        )
        for row in case.analysis.sdo
        if _clear_told(case, row.start_ns, row.end_ns)
        and not _unfinished(case, row)
        and row.node not in _twins(case)
    ]
    yield from differences("SDO", case, true, told)


def _unfinished(case: Case, row: SdoRow) -> bool:
    """Whether a transfer runs at the end of the run: the client has not given it up."""
    waited_ns = case.stamp(case.at(case.scenario.seconds)) - row.start_ns
    return row.result not in ("ok", "abort") and waited_ns < 600 * MS


def _sdo_row(
    node: int,
    index: int | None,
    sub: int | None,
    direction: str,
    kind: str,
    result: str,
    code: int | None,
    data: bytes,
) -> Row:
    ended = "not answered" if result in ("no answer", "interrupted") else result
    return node, index, sub, direction, kind, ended, code, data if ended == "ok" else b""


def _clear(case: Case, start_ns: int, end_ns: int) -> bool:
    """Whether a stretch lies well outside of what the recorder did not hear."""
    near = 600 * MS
    return not any(start_ns < end + near and end_ns > start - near for start, end in case.deaf)


def _clear_told(case: Case, start_ns: int, end_ns: int) -> bool:
    near = 600 * MS
    return not any(
        start_ns < case.stamp(end) + near and end_ns > case.stamp(start) - near
        for start, end in case.deaf
    )


def pdos(case: Case) -> Iterator[str]:
    """Frames of every PDO are counted under its identifier and node."""
    true = Counter((pdo.cob_id, pdo.node) for pdo in case.truth.pdos if case.heard(pdo.end_ns))
    outputs = 0x200 + case.scenario.rpdo_node
    told = {
        (row.cob_id, row.node): row.frames
        for row in case.analysis.pdos
        if not (case.scenario.rpdo_node and row.cob_id == outputs)
    }
    if dict(true) != told:
        yield f"PDO frames by identifier and node: {told} instead of {dict(true)}"


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


def timelines(case: Case) -> Iterator[str]:
    """The intervals of a node follow one another from the first frame to the end."""
    row = case.analysis.capture
    for node in {each.node for each in case.analysis.nmt_states}:
        rows = [each for each in case.analysis.nmt_states if each.node == node]
        edges = [row.begin_ns, *(each.end_ns for each in rows)]
        if [each.start_ns for each in rows] != edges[:-1]:
            yield f"node {node}: intervals do not follow one another"
        if any(each.end_ns < each.start_ns for each in rows):
            yield f"node {node}: an interval ends before it starts"
        if not case.steps and rows[-1].end_ns != row.end_ns:
            yield f"node {node}: the timeline ends at {rows[-1].end_ns}, not {row.end_ns}"


def states(case: Case) -> Iterator[str]:
    """Well after each change the state told is the true one, or UNKNOWN where nothing tells it."""
    for true in case.truth.states:
        if true.node in _twins(case):
            continue
        settle_ns = 2 * case.period_ns(true.node) + 150 * MS
        for at_ns in (
            true.start_ns + settle_ns,
            (true.start_ns + true.end_ns) // 2,
            true.end_ns - MS,
        ):
            if true.start_ns + settle_ns <= at_ns < true.end_ns and not _unclear(
                case, at_ns, settle_ns
            ):
                told = _told_state(case, true.node, at_ns)
                if told is not None and told not in _fitting(case, true.node, true.state, at_ns):
                    after = (at_ns - case.scenario.epoch_ns) / S
                    yield f"node {true.node} at {after:.3f} s: {told} instead of {true.state}"


def _twins(case: Case) -> set[int]:
    """Numbers that two devices carry."""
    return {f.node for f in case.scenario.faults if isinstance(f, DuplicateNode)}


def _unclear(case: Case, at_ns: int, settle_ns: int) -> bool:
    """Whether a moment lies in a gap, soon after one, or around a clock step."""
    if any(start - settle_ns <= at_ns < end + settle_ns for start, end in case.deaf):
        return True
    return any(abs(at_ns - step_ns) < abs(step) + settle_ns for step_ns, step in case.steps)


def _told_state(case: Case, node: int, at_ns: int) -> str | None:
    stamp = case.stamp(at_ns)
    for row in case.analysis.nmt_states:
        if row.node == node and row.start_ns <= stamp < row.end_ns:
            return row.state
    return None


def _fitting(case: Case, node: int, state: str, at_ns: int) -> set[str]:
    """States that may be told of a node that is in a state.

    UNKNOWN is right as long as nothing is heard, or nothing but empty heartbeats; LOST once the
    node is silent too long; a change that nobody commanded shows with the next message, and a
    restart reaches back to the last sign of life (analysis.md 4).
    """
    signs, stamp = case.signs(node), case.stamp(at_ns)
    begun = max((case.stamp(end) for _, end in case.deaf if end <= at_ns), default=0)
    before = signs[(signs >= begun) & (signs <= stamp)]
    fitting = {state}
    if not len(before):
        return fitting | {"UNKNOWN", "LOST"}
    beats = case.beats(node)
    overdue_ns = stamp - round(1.4 * case.period_ns(node))
    if not ((beats > overdue_ns) & (beats <= stamp)).any():
        fitting.add("UNKNOWN")
    if state in ("OFF", "INITIALISING") or before[-1] <= overdue_ns:
        fitting |= {"LOST", "INITIALISING", "UNKNOWN"}
    if _restarts(case, node, stamp):
        fitting.add("INITIALISING")
    return fitting | _earlier(case, node, at_ns) | _spoiled(case, node, at_ns)


def _restarts(case: Case, node: int, stamp: int) -> bool:
    """Whether the next message after a moment is a boot-up."""
    later = case.signs(node)
    later = later[later > stamp]
    boots = [case.stamp(boot.t_ns) for boot in _boot_ups(case, node)]
    return bool(len(later)) and any(abs(t_ns - int(later[0])) <= case.slack_ns for t_ns in boots)


def _earlier(case: Case, node: int, at_ns: int) -> set[str]:
    """The state before a change of its own, as long as the node has not told the new one."""
    rows = [row for row in case.truth.states if row.node == node and row.start_ns <= at_ns]
    beats = case.beats(node)
    since, until = case.stamp(rows[-1].start_ns), case.stamp(at_ns)
    told = ((beats >= since) & (beats <= until)).any()
    return {row.state for row in rows[-2:-1]} if not told else set()


def _spoiled(case: Case, node: int, at_ns: int) -> set[str]:
    """What a scripted fault makes a node seem to be."""
    found = set()
    for fault in case.scenario.faults:
        if isinstance(fault, RemoteOnHeartbeat) and fault.node == node:
            found |= {"UNKNOWN"} if case.at(fault.at_s) <= at_ns else set()
        if isinstance(fault, LeavesOperational) and fault.node == node and _falls(case, node):
            during = abs(at_ns - case.at(fault.at_s)) < 2 * case.period_ns(node)
            found |= {"INITIALISING"} if during else set()
        if isinstance(fault, CommandIgnored) and fault.node == node:
            during = 0 <= at_ns - case.at(fault.at_s) < 2 * case.period_ns(node)
            found |= {"STOPPED", "PRE-OPERATIONAL"} if during else set()
    return found


def findings(case: Case) -> Iterator[str]:
    """All that must be found is, and nothing else above `info`."""
    outcome = compare(_shifted(case), case.analysis.findings)
    for missing in outcome.missing:
        unasked = "nmt.unexpected_reset" in (missing.id, *missing.or_as)
        if unasked and _reset_before(case, missing):
            continue
        yield f"{missing.id} of node {missing.node} not found ({missing.what})"
    mild = {id(f) for f in case.analysis.findings if f.severity == "info" and not f.chain}
    for told in outcome.unexpected:
        if id(told) not in mild:
            yield f"{told.id} of node {told.node} invented: {told.text}"


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
        each._replace(start_ns=each.start_ns + earlier, end_ns=each.end_ns + later)
        for each in (*case.truth.findings, *_also_true(case))
    ]


def _also_true(case: Case) -> Iterator[ExpectedFinding]:
    """What an analyzer may say of a run besides what the script asks for, because it is so."""
    for emcy in case.truth.emcy:
        if emcy.code == 0 and emcy.active:
            yield _allowed("emcy.partly_cleared", emcy.node, emcy.t_ns)

    for spec in case.scenario.devices:
        yield _allowed("device.lost_at_reset", spec.node_id, case.at(0))._replace(end_ns=1 << 62)
    for node in _twins(case):
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
    if any(isinstance(f, MoveEmcy) and f.node == piece.node for f in case.scenario.faults):
        return
    about = ((ids & 0x7F) == piece.node) | (ids == 0) | (ids == 0x80)
    if piece.node is not None and piece.evidence and not about.any():
        yield f"{name} rests on frames of others"


CHECKS: tuple[Callable[[Case], Iterator[str]], ...] = (
    capture_counts,
    commands,
    nodes,
    error_control,
    emcys,
    errors,
    sdo,
    pdos,
    syncs,
    timelines,
    states,
    findings,
    evidence,
)


def wrong(case: Case) -> list[str]:
    """Everything that does not agree, each with the name of its check."""
    return [f"{check.__name__}: {text}" for check in CHECKS for text in check(case)]
