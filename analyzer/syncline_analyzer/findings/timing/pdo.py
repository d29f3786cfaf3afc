"""Findings on PDOs: those that stay away, come late, too often or not as they were set."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import milliseconds, moment, seconds
from syncline_analyzer.findings.timing.blame import Why, assumed_window, why_late, why_missed
from syncline_analyzer.findings.timing.stopping import SAME_MOMENT_NS, aftermath, was_commanded
from syncline_analyzer.findings.timing.sync import MAX_EVIDENCE, evidence_of, holes_of, together
from syncline_analyzer.results import Finding, HoleRow, PdoPauseRow, PdoRow, SdoObject
from syncline_schemas.wording import counted

_FEW = 3
_MANY_PERIODS = 20
_LONGER = 1.1
_PDO_SETTINGS = 0x1400
_OTHER_SETTINGS = (0x1005, 0x1006, 0x1007, 0x1010, 0x1011, 0x1019)
"""Settings below the PDO parameters that may change which PDOs are sent: SYNC, and storage."""
_SETTING_NS = 2_000_000_000
"""A setting written this soon after the last PDO may go with what stopped it [ns]."""
_ACTS_NS = 500_000_000
_ACTS_PERIODS = 3
"""A setting acts within this time, or so many periods of the PDO [ns]."""

_WHY_MISSED = Why(
    "The device was too busy or had no new value, it was about to leave OPERATIONAL, or the frame lost"
    " arbitration until the next one was due.",
    "Compare with EMCY messages and bus load at these times; read 180xh:2/5 and, on devices that have"
    " it, the repeat counter (280xh).",
    [],
)
_WHY_LATE = Why(
    "Frames of others can have kept the bus busy after the SYNC, or the device itself takes too long.",
    "Compare the bounds of the device time with the response: if the lower bound is small, relieve the"
    " bus (identifiers, types, bit rate); else look at the device.",
    [],
)


def _pdo_missed(facts: Facts) -> Iterator[Finding]:
    """PDOs that were due and did not come while their node was OPERATIONAL."""
    analysis = facts.analysis
    for row in analysis.pdos:
        if not row.missed or _other_period(row):
            continue
        stopped = [p for p in analysis.pdo_pauses if (p.bus, p.cob_id) == (row.bus, row.cob_id)]
        holes = [
            hole
            for hole in holes_of(analysis, "pdo", row)
            if hole.held_back < hole.missing
            and not any(p.start_ns <= hole.start_ns < p.end_ns for p in stopped)
            and not (hole.missing >= _MANY_PERIODS and _was_set(facts, row, hole.start_ns))
        ]
        for group in together(holes):
            yield _missed(facts, row, group)


def _missed(facts: Facts, row: PdoRow, group: Sequence[HoleRow]) -> Finding:
    missed = sum(hole.missing for hole in group)
    longest = max(group, key=lambda hole: hole.missing)
    synchronous = row.response_us is not None or (row.transmission_type or 0xFF) <= 0xF0
    due = "SYNC that it had to answer" if synchronous else "period of its event timer"
    in_a_row = f", up to {longest.missing} in a row" if longest.missing > 1 else ""
    often = (
        f" {missed} times{in_a_row}, each time after a {due}"
        if missed > 1
        else f"{facts.at(group[0].start_ns)} after a {due}"
    )
    why = why_missed(facts, row) or _WHY_MISSED
    return Finding(
        "pdo.missed",
        "warning",
        row.bus,
        row.node,
        group[0].start_ns,
        group[-1].end_ns,
        f"{named(facts, row)} did not come{often}; {_type(row)}.",
        why.cause,
        why.check_next,
        evidence_of(group),
        assumed=[*_assumed_type(row), *why.assumed],
    )


def _assumed_type(row: PdoRow) -> list[str]:
    """The transmission type, where only the device's EDS says so and the frames agree."""
    if row.type_source != "eds-default":
        return []
    return [f"180xh:2 = {row.transmission_type} (eds-default)"]


