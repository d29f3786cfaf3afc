"""The NMT state timeline of one node, told from its reduced history (analysis.md section 4)."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence

from syncline_analyzer.context import Context
from syncline_analyzer.extent import MOST_STEPS, SET_BACK_NS
from syncline_analyzer.folds.bus.clock import ClockStep, ClockTable
from syncline_analyzer.folds.nmt.emptied import boots_with_00h
from syncline_analyzer.folds.nmt.events import (
    IN_FLIGHT_NS,
    UNASKED,
    UNSEEN,
    Beat,
    BootUpEvent,
    Certainty,
    Command,
    Ignored,
    Interval,
    Lost,
    MissedMaster,
    NodeHistory,
    PdoSpan,
    Silence,
    Unasked,
    Violation,
)
from syncline_analyzer.folds.nmt.quiet import Quiet
from syncline_analyzer.folds.nmt.reactions import REACTION, Reactions
from syncline_analyzer.folds.nmt.silences import RESET_WINDOW_NS, Silences, loss_of
from syncline_analyzer.folds.nmt.timeout import LOST_FACTOR, off_pace
from syncline_analyzer.folds.nmt.unheeded import in_step, unheeded
from syncline_schemas.batch import Gap
from syncline_schemas.canopen.nmt import (
    RESETS,
    STATE_AFTER_COMMAND,
    STATE_OF_BYTE,
    NmtState,
    command_name,
)
from syncline_schemas.devices import quirks
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

RESET_MARGIN_NS = 1_000_000_000
"""Added to the silence that a device's maker allows after a reset [ns]."""
RESET_QUIET_NS = 4_000_000_000
"""Silence after a reset command that is not held against a node of unknown make [ns]."""
PAIR_NS = 150_000_000
"""A second boot-up this soon after the first belongs to the same start [ns]: devices that send a
pair have 45 ms and 85 ms between the two."""
REACTION_NS = 10_000_000_000
"""An error explains a fall to PRE-OPERATIONAL this long after it [ns]."""
TOLD_LATE_NS = 1_000_000_000
"""A node that was bus-off can tell it this long after its first message [ns]."""
TOLD_PERIODS = 2
"""A node that follows a command has told it after so many periods of its error control."""
_TOLD = (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL, NmtState.STOPPED)
_ENDS_PDOS = (0x02, 0x80)
GOES_ON = "; goes on after a step back of the clock"
_SINCE_STEP = "nothing heard of it since the clock stepped back"


@dataclass(slots=True)
class _Cursor:
    """What is known at one point of the timeline."""

    state: NmtState
    since_ns: int
    command: Command | None = None
    """The last command that nothing has confirmed yet."""
    first: Command | None = None
    """The first of equal commands, of which that is the last."""
    boot_ns: int | None = None
    reset: Command | None = None
    blind: bool = False
    """Nothing was heard of the node since a gap or a silence of the whole bus."""


class _Told(NamedTuple):
    """What was told before a pause: the number of intervals, and the last of them."""

    number: int
    state: NmtState
    certainty: Certainty

    @classmethod
    def of(cls, intervals: Sequence[Interval]) -> "_Told":
        return cls(len(intervals), intervals[-1].state, intervals[-1].certainty)


