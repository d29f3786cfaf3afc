"""Findings on SYNC and PDO timing (analysis.md 5)."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.results import Analysis, Finding, HoleRow, PdoRow, SyncJitterRow, SyncRow

TOGETHER_NS = 10_000_000_000
"""Holes no further apart than this are one finding [ns]."""
MAX_FINDINGS = 10
"""More findings of one kind and identifier than this become one."""
MAX_EVIDENCE = 100
_LONG_SILENCE_NS = 1_000_000_000


def _sync_missing(facts: Facts) -> Iterator[Finding]:
    """SYNCs that did not come while nothing else explains it."""
    analysis = facts.analysis
    for row in analysis.sync:
        for group in _together(_holes(analysis, "sync", row)):
            yield _missing_syncs(row, group)


def _missing_syncs(row: SyncRow, group: Sequence[HoleRow]) -> Finding:
    missing = sum(hole.missing for hole in group)
    longest = max(group, key=lambda hole: hole.end_ns - hole.start_ns)
    times = f"{len(group)} times" if len(group) > 1 else "once"
    period = f"; the period is {row.period_us.median / 1000:.4g} ms" if row.period_us else ""
    silent = longest.evidence[1] - longest.evidence[0] <= 1
    if silent and longest.end_ns - longest.start_ns >= _LONG_SILENCE_NS:
        cause = "Nothing else was heard either: the bus was interrupted, or the recorder paused."
    elif row.counter_jumps:
        cause = "The SYNC counter jumped: the frames were lost on the way, or not sent at all."
    else:
        cause = (
            "The SYNC producer did not send them (overloaded, restarted, bus-off), or they were"
            " destroyed on the bus."
        )
    return Finding(
        "sync.missing",
        "warning",
        row.bus,
        None,
        group[0].start_ns,
        group[-1].end_ns,
        f"{_count(missing, 'SYNC')} of {row.cob_id:03X}h missing: it stayed away {times}, at most"
        f" {seconds(longest.end_ns - longest.start_ns)} long{period}.",
        cause,
        "Look at the SYNC producer (1006h, its cycle and CPU load, its error state) and for error"
        " frames at the same time.",
        _evidence(group),
    )


def _sync_jitter(facts: Facts) -> Iterator[Finding]:
    analysis = facts.analysis
    for bus, cob_id in sorted({(row.bus, row.cob_id) for row in analysis.sync_jitter}):
        rows = [row for row in analysis.sync_jitter if (row.bus, row.cob_id) == (bus, cob_id)]
        if len(rows) > MAX_FINDINGS:
            yield _jitter(rows)
        else:
            yield from (_jitter([row]) for row in rows)


def _jitter(rows: Sequence[SyncJitterRow]) -> Finding:
    off, periods = sum(row.off for row in rows), sum(row.periods for row in rows)
    worst = max(rows, key=lambda row: row.worst_us)
    stretches = f" in {len(rows)} stretches" if len(rows) > 1 else ""
    return Finding(
        "sync.jitter",
        "warning",
        worst.bus,
        None,
        min(row.start_ns for row in rows),
        max(row.end_ns for row in rows),
        f"SYNC {worst.cob_id:03X}h comes irregularly{stretches}: {off} of {periods} periods are off"
        f" by more than a tenth of {worst.period_us / 1000:.4g} ms, the worst by"
        f" {worst.worst_us / 1000:.4g} ms.",
        "The SYNC producer sends it from a task with a low priority, or its host is overloaded; if"
        " the recorder stamps in software, its own delay is in these numbers.",
        "Look at the cycle of the SYNC producer; record with hardware stamps to rule the recorder"
        " out.",
        [seq for row in rows for seq in row.evidence][:MAX_EVIDENCE],
    )


def _pdo_missed(facts: Facts) -> Iterator[Finding]:
    """PDOs that were due and did not come while their node was OPERATIONAL."""
    analysis = facts.analysis
    for row in analysis.pdos:
        for group in _together(_holes(analysis, "pdo", row)) if row.missed else ():
            yield _missed(row, group)


def _missed(row: PdoRow, group: Sequence[HoleRow]) -> Finding:
    missed = sum(hole.missing for hole in group)
    longest = max(group, key=lambda hole: hole.missing)
    synchronous = row.response_us is not None or (row.transmission_type or 0xFF) <= 0xF0
    due = "SYNC that it had to answer" if synchronous else "period of its event timer"
    in_a_row = f", up to {longest.missing} in a row" if longest.missing > 1 else ""
    return Finding(
        "pdo.missed",
        "warning",
        row.bus,
        row.node,
        group[0].start_ns,
        group[-1].end_ns,
        f"{_name(row)} did not come {_count(missed, 'time')}{in_a_row}, each time after a {due};"
        f" {_type(row)}.",
        "The device was too busy or had no new value, it was about to leave OPERATIONAL, or the"
        " frame lost arbitration until the next one was due.",
        "Compare with EMCY messages and bus load at these times; read 180xh:2/5 and, on devices"
        " that have it, the repeat counter (280xh).",
        _evidence(group),
    )


def _pdo_late(facts: Facts) -> Iterator[Finding]:
    """Answers after the synchronous window length."""
    analysis = facts.analysis
    for row in analysis.pdos:
        responses = [r for r in analysis.responses if (r.bus, r.cob_id) == (row.bus, row.cob_id)]
        if not row.late or not responses or row.response_us is None:
            continue
        slowest = responses[0].response_us.argsort()[::-1][: min(row.late, MAX_EVIDENCE)]
        t_ns = responses[0].t_ns[slowest]
        yield Finding(
            "pdo.late",
            "warning",
            row.bus,
            row.node,
            int(t_ns.min()),
            int(t_ns.max()) + 1,
            f"{_name(row)} answered {_count(row.late, 'time')} of {row.frames} later than the"
            f" synchronous window (1007h) allows; the slowest took"
            f" {row.response_us.max / 1000:.4g} ms.",
            "Frames with a higher priority kept the bus busy after the SYNC, or the device itself"
            " takes too long.",
            "Compare the bounds of the device time with the response: if the lower bound is small,"
            " relieve the bus (identifiers, types, bit rate); else look at the device.",
            sorted(responses[0].seq[slowest].tolist()),
        )


def _holes(analysis: Analysis, service: str, row: SyncRow | PdoRow) -> list[HoleRow]:
    return [
        hole
        for hole in analysis.holes
        if (hole.service, hole.bus, hole.cob_id) == (service, row.bus, row.cob_id)
    ]


def _together(holes: Sequence[HoleRow]) -> list[list[HoleRow]]:
    """Holes in groups that belong together; all in one when there would be too many groups."""
    groups: list[list[HoleRow]] = []
    for hole in holes:
        if groups and 0 <= hole.start_ns - groups[-1][-1].end_ns <= TOGETHER_NS:
            groups[-1].append(hole)
        else:
            groups.append([hole])
    return groups if len(groups) <= MAX_FINDINGS else [list(holes)]


def _evidence(group: Sequence[HoleRow]) -> list[int]:
    return sorted({seq for hole in group for seq in hole.evidence})[:MAX_EVIDENCE]


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _name(row: PdoRow) -> str:
    whose = f"{row.pdo} of node {row.node}" if row.pdo else "A PDO"
    return f"{whose} ({row.cob_id:03X}h)"


def _type(row: PdoRow) -> str:
    """The transmission type in words, with its source."""
    if row.type_source.startswith("inferred"):
        return f"its transmission type is {row.type_source}"
    return f"its transmission type is {row.transmission_type} ({row.type_source})"


RULES = (
    Rule(
        "sync.missing",
        "SYNC messages stayed away.",
        "The SYNCs around each hole.",
        (
            "Never over a capture gap or a step of the clock.",
            "A backlog that the recorder delivers at once counts nowhere.",
        ),
        _sync_missing,
    ),
    Rule(
        "sync.jitter",
        "SYNC periods lie off their mean by a tenth and more, again and again.",
        "The first SYNCs that are off.",
        ("One period that is off is none; a backlog of the recorder counts nowhere.",),
        _sync_jitter,
    ),
    Rule(
        "pdo.missed",
        "A PDO that was due did not come while its node was OPERATIONAL.",
        "The SYNCs without an answer, or the frame before the silence.",
        (
            "Not where a repeat counter, transmission type 0 or the node's state explains it.",
            "Not over a capture gap or a step of the clock.",
        ),
        _pdo_missed,
    ),
    Rule(
        "pdo.late",
        "A PDO came after the synchronous window (1007h).",
        "The slowest answers.",
        ("Only where 1007h is known.",),
        _pdo_late,
    ),
)
