"""Findings on time: the recorder's clock, and what the bus takes for the time."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import moment, seconds
from syncline_analyzer.folds.bus.time_stamp import TimeStand
from syncline_analyzer.results import ClockStepRow, Finding, TimeStampRow
from syncline_schemas.wording import counted

REORDERED_NS = 1_000_000
"""Stamps that run back by less are the driver's reordering, not a step of the clock [ns]."""
DIFFERS_NS = 60_000_000_000
"""TIME that is off the recorder's clock by less is not worth a word [ns]."""
MAX_FINDINGS = 20
STILL_NS = 2_500_000_000
"""TIME that says the same for so long stands still [ns]."""
_QUARTER_NS = 900_000_000_000
_ZONE_NS = 5_000_000_000
"""TIME this close to a whole quarter of an hour off is local time [ns]."""
_RECORDER = "Let the recorder's clock run in step (NTP, GPS) or record with the adapter's clock."


def _step_back(facts: Facts) -> Iterator[Finding]:
    """Steps back of the clock; the smaller disorder of a driver is told once."""
    steps = [step for step in facts.control.clock.steps if step.back_ns >= REORDERED_NS]
    for step in steps[:MAX_FINDINGS]:
        yield Finding(
            "clock.step_back",
            "warning",
            step.bus,
            None,
            step.t_ns,
            step.t_ns + step.back_ns,
            f"The stamps step back by {seconds(step.back_ns)}{facts.at(step.t_ns + step.back_ns)};"
            " durations across it are not told.",
            "The recorder's clock was set, or files were joined in the wrong order.",
            _RECORDER,
            [step.seq],
        )
    small = [step for step in facts.control.clock.steps if step.back_ns < REORDERED_NS]
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


def _step_forward(facts: Facts) -> Iterator[Finding]:
    """Steps forward, which look like a silence of everything; buses of one clock tell it once."""
    told: list[ClockStepRow] = []
    for step in sorted(facts.analysis.clock_steps, key=lambda row: row.end_ns):
        if any(step.start_ns <= each.end_ns and each.start_ns <= step.end_ns for each in told):
            continue
        told.append(step)
        yield Finding(
            "clock.step_forward",
            "warning",
            step.bus,
            None,
            step.start_ns,
            step.end_ns,
            f"The recorder's clock was set forward by {seconds(step.step_ns)}: after it"
            f" {step.witnesses} identifiers go on as if no time had passed, so nobody was silent.",
            "The recorder's clock was set while it recorded.",
            _RECORDER,
            step.evidence,
        )


def _time_differs(facts: Facts) -> Iterator[Finding]:
    """TIME on the bus that is far from the recorder's clock, by its first message."""
    seen: set[tuple[str, int]] = set()
    for row in facts.analysis.time_stamps:
        if row.offset_ns is None or (row.bus, row.cob_id) in seen:
            continue
        seen.add((row.bus, row.cob_id))
        if abs(row.offset_ns) >= DIFFERS_NS:
            yield _differs(facts, row, row.offset_ns)


def _differs(facts: Facts, row: TimeStampRow, offset_ns: int) -> Finding:
    side = "ahead of" if offset_ns > 0 else "behind"
    off_zone = abs(offset_ns - round(offset_ns / _QUARTER_NS) * _QUARTER_NS)
    local = off_zone <= _ZONE_NS and abs(offset_ns) <= 15 * 4 * _QUARTER_NS
    return Finding(
        "clock.time_differs",
        "info",
        row.bus,
        None,
        row.t_ns,
        row.t_ns,
        f"TIME on the bus ({row.cob_id:03X}h) says {row.text}: {seconds(abs(offset_ns))} {side} the"
        f" recorder's clock (UTC) at {moment(facts.analysis, row.t_ns)}.",
        "TIME is most likely local time, not UTC."
        if local
        else "The clock of the TIME producer, or that of the recorder, is not set.",
        "Mind the difference when you compare with logs of the machine's control.",
        [row.seq],
    )


