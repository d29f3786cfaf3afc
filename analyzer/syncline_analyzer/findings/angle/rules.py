"""Findings on angle traces (analysis.md 7)."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.findings.angle.words import (
    DEGREES,
    SETTING,
    events_of,
    evidence_of,
    number,
    rests_on,
    scale_of,
    stepped,
    together,
)
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.results import Finding, TraceEventRow, TraceRow
from syncline_schemas.wording import counted

WIDE = 0x100
"""From the index of a 16-bit slope to that of the same axis in 32 bits (CiA 410)."""
WARNINGS = 0x6505
_AT_PRESET = "preset value"
_ASSUMED = "assumed"
_Outside = tuple[TraceRow, list[TraceEventRow]]
"""A trace and its events "out of range"."""


def _jumps(facts: Facts) -> Iterator[Finding]:
    """Steps faster than the device can turn; a wrap or a preset by SDO is none."""
    for trace in facts.analysis.traces:
        if events_of(facts.analysis, trace, "gray code"):
            continue
        jumps = [e for e in events_of(facts.analysis, trace, "jump") if _AT_PRESET not in e.text]
        for group in together(jumps):
            yield _jump(facts, trace, group)


def _presets(facts: Facts) -> Iterator[Finding]:
    """Steps onto the preset value, on devices that a wire can set."""
    for trace in facts.analysis.traces:
        jumps = events_of(facts.analysis, trace, "jump", "preset")
        jumps = [event for event in jumps if _AT_PRESET in event.text]
        for group in together(jumps):
            yield _preset(facts, trace, group)


def _jump(facts: Facts, trace: TraceRow, group: Sequence[TraceEventRow]) -> Finding:
    return Finding(
        "angle.jump",
        "error",
        trace.bus,
        trace.node,
        group[0].t_ns,
        group[-1].t_ns + 1,
        stepped(facts, trace, group, "jumps"),
        "The encoder lost its position (fault, loose coupling, disturbed sensor), or its"
        " offset was changed without a message in this capture.",
        "Compare with the true position of the shaft; look at coupling, shielding and EMCY"
        " messages of the encoder.",
        evidence_of(group),
        assumed=scale_of(trace),
    )


def _preset(facts: Facts, trace: TraceRow, group: Sequence[TraceEventRow]) -> Finding:
    return Finding(
        "angle.preset_by_wire",
        "warning",
        trace.bus,
        trace.node,
        group[0].t_ns,
        group[-1].t_ns + 1,
        stepped(facts, trace, group, "jumps"),
        "The set input (wire) of the encoder was activated: it puts the position to the preset value"
        " without any bus message.",
        "Check the wire of the set input and what drives it; insulate it when it is not used.",
        evidence_of(group),
        assumed=scale_of(trace),
    )


def _out_of_range(facts: Facts) -> Iterator[Finding]:
    """Values that the object cannot have: the scale is wrong rather than the sensor."""
    slopes: dict[tuple[str, int], list[_Outside]] = {}
    for trace in facts.analysis.traces:
        events = events_of(facts.analysis, trace, "out of range")
        if events and trace.unit == "deg":
            slopes.setdefault((trace.bus, trace.node), []).append((trace, events))
        elif events:
            yield _outside(facts, [(trace, events)])
    # Both slopes in both widths rest on the same 6000h and 2040h.
    for found in slopes.values():
        yield _outside(facts, found)


def _outside(facts: Facts, found: Sequence[_Outside]) -> Finding:
    """One finding on all objects of a node with the same scale."""
    trace, _ = found[0]
    events = sorted((e for _, each in found for e in each), key=lambda e: e.seq)
    first = events[0]
    worst = next(t for t, each in found if first in each)
    assumed = any(event.text.startswith(_ASSUMED) for event in events)
    tilt = trace.unit == "deg"
    objects = "6000h (resolution) or 2040h (quadrant)" if tilt else "6001h or 6002h (range)"
    shown = " and ".join(
        f"{t.name} in {t.flags['out_of_range']} of {counted(t.samples, 'sample')}" for t, _ in found
    )
    words = {word for t, _ in found for word in scale_of(t)}
    zeroed = any("reference" in event.text for event in events)
    return Finding(
        "angle.out_of_range",
        "warning",
        trace.bus,
        trace.node,
        first.t_ns,
        max(event.t_ns for event in events) + 1,
        f"{facts.who(trace.bus, trace.node)} shows values that it cannot have: {shown}; the"
        f" first{facts.at(first.t_ns)} is {number(first.after)} {worst.unit}"
        f" ({'the scale is assumed' if assumed else 'the scale is as it was read'}).",
        f"The scale that was assumed is wrong: {objects}; the sensor itself may be fine."
        if assumed
        else f"{objects} changed without a message in this capture, or the device is faulty.",
        f"Read {objects} from the device, or state them in the bus description.",
        evidence_of(events),
        assumed=[*sorted(words), *(["no zero point (2046h)"] if zeroed else [])] if assumed else [],
    )


def _frozen(facts: Facts) -> Iterator[Finding]:
    """Values that stand still while the same quantity moves in another PDO or width."""
    for trace in facts.analysis.traces:
        for group in together(events_of(facts.analysis, trace, "frozen")):
            first = group[0]
            since = f" from {facts.moment(first.t_ns)} on" if facts.context.timed else ""
            yield Finding(
                "angle.frozen",
                "error",
                trace.bus,
                trace.node,
                first.t_ns,
                group[-1].t_ns + 1,
                f"{trace.name} of {facts.inside(trace.bus, trace.node)} is frozen at {number(first.before)}"
                f"{since} ({first.text}) while the same quantity moves in another PDO of the node.",
                "The device goes on sending an old value: its firmware hangs in part, or a gateway"
                " repeats what it got last.",
                "Restart the device or the gateway; compare both values with the true position.",
                evidence_of(group),
            )


def _ambiguous_16(facts: Facts) -> Iterator[Finding]:
    """Angles of 16 bits with so fine a resolution that they repeat within the circle."""
    traced = {(t.bus, t.node, t.object >> 8) for t in facts.analysis.traces}
    for trace in facts.analysis.traces:
        index = (trace.object >> 8) + WIDE
        wide = (trace.bus, trace.node, index) in traced
        if trace.unit != "deg":
            continue
        for event in events_of(facts.analysis, trace, "ambiguous"):
            yield Finding(
                "angle.ambiguous",
                "info",
                trace.bus,
                trace.node,
                event.t_ns,
                event.t_ns + 1,
                f"{trace.name} of {facts.inside(trace.bus, trace.node)} is ambiguous: {event.text}"
                + (f"; {index:04X}h of the same axis is here and tells it." if wide else "."),
                "16 bits are too few for 0..360 deg at this resolution (6000h).",
                f"Whoever reads the 16 bits: use {index:04X}h (TPDO2), or a coarser resolution."
                if wide
                else "Use TPDO2 (6110h and 6120h, 32 bits), or a coarser resolution.",
                [event.seq],
                assumed=scale_of(trace),
            )


def _disagreements(facts: Facts) -> Iterator[Finding]:
    """Angles of 16 bits that are not the lower half of the same axis in 32 bits."""
    for trace in facts.analysis.traces:
        for group in together(events_of(facts.analysis, trace, "disagrees")):
            first = group[0]
            index = (trace.object >> 8) + WIDE
            times = f"; it happened {len(group)} times" if len(group) > 1 else ""
            yield Finding(
                "angle.widths_disagree",
                "error",
                trace.bus,
                trace.node,
                first.t_ns,
                group[-1].t_ns + 1,
                f"{trace.name} of {facts.inside(trace.bus, trace.node)} does not tell the same in 16"
                f" and in 32 bits{facts.at(first.t_ns)}: {number(first.after)} deg, and"
                f" {number(first.before)} deg in {index:04X}h; they stay"
                f" {first.text}{times}.{rests_on(trace)}",
                "One of the two values is an old one or a wrong one: the device's firmware hangs in"
                " part, or something else sends under one of its identifiers.",
                "Compare both with the true pose; look who else may send these identifiers.",
                evidence_of(group),
                assumed=scale_of(trace),
            )


def _gray(facts: Facts) -> Iterator[Finding]:
    """Counts in the wrong code."""
    for trace in facts.analysis.traces:
        for event in events_of(facts.analysis, trace, "gray code"):
            yield Finding(
                "angle.gray_code",
                "warning",
                trace.bus,
                trace.node,
                event.t_ns,
                facts.analysis.capture.end_ns,
                f"{trace.name} of {facts.inside(trace.bus, trace.node)} steps by powers of two while the shaft"
                f" turns steadily: {event.text} (Gray/binary mismatch), the values are not noise.",
                "6000h bit 12 (Gray to binary) does not fit the SSI encoder behind the converter.",
                "Compare 6000h bit 12 with the code of the SSI encoder; positions are wrong until"
                " then.",
                [event.seq],
                assumed=scale_of(trace),
            )


def _scale_assumed(facts: Facts) -> Iterator[Finding]:
    """Nodes whose degrees rest on an assumed scale while the shaft or the platform moves."""
    told: set[tuple[str, int]] = set()
    for trace in facts.analysis.traces:
        guessed = [name for name in trace.assumed if name in DEGREES]
        moves = trace.min is not None and trace.min != trace.max
        if not guessed or not moves or (trace.bus, trace.node) in told:
            continue
        told.add((trace.bus, trace.node))
        objects = " and ".join(DEGREES[name] for name in guessed)
        capture = facts.analysis.capture
        partly = all(_told_once(facts, trace, name) for name in guessed)
        unseen = (
            "not known all the time: seen later only, or not again after a restart, which may have"
            " changed it"
            if partly
            else "not seen in this capture"
        )
        yield Finding(
            "angle.scale_assumed",
            "info",
            trace.bus,
            trace.node,
            capture.begin_ns,
            capture.end_ns,
            (
                f"The position of {facts.inside(trace.bus, trace.node)} is shown without degrees"
                f" ({trace.shows}):"
                if trace.unwrapped_min_deg is None
                else f"The degrees of {facts.inside(trace.bus, trace.node)} rest on an assumed scale"
                f" ({trace.shows}):"
            )
            + f" {objects} {'were' if len(guessed) > 1 else 'was'} {unseen}.",
            "The settings were read after the first values, or not again after the node started anew."
            if partly
            else "The recorder started after the settings were read, or nobody reads them.",
            f"Read {objects} from the device, or state {'them' if len(guessed) > 1 else 'it'} in the bus"
            " description.",
            [],
            assumed=scale_of(trace),
        )


def _told_once(facts: Facts, trace: TraceRow, name: str) -> bool:
    """Whether the node told or acknowledged a setting at some time."""
    changes = facts.context.shadow.changes(facts.number(trace.bus), trace.node, *SETTING[name])
    return bool(changes)


def _alarms(facts: Facts) -> Iterator[Finding]:
    """Alarm and warning bits of the measurement (6503h, 6505h)."""
    for trace in facts.analysis.traces:
        for group in together(events_of(facts.analysis, trace, "alarm")):
            first = group[0]
            bits = int(first.after or 0)
            words = f" ({first.text})" if first.text else ""
            more = f" and {len(group)} times in all" if len(group) > 1 else ""
            yield Finding(
                "angle.sensor_alarm",
                "info" if trace.object >> 8 == WARNINGS else "warning",
                trace.bus,
                trace.node,
                first.t_ns,
                group[-1].t_ns + 1,
                f"{facts.who(trace.bus, trace.node)} says {trace.object >> 8:04X}h ="
                f" {bits:04X}h{words}{facts.at(first.t_ns)}{more}.",
                "The sensor itself doubts its position."
                if trace.object >> 8 != WARNINGS
                else "The sensor reports a condition that is no failure yet.",
                "Do not trust its position until the bit is gone; look at its EMCY messages."
                if trace.object >> 8 != WARNINGS
                else "What the bit means in the device's manual; look at its EMCY messages.",
                evidence_of(group),
            )


RULES: tuple[Rule, ...] = (
    Rule(
        "angle.jump",
        "A position stepped further than the device can turn in that time.",
        "The two samples around the step.",
        (
            "A wrap at the measuring range is no step.",
            "A preset, a direction change, a teach or a reset cuts the trace instead.",
            "No step is told across a capture gap or a step of the clock.",
        ),
        _jumps,
        untimed=True,
    ),
    Rule(
        "angle.out_of_range",
        "A measured value that the object cannot have: the scale is wrong, or the device is faulty.",
        "The first sample of each such stretch.",
        (
            "The text says whether the scale was only assumed.",
            "Both slopes of an inclinometer, in both widths, are one finding.",
            "A zero point that is subtracted may move a slope beyond 90 deg.",
        ),
        _out_of_range,
        untimed=True,
    ),
    Rule(
        "angle.preset_by_wire",
        "A position stepped onto its preset value without a command: the set input was active.",
        "The two samples around the step.",
        ("Only on devices that have such an input; a preset by SDO cuts the trace instead.",),
        _presets,
    ),
    Rule(
        "angle.frozen",
        "A value stands still while the same quantity moves in another PDO of the node.",
        "The first of the equal samples.",
        (
            "Standstill makes all PDOs stand.",
            "A repeat counter sends no long row of equal values.",
            "Two axes are not compared with one another.",
        ),
        _frozen,
    ),
    Rule(
        "angle.ambiguous",
        "A 16-bit angle repeats within the circle at the resolution that is set.",
        "The first sample of the trace.",
        (
            "Only where 16 bits at the resolution in force do not reach round the circle.",
            "It is a note: the text names the angles that look alike, and the object that tells.",
        ),
        _ambiguous_16,
        untimed=True,
    ),
    Rule(
        "angle.widths_disagree",
        "16 bits of an angle are not the lower half of the same axis in 32 bits.",
        "The first of the samples that differ.",
        (
            "Both are compared modulo 65536, in samples no more than 100 ms apart.",
            "What moves between two samples is no difference.",
            "At least 16 samples in a row, over a second, must differ.",
        ),
        _disagreements,
    ),
    Rule(
        "angle.gray_code",
        "Positions step by powers of two at steady turning: Gray code and binary are mixed up.",
        "The first sample of the trace.",
        (
            "Only on converters that have such a setting.",
            "The motion must be far smoother in the other code.",
        ),
        _gray,
        untimed=True,
    ),
    Rule(
        "angle.scale_assumed",
        "Degrees rest on a scale that nobody read or stated.",
        "No single frame: it was not seen.",
        ("Not told of what stands still, nor of a setting that changes no degrees.",),
        _scale_assumed,
        untimed=True,
    ),
    Rule(
        "angle.sensor_alarm",
        "The sensor itself reports an alarm or a warning about its position (6503h, 6505h).",
        "The PDO or SDO answer with the bit.",
        ("Only bits that came up; a 0 is no alarm.",),
        _alarms,
        untimed=True,
    ),
)
