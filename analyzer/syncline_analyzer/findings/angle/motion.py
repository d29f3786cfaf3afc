"""Findings on how a shaft or a platform moves, or is said to move."""

from collections.abc import Iterator

import numpy as np

from syncline_analyzer.findings.angle.words import (
    events_of,
    evidence_of,
    number,
    rests_on,
    scale_of,
    stepped,
    together,
)
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.results import TRACE_FLAGS, Finding, ShaftRow, TraceRow

NOISY_DEG = {"counts": 0.5, "deg": 1.0}
"""Standard deviation at rest from which a value is worth a note, by the unit of the trace."""
RESTED = 640
"""Samples at rest from which noise is judged."""
UNTOLD = 3
"""Samples that leave the direction open from which a shaft is too fast for them."""
ALL_THE_TIME = 5
"""Encoders that part so often do not slip: what was stated of their shaft is wrong."""


def _steps(facts: Facts) -> Iterator[Finding]:
    """Positions that were moved between two samples while the shaft went on as before."""
    for trace in _judged(facts):
        for group in together(events_of(facts.analysis, trace, "step")):
            yield Finding(
                "angle.step",
                "warning",
                trace.bus,
                trace.node,
                group[0].t_ns,
                group[-1].t_ns + 1,
                stepped(facts, trace, group, "steps"),
                "The encoder lost its position, the coupling slipped, or its offset was changed"
                " without a message in this capture.",
                "Compare with the true position of the shaft; look at coupling, shielding and EMCY"
                " messages of the encoder.",
                evidence_of(group),
                assumed=scale_of(trace),
            )


def _unsure_steps(facts: Facts) -> Iterator[Finding]:
    """Positions that left their line so near to the end that nothing more can be told."""
    for trace in _judged(facts):
        for group in together(events_of(facts.analysis, trace, "unsure step")):
            first = group[0]
            more = f" ({len(group)} times)" if len(group) > 1 else ""
            yield Finding(
                "angle.step_unsure",
                "info",
                trace.bus,
                trace.node,
                first.t_ns,
                group[-1].t_ns + 1,
                f"{trace.name} of {facts.inside(trace.bus, trace.node)} went from"
                f" {number(first.before)} to {number(first.after)} {trace.unit}{facts.at(first.t_ns)}"
                f" within one sample{more}; the trace ends or is cut so soon after it that it cannot"
                f" be told whether the shaft began to turn or the position was lost: {first.text}."
                f"{rests_on(trace)}",
                "The shaft was set in motion very hard, or the encoder lost its position.",
                "Look at what comes after it: the next capture, or the position after the cut.",
                evidence_of(group),
                assumed=scale_of(trace),
            )


def _spikes(facts: Facts) -> Iterator[Finding]:
    """Single samples far off the line of those around them."""
    for trace in _judged(facts):
        for group in together(events_of(facts.analysis, trace, "spike")):
            first = group[0]
            count = len(group)
            times = f" ({count} such samples up to {facts.moment(group[-1].t_ns)})"
            yield Finding(
                "angle.spike",
                "warning",
                trace.bus,
                trace.node,
                first.t_ns,
                group[-1].t_ns + 1,
                f"{trace.name} of {facts.inside(trace.bus, trace.node)} was away for one sample"
                f"{facts.at(first.t_ns)}: {first.before:.10g}, then {first.after:.10g}, then back"
                f"{times if count > 1 else ''}; {first.text}.{rests_on(trace)}",
                "A reading of the sensor was disturbed: dirty or damaged code disc, magnet or read"
                " head, interference, or a bad line to the SSI encoder behind a converter.",
                "Look whether it happens at one position of the shaft (disc) or at one time"
                " (interference); check shielding and supply.",
                evidence_of(group),
                assumed=scale_of(trace),
            )


def _fast(facts: Facts) -> Iterator[Finding]:
    """Shafts that turn faster than the encoder may."""
    for trace in _judged(facts):
        for group in together(events_of(facts.analysis, trace, "too fast")):
            first = group[0]
            tops = [event.after for event in group if event.after is not None]
            more = (
                f" ({len(group)} times, up to {max(tops):.4g} rpm)"
                if len(group) > 1 and tops
                else ""
            )
            yield Finding(
                "angle.overspeed",
                "warning",
                trace.bus,
                trace.node,
                first.t_ns,
                group[-1].t_ns + 1,
                f"{facts.who(trace.bus, trace.node)} turned too fast{facts.at(first.t_ns)}:"
                f" {first.text}{more}{_beyond(facts, trace, max(tops, default=0.0))}.{rests_on(trace)}",
                "The machine ran faster than the encoder is made for; or the counts per turn or the"
                " speed limit are not those of this encoder.",
                "Compare with the speed of the machine; state the encoder's limit (override"
                " max_rpm) and its scale.",
                evidence_of(group),
                assumed=scale_of(trace),
            )


def _beyond(facts: Facts, trace: TraceRow, top_rpm: float) -> str:
    """Says so where even the mechanical limit was passed."""
    device = facts.context.shadow.device(facts.number(trace.bus), trace.node)
    limit = device.limits.get("max_rpm_mech") if device else None
    if limit is None or top_rpm <= limit:
        return ""
    return f"; even its mechanical limit is {limit:.6g} rpm"


