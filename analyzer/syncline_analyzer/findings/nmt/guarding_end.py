"""Node guarding that ends for good while the bus lives on, and no node says that it misses it."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.findings.nmt.guarding_story import guarding_stories
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.nmt.events import Pause, Silence
from syncline_analyzer.folds.nmt.guarding import GUARD_ANSWER_NS
from syncline_analyzer.folds.nmt.table import NodeKey, NodeNmt
from syncline_analyzer.folds.nmt.timeout import (
    GUARD_TIME,
    LIFE_TIME_FACTOR,
    PRODUCER_TIME,
    life_time_ns,
)
from syncline_analyzer.results import Finding
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.named_tuples import NamedTuple

ENOUGH = 20
"""Guard answers that make a rhythm."""
EVEN = 1.5
"""Nearly all periods of a regular guarding are no longer than so many times the usual one."""
SILENT_NS = 5_000_000_000
SILENT_PERIODS = 20
"""Guarding has ended when the bus is heard so long, and so many of its periods, after it."""
LONGER = 2
"""That is also so many times as long as any pause before."""
MEANT_NS = 10_000_000_000
"""A command or a setting this close to the last request goes with it [ns]."""
TOGETHER_NS = 1_000_000_000
"""Nodes whose guarding ends no further apart are one finding, beside a period [ns]."""
EMCY_ID, INVALID = 0x1014, 1 << 31
_KNOWN = (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL, NmtState.STOPPED)
_DOWN = ("stop", "enter pre-operational", "reset")
_SETTINGS = (GUARD_TIME, LIFE_TIME_FACTOR, PRODUCER_TIME)
_NAMED = 8
"""Nodes that a text names one by one."""


_MASTERS = (
    (
        "The master's program stopped or was restarted, it gave the node up, or a tool that asked"
        " was closed."
    ),
    (
        "Does the master still run, and is the node in its list? Nobody watches it now: read its"
        " 1001h, 100Ch and 100Dh."
    ),
)
"""Cause, and what to check next; ..."""
_OPEN = (
    (
        "The master's program stopped or gave the node up, a tool that asked was closed, or the node"
        " lost its supply or its connection."
    ),
    (
        "Does the node answer (1001h)? If it does, look at the master; if not, at the node's supply"
        " and plug. Record again with a tool that stores remote frames."
    ),
)
"""... the same where the requests are not seen."""


class _End(NamedTuple):
    """The last request to a node that was asked regularly."""

    t_ns: int
    seq: int
    node: int
    period_ns: int
    silent_ns: int
    heard_ns: int
    life: str
    """Its life time where it is known, on, and over."""
    unseen: bool = False
    """The log holds no requests: it is the last answer."""


def _ended(facts: Facts) -> Iterator[Finding]:
    """Masters that asked nodes regularly, and then no more."""
    by_bus: dict[tuple[int, bool, bool], list[_End]] = {}
    for key, nmt in facts.control.nmt.nodes.items():
        end = _last_answer(facts, key, nmt) if nmt.counts.unseen else _end(facts, key, nmt)
        if end is not None and not _told(facts, key, end) and not _meant(facts, key, end):
            alike = end.unseen, end.unseen and _silent([end])
            by_bus.setdefault((key[0], *alike), []).append(end)
    for (bus, *_), ends in by_bus.items():
        for group in _groups(sorted(ends)):
            yield _finding(facts, facts.context.bus_name(bus), group)


def _end(facts: Facts, key: NodeKey, nmt: NodeNmt) -> _End | None:
    """The last request, where the bus is heard for long after it and the node answered till then."""
    period, last_ns = nmt.guarding.periods.median_ns(), facts.control.clock.ended_ns.get(key[0])
    pauses = nmt.guarding.pauses
    if period is None or last_ns is None or not pauses or nmt.told_ns is None:
        return None
    last, silent_ns = pauses[-1], last_ns - pauses[-1].start_ns
    longest = max((p.end_ns - p.start_ns for p in pauses if p.end_ns is not None), default=0)
    if last.end_ns is not None or not _regular(nmt, period):
        return None
    if silent_ns < max(SILENT_NS, SILENT_PERIODS * period, LONGER * longest):
        return None
    if not -2 * period <= nmt.told_ns - last.start_ns <= GUARD_ANSWER_NS:
        return None
    if _unheard(facts, key, last.start_ns, last_ns):
        return None
    life = life_time_ns(facts.context, *key, last.start_seq)
    heard_ns = nmt.told_ns if nmt.heard_ns is None else nmt.heard_ns
    over = life is not None and life[0] < silent_ns and _would_tell(facts, key, last)
    told = life[1] if life is not None and over else ""
    return _End(last.start_ns, last.start_seq, key[1], period, silent_ns, heard_ns, told)


def _last_answer(facts: Facts, key: NodeKey, nmt: NodeNmt) -> _End | None:
    """The same of a log without requests: the last answer."""
    silences, last_ns = _answers_missing(facts, key), facts.control.clock.ended_ns.get(key[0])
    period, told_ns, answers = nmt.heartbeat_period_ns, nmt.told_ns, nmt.counts.guard_answers
    if period is None or told_ns is None or last_ns is None or not silences:
        return None
    last, paused = silences[-1], [s.end_ns - s.start_ns for s in silences if s.end_seq is not None]
    if last.kind != "guard answer" or answers < max(ENOUGH, nmt.counts.heartbeats):
        return None
    silent_ns = last_ns - told_ns
    if silent_ns < max(SILENT_NS, SILENT_PERIODS * period, LONGER * max(paused, default=0)):
        return None
    if _unheard(facts, key, told_ns, last_ns):
        return None
    heard_ns = told_ns if nmt.heard_ns is None else nmt.heard_ns
    return _End(told_ns, last.start_seq, key[1], period, silent_ns, heard_ns, "", unseen=True)


def _answers_missing(facts: Facts, key: NodeKey) -> list[Silence]:
    """Silences of a node, in order."""
    silences = facts.control.nmt.timelines[key].history.silences
    return sorted(silences, key=lambda silence: silence.start_seq)


def _would_tell(facts: Facts, key: NodeKey, last: Pause) -> bool:
    """Whether a node may send EMCYs: not while STOPPED, nor with bit 31 of 1014h."""
    can_id = facts.context.shadow.number(*key, EMCY_ID, 0, last.start_seq) or 0
    return not can_id & INVALID and _state(facts, key, last.start_ns) is not NmtState.STOPPED


def _state(facts: Facts, key: NodeKey, t_ns: int) -> NmtState | None:
    """In which state a node was."""
    intervals = facts.control.nmt.timelines[key].intervals
    return next((i.state for i in intervals if i.start_ns <= t_ns < i.end_ns), None)


def _unheard(facts: Facts, key: NodeKey, start_ns: int, end_ns: int) -> bool:
    """Whether a gap, or a silence of the whole bus, hides what came after the last request."""
    timeline = facts.control.nmt.timelines[key]
    silent = timeline.quiet.within(start_ns, end_ns) > (end_ns - start_ns) / 2
    return silent or any(gap.end_ns > start_ns for _, gap in timeline.history.gaps)


def _regular(nmt: NodeNmt, period: int) -> bool:
    """Whether a node was asked at even intervals, and answered instead of sending heartbeats."""
    most = nmt.guarding.periods.quantile_ns(0.95)
    even = most is not None and most <= EVEN * period
    return even and nmt.counts.guard_answers >= max(ENOUGH, nmt.counts.heartbeats)


def _told(facts: Facts, key: NodeKey, end: _End) -> bool:
    """Whether the node says itself that it misses its master, or was lost before."""
    bus = facts.context.bus_name(key[0])
    losses = facts.control.nmt.timelines[key].lost
    lost = any(each.last_ns <= end.t_ns < each.end_ns for each in losses)
    return (
        lost
        or _state(facts, key, end.t_ns) not in _KNOWN
        or any(
            story.bus == bus
            and key[1] in (story.node, *(link.node for link in story.chain))
            and story.end_ns >= end.t_ns
            for story in guarding_stories(facts)
        )
    )


def _meant(facts: Facts, key: NodeKey, end: _End) -> bool:
    """Whether somebody sent the node down, or told it to heed no requests, about then or later."""
    since_ns, bus = end.t_ns - MEANT_NS, facts.context.bus_name(key[0])
    down = any(
        row.bus == bus
        and row.node in (0, key[1])
        and row.command.startswith(_DOWN)
        and row.t_ns >= since_ns
        for row in facts.control.nmt.commands
    )
    own = facts.analysis.sdo.writes.of_node(bus, key[1])
    settings = own.of_objects(lambda of: of.index in _SETTINGS)
    return down or any(
        row.end_ns >= since_ns and any(row.data) == (row.index == PRODUCER_TIME) for row in settings
    )


def _groups(ends: Sequence[_End]) -> list[list[_End]]:
    """Nodes whose guarding ended together."""
    groups: list[list[_End]] = []
    for end in ends:
        if groups and end.t_ns - groups[-1][0].t_ns <= TOGETHER_NS + end.period_ns:
            groups[-1].append(end)
        else:
            groups.append([end])
    return groups


def _finding(facts: Facts, bus: str, group: Sequence[_End]) -> Finding:
    first, nodes = group[0], [end.node for end in group]
    named = ", ".join(map(str, sorted(nodes)[:_NAMED]))
    named += f" and {len(nodes) - _NAMED} more" if len(nodes) > _NAMED else ""
    whom = facts.inside(bus, first.node) if len(nodes) == 1 else f"nodes {named}"
    what = "answers of" if first.unseen else "requests to"
    text = f"The guard {what} {whom}, every {seconds(first.period_ns)} until then, ended"
    text += f" at {facts.moment(first.t_ns)}, while other frames went on for"
    text += f" {seconds(min(end.silent_ns for end in group))} up to the end."
    text += _unseen(facts, group) if first.unseen else _afterwards(facts, group)
    alive = [end for end in group if end.life]
    if alive:
        text += (
            f" The {alive[0].life} of node {alive[0].node} ran out, but EMCY 8130h did not come."
        )
    return Finding(
        "nmt.guarding_ended",
        "warning" if alive or (first.unseen and _silent(group)) else "info",
        bus,
        first.node if len(nodes) == 1 else None,
        first.t_ns,
        max(end.t_ns for end in group) + 1,
        text,
        *(_OPEN if first.unseen and _silent(group) else _MASTERS),
        [end.seq for end in group],
    )


def _afterwards(facts: Facts, group: Sequence[_End]) -> str:
    """Whether anything was heard of the nodes for long after it."""
    if not _silent(group):
        return ""
    last_ns = max(end.heard_ns for end in group)
    return f" Nothing was heard of {'it' if len(group) == 1 else 'them'} after {facts.moment(last_ns)}."


def _silent(group: Sequence[_End]) -> bool:
    """Whether nothing was heard of the nodes for long after it."""
    return not any(end.heard_ns - end.t_ns >= end.silent_ns / 2 for end in group)


def _unseen(facts: Facts, group: Sequence[_End]) -> str:
    """What a log leaves open that holds no requests."""
    who = "it" if len(group) == 1 else "them"
    if not _silent(group):
        return f" Other frames of {who} went on: nobody asks {who} any more."
    lost = "it was lost" if len(group) == 1 else "they were lost"
    text = " The log holds no guard requests, so it cannot tell which it was: nobody asked"
    return f"{text} {who} any more, or {lost}.{_afterwards(facts, group)}"


RULES = (
    Rule(
        "nmt.guarding_ended",
        "A master that asked a node for its state regularly ended that while the bus lived on.",
        "The last request; the last answer where the log holds no requests.",
        (
            "At least 20 answers to requests at even intervals, the last request or two among them.",
            (
                "Where the log holds no requests, an alternating bit 7 shows that a node is guarded; that"
                " it may be lost instead is said, and a warning."
            ),
            (
                "Other frames come for 5 s and 20 periods after it, and for twice as long as any"
                " pause before; no gap and no silence of the whole bus."
            ),
            (
                "Not after a stop, PRE-OPERATIONAL or reset, nor where 100Ch or 100Dh is set to 0, or"
                " the heartbeat (1017h) is switched on."
            ),
            "Not where the node tells it (8130h), is lost, or sends heartbeats instead.",
            (
                "Information only where no life time (100Ch x 100Dh) of the node is known, or it sends no"
                " EMCY: while it is STOPPED, or with bit 31 of 1014h."
            ),
        ),
        _ended,
        by_remote=True,
    ),
)
