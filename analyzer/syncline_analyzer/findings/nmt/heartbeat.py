"""Heartbeats: against 1017h and 1016h, irregular ones, switched off, and bytes that are no state."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator

from syncline_analyzer.findings.nmt.lateness import late_heartbeats
from syncline_analyzer.findings.nmt.twins import NEVER, twins
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import LISTED, seconds, several
from syncline_analyzer.folds.nmt.events import OffPace
from syncline_analyzer.folds.nmt.pace import Late
from syncline_analyzer.folds.nmt.table import NodeKey, NodeNmt
from syncline_analyzer.folds.nmt.timeout import CONSUMER_TIME, PRODUCER_TIME, consumer_times
from syncline_analyzer.results import Finding
from syncline_schemas.wording import counted

EVIDENCE = 40
IRREGULAR_FACTOR = 1.5
"""A heartbeat is late after so many of its usual periods."""
IRREGULAR = 3
"""Late heartbeats that are worth a word."""
SETTLED_NS = 10_000_000_000
"""A heartbeat that stays off for so long was not only being set up [ns]."""
KNOWN_BEATS = 3
_SDO = ("sdo-read", "sdo-write")


def _single(facts: Facts) -> Iterator[tuple[NodeKey, str, NodeNmt, int]]:
    """Nodes with the name of their bus, and when a second device of their number appears [ns]."""
    doubled = twins(facts)
    for key, nmt in facts.control.nmt.nodes.items():
        bus = facts.context.bus_name(key[0])
        yield key, bus, nmt, doubled.begin(bus, key[1])


def _slow(facts: Facts) -> Iterator[Finding]:
    for (_, node), bus, nmt, until_ns in _single(facts):
        off_pace = [off for off in nmt.off_pace if off.end_ns < until_ns]
        slow = [off for off in off_pace if off.median_ns > off.producer_ms * 1e6]
        if slow:
            yield _off(
                facts,
                "nmt.heartbeat_slow",
                bus,
                node,
                slow,
                "1017h was changed without effect, or the node is overloaded.",
                "Read 1017h back; compare after a reset.",
            )


def _fast(facts: Facts) -> Iterator[Finding]:
    for (_, node), bus, nmt, until_ns in _single(facts):
        off_pace = [off for off in nmt.off_pace if off.end_ns < until_ns]
        fast = [off for off in off_pace if off.median_ns < off.producer_ms * 1e6]
        if fast:
            yield _off(
                facts,
                "nmt.heartbeat_fast",
                bus,
                node,
                fast,
                "1017h was changed by other means (menu, save and restart), or two devices carry"
                " this number.",
                "Read 1017h back; unplug the node: does the heartbeat stop?",
            )


def _off(
    facts: Facts, rule: str, bus: str, node: int, found: list[OffPace], cause: str, check: str
) -> Finding:
    """A heartbeat of another period than 1017h says."""
    worst = max(found, key=lambda off: off.end_ns - off.start_ns)
    value = f"1017h is {worst.producer_ms} ms ({worst.source})"
    return Finding(
        rule,
        "warning",
        bus,
        node,
        found[0].start_ns,
        found[-1].end_ns,
        f"{facts.who(bus, node)} sends its heartbeat every {seconds(worst.median_ns)} although"
        f" {value}.",
        cause,
        check,
        [seq for off in found for seq in (off.first_seq, off.last_seq)][:EVIDENCE],
        assumed=[] if worst.source in _SDO else [value],
    )


def _irregular(facts: Facts) -> Iterator[Finding]:
    """Heartbeats that came late again and again while the node was heard otherwise."""
    for key, bus, nmt, until_ns in _single(facts):
        node, usual = key[1], nmt.heartbeat_period_ns
        if usual is None:
            continue
        ends = [pace.last_seq for pace in nmt.paces.paces]
        late = [entry for entry in late_heartbeats(facts, key) if entry.end_ns < until_ns]
        late = [entry for entry in late if _is_late(nmt, ends, entry, usual)]
        if len(late) < IRREGULAR:
            continue
        worst = max(late, key=lambda e: e.end_ns - e.start_ns)
        often = several([facts.moment(entry.start_ns) for entry in late])
        yield Finding(
            "nmt.heartbeat_irregular",
            "info",
            bus,
            node,
            late[0].start_ns,
            late[-1].end_ns,
            f"The heartbeat of {facts.inside(bus, node)} was late {often}by up to"
            f" {seconds(worst.end_ns - worst.start_ns - usual)}; usually it comes every"
            f" {seconds(usual)}, and the node was there all the time.",
            "The node is busy with something of a higher priority, single heartbeats were destroyed"
            " or not recorded, or its heartbeat loses arbitration on a loaded bus.",
            "Compare with bus load, error frames and SDO transfers at these times; a consumer"
            " needs a longer time (1016h) than the longest period.",
            [entry.seq for entry in late][:EVIDENCE],
        )


def _is_late(nmt: NodeNmt, ends: list[int], late: Late, usual_ns: int) -> bool:
    """Whether a heartbeat was late for the pace that it stands in, and for the next one."""
    at = bisect_left(ends, late.seq)
    near = [pace.median_ns for pace in nmt.paces.paces[at : at + 2]]
    return late.end_ns - late.start_ns > IRREGULAR_FACTOR * max([usual_ns, *near])


def _consumers(facts: Facts) -> Iterator[Finding]:
    """Nodes that allow another one less time than its heartbeat takes."""
    for bus in range(len(facts.context.buses)):
        for watcher, sub, watched, ms, known in consumer_times(facts.context, bus):
            nmt = facts.control.nmt.nodes.get((bus, watched))
            if nmt is None or watcher == watched or known.source == "eds-default":
                continue
            since = known.t_ns or 0
            paces = [p for p in nmt.paces.paces if p.last_ns > since and p.median_ns >= ms * 1e6]
            late = [
                entry
                for entry in late_heartbeats(facts, (bus, watched))
                if entry.start_ns >= since and entry.end_ns - entry.start_ns > ms * 1e6
            ]
            if not paces and not late:
                continue
            name = facts.context.bus_name(bus)
            value = f"{ms} ms (1016h:{sub:02X}, {known.source})"
            longest = max([*(p.median_ns for p in paces), *(e.end_ns - e.start_ns for e in late)])
            often = "comes every" if paces else f"{counted(len(late), 'time')} took up to"
            begin = paces[0].first_ns if paces else late[0].start_ns
            end = paces[-1].last_ns if paces else late[-1].end_ns
            seqs = [p.first_seq for p in paces] + [e.seq for e in late]
            yield Finding(
                "nmt.consumer_time",
                "warning",
                name,
                watcher,
                begin,
                end,
                f"{facts.who(name, watcher)} allows {facts.inside(name, watched)} {value}, but its heartbeat"
                f" {often} {seconds(longest)}.",
                "1016h of the watching node is shorter than 1017h of the watched one, or its"
                f" heartbeat is late: node {watcher} must report EMCY 8130h though node {watched}"
                " is alive.",
                f"Set 1016h:{sub:02X} to at least 1.5 times 1017h of node {watched}.",
                [*([known.seq] if known.seq is not None else []), *seqs][:EVIDENCE],
                assumed=[] if known.source in _SDO else [f"1016h:{sub:02X} = {value}"],
            )


def _stopped(facts: Facts) -> Iterator[Finding]:
    """Heartbeats that a write of 0 to 1017h switched off for good."""
    for key, bus, nmt, until_ns in _single(facts):
        if until_ns != NEVER:
            continue
        changes = facts.context.shadow.changes(*key, PRODUCER_TIME)
        known = facts.context.shadow.get(*key, PRODUCER_TIME, 0, changes[-1]) if changes else None
        if known is None or known.source != "sdo-write" or known.value or known.t_ns is None:
            continue
        before = [pace for pace in nmt.paces.paces if pace.first_ns < known.t_ns]
        if sum(pace.number for pace in before) < KNOWN_BEATS:
            continue
        period = before[-1].median_ns
        ended = before[-1].last_ns <= known.t_ns + 2 * period and before[-1] is nmt.paces.paces[-1]
        if not ended or facts.control.nmt.end_ns - known.t_ns < SETTLED_NS:
            continue
        yield Finding(
            "nmt.heartbeat_stopped",
            "info",
            bus,
            key[1],
            known.t_ns,
            facts.control.nmt.end_ns,
            f"The heartbeat of {facts.inside(bus, key[1])} was switched off at"
            f" {facts.moment(known.t_ns)} by a write of 0 to 1017h; until then it came every"
            f" {seconds(period)}.",
            "A configuration tool or the master wrote it; from then on nobody notices when the node"
            " is lost.",
            "Was it meant? If not, find out who writes 1017h; check that guarding took its place.",
            [seq for seq in (before[-1].last_seq, known.seq) if seq is not None],
        )


def _unknown_states(facts: Facts) -> Iterator[Finding]:
    """Messages on a node's error-control identifier that are none."""
    for (_, node), bus, nmt, until_ns in _single(facts):
        told = [odd for odd in nmt.odd if odd.t_ns < until_ns]
        if not told or nmt.counts.heartbeats + nmt.counts.guard_answers < KNOWN_BEATS:
            continue
        kinds = Counter(odd.what for odd in told)
        what = "; ".join(f"{k} ({n} times)" if n > 1 else k for k, n in kinds.most_common(LISTED))
        number = nmt.counts.odd if len(told) == len(nmt.odd) else len(told)
        states = any(odd.what.startswith("state") for odd in told)
        yield Finding(
            "nmt.unknown_state",
            "warning" if states else "info",
            bus,
            node,
            told[0].t_ns,
            told[-1].t_ns,
            f"{facts.who(bus, node)} sent {counted(number, 'message')} on {0x700 + node:03X}h that"
            f" {'is' if number == 1 else 'are'} no NMT state of CiA 301: {what}.",
            "A fault of its firmware, or another device sends on this identifier.",
            "Find the sender; these messages were left out of the node's states.",
            [odd.seq for odd in told][:EVIDENCE],
        )


