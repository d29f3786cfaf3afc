"""Stories of EMCY 8130h: a node missed its master, not the other way round (analysis.md 8)."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from operator import itemgetter

from syncline_analyzer.findings.nmt.waited import only_waited
from syncline_analyzer.findings.reaction import told_until_ns
from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.findings.stretch import Stretch, seconds
from syncline_analyzer.folds.nmt.events import Pause
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.folds.nmt.timeout import life_time_ns
from syncline_analyzer.results import EmcyRow, ErrorRow, Finding
from syncline_schemas.devices import quirks
from syncline_schemas.named_tuples import NamedTuple

STORY_NS = 10_000_000_000
"""Events this close to an EMCY belong to its story [ns]."""
LIFE_GUARD = 0x8130
HEARTBEAT_CONSUMER = 0x1016
_ENTRIES = 127
_AT_ONCE_NS = 1_000_000_000
"""Silences of one master towards several nodes begin within this time [ns]."""
_EVIDENCE = 40
_SUSPECTS = 3
"""Silent nodes that a text names one by one."""
_CHECK = "Look at {root} before changing the {what};"


class _Silence(NamedTuple):
    """A stretch in which nothing was heard of a node."""

    last_ns: int
    end_ns: int
    last_seq: int
    node: int
    waited: bool = False
    """Its heartbeat stood ready, but the bus was full."""


class _Silent(NamedTuple):
    """Who fell silent: a node that is watched, or the guarding master (node None)."""

    node: int | None
    last_ns: int
    last_seq: int
    slave: bool = False
    """A node like others, whose loss is an event of its own."""
    assumed: str = ""
    """What is taken for granted where no 1016h names it."""
    waited: bool = False
    """Its heartbeat stood ready, but the bus was full."""

    @property
    def name(self) -> str:
        if self.node is None:
            return "Guarding master"
        return f"Node {self.node}" if self.slave else f"Master (node {self.node})"

    @property
    def root(self) -> str:
        """Where to look."""
        if self.waited:
            return "what fills the bus at that time"
        if self.slave:
            return f"node {self.node} (supply, cable, restarted, bus-off?)"
        return "the master (program stopped, restarted, bus-off?)"

    @property
    def blame(self) -> str:
        """What happened to it."""
        if self.waited:
            return f"{self.name} was there, but its heartbeat had to wait on a full bus"
        return f"{self.name} stopped"


class _Story(NamedTuple):
    """One node's part: what it tells, and who is behind it."""

    finding: Finding
    silent: _Silent | None
    missed_ns: int
    """When the node said so."""


class _Watch(NamedTuple):
    """A node whose heartbeat another one consumes (1016h); `assumed` where only its EDS says so."""

    node: int
    assumed: str


def guarding_stories(facts: Facts) -> list[Finding]:
    """The stories of EMCY 8130h, one by node and stretch of time."""
    return [story.finding for story in facts.once(_stories)]


def told_by_guarding(facts: Facts) -> set[int]:
    """Frames that the stories of lost guarding rest on; the loss of a slave is none of them."""
    return facts.once(_told)


def _told(facts: Facts) -> set[int]:
    seqs = {seq for finding in guarding_stories(facts) for seq in finding.evidence}
    slaves = (story.silent for story in facts.once(_stories) if story.silent is not None)
    return seqs - {silent.last_seq for silent in slaves if silent.slave}


def guarding_lost(facts: Facts) -> Iterator[Finding]:
    """The same stories; what several nodes tell of one silence of a master is one finding."""
    groups: list[list[_Story]] = []
    last: dict[tuple[str | None, int | None], list[_Story]] = {}
    for story in sorted(facts.once(_stories), key=lambda story: story.finding.start_ns):
        silent = story.silent
        place = (story.finding.bus, silent.node) if silent is not None else None
        group = last.get(place) if place is not None else None
        if group is not None and _one_silence(group[0], story):
            group.append(story)
            continue
        groups.append([story])
        if place is not None:
            last[place] = groups[-1]
    yield from (
        group[0].finding if len(group) == 1 else _together(facts, group) for group in groups
    )


def _one_silence(first: _Story, story: _Story) -> bool:
    one, other = first.silent, story.silent
    return one is not None and other is not None and abs(one.last_ns - other.last_ns) <= _AT_ONCE_NS


