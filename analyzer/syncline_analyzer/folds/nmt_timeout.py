"""How long a node may be silent before it is LOST, and where that number comes from."""

from syncline_analyzer.context import Context
from syncline_analyzer.folds.nmt_events import Lateness, NodeHistory, Silence
from syncline_schemas.devices import quirks

LOST_FACTOR = 1.5
"""Producer heartbeat times without a message after which a node is LOST (analysis.md 4)."""


def silence_limit(
    context: Context, history: NodeHistory, silence: Silence
) -> tuple[int, str] | None:
    """Silence after which the node is LOST [ns], and where the number comes from."""
    if not context.timed or silence.kind == "boot-up":
        return None
    median = silence.period_ns
    if median is not None:
        median = max(median, history.period_ns or 0)
    if silence.kind == "guard answer":
        if not silence.requests or median is None:
            return None
        return round(LOST_FACTOR * median), f"{silence.requests} guard requests not answered"
    consumer = _consumer_ns(context, history, silence.start_seq)
    if consumer is not None and (median is None or consumer[0] > median):
        return consumer
    known = context.shadow.get(history.bus, history.node, 0x1017, 0, silence.start_seq)
    if known is not None and isinstance(known.value, int) and known.value > 0:
        limit = round(LOST_FACTOR * known.value * 1e6)
        if median is None or limit > median:
            return limit, f"1.5 times its 1017h of {known.value} ms ({known.source})"
    if median is None:
        return None
    return round(LOST_FACTOR * median), f"1.5 times its usual period of {median / 1e6:.1f} ms"


def _consumer_ns(context: Context, history: NodeHistory, seq: int) -> tuple[int, str] | None:
    """The shortest 1016h time of a node that watches this one, as far as the bus told it."""
    shadow, found = context.shadow, []
    for bus, node in shadow.nodes():
        if bus != history.bus or node == history.node:
            continue
        if not quirks(shadow.device(bus, node)).consumes_heartbeat:
            continue
        for sub in range(1, 128):
            known = shadow.get(bus, node, 0x1016, sub, seq)
            if known is None:
                break
            value = known.value if isinstance(known.value, int) else 0
            if value >> 16 & 0x7F == history.node and value & 0xFFFF:
                found.append((value & 0xFFFF, node, sub, known.source))
    if not found:
        return None
    ms, node, sub, source = min(found)
    return ms * 1_000_000, f"the {ms} ms that node {node} allows it (1016h:{sub}, {source})"


def lateness(context: Context, history: NodeHistory) -> Lateness | None:
    """Heartbeats that come at more than 1.5 times 1017h as a rule."""
    known = context.shadow.get(history.bus, history.node, 0x1017)
    if known is None or known.source == "eds-default" or history.period_ns is None:
        return None
    value = known.value if isinstance(known.value, int) else 0
    if value <= 0 or history.period_ns <= LOST_FACTOR * value * 1e6:
        return None
    return Lateness(value, history.period_ns / 1e6, known.source)
