"""How long a node may be silent before it is LOST, and where that number comes from."""

from collections.abc import Iterable, Iterator

from syncline_analyzer.context import Context
from syncline_analyzer.folds.nmt.events import NodeHistory, OffPace, Silence
from syncline_analyzer.folds.nmt.pace import ENOUGH, Pace
from syncline_analyzer.shadow import Known
from syncline_schemas.devices import quirks

LOST_FACTOR = 1.5
"""Producer heartbeat times without a message after which a node is LOST (analysis.md 4)."""
FAST_FACTOR = 0.7
"""A heartbeat whose period is a smaller part of 1017h is too fast."""
NO_EFFECT_NS = 10_000_000_000
"""A heartbeat that goes on as before for so long after a write of 1017h does not heed it [ns]."""
KEPT = 0.1
"""Part by which the period of a heartbeat that keeps 1017h may be off."""
MISSED_GUARDS = 2
"""Guard requests in a row without an answer that make a node lost; a single one may go astray."""
PRODUCER_TIME = 0x1017
GUARD_TIME, LIFE_TIME_FACTOR = 0x100C, 0x100D
CONSUMER_TIME = 0x1016


def silence_limit(
    context: Context, history: NodeHistory, silence: Silence, watching: Iterable[int]
) -> tuple[int, str] | None:
    """Silence after which the node is LOST [ns], and where the number comes from.

    `watching` are the `watchers` of its bus.
    """
    if not context.timed or silence.kind == "boot-up":
        return None
    median = silence.period_ns
    if median is not None and silence.end_ns >= history.period_since_ns:
        median = max(median, history.period_ns or 0)
    if silence.kind == "guard answer":
        return _guarded(context, history, silence)
    producer = _producer_ms(context, history, silence)
    if producer is not None and producer[0] == 0:
        return None
    consumer = _consumer_ns(context, history, silence.start_seq, watching)
    if consumer is not None and (median is None or consumer[0] > median):
        return consumer
    if producer is not None:
        limit = round(LOST_FACTOR * producer[0] * 1e6)
        if median is None or limit > median:
            return limit, f"1.5 times its 1017h of {producer[0]} ms ({producer[1]})"
    if median is None:
        return None
    return round(LOST_FACTOR * median), f"1.5 times its usual period of {median / 1e6:.1f} ms"


def _guarded(context: Context, history: NodeHistory, silence: Silence) -> tuple[int, str] | None:
    """A guarded node is judged only while it is asked; its life time is 100Ch x 100Dh."""
    median = silence.period_ns
    if silence.requests < MISSED_GUARDS or median is None:
        return None
    limit = round(LOST_FACTOR * max(median, history.guard_period_ns or 0))
    life = life_time_ns(context, history.bus, history.node, silence.start_seq)
    if life is not None and life[0] > limit:
        return life[0], f"{silence.requests} guard requests not answered in its {life[1]}"
    return limit, f"{silence.requests} guard requests not answered"


def unasked_limit(context: Context, history: NodeHistory, silence: Silence) -> int | None:
    """Silence after which nothing tells the state of a guarded node that nobody asks [ns].

    That is its life time, or the usual period of the requests where that is longer or not known.
    """
    usual = silence.period_ns
    if not context.timed or silence.kind != "guard answer" or usual is None:
        return None
    if silence.requests >= MISSED_GUARDS:
        return None
    limit = round(LOST_FACTOR * max(usual, history.guard_period_ns or 0))
    life = life_time_ns(context, history.bus, history.node, silence.start_seq)
    return max(limit, life[0]) if life is not None else limit


def life_time_ns(context: Context, bus: int, node: int, seq: int) -> tuple[int, str] | None:
    """Node life time [ns] and where it comes from (CiA 301 7.2.8.2.1); None while it is off."""
    time, factor = (
        context.shadow.get(bus, node, i, 0, seq) for i in (GUARD_TIME, LIFE_TIME_FACTOR)
    )
    if time is None or factor is None or "eds-default" in (time.source, factor.source):
        return None
    ms = _number(time) * _number(factor)
    if not ms:
        return None
    return ms * 1_000_000, f"life time of {ms} ms (100Ch x 100Dh, {factor.source})"


def _producer_ms(
    context: Context, history: NodeHistory, silence: Silence
) -> tuple[int, str] | None:
    """The longest 1017h that held from the last heartbeat on; 0 when it was switched off."""
    end_seq = silence.order if silence.end_seq is None else silence.end_seq
    known = _values_between(context, history, silence.start_seq, end_seq)
    period = silence.period_ns or 0
    for entry in known:
        written = entry.t_ns is not None and entry.t_ns >= silence.start_ns - 2 * period
        if not _number(entry) and written and entry.source.startswith("sdo"):
            return 0, entry.source
    longest = max(known, key=_number, default=None)
    return (_number(longest), longest.source) if longest and _number(longest) else None


