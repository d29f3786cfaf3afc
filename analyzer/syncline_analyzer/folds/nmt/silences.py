"""Silences of one node: which are its own, a restart's, or those of everybody."""

from bisect import bisect_left
from collections.abc import Container, Iterator

from syncline_analyzer.context import Context
from syncline_analyzer.folds.bus.clock import ClockTable
from syncline_analyzer.folds.nmt.events import Lost, NodeHistory, Silence, Unasked
from syncline_analyzer.folds.nmt.quiet import Quiet
from syncline_analyzer.folds.nmt.timeout import silence_limit, unasked_limit, watchers
from syncline_schemas.canopen.nmt import RESETS, STATE_AFTER_COMMAND, NmtState

RESTART_NS = 10_000_000_000
"""A silence that a boot-up ends is a restart up to this length, longer ones are losses [ns]."""
ALONE_RESTART_NS = 2_000_000_000
"""The same for the only node of a bus that was silent altogether: nobody switches a machine off and
on in less, and beyond it that is the likelier story [ns]."""
RESET_WINDOW_NS = 10_000_000_000
"""A boot-up this long after a reset command is still its effect [ns]."""
ALIKE = 3
"""So many long intervals of one length in a row are a period, not silences."""
FADE_NS = 3_000_000_000
"""Nodes of a machine that is switched off fall silent within this time of one another [ns]."""
BUS_SHARE = 0.8
"""Part of a node's silence during which the whole bus was silent that makes it the bus's."""


