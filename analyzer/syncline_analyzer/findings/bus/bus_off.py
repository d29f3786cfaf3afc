"""Findings on a bus as a whole: bus-off, silence, load."""

from collections.abc import Iterator
from itertools import groupby

from syncline_analyzer.context import Context
from syncline_analyzer.findings.reaction import told_until_ns
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import Stretch, seconds
from syncline_analyzer.folds.nmt.events import Interval, Lost
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.folds.timing.load import OVERLOAD_PERCENT
from syncline_analyzer.results import BusSilenceRow, EmcyRow, Finding
from syncline_schemas.wording import counted

RECOVERED = 0x8140
"""EMCY "recovered from bus-off" (CiA 301 table 27)."""
RESTART_NS = 1_000_000_000
"""A restart this close to a silence explains it [ns]."""
MAX_FINDINGS = 10
"""More silences of one bus become one finding."""
MAX_EVIDENCE = 20
TOGETHER_NS = 10_000_000_000


def tells_bus_off(code: int, meaning: str) -> bool:
    """Whether an EMCY says that its node was bus-off, by CiA 301 or its maker's words."""
    return code == RECOVERED or (code >> 8 != 0 and "bus-off" in meaning.lower())


def _bus_off(facts: Facts) -> Iterator[Finding]:
    """The recorder's own controller, and nodes that tell of it when they are back."""
    yield from _recorder_off(facts)
    if facts.context.timed:
        yield from _node_off(facts)


def _recorder_off(facts: Facts) -> Iterator[Finding]:
    events = facts.control.bus_errors.events
    for bus in sorted({event.bus for event in events}):
        times = [e.t_ns for e in events if e.bus == bus and not e.restarted]
        for start, end in Stretch.of(times, TOGETHER_NS):
            part = [e for e in events if e.bus == bus and start <= e.t_ns <= end]
            back = next((e for e in events if e.bus == bus and e.restarted and e.t_ns >= end), None)
            until = f"; it was back after {seconds(back.t_ns - end)}" if back else ""
            yield Finding(
                "error.bus_off",
                "error",
                bus,
                None,
                start,
                back.t_ns if back else end,
                f"The recorder's own controller on {bus} went bus-off{facts.at(start)}{until}.",
                "Wrong bit rate, a short circuit, or a missing terminating resistor: the"
                " controller could not send without errors. It hears nothing while it is off.",
                "Measure 60 ohm between CAN_H and CAN_L; compare the bit rates.",
                [e.seq for e in part[:20]] + ([back.seq] if back else []),
            )


def bus_off_silences(facts: Facts) -> dict[NodeKey, set[Lost]]:
    """By (bus number, node) the silences that the node explains: the last one before each such EMCY."""
    found: dict[NodeKey, set[Lost]] = {}
    for row in _told(facts):
        key = (facts.number(row.bus), row.node)
        timeline = facts.control.nmt.timelines.get(key)
        before = [
            silence
            for silence in ((*timeline.lost, *timeline.restarts) if timeline else ())
            if silence.last_ns <= row.t_ns
        ]
        last = max(before, key=lambda silence: silence.last_ns, default=None)
        if last is not None and row.t_ns - last.end_ns <= TOGETHER_NS:
            found.setdefault(key, set()).add(last)
    return found


def _told(facts: Facts) -> list[EmcyRow]:
    """EMCYs by which nodes say that they were bus-off, by bus, node and `seq`."""
    rows = [
        row
        for row in facts.analysis.emcy
        if row.code is not None
        and row.transition not in ("malformed", "reset")
        and tells_bus_off(row.code, row.meaning)
    ]
    return sorted(rows, key=lambda row: (row.bus, row.node, row.seq))


def _node_off(facts: Facts) -> Iterator[Finding]:
    """A node can tell of its bus-off only when it is back; what belongs together is one story."""
    for _, group in groupby(_told(facts), key=lambda row: (row.bus, row.node)):
        found = list(group)
        for start, end in Stretch.of([row.t_ns for row in found], TOGETHER_NS):
            yield _node_off_story(facts, [row for row in found if start <= row.t_ns <= end])