class Timeline:
    """Tells a node's states; `intervals` are half-open and leave no time out."""

    def __init__(self, context: Context, history: NodeHistory, clock: ClockTable) -> None:
        self._context = context
        self.history = history
        self.quiet = Quiet(clock.silences.get(history.bus, ()))
        self._silences = Silences(context, history, clock, self.quiet)
        self._set_back = _set_back(clock, context.bus_name(history.bus))
        self._quirks = quirks(context.shadow.device(history.bus, history.node))
        self._reactions = Reactions(context, history)
        self._seqs = [beat.seq for beat in history.beats]
        self.intervals: list[Interval] = []
        self.boot_ups: list[BootUpEvent] = []
        self.violations: list[Violation] = []
        self.lost: list[Lost] = []
        self.restarts: list[Lost] = []
        """Silences that an unasked boot-up ends and explains."""
        self.ignored: list[Ignored] = []
        self.changes: list[tuple[int, int, str, str]] = []
        """(seq, t_ns, from, to) of changes that the node reported without a command for them."""
        self.off_pace = off_pace(context, history)
        self.followed = False
        """Whether the node ever did what a command said; the NMT master itself does not."""
        self._heard = False
        self._blank = False
        """Whether its last message told no state."""
        self._said: NmtState | None = None
        """What the node told last."""
        self._fresh_seq: int | None = -1
        """The last boot-up, as long as the node has not told a state since: it may start itself."""
        self._step: ClockStep | None = None
        """The last step back of the clock, until the node is heard after it."""
        self._before: _Told | None = None
        """What was told ahead of a pause of the node's guarding, until anything tells more."""
        self._now = _Cursor(NmtState.UNKNOWN, history.first_ns)
        self._begin(NmtState.UNKNOWN, history.first_ns, "nothing heard of it yet", "assumed", None)
        for _, _, event in sorted(self._events(), key=lambda entry: entry[:2]):
            self._take(event)
        self._close(history.end_ns)
        if context.timed:
            self._forget_unheard()
            told = {id(ignored.command) for ignored in self.ignored}
            resets = unheeded(history, self.intervals, self.boot_ups, context.resolution_ns)
            self.ignored += [each for each in resets if id(each.command) not in told]

    def _events(self) -> Iterator[tuple[int, int, object]]:
        """(seq, order, event): commands before beats, silences before the frame that ends them."""
        history = self.history
        for step in self._set_back:
            yield step.seq, -1, step
        yield from self._silences.events()
        for seq, gap in history.gaps:
            yield seq, 2, gap
        for command in history.commands:
            yield command.seq, 3, command
        for beat in history.beats:
            yield beat.seq, 4, beat
        for span in history.spans:
            yield span.first_seq, 5, span
        for missed in history.missed_masters:
            yield missed.seq, 6, missed

    def _take(self, event: object) -> None:
        match event:
            case Command():
                self._command(event)
            case Beat():
                self._beat(event)
            case PdoSpan():
                self._pdos(event)
            case (Silence() as silence, (int() as timeout_ns, str() as reason)):
                self._silence(silence, timeout_ns, reason)
            case Silence():
                self._heard_again(event)
            case Unasked():
                self._unasked(event)
            case MissedMaster():
                self._missed_master(event)
            case Gap():
                self._gap(event)
            case ClockStep():
                self._step_back(event)

    def _step_back(self, step: ClockStep) -> None:
        """The clock was set back: the state goes on, at stamps that are earlier than before."""
        last, self._step = self.intervals[-1], step
        before_ns = step.t_ns + step.back_ns
        if step.t_ns >= last.start_ns:
            return
        self._close(before_ns)
        cause = last.cause if last.cause.endswith(GOES_ON) else last.cause + GOES_ON
        self.intervals.append(
            Interval(last.state, step.t_ns, step.t_ns, cause, last.certainty, last.evidence)
        )
        self._now.since_ns = step.t_ns

    def _heard_after_step(self, beat: Beat) -> None:
        """The state of a node is not known before its first sign of life after a step back.

        What it tells then is held against its state before all the same.
        """
        step, self._step = self._step, None
        period_ns = self.history.period_ns if beat.kind != "guard answer" else None
        if step is None or period_ns is None or beat.previous_ns <= beat.t_ns:
            return
        t_ns, last = step.t_ns + round(LOST_FACTOR * period_ns), self.intervals[-1]
        if last.start_ns == step.t_ns and last.state in _TOLD and t_ns < beat.t_ns:
            self._begin(NmtState.UNKNOWN, t_ns, _SINCE_STEP, "assumed", None)
            if state_of(beat) is not last.state:
                self._now.state = last.state

    def _forget_unheard(self) -> None:
        """The state of a node that was heard last before the clock was set back is not known long.

        Its silence has no length by the stamps.
        """
        history, last = self.history, self.intervals[-1]
        period_ns = history.period_ns or history.guard_period_ns
        if not self._set_back or period_ns is None or (history.heard_ns or 0) <= history.end_ns:
            return
        t_ns = last.start_ns + round(LOST_FACTOR * period_ns)
        if GOES_ON in last.cause and last.state in _TOLD and t_ns < history.end_ns:
            self._begin(NmtState.UNKNOWN, t_ns, _SINCE_STEP, "assumed", None)
            self._close(history.end_ns)

    def _begin(
        self, state: NmtState, t_ns: int, cause: str, certainty: Certainty, evidence: int | None
    ) -> None:
        """Start a new interval; a time before the present one's start is taken as its start."""
        if self.intervals:
            t_ns = max(t_ns, self.intervals[-1].start_ns)
            self._close(t_ns)
        if self.intervals and self.intervals[-1].start_ns == t_ns and self._may_vanish():
            self.intervals.pop()
        self.intervals.append(Interval(state, t_ns, t_ns, cause, certainty, evidence))
        self._now.state, self._now.since_ns = state, t_ns
        self._before = None

    def _may_vanish(self) -> bool:
        """Whether an interval without length says nothing: all have none in a log without times."""
        return self._context.timed or self.intervals[-1].state is NmtState.UNKNOWN

    def _close(self, t_ns: int) -> None:
        if self.intervals:
            last = self.intervals[-1]
            last.end_ns = max(last.start_ns, t_ns)

    def _command(self, command: Command) -> None:
        state = STATE_AFTER_COMMAND.get(command.specifier)
        if state is None:
            return
        now = self._now
        if command.specifier in RESETS:
            now.reset = command
        again = now.command is not None and now.command.specifier == command.specifier
        first = now.first if again else command
        if now.state is state and state is not NmtState.INITIALISING:
            now.command, now.first, self._before = command, first, None
            return
        restarts = self.restarts and command.t_ns < self.restarts[-1].end_ns
        if restarts or now.state is NmtState.LOST or (command.node == 0 and not self._heard):
            return
        now.command, now.first = command, first
        whom = "all nodes" if command.node == 0 else "the node"
        cause = command.by or f'command "{command_name(command.specifier)}" to {whom}'
        self._begin(state, command.t_ns, cause, "commanded", command.seq)

    def _beat(self, beat: Beat) -> None:
        self._heard_after_step(beat)
        first, self._heard = not self._heard, True
        blind, self._now.blind = self._now.blind, False
        if self._is_boot_up(beat, first):
            self._boot_up(beat, blind)
            return
        again, self._blank = self._blank, beat.kind == "empty"
        if beat.kind == "empty":
            implied = again and self.intervals[-1].certainty == "implied"
            if self._now.state is not NmtState.UNKNOWN and not implied:
                cause = "alive, but its state byte is empty since a remote frame asked for it"
                self._begin(NmtState.UNKNOWN, beat.t_ns, cause, "observed", beat.seq)
            return
        state = state_of(beat)
        if state is None:
            return
        self._take_state(beat, state)
        self._said = state

    def _take_state(self, beat: Beat, state: NmtState) -> None:
        """The node tells its state."""
        self._end_pause(beat, state)
        now, last = self._now, self.intervals[-1]
        command = now.command
        if command is not None and STATE_AFTER_COMMAND[command.specifier] is not state:
            self._note_ignored(now.first or command, beat, state)
        if state is now.state:
            self._confirm(last, beat, state)
            return
        if command is not None and last.certainty == "commanded":
            if abs(beat.t_ns - command.t_ns) <= IN_FLIGHT_NS and self._context.timed:
                return
            if command.specifier in RESETS and command.node == 0 and len(self.intervals) > 1:
                self._take_back(state, beat)
                return
        elif command is not None and STATE_AFTER_COMMAND[command.specifier] is state:
            now.command = None
            name = command_name(command.specifier)
            self._begin(
                state, beat.t_ns, f'{beat.kind} follows "{name}" late', "observed", beat.seq
            )
            return
        elif now.state not in (NmtState.UNKNOWN, NmtState.LOST) and last.certainty != "implied":
            self.changes.append((beat.seq, beat.t_ns, now.state.value, state.value))
        self._begin(state, beat.t_ns, self._cause_of(beat, now.state), "observed", beat.seq)

    def _unasked(self, event: Unasked) -> None:
        """Nobody asks a guarded node any more: nothing tells whether its state stays."""
        if self._now.state not in _TOLD:
            return
        before = self._before or _Told.of(self.intervals)
        passed = (event.t_ns - event.since_ns) / 1e9
        cause = f"{UNASKED} {passed:.3f} s, and nothing else was heard of it"
        if self.history.unseen:
            cause = f"{UNSEEN} {passed:.3f} s: nobody asked it any more, or it is lost"
            cause += "; the log holds no requests"
        self._begin(NmtState.UNKNOWN, event.t_ns, cause, "assumed", None)
        self._before = before

    def _missed_master(self, event: MissedMaster) -> None:
        """A guarded node that nobody asks goes where 1029h:1 lets it, and says so by 8130h."""
        before = self._before or _Told.of(self.intervals)
        known = before.state is NmtState.OPERATIONAL and before.certainty != "commanded"
        went = self._reactions.to(event) if known and self._context.timed else None
        if went is not None:
            self._begin(*went)
            self._before = before

    def _end_pause(self, beat: Beat, state: NmtState) -> None:
        """What a node answers after a pause of its guarding tells how it was in it."""
        before, self._before = self._before, None
        if before is None:
            return
        if before.state is state:
            self._resume(before.number)
            return
        if before.certainty == "observed":
            self.changes.append((beat.seq, beat.t_ns, before.state.value, state.value))
        if len(self.intervals) - before.number > 1 and self.intervals[-2].state is state:
            self._resume(len(self.intervals) - 1)

    def _resume(self, number: int) -> None:
        """Let the last of so many states go on that were told ahead of a pause, or in it."""
        del self.intervals[number:]
        last = self.intervals[-1]
        self._now.state, self._now.since_ns = last.state, last.start_ns
        self._before = None

    def _take_back(self, state: NmtState, beat: Beat) -> None:
        """A node that goes on after a reset of all, the NMT master above all, was not reset."""
        self.intervals.pop()
        last = self.intervals[-1]
        self._now.state, self._now.since_ns = last.state, last.start_ns
        self._now.command = self._now.reset = None
        if state is not last.state:
            self._begin(state, beat.t_ns, f"{beat.kind} says so", "observed", beat.seq)

    def _confirm(self, last: Interval, beat: Beat, state: NmtState) -> None:
        """The node says the state that is told already."""
        self._fresh_seq = -1
        if last.certainty == "commanded":
            self.followed = self.followed or self._said is not state
            last.cause += f", confirmed by {beat.kind}"
            if self._context.timed and GOES_ON not in last.cause:
                last.cause += f" after {max(0, beat.t_ns - last.start_ns) / 1e6:.1f} ms"
        elif last.certainty == "implied":
            last.cause += f", confirmed by {beat.kind}"
        last.certainty = "observed"
        last.evidence = beat.seq if last.evidence is None else last.evidence
        command = self._now.command
        if command is not None and STATE_AFTER_COMMAND[command.specifier] is state:
            self._now.command = None

    def _note_ignored(self, command: Command, beat: Beat, state: NmtState) -> None:
        """A contradiction counts once a period of the error control has passed.

        Of a reset that was followed a boot-up tells, by a node that is known to send any.
        """
        patience = self.history.period_ns
        if patience is None or not self._context.timed or command.by:
            return
        if command.specifier in RESETS:
            if not self.boot_ups or state is NmtState.PRE_OPERATIONAL:
                return
            patience = max(patience, self.reset_quiet_ns)
        passed = beat.t_ns - command.t_ns
        if passed - self.quiet.within(command.t_ns, beat.t_ns) > patience:
            self.ignored.append(Ignored(command, beat.seq, beat.t_ns, state.value))
            self._now.command = None

    def _note_against(self, span: PdoSpan) -> None:
        """PDOs that go on for two periods after a command contradict it, if no state is told."""
        command, patience = self._now.command, self.history.period_ns
        if command is None or patience is None or command.by or not self._context.timed:
            return
        if span.guess or span.asked or command.specifier not in _ENDS_PDOS:
            return
        due_ns = command.t_ns + TOLD_PERIODS * patience
        if span.last_ns - self.quiet.within(command.t_ns, span.last_ns) <= due_ns:
            return
        t_ns = min(span.last_ns, max(span.first_ns, due_ns))
        seq = span.first_seq if span.late_seq is None else span.late_seq
        state = NmtState.OPERATIONAL.value
        self.ignored.append(Ignored(self._now.first or command, seq, t_ns, state, span.can_id))
        self._now.command = None

    def _cause_of(self, beat: Beat, before: NmtState) -> str:
        if before in (NmtState.UNKNOWN, NmtState.LOST):
            return f"{beat.kind} says so"
        command = self._now.command
        if before is NmtState.INITIALISING and self._now.reset is not None:
            return f"{beat.kind} says so, no boot-up was seen"
        if command is not None and STATE_AFTER_COMMAND.get(command.specifier) is before:
            return f'{beat.kind} says so, against the command "{command_name(command.specifier)}"'
        return f"{beat.kind} says so, no command seen"

    def _is_boot_up(self, beat: Beat, first: bool) -> bool:
        """00h as classified; another byte by the device's habit, after a reset, silence or fall."""
        if beat.kind == "boot-up":
            return True
        if beat.kind != "heartbeat" or beat.state not in self._quirks.bootup_bytes:
            return False
        now = self._now
        if now.reset is not None and (first or now.state is NmtState.INITIALISING):
            return True
        if now.state in (NmtState.OPERATIONAL, NmtState.STOPPED):
            return self._fell_by_restart(beat)
        back = now.state is NmtState.LOST and beat.t_ns - beat.previous_ns >= 0
        return back and not self._boots_with_00h()

    def _fell_by_restart(self, beat: Beat) -> bool:
        """A fall to PRE-OPERATIONAL that neither a command, an error nor a second device explains.

        LIR protocol manual, sheet skbis-lir-canopen.md traps 1 and 17.
        """
        if self.intervals[-1].certainty != "observed" or self._now.command is not None:
            return False
        history = self.history
        known = self._context.shadow.get(history.bus, history.node, REACTION, 1, beat.seq)
        if known is not None and known.source != "eds-default" and known.value == 0:
            return False
        if self._boots_with_00h():
            return False
        told = any(
            -TOLD_LATE_NS <= beat.t_ns - t_ns <= REACTION_NS and not self._told_since(t_ns, beat)
            for t_ns in history.communication_errors
        )
        return not told and self._stays(beat) and not self._in_step(beat)

    def _in_step(self, fall: Beat) -> bool:
        """Whether the heartbeat keeps its rhythm over a fall, as none does of a node that restarts."""
        after = self.history.beats[bisect_right(self._seqs, fall.seq) :][:1]
        if not after or after[0].after_ns != fall.t_ns or fall.after_ns is None:
            return False
        around = [beat for beat in (fall, after[0]) if beat.kind == "heartbeat"]
        return len(around) == 2 and in_step(self.history, around, self._context.resolution_ns)

    def _told_since(self, t_ns: int, fall: Beat) -> bool:
        """Whether heartbeats went on as before after an error: the reaction to it comes at once."""
        period_ns = self.history.period_ns
        return (
            period_ns is not None
            and fall.previous_ns - t_ns > TOLD_LATE_NS + TOLD_PERIODS * period_ns
        )

    def _boots_with_00h(self) -> bool:
        """Whether the node booted with 00h before, and still does."""
        last = self.boot_ups[-1] if self.boot_ups else None
        place = (self.history.bus, self.history.node)
        return last is not None and boots_with_00h(self._context, place, last.seq, last.byte)

    def _stays(self, beat: Beat) -> bool:
        """Whether the node says the same state until a command comes; two devices do not."""
        if any(after == NmtState.OPERATIONAL.value for _, _, _, after in self.changes):
            return False
        history = self.history
        following = history.beats[bisect_right(self._seqs, beat.seq) :]
        other = next((each.seq for each in following if each.state != beat.state), None)
        if other is None:
            return True
        return any(beat.seq < command.seq < other for command in history.commands)

    def _boot_up(self, beat: Beat, blind: bool) -> None:
        now = self._now
        reset = now.reset
        commanded = reset is not None and self._soon_after(reset, beat)
        repeated = (
            self._context.timed
            and now.boot_ns is not None
            and 0 <= beat.t_ns - now.boot_ns <= PAIR_NS
            and now.reset is None
        )
        seq, t_ns = (reset.seq, reset.t_ns) if reset and commanded else (None, None)
        blind = blind or self._switched_on(beat)
        event = BootUpEvent(beat.seq, beat.t_ns, beat.state, seq, t_ns, repeated, blind)
        self.boot_ups.append(event)
        if not repeated:
            if commanded and now.state is NmtState.OPERATIONAL:
                self._started_too_soon(beat)
            elif now.state not in (NmtState.INITIALISING, NmtState.LOST, NmtState.UNKNOWN):
                cause = "it started anew without a command, some time after its last sign of life"
                start = min(beat.previous_ns, beat.t_ns) if self._context.timed else beat.t_ns
                self._begin(NmtState.INITIALISING, start, cause, "implied", beat.seq)
            cause = "boot-up after a reset command" if commanded else "boot-up"
            self._begin(NmtState.PRE_OPERATIONAL, beat.t_ns, cause, "observed", beat.seq)
            self._fresh_seq = beat.seq
        self._said = NmtState.PRE_OPERATIONAL
        self.followed = self.followed or commanded
        now.boot_ns, now.reset, now.command = beat.t_ns, None, None

    def _started_too_soon(self, beat: Beat) -> None:
        """A start that came between a reset and its boot-up, when a node follows none."""
        command, last = self._now.command, self.intervals[-1]
        if command is None or last.certainty != "commanded":
            return
        cause = "it was still starting when it was commanded to start"
        self._begin(NmtState.INITIALISING, last.start_ns, cause, "implied", beat.seq)
        if self._context.timed and not any(c.seq > beat.seq for c in self.history.commands):
            state = NmtState.PRE_OPERATIONAL.value
            self.ignored.append(Ignored(command, beat.seq, beat.t_ns, state, starting=True))

    def _soon_after(self, reset: Command, beat: Beat) -> bool:
        """Whether a boot-up is the effect of a reset; a step of the clock in between is no time."""
        passed = beat.t_ns - reset.t_ns
        if not self._context.timed or passed <= RESET_WINDOW_NS:
            return True
        return passed - self.quiet.within(reset.t_ns, beat.t_ns) <= RESET_WINDOW_NS

    def _pdos(self, span: PdoSpan) -> None:
        self._now.blind = False
        self._note_against(span)
        if self._before is not None and self._before.state is NmtState.OPERATIONAL:
            self._resume(self._before.number)
        now, last = self._now, self.intervals[-1]
        fresh = now.state is NmtState.PRE_OPERATIONAL and last.evidence == self._fresh_seq
        if now.state in (NmtState.UNKNOWN, NmtState.LOST) or fresh:
            cause = f"PDO {span.can_id:03X}h, which only an OPERATIONAL node sends"
            self._begin(NmtState.OPERATIONAL, span.first_ns, cause, "implied", span.first_seq)
        elif now.state is NmtState.OPERATIONAL or span.asked or not self._context.timed:
            return
        elif span.late_seq is not None:
            self.violations.append(
                Violation(
                    span.can_id,
                    now.state,
                    span.late_seq,
                    span.late_ns,
                    span.last_ns,
                    span.late_count,
                    span.guess,
                    self.intervals[-1].certainty,
                )
            )

    def _silence(self, silence: Silence, timeout_ns: int, reason: str) -> None:
        now = self._now
        start = silence.start_ns + timeout_ns
        starting = now.state is NmtState.INITIALISING or self._unheard_since_reset(silence)
        if starting:
            quiet = self.reset_quiet_ns
            since = now.reset.t_ns if now.reset else silence.start_ns
            passed = silence.end_ns - since
            if passed - self.quiet.within(since, silence.end_ns) <= quiet:
                return
            start = max(start, since + quiet)
        bootup_bytes = (0,) if self._boots_with_00h() else self._quirks.bootup_bytes
        anew = self._silences.starts_anew(silence, bootup_bytes)
        whole = self._silences.whole_bus(silence, timeout_ns, anew)
        went_on = not anew or self._silences.went_on(silence.start_ns, silence.end_ns)
        before = (NmtState.INITIALISING if starting else now.state).value
        now.command = None
        booted_seq = self.boot_ups[-1].seq if self.boot_ups else -1
        if self._silences.is_restart(silence, whole, booted_seq):
            cause = "it started anew without a command, some time after its last sign of life"
            self._begin(NmtState.INITIALISING, silence.start_ns, cause, "implied", silence.end_seq)
            self.restarts.append(
                loss_of(silence, silence.start_ns, timeout_ns, reason, before, whole)
            )
            return
        if whole and went_on and silence.end_seq is not None:
            cause = (
                "no frame of anybody on the bus: switched off, not recorded, or the clock stepped"
            )
            self._begin(NmtState.UNKNOWN, start, cause, "assumed", None)
            now.blind = True
            return
        cause = f"silent for {(silence.end_ns - silence.start_ns) / 1e9:.3f} s, {reason}"
        if whole:
            cause += "; nobody else was heard either"
        self._begin(NmtState.LOST, start, cause, "observed", silence.start_seq)
        self.lost.append(loss_of(silence, start, timeout_ns, reason, before, whole))

    def _unheard_since_reset(self, silence: Silence) -> bool:
        """Whether a node has not been heard since a reset: it follows no start before it booted."""
        reset = self._now.reset
        return reset is not None and silence.start_ns <= reset.t_ns + IN_FLIGHT_NS

    def _heard_again(self, silence: Silence) -> None:
        if self._now.state is NmtState.LOST:
            cause = "heard again, but it has not told its state"
            self._begin(NmtState.UNKNOWN, silence.end_ns, cause, "assumed", silence.end_seq)

    def _switched_on(self, beat: Beat) -> bool:
        """Whether the machine may have been off since the node was heard last."""
        return not self.history.alone and self.quiet.off(beat.previous_ns, beat.t_ns) is not None

    def _gap(self, gap: Gap) -> None:
        cause = f"the recorder was blind ({gap.reason}); nothing heard since"
        self._begin(NmtState.UNKNOWN, gap.start_ns, cause, "assumed", None)
        self._now.command = self._now.reset = self._now.boot_ns = None
        self._now.blind = True

    @property
    def reset_quiet_ns(self) -> int:
        """Silence after a reset that is not held against the node [ns]."""
        known = self._quirks.reset_quiet_ms * 1_000_000
        return (known or RESET_QUIET_NS) + RESET_MARGIN_NS


def _set_back(clock: ClockTable, bus: str) -> list[ClockStep]:
    """Steps back of the clock of a bus; stamps that run back again and again are disorder."""
    steps = [step for step in clock.steps if step.bus == bus and step.back_ns >= SET_BACK_NS]
    return steps if len(steps) <= MOST_STEPS else []


def state_of(beat: Beat) -> NmtState | None:
    """The state that a message tells, None for one that tells none."""
    if beat.kind == "boot-up":
        return NmtState.PRE_OPERATIONAL
    return None if beat.kind == "empty" else STATE_OF_BYTE.get(beat.state)
