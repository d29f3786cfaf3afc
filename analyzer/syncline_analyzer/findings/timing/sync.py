"""Findings on SYNC (analysis.md 5)."""

from collections.abc import Iterator, Sequence

import numpy as np

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import milliseconds, seconds
from syncline_analyzer.folds.timing.sync_settings import PERIOD
from syncline_analyzer.results import Analysis, Finding, HoleRow, PdoRow, SyncJitterRow, SyncRow
from syncline_schemas.wording import counted

TOGETHER_NS = 10_000_000_000
"""Holes no further apart than this are one finding [ns]."""
MAX_FINDINGS = 10
"""More findings of one kind and identifier than this become one."""
MAX_EVIDENCE = 100
_LONG_SILENCE_NS = 1_000_000_000
_PERIOD_OFF = 0.05
_FEW_PERIODS = 20


def _sync_missing(facts: Facts) -> Iterator[Finding]:
    """SYNCs that did not come while nothing else explains it."""
    analysis = facts.analysis
    for row in analysis.sync:
        for group in together(holes_of(analysis, "sync", row)):
            yield _missing_syncs(facts, row, group)


def _missing_syncs(facts: Facts, row: SyncRow, group: Sequence[HoleRow]) -> Finding:
    missing = sum(hole.missing for hole in group)
    longest = max(group, key=lambda hole: hole.end_ns - hole.start_ns)
    longest_text = seconds(longest.end_ns - longest.start_ns)
    stayed = (
        f"it stayed away {len(group)} times, first{facts.at(group[0].start_ns)}, at most"
        f" {longest_text} long"
        if len(group) > 1
        else f"it stayed away for {longest_text}{facts.at(longest.start_ns)}"
    )
    verb = "is" if missing == 1 else "are"
    period = f"; the period is {milliseconds(row.period_us.median)}" if row.period_us else ""
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
        f"{counted(missing, 'SYNC')} of {row.cob_id:03X}h {verb} missing: {stayed}{period}.",
        cause,
        "Look at the SYNC producer (1006h, its cycle and CPU load, its error state) and for error"
        " frames at the same time.",
        evidence_of(group),
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
        f" by more than a tenth of {milliseconds(worst.period_us)}, the worst by"
        f" {milliseconds(worst.worst_us)}.",
        "The SYNC producer sends it from a task with a low priority, or its host is overloaded; if"
        " the recorder stamps in software, its own delay is in these numbers.",
        "Look at the cycle of the SYNC producer; record with hardware stamps to rule the recorder"
        " out.",
        [seq for row in rows for seq in row.evidence][:MAX_EVIDENCE],
    )


def holes_of(analysis: Analysis, service: str, row: SyncRow | PdoRow) -> list[HoleRow]:
    """Holes of one SYNC or PDO, in order of time."""
    return [
        hole
        for hole in analysis.holes
        if (hole.service, hole.bus, hole.cob_id) == (service, row.bus, row.cob_id)
    ]


def together(holes: Sequence[HoleRow]) -> list[list[HoleRow]]:
    """Holes in groups that belong together; all in one when there would be too many groups."""
    groups: list[list[HoleRow]] = []
    for hole in holes:
        if groups and 0 <= hole.start_ns - groups[-1][-1].end_ns <= TOGETHER_NS:
            groups[-1].append(hole)
        else:
            groups.append([hole])
    return groups if len(groups) <= MAX_FINDINGS else [list(holes)]


def evidence_of(group: Sequence[HoleRow]) -> list[int]:
    """The first frames that prove a group of holes."""
    return sorted({seq for hole in group for seq in hole.evidence})[:MAX_EVIDENCE]