def _pdo_late(facts: Facts) -> Iterator[Finding]:
    """Answers after the synchronous window length."""
    analysis = facts.analysis
    for row in analysis.pdos:
        responses = [r for r in analysis.responses if (r.bus, r.cob_id) == (row.bus, row.cob_id)]
        if not row.late or not responses or row.response_us is None:
            continue
        slowest = responses[0].response_us.argsort()[::-1][: min(row.late, MAX_EVIDENCE)]
        t_ns = responses[0].t_ns[slowest]
        why = why_late(facts, row) or _WHY_LATE
        yield Finding(
            "pdo.late",
            "warning",
            row.bus,
            row.node,
            int(t_ns.min()),
            int(t_ns.max()) + 1,
            f"{named(facts, row)} answered {counted(row.late, 'time')} of {row.frames} later than"
            " the synchronous window (1007h) allows; the slowest took"
            f" {milliseconds(row.response_us.max)}.",
            why.cause,
            why.check_next,
            sorted(responses[0].seq[slowest].tolist()),
            assumed=[*assumed_window(facts, row), *why.assumed],
        )


def _stopped(facts: Facts) -> Iterator[Finding]:
    """PDOs that stopped while their node went on; those of one node and moment are one finding."""
    rows = [
        row
        for row in facts.analysis.pdo_pauses
        if not _was_set(facts, row, row.start_ns)
        and not was_commanded(facts, row, _period_ns(facts, row))
    ]
    rows.sort(key=lambda row: (row.bus, row.node, row.pdo[0], row.start_ns, row.cob_id))
    groups: list[list[PdoPauseRow]] = []
    for row in rows:
        last = groups[-1][-1] if groups else None
        own = (row.bus, row.node, row.pdo[0])
        same = last is not None and (last.bus, last.node, last.pdo[0]) == own
        if last is not None and same and row.start_ns - last.start_ns <= SAME_MOMENT_NS:
            groups[-1].append(row)
        else:
            groups.append([row])
    for group in groups:
        received = group[0].pdo.startswith("RPDO")
        yield _sender_stopped(facts, group) if received else _stop(facts, group)


def _stop(facts: Facts, group: list[PdoPauseRow]) -> Finding:
    first = group[0]
    names = list(dict.fromkeys(f"{row.pdo} ({row.cob_id:03X}h)" for row in group))
    due = max(row.due for row in group)
    start_ns, end_ns = min(r.start_ns for r in group), max(r.end_ns for r in group)
    back = all(row.resumed for row in group)
    after = aftermath(facts, group)
    until = f"came again after {seconds(end_ns - start_ns)}" if back else "did not come again"
    return Finding(
        "pdo.stopped",
        "error" if after.stayed and not back and not after.unsure else "warning",
        first.bus,
        first.node,
        start_ns,
        end_ns,
        f"{facts.who(first.bus, first.node)} stopped sending {' and '.join(names)} at"
        f" {moment(facts.analysis, start_ns)} though it"
        f" {'stayed' if after.stayed else 'had been'} OPERATIONAL: {due} were due by {first.basis};"
        f" it {until}.{after.told}",
        after.cause,
        after.check_next,
        sorted({seq for row in group for seq in row.evidence}),
        assumed=after.assumed,
    )


def _sender_stopped(facts: Facts, group: list[PdoPauseRow]) -> Finding:
    """RPDOs that do not come any more: their node only receives them."""
    first = group[0]
    names = " and ".join(dict.fromkeys(f"{row.pdo} ({row.cob_id:03X}h)" for row in group))
    start_ns, end_ns = min(r.start_ns for r in group), max(r.end_ns for r in group)
    back = all(row.resumed for row in group)
    until = f"It came again after {seconds(end_ns - start_ns)}" if back else "It did not come again"
    return Finding(
        "pdo.stopped",
        "warning",
        first.bus,
        first.node,
        start_ns,
        end_ns,
        f"Nobody sent {names} to {facts.inside(first.bus, first.node)} any more from"
        f" {moment(facts.analysis, start_ns)} on: {max(row.due for row in group)} were due by"
        f" {first.basis}. {until}.",
        f"Whoever sends it stopped, as a rule the master, or had nothing new to send; node {first.node}"
        " only receives it.",
        f"Look at the sender of {first.cob_id:03X}h: its program, its state, its own 180xh.",
        sorted({seq for row in group for seq in row.evidence}),
    )


