"""Ready-made questions to a data set: each makes one SQL statement of its options.

A capture counts for the day on which it began (UTC). Captures without a date are left out of every
question that has a time in it.
"""

import inspect
import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any

from syncline_analyzer.fleet.database import Query
from syncline_analyzer.fleet.quantities import QUANTITIES, Quantity, quantity_named
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

EVERY = ("day", "week", "month")
_CODE = re.compile(r"(?:0x)?(?!0x)([0-9a-fx]{4})h?", re.IGNORECASE)
_SIGMA = 1.4826
"""Median absolute deviation to standard deviation, of normal values."""
_OF_CAPTURE = "machine, date, capture_id"


def emcy(
    *,
    code: str | None = None,
    since: str | None = None,
    until: str | None = None,
    machine: str | None = None,
    bus: str | None = None,
    node: int | None = None,
) -> Query:
    """Which machines had an EMCY since a date: by machine, node and code, the latest first.

    Args:
        code: emergency error code, `7320h`; `x` stands for any digit, `73xxh`; any by default.
        since, until: ISO date or time, UTC; the half-open span of the messages.
        machine: its name; `*` and `?` stand for others.
        bus, node: of the node.
    """
    where = _Conditions()
    where.add("code <> 0")
    if code is not None:
        where.add("format('{:04X}', code) LIKE $code", code=_code_pattern(code))
    _add_place(where, machine, bus, node)
    for sign, moment in ((">=", since), ("<", until)):
        if moment is not None:
            name = "since_ns" if sign == ">=" else "until_ns"
            where.add(f"t IS NOT NULL AND t_ns {sign} ${name}", **{name: utc_ns(moment)})
    return where.query(f"""
        SELECT machine, bus, node, any_value(name) AS name, format('{{:04X}}h', code) AS code,
            any_value(meaning) AS meaning, count(*) AS messages,
            count(DISTINCT capture_id) AS captures, min(t) AS first, max(t) AS last
        FROM emcy LEFT JOIN (SELECT {_OF_CAPTURE}, bus, node, name FROM nodes)
            USING ({_OF_CAPTURE}, bus, node)
        WHERE {where.sql}
        GROUP BY machine, bus, node, emcy.code ORDER BY last DESC NULLS LAST, machine, bus, node, emcy.code
    """)


def over_time(
    *,
    quantity: str,
    every: str = "week",
    since: str | None = None,
    until: str | None = None,
    machine: str | None = None,
    bus: str | None = None,
    node: int | None = None,
    min_samples: int = 10,
) -> Query:
    """A quantity by node over weeks: its value in each, and how far the captures lie apart.

    Args:
        quantity: name in `QUANTITIES`.
        every: "day", "week" (from Monday on) or "month".
        since, until: ISO date or time, UTC; the half-open span in which captures began.
        machine: its name; `*` and `?` stand for others.
        bus, node: of the node.
        min_samples: captures with fewer are left out, where a value is made from samples.
    """
    of = quantity_named(quantity)
    if every not in EVERY:
        raise UsageError(f"every '{every}': it is one of {', '.join(EVERY)}")
    where = _Conditions()
    _add_scope(where, since, until, machine, bus, node, min_samples)
    reading = ", arg_max(reading, begun_ns) AS latest_reading" if of.kind == "growth" else ""
    return where.query(f"""
        WITH {_measured(of, where, dated=True)}
        SELECT machine, bus, node, any_value(name) AS name, part,
            date_trunc('{every}', make_timestamp(begun_ns // 1000))::DATE AS {every},
            {of.value} AS value, '{of.unit}' AS unit,
            min({of.single}) AS lowest, max({of.single}) AS highest,
            count(*) AS captures{_counted(of)}{reading}
        FROM measured GROUP BY machine, bus, node, part, {every}
        ORDER BY machine, bus, node, part, {every}
    """)


def outliers(
    *,
    quantity: str | None = None,
    since: str | None = None,
    until: str | None = None,
    machine: str | None = None,
    bus: str | None = None,
    node: int | None = None,
    min_samples: int = 10,
    min_captures: int = 3,
    min_machines: int = 5,
    threshold: float = 5.0,
) -> Query:
    """Which machines stand out: a node against the same node of the others, the farthest first.

    The fleet is the median over the machines, its spread their median absolute deviation times
    1.4826, no less than a share of the median (1 %, or what its `Quantity` says). Nodes are
    compared where bus, node, part and kind of device are the same. Where events are counted, the
    spread is no less than chance makes it.

    Args:
        quantity: name in `QUANTITIES`; all by default.
        since, until: ISO date or time, UTC; the half-open span in which captures began.
        machine: which to tell of; they are still compared with all.
        bus, node: of the node.
        min_samples: captures with fewer are left out, where a value is made from samples.
        min_captures: machines with fewer are left out.
        min_machines: no comparison with fewer.
        threshold: how many spreads off the median.
    """
    where = _Conditions()
    _add_scope(where, since, until, None, bus, node, min_samples)
    where.values |= {"captures": min_captures, "machines": min_machines, "threshold": threshold}
    shown = "TRUE"
    if machine is not None:
        shown, where.values["machine"] = "machine GLOB $machine", machine
    dated = since is not None or until is not None
    parts = [_against_fleet(name, of, where, dated) for name, of in _wanted(quantity)]
    return where.query(f"""
        SELECT * FROM ({" UNION ALL BY NAME ".join(parts)})
        WHERE {shown} AND abs(spreads_off) >= $threshold
        ORDER BY abs(spreads_off) DESC, quantity, machine, bus, node, part
    """)


