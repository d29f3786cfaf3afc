"""PDOs that somebody waits for: by remote frames, or with a deadline."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import milliseconds
from syncline_analyzer.findings.timing.pdo import named
from syncline_analyzer.results import Finding, PdoRow
from syncline_schemas.wording import counted

FEW = 3
"""Requests without an answer that are worth telling."""
_TIMEOUT = 0x8250
"""RPDO timeout (CiA 301 7.2.7)."""


def _not_answered(facts: Facts) -> Iterator[Finding]:
    """Remote frames to a PDO that nobody answers."""
    for row in (*facts.analysis.pdos, *facts.analysis.unsent_pdos):
        first_ns, last_ns = row.unanswered_first_ns, row.unanswered_last_ns
        known = row.node is not None and _was_operational(facts, row)
        if row.unanswered < FEW or first_ns is None or last_ns is None or not known:
            continue
        never = not row.asked_answered
        rest = "none of them" if never else f"{counted(row.unanswered, 'time')} in vain"
        yield Finding(
            "pdo.not_answered",
            "info" if never else "warning",
            row.bus,
            row.node,
            first_ns,
            last_ns + 1,
            f"{named(facts, row)} was asked for by {counted(row.asked, 'remote frame')}"
            f"{', and answered ' + rest if never else ', ' + rest}, while the node was OPERATIONAL.",
            "The PDO does not take remote frames (bit 30 of 180xh:1), or the controller of the device"
            " does not."
            if never
            else "The device was too busy, or left the bus for a while; it answers at other times.",
            "Read 180xh:1 and 180xh:2 of the node; an event timer or SYNC serves better than remote"
            " frames."
            if never
            else "Compare with EMCY messages, heartbeat and bus load at these times.",
            row.unanswered_seq,
        )


def _was_operational(facts: Facts, row: PdoRow) -> bool:
    """Whether the node itself said that it was OPERATIONAL."""
    return any(
        (each.bus, each.node, each.state) == (row.bus, row.node, "OPERATIONAL")
        and each.certainty == "observed"
        for each in facts.analysis.nmt_states
    )


def _deadline(facts: Facts) -> Iterator[Finding]:
    """RPDOs that come later than their node allows."""
    for row in facts.analysis.pdos:
        first_ns, last_ns = row.overdue_first_ns, row.overdue_last_ns
        if not row.overdue or first_ns is None or last_ns is None or row.deadline_us is None:
            continue
        complains = any(
            (emcy.bus, emcy.node, emcy.code) == (row.bus, row.node, _TIMEOUT)
            for emcy in facts.analysis.emcy
        )
        said = "; the node complains of that with EMCY 8250h" if complains else ""
        longest = f" at most {milliseconds(row.period_us.max)}" if row.period_us else ""
        yield Finding(
            "pdo.deadline",
            "warning" if complains else "info",
            row.bus,
            row.node,
            first_ns,
            last_ns + 1,
            f"{named(facts, row)} was to come every {milliseconds(row.deadline_us)} at most (140xh:5)"
            f" and took longer {counted(row.overdue, 'time')},{longest}{said}.",
            "The sender of the PDO (the controller) paused or sends it only on changes; the node"
            " itself only waits.",
            "Look at the controller's cycle and load at these times; is its event timer shorter than"
            " 140xh:5 of the node?",
            row.overdue_seq,
        )


RULES: tuple[Rule, ...] = (
    Rule(
        "pdo.not_answered",
        "A PDO was asked for by remote frames and did not come.",
        "The first 20 requests without an answer.",
        (
            "Only while the node was OPERATIONAL by its own word, from 3 requests on.",
            "Repeated requests within 20 ms count once; none in a capture gap or a silence of the bus.",
            "An info where it never answers: then it is a setting.",
        ),
        _not_answered,
    ),
    Rule(
        "pdo.deadline",
        "An RPDO came later than its node allows (140xh:5).",
        "The frame before each of the first 20 pauses.",
        (
            "Only where 140xh:5 was seen or described, and only while the node was OPERATIONAL.",
            "Up to 10 % longer is none, nor a silence of the whole bus or a step of the clock.",
            "An info unless the node says so too (EMCY 8250h).",
        ),
        _deadline,
    ),
)