def _was_set(facts: Facts, pdo: PdoRow | PdoPauseRow, t_ns: int) -> bool:
    """Whether somebody wrote a setting to the node at about the time when a PDO stopped.

    Those of error control, EMCY and identity stop no PDO, nor does one after which it went on.
    """
    acts_ns = max(_ACTS_NS, round(_ACTS_PERIODS * _period_ns(facts, pdo)))
    own = facts.analysis.sdo.accepted.of_node(pdo.bus, pdo.node or 0)
    ends_ns = own.of_objects(_may_stop).records["end_ns"]
    near = (t_ns - acts_ns <= ends_ns) & (ends_ns <= t_ns + _SETTING_NS)
    return bool(near.any())


def _may_stop(setting: SdoObject) -> bool:
    index = setting.index
    return index is None or index >= _PDO_SETTINGS or index in _OTHER_SETTINGS


def _period_ns(facts: Facts, pdo: PdoRow | PdoPauseRow) -> float:
    """Median period of a PDO, 0 where it is not known."""
    rows = (row for row in facts.analysis.pdos if (row.bus, row.cob_id) == (pdo.bus, pdo.cob_id))
    period = next((row.period_us for row in rows), None)
    return period.median * 1000 if period else 0.0


def _extra(facts: Facts) -> Iterator[Finding]:
    """Synchronous PDOs that came twice between two SYNCs."""
    for row in facts.analysis.pdos:
        told = row.transmission_type is not None and 1 <= row.transmission_type <= 0xF0
        seen = not row.type_source.startswith(("inferred", "unknown"))
        if not (told and seen) or row.extra_alone < _FEW:
            continue
        yield Finding(
            "pdo.extra",
            "warning",
            row.bus,
            row.node,
            _moment_of(facts, row.extra_first_ns),
            _moment_of(facts, row.extra_last_ns),
            f"{named(facts, row)} came a second time before the next SYNC"
            f", {row.extra_alone} times; {_type(row)}, which allows one.",
            "A second device sends the same identifier, or the device sends on events as well.",
            "Look for a second node with this identifier (180xh:1) or this node-ID; read 180xh:2.",
            row.extra_seq,
            assumed=_assumed_type(row),
        )


def _moment_of(facts: Facts, t_ns: int | None) -> int:
    return facts.analysis.capture.begin_ns if t_ns is None else t_ns


def _inhibit_time(facts: Facts) -> Iterator[Finding]:
    """Event-driven PDOs that come sooner than their inhibit time allows."""
    for row in facts.analysis.pdos:
        if row.too_soon < _FEW or row.inhibit_us is None or row.period_us is None:
            continue
        yield Finding(
            "pdo.inhibit_time",
            "warning",
            row.bus,
            row.node,
            _moment_of(facts, row.too_soon_first_ns),
            _moment_of(facts, row.too_soon_last_ns),
            f"{named(facts, row)} came {counted(row.too_soon, 'time')} in less than half of its"
            f" inhibit time of {milliseconds(row.inhibit_us)} (180xh:3); the shortest time between"
            f" two was {milliseconds(row.period_us.min)}.",
            "The device does not keep its inhibit time, or a second device sends the same"
            " identifier.",
            "Read 180xh:3, which some devices take only while the PDO is switched off; look for a"
            " second node with this identifier.",
            row.too_soon_seq,
        )


def _event_timer(facts: Facts) -> Iterator[Finding]:
    """Cyclic PDOs whose period is longer than their event timer."""
    for row in facts.analysis.pdos:
        if not _other_period(row) or row.period_us is None or row.event_timer_us is None:
            continue
        yield Finding(
            "pdo.event_timer",
            "warning",
            row.bus,
            row.node,
            facts.analysis.capture.begin_ns,
            facts.analysis.capture.end_ns,
            f"{named(facts, row)} comes every {milliseconds(row.period_us.median)}, its event timer"
            f" (180xh:5) is {milliseconds(row.event_timer_us)}.",
            "The device rounds the timer to steps of its own or did not take it, or its inhibit time"
            " is longer.",
            "Read 180xh:5 and 180xh:3; look up the smallest period that the device's manual allows.",
            [],
        )


