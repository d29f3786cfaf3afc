"""Resets that a node demonstrably did not follow: its heartbeats went on as if nothing was said."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from itertools import islice, takewhile

from syncline_analyzer.folds.nmt.events import (
    IN_FLIGHT_NS,
    KEPT_AFTER_MARK,
    Beat,
    BootUpEvent,
    Command,
    Ignored,
    Interval,
    NodeHistory,
)
from syncline_analyzer.folds.nmt.pace import Even
from syncline_schemas.canopen.nmt import RESETS, STATE_OF_BYTE, NmtState

BOOT_NS = 10_000_000_000
"""A boot-up may come so long after a reset; until then nothing else may explain the states [ns]."""
SOON = 0.9
"""Part of a period before which a node that did start anew sends no heartbeat."""
LATE = 1.25
"""The same where PDOs went on meanwhile: the heartbeat is the next one in its turn."""
ON_TIME = 0.03
"""Part of a period by which the heartbeats around a reset may be off their pace."""
MANY = 3
"""So many PDOs between a reset and the next heartbeat show that it sends on."""
_STAYS = (NmtState.OPERATIONAL, NmtState.STOPPED)
"""States in which no node is after a reset."""


def unheeded(
    history: NodeHistory,
    intervals: list[Interval],
    boot_ups: Sequence[BootUpEvent],
    resolution_ns: int,
) -> list[Ignored]:
    """Resets of this node alone after which it stays as it was; takes back what they told.

    Its heartbeats come on time over the command and say OPERATIONAL or STOPPED still. One of them
    comes sooner than a node that starts anew can send any, or PDOs go on before it. For 10 s there
    is neither a boot-up nor a silence, a gap, another command or an EMCY without an error.

    Args:
        history: of the node.
        intervals: its states as told so far.
        boot_ups: those of the node.
        resolution_ns: step of the stamps.
    """
    found: list[Ignored] = []
    for command in history.commands:
        beat = _contradiction(history, command, resolution_ns)
        if beat is None or _explained(history, boot_ups, command):
            continue
        if not _stays(intervals, command, STATE_OF_BYTE[beat.state]):
            continue
        if not (found and command.t_ns - found[-1].command.t_ns <= BOOT_NS):
            state = STATE_OF_BYTE[beat.state].value
            found.append(Ignored(command, beat.seq, beat.t_ns, state))
        _take_back(intervals, command)
    return found


def _contradiction(history: NodeHistory, command: Command, resolution_ns: int) -> Beat | None:
    """A heartbeat that only a node sends which was not reset: one of the first two."""
    period_ns, reset = history.period_ns, command.specifier in RESETS and command.node
    if period_ns is None or not reset or command.by:
        return None
    begin = bisect_right(history.beats, command.seq, key=lambda beat: beat.seq)
    following = history.beats[begin : begin + KEPT_AFTER_MARK]
    for beat in following[:2]:
        told = beat.kind == "heartbeat" and STATE_OF_BYTE.get(beat.state) in _STAYS
        passed = beat.t_ns - command.t_ns
        if not told or not IN_FLIGHT_NS < passed < LATE * period_ns:
            continue
        soon = passed < SOON * period_ns or _sends_on(history, command)
        on_time = _on_time(history, command, following, resolution_ns)
        return beat if soon and on_time else None
    return None


def _sends_on(history: NodeHistory, command: Command) -> bool:
    """Whether PDOs that are surely its own go on after a command, before its next heartbeat."""
    return any(
        span.since == (command.seq, command.t_ns)
        and not span.guess
        and not span.asked
        and span.late_count >= MANY
        for span in history.spans
    )


def _on_time(
    history: NodeHistory, command: Command, beats: Sequence[Beat], resolution_ns: int
) -> bool:
    """Whether heartbeats go on over a command, and for a few periods after it, at one pace.

    A node that starts anew falls out of step with the heartbeats (`beats`) that came before.
    """
    return any(
        even.first_ns < command.t_ns
        and command.t_ns + 2 * even.period_ns < even.last_ns
        and _keep(even, beats, resolution_ns)
        for even in history.even
    )


def in_step(history: NodeHistory, beats: Sequence[Beat], resolution_ns: int) -> bool:
    """Whether some heartbeats in a row come on time among others of one pace."""
    return any(
        even.first_ns < beats[0].t_ns
        and beats[-1].t_ns <= even.last_ns
        and _keep(even, beats, resolution_ns)
        for even in history.even
    )


def _keep(even: Even, beats: Sequence[Beat], resolution_ns: int) -> bool:
    """Whether heartbeats come a period after the ones before them."""
    slack = ON_TIME * even.period_ns
    intervals = [beat.t_ns - (beat.after_ns or 0) for beat in beats]
    return resolution_ns <= slack and all(abs(each - even.period_ns) <= slack for each in intervals)


def _explained(history: NodeHistory, boot_ups: Sequence[BootUpEvent], command: Command) -> bool:
    """Whether a boot-up, a gap or another command comes soon, or the capture ends before.

    Some devices send an EMCY without an error as their boot-up, or after it.
    """
    until_ns = command.t_ns + BOOT_NS
    booted = any(boot.seq > command.seq and boot.t_ns <= until_ns for boot in boot_ups)
    booted |= any(seq > command.seq and t_ns <= until_ns for seq, t_ns in history.no_errors)
    begin = bisect_right(history.commands, command.seq, key=lambda each: each.seq)
    later = islice(history.commands, begin, None)
    soon = takewhile(lambda each: each.t_ns <= until_ns, later)
    told = any(each.specifier not in RESETS for each in soon)
    blind = any(gap.start_ns <= until_ns and gap.end_ns >= command.t_ns for _, gap in history.gaps)
    return booted or told or blind or history.end_ns < until_ns


def _stays(intervals: Sequence[Interval], command: Command, state: NmtState) -> bool:
    """Whether the node was known to be in a state before a reset, and is in it for long after."""
    at = _told_by(intervals, command)
    if at is None or at == 0 or intervals[at - 1].certainty == "commanded":
        return False
    until_ns = command.t_ns + BOOT_NS
    around = takewhile(lambda i: i.start_ns < until_ns, islice(intervals, at - 1, None))
    return all(i.state is state for i in around if i.certainty != "commanded")


def _told_by(intervals: Sequence[Interval], command: Command) -> int | None:
    """Which interval a command alone tells, with another one after it."""
    at = bisect_left(intervals, command.t_ns, key=lambda interval: interval.start_ns)
    for number in range(at, len(intervals) - 1):
        interval = intervals[number]
        if interval.evidence == command.seq and interval.certainty == "commanded":
            return number
        if interval.start_ns > command.t_ns:
            break
    return None


def _take_back(intervals: list[Interval], command: Command) -> None:
    """Let the state go on that a reset did not end."""
    at = _told_by(intervals, command)
    if at is not None:
        intervals[at - 1].end_ns = intervals[at + 1].end_ns
        del intervals[at : at + 2]
