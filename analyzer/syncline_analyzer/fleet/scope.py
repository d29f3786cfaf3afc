"""Which captures of a data set are wanted: of which machines, begun when."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Self

from syncline_analyzer.fleet.captures import CaptureEntry, FailureEntry
from syncline_analyzer.fleet.questions import utc_ns
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Scope:
    """Some captures.

    Attributes:
        machine: whose; `*` and `?` stand for others. None for all.
        since_ns, until_ns: half-open span in which they began [ns since 1970]; captures without a
            date are in none.
        since, until: the same as they were asked for.
    """

    machine: str | None = None
    since_ns: int | None = None
    until_ns: int | None = None
    since: str | None = None
    until: str | None = None

    @classmethod
    def of(cls, machine: str | None, since: str | None, until: str | None) -> Self:
        """From what a user typed; dates are ISO, UTC. Raises: UsageError."""
        begin_ns, end_ns = (None if each is None else utc_ns(each) for each in (since, until))
        return cls(machine, begin_ns, end_ns, since, until)

    def of_these(self, captures: Sequence[CaptureEntry]) -> list[CaptureEntry]:
        """The wanted ones of some captures."""
        return [entry for entry in captures if self._has(entry)]

    def of_failures(self, failures: Sequence[FailureEntry]) -> list[FailureEntry]:
        """Those of some failures that are of the machines; nobody knows when they began."""
        machine = self.machine
        return [each for each in failures if machine is None or fnmatchcase(each.machine, machine)]

    @property
    def words(self) -> str:
        """What is wanted, as it is said after a name.

        >>> Scope(machine="press-*", since="2026-11-01").words
        ', machine press-*, since 2026-11-01'
        """
        told = (("machine", self.machine), ("since", self.since), ("before", self.until))
        return "".join(f", {name} {value}" for name, value in told if value is not None)

    def _has(self, entry: CaptureEntry) -> bool:
        begun_ns = entry.values["start_utc_ns"]
        if self.machine is not None and not fnmatchcase(entry.partition.machine, self.machine):
            return False
        if self.since_ns is not None and (begun_ns is None or begun_ns < self.since_ns):
            return False
        return self.until_ns is None or (begun_ns is not None and begun_ns < self.until_ns)


EVERYTHING = Scope()
"""All captures."""
