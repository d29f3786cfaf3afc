"""Stories of EMCY 8130h: a node missed its master, not the other way round (analysis.md 8)."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.findings.stretch import Stretch, seconds
from syncline_analyzer.folds.nmt import NodeKey
from syncline_analyzer.folds.nmt_timeout import life_time_ns
from syncline_analyzer.results import EmcyRow, Finding, Link

STORY_NS = 10_000_000_000
"""Events this close to an EMCY belong to its story [ns]."""
LIFE_GUARD = 0x8130
HEARTBEAT_CONSUMER = 0x1016
_ENTRIES = 127
_AT_ONCE_NS = 1_000_000_000
"""Silences of one master towards several nodes begin within this time [ns]."""
_EVIDENCE = 40
_CHECK = "Look at the master (program stopped, restarted, bus-off?) before changing the {what};"


class _Silent(NamedTuple):
    """Who fell silent: a node that is watched, or the guarding master (node None)."""

    node: int | None
    last_ns: int
    last_seq: int

    @property
    def name(self) -> str:
        return "Guarding master" if self.node is None else f"Master (node {self.node})"


class _Story(NamedTuple):
    """One node's part: what it tells, and who is behind it."""

    finding: Finding
    silent: _Silent | None
    missed_ns: int
    """When the node said so."""


def guarding_stories(facts: Facts) -> list[Finding]:
    """The stories of EMCY 8130h, one by node and stretch of time."""
    return [story.finding for story in _stories(facts)]


def told_by_guarding(facts: Facts) -> set[int]:
    """Frames that the stories of lost guarding rest on."""
    return {seq for finding in guarding_stories(facts) for seq in finding.evidence}


def guarding_lost(facts: Facts) -> Iterator[Finding]:
    """The same stories; what several nodes tell of one silence of a master is one finding."""
    groups: list[list[_Story]] = []
    for story in sorted(_stories(facts), key=lambda story: story.finding.start_ns):
        same = (group for group in groups if _one_silence(group[0], story))
        if group := next(same, None):
            group.append(story)
        else:
            groups.append([story])
    yield from (
        group[0].finding if len(group) == 1 else _together(facts, group) for group in groups
    )


def _one_silence(first: _Story, story: _Story) -> bool:
    one, other = first.silent, story.silent
    if one is None or other is None or first.finding.bus != story.finding.bus:
        return False
    return one.node == other.node and abs(one.last_ns - other.last_ns) <= _AT_ONCE_NS


def _stories(facts: Facts) -> Iterator[_Story]:
    rows = [
        row
        for row in facts.analysis.emcy
        if row.code == LIFE_GUARD and row.transition in ("raised", "further")
    ]
    rows.sort(key=lambda row: (row.bus, row.node, row.t_ns))
    for (bus, node), group in groupby(rows, key=lambda row: (row.bus, row.node)):
        found = list(group)
        for begin, end in Stretch.of([row.t_ns for row in found], STORY_NS):
            yield _story(facts, bus, node, [row for row in found if begin <= row.t_ns <= end])


def _story(facts: Facts, bus: str, node: int, told: list[EmcyRow]) -> _Story:
    """Who fell silent, who missed it, and what it did then."""
    first, last = told[0], told[-1]
    key = (facts.number(bus), node)
    silent = _silent_before(facts, key, first)
    fall = _fall_after(facts, key, first.t_ns)
    evidence = [*([silent.last_seq] if silent else []), *(row.seq for row in told)]
    pieces = [f"EMCY 8130h at {facts.moment(first.t_ns)}"]
    if silent is None:
        pieces.insert(0, f"{facts.who(bus, node)} misses its master")
    else:
        life = life_time_ns(facts.context, *key, first.seq)
        limit = f" ({life[1]})" if life is not None else ""
        passed = seconds(first.t_ns - silent.last_ns)
        pieces.insert(0, f"{facts.inside(bus, node)} misses it after {passed}{limit}")
        pieces.insert(0, f"{silent.name} silent from {facts.moment(silent.last_ns)} on")
    if fall is not None:
        pieces.append(f"node {node} goes {fall[1]} and its PDOs stop")
        evidence.append(fall[0])
    finding = Finding(
        "nmt.guarding_lost",
        "error",
        bus,
        node,
        silent.last_ns if silent else first.t_ns,
        max(last.t_ns, fall[2] if fall else last.t_ns),
        f"{' -> '.join(pieces)}.",
        f"{silent.name} stopped: the root is there, not at node {node}."
        if silent
        else "The master stopped guarding or its heartbeat did not reach node"
        f" {node}; no silence of a master stands in the capture.",
        f"{_CHECK.format(what='sensor')} compare its period with 100Ch x 100Dh or 1016h of node"
        f" {node}.",
        evidence,
    )
    return _Story(finding, silent, first.t_ns)


