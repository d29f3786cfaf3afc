"""Findings on SDO transfers that keep synchronous PDOs waiting."""

import math
from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import milliseconds
from syncline_analyzer.findings.timing.ahead import (
    EXACT_STAMPS,
    assumed,
    evidence_of,
    is_late,
    late_waits,
    listed,
    named_pdo,
    sync_period_us,
)
from syncline_analyzer.findings.timing.blame import behind, waits_of
from syncline_analyzer.results import Ahead, Finding, LatenessRow, Quantiles

_SLOWER = 0.1
"""Share of the SYNC period by which SDO traffic must slow down the answers."""
_MOST = 0.5
_FEW = 3
_ENOUGH = 20
_BESIDE_SDO = 0.8
"""So many of the late answers beside SDO traffic make it the cause."""
_CHANCE = 0.01


def _sdo(facts: Facts) -> Iterator[Finding]:
    """PDOs that come late while SDO transfers with their node go on."""
    for row in facts.analysis.lateness:
        rare = row.beside_sdo <= _MOST * row.answers
        if rare and _late_beside_sdo(row):
            which = (
                f"{row.late_by_device_beside_sdo} of {row.late_by_device} answers that the device"
            )
            yield _beside_sdo(facts, row, "warning", f"{which} itself made late")
            continue
        period_us = sync_period_us(facts, row.bus)
        slow, usual = row.device_us_beside_sdo, row.device_us_without_sdo
        if period_us and slow and usual and rare and row.beside_sdo >= _ENOUGH:
            resolution_us = facts.context.resolution_ns / 1000
            more_us = max(_SLOWER * period_us, 2 * resolution_us)
            if slow.median > max(usual.p99, _at_most_us(facts, row)) + more_us:
                yield _beside_sdo(facts, row, "info", "the slow answers")
    yield from _behind_sdo(facts)


def _late_beside_sdo(row: LatenessRow) -> bool:
    """Whether what the device made late itself comes beside SDO traffic, and not by chance."""
    late, beside = row.late_by_device, row.late_by_device_beside_sdo
    if beside < max(_FEW, _BESIDE_SDO * late) or not row.beside_sdo:
        return False
    # Chernoff's bound of the chance to find so many of them beside it.
    share, usual = beside / late, row.beside_sdo / row.answers
    bits = share * math.log(share / usual)
    if share < 1:
        bits += (1 - share) * math.log((1 - share) / (1 - usual))
    return late * bits >= -math.log(_CHANCE)


def _at_most_us(facts: Facts, row: LatenessRow) -> float:
    """Half of the answers took the device no longer than this."""
    pdos = facts.analysis.pdos
    pdo = next((p for p in pdos if (p.bus, p.cob_id) == (row.bus, row.cob_id)), None)
    return pdo.device_us_high.median if pdo and pdo.device_us_high else float("inf")


def _beside_sdo(facts: Facts, row: LatenessRow, severity: str, which: str) -> Finding:
    late = severity == "warning"
    chosen = late_waits(facts, row) if late else waits_of(facts, row)
    waits = [wait for wait in chosen if late or not is_late(wait, row)]
    return Finding(
        "sdo.delays_pdo",
        "warning" if late else "info",
        row.bus,
        row.node,
        min((wait.t_ns for wait in waits), default=facts.analysis.capture.begin_ns),
        max((wait.t_ns for wait in waits), default=facts.analysis.capture.begin_ns) + 1,
        f"{named_pdo(facts, row)} answers SYNC later while SDO transfers with its node go on: {which}"
        f" come beside them, though only {row.beside_sdo} of {row.answers} answers do; the device"
        f" then takes {_median(row.device_us_beside_sdo)}, else {_median(row.device_us_without_sdo)}"
        " (median of the least it can have taken).",
        "The device works off SDO requests before it sends its PDOs.",
        "Read and write its objects less often while the machine runs, or let the program wait"
        " between two transfers.",
        evidence_of(waits),
        assumed=assumed(facts, row),
    )


def _behind_sdo(facts: Facts) -> Iterator[Finding]:
    """PDOs that SDO frames on the wire made late."""
    for row in facts.analysis.lateness:
        late = behind(facts, row, _is_sdo)
        if late is None:
            continue
        yield Finding(
            "sdo.delays_pdo",
            "warning",
            row.bus,
            row.node,
            row.late_first_ns or 0,
            (row.late_last_ns or 0) + 1,
            f"{named_pdo(facts, row)} was late {late} behind SDO traffic:"
            f" {listed(facts, row.bus, late.ahead)}.",
            "A program reads or writes objects in a burst while the machine runs.",
            "Let the program wait between two transfers; SDO needs no more than a few frames per"
            " SYNC period.",
            evidence_of(late_waits(facts, row)),
            assumed=assumed(facts, row),
        )


def _is_sdo(each: Ahead) -> bool:
    return each.service.startswith("SDO")


def _median(quantiles: Quantiles | None) -> str:
    return milliseconds(quantiles.median) if quantiles else "unknown time"


RULES = (
    Rule(
        "sdo.delays_pdo",
        "A synchronous PDO comes late while SDO transfers go on.",
        "The late answers, or the slowest ones, and the frames ahead of them.",
        (
            EXACT_STAMPS,
            (
                "Only where SDO traffic stands beside at most half of the answers, but beside four fifths"
                " of those that the device itself made late, more than by chance; or where the device"
                " takes longer beside it for certain, by a tenth of the SYNC period."
            ),
            ("Late behind SDO frames are only answers that would have been in time without them."),
        ),
        _sdo,
    ),
)
