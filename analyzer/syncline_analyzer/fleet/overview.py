"""The state of a whole fleet: its machines, what was found on them and when, and what they are."""

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import date, timedelta
from functools import cached_property
from typing import Any

from syncline_analyzer.fleet.captures import HEALTHY, FailureEntry
from syncline_analyzer.fleet.database import Database, Query
from syncline_analyzer.fleet.layout import UNDATED
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

SEVERITIES = ("error", "warning", HEALTHY)
"""Verdicts of captures, the worst first."""
MAX_COLUMNS = 62
"""Days of the map; a longer time is shown by weeks, then by months."""
NO_CAPTURE = "no capture"
"""Kind of a failure that is none: nothing says that the file should be a capture."""
_KEY = "machine, date, capture_id"
_IDENTITY = {0x1008: "told", 0x1009: "hardware", 0x100A: "software"}


class Capture(NamedTuple):
    """What the fleet's report tells of one capture."""

    machine: str
    date: str
    capture_id: str
    begun_ns: int | None
    verdict: str
    errors: int
    warnings: int
    infos: int
    frames: int
    duration_ns: int
    blind_ns: int
    error_frames: int
    unparsed_lines: int
    damages: int
    has_report: bool

    @property
    def rank(self) -> tuple[int, int, int]:
        """The smaller, the worse."""
        return SEVERITIES.index(self.verdict), -self.errors, -self.warnings


class Story(NamedTuple):
    """One kind of finding on one node of a machine, over all its captures.

    Attributes:
        findings, captures: how many there are, in how many captures.
        first_ns, last_ns: when it was seen first and last, UTC; None where no capture has a date.
        first_capture, last_capture: in which captures that was.
        text: of the last one.
    """

    machine: str
    id: str
    severity: str
    bus: str | None
    node: int | None
    findings: int
    captures: int
    first_ns: int | None
    last_ns: int | None
    first_capture: str
    last_capture: str
    text: str


class Kind(NamedTuple):
    """One kind of finding over the fleet; see `Story`."""

    id: str
    severity: str
    machines: int
    captures: int
    findings: int
    first_ns: int | None
    last_ns: int | None
    last_capture: str
    last_machine: str


class Device(NamedTuple):
    """Nodes that say the same of what they are.

    Attributes:
        device: as Syncline knows it, None where it does not.
        told, hardware, software: what 1008h, 1009h and 100Ah were, None where nobody asked.
        vendor, product, revision: 1018h:01 to 03.
        nodes: how many there are.
        machines: on which.
    """

    device: str | None
    told: str | None
    hardware: str | None
    software: str | None
    vendor: int | None
    product: int | None
    revision: int | None
    nodes: int
    machines: tuple[str, ...]


class Cell(NamedTuple):
    """A machine at a time of the map: its worst capture, and how many there are."""

    worst: Capture
    captures: int


_UNKNOWN = 1.5
"""Rank of a machine of which everything failed: before the healthy ones."""


@dataclass(frozen=True)
class Machine:
    """A machine with its captures in order of time, its stories, the gravest first, and failures.

    Attributes:
        lost_frames: at least so many were lost in gaps.
    """

    name: str
    captures: Sequence[Capture] = ()
    stories: Sequence[Story] = ()
    failures: int = 0
    lost_frames: int = 0

    @cached_property
    def verdict(self) -> str | None:
        """That of its worst capture; None without captures."""
        return min(self.captures, key=lambda each: each.rank).verdict if self.captures else None

    @property
    def latest(self) -> Capture | None:
        """Its last capture."""
        return self.captures[-1] if self.captures else None

    def count(self, verdict: str) -> int:
        """How many captures came out so."""
        return sum(each.verdict == verdict for each in self.captures)

    @cached_property
    def rank(self) -> tuple[Any, ...]:
        """Order of the machines, the worst first: those that are still in trouble before others."""
        place = SEVERITIES.index(self.verdict) if self.verdict else _UNKNOWN
        now = self.latest.rank[0] if self.latest else _UNKNOWN
        often = -self.count("error"), -self.count("warning"), -self.failures
        return place, now, *often, _by_number(self.name)


