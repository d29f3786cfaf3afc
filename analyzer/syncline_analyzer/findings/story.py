"""Stories: findings that follow from another finding become links of its chain (analysis.md 8)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from syncline_analyzer.findings.bonds import BONDS
from syncline_analyzer.results import SEVERITY_RANK, Finding


def joined(findings: Sequence[Finding]) -> list[Finding]:
    """The findings that are the root of a story, each with what followed from it.

    A story is as severe as the worst of its pieces.
    """
    by_id: dict[str, list[int]] = {}
    for number, finding in enumerate(findings):
        by_id.setdefault(finding.id, []).append(number)
    parents = [_cause_of(effect, findings, by_id) for effect in findings]
    members: dict[int, list[Finding]] = {}
    for number, finding in enumerate(findings):
        root = _root(number, parents)
        if root != number:
            members.setdefault(root, []).append(finding)
    return [
        _told(finding, members.get(number, []))
        for number, finding in enumerate(findings)
        if parents[number] is None
    ]


def _cause_of(
    effect: Finding, findings: Sequence[Finding], by_id: Mapping[str, Sequence[int]]
) -> int | None:
    """Number of the finding that an effect follows from: the nearest one of the first bond."""
    for bond in BONDS:
        if bond.effect != effect.id:
            continue
        held = [n for n in by_id.get(bond.cause, ()) if bond.holds(findings[n], effect)]
        if held:
            return min(held, key=lambda n: abs(findings[n].start_ns - effect.start_ns))
    return None


def _root(number: int, parents: Sequence[int | None]) -> int:
    parent = parents[number]
    while parent is not None:
        number, parent = parent, parents[parent]
    return number


def _told(root: Finding, effects: Sequence[Finding]) -> Finding:
    if not effects:
        return root
    followed = (link for effect in effects for link in (effect.as_link(), *effect.chain))
    links = [*root.chain, *followed]
    worst = min([root, *effects], key=lambda finding: SEVERITY_RANK[finding.severity])
    assumed = [*root.assumed, *(text for effect in effects for text in effect.assumed)]
    return replace(
        root,
        severity=worst.severity,
        chain=sorted(links, key=lambda link: (link.start_ns, link.id)),
        assumed=list(dict.fromkeys(assumed)),
    )