def _values_between(
    context: Context, history: NodeHistory, start_seq: int, end_seq: int
) -> list[Known]:
    shadow, place = context.shadow, (history.bus, history.node, PRODUCER_TIME, 0)
    seqs = [start_seq, *(s for s in shadow.changes(*place) if start_seq < s <= end_seq)]
    found = (shadow.get(*place, seq) for seq in seqs)
    return [known for known in found if known is not None]


def period_changed(context: Context, history: NodeHistory, start_ns: int, end_ns: int) -> bool:
    """Whether 1017h changed in a stretch of time."""
    place = (history.bus, history.node, PRODUCER_TIME, 0)
    known = (context.shadow.get(*place, seq) for seq in context.shadow.changes(*place))
    return any(k is not None and k.t_ns is not None and start_ns <= k.t_ns <= end_ns for k in known)


def _consumer_ns(
    context: Context, history: NodeHistory, seq: int, watching: Iterable[int]
) -> tuple[int, str] | None:
    """The shortest 1016h time of a node that watches this one, as far as the bus told it."""
    found = [
        (ms, watcher, sub, known.source)
        for watcher, sub, watched, ms, known in consumer_times(context, history.bus, seq, watching)
        if watched == history.node != watcher
    ]
    if not found:
        return None
    ms, node, sub, source = min(found)
    return ms * 1_000_000, f"the {ms} ms that node {node} allows it (1016h:{sub}, {source})"


def watchers(context: Context, bus: int) -> list[int]:
    """Nodes of a bus of which it was ever known that they watch the heartbeat of others (1016h)."""
    shadow = context.shadow
    return [
        node
        for on, node in shadow.nodes()
        if on == bus
        and quirks(shadow.device(on, node)).consumes_heartbeat
        and (
            shadow.changes(on, node, CONSUMER_TIME, 1)
            or shadow.assumed(on, node, CONSUMER_TIME, 1) is not None
        )
    ]


def consumer_times(
    context: Context, bus: int, seq: int | None = None, watching: Iterable[int] | None = None
) -> Iterator[tuple[int, int, int, int, Known]]:
    """(watching node, sub, watched node, time [ms], value) of every 1016h entry on a bus.

    `watching` are its `watchers`, where they are known.
    """
    for node in watchers(context, bus) if watching is None else watching:
        for sub in range(1, 128):
            known = context.shadow.get(bus, node, CONSUMER_TIME, sub, seq)
            if known is None:
                break
            value = _number(known)
            if value >> 16 & 0x7F and value & 0xFFFF:
                yield node, sub, value >> 16 & 0x7F, value & 0xFFFF, known


def off_pace(context: Context, history: NodeHistory) -> list[OffPace]:
    """Stretches in which the heartbeat came at more than 1.5, or less than 0.7 times 1017h."""
    paces = sorted([*history.paces, *history.stretches], key=lambda pace: pace.first_seq)
    found: list[OffPace] = []
    for pace in paces:
        entry = _off_pace(context, history, pace) if pace.number >= ENOUGH else None
        if entry is not None and not (found and entry.first_seq <= found[-1].last_seq):
            found.append(entry)
    return found


def _off_pace(context: Context, history: NodeHistory, pace: Pace) -> OffPace | None:
    shadow, place = context.shadow, (history.bus, history.node, PRODUCER_TIME, 0)
    changes = [seq for seq in shadow.changes(*place) if pace.first_seq < seq <= pace.last_seq]
    known = shadow.get(*place, changes[-1] if changes else pace.first_seq)
    if known is None or known.source == "eds-default":
        return None
    start = (pace.first_seq, pace.first_ns)
    if _may_be_gone(history, known, pace.last_ns if changes else pace.first_ns):
        return None
    if changes:
        if known.t_ns is None or pace.last_ns - known.t_ns < NO_EFFECT_NS:
            return None
        start = (changes[-1], known.t_ns)
    value = _number(known)
    if not value or FAST_FACTOR <= pace.median_ns / (value * 1e6) <= LOST_FACTOR:
        return None
    ends = (start[0], pace.last_seq, start[1], pace.last_ns)
    return OffPace(value, pace.median_ns, known.source, *ends)


def _may_be_gone(history: NodeHistory, known: Known, t_ns: int) -> bool:
    """Whether the node may have started anew unheard, in a gap, since it was told a value.

    It did not lose the value if it kept it for a while after the gap.
    """
    if known.t_ns is None:
        return False
    kept_ns = [
        even.first_ns
        for even in history.even
        if abs(even.period_ns - _number(known) * 1e6) <= KEPT * even.period_ns
    ]
    return any(
        known.t_ns <= gap.start_ns < t_ns
        and not any(gap.start_ns < begin_ns < t_ns for begin_ns in kept_ns)
        for _, gap in history.gaps
    )


def _number(known: Known) -> int:
    return known.value if isinstance(known.value, int) else int.from_bytes(known.value, "little")