@dataclass(frozen=True)
class Overview:
    """All that the report of a fleet says, without its trends.

    Attributes:
        machines: the worst first.
        columns: times of the map: dates, weeks by their Monday, or months; `UNDATED` is the last.
        every: "day", "week" or "month": what a column stands for.
        kinds: the gravest and most frequent first.
        devices: by device, the most frequent of each first.
        failures: recordings that could not be analyzed.
        reports: ids of the captures of which there is a report.
    """

    machines: Sequence[Machine]
    columns: Sequence[str]
    every: str
    kinds: Sequence[Kind]
    devices: Sequence[Device]
    failures: Sequence[FailureEntry] = ()
    reports: frozenset[str] = frozenset()

    @property
    def captures(self) -> Iterable[Capture]:
        """All captures."""
        return (capture for machine in self.machines for capture in machine.captures)

    def cells(self, machine: Machine) -> dict[str, Cell]:
        """Row of a machine in the map, by column; times without a capture are not in it."""
        found: dict[str, list[Capture]] = {}
        for capture in machine.captures:
            found.setdefault(column_of(capture.date, self.every), []).append(capture)
        return {
            column: Cell(min(captures, key=lambda each: each.rank), len(captures))
            for column, captures in found.items()
        }


def overview(database: Database, failures: Sequence[FailureEntry] = ()) -> Overview:
    """The state of a fleet. Raises: UsageError, the data set cannot be read."""
    captures = _captures(database)
    stories, kinds = _stories(database)
    lost = {machine: int(count or 0) for machine, count in _rows(database, _LOST)}
    every, columns = _columns({capture.date for capture in captures})
    return Overview(
        _machines(captures, stories, failures, lost),
        columns,
        every,
        kinds,
        _devices(database),
        failures,
        frozenset(capture.capture_id for capture in captures if capture.has_report),
    )


def column_of(day: str, every: str) -> str:
    """Column of the map in which a date is.

    >>> column_of("2026-11-22", "day"), column_of("2026-11-22", "week"), column_of("2026-11-22", "month")
    ('2026-11-22', '2026-11-16', '2026-11')
    """
    if day == UNDATED or every == "day":
        return day
    if every == "month":
        return day[:7]
    when = date.fromisoformat(day)
    return (when - timedelta(days=when.weekday())).isoformat()


def _columns(days: set[str]) -> tuple[str, list[str]]:
    """What a column stands for, and all columns from the first date to the last; the latest ones."""
    dated = sorted(days - {UNDATED})
    if not dated:
        return "day", [UNDATED] if days else []
    first, last = date.fromisoformat(dated[0]), date.fromisoformat(dated[-1])
    span = (last - first).days + 1
    every = next((each for each, days_of in _STEPS if span <= days_of * MAX_COLUMNS), "month")
    columns = [column_of((first + timedelta(days=n)).isoformat(), every) for n in range(span)]
    kept = list(dict.fromkeys(columns))[-MAX_COLUMNS:]
    return every, [*kept, *([UNDATED] if UNDATED in days else [])]


_STEPS = (("day", 1), ("week", 7))


def _machines(
    captures: Iterable[Capture],
    stories: Iterable[Story],
    failures: Iterable[FailureEntry],
    lost: Mapping[str, int],
) -> list[Machine]:
    """All machines, also those of which everything failed."""
    by_machine = _grouped(captures)
    told = _grouped(stories)
    failed = _grouped(each for each in failures if each.kind != NO_CAPTURE)
    machines = [
        Machine(
            name,
            by_machine.get(name, ()),
            told.get(name, ()),
            len(failed.get(name, ())),
            lost.get(name, 0),
        )
        for name in {**by_machine, **failed}
    ]
    return sorted(machines, key=lambda each: each.rank)