def changes(
    *,
    after: str,
    quantity: str | None = None,
    since: str | None = None,
    until: str | None = None,
    machine: str | None = None,
    bus: str | None = None,
    node: int | None = None,
    min_samples: int = 10,
    min_captures: int = 3,
    threshold: float = 3.0,
) -> Query:
    """What is different after a date: of each node before and after, the clearest first.

    Levels are medians of captures with their spread (median absolute deviation times 1.4826, no
    less than a share of the median); events are rates, with the spread that chance makes.

    Args:
        after: ISO date or time, UTC: captures that began then or later are after.
        quantity: name in `QUANTITIES`; all by default.
        since, until: the half-open span in which captures began.
        machine: its name; `*` and `?` stand for others.
        bus, node: of the node.
        min_samples: captures with fewer are left out, where a value is made from samples.
        min_captures: on either side.
        threshold: by how many spreads it differs; 0 tells all.
    """
    where = _Conditions()
    _add_scope(where, since, until, machine, bus, node, min_samples)
    where.values |= {
        "after_ns": utc_ns(after),
        "captures": min_captures,
        "threshold": threshold,
    }
    parts = [_before_and_after(name, of, where) for name, of in _wanted(quantity)]
    return where.query(f"""
        SELECT * FROM ({" UNION ALL BY NAME ".join(parts)})
        WHERE abs(spreads_off) >= $threshold
        ORDER BY abs(spreads_off) DESC, quantity, machine, bus, node, part
    """)


def changed_objects(
    *,
    after: str,
    since: str | None = None,
    until: str | None = None,
    machine: str | None = None,
    bus: str | None = None,
    node: int | None = None,
    min_captures: int = 2,
) -> Query:
    """Which objects have another value after a date, read or written by SDO both before and after.

    Told are those that were the same in all captures before, which leaves out what is always
    different: positions, counters, error registers.

    Args:
        after: ISO date or time, UTC: captures that began then or later are after.
        since, until: the half-open span in which captures began.
        machine: its name; `*` and `?` stand for others.
        bus, node: of the node.
        min_captures: in how many captures it was the same before.
    """
    where = _Conditions()
    where.values |= {"after_ns": utc_ns(after), "captures": min_captures}
    _add_span(where, since, until)
    _add_place(where, machine, bus, node)
    where.add("source LIKE 'sdo%' AND value IS NOT NULL AND start_utc_ns IS NOT NULL")
    return where.query(f"""
        WITH seen AS (
            SELECT machine, bus, node, index, sub, objects.name, value, date,
                start_utc_ns AS begun_ns, start_utc_ns >= $after_ns AS is_after
            FROM objects JOIN captures USING ({_OF_CAPTURE}) WHERE {where.sql}
        ), sides AS (
            SELECT machine, bus, node, index, sub, any_value(name) AS name,
                arg_max(value, begun_ns) FILTER (NOT is_after) AS value_before,
                arg_max(value, begun_ns) FILTER (is_after) AS value_after,
                count(*) FILTER (NOT is_after) AS captures_before,
                count(*) FILTER (is_after) AS captures_after,
                count(DISTINCT value) FILTER (NOT is_after) AS values_before,
                count(DISTINCT value) FILTER (is_after) AS values_after
            FROM seen GROUP BY machine, bus, node, index, sub
        )
        SELECT machine, bus, node, format('{{:04X}}h:{{:02X}}', index, sub) AS object,
            any_value(sides.name) AS name, value_before, value_after, min(date) AS first_seen,
            captures_before, captures_after, values_after
        FROM sides JOIN seen USING (machine, bus, node, index, sub)
        WHERE values_before = 1 AND captures_before >= $captures
            AND value_after <> value_before AND is_after AND value = value_after
        GROUP BY ALL ORDER BY ALL
    """)


