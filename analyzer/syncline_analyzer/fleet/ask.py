"""Questions to a data set in Python, answered by DataFrames.

from syncline_analyzer.fleet import open_fleet

fleet = open_fleet("/data/fleet")
fleet.query("SELECT machine, count(*) AS errors FROM findings WHERE severity = 'error' GROUP BY 1")
fleet.emcy_since("2026-11-01", code="7320h")
fleet.over_time("encoder-noise", node=5)
fleet.changes(after="2026-11-10")
fleet.trends(quantity="encoder-noise")
"""

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any, Self

from syncline_analyzer.fleet import questions
from syncline_analyzer.fleet.database import Database, Query
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.trends import trend_findings
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Fleet:
    """A data set that `syncline fleet analyze` wrote, as it was when it was opened.

    All questions raise UsageError for what they cannot answer. Options that are not named here are
    those of `syncline_analyzer.fleet.questions`, such as `since`, `until`, `machine`, `bus`, `node`.
    """

    database: Database

    @classmethod
    def open(cls, url: str, options: Mapping[str, Any] | None = None) -> Self:
        """See `open_fleet`."""
        return cls(Database(Dataset.open(url, options)))

    @property
    def tables(self) -> dict[str, int]:
        """Tables, and how many captures have rows of each."""
        return self.database.captures_with()

    @property
    def undated(self) -> int:
        """Captures without a date, which questions with a time in them leave out."""
        return sum(entry.values["start_utc_ns"] is None for entry in self.database.data.captures)

    def query(self, sql: str, values: Mapping[str, Any] | None = None) -> "pd.DataFrame":
        """Rows of one SELECT; stamps are datetime64[ns, UTC].

        Args:
            values: of the `$names` in it.
        """
        return self._frame(Query(sql, values or {}))

    def emcy_since(
        self, since: str | None = None, code: str | None = None, **options: Any
    ) -> "pd.DataFrame":
        """Which machines had an EMCY since a date; see `questions.emcy`."""
        return self.ask("emcy", since=since, code=code, **options)

    def over_time(self, quantity: str, every: str = "week", **options: Any) -> "pd.DataFrame":
        """A quantity by node over weeks; see `questions.over_time`."""
        return self._frame(questions.over_time(quantity=quantity, every=every, **options))

    def outliers(self, quantity: str | None = None, **options: Any) -> "pd.DataFrame":
        """Nodes that stand out against the fleet; see `questions.outliers`."""
        return self.ask("outliers", quantity=quantity, **options)

    def changes(self, after: str, quantity: str | None = None, **options: Any) -> "pd.DataFrame":
        """What is different after a date; see `questions.changes`."""
        return self.ask("changes", after=after, quantity=quantity, **options)

    def changed_objects(self, after: str, **options: Any) -> "pd.DataFrame":
        """Objects with another value after a date; see `questions.changed_objects`."""
        return self.ask("changed-objects", after=after, **options)

    def ask(self, question: str, **options: Any) -> "pd.DataFrame":
        """A question by its name in `questions.QUESTIONS`."""
        return self._frame(questions.question(question, options))

    def trends(self, **options: Any) -> "pd.DataFrame":
        """What drifts, steps or comes more often, a `trends.rows.TrendFinding` each, the gravest first.

        Args:
            options: those of `trends.trend_findings`, such as `quantity`, `machine`, `since`.
        """
        import pandas as pd

        from syncline_analyzer.fleet.trends.rows import TrendFinding

        found = [asdict(each) for each in trend_findings(self.database, **options)]
        frame = pd.DataFrame(found, columns=[each.name for each in fields(TrendFinding)])
        frame.insert(0, "onset", pd.to_datetime(frame["onset_ns"].astype("int64"), utc=True))
        return frame.astype({"node": "Int64", "reaches_ns": "Int64"})

    def _frame(self, query: Query) -> "pd.DataFrame":
        with self.database.ask(query) as reader:
            frame: pd.DataFrame = reader.read_all().to_pandas()
        return frame
