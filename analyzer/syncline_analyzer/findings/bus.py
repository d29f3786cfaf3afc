"""Findings on the bus and the recording itself: bus-off, steps of the clock, gaps."""

from collections.abc import Iterator
from itertools import groupby

from syncline_analyzer.context import Context
from syncline_analyzer.deafness import RECORDER_OFF
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import Stretch, seconds
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.folds.nmt_events import Interval, Lost
from syncline_analyzer.folds.nmt_timeline import Timeline
from syncline_analyzer.results import Analysis, EmcyRow, Finding
from syncline_schemas.wording import counted

RECOVERED = 0x8140
"""EMCY "recovered from bus-off" (CiA 301 table 27)."""
REORDERED_NS = 1_000_000
"""Stamps that run back by less are the driver's reordering, not a step of the clock [ns]."""
TOGETHER_NS = 10_000_000_000


def tells_bus_off(code: int, meaning: str) -> bool:
    """Whether an EMCY says that its node was bus-off, by CiA 301 or its maker's words."""
    return code == RECOVERED or (code >> 8 != 0 and "bus-off" in meaning.lower())


def _bus_off(facts: Facts) -> Iterator[Finding]:
    """The recorder's own controller, and nodes that tell of it when they are back."""
    yield from _recorder_off(facts.control)
    if facts.context.timed:
        yield from _node_off(facts.analysis, facts.control, facts.context)


def _recorder_off(control: ControlTables) -> Iterator[Finding]:
    events = control.bus_errors.events
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
                f"The recorder's own controller on {bus} went bus-off{until}.",
                "Wrong bit rate, a short circuit, or a missing terminating resistor: the"
                " controller could not send without errors. It hears nothing while it is off.",
                "Measure 60 ohm between CAN_H and CAN_L; compare the bit rates.",
                [e.seq for e in part[:20]] + ([back.seq] if back else []),
            )


def _node_off(analysis: Analysis, control: ControlTables, context: Context) -> Iterator[Finding]:
    """A node can tell of its bus-off only when it is back; what belongs together is one story."""
    rows = [
        row
        for row in analysis.emcy
        if row.code is not None
        and row.transition not in ("malformed", "reset")
        and tells_bus_off(row.code, row.meaning)
    ]
    rows.sort(key=lambda row: (row.bus, row.node, row.seq))
    for _, group in groupby(rows, key=lambda row: (row.bus, row.node)):
        found = list(group)
        for start, end in Stretch.of([row.t_ns for row in found], TOGETHER_NS):
            yield _node_off_story(
                control, context, [row for row in found if start <= row.t_ns <= end]
            )


def _node_off_story(control: ControlTables, context: Context, rows: list[EmcyRow]) -> Finding:
    """Silence, the node's own word for it, and the state it went to."""
    first, last = rows[0], rows[-1]
    number = context.buses.index(first.bus) if first.bus in context.buses else 0
    timeline = control.nmt.timelines.get((number, first.node))
    lost = [
        stretch
        for stretch in ((*timeline.lost, *timeline.restarts) if timeline else ())
        if stretch.last_ns <= last.t_ns and first.t_ns - stretch.end_ns <= TOGETHER_NS
    ]
    fall = _fall(timeline, rows, lost) if timeline else None
    often = f" {len(rows)} times" if len(rows) > 1 else ""
    silent = seconds(sum(stretch.end_ns - stretch.last_ns for stretch in lost))
    away = f"; it had been silent for {silent}" if lost else ""
    fell = f"; then it was {fall.state.value} without a command" if fall else ""
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
        f"Node {first.node} says{often} that it was bus-off"
        f" (EMCY {first.code or 0:04X}h){away}{fell}.",
        "The node's frames were destroyed on the wire: cable, termination, bit rate, or its"
        " CAN driver. The message comes after the recovery; the fault lies before it.",
        "Check the stub and plug of this node and the terminating resistors; count error"
        " frames at that time.",
        sorted(seqs)[:20],
    )


def _fall(timeline: Timeline, rows: list[EmcyRow], lost: list[Lost]) -> Interval | None:
    """The state that the node went to from OPERATIONAL by itself, about when it was bus-off."""
    fallen = {change[0] for change in timeline.changes if change[2] == "OPERATIONAL"}
    operational = any(stretch.state_before == "OPERATIONAL" for stretch in lost)
    for interval in timeline.intervals:
        told = operational and interval.cause.endswith("says so")
        if (
            rows[0].t_ns <= interval.start_ns <= rows[-1].t_ns + TOGETHER_NS
            and interval.state.value in ("PRE-OPERATIONAL", "STOPPED")
            and (interval.evidence in fallen or told)
        ):
            return interval
    return None


def _steps(facts: Facts) -> Iterator[Finding]:
    """Steps back of the clock; the smaller disorder of a driver is told once."""
    control = facts.control
    steps = [step for step in control.clock.steps if step.back_ns >= REORDERED_NS]
    for step in steps[:20]:
        yield Finding(
            "clock.step_back",
            "warning",
            step.bus,
            None,
            step.t_ns,
            step.t_ns + step.back_ns,
            f"The stamps step back by {seconds(step.back_ns)}; durations across it are not told.",
            "The recorder's clock was set, or files were joined in the wrong order.",
            "Let the recorder's clock run in step (NTP, GPS) or record with the adapter's clock.",
            [step.seq],
        )
    small = [step for step in control.clock.steps if step.back_ns < REORDERED_NS]
    if small:
        yield Finding(
            "clock.step_back",
            "info",
            small[0].bus,
            None,
            small[0].t_ns,
            small[-1].t_ns,
            f"{counted(len(small), 'frame')} {'is' if len(small) == 1 else 'are'} stamped earlier"
            " than the frame before, by up to"
            f" {max(step.back_ns for step in small) / 1e3:.0f} us.",
            "The driver handed frames over in another order than it stamped them.",
            "Nothing: states follow the order of the frames.",
            [step.seq for step in small[:20]],
        )


def _gaps(facts: Facts) -> Iterator[Finding]:
    """Gaps, but for those that the recorder's own bus-off explains."""
    for gap in facts.analysis.capture.gaps:
        if gap.reason == RECORDER_OFF:
            continue
        number = gap.lost_frames or 0
        lost = (
            f"; {counted(number, 'frame')} {'was' if number == 1 else 'were'} lost"
            if number
            else ""
        )
        yield Finding(
            "capture.gap",
            "info",
            gap.bus,
            None,
            gap.start_ns,
            gap.end_ns,
            f"The recorder was blind for {seconds(gap.end_ns - gap.start_ns)}"
            f" ({gap.reason}){lost}: nothing is concluded from that time.",
            "See the reason; what happened in it is not known.",
            "Adapter, its plug, and the load of the recording computer.",
            [],
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
        "clock.step_back",
        "The stamps of the capture run back.",
        "The first frame after the step.",
        ("Disorder below 1 ms is the driver's and told once, as a note.",),
        _steps,
        untimed=True,
    ),
    Rule(
        "capture.gap",
        "The recorder was blind; nothing is concluded from that time.",
        "The gap itself, as the recorder noted it.",
        ("Only gaps that the recorder noted, and its own bus-off.",),
        _gaps,
        untimed=True,
    ),
)