@dataclass(frozen=True, slots=True)
class Question:
    """A question by its name.

    Attributes:
        meaning: what it answers, in one line.
        build: makes the statement of its options.
        quantity: that the name already says, where it is about one.
    """

    meaning: str
    build: Callable[..., Query]
    quantity: str | None = None

    @property
    def options(self) -> list[str]:
        """Names of the options that it takes."""
        names = inspect.signature(self.build).parameters
        return [name for name in names if name != "quantity" or self.quantity is None]

    @property
    def required(self) -> list[str]:
        """Options that must be given."""
        parameters = inspect.signature(self.build).parameters
        return [
            name for name in self.options if parameters[name].default is inspect.Parameter.empty
        ]


def _followed(name: str) -> Question:
    meaning = f"{QUANTITIES[name].meaning}: by node over weeks [{QUANTITIES[name].unit}]"
    return Question(meaning, over_time, name)


QUESTIONS: Mapping[str, Question] = MappingProxyType(
    {
        "emcy": Question("which machines had an EMCY since a date", emcy),
        **{name: _followed(name) for name in QUANTITIES if name != "emcy"},
        "emcy-rate": _followed("emcy"),
        "outliers": Question("nodes that stand out against the fleet", outliers),
        "changes": Question("what is different after a date, with medians and counts", changes),
        "changed-objects": Question("objects with another value after a date", changed_objects),
    }
)
"""By name."""


def question(name: str, options: Mapping[str, Any]) -> Query:
    """The statement of a question. Raises: UsageError, its name or an option is wrong."""
    if name not in QUESTIONS:
        raise UsageError(f"there is no question '{name}'; there are {', '.join(QUESTIONS)}")
    asked = QUESTIONS[name]
    taken = ", ".join(map(option_name, asked.options))
    for option in options:
        if option not in asked.options:
            raise UsageError(f"question '{name}' has no {option_name(option)}; it takes {taken}")
    for option in asked.required:
        if option not in options:
            raise UsageError(f"question '{name}' needs {option_name(option)}; it takes {taken}")
    fixed = {} if asked.quantity is None else {"quantity": asked.quantity}
    return asked.build(**fixed, **options)


def utc_ns(moment: str) -> int:
    """ISO date or time as ns since 1970, UTC where it names no zone. Raises: UsageError.

    >>> utc_ns("2026-09-21"), utc_ns("2026-09-21T02:00+02:00")
    (1789948800000000000, 1789948800000000000)
    """
    try:
        parsed = datetime.fromisoformat(moment)
    except ValueError as error:
        raise UsageError(
            f"'{moment}' is no date: write 2026-11-22 or 2026-11-22T14:30 (UTC)"
        ) from error
    aware = parsed if parsed.tzinfo else parsed.replace(tzinfo=UTC)
    since = aware - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000


class _Conditions:
    """Conditions of a statement, and the values that they name."""

    def __init__(self) -> None:
        self._conditions: list[str] = []
        self.values: dict[str, Any] = {}

    def add(self, condition: str, **values: Any) -> None:
        self._conditions.append(f"({condition})")
        self.values |= values

    @property
    def sql(self) -> str:
        return " AND ".join(self._conditions) or "TRUE"

    def query(self, sql: str) -> Query:
        return Query(inspect.cleandoc(sql), self.values)


def _add_scope(
    where: _Conditions,
    since: str | None,
    until: str | None,
    machine: str | None,
    bus: str | None,
    node: int | None,
    min_samples: int,
) -> None:
    _add_span(where, since, until)
    _add_place(where, machine, bus, node)
    where.add("samples IS NULL OR samples >= $samples", samples=min_samples)


def _add_span(where: _Conditions, since: str | None, until: str | None) -> None:
    if since is not None:
        where.add("start_utc_ns >= $since_ns", since_ns=utc_ns(since))
    if until is not None:
        where.add("start_utc_ns < $until_ns", until_ns=utc_ns(until))


def _add_place(where: _Conditions, machine: str | None, bus: str | None, node: int | None) -> None:
    if machine is not None:
        where.add("machine GLOB $machine", machine=machine)
    if bus is not None:
        where.add("bus = $bus", bus=bus)
    if node is not None:
        where.add("node = $node", node=node)


def _wanted(quantity: str | None) -> list[tuple[str, Quantity]]:
    if quantity is None:
        return list(QUANTITIES.items())
    return [(quantity, quantity_named(quantity))]


def _measured(of: Quantity, where: _Conditions, *, dated: bool) -> str:
    """Rows of a quantity within the conditions, with when the capture began and what the node is."""
    condition = where.sql + (" AND start_utc_ns IS NOT NULL" if dated else "")
    return f"""measured AS (
        SELECT rows.*, start_utc_ns AS begun_ns, known.name, known.device
        FROM ({of.rows}) rows
        JOIN (SELECT {_OF_CAPTURE}, start_utc_ns FROM captures) USING ({_OF_CAPTURE})
        LEFT JOIN (SELECT {_OF_CAPTURE}, bus, node, name, device FROM nodes) known
            USING ({_OF_CAPTURE}, bus, node)
        WHERE {condition}
    )"""