def _stories(facts: Facts) -> list[_Story]:
    """The part of every node that said 8130h, one by stretch of time."""
    found: list[_Story] = []
    rows = [
        row
        for row in facts.analysis.emcy
        if row.code == LIFE_GUARD and row.transition in ("raised", "further")
    ]
    rows.sort(key=lambda row: (row.bus, row.node, row.t_ns))
    for (bus, node), group in groupby(rows, key=lambda row: (row.bus, row.node)):
        told = list(group)
        times = [row.t_ns for row in told]
        for begin, end in Stretch.of(times, STORY_NS):
            part = told[bisect_left(times, begin) : bisect_right(times, end)]
            found.append(_story(facts, bus, node, part))
    return found


def _story(facts: Facts, bus: str, node: int, told: list[EmcyRow]) -> _Story:
    """Who fell silent, who missed it, and what it did then."""
    first, last = told[0], told[-1]
    key = (facts.number(bus), node)
    silent, suspects = _silent_before(facts, key, first)
    falls = _falls_after(facts, key, told)
    evidence = [*([silent.last_seq] if silent else []), *(row.seq for row in told)]
    pieces = [f"EMCY 8130h at {facts.moment(first.t_ns)}"]
    if silent is None:
        pieces.insert(0, f"{facts.who(bus, node)} misses its master")
    else:
        life = life_time_ns(facts.context, *key, first.seq)
        limit = f" ({life[1]})" if life is not None else ""
        passed = seconds(first.t_ns - silent.last_ns)
        watches = ", which watches its heartbeat (1016h)," if silent.slave else ""
        pieces.insert(0, f"{facts.inside(bus, node)}{watches} misses it after {passed}{limit}")
        pieces.insert(0, f"{silent.name} silent from {facts.moment(silent.last_ns)} on")
    if falls:
        again = f", {len(falls)} times" if len(falls) > 1 else ""
        pieces.append(f"node {node} goes {falls[0][1]} and its PDOs stop{again}")
        evidence.extend(fall[0] for fall in falls)
    cleared = _cleared(facts, bus, node, first, last)
    if cleared is not None and cleared.cleared_ns is not None:
        pieces.append(f"cleared by the node {seconds(cleared.cleared_ns - first.t_ns)} later")
        evidence.append(cleared.evidence[-1])
    harmless = cleared is not None and silent is None and not falls
    finding = Finding(
        "nmt.guarding_lost",
        "warning" if harmless else "error",
        bus,
        node,
        silent.last_ns if silent else first.t_ns,
        max([last.t_ns, *(fall[2] for fall in falls)]),
        f"{' -> '.join(pieces)}.",
        f"{silent.blame}: the root is there, not at node {node}."
        if silent
        else f"{_missed(facts, key)}; {_suspicion(facts, key, first.t_ns, suspects)}.",
        f"{_check(silent, 'sensor')} compare its period with {_times(facts, [key])} of node {node}.",
        evidence,
        assumed=[silent.assumed] if silent and silent.assumed else [],
    )
    return _Story(finding, silent, first.t_ns)


def _cleared(facts: Facts, bus: str, node: int, first: EmcyRow, last: EmcyRow) -> ErrorRow | None:
    """The last error of a story where the node said of all of them that they are over."""
    told = [
        row
        for row in facts.once(_guard_errors).get((bus, node), [])
        if first.seq <= row.evidence[0] <= last.seq
    ]
    over = bool(told) and all(row.status == "cleared" for row in told)
    return max(told, key=lambda row: row.cleared_ns or 0) if over else None


def _guard_errors(facts: Facts) -> dict[tuple[str, int], list[ErrorRow]]:
    """Errors 8130h of each node."""
    found: dict[tuple[str, int], list[ErrorRow]] = {}
    for row in facts.analysis.errors:
        if row.code == LIFE_GUARD:
            found.setdefault((row.bus, row.node), []).append(row)
    return found


def _consumes(facts: Facts, key: NodeKey) -> bool:
    """Whether a node may watch a heartbeat (1016h), and not only who guards it."""
    return quirks(facts.context.shadow.device(*key)).consumes_heartbeat


def _missed(facts: Facts, key: NodeKey) -> str:
    if _consumes(facts, key):
        return f"The master stopped guarding or its heartbeat did not reach node {key[1]}"
    return f"The master stopped guarding node {key[1]}, or its requests did not reach it"


