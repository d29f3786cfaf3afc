"""What is known of a node after its PDOs stopped: whether it lives, who watches it, what explains it."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from itertools import islice, takewhile

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.folds.nmt.table import NodeNmt
from syncline_analyzer.folds.timing.pdo_judge import BY_TIMER
from syncline_analyzer.folds.timing.pdo_periods import PAUSE_NS, PAUSE_PERIODS
from syncline_analyzer.folds.timing.pdo_state import MOST_REPEATS, PROVE_TIMER
from syncline_analyzer.pdo_binding import Pdo, PdoBindings
from syncline_analyzer.results import PdoPauseRow, PdoRow
from syncline_schemas.canopen.nmt import STATE_AFTER_COMMAND
from syncline_schemas.records import dataclass

SAME_MOMENT_NS = 1_000_000_000
_DEFAULT = "eds-default"
_START = 0x01
_ACTS_NS = 500_000_000
"""A command may act so late that a PDO still comes after it [ns]."""


@dataclass(frozen=True, slots=True)
class Aftermath:
    """What a finding on PDOs that stopped says besides the fact.

    Attributes:
        stayed: whether the node's error control went on; a change of state it would tell.
        told: sentences behind the fact, each after a blank.
        unsure: whether a value that stands still may explain it.
    """

    stayed: bool
    told: str
    cause: str
    check_next: str
    unsure: bool
    assumed: list[str]


def aftermath(facts: Facts, group: Sequence[PdoPauseRow]) -> Aftermath:
    """What is known of a node whose PDOs stopped at one moment."""
    first = group[0]
    nmt = _nmt(facts, first)
    stayed = _stayed(nmt, min(row.start_ns for row in group))
    watched = nmt is None or not _unwatched(nmt)
    rows = {each.cob_id: each for each in facts.analysis.pdos if each.bus == first.bus}
    pdos = {row.cob_id: (rows[row.cob_id], row.basis) for row in group if row.cob_id in rows}
    unsure = all(_counter(row) or _changing(row, basis) for row, basis in pdos.values())
    doubted = list(pdos.values()) if unsure else []
    counter = " and ".join(name for row, _ in doubted for name in _counter(row))
    changing = any(_changing(*each) for each in doubted)
    return Aftermath(
        stayed,
        "" if stayed else _told(nmt, group, watched),
        _cause(stayed, counter, changing),
        _check(stayed or watched, counter),
        bool(doubted),
        [each for row, basis in pdos.values() for each in _assumed(facts, row, basis)],
    )


def _nmt(facts: Facts, row: PdoPauseRow) -> NodeNmt | None:
    return facts.control.nmt.nodes.get((facts.number(row.bus), row.node))


def _stayed(nmt: NodeNmt | None, start_ns: int) -> bool:
    """Whether the node's error control goes on after a moment; a change of state it would tell."""
    return nmt is not None and (nmt.told_ns or 0) > start_ns + SAME_MOMENT_NS


def was_commanded(facts: Facts, pause: PdoPauseRow, period_ns: float) -> bool:
    """Whether a command to all nodes explains a pause of a node that tells no state after it.

    Such a command changes no state of a node that never told one: it may not listen to it.
    """
    timeline = facts.control.nmt.timelines.get((facts.number(pause.bus), pause.node))
    if timeline is None or _stayed(_nmt(facts, pause), pause.start_ns):
        return False
    commands, until_ns = timeline.history.commands, pause.start_ns + 1.5 * period_ns
    begin = bisect_left(commands, pause.start_ns - _ACTS_NS, key=lambda each: each.t_ns)
    later = takewhile(lambda each: each.t_ns < pause.end_ns, islice(commands, begin, None))
    told = [each for each in later if each.specifier in STATE_AFTER_COMMAND]
    if not any(c.node == 0 and c.specifier != _START and c.t_ns <= until_ns for c in told):
        return False
    due_ns = pause.end_ns - told[-1].t_ns
    return told[-1].specifier != _START or due_ns < max(PAUSE_NS, PAUSE_PERIODS * period_ns)


def _unwatched(nmt: NodeNmt) -> bool:
    """Whether a node tells no state by itself, and is asked for none."""
    return nmt.told_ns is None and not nmt.counts.heartbeats and not nmt.counts.guard_requests


def _told(nmt: NodeNmt | None, group: Sequence[PdoPauseRow], watched: bool) -> str:
    if watched or nmt is None:
        return " What state it was in from then on was not heard."
    last_ns = max(row.start_ns for row in group)
    mute = nmt.heard_ns is not None and nmt.heard_ns <= last_ns
    what = "Nothing at all" if mute else "No state"
    return (
        f" {what} was heard of it from then on, and nothing watches it: it sends no heartbeat, and"
        " nobody guards it."
    )


def _cause(stayed: bool, counter: str, changing: bool) -> str:
    what = (
        "The application in the device stopped (the CAN part goes on), its sensor failed, or the PDO"
        " was switched off in a way that was not recorded."
        if stayed
        else "It left OPERATIONAL, was switched off, or its application stopped: no heartbeat or"
        " guard answer after that tells which."
    )
    why = [
        f"its repeat counter ({counter}) was not read, and may end equal frames" * bool(counter),
        "its event timer was not read, and each frame brought another value, which may send it"
        * changing,
    ]
    still = "; ".join(each for each in why if each)
    return f"{what} Or its value stands still: {still}." if still else what


def _check(watched: bool, counter: str) -> str:
    counted = f", {counter}" if counter else ""
    if watched:
        return (
            f"Read 1001h, 1003h and 180xh{counted} of the node, and its state; does it send again"
            " after a start command, or a reset?"
        )
    return (
        f"Does it answer a read of 1000h? Then read 1001h, 1003h and 180xh{counted} of it; else look"
        " at its plug, cable and supply. Let it send a heartbeat (1017h), so that a loss is told."
    )


def _counter(row: PdoRow) -> list[str]:
    """The repeat counter of a PDO that nobody read, unless more equal frames came than it allows."""
    if row.repeat_source != _DEFAULT or row.longest_repeat > MOST_REPEATS:
        return []
    return [f"{0x27FF + _number(row):04X}h"]


def _changing(row: PdoRow, basis: str) -> bool:
    """Whether only the EDS tells its event timer, and changes of the value may have sent all frames."""
    return basis == BY_TIMER and row.event_timer_us is None and row.repeats < PROVE_TIMER


def _assumed(facts: Facts, row: PdoRow, basis: str) -> Iterator[str]:
    """Settings that make a PDO due and that only the device's EDS tells."""
    if basis != BY_TIMER or row.node is None:
        return
    pdo = Pdo(facts.number(row.bus), row.node, "tpdo", _number(row), "")
    settings = PdoBindings(facts.context.shadow).transmission(pdo)
    for sub, known in ((2, settings.type), (5, settings.event_timer_ms)):
        if known is not None and known.source == _DEFAULT:
            yield f"{pdo.communication:04X}h:{sub:02X} = {known.value!r} ({_DEFAULT})"
    if row.repeat_source == _DEFAULT:
        yield f"{0x27FF + pdo.number:04X}h = {row.repeat_counter} ({_DEFAULT})"


def _number(row: PdoRow) -> int:
    """
    >>> from types import SimpleNamespace as Row
    >>> _number(Row(pdo="TPDO2 (guess)"))
    2
    """
    return int((row.pdo or "TPDO0").split()[0][4:])