def _counted(of: Quantity) -> str:
    """What a value rests on, beside the captures."""
    if of.kind == "level":
        return ", sum(samples)::BIGINT AS samples"
    unit = of.unit.removeprefix("1/")
    time = "hours" if unit == "h" else f"{unit}s"
    return f', sum(amount)::BIGINT AS total, sum("over") AS {time}'


def _against_fleet(name: str, of: Quantity, where: _Conditions, dated: bool) -> str:
    chance = "0"
    if of.kind == "events":
        chance = "sqrt(fleet_value * over_all + 1) / over_all"
    return f"""(
        WITH {_measured(of, where, dated=dated)}, each_machine AS MATERIALIZED (
            SELECT machine, bus, node, part, device, any_value(name) AS name,
                {of.value} AS value, sum("over") AS over_all, count(amount) AS captures
            FROM measured GROUP BY machine, bus, node, part, device
            HAVING count(amount) >= $captures AND value IS NOT NULL
        ), fleet AS (
            SELECT bus, node, part, device, median(value) AS fleet_value,
                mad(value) * {_SIGMA} AS fleet_mad, count(*) AS machines
            FROM each_machine GROUP BY bus, node, part, device HAVING count(*) >= $machines
        ), compared AS (
            SELECT each_machine.*, fleet_value, machines,
                greatest(fleet_mad, {of.floor}, {of.steady} * abs(fleet_value), {chance}) AS spread
            FROM each_machine JOIN fleet
                ON each_machine.bus = fleet.bus AND each_machine.part = fleet.part
                AND each_machine.node IS NOT DISTINCT FROM fleet.node
                AND each_machine.device IS NOT DISTINCT FROM fleet.device
        )
        SELECT '{name}' AS quantity, machine, bus, node, name, part, value, fleet_value,
            spread AS fleet_spread, '{of.unit}' AS unit,
            (value - fleet_value) / nullif(spread, 0) AS spreads_off, captures, machines
        FROM compared
    )"""


def _before_and_after(name: str, of: Quantity, where: _Conditions) -> str:
    before, after = _side(of, "NOT is_after"), _side(of, "is_after")
    chance = "0"
    if of.kind == "events":
        chance = (
            "sqrt((total_before + total_after) / (over_before + over_after)"
            " * (1 / over_before + 1 / over_after))"
        )
    floors = f"{of.floor}, {of.steady} * greatest(abs(before), abs(after))"
    spread = f"greatest({floors}, {chance})"
    if of.kind != "events":
        spread = f"greatest(spread_before, spread_after, {floors})"
    return f"""(
        WITH {_measured(of, where, dated=True)}, marked AS (
            SELECT *, begun_ns >= $after_ns AS is_after FROM measured WHERE amount IS NOT NULL
        ), sides AS (
            SELECT machine, bus, node, part, any_value(name) AS name,
                {before} AS before, {after} AS after,
                mad({of.single}) FILTER (NOT is_after) * {_SIGMA} AS spread_before,
                mad({of.single}) FILTER (is_after) * {_SIGMA} AS spread_after,
                count(*) FILTER (NOT is_after) AS captures_before,
                count(*) FILTER (is_after) AS captures_after,
                sum(amount) FILTER (NOT is_after) AS total_before,
                sum(amount) FILTER (is_after) AS total_after,
                nullif(sum("over") FILTER (NOT is_after), 0) AS over_before,
                nullif(sum("over") FILTER (is_after), 0) AS over_after
            FROM marked GROUP BY machine, bus, node, part
            HAVING captures_before >= $captures AND captures_after >= $captures
        )
        SELECT '{name}' AS quantity, machine, bus, node, name, part, before, after,
            '{of.unit}' AS unit, after - before AS difference, spread_before, spread_after,
            CASE WHEN after = before THEN 0 ELSE (after - before) / nullif({spread}, 0) END
                AS spreads_off, captures_before, captures_after
        FROM sides WHERE before IS NOT NULL AND after IS NOT NULL
    )"""


def _side(of: Quantity, which: str) -> str:
    if of.kind == "level":
        return f"median(amount) FILTER ({which})"
    return f'sum(amount) FILTER ({which}) / nullif(sum("over") FILTER ({which}), 0)'


def _code_pattern(code: str) -> str:
    match = _CODE.fullmatch(code.strip())
    if match is None:
        raise UsageError(f"EMCY code '{code}': write four hexadecimal digits, 7320h or 73xxh")
    return match[1].upper().replace("X", "_")


def option_name(name: str) -> str:
    """An option as it is typed."""
    return f"--{name.replace('_', '-')}"