class Silences:
    """Judges the silences of a node."""

    def __init__(
        self, context: Context, history: NodeHistory, clock: ClockTable, quiet: Quiet
    ) -> None:
        self._context = context
        self._history = history
        self._clock = clock
        self._quiet = quiet
        self._seqs = [beat.seq for beat in history.beats]
        self._watching = watchers(context, history.bus)

    def events(self) -> Iterator[tuple[int, int, object]]:
        """(seq, order, event): the node gets LOST, or it is heard again."""
        for silence in self._periodic(self._history.silences):
            yield from self._events_of(silence)

    def _periodic(self, silences: list[Silence]) -> Iterator[Silence]:
        """Leave out those that are a new, longer period: several alike, one after the other."""
        run: list[Silence] = []
        for silence in silences:
            if run and not _continues(run[-1], silence):
                yield from run if len(run) < ALIKE else ()
                run = []
            run.append(silence)
        yield from run if len(run) < ALIKE else ()

    def _events_of(self, silence: Silence) -> Iterator[tuple[int, int, object]]:
        """Where in the order of `seq` a node gets LOST: commands may come before and after."""
        timeout = silence_limit(self._context, self._history, silence, self._watching)
        if timeout is None:
            yield from self._unasked(silence)
            return
        if silence.end_ns <= silence.start_ns + timeout[0]:
            return
        yield self._order(silence, silence.start_ns + timeout[0]), 0, (silence, timeout)
        if silence.end_seq is not None and not self._is_beat(silence.end_seq):
            yield silence.order, 1, silence

    def _unasked(self, silence: Silence) -> Iterator[tuple[int, int, object]]:
        """Where in the order of `seq` the state of a guarded node is not known any more."""
        limit = unasked_limit(self._context, self._history, silence)
        if limit is not None and silence.end_ns > silence.start_ns + limit:
            t_ns = silence.start_ns + limit
            yield self._order(silence, t_ns), 0, Unasked(t_ns, silence.start_ns)

    def _order(self, silence: Silence, t_ns: int) -> int:
        """The `seq` at which a moment of a silence is told: before the first command after it."""
        later = [
            command.seq
            for command in self._history.commands
            if silence.start_seq < command.seq and command.t_ns >= t_ns
        ]
        return min([silence.order, *later[:1]])

    def _is_beat(self, seq: int) -> bool:
        at = bisect_left(self._seqs, seq)
        return at < len(self._seqs) and self._seqs[at] == seq

    def whole_bus(self, silence: Silence, timeout_ns: int, anew: bool) -> bool:
        """Whether a silence is that of everybody, and no restart of this node alone.

        The machine was off if nobody was heard for long enough, from soon after the node was heard
        last: supplies hold some nodes up for seconds, and some, the master above all, take longer
        to start.
        """
        if not anew or self._history.alone:
            return self._of_the_bus(silence, timeout_ns)
        off_ns = self._quiet.off(silence.start_ns, silence.end_ns)
        if off_ns is None or off_ns - silence.start_ns > max(timeout_ns, FADE_NS):
            return False
        # With the machine off the others would have started anew as well.
        apart = off_ns - silence.start_ns > timeout_ns
        return not (apart and self._others_beat_on(silence.start_ns, silence.end_ns))

    def _of_the_bus(self, silence: Silence, timeout_ns: int) -> bool:
        """Whether nobody was heard for most of a silence, or for what makes it too long."""
        history = self._history
        if history.witnesses.prove(history.node, silence.start_ns, silence.end_ns):
            return False
        passed = silence.end_ns - silence.start_ns
        bus = self._clock.silence_within(self._history.bus, silence.start_ns, silence.end_ns)
        if bus is not None and bus.end_ns - bus.start_ns >= BUS_SHARE * passed:
            return True
        if history.witnesses.agree(history.node, silence.start_ns, silence.end_ns):
            return True
        nobody = self._quiet.within(silence.start_ns, silence.end_ns)
        return nobody > 0 and passed - nobody <= timeout_ns

    def went_on(self, start_ns: int, end_ns: int) -> bool:
        """Whether the other nodes of the bus did not start anew when this one did."""
        anew = self._history.others_anew
        at = bisect_left(anew, start_ns)
        return not self._history.alone and (at == len(anew) or anew[at] > end_ns + RESTART_NS)

    def _others_beat_on(self, start_ns: int, end_ns: int) -> bool:
        """Whether the heartbeat of another node went on over a stretch, and none started anew."""
        until_ns = end_ns + FADE_NS
        anew = self._history.others_anew
        at = bisect_left(anew, start_ns)
        beat = any(
            first <= start_ns and last > until_ns for first, last in self._history.others_beat
        )
        return beat and (at == len(anew) or anew[at] > until_ns)

    def is_restart(self, silence: Silence, whole: bool, booted_seq: int) -> bool:
        """Whether an unasked boot-up ends a silence no longer than a restart may take.

        A reset before the last boot-up, which has `booted_seq`, explains no further one.
        """
        end_seq = silence.end_seq
        longest = RESTART_NS
        if whole:
            longest = ALONE_RESTART_NS if self._history.alone else 0
        if end_seq is None or silence.end_ns - silence.start_ns > longest:
            return False
        at = bisect_left(self._seqs, end_seq)
        if not self._is_beat(end_seq) or self._history.beats[at].kind != "boot-up":
            return False
        return not any(
            command.specifier in RESETS
            and booted_seq < command.seq < end_seq
            and silence.end_ns - command.t_ns <= RESET_WINDOW_NS
            for command in self._history.commands
        )

    def starts_anew(self, silence: Silence, bootup_bytes: Container[int]) -> bool:
        """Whether the node's first message after a silence is a boot-up, or may be one.

        A state that it was told to take in the silence is none.
        """
        if silence.end_seq is None:
            return False
        at = bisect_left(self._seqs, silence.end_seq)
        following = self._history.beats[at : at + 1]
        told = any(
            STATE_AFTER_COMMAND.get(command.specifier) is NmtState.PRE_OPERATIONAL
            and silence.start_seq < command.seq < silence.end_seq
            for command in self._history.commands
        )
        return any(
            beat.kind == "boot-up" or (beat.state in bootup_bytes and not told)
            for beat in following
        )


def loss_of(
    silence: Silence, start_ns: int, timeout_ns: int, reason: str, before: str, whole: bool
) -> Lost:
    return Lost(
        start_ns,
        silence.end_ns,
        silence.start_seq,
        silence.start_ns,
        silence.end_seq,
        timeout_ns,
        reason,
        before,
        whole,
    )


def _continues(before: Silence, after: Silence) -> bool:
    """Whether a silence begins where one of the same length ended."""
    lengths = [silence.end_ns - silence.start_ns for silence in (before, after)]
    return before.end_ns == after.start_ns and max(lengths) < 1.2 * min(lengths)