def _by_number(name: str) -> list[tuple[int, str]]:
    """Key by which machine 9 comes before machine 10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in _NUMBER.split(name)]


_NUMBER = re.compile(r"(\d+)")


def _grouped(rows: Iterable[Any]) -> dict[str, list[Any]]:
    groups: dict[str, list[Any]] = {}
    for row in rows:
        groups.setdefault(row.machine, []).append(row)
    return groups


def _captures(database: Database) -> list[Capture]:
    return [
        Capture(*row)
        for row in _rows(
            database,
            f"""
            SELECT {_KEY}, start_utc_ns, verdict, errors, warnings, infos, frames, duration_ns,
                coalesce(blind_ns, 0), error_frames, unparsed_lines, len(damage), report
            FROM captures ORDER BY machine, start_utc_ns NULLS FIRST, capture_id
            """,
        )
    ]


def _stories(database: Database) -> tuple[list[Story], list[Kind]]:
    """What was found by machine and node, and by kind; the findings are read once."""
    worst = "CASE severity WHEN 'error' THEN 0 WHEN 'warning' THEN 1 ELSE 2 END"
    seen = 'coalesce(epoch_ns("start"), 0)'
    rows = _rows(
        database,
        f"""
        SELECT machine, id, severity, bus, node, count(*) AS findings,
            count(DISTINCT capture_id) AS captures,
            min(epoch_ns("start")), max(epoch_ns("start")) AS last_ns,
            arg_min(capture_id, {seen}), arg_max(capture_id, {seen}) AS last_capture,
            arg_max(text, {seen}), arg_max(machine, {seen}), count(DISTINCT machine)
        FROM findings
        GROUP BY GROUPING SETS ((machine, id, severity, bus, node), (id, severity))
        ORDER BY {worst}, captures DESC, findings DESC, id, machine, bus, node
        """,
    )
    stories = [Story(*row[:12]) for row in rows if row[0] is not None]
    kinds = [
        Kind(
            id=row[1],
            severity=row[2],
            machines=row[13],
            captures=row[6],
            findings=row[5],
            first_ns=row[7],
            last_ns=row[8],
            last_capture=row[10],
            last_machine=row[12],
        )
        for row in rows
        if row[0] is None
    ]
    return stories, kinds


_LOST = "SELECT machine, sum(lost_frames) FROM gaps WHERE lost_frames > 0 GROUP BY machine"


def _devices(database: Database) -> list[Device]:
    """What the nodes of the fleet are by what they said last, nodes that said the same together."""
    rows = _rows(
        database,
        f"""
        WITH begun AS (SELECT {_KEY}, coalesce(start_utc_ns, 0) AS begun_ns FROM captures),
        said AS (
            SELECT machine, bus, node,
                {", ".join(_last(f"index = {index}", name) for index, name in _IDENTITY.items())},
                {
            ", ".join(
                _last(f"index = {0x1018} AND sub = {sub}", name)
                for sub, name in ((1, "vendor"), (2, "product"), (3, "revision"))
            )
        }
            FROM objects JOIN begun USING ({_KEY})
            WHERE index IN ({0x1008}, {0x1009}, {0x100A}, {0x1018}) AND source LIKE 'sdo%'
            GROUP BY ALL
        ), known AS (
            SELECT machine, bus, node, arg_max(device, begun_ns) AS device
            FROM nodes JOIN begun USING ({_KEY}) GROUP BY ALL
        )
        SELECT device, told, hardware, software, vendor, product, revision, count(*) AS nodes,
            list_sort(list_distinct(list(machine)))
        FROM known LEFT JOIN said USING (machine, bus, node)
        WHERE coalesce(device, told, hardware, software, vendor) IS NOT NULL
        GROUP BY device, told, hardware, software, vendor, product, revision
        ORDER BY device NULLS LAST, told, nodes DESC, software, revision
        """,
    )
    return [
        Device(
            device=row[0],
            told=row[1],
            hardware=row[2],
            software=row[3],
            vendor=_whole(row[4]),
            product=_whole(row[5]),
            revision=_whole(row[6]),
            nodes=row[7],
            machines=tuple(row[8]),
        )
        for row in rows
    ]


def _last(condition: str, name: str) -> str:
    return f"arg_max(value, begun_ns) FILTER ({condition}) AS {name}"


def _whole(text: str | None) -> int | None:
    try:
        return None if text is None else int(text)
    except ValueError:
        return None


def _rows(database: Database, sql: str) -> list[tuple[Any, ...]]:
    with database.ask(Query(sql, {})) as reader:
        table = reader.read_all()
    return list(zip(*(column.to_pylist() for column in table.columns), strict=True))
