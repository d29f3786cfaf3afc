"""The rows of a data set that trends are judged from."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from syncline_analyzer.fleet.database import Database, Query
from syncline_analyzer.fleet.quantities import QUANTITIES, quantity_named
from syncline_analyzer.fleet.questions import utc_ns
from syncline_analyzer.fleet.trends.tracks import Tracks, tracks_of
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    import pandas as pd

_KEY = ["machine", "date", "capture_id"]
_NODE = [*_KEY, "bus", "node"]


@dataclass(frozen=True, slots=True)
class Scope:
    """Which captures and nodes are looked at.

    Attributes:
        bus, node: of the node; None: all.
        quantity: name in `QUANTITIES`; None: all.
        since_ns, until_ns: half-open span in which captures began, UTC.
        min_samples: captures with fewer are left out, where a value is made from samples.
    """

    bus: str | None = None
    node: int | None = None
    quantity: str | None = None
    since_ns: int | None = None
    until_ns: int | None = None
    min_samples: int = 10

    @classmethod
    def of(
        cls,
        bus: str | None,
        node: int | None,
        quantity: str | None,
        since: str | None,
        until: str | None,
        min_samples: int,
    ) -> "Scope":
        """The scope of options as they are typed. Raises: UsageError."""
        if quantity is not None:
            quantity_named(quantity)
        since_ns = None if since is None else utc_ns(since)
        until_ns = None if until is None else utc_ns(until)
        return cls(bus, node, quantity, since_ns, until_ns, min_samples)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of those that are looked at."""
        return tuple(QUANTITIES) if self.quantity is None else (self.quantity,)


def gather(database: Database, scope: Scope) -> Iterator[Tracks]:
    """Tracks of each quantity that has any. Raises: UsageError, the data set cannot be read."""
    captures = _captures(database, scope)
    nodes = _nodes(database)
    resolution = _resolutions(database)
    for quantity in scope.quantities:
        rows = _rows(database, quantity, scope)
        rows = rows.merge(captures, on=_KEY).merge(nodes, on=_NODE, how="left")
        rows = rows.merge(resolution, on=[*_KEY, "bus"], how="left")
        tracks = tracks_of(quantity, rows)
        if tracks is not None:
            yield tracks


def sync_periods_us(database: Database) -> Mapping[tuple[str, str], float]:
    """SYNC period of machines and buses, the shortest of several [us]."""
    rows = _frame(
        database,
        "SELECT machine, bus, min(period) AS period FROM (SELECT machine, bus, cob_id,"
        " median(period_us_median) AS period FROM sync WHERE period_us_median > 0 GROUP BY ALL)"
        " GROUP BY ALL",
    )
    return {
        (str(machine), str(bus)): float(period)
        for machine, bus, period in zip(rows["machine"], rows["bus"], rows["period"], strict=True)
    }


def _rows(database: Database, quantity: str, scope: Scope) -> "pd.DataFrame":
    where = ["(samples IS NULL OR samples >= $samples)"]
    values: dict[str, Any] = {"samples": scope.min_samples}
    for name, value in (("bus", scope.bus), ("node", scope.node)):
        if value is not None:
            where.append(f"{name} = ${name}")
            values[name] = value
    sql = (
        f'SELECT machine, date, capture_id, bus, node, part, amount, "over", reading'
        f" FROM ({QUANTITIES[quantity].rows}) WHERE {' AND '.join(where)}"
    )
    rows = _frame(database, sql, values)
    return rows.astype({"node": "Int64", "amount": float, "over": float, "reading": float})


def _captures(database: Database, scope: Scope) -> "pd.DataFrame":
    where = ["start_utc_ns IS NOT NULL"]
    values: dict[str, Any] = {}
    for sign, name, moment in ((">=", "since", scope.since_ns), ("<", "until", scope.until_ns)):
        if moment is not None:
            where.append(f"start_utc_ns {sign} ${name}")
            values[name] = moment
    return _frame(
        database,
        "SELECT machine, date, capture_id, start_utc_ns AS begun_ns, duration_ns,"
        f" files[1].host AS recorder FROM captures WHERE {' AND '.join(where)}",
        values,
    )


def _nodes(database: Database) -> "pd.DataFrame":
    rows = _frame(
        database,
        """
        SELECT machine, date, capture_id, bus, node, name, device, serial FROM nodes LEFT JOIN (
            SELECT machine, date, capture_id, bus, node, any_value(value) AS serial
            FROM objects WHERE index = 4120 AND sub = 4 AND source LIKE 'sdo%'
            GROUP BY ALL
        ) USING (machine, date, capture_id, bus, node)
        """,
    )
    return rows.astype({"node": "Int64"})


def _resolutions(database: Database) -> "pd.DataFrame":
    return _frame(
        database,
        "SELECT machine, date, capture_id, bus, max(resolution_us) AS resolution_us"
        " FROM sync GROUP BY ALL",
    )


def _frame(database: Database, sql: str, values: Mapping[str, Any] | None = None) -> "pd.DataFrame":
    with database.ask(Query(sql, values or {})) as reader:
        frame: pd.DataFrame = reader.read_all().to_pandas()
    return frame
