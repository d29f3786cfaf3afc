"""Stories: findings that follow from another finding become links of its chain (analysis.md 8)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from syncline_analyzer.results import Finding, Link

_RANK = {"error": 0, "warning": 1, "info": 2}


@dataclass(frozen=True, slots=True)
class Bond:
    """That one kind of finding can be the consequence of another.

    Attributes:
        cause, effect: ids of the findings.
        after_ns: the effect begins no later than this after the cause ended.
        before_ns: nor earlier than this before the cause was seen to begin.
        same_node: whether both must be about one node; else about one bus.
        lasting: whether the effect may go on long after the cause, as an active error does.
    """

    cause: str
    effect: str
    after_ns: int
    before_ns: int = 1_000_000_000
    same_node: bool = True
    lasting: bool = False

    def holds(self, cause: Finding, effect: Finding) -> bool:
        """Whether the effect follows from the cause by place and time."""
        if (cause.id, effect.id) != (self.cause, self.effect) or cause.bus != effect.bus:
            return False
        if self.same_node and (cause.node is None or cause.node != effect.node):
            return False
        begins = cause.start_ns - self.before_ns <= effect.start_ns <= cause.end_ns + self.after_ns
        return begins and (self.lasting or effect.end_ns <= cause.end_ns + self.after_ns)


_S = 1_000_000_000
_FOREVER = 1 << 62

BONDS: tuple[Bond, ...] = (
    *(
        Bond("nmt.duplicate_node_id", effect, _FOREVER, before_ns=10 * _S)
        for effect in (
            "nmt.unexpected_reset",
            "nmt.command_ignored",
            "nmt.pdo_outside_operational",
            "nmt.left_operational",
            "nmt.heartbeat_slow",
        )
    ),
    Bond("nmt.node_lost", "nmt.unexpected_reset", _S),
    Bond("nmt.node_lost", "pdo.missed", _S),
    Bond("nmt.unexpected_reset", "emcy.active", 5 * _S, lasting=True),
    Bond("nmt.unexpected_reset", "pdo.missed", 5 * _S),
)
"""Causes before what follows from them; of several the first one that holds is taken."""


def joined(findings: Sequence[Finding]) -> list[Finding]:
    """The findings that are the root of a story, each with what followed from it.

    A story is as severe as the worst of its pieces.
    """
    parents = [_cause_of(effect, findings) for effect in findings]
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


def _cause_of(effect: Finding, findings: Sequence[Finding]) -> int | None:
    """Number of the finding that an effect follows from: the nearest one of the first bond."""
    for bond in BONDS:
        if bond.effect != effect.id:
            continue
        held = [
            number
            for number, cause in enumerate(findings)
            if cause is not effect and bond.holds(cause, effect)
        ]
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
    links = [*root.chain, *(link for effect in effects for link in _links(effect))]
    worst = min([root, *effects], key=lambda finding: _RANK[finding.severity])
    assumed = [*root.assumed, *(text for effect in effects for text in effect.assumed)]
    return replace(
        root,
        severity=worst.severity,
        chain=sorted(links, key=lambda link: (link.start_ns, link.id)),
        assumed=list(dict.fromkeys(assumed)),
    )


def _links(finding: Finding) -> list[Link]:
    own = Link(
        finding.id,
        finding.bus,
        finding.node,
        finding.start_ns,
        finding.end_ns,
        finding.text,
        finding.evidence,
    )
    return [own, *finding.chain]