def _seldom(facts: Facts) -> Iterator[Finding]:
    """Encoders whose samples come too seldom for their speed and direction."""
    for trace in facts.analysis.traces:
        if trace.unit != "counts" or trace.untold_speeds < UNTOLD:
            continue
        for event in events_of(facts.analysis, trace, "ambiguous"):
            yield Finding(
                "angle.sampled_too_seldom",
                "info",
                trace.bus,
                trace.node,
                event.t_ns,
                max(event.t_ns, _untold_until(facts, trace)) + 1,
                f"{trace.name} of {facts.inside(trace.bus, trace.node)} is ambiguous:"
                f" {event.text}; speed, direction and turns of the trace are right only if the"
                f" shaft is slower.{rests_on(trace)}",
                "The PDO or the SDO reads come too seldom for a shaft that may turn so fast.",
                "Shorten the event timer (180xh:5) or use the PDO that follows SYNC; or state the"
                " speed of the machine (override max_rpm).",
                [event.seq],
                assumed=scale_of(trace),
            )


def _untold_until(facts: Facts, trace: TraceRow) -> int:
    """Time of the last sample whose speed and direction are not told [ns]."""
    key = (trace.bus, trace.node, trace.object)
    for data in facts.analysis.trace_data:
        if (data.bus, data.node, data.object) == key and "speed_rpm" in data.columns:
            unsure = (data.flags >> TRACE_FLAGS.index("ambiguous") & 1).astype(np.bool_)
            untold = data.t_ns[unsure & np.isnan(data.columns["speed_rpm"])]
            return int(untold[-1]) if len(untold) else 0
    return 0


def _noise(facts: Facts) -> Iterator[Finding]:
    """Values that scatter while nothing moves."""
    for trace in facts.analysis.traces:
        noise, widest = trace.noise_deg, trace.noise_peak_deg
        if noise is None or widest is None or trace.rest_samples < RESTED:
            continue
        if noise < NOISY_DEG.get(trace.unit, noise + 1) or trace.flags["out_of_range"]:
            continue
        capture = facts.analysis.capture
        yield Finding(
            "angle.noise",
            "info",
            trace.bus,
            trace.node,
            capture.begin_ns,
            capture.end_ns,
            f"{trace.name} of {facts.inside(trace.bus, trace.node)} scatters at rest: standard"
            f" deviation {noise:.3g} deg over {trace.rest_samples} samples, up to {widest:.3g} deg"
            f" from peak to peak.{rests_on(trace)}",
            "Vibration of the mounting, play in the coupling, interference, or a filter that is off"
            " or too fast.",
            "Look at the filter of the sensor and its mounting; compare with a sensor nearby.",
            [],
            assumed=scale_of(trace),
        )


def _parted(facts: Facts) -> Iterator[Finding]:
    """Encoders of one shaft that no longer tell the same."""
    for shaft in facts.analysis.shafts:
        if not shaft.parted or shaft.parted_ns is None or shaft.parted_deg is None:
            continue
        always = shaft.parted >= ALL_THE_TIME
        events = [
            event
            for event in facts.analysis.trace_events
            if (event.kind, event.bus, event.node) == ("parted", shaft.bus, shaft.node)
        ]
        last_ns = max((event.t_ns for event in events), default=shaft.parted_ns)
        yield Finding(
            "angle.shafts_parted",
            "warning" if always else "error",
            shaft.bus,
            shaft.node,
            shaft.parted_ns,
            last_ns + 1,
            _parting(facts, shaft),
            "What was stated of the shaft is wrong (ratio, direction, or they are not on one"
            " shaft), or a coupling slips all the time."
            if always
            else "A coupling or belt slipped, or one of the encoders lost its position or was"
            " preset by its wire.",
            "Compare both with the true position of the shaft; look at the couplings, and at"
            " findings on either encoder.",
            evidence_of(events),
            assumed=sorted(
                {
                    f"{words} of node {trace.node}"
                    for trace in facts.analysis.traces
                    if trace.unit == "counts"
                    and (trace.bus, trace.node)
                    in ((shaft.bus, shaft.node), (shaft.other_bus, shaft.other))
                    for words in scale_of(trace)
                }
            ),
        )


def _followers(facts: Facts) -> Iterator[Finding]:
    """Encoders that follow one another although nobody says that they sit on one shaft."""
    for row in facts.analysis.followers:
        seconds = (row.end_ns - row.start_ns) / 1e9
        ratio = f" and ratio = {row.ratio:.6g}" if row.ratio != 1 else ""
        how = "as far as" if row.ratio == 1 else f"{row.ratio:.6g} times as far as"
        yield Finding(
            "angle.follow_one_another",
            "info",
            row.bus,
            row.node,
            row.start_ns,
            row.end_ns,
            f"{facts.who(row.bus, row.node)} follows {facts.inside(row.bus, row.other)}: for"
            f" {seconds:.4g} s it turned {how} the other one, over {row.moved_deg:.4g} deg and never"
            f" evenly, and hardly ever more than {max(row.spread_deg, 0.1):.2g} deg off; these two"
            " may sit on one shaft, or be geared to one another.",
            "Nobody said in the bus description what belongs together.",
            f"If it is so, say same_shaft_as = {row.other}{ratio} at node {row.node} in the bus"
            " description: then they are compared, and told if they ever part.",
            [],
            assumed=_scales_of(facts, row.bus, (row.node, row.other)),
        )


