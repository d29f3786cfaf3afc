"""How a PDO is sent: its transmission type as told, or as its frames show it."""

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.rhythm import LEARN
from syncline_analyzer.shadow import Known
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Sending:
    """Transmission type of a row, where it comes from, and n of a synchronous PDO."""

    type: int | None
    source: str
    synchronous: bool = False
    every: int = 1


def sending(state: PdoState, sync_ns: float, context: Context) -> Sending:
    """The transmission type as told; a mere default only where the frames do not contradict it."""
    judged = context.timed and not state.polled()
    inferred = _inferred(state, sync_ns) if judged else Sending(None, "unknown")
    known = state.transmission.type if state.transmission else None
    if known is None or not isinstance(known.value, int):
        return inferred
    told = _told(known)
    if known.source == "eds-default" and inferred.source != "unknown":
        agree = told.synchronous == inferred.synchronous and (
            told.every == inferred.every or told.type == 0
        )
        event_on_sync = told.type == 0 and not inferred.synchronous
        # Frames every n periods of a steady SYNC look the same from a timer of that length.
        by_timer = (
            inferred.synchronous
            and not told.synchronous
            and not state.timer_excluded(context.resolution_ns)
        )
        return told if agree or event_on_sync or by_timer else inferred
    return told


def by_chance(state: PdoState, sending: Sending, context: Context) -> bool:
    """Whether a PDO whose sender was not told to be synchronous keeps step with SYNC by chance.

    A timer of n SYNC periods looks the same, and so do new values at that pace: who sends those
    owes nothing when the value stands still. The sender of an RPDO often sends SYNC as well, and
    its type (140xh:2) says when it is taken over, not when it is sent.
    """
    rpdo = state.owner is not None and state.owner.kind == "rpdo"
    inferred = sending.source.startswith("inferred")
    if not rpdo and (not inferred or sending.every == 1):
        return False
    steady = state.sent_by_timer() and not rpdo
    return not steady and not state.timer_excluded(context.resolution_ns)


def _told(known: Known) -> Sending:
    number = known.value if isinstance(known.value, int) else 0
    return Sending(number, known.source, number <= 0xF0, max(1, number) if number <= 0xF0 else 1)


def _inferred(state: PdoState, sync_ns: float) -> Sending:
    """What the frames say (analysis.md section 5)."""
    every = state.answers_sync(sync_ns)
    if every is not None:
        which = "every SYNC" if every == 1 else f"every {_ordinal(every)} SYNC"
        return Sending(every, f"inferred: synchronous, {which}", True, every)
    if state.period.count < LEARN - 1:
        return Sending(None, "unknown")
    if state.cyclic():
        return Sending(None, f"inferred: cyclic, {state.period.quantile(0.5) / 1e6:.4g} ms")
    return Sending(None, "inferred: event-driven")


def _ordinal(number: int) -> str:
    """
    >>> [_ordinal(n) for n in (2, 3, 4, 11, 21)]
    ['2nd', '3rd', '4th', '11th', '21st']
    """
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10)
    return f"{number}{ending or 'th'}"


def due_step_ns(state: PdoState, sending: Sending, sync_ns: float) -> float:
    """Time between two moments at which the PDO is due."""
    if sending.synchronous:
        return sync_ns * sending.every
    return float(state.told_timer_ns() or 0)
