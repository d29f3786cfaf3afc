"""What an analyzer reported, held against the script of a run."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from syncline_samples.truth import ExpectedFinding


class Told(Protocol):
    """A finding of an analyzer, or a piece of its story; the times are `t`, ns."""

    @property
    def id(self) -> str: ...
    @property
    def node(self) -> int | None: ...
    @property
    def start_ns(self) -> int: ...
    @property
    def end_ns(self) -> int: ...
    @property
    def text(self) -> str: ...


class Reported(Told, Protocol):
    """A finding of an analyzer with what it says to have followed from it."""

    @property
    def chain(self) -> Sequence[Told]: ...


@dataclass(frozen=True, slots=True)
class Comparison:
    """Script and report side by side; a piece of a story counts like a finding of its own.

    Attributes:
        found: each required finding with what was reported of it.
        missing: required findings that nobody reported.
        allowed: reported findings that the script allows but does not require.
        unexpected: reported findings that the script knows nothing of.
    """

    found: list[tuple[ExpectedFinding, list[Told]]]
    missing: list[ExpectedFinding]
    allowed: list[Told]
    unexpected: list[Told]

    @property
    def agrees(self) -> bool:
        """Whether all was found and nothing invented."""
        return not self.missing and not self.unexpected


def compare(expected: Sequence[ExpectedFinding], reported: Iterable[Reported]) -> Comparison:
    """Hold a report against the script."""
    reports = [piece for report in reported for piece in (report, *report.chain)]
    found: list[tuple[ExpectedFinding, list[Told]]] = []
    missing: list[ExpectedFinding] = []
    for entry in (entry for entry in expected if entry.required):
        fitting = [report for report in reports if _fits(entry, report)]
        if fitting:
            found.append((entry, fitting))
        else:
            missing.append(entry)
    explained = {id(report) for _, fitting in found for report in fitting}
    rest = [report for report in reports if id(report) not in explained]
    allowed = [each for each in rest if any(_fits(entry, each) for entry in expected)]
    kept = {id(report) for report in allowed}
    return Comparison(found, missing, allowed, [each for each in rest if id(each) not in kept])


def _fits(entry: ExpectedFinding, report: Told) -> bool:
    same_node = entry.node is None or report.node is None or entry.node == report.node
    begins_in_time = report.start_ns < entry.end_ns
    ends_in_time = report.end_ns >= entry.start_ns
    same_id = report.id in (entry.id, *entry.or_as)
    return same_id and same_node and begins_in_time and ends_in_time
