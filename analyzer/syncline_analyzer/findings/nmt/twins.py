"""Two devices under one node id: interleaved cadences, states told in turn, double answers."""

from collections.abc import Iterator
from itertools import pairwise

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.nmt.events import Beat, BootUpEvent
from syncline_analyzer.folds.nmt.pace import ENOUGH, Halved
from syncline_analyzer.folds.nmt.table import NodeKey, NodeNmt
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.folds.nmt.timeout import PRODUCER_TIME
from syncline_analyzer.results import Finding
from syncline_schemas.records import dataclass

FLIPS = 3
"""Returns to OPERATIONAL without a command that no single node makes."""
TURNS = 5
"""Returns from empty heartbeats to states that no single node makes."""
DOUBLED = 10
"""Alternating heartbeat intervals from which on two producers are believed."""
ASKED = 0.8
"""Part of the messages of a second cadence that remote frames explain."""
ANSWERED_TWICE = 5
"""Guard requests with two answers from which on two devices are believed."""
RECORDED_TWICE_NS = 10_000_000
"""Frames that a recorder took twice are no further apart than this [ns]."""
ALIKE = 0.1
"""Part by which a measured period may differ from 1017h."""
BEATS_BEFORE, BEFORE_NS = 20, (2_000_000_000, 10_000_000_000)
"""Heartbeats, and the least and most time, that a second device may be there before it shows."""
STARTED_TOGETHER_NS = 2_000_000_000
"""Two devices that are switched on with the machine tell it within this time [ns]."""
STARTED_BEFORE_NS = 10_000_000_000
"""The heartbeats of two devices, or their PDOs, begin so soon after the two have started [ns]."""
BLURRED = 3
"""Pairs of intervals by which a pace may reach into the next one."""
ALONE_PERIODS = 2
"""Even heartbeats over so many of the longer period show that one device was alone."""
NEVER = 1 << 63
Place = tuple[str | None, int | None]
"""Bus and node of a finding."""


@dataclass(frozen=True, slots=True)
class _Sign:
    """What shows two devices: when, in which words, by which frames."""

    start_ns: int
    end_ns: int
    how: str
    evidence: list[int]
    sure: bool = True
    """Whether one device cannot do it, however it is set."""
    alone_ns: tuple[int, ...] = ()
    """Heartbeat periods of the two devices, as far as they are known."""


@dataclass(frozen=True, slots=True)
class Shared:
    """Numbers that two devices share, each from a moment on [ns]: what follows is no other fault."""

    since: dict[Place, int]

    def begin(self, bus: str | None, node: int | None) -> int:
        """When a number began to be that of two devices, `NEVER` where it did not."""
        return self.since.get((bus, node), NEVER)

    def at(self, bus: str | None, node: int | None, t_ns: int) -> bool:
        """Whether two devices may have had a number at a moment."""
        return t_ns >= self.begin(bus, node)


def twins(facts: Facts) -> Shared:
    """Where two devices share one number."""
    return facts.once(_shared)


def _shared(facts: Facts) -> Shared:
    since: dict[Place, int] = {}
    for (bus, node), sign in facts.once(_signs).items():
        nmt = facts.control.nmt.nodes[bus, node]
        least, most = BEFORE_NS
        alone_ns = _alone_until(nmt, sign)
        before = min(most, max(least, BEATS_BEFORE * (nmt.heartbeat_period_ns or 0)))
        start_ns = _before_steps(facts, bus, sign.start_ns, most)
        begin_ns = max(start_ns - (most if alone_ns else before), alone_ns)
        since[facts.context.bus_name(bus), node] = begin_ns
    return Shared(since)


def _before_steps(facts: Facts, bus: int, start_ns: int, within_ns: int) -> int:
    """When two devices may have shown, had the clock not been set shortly before they did.

    The heartbeats on both sides of a step are not held against one another.
    """
    name = facts.context.bus_name(bus)
    for step in reversed(facts.analysis.clock_steps):
        if step.bus == name and 0 <= start_ns - step.end_ns <= within_ns:
            start_ns = min(step.start_ns, start_ns)
    return start_ns


def _alone_until(nmt: NodeNmt, sign: _Sign) -> int:
    """Until when one device sent every heartbeat of a number, before a sign of two; 0 if unknown.

    A heartbeat of the other one would have parted the even intervals of a single one, and what is
    no state between them may be that heartbeat.
    """
    slow = max(sign.alone_ns, default=0)
    found = [
        even.last_ns
        for even in nmt.paces.even
        if even.last_ns <= sign.start_ns
        and even.last_ns - even.first_ns >= ALONE_PERIODS * slow
        and any(abs(even.period_ns - each) <= ALIKE * each for each in sign.alone_ns)
        and not any(even.first_ns < odd.t_ns < even.last_ns for odd in nmt.odd)
    ]
    return max(found, default=0)


