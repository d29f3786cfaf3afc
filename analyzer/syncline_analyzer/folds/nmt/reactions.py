"""Where a node goes by itself when it misses its master: EMCY 8130h and 1029h:1 (CiA 301 7.5.2.27)."""

from bisect import bisect_right

from syncline_analyzer.context import Context
from syncline_analyzer.folds.nmt.events import (
    IN_FLIGHT_NS,
    Certainty,
    MissedMaster,
    NodeHistory,
    PdoSpan,
)
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.devices import quirks
from syncline_schemas.named_tuples import NamedTuple

REACTION = 0x1029
"""What a node does after a communication error: subindex 1, 0 for PRE-OPERATIONAL."""
STATES = {0: NmtState.PRE_OPERATIONAL, 2: NmtState.STOPPED}
"""By value of 1029h:1; 1 changes nothing."""
RHYTHM = 3
"""So many PDOs tell how often they come."""


class Reaction(NamedTuple):
    """The state that a node went to, as an interval begins."""

    state: NmtState
    t_ns: int
    cause: str
    certainty: Certainty
    evidence: int


class Reactions:
    """Judges the EMCYs by which an OPERATIONAL node misses its master."""

    def __init__(self, context: Context, history: NodeHistory) -> None:
        self._context = context
        self._history = history

    def to(self, missed: MissedMaster) -> Reaction | None:
        """Where the node went; None where it is asked on and will say so, or does not react.

        What 1029h:1 is by default is assumed, unless the node's PDOs ended with the EMCY.
        """
        if not self._unasked(missed) or self._sends_on(missed):
            return None
        state, source, known = self._told(missed)
        if state is None:
            return None
        ended = any(_ends(span, missed) for span in self._history.spans)
        cause = f"EMCY 8130h: it missed its master ({source})"
        cause += ", and its PDOs ended" if ended else ""
        certainty: Certainty = "implied" if ended or known else "assumed"
        return Reaction(state, missed.t_ns, cause, certainty, missed.seq)

    def _told(self, missed: MissedMaster) -> tuple[NmtState | None, str, bool]:
        """The state that a node's settings tell, their source, and whether they are known."""
        shadow, place = self._context.shadow, (self._history.bus, self._history.node)
        device = shadow.device(*place)
        if quirks(device).life_guard_reaction == "pre-operational":
            return NmtState.PRE_OPERATIONAL, "this device does so whatever 1029h says", True
        known = shadow.get(*place, REACTION, 1, missed.seq)
        value = known.value if known is not None else 0
        source = known.source if known is not None else "by default, it is not known here"
        state = STATES.get(value) if isinstance(value, int) else None
        return state, f"1029h:1 = {value!r}, {source}", known is not None

    def _unasked(self, missed: MissedMaster) -> bool:
        """Whether the node is guarded, and no answer of it tells its state soon."""
        history, at = self._history, self._at(missed)
        if not at or history.beats[at - 1].kind != "guard answer":
            return False
        if history.told_ns is not None and missed.t_ns >= history.told_ns:
            return True
        return any(
            silence.kind == "guard answer" and silence.start_ns <= missed.t_ns <= silence.end_ns
            for silence in history.silences
        )

    def _sends_on(self, missed: MissedMaster) -> bool:
        """Whether PDOs come after the EMCY, with neither a command nor a state between."""
        history = self._history
        ends = [command.seq for command in history.commands if command.seq > missed.seq][:1]
        ends += [beat.seq for beat in history.beats[self._at(missed) :][:1]]
        until = min(ends, default=None)
        return any(
            span.last_ns > missed.t_ns + IN_FLIGHT_NS and (until is None or span.first_seq < until)
            for span in history.spans
        )

    def _at(self, missed: MissedMaster) -> int:
        """How many of the kept messages came before the EMCY."""
        return bisect_right(self._history.beats, missed.seq, key=lambda beat: beat.seq)


def _ends(span: PdoSpan, missed: MissedMaster) -> bool:
    """Whether PDOs came regularly until then: none is missing before it."""
    if span.asked or span.count < RHYTHM or span.first_ns > missed.t_ns:
        return False
    period_ns = (span.last_ns - span.first_ns) / (span.count - 1)
    return missed.t_ns - span.last_ns <= 2 * period_ns