def _scales_of(facts: Facts, bus: str, nodes: tuple[int, int]) -> list[str]:
    """Settings of both scales that were only assumed, in words."""
    return sorted(
        {
            f"{words} of node {trace.node}"
            for trace in facts.analysis.traces
            if trace.unit == "counts" and trace.bus == bus and trace.node in nodes
            for words in scale_of(trace)
        }
    )


def _parting(facts: Facts, shaft: ShaftRow) -> str:
    assert shaft.parted_ns is not None
    assert shaft.parted_deg is not None
    way = "ahead" if shaft.parted_deg > 0 else "back"
    often = f"; it happened {shaft.parted} times" if shaft.parted > 1 else ""
    if shaft.shifted_deg is not None and abs(shaft.shifted_deg) > 1.2 * abs(shaft.parted_deg):
        often += f", and came to {abs(shaft.shifted_deg):.4g} deg"
    return (
        f"{facts.who(shaft.bus, shaft.node)} and {facts.inside(shaft.other_bus, shaft.other)} sit on"
        f" one shaft (bus description, ratio {shaft.ratio:g}), but since"
        f" {facts.moment(shaft.parted_ns)} the first one is {abs(shaft.parted_deg):.4g} deg further"
        f" {way} than before ({shaft.allowed_deg:g} deg are allowed at rest){often}."
    )


def _judged(facts: Facts) -> Iterator[TraceRow]:
    """Traces whose counts are in the right code."""
    for trace in facts.analysis.traces:
        if not events_of(facts.analysis, trace, "gray code"):
            yield trace


RULES: tuple[Rule, ...] = (
    Rule(
        "angle.step",
        "A position was moved between two samples while the shaft went on as before.",
        "The sample after the step.",
        (
            "Only what no machine can do: it would speed up and brake with 1000 rev/s^2.",
            "Three samples before and after must tell the same slow motion.",
            "Writes that explain it, resets, gaps and silences cut the trace instead.",
        ),
        _steps,
    ),
    Rule(
        "angle.step_unsure",
        "A position left its line so near to the end of the trace that it cannot be judged.",
        "The sample after the step.",
        (
            "Only a step that no machine begins with: 1000 rev/s^2.",
            "Steps that a write or a restart explains are none.",
            "It is a note: less than half a second follows, so that nobody is accused.",
        ),
        _unsure_steps,
    ),
    Rule(
        "angle.spike",
        "A single sample of a position is far off the line of those around it.",
        "The sample that is off.",
        (
            "Only what no machine can do: it would speed up and brake with 1000 rev/s^2.",
            "A frame that is too short holds no value.",
        ),
        _spikes,
    ),
    Rule(
        "angle.overspeed",
        "A shaft turned faster than its encoder may.",
        "The first sample of each such stretch.",
        (
            "Several samples in a row must tell the same speed; a single one is a jump.",
            "Stamps may be late by a millisecond, or by what frames come in bundles.",
            "Not told where the samples come too seldom to tell the speed.",
            "Not told where no speed limit is known.",
        ),
        _fast,
    ),
    Rule(
        "angle.sampled_too_seldom",
        "Samples of an encoder come too seldom to tell direction and speed of a fast shaft.",
        "The first sample after which the direction is not told.",
        (
            "From that sample to the last one like it; the spacing is that of most of these samples.",
            "Not told of a shaft whose samples stay nearer than a quarter of the range to one another.",
            "Not told where another PDO of the node comes often enough.",
            "Not told where no speed limit is known.",
        ),
        _seldom,
    ),
    Rule(
        "angle.noise",
        "A value scatters while nothing moves.",
        "The samples of the stretches at rest.",
        (
            "Only stretches whose mean does not move.",
            "A few counts are usual; it is a note, not a fault.",
        ),
        _noise,
        untimed=True,
    ),
    Rule(
        "angle.shafts_parted",
        "Two encoders on one shaft, by the bus description, no longer tell the same.",
        "The sample at which they parted.",
        (
            "Whole ranges are no difference where turns cannot be counted surely.",
            "What a lag explains is allowed where the speed changes: it moves nothing at an even one.",
            "Presets, resets, gaps and silences of either begin a new comparison.",
            "Single samples do not count: it must last half a second.",
        ),
        _parted,
    ),
    Rule(
        "angle.follow_one_another",
        "Two encoders follow one another over a long time: they may sit on one shaft.",
        "No single frame: both traces on a common grid of time.",
        (
            "At least a minute together, and each must turn by 45 deg and more.",
            "Even turning does not count: two even motions follow one another in any case.",
            "Not told of pairs that the bus description already places on one shaft.",
            "Only encoders of one bus whose counts per turn and range are known.",
        ),
        _followers,
    ),
)