def _signs(facts: Facts) -> dict[NodeKey, _Sign]:
    """The strongest sign of two devices for each number that shows one."""
    signs = ((key, _sign(facts, key, nmt)) for key, nmt in facts.control.nmt.nodes.items())
    return {key: sign for key, sign in signs if sign is not None}


def _doubled(facts: Facts) -> Iterator[Finding]:
    """One finding for each number that two devices carry."""
    for (bus, node), sign in facts.once(_signs).items():
        name = facts.context.bus_name(bus)
        yield Finding(
            "nmt.duplicate_node_id",
            "error" if sign.sure else "warning",
            name,
            node,
            sign.start_ns,
            sign.end_ns,
            f"Two devices send as {facts.inside(name, node)}: {sign.how}.",
            f"Two devices carry the number {node} (or the recorder took every frame twice).",
            "Unplug the device that should be there: if the messages go on, find the other one.",
            sign.evidence,
        )


def _sign(facts: Facts, key: NodeKey, nmt: NodeNmt) -> _Sign | None:
    """The strongest sign of two devices, None without any."""
    timeline = facts.control.nmt.timelines[key]
    if nmt.twins.periods_ns is not None and not _asked(
        nmt, nmt.twins.span, max(nmt.twins.periods_ns)
    ):
        fast, slow = nmt.twins.periods_ns
        how = f"one heartbeat comes every {seconds(fast)}, the other every {seconds(slow)}"
        return _Sign(*nmt.twins.span, how, nmt.twins.at, alone_ns=(fast, slow))
    if nmt.doubles.count >= DOUBLED and _believed(facts, key, nmt):
        how = f"short and long heartbeat intervals alternate {nmt.doubles.count} times"
        seqs = nmt.doubles.at
        if starts := _started_twice(timeline, nmt.doubles.span[0]):
            told = " and ".join(facts.moment(start.t_ns) for start in starts)
            how += f", and it told at {told} that it started, with no reset and no silence between"
            seqs = [*(start.seq for start in starts), *seqs]
        return _Sign(*nmt.doubles.span, how, seqs, alone_ns=(nmt.doubles.pair_ns,))
    if (sign := _paired(facts, key, nmt)) is not None:
        return sign
    halved = nmt.paces.halved
    if (
        halved is not None
        and not _asked(nmt, (halved.t_ns, nmt.paces.paces[-1].last_ns), halved.period_ns)
        and _from_then_on(nmt, halved)
        and not _rewritten(facts, key, *halved[:2])
    ):
        period, half = seconds(halved.period_ns), seconds(halved.period_ns // 2)
        how = f"the heartbeat came every {period}, and from {facts.moment(halved.t_ns)} on a"
        how += f" second one in the middle between two, so that one comes every {half}"
        seqs = [halved.first_seq, halved.seq]
        ends = (halved.t_ns, nmt.paces.paces[-1].last_ns)
        return _Sign(*ends, how, seqs, sure=False, alone_ns=(halved.period_ns,))
    if nmt.guarding.doubled >= ANSWERED_TWICE and not _beats_by_chance(nmt):
        how = f"{nmt.guarding.doubled} guard requests were answered twice"
        return _Sign(*nmt.guarding.doubled_span, how, nmt.guarding.doubled_at)
    if turns := _turns(timeline):
        how = f"states are told between empty heartbeats, {len(turns)} times"
        return _Sign(turns[0].t_ns, turns[-1].t_ns, how, [beat.seq for beat in turns[:20]])
    if flips := _flips(timeline):
        states = " and ".join(sorted({flip[3] for flip in flips}))
        how = f"{states} are told in turn, {len(flips)} times without any command"
        return _Sign(flips[0][1], flips[-1][1], how, [flip[0] for flip in flips[:20]])
    return _doubled_pdo(facts, timeline, nmt)


def _paired(facts: Facts, key: NodeKey, nmt: NodeNmt) -> _Sign | None:
    """From an unasked boot-up on each heartbeat came twice, which was single before.

    The second device takes over the period that the master writes, at the same moment as the first.
    """
    if not nmt.pairs.found or not _single_elsewhere(facts, key):
        return None
    boots = facts.control.nmt.timelines[key].boot_ups
    before = [boot for boot in boots if boot.t_ns <= nmt.pairs.span[0]]
    if not before or before[-1].command_seq is not None or before[-1].blind:
        return None
    boot = before[-1]
    alone = [even for even in nmt.paces.even if even.last_ns <= boot.t_ns]
    if not alone or nmt.pairs.span[0] - boot.t_ns > STARTED_TOGETHER_NS + alone[-1].period_ns:
        return None
    how = (
        f"from its boot-up at {facts.moment(boot.t_ns)} on, which nobody asked for, each heartbeat"
    )
    how += " comes twice, and those of no other node do"
    seqs = [boot.seq, *nmt.pairs.at]
    return _Sign(*nmt.pairs.span, how, seqs, sure=False, alone_ns=(alone[-1].period_ns,))


def _single_elsewhere(facts: Facts, key: NodeKey) -> bool:
    """Whether heartbeats of other nodes come, and none of them twice: it is not the recorder."""
    others = [
        nmt
        for other, nmt in facts.control.nmt.nodes.items()
        if other[0] == key[0] and other != key and nmt.counts.heartbeats >= ENOUGH
    ]
    return bool(others) and not any(nmt.pairs.count for nmt in others)


def _doubled_pdo(facts: Facts, timeline: Timeline, nmt: NodeNmt) -> _Sign | None:
    """Two boot-ups together, and from then on a PDO in two interleaved cadences."""
    for can_id, doubles in nmt.pdo_doubles.items():
        starts = _started_twice(timeline, doubles.span[0])
        if not starts or starts[1].t_ns - starts[0].t_ns <= RECORDED_TWICE_NS:
            continue
        if _answers_two(facts, timeline.history.bus, *doubles.span):
            continue
        apart = doubles.count >= DOUBLED and doubles.short_ns > RECORDED_TWICE_NS
        if apart and not doubles.stepped and doubles.span[0] >= starts[0].t_ns:
            told = " and ".join(facts.moment(start.t_ns) for start in starts)
            how = f"it told at {told} that it started, with no reset and no silence between, and"
            how += f" short and long intervals of the PDO {can_id:03X}h alternate"
            how += f" {doubles.count} times"
            seqs = [*(start.seq for start in starts), *doubles.at]
            return _Sign(*doubles.span, how, seqs, sure=False)
    return None


def _answers_two(facts: Facts, bus: int, start_ns: int, end_ns: int) -> bool:
    """Whether most of a time has two SYNC producers: one device that answers both sends as often."""
    name = facts.context.bus_name(bus)
    doubled_ns = sum(
        max(0, min(row.end_ns, end_ns) - max(row.start_ns, start_ns))
        for row in facts.analysis.sync_doubles
        if row.bus == name
    )
    return 2 * doubled_ns > end_ns - start_ns


def _believed(facts: Facts, key: NodeKey, nmt: NodeNmt) -> bool:
    """Whether alternating intervals are two devices, and not a slow task or the recorder."""
    if _asked(nmt, nmt.doubles.span, nmt.doubles.pair_ns):
        return False
    known = facts.context.shadow.get(*key, PRODUCER_TIME)
    if known is not None and known.source != "eds-default" and isinstance(known.value, int):
        told_ns, pair = known.value * 1e6, nmt.doubles.pair_ns
        if abs(pair - told_ns) <= ALIKE * told_ns:
            return not _recorded_twice(facts, key[0])
        if abs(pair - 2 * told_ns) <= 2 * ALIKE * told_ns:
            return False
    if _recorded_twice(facts, key[0]):
        return False
    timeline = facts.control.nmt.timelines[key]
    twice = _started_twice(timeline, nmt.doubles.span[0])
    return not nmt.doubles.stepped or bool(twice) or _one_before(facts, key, nmt)


def _beats_by_chance(nmt: NodeNmt) -> bool:
    """Whether a node sends heartbeats as well, few of which come right after an answer."""
    return 2 * nmt.guarding.doubled < nmt.counts.heartbeats


def _asked(nmt: NodeNmt, span: tuple[int, int], period_ns: int) -> bool:
    """Whether remote frames explain a second cadence: messages of a period come at once after them."""
    return nmt.guarding.prompt * period_ns >= ASKED * (span[1] - span[0])


def _started_twice(timeline: Timeline, since_ns: int) -> list[BootUpEvent]:
    """Two boot-ups in a row with neither a reset nor a restart's silence between, if there are.

    They are no sign of what began at `since_ns`, long after them or after a later boot-up.

    One reset command may be behind both: each of two devices follows it. Devices that send a pair
    of boot-ups do so too: it takes another sign beside this one.
    """
    boots = timeline.boot_ups
    for first, second, third in zip(boots, boots[1:], [*boots[2:], None], strict=False):
        if since_ns - second.t_ns > STARTED_BEFORE_NS:
            continue
        if third is not None and second.t_ns + STARTED_TOGETHER_NS < third.t_ns <= since_ns:
            continue
        passed = second.t_ns - first.t_ns
        reset = second.command_seq is not None and second.command_seq > first.seq
        silent = any(first.seq <= lost.last_seq < second.seq for lost in timeline.restarts)
        if 0 <= passed <= STARTED_TOGETHER_NS and not (reset or silent or second.blind):
            return [first, second]
    return []


def _one_before(facts: Facts, key: NodeKey, nmt: NodeNmt) -> bool:
    """Whether one of the two cadences was there alone before the other one, or after it."""
    doubles = nmt.doubles
    for pace in nmt.paces.paces:
        alike = abs(pace.median_ns - doubles.pair_ns) <= ALIKE * doubles.pair_ns
        blurred = BLURRED * doubles.pair_ns
        before = pace.last_ns <= doubles.span[0] + blurred
        after = pace.first_ns >= doubles.span[1] - blurred
        if alike and pace.number >= ENOUGH and (before or after):
            ends = (pace.first_seq, doubles.at[0]) if before else (doubles.at[0], pace.last_seq)
            return not _rewritten(facts, key, *ends)
    return False


def _recorded_twice(facts: Facts, bus: int) -> bool:
    """Whether all heartbeats of a bus come twice: that is the recorder, or joined logs."""
    steady = [
        nmt
        for (on, _), nmt in facts.control.nmt.nodes.items()
        if on == bus and nmt.counts.heartbeats > 2 * DOUBLED
    ]
    return len(steady) > 1 and all(
        nmt.doubles.count >= DOUBLED and nmt.doubles.short_ns <= RECORDED_TWICE_NS for nmt in steady
    )


def _from_then_on(nmt: NodeNmt, halved: Halved) -> bool:
    """Whether the heartbeat came twice as often from a moment on, and neither before nor no more.

    A device that was set would keep its old period again; one whose heartbeat was slow for a while
    had the short period before.
    """
    later = (pace for pace in nmt.paces.paces if pace.first_seq > halved.seq)
    half_ns = halved.period_ns / 2
    paces = [*nmt.paces.paces, *nmt.paces.stretches]
    earlier = (pace for pace in paces if pace.first_seq < halved.first_seq)
    return all(pace.median_ns < 0.75 * halved.period_ns for pace in later) and not any(
        abs(pace.median_ns - half_ns) <= ALIKE * half_ns for pace in earlier
    )


def _rewritten(facts: Facts, key: NodeKey, start_seq: int, end_seq: int) -> bool:
    """Whether 1017h was written, or thrown away by a reset, while the period changed."""
    changes = facts.context.shadow.changes(*key, PRODUCER_TIME)
    return any(start_seq <= seq <= end_seq for seq in changes)


def _turns(timeline: Timeline) -> list[Beat]:
    """States told although heartbeats are empty since a remote frame, which lasts until a reset."""
    found = [
        beat
        for before, beat in pairwise(timeline.history.beats)
        if (before.kind, beat.kind) == ("empty", "heartbeat")
    ]
    return found if len(found) >= TURNS else []


def _flips(timeline: Timeline) -> list[tuple[int, int, str, str]]:
    """Changes to and fro that no single node makes: back in OPERATIONAL without a command."""
    back = [change for change in timeline.changes if change[3] == "OPERATIONAL"]
    gone = [change for change in timeline.changes if change[2] == "OPERATIONAL"]
    return timeline.changes if min(len(back), len(gone)) >= FLIPS else []


RULES = (
    Rule(
        "nmt.duplicate_node_id",
        "Two devices carry one node id.",
        (
            "Heartbeats of two cadences, or in pairs since a boot-up that nobody asked for, states"
            " told in turn, or guard requests answered twice."
        ),
        (
            (
                "Jitter of one producer, heartbeats on the grid of a slow task, a reset or a changed"
                " 1017h is none; two boot-ups without a reset, or one of the cadences alone"
                " before or after, tell two devices from such a task."
            ),
            "Where the heartbeats of all nodes come twice it is the recorder.",
            (
                "What comes within 10 ms of a remote frame, for each of a cadence, is the answer to it,"
                " also of a node that sends heartbeats and gives its answers no toggle bit."
            ),
            "PDOs in two cadences prove nothing while two producers send SYNC.",
        ),
        _doubled,
    ),
)