def _times(facts: Facts, keys: Iterable[NodeKey]) -> str:
    """The settings by which these nodes miss their master."""
    consuming = any(_consumes(facts, key) for key in keys)
    return "100Ch x 100Dh or 1016h" if consuming else "100Ch x 100Dh"


def _check(silent: _Silent | None, what: str) -> str:
    root = silent.root if silent else "the master (program stopped, restarted, bus-off?)"
    return _CHECK.format(root=root, what=what)


def _suspicion(facts: Facts, key: NodeKey, t_ns: int, suspects: Sequence[_Silence]) -> str:
    """What else was silent then, in words that accuse nobody."""
    if not suspects:
        return "no silence of a master stands in the capture"
    named = [f"node {each.node} for {seconds(t_ns - each.last_ns)}" for each in suspects]
    more = f" and {len(named) - _SUSPECTS} more" if len(named) > _SUSPECTS else ""
    relation = (
        f"node {key[1]} watches it (1016h is not known)"
        if _consumes(facts, key)
        else f"it guards node {key[1]}"
    )
    return (
        f"silent at that moment: {', '.join(named[:_SUSPECTS])}{more}, but nothing tells whether"
        f" {relation}"
    )


def _together(facts: Facts, stories: Sequence[_Story]) -> Finding:
    """One silence of a master that several nodes missed, each of them a link of the chain."""
    silent = stories[0].silent
    assert silent is not None
    ordered = sorted(stories, key=lambda story: story.missed_ns)
    nodes = sorted({story.finding.node or 0 for story in stories})
    named = f"{', '.join(map(str, nodes[:-1]))} and {nodes[-1]}"
    first = ordered[0]
    keys = [(facts.number(first.finding.bus or ""), node) for node in nodes]
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
        f"{silent.blame}: the root is there, not at the nodes that miss it.",
        f"{_check(silent, 'sensors')} compare its period with {_times(facts, keys)} of them.",
        list(seqs)[:_EVIDENCE],
        [story.finding.as_link() for story in ordered],
        sorted({text for story in ordered for text in story.finding.assumed}),
    )


def _silent_before(
    facts: Facts, key: NodeKey, emcy: EmcyRow
) -> tuple[_Silent | None, list[_Silence]]:
    """Who fell silent just before, and whoever else was silent where nothing tells who is watched.

    That is the master that guards the node, a node that its 1016h names, or the only silent node
    where nothing shows it to be another one than the master.
    """
    if (paused := _guarding_paused(facts, key, emcy.t_ns)) is not None:
        return paused, []
    silences = _silences_at(facts, key, emcy.t_ns)
    watched = {watch.node: watch for watch in _watched(facts, key, emcy.seq)}
    if watched:
        named = [silence for silence in silences if silence.node in watched]
        if not named:
            return None, []
        last = max(named)
        slave = _is_slave(facts, (key[0], last.node))
        assumed = watched[last.node].assumed
        return _Silent(last.node, last.last_ns, last.last_seq, slave, assumed, last.waited), []
    nodes = {silence.node for silence in silences}
    if len(nodes) != 1 or not _may_be_master(facts, key, max(silences)):
        return None, silences
    last = max(silences)
    relation = (
        f"node {key[1]} watches node {last.node}: 1016h of node {key[1]} is not known"
        if _consumes(facts, key)
        else f"node {last.node} guards node {key[1]}: nothing tells who does"
    )
    assumed = f"{relation}, but no other node was silent then"
    silent = _Silent(last.node, last.last_ns, last.last_seq, assumed=assumed, waited=last.waited)
    return silent, []


def _guarding_paused(facts: Facts, key: NodeKey, t_ns: int) -> _Silent | None:
    """The guarding master, where a pause of its requests to a node covers a moment."""
    pause = _pause_at(facts, key, t_ns)
    return _Silent(None, pause.start_ns, pause.start_seq) if pause is not None else None


def _pause_at(facts: Facts, key: NodeKey, t_ns: int) -> Pause | None:
    """The pause of the guard requests to a node that covers a moment."""
    nmt = facts.control.nmt.nodes.get(key)
    pauses = nmt.guarding.pauses if nmt else []
    for number in range(bisect_right(pauses, t_ns, key=lambda pause: pause.start_ns) - 1, -1, -1):
        pause = pauses[number]
        if t_ns - pause.start_ns > STORY_NS:
            return None
        if pause.end_ns is None or t_ns <= pause.end_ns:
            return pause
    return None


