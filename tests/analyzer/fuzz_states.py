"""NMT states: the timelines against the truth."""

from collections.abc import Iterator

from syncline_analyzer.results import NmtStateRow
from syncline_samples.faults import (
    CommandIgnored,
    LeavesOperational,
    RemoteOnHeartbeat,
    ResetBySdo,
)
from tests.analyzer.fuzz_case import MS, Case, S
from tests.analyzer.fuzz_rows import boot_ups, falls, twins


def timelines(case: Case) -> Iterator[str]:
    """The intervals of a node follow one another from the first frame to the end.

    One in which the clock steps back ends at the last stamp, and goes on at the first after it.
    """
    row = case.analysis.capture
    for node in {each.node for each in case.analysis.nmt_states}:
        rows = [each for each in case.analysis.nmt_states if each.node == node]
        edges = [row.begin_ns, *(each.end_ns for each in rows)]
        parted = [each for each, edge in zip(rows, edges, strict=False) if each.start_ns != edge]
        if not all(_stepped_back(case, each) for each in parted):
            yield f"node {node}: intervals do not follow one another"
        if any(each.end_ns < each.start_ns for each in rows):
            yield f"node {node}: an interval ends before it starts"
        if not case.steps and rows[-1].end_ns != row.end_ns:
            yield f"node {node}: the timeline ends at {rows[-1].end_ns}, not {row.end_ns}"


def _stepped_back(case: Case, row: NmtStateRow) -> bool:
    """Whether an interval is the rest of one in which the clock stepped back."""
    return "step back of the clock" in row.cause and any(step < 0 for _, step in case.steps)


def states(case: Case) -> Iterator[str]:
    """Well after each change the state told is the true one, or UNKNOWN where nothing tells it."""
    for true in case.truth.states:
        if true.node in twins(case):
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
    boots = [case.stamp(boot.t_ns) for boot in boot_ups(case, node)]
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
        if isinstance(fault, LeavesOperational) and fault.node == node and falls(case, node):
            during = abs(at_ns - case.at(fault.at_s)) < 2 * case.period_ns(node)
            found |= {"INITIALISING"} if during else set()
        if isinstance(fault, ResetBySdo) and fault.node == node:
            # The write is a reset command: INITIALISING from its answer on.
            during = 0 <= at_ns - case.at(fault.at_s) < S
            found |= {"INITIALISING"} if during else set()
        if isinstance(fault, CommandIgnored) and fault.node == node:
            during = 0 <= at_ns - case.at(fault.at_s) < 2 * case.period_ns(node)
            found |= {"STOPPED", "PRE-OPERATIONAL"} if during else set()
    return found