def _other_period(row: PdoRow) -> bool:
    """Whether a PDO keeps another period than its event timer's: then none of them is missing."""
    if row.event_timer_us is None or row.period_us is None or row.frames < _MANY_PERIODS:
        return False
    return row.period_us.median > _LONGER * row.event_timer_us


def named(facts: Facts, row: PdoRow) -> str:
    """A PDO by its node, its number and its identifier, at the head of texts."""
    if row.pdo is None or row.node is None:
        return f"A PDO ({row.cob_id:03X}h)"
    name, _, guess = (row.pdo or "PDO").partition(" ")
    how = ", by its identifier alone" if guess else ""
    return f"{facts.who(row.bus, row.node)}: {name} ({row.cob_id:03X}h{how})"


def _type(row: PdoRow) -> str:
    """The transmission type in words, with its source."""
    if row.type_source.startswith("inferred"):
        return f"its transmission type is {row.type_source}"
    return f"its transmission type is {row.transmission_type} ({row.type_source})"


RULES = (
    Rule(
        "pdo.missed",
        "A PDO that was due did not come while its node was OPERATIONAL.",
        "The SYNCs without an answer, or the frame before the silence.",
        (
            (
                "Not where a repeat counter, transmission type 0 or the node's state explains it, nor a"
                " long stretch that begins when a setting is written to the node."
            ),
            (
                "Not over a capture gap or a step of the clock, nor where others are as late, nor where a"
                " PDO that only seems to answer SYNC comes as often as ever, before a SYNC or after."
            ),
            "Not where error frames may have kept the bus busy up to the next SYNC.",
            "One of an event timer is due from half a second after its node became OPERATIONAL on.",
            (
                "An RPDO, or a TPDO that only seems to answer every n-th SYNC, counts only where its"
                " frames waver with the SYNC; a TPDO also where its value stands still."
            ),
        ),
        _pdo_missed,
    ),
    Rule(
        "pdo.late",
        "A PDO came after the synchronous window (1007h).",
        "The slowest answers.",
        (
            "Only where 1007h is known.",
            "Not where SYNC and other nodes' answers are as late: then the clock was set.",
        ),
        _pdo_late,
    ),
    Rule(
        "pdo.stopped",
        "A PDO with a steady rhythm stopped while its node stayed OPERATIONAL.",
        "The last frame before the stop, and the first one after where it came again.",
        (
            "At least 5 s and 20 frames that were due.",
            (
                "Not where a repeat counter, transmission type 0, PDO-off bit, a setting written at that"
                " moment, or a command to all nodes that stops them explains it."
            ),
            (
                "A PDO whose rhythm is only seen must have repeated its data: a value that stands still"
                " sends no event."
            ),
            "Not in a silence of the whole bus, nor where SYNC itself stays away.",
            "An RPDO is laid to whoever sends it, not to the node that receives it, and is no error.",
            "Not a PDO that is sent because remote frames ask for it.",
            (
                "An event timer that only the device's EDS tells counts where the period has kept to it;"
                " then a pause that ended counts only where equal frames came before, and no unread"
                " repeat counter may explain it."
            ),
            (
                "An error only where the node's error control goes on and tells OPERATIONAL, and no"
                " value that stands still may explain it; it says where nothing watches the node."
            ),
        ),
        _stopped,
    ),
    Rule(
        "pdo.extra",
        "A synchronous PDO came twice between two SYNCs.",
        "The first 20 frames that came a second time.",
        (
            "Only where its transmission type is known, not where it is inferred.",
            "Not where a SYNC may have been lost, nor beside one that was not answered.",
        ),
        _extra,
        untimed=True,
    ),
    Rule(
        "pdo.inhibit_time",
        "An event-driven PDO came sooner than its inhibit time (180xh:3) allows.",
        "The first 20 frames that came too soon.",
        (
            (
                "Only where 180xh:2 and 180xh:3 were seen or described, and frames come in less than"
                " half of the time: arbitration may delay the one before."
            ),
        ),
        _inhibit_time,
    ),
    Rule(
        "pdo.event_timer",
        "A cyclic PDO comes with a longer period than its event timer (180xh:5).",
        "The median of its period.",
        ("Only where 180xh:2 and 180xh:5 were seen or described.", "Up to 10 % longer is none."),
        _event_timer,
    ),
)