def _time_jump(facts: Facts) -> Iterator[Finding]:
    """TIME that jumps while the recorder's clock runs on."""
    stepped = [(s.start_ns, s.end_ns) for s in facts.analysis.clock_steps]
    stepped += [(s.t_ns, s.t_ns + s.back_ns) for s in facts.control.clock.steps]
    for jump in facts.control.time.jumps[:MAX_FINDINGS]:
        low, high = sorted((jump.before.t_ns, jump.after.t_ns))
        if any(start <= high and low <= end for start, end in stepped):
            continue
        way = "forward" if jump.by_ns > 0 else "back"
        yield Finding(
            "clock.time_jump",
            "info",
            jump.after.bus,
            None,
            jump.before.t_ns,
            jump.after.t_ns,
            f"TIME on the bus ({jump.after.cob_id:03X}h) jumped {way} by"
            f" {seconds(abs(jump.by_ns))}, to {jump.after.text}.",
            "The clock of the TIME producer was set, or two nodes send TIME.",
            "Find out which node sends TIME (1012h) and who sets its clock.",
            [jump.before.seq, jump.after.seq],
        )


def _time_still(facts: Facts) -> Iterator[Finding]:
    """TIME that stands still, by identifier."""
    groups: dict[tuple[str, int], list[TimeStand]] = {}
    for stand in facts.control.time.stands:
        if stand.last.t_ns - stand.first.t_ns >= STILL_NS:
            groups.setdefault((stand.first.bus, stand.first.cob_id), []).append(stand)
    for (bus, cob_id), stands in groups.items():
        longest = max(stands, key=lambda each: each.last.t_ns - each.first.t_ns)
        often = f", {len(stands)} times in all" if len(stands) > 1 else ""
        yield Finding(
            "clock.time_still",
            "info",
            bus,
            None,
            stands[0].first.t_ns,
            stands[-1].last.t_ns,
            f"TIME on the bus ({cob_id:03X}h) stood still{often}: it said {longest.first.text} for"
            f" {seconds(longest.last.t_ns - longest.first.t_ns)}"
            f" from {moment(facts.analysis, longest.first.t_ns)} on.",
            "The clock of the TIME producer does not run (battery, never set), or its program sends"
            " a fixed value.",
            "Look at the clock of the node that sends TIME (1012h); logs that take their time from"
            " it are wrong.",
            [seq for each in stands[:MAX_FINDINGS] for seq in (each.first.seq, each.last.seq)],
        )


RULES = (
    Rule(
        "clock.step_back",
        "The stamps of the capture run back.",
        "The first frame after the step.",
        ("Disorder below 1 ms is the driver's and told once, as a note.",),
        _step_back,
        untimed=True,
    ),
    Rule(
        "clock.step_forward",
        "The recorder's clock was set forward; nobody was silent meanwhile.",
        "The first frame after the step.",
        (
            (
                "At least three identifiers that came steadily up to then, all heartbeats among them,"
                " go on after exactly one period and the same step."
            ),
            "Not where a true silence would look the same: what follows SYNC counts as one clock.",
            "Not where a node starts anew after it.",
        ),
        _step_forward,
    ),
    Rule(
        "clock.time_differs",
        "TIME on the bus is more than a minute off the recorder's clock.",
        "The first TIME message.",
        ("Only in captures with dates.",),
        _time_differs,
    ),
    Rule(
        "clock.time_jump",
        "TIME on the bus jumped while the recorder's clock ran on.",
        "The TIME messages before and after.",
        ("Not where the recorder's own clock was set, nor over a capture gap.",),
        _time_jump,
    ),
    Rule(
        "clock.time_still",
        "TIME on the bus stood still while the recorder's clock ran on.",
        "The first and the last TIME message with the same time.",
        (
            "The very same time for 2.5 s and more, in messages that go on.",
            "Not where the recorder was blind meanwhile.",
        ),
        _time_still,
    ),
)
