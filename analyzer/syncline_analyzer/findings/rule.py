"""A rule: how one kind of finding is found, and what a reader may know of it."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import field, replace
from typing import Any, TypeVar

from syncline_analyzer.context import Context
from syncline_analyzer.findings.stretch import moment
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.results import Analysis, Finding
from syncline_schemas.records import dataclass

_T = TypeVar("_T")
_REMOTE_FRAMES = "empty data frames are remote frames, which the log does not mark"


@dataclass(frozen=True, slots=True)
class Facts:
    """What a rule may read: the tables, what the control fold knows besides, and the context."""

    analysis: Analysis
    control: ControlTables
    context: Context
    _found: dict[object, Any] = field(default_factory=dict, repr=False, compare=False)

    def once(self, find: "Callable[[Facts], _T]") -> _T:
        """What a function makes of these facts, worked out a single time for all rules."""
        if find not in self._found:
            self._found[find] = find(self)
        found: _T = self._found[find]
        return found

    def number(self, bus: str) -> int:
        """Number of a bus by its name, 0 where there is none of this name."""
        return self.context.buses.index(bus) if bus in self.context.buses else 0

    def who(self, bus: str, node: int) -> str:
        """A node as a sentence begins with it: its number, and its name where one is described."""
        name = self.context.shadow.name(self.number(bus), node)
        return f"Node {node} ({name})" if name else f"Node {node}"

    def inside(self, bus: str, node: int) -> str:
        """The same within a sentence."""
        who = self.who(bus, node)
        return who[:1].lower() + who[1:]

    def moment(self, t_ns: int) -> str:
        """A moment of the capture as time since its begin."""
        return moment(self.analysis, t_ns)

    def assumed_remote(self) -> list[str]:
        """What rests on remote frames assumes in a log that does not mark them."""
        return [_REMOTE_FRAMES] if self.analysis.capture.remote_lost else []

    def at(self, t_ns: int) -> str:
        """ " at +12.345 s", to go on in a sentence with; nothing in a log without times."""
        return f" at {self.moment(t_ns)}" if self.context.timed else ""


@dataclass(frozen=True, slots=True)
class Rule:
    """One kind of finding; `docs/findings.md` is made of these.

    Attributes:
        id: family and name, as in the table of findings.
        meaning: what the finding says, in one sentence.
        evidence: the frames that prove it.
        guards: what keeps the rule silent where nothing is wrong.
        find: the findings of a capture, in any order.
        untimed: whether a log without times is judged as well.
        by_remote: whether it rests on remote frames, and says so where a log does not mark them.
    """

    id: str
    meaning: str
    evidence: str
    guards: tuple[str, ...]
    find: Callable[[Facts], Iterable[Finding]]
    untimed: bool = False
    by_remote: bool = False


def apply(rules: Iterable[Rule], facts: Facts) -> list[Finding]:
    """Findings of the rules that can be judged on this capture, in the order of the rules."""
    timed = facts.context.timed
    return [
        finding for rule in rules if timed or rule.untimed for finding in _found_by(rule, facts)
    ]


def _found_by(rule: Rule, facts: Facts) -> Iterator[Finding]:
    """A rule's findings; those by remote frames say what a log that does not mark them left open."""
    assumed = facts.assumed_remote() if rule.by_remote else []
    for finding in rule.find(facts):
        yield replace(finding, assumed=[*finding.assumed, *assumed]) if assumed else finding
