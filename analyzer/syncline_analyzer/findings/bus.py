"""Findings on the bus and the recording itself: bus-off, steps of the clock, gaps."""

from collections.abc import Iterator

from syncline_analyzer.context import Context
from syncline_analyzer.findings.stretch import Stretch, seconds
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.results import Analysis, Finding

RECOVERED = 0x8140
"""EMCY "recovered from bus-off" (CiA 301 table 27)."""
REORDERED_NS = 1_000_000
"""Stamps that run back by less are the driver's reordering, not a step of the clock [ns]."""
TOGETHER_NS = 10_000_000_000


def find(analysis: Analysis, control: ControlTables, context: Context) -> list[Finding]:
    """All findings of this family."""
    return [
        *_recorder_off(control),
        *_node_off(analysis, control, context),
        *_steps(control),
        *_gaps(analysis),
    ]


def tells_bus_off(code: int, meaning: str) -> bool:
    """Whether an EMCY says that its node was bus-off, by CiA 301 or its maker's words."""
    return code == RECOVERED or (code >> 8 != 0 and "bus-off" in meaning.lower())


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
    """A node can tell of its bus-off only when it is back."""
    for row in analysis.emcy:
        if row.code is None or row.transition == "malformed":
            continue
        if not tells_bus_off(row.code, row.meaning):
            continue
        number = context.buses.index(row.bus) if row.bus in context.buses else 0
        timeline = control.nmt.timelines.get((number, row.node))
        lost = [
            stretch
            for stretch in (timeline.lost if timeline else ())
            if stretch.last_ns <= row.t_ns and row.t_ns - stretch.end_ns <= TOGETHER_NS
        ]
        start = lost[-1].last_ns if lost else row.t_ns
        away = f"; it had been silent for {seconds(lost[-1].end_ns - start)}" if lost else ""
        yield Finding(
            "error.bus_off",
            "error",
            row.bus,
            row.node,
            start,
            row.t_ns,
            f"Node {row.node} says that it was bus-off (EMCY {row.code:04X}h){away}.",
            "The node's frames were destroyed on the wire: cable, termination, bit rate, or its"
            " CAN driver. The message comes after the recovery; the fault lies before it.",
            "Check the stub and plug of this node and the terminating resistors; count error"
            " frames at that time.",
            [*([lost[-1].last_seq] if lost else []), row.seq],
        )


def _steps(control: ControlTables) -> Iterator[Finding]:
    """Steps back of the clock; the smaller disorder of a driver is told once."""
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
            f"{len(small)} frames are stamped up to"
            f" {max(step.back_ns for step in small) / 1e3:.0f} us before the frame ahead of them.",
            "The driver handed frames over in another order than it stamped them.",
            "Nothing: states follow the order of the frames.",
            [step.seq for step in small[:20]],
        )


def _gaps(analysis: Analysis) -> Iterator[Finding]:
    for gap in analysis.capture.gaps:
        lost = f"; {gap.lost_frames} frames were lost" if gap.lost_frames else ""
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