def _two_producers(facts: Facts) -> Iterator[Finding]:
    """A second rhythm that joined the first, or left it."""
    for bus, cob_id in sorted({(row.bus, row.cob_id) for row in facts.analysis.sync_doubles}):
        rows = [r for r in facts.analysis.sync_doubles if (r.bus, r.cob_id) == (bus, cob_id)]
        first, last = rows[0], rows[-1]
        often = f" in {len(rows)} stretches" if len(rows) > 1 else ""
        yield Finding(
            "sync.two_producers",
            "error",
            bus,
            None,
            first.start_ns,
            last.end_ns,
            f"Two producers sent SYNC {cob_id:03X}h at the same time{often}: between those that come"
            f" every {milliseconds(first.period_us)} there were"
            f" {sum(row.pairs for row in rows)} more, the first {milliseconds(first.offset_us)}"
            " beside one of them.",
            "A second device was set to produce SYNC (1005h bit 30, 1006h), or a second master was"
            " connected.",
            "Read 1005h of all nodes: only one may have bit 30 set; look for a service tool on the"
            " bus.",
            first.evidence,
        )


def _sync_period(facts: Facts) -> Iterator[Finding]:
    """SYNC whose period is not the one that its producer was given (1006h)."""
    for row in facts.analysis.sync:
        for node, period_us in _producers(facts, row):
            found = _median_since(facts, row, node)
            if found is None or abs(found - period_us) <= _PERIOD_OFF * period_us:
                continue
            yield Finding(
                "sync.period",
                "warning",
                row.bus,
                node,
                facts.analysis.capture.begin_ns,
                facts.analysis.capture.end_ns,
                f"{facts.who(row.bus, node)} was set to send SYNC every {milliseconds(period_us)}"
                f" (1006h), but SYNC {row.cob_id:03X}h comes every {milliseconds(found)}.",
                "The device rounds the period to steps of its own, is overloaded, or another node"
                " sends SYNC.",
                "Read 1005h and 1006h of all nodes, and look up which periods the producer takes.",
                [],
            )


def _producers(facts: Facts, row: SyncRow) -> Iterator[tuple[int, int]]:
    """(node, 1006h) of each node that was seen to be set to produce this SYNC."""
    bus = facts.number(row.bus)
    for node in row.producer_nodes:
        period = facts.context.shadow.get(bus, node, PERIOD)
        if period is None or period.source == "eds-default" or not isinstance(period.value, int):
            continue
        if period.value:
            yield node, period.value


def _median_since(facts: Facts, row: SyncRow, node: int) -> float | None:
    """Median period [us] since 1006h was last seen to change; None with too few of them."""
    bus = facts.number(row.bus)
    period = facts.context.shadow.get(bus, node, PERIOD)
    since_ns = period.t_ns if period is not None and period.t_ns is not None else 0
    for series in facts.analysis.series:
        if (series.bus, series.name) == (row.bus, f"SYNC {row.cob_id:03X}h period"):
            chosen = series.value[series.t_ns > since_ns]
            return float(np.median(chosen)) if len(chosen) >= _FEW_PERIODS else None
    return None


RULES = (
    Rule(
        "sync.missing",
        "SYNC messages stayed away.",
        "The SYNCs around each hole.",
        (
            "Never over a capture gap or a step of the clock, nor where only the counter begins anew.",
            "A backlog that the recorder delivers at once counts nowhere; what it bundles is counted.",
            "Not while the master holds all nodes (stop, pre-operational or reset of all).",
            "Not where the producer is switched off just then (1005h bit 30, or 1006h = 0).",
            "Not where as many lines of the log could not be read.",
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
        "sync.two_producers",
        "Two producers sent SYNC on one identifier.",
        "The first SYNCs of the stretch in which both sent.",
        (
            (
                "Only where one of the two rhythms was also seen alone, and is kept: one with a coarse timer"
                " may alternate between two periods."
            ),
            "At least 20 SYNCs more; a producer that was set to another period makes none.",
        ),
        _two_producers,
    ),
    Rule(
        "sync.period",
        "SYNC does not come with the period that its producer was set to (1006h).",
        "The median of the periods since 1006h was seen.",
        (
            "Only where 1005h bit 30 and 1006h of the producer were seen or described.",
            "Deviations of up to 5 % are none.",
        ),
        _sync_period,
    ),
)
