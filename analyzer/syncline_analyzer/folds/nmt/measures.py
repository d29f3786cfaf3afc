"""What a node's told timeline measures: answers to commands, starts, late heartbeats."""

from bisect import bisect_left, bisect_right
from itertools import islice

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.nmt.events import Command, Interval
from syncline_analyzer.folds.nmt.pace import Late
from syncline_analyzer.folds.nmt.silences import RESET_WINDOW_NS
from syncline_analyzer.folds.nmt.timeline import Timeline, state_of
from syncline_analyzer.folds.nmt.timeout import period_changed
from syncline_analyzer.results import Quantiles
from syncline_schemas.canopen.nmt import STATE_AFTER_COMMAND, NmtState

SILENT_PART = 0.2
"""A heartbeat is late by the silence of the whole bus if that makes so much of its period."""
_AWAY = (NmtState.LOST, NmtState.INITIALISING, NmtState.UNKNOWN)


class Measures:
    """Durations of one node, none of them across a step of the clock or a loss."""

    def __init__(self, context: Context, timeline: Timeline) -> None:
        self._context = context
        self._timeline = timeline
        self._history = timeline.history
        self._intervals = sorted(timeline.intervals, key=lambda interval: interval.start_ns)
        self._starts = [interval.start_ns for interval in self._intervals]
        self._seqs = [beat.seq for beat in timeline.history.beats]
        self._boots = {boot.seq for boot in timeline.boot_ups}
        self._gone = [*timeline.lost, *timeline.restarts]

    def listens(self, command: Command) -> bool:
        """Whether the node was there to hear a command: known before it, and not LOST."""
        return bisect_left(self._seqs, command.seq) > 0 and not self._away(command)

    def confirmed(self, command: Command) -> int | None:
        """Time from a command to the first message that confirms it [ns], None without one.

        A node that is lost does not hear a command: what it says when it is back confirms nothing.
        """
        wanted = STATE_AFTER_COMMAND.get(command.specifier)
        if wanted is None or not self._context.timed or self._away(command):
            return None
        at = bisect_right(self._history.commands, command.seq, key=lambda c: c.seq)
        later = islice(self._history.commands, at, None)
        stop = next((c.seq for c in later if STATE_AFTER_COMMAND.get(c.specifier) != wanted), None)
        for row in range(bisect_right(self._seqs, command.seq), len(self._seqs)):
            beat = self._history.beats[row]
            if stop is not None and beat.seq > stop:
                return None
            reset = wanted is NmtState.INITIALISING
            if beat.seq in self._boots if reset else state_of(beat) is wanted:
                return self._passed(command.t_ns, beat.t_ns)
        return None

    def confirmations(self) -> list[int]:
        """The times of all commands to this node that ask for a state, resets left out [ns]."""
        asked = (
            self.confirmed(command)
            for command in self._history.commands
            if STATE_AFTER_COMMAND.get(command.specifier) is not NmtState.INITIALISING
        )
        return [passed for passed in asked if passed is not None]

    def boot_times(self) -> list[int]:
        """From each reset command to its boot-up [ns]."""
        passed = (
            self._passed(boot.command_ns, boot.t_ns)
            for boot in self._timeline.boot_ups
            if boot.command_ns is not None and self._context.timed
        )
        return [time for time in passed if time is not None]

    def explains(self, late: Late) -> bool:
        """Whether a longer heartbeat period is a silence told elsewhere, or a changed 1017h."""
        begin = max(0, bisect_right(self._starts, late.start_ns) - 1)
        stop = bisect_left(self._starts, late.end_ns)
        if any(interval.state in _AWAY for interval in self._intervals[begin:stop]):
            return True
        nobody = self._timeline.quiet.within(late.start_ns, late.end_ns)
        if nobody > SILENT_PART * (late.end_ns - late.start_ns):
            return True
        return period_changed(self._context, self._history, late.start_ns, late.end_ns)

    def _away(self, command: Command) -> bool:
        return any(lost.start_ns <= command.t_ns < lost.end_ns for lost in self._gone)

    def _passed(self, start_ns: int, end_ns: int) -> int | None:
        """A duration, None where the clock stepped in between."""
        passed = end_ns - start_ns
        nobody = self._timeline.quiet.within(start_ns, end_ns)
        stepped = passed > RESET_WINDOW_NS and nobody > passed / 2
        return None if passed < 0 or stepped else passed


def quantiles_ms(times_ns: list[int]) -> Quantiles | None:
    """Row of the tables [ms] of some times [ns]; None without any."""
    found = Distribution()
    found.add(np.array(times_ns, np.int64))
    return found.quantiles(1e6)


def shares(intervals: list[Interval]) -> dict[str, float]:
    """Share of the told time by state; empty when no time passed."""
    total = sum(i.end_ns - i.start_ns for i in intervals)
    shares: dict[str, float] = {}
    for interval in intervals:
        part = (interval.end_ns - interval.start_ns) / total if total else 0.0
        shares[interval.state.value] = shares.get(interval.state.value, 0.0) + part
    return shares if total else {}