def _node_off_story(facts: Facts, rows: list[EmcyRow]) -> Finding:
    """Silence, the node's own word for it, and the state it went to."""
    first, last = rows[0], rows[-1]
    key = (facts.number(first.bus), first.node)
    timeline = facts.control.nmt.timelines.get(key)
    lost = [
        stretch
        for stretch in sorted(facts.once(bus_off_silences).get(key, ()))
        if stretch.last_ns <= last.t_ns and first.t_ns - stretch.end_ns <= TOGETHER_NS
    ]
    fall = _fall(timeline, rows, lost) if timeline else None
    often = f" {len(rows)} times" if len(rows) > 1 else ""
    silent = seconds(sum(stretch.end_ns - stretch.last_ns for stretch in lost))
    away = f"; it had been silent for {silent}" if lost else ""
    fell = ""
    if fall is not None:
        reaction = _reaction(facts.context, key, fall.evidence)
        fell = f"; then it was {fall.state.value} without a command{reaction}"
    seqs = {row.seq for row in rows}
    if fall is not None and fall.evidence is not None:
        seqs.add(fall.evidence)
    for stretch in lost:
        seqs |= (
            {stretch.last_seq} if stretch.end_seq is None else {stretch.last_seq, stretch.end_seq}
        )
    return Finding(
        "error.bus_off",
        "error",
        first.bus,
        first.node,
        min([first.t_ns, *(stretch.last_ns for stretch in lost)]),
        max(last.t_ns, fall.start_ns if fall else 0),
        f"{facts.who(first.bus, first.node)} says{often} that it was bus-off"
        f" (EMCY {first.code or 0:04X}h{facts.at(first.t_ns)}){away}{fell}.",
        "The node's frames were destroyed on the wire: cable, termination, bit rate, or its"
        " CAN driver. The message comes after the recovery; the fault lies before it.",
        "Check the stub and plug of this node and the terminating resistors; count error"
        " frames at that time.",
        sorted(seqs)[:20],
    )


def _reaction(context: Context, key: tuple[int, int], seq: int | None) -> str:
    """That the device does so by itself after a communication error, where it was set to."""
    known = context.shadow.get(*key, 0x1029, 1, seq)
    if known is None or not isinstance(known.value, int):
        return ""
    source = "" if known.confirmed else f", {known.source}"
    return f", which is its error reaction (1029h:01 = {known.value}{source})"


def _fall(timeline: Timeline, rows: list[EmcyRow], lost: list[Lost]) -> Interval | None:
    """The state that the node went to from OPERATIONAL by itself, about when it was bus-off."""
    fallen = {change[0] for change in timeline.changes if change[2] == "OPERATIONAL"}
    operational = any(stretch.state_before == "OPERATIONAL" for stretch in lost)
    until_ns = told_until_ns(timeline, rows[-1].t_ns)
    for interval in timeline.intervals:
        told = operational and interval.cause.endswith("says so")
        if (
            rows[0].t_ns <= interval.start_ns <= until_ns
            and interval.state.value in ("PRE-OPERATIONAL", "STOPPED")
            and (interval.evidence in fallen or told)
        ):
            return interval
    return None


def _silent(facts: Facts) -> Iterator[Finding]:
    """Silences of a whole bus, after which everybody goes on."""
    for bus in facts.context.buses:
        rows = [
            row
            for row in facts.analysis.bus_silences
            if row.bus == bus and not _restarted(facts, row) and not _went_off(facts, row)
        ]
        if len(rows) > MAX_FINDINGS:
            yield _silence(facts, rows)
        else:
            yield from (_silence(facts, [row]) for row in rows)