_KNOWN = (
    "1017h as it was at that time: read or written on the bus, or described; never an EDS default.",
    (
        "At least six periods of one pace, none of them across a change of 1017h, unless the pace"
        " goes on unchanged for 10 s after it; periods of 0.7 to 1.5 times 1017h are let be."
    ),
)
RULES = (
    Rule(
        "nmt.heartbeat_slow",
        "A node sends its heartbeat slower than 1017h says.",
        "The first and the last heartbeat of the stretch.",
        _KNOWN,
        _slow,
    ),
    Rule(
        "nmt.heartbeat_fast",
        "A node sends its heartbeat faster than 1017h says.",
        "The first and the last heartbeat of the stretch.",
        _KNOWN,
        _fast,
    ),
    Rule(
        "nmt.heartbeat_irregular",
        "A node's heartbeat was late again and again, but the node was there.",
        "The late heartbeats.",
        (
            "At least three, each more than 1.5 usual periods after the one before.",
            "Silences of the node or the whole bus, resets, gaps and a changed 1017h are none.",
        ),
        _irregular,
    ),
    Rule(
        "nmt.consumer_time",
        "A node allows another one less time than its heartbeat takes (1016h).",
        f"The value of {CONSUMER_TIME:04X}h and the heartbeats that took longer.",
        (
            "Only values read or written on the bus, or described, and heartbeats after that.",
            "Devices of which the maker says that they watch nobody are left out.",
        ),
        _consumers,
    ),
    Rule(
        "nmt.heartbeat_stopped",
        "A node's heartbeat was switched off by a write to 1017h.",
        "The write, and the last heartbeat.",
        ("Only when it is not switched on again, and the capture goes on for 10 s.",),
        _stopped,
    ),
    Rule(
        "nmt.unknown_state",
        "A node sent messages on its error-control identifier that are no NMT state.",
        "These messages.",
        (
            "Only nodes that send proper states as well.",
            "Empty heartbeats after a remote frame and guard requests stored without RTR are none.",
        ),
        _unknown_states,
        untimed=True,
    ),
)
