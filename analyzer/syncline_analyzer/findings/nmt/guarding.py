"""Node guarding: answers that stay away, toggle bits, life times, and its stories."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator

from syncline_analyzer.findings.bus.clock import REORDERED_NS
from syncline_analyzer.findings.nmt.guarding_story import guarding_lost
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.nmt.events import Repeated, Unanswered
from syncline_analyzer.folds.nmt.table import NodeKey, NodeNmt
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.folds.nmt.timeout import (
    GUARD_TIME,
    LIFE_TIME_FACTOR,
    PRODUCER_TIME,
    life_time_ns,
)
from syncline_analyzer.results import Finding
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.wording import counted

IN_A_ROW = 2
"""Unanswered guard requests in a row that are worth a word."""
SINGLE = 5
"""The same for single ones over the whole capture."""
REPEATED = 2
"""Guard answers with the toggle bit of the one before, from which on it is told."""
EVIDENCE = 40
_ELSEWHERE = (NmtState.INITIALISING, NmtState.LOST, NmtState.UNKNOWN)


def _unanswered(facts: Facts) -> Iterator[Finding]:
    """Guard requests without an answer of a node that was there all the time."""
    for key, nmt in facts.control.nmt.nodes.items():
        timeline = facts.control.nmt.timelines[key]
        away = _away(facts, key[0], timeline)
        period = nmt.guarding.periods.median_ns() or 0
        runs = [run for run in nmt.guarding.unanswered if not _within(away, run)]
        runs = [run for run in runs if run.end_ns - run.start_ns >= run.number * period / 2]
        long = [run for run in runs if run.number >= IN_A_ROW]
        number = sum(run.number for run in runs)
        if not long and number < SINGLE:
            continue
        bus, node = facts.context.bus_name(key[0]), key[1]
        most = max(run.number for run in runs)
        row = f", up to {most} in a row" if most > 1 else ""
        asked = nmt.counts.guard_requests
        sent = len(_not_recorded(nmt))
        told = f" The toggle bits show that it sent {sent} of the answers." if sent else ""
        yield Finding(
            "nmt.guard_unanswered",
            "info" if sent >= number else "warning",
            bus,
            node,
            runs[0].start_ns,
            runs[-1].end_ns,
            f"{facts.who(bus, node)} left {number} of {asked} guard requests"
            f" unanswered{row}, although it was there.{told}",
            "The recorder lost answers of the node; nothing is wrong with it."
            if sent >= number
            else "The node is overloaded, its guarding was switched off (100Ch, 100Dh, 1017h written), or"
            " its answers were destroyed on the bus or lost by the recorder.",
            "Look for error frames and bus load at these times; read 100Ch, 100Dh and 1017h.",
            [run.seq for run in runs][:EVIDENCE],
        )


def _not_recorded(nmt: NodeNmt) -> list[Repeated]:
    """Repeated toggle bits with one missing answer before: it was sent, or the bit would differ."""
    odd = [run.seq for run in nmt.guarding.unanswered if run.number % 2]
    return [
        toggle
        for toggle in nmt.toggles
        if bisect_right(odd, toggle.before_seq) < bisect_left(odd, toggle.seq)
    ]


def _away(facts: Facts, bus: int, timeline: Timeline) -> list[tuple[int, int]]:
    """When the node was lost, restarting, or its state not known: disjoint, in order [ns].

    Of times that the stamps go through twice, as the clock was set back, no state is told.
    """
    name = facts.context.bus_name(bus)
    spans = [(i.start_ns, i.end_ns) for i in timeline.intervals if i.state in _ELSEWHERE]
    spans += [
        (step.t_ns, step.t_ns + step.back_ns)
        for step in facts.control.clock.steps
        if step.bus == name and step.back_ns >= REORDERED_NS
    ]
    joined: list[tuple[int, int]] = []
    for start_ns, end_ns in sorted(spans):
        if joined and start_ns <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(end_ns, joined[-1][1])
        else:
            joined.append((start_ns, end_ns))
    return joined


def _within(away: list[tuple[int, int]], run: Unanswered) -> bool:
    """Whether requests without an answer touch such a time: that is told elsewhere."""
    first, last = sorted((run.start_ns, run.end_ns))
    at = bisect_right(away, last, key=lambda span: span[0])
    return at > 0 and away[at - 1][1] >= first


def _toggles(facts: Facts) -> Iterator[Finding]:
    """Toggle bits that do not alternate, but for those that a write has restarted."""
    for (bus, node), nmt in facts.control.nmt.nodes.items():
        number = nmt.counts.toggle_errors - len(_not_recorded(nmt))
        if nmt.counts.unseen or number < REPEATED or _sends_beats(facts, (bus, node), nmt):
            continue
        name = facts.context.bus_name(bus)
        stuck = number >= nmt.counts.guard_answers - 2
        how = (
            f"always had the same toggle bit ({nmt.counts.guard_answers} of them)"
            if stuck
            else f"repeated the toggle bit of the answer before {number} times"
        )
        yield Finding(
            "nmt.guard_toggle",
            "warning",
            name,
            node,
            nmt.toggles[0].t_ns,
            nmt.toggles[-1].t_ns,
            f"The guard answers of {facts.inside(name, node)} {how}.",
            "The node does not keep to CiA 301: its answers may be made by its CAN controller while"
            " its program hangs."
            if stuck
            else "The node does not keep to CiA 301, two devices answer, or frames were not recorded.",
            "Compare with another recorder; look for a second device under this number.",
            [entry.seq for entry in nmt.toggles[:20]],
        )


def _both(facts: Facts) -> Iterator[Finding]:
    """Remote frames to a node that sends heartbeats: some devices then send an empty byte."""
    for (bus, node), nmt in facts.control.nmt.nodes.items():
        if nmt.guarding.both_at is None:
            continue
        seq, t_ns = nmt.guarding.both_at
        last_seq, last_ns = nmt.guarding.both_last
        empty = nmt.counts.empty
        effect = f" Since then {counted(empty, 'heartbeat')} carried no state." if empty else ""
        name = facts.context.bus_name(bus)
        once = seq == last_seq and not empty
        yield Finding(
            "config.rtr_on_heartbeat_node",
            "info" if once else "warning",
            name,
            node,
            t_ns,
            max(t_ns, last_ns),
            f"{facts.who(name, node)} sends heartbeats and was asked once by a remote frame as well."
            if once
            else f"{facts.who(name, node)} sends heartbeats and is asked by remote frames as"
            f" well.{effect}",
            "A service tool or a master asked for the node's state; one request is no guarding yet."
            if once
            else "The master guards a node whose heartbeat (1017h) is on; only one of both is"
            " allowed (CiA 301 7.2.8.3.2.2).",
            "Who asked? Some devices send heartbeats without a state from such a request on."
            if once
            else "Switch node guarding off in the master for this node, or 1017h to 0; after that"
            " reset the node.",
            sorted({seq, last_seq}),
        )


def _life_times(facts: Facts) -> Iterator[Finding]:
    """Masters that ask less often than the node's life time allows."""
    for key, nmt in facts.control.nmt.nodes.items():
        period = nmt.guarding.periods.median_ns()
        last = facts.control.nmt.timelines[key].history.beats
        if period is None or not nmt.counts.guard_answers or not last:
            continue
        life = life_time_ns(facts.context, *key, last[-1].seq)
        if life is None or period < life[0] or _sends_beats(facts, key, nmt):
            continue
        bus, node = facts.context.bus_name(key[0]), key[1]
        values = (facts.context.shadow.get(*key, i) for i in (GUARD_TIME, LIFE_TIME_FACTOR))
        seqs = [known.seq for known in values if known is not None and known.seq is not None]
        yield Finding(
            "nmt.life_time",
            "warning",
            bus,
            node,
            facts.control.nmt.first_ns,
            facts.control.nmt.end_ns,
            f"The master asks {facts.inside(bus, node)} every {seconds(period)}, but its {life[1]}"
            " is over before: it must report EMCY 8130h again and again.",
            "100Ch or 100Dh of the node does not fit to the guard period of the master.",
            "Set 100Ch to the master's guard period and 100Dh to 3.",
            [*sorted(seqs), last[-1].seq],
        )


