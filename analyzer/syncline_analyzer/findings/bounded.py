"""A bound on the number of findings, however much goes wrong: what is beyond it is counted."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.results import SEVERITY_RANK, Finding
from syncline_schemas.wording import counted

KINDS = 20
"""Findings of one rule on one node that are told one by one."""
PLACES = 200
"""Findings of one rule that are told one by one, over all nodes."""
_EVIDENCE = 40


def bounded(facts: Facts, findings: Iterable[Finding]) -> list[Finding]:
    """The findings, with one for all that are beyond the bound of a node or of a rule."""
    by_node = _cut(facts, findings, KINDS, lambda each: (each.id, each.bus, each.node))
    return _cut(facts, by_node, PLACES, lambda each: each.id)


def _cut(
    facts: Facts, findings: Iterable[Finding], most: int, key: Callable[[Finding], Any]
) -> list[Finding]:
    groups: dict[Any, list[Finding]] = {}
    for finding in findings:
        groups.setdefault(key(finding), []).append(finding)
    kept: list[Finding] = []
    for group in groups.values():
        if len(group) <= most + 1:
            kept.extend(group)
            continue
        ordered = sorted(group, key=lambda each: (SEVERITY_RANK[each.severity], each.start_ns))
        kept.extend([*ordered[:most], _rest(facts, ordered[most:])])
    return kept


def _rest(facts: Facts, findings: Sequence[Finding]) -> Finding:
    """One finding for many of one rule."""
    first = findings[0]
    places = {(each.bus, each.node) for each in findings}
    bus, node = places.pop() if len(places) == 1 else (None, None)
    nodes = {each.node for each in findings} - {None}
    whose = f" of {counted(len(nodes), 'node')}" if len(nodes) > 1 else ""
    start_ns = min(each.start_ns for each in findings)
    end_ns = max(each.end_ns for each in findings)
    span = f" between {facts.moment(start_ns)} and {facts.moment(end_ns)}"
    seqs = dict.fromkeys(seq for each in findings[:_EVIDENCE] for seq in each.evidence[:1])
    return Finding(
        first.id,
        first.severity,
        bus,
        node,
        start_ns,
        end_ns,
        f"And {len(findings):,} more kinds of {first.id}{whose}{span if facts.context.timed else ''};"
        f" the first of them: {first.text}",
        "There are too many to tell them one by one; those before stand for them.",
        "Look into the ones that are told one by one first; the tables hold the others.",
        list(seqs),
        assumed=list(dict.fromkeys(text for each in findings for text in each.assumed))[:_EVIDENCE],
    )