def _silences(facts: Facts) -> dict[int, list[_Silence]]:
    """All silences of each bus, by their beginning."""
    found: dict[int, list[_Silence]] = {}
    for (bus, node), timeline in facts.control.nmt.timelines.items():
        found.setdefault(bus, []).extend(
            _Silence(
                lost.last_ns,
                lost.end_ns,
                lost.last_seq,
                node,
                only_waited(facts, (bus, node), lost),
            )
            for lost in (*timeline.lost, *timeline.restarts)
        )
    return {bus: sorted(silences) for bus, silences in found.items()}


def _silences_at(facts: Facts, key: NodeKey, t_ns: int) -> list[_Silence]:
    """Silences of other nodes that cover a moment and began shortly before it."""
    silences = facts.once(_silences).get(key[0], [])
    begin = bisect_left(silences, t_ns - STORY_NS, key=itemgetter(0))
    end = bisect_right(silences, t_ns, key=itemgetter(0))
    return [each for each in silences[begin:end] if each.node != key[1] and t_ns <= each.end_ns]


def _is_slave(facts: Facts, key: NodeKey) -> bool:
    """Whether a node is asked or commanded, or sends PDOs of its own, as a master seldom does."""
    nmt = facts.control.nmt.nodes.get(key)
    counts = facts.control.sdo.counts.get(key)
    if counts is not None and counts.confirmed:
        return True
    return nmt is not None and (nmt.pdos != "no" or nmt.counts.guard_requests > 0)


def _may_be_master(facts: Facts, key: NodeKey, silence: _Silence) -> bool:
    """Whether nothing tells that a silent node is not whom another one misses."""
    nmt = facts.control.nmt.nodes.get(key)
    guarded = nmt is not None and nmt.counts.guard_requests > 0
    if guarded or _is_slave(facts, (key[0], silence.node)):
        return False
    times = facts.once(_command_times).get(key[0], [])
    return bisect_right(times, silence.last_ns) == bisect_left(times, silence.end_ns)


def _command_times(facts: Facts) -> dict[int, list[int]]:
    """When somebody sent NMT commands on each bus: whoever it is, was there [ns]."""
    found: dict[int, list[int]] = {}
    for row in facts.control.nmt.commands:
        found.setdefault(facts.number(row.bus), []).append(row.t_ns)
    return {bus: sorted(times) for bus, times in found.items()}


def _watched(facts: Facts, key: NodeKey, seq: int) -> Iterator[_Watch]:
    """Nodes whose heartbeat a node consumes (1016h, bits 23..16); none where it is not known.

    Nor on devices in which 1016h has no effect.
    """
    if not _consumes(facts, key):
        return
    for sub in range(1, _ENTRIES + 1):
        known = facts.context.shadow.get(*key, HEARTBEAT_CONSUMER, sub, seq)
        entry = known.value if known is not None else None
        if known is None or not isinstance(entry, int):
            continue
        if entry & 0xFFFF and (node := entry >> 16 & 0x7F):
            default = known.source == "eds-default"
            told = f"1016h:{sub:02X} of node {key[1]} = {entry:08X}h (eds-default)"
            yield _Watch(node, told if default else "")


def _falls_after(facts: Facts, key: NodeKey, told: Sequence[EmcyRow]) -> list[tuple[int, str, int]]:
    """(seq, state, time) of the changes out of OPERATIONAL that followed these EMCYs.

    A guarded node tells it once it is asked again.
    """
    timeline = facts.control.nmt.timelines.get(key)
    if timeline is None:
        return []
    found: dict[int, tuple[int, str, int]] = {}
    changes = timeline.changes
    for emcy in told:
        pause = _pause_at(facts, key, emcy.t_ns)
        asked_ns = pause.end_ns if pause is not None else None
        until_ns = told_until_ns(timeline, emcy.t_ns if asked_ns is None else asked_ns)
        for number in range(bisect_left(changes, emcy.seq, key=itemgetter(0)), len(changes)):
            seq, change_ns, before, after = changes[number]
            if change_ns > until_ns:
                break
            if before == "OPERATIONAL" and change_ns >= emcy.t_ns:
                found[seq] = (seq, after, change_ns)
                break
    return list(found.values())