def _together(facts: Facts, stories: Sequence[_Story]) -> Finding:
    """One silence of a master that several nodes missed, each of them a link of the chain."""
    silent = stories[0].silent
    assert silent is not None
    ordered = sorted(stories, key=lambda story: story.missed_ns)
    nodes = sorted({story.finding.node or 0 for story in stories})
    named = f"{', '.join(map(str, nodes[:-1]))} and {nodes[-1]}"
    first = ordered[0]
    start_ns = min(story.finding.start_ns for story in stories)
    seqs = dict.fromkeys(seq for story in ordered for seq in story.finding.evidence)
    return Finding(
        "nmt.guarding_lost",
        "error",
        first.finding.bus,
        silent.node,
        start_ns,
        max(story.finding.end_ns for story in stories),
        f"{silent.name} silent from {facts.moment(start_ns)} on -> nodes {named} miss it, node"
        f" {first.finding.node} first after {seconds(first.missed_ns - start_ns)} -> EMCY 8130h of"
        f" all {len(nodes)}.",
        f"{silent.name} stopped: the root is there, not at the nodes that miss it.",
        f"{_CHECK.format(what='sensors')} compare its period with 100Ch x 100Dh or 1016h of them.",
        list(seqs)[:_EVIDENCE],
        [_link(story.finding) for story in ordered],
    )


def _link(finding: Finding) -> Link:
    return Link(
        finding.id,
        finding.bus,
        finding.node,
        finding.start_ns,
        finding.end_ns,
        finding.text,
        finding.evidence,
    )


def _silent_before(facts: Facts, key: NodeKey, emcy: EmcyRow) -> _Silent | None:
    """Who fell silent just before: the guard requests to this node, or a node that it watches."""
    nmt = facts.control.nmt.nodes.get(key)
    t_ns = emcy.t_ns
    for pause in reversed(nmt.guarding.pauses if nmt else []):
        covers = pause.start_ns <= t_ns and (pause.end_ns is None or t_ns <= pause.end_ns)
        if covers and t_ns - pause.start_ns <= STORY_NS:
            return _Silent(None, pause.start_ns, pause.start_seq)
    watched = _watched(facts, key, emcy.seq)
    losses = [
        _Silent(other, lost.last_ns, lost.last_seq)
        for (bus, other), timeline in facts.control.nmt.timelines.items()
        if bus == key[0] and other != key[1] and (not watched or other in watched)
        for lost in (*timeline.lost, *timeline.restarts)
        if lost.last_ns <= t_ns <= lost.end_ns and t_ns - lost.last_ns <= STORY_NS
    ]
    return max(losses, key=lambda lost: lost.last_ns, default=None)


def _watched(facts: Facts, key: NodeKey, seq: int) -> set[int]:
    """Nodes whose heartbeat a node consumes (1016h, bits 23..16); empty where it is not known."""
    entries = (
        facts.context.shadow.number(*key, HEARTBEAT_CONSUMER, sub, seq)
        for sub in range(1, _ENTRIES + 1)
    )
    return {entry >> 16 & 0x7F for entry in entries if entry and entry & 0xFFFF} - {0}


def _fall_after(facts: Facts, key: NodeKey, t_ns: int) -> tuple[int, str, int] | None:
    timeline = facts.control.nmt.timelines.get(key)
    for seq, change_ns, before, after in timeline.changes if timeline else ():
        if before == "OPERATIONAL" and 0 <= change_ns - t_ns <= STORY_NS:
            return seq, after, change_ns
    return None