def _restarted(facts: Facts, silence: BusSilenceRow) -> bool:
    """Whether nodes started anew in a silence, or right after it: then their own findings tell."""
    return any(
        row.start_ns < silence.end_ns + RESTART_NS and row.end_ns > silence.start_ns
        for row in facts.analysis.nmt_states
        if row.bus == silence.bus
        and (row.state == "INITIALISING" or row.cause.startswith("boot-up"))
        and row.start_ns > silence.start_ns - RESTART_NS
    )


def _went_off(facts: Facts, silence: BusSilenceRow) -> bool:
    """Whether a silence is only part of that of most nodes: then they were off, one by one."""
    here = {
        key: timeline
        for key, timeline in facts.control.nmt.timelines.items()
        if facts.context.bus_name(key[0]) == silence.bus
    }
    gone = {
        key
        for key, timeline in here.items()
        for lost in timeline.lost
        if abs(lost.last_ns - silence.start_ns) <= RESTART_NS
        and (lost.end_seq is None or lost.end_ns > silence.end_ns + RESTART_NS)
    }
    return bool(gone) and 2 * len(gone) >= len(here)


def _silence(facts: Facts, rows: list[BusSilenceRow]) -> Finding:
    first, last = rows[0], rows[-1]
    longest = max(row.end_ns - row.start_ns for row in rows)
    heard = {row.node for row in facts.analysis.nodes if row.bus == first.bus and row.heartbeats}
    often = f" {len(rows)} times, at most" if len(rows) > 1 else facts.at(first.start_ns)
    return Finding(
        "bus.silent",
        "warning",
        first.bus,
        None,
        first.start_ns,
        last.end_ns,
        f"Nothing at all was heard on {first.bus}{often} for {seconds(longest)}, though heartbeats"
        f" of {counted(len(heard), 'node')} were due: this accuses no node.",
        "The recorder paused or was unplugged without noting it, its clock was set forward, the bus"
        " was interrupted near it, or the whole machine was off.",
        "Look at the log of the recording computer at that time; was the machine switched off?",
        [seq for row in rows for seq in row.evidence][:MAX_EVIDENCE],
    )


def _overload(facts: Facts) -> Iterator[Finding]:
    """Seconds in a row in which the bus was nearly full."""
    for bus in facts.context.buses:
        rows = [row for row in facts.analysis.overloads if row.bus == bus]
        if not rows:
            continue
        total = sum(row.end_ns - row.start_ns for row in rows)
        often = f" in {len(rows)} stretches" if len(rows) > 1 else ""
        worst = max(row.percent for row in rows)
        yield Finding(
            "bus.overload",
            "warning",
            bus,
            None,
            rows[0].start_ns,
            rows[-1].end_ns,
            f"The load of {bus} was above {OVERLOAD_PERCENT:.0f} % for {seconds(total)}{often}, up to"
            f" {worst:.0f} %: frames of low priority had to wait for long.",
            "Too many or too frequent PDOs for this bit rate, or a node that sends without pause.",
            "See which identifiers come most often; raise inhibit times and event timers, use SYNC"
            " with a longer period, or a higher bit rate.",
            [],
            assumed=facts.context.assumed_bitrate(bus),
        )


RULES = (
    Rule(
        "error.bus_off",
        "A node, or the recorder itself, was bus-off.",
        "The error frame of the recorder's controller, or the node's EMCY and its last frame before.",
        ("A node is named only where it says so itself.",),
        _bus_off,
        untimed=True,
    ),
    Rule(
        "bus.silent",
        "Nothing at all was heard of a bus for a while, and then everybody went on.",
        "The frames before and after the silence.",
        (
            "Only where heartbeats were due; a gap that the recorder noted is told as such.",
            "A step of the clock is told as such; a restart of nodes is told of the nodes.",
        ),
        _silent,
    ),
    Rule(
        "bus.overload",
        "The bus was nearly full for seconds.",
        "The number and length of the frames in windows of one second.",
        (
            "Only where the bit rate is known.",
            "A single full second is none; more than 100 % is a delay of the recorder's stamps.",
        ),
        _overload,
    ),
)