def _sends_beats(facts: Facts, key: NodeKey, nmt: NodeNmt) -> bool:
    """Whether most of what a node tells are heartbeats: one that follows a request is no answer."""
    producer = facts.context.shadow.number(*key, PRODUCER_TIME)
    return bool(producer) and nmt.counts.heartbeats > nmt.counts.guard_answers


RULES = (
    Rule(
        "nmt.guarding_lost",
        "A node missed its master: life guarding or heartbeat consumption failed (EMCY 8130h).",
        "The master's last frame, the EMCY, and the state the node went to.",
        (
            "Only where the node itself says so.",
            (
                "A silent node is called the master only if 1016h names it, or if no other node was"
                " silent and nothing shows it to be a slave; that is said to be assumed."
            ),
            "An error that the node cleared, without any silence in the capture, is a warning.",
        ),
        guarding_lost,
    ),
    Rule(
        "nmt.guard_unanswered",
        "A node that answers guard requests left some of them unanswered.",
        "The requests without an answer.",
        (
            "Only after its first answer: a master may search for nodes that are not there.",
            (
                "Not while it is lost, restarting, or its state is not known; single ones only when"
                " there are many."
            ),
        ),
        _unanswered,
        by_remote=True,
    ),
    Rule(
        "nmt.guard_toggle",
        "The toggle bit of a node's guard answers does not alternate.",
        "The answers that repeat it.",
        (
            "A single repetition is none; nor is the first answer after a reset or a gap.",
            "Only where requests are seen: an answer may be missing without them.",
            "Writes that restart the bit on some devices are not counted.",
            "Nor are heartbeats of a node that is asked as well: they carry no toggle bit.",
        ),
        _toggles,
        untimed=True,
        by_remote=True,
    ),
    Rule(
        "nmt.life_time",
        "A master guards a node less often than the node's life time (100Ch x 100Dh) asks for.",
        "The values of 100Ch and 100Dh, and an answer.",
        ("Only values read or written on the bus, or described, and a measured guard period.",),
        _life_times,
        by_remote=True,
    ),
    Rule(
        "config.rtr_on_heartbeat_node",
        "A node that sends heartbeats is guarded by remote frames as well.",
        "The first guard request.",
        ("Only nodes that sent at least three heartbeats unasked.",),
        _both,
        untimed=True,
        by_remote=True,
    ),
)
