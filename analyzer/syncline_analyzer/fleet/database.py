"""The data set as a database: SQL over the tables of the captures that stand.

SQL can reach nothing but these tables. DuckDB itself opens no file: Arrow reads the tables for it,
and files, networks, extensions and settings are switched off for every statement.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import duckdb
import pyarrow as pa

from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.layout import PACKS
from syncline_analyzer.fleet.relations import relations
from syncline_analyzer.fleet.schemas import FAILURES, tables
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

_ROWS_AT_ONCE = 65_536
_CONFIG: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": "false",
    "python_enable_replacements": "false",
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
    "temp_directory": "",
}
_NO_TABLE = re.compile(r"Table with name (\S+) does not exist")
_UNREAD = re.compile("reading the (?:stream|Arrow source)")
"""What DuckDB says where Arrow could not read a file of a table."""
_LISTING = re.compile(r"\b(?:show|describe|information_schema|duckdb_\w+|pg_\w+)\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Query:
    """A statement and the values of its `$names`."""

    sql: str
    values: Mapping[str, Any]


class Database:
    """The tables of a data set, each with `machine`, `date` and `capture_id` before its columns.

    Stamps are UTC. A table that no capture has rows of is there and empty; those with a row per
    sample hold what `--with-traces` wrote.
    """

    def __init__(self, data: Dataset) -> None:
        self.data = data
        self.names = (*tables(samples=True), FAILURES)

    def captures_with(self) -> dict[str, int]:
        """How many captures have rows of each table; of `failures` how many there are."""
        counts = {name: len(self.data.partitions(name)) for name in self.names}
        return counts | {FAILURES: len(self.data.failures)}

    @contextmanager
    def ask(self, query: Query) -> Iterator[pa.RecordBatchReader]:
        """Rows of a statement, as they come.

        Raises:
            UsageError: it is no SELECT, cannot be understood, or asks for what is not there.
        """
        with duckdb.connect(":memory:", config=_CONFIG) as connection, self._errors():
            connection.execute("SET TimeZone = 'UTC'")
            connection.execute("SET lock_configuration = true")
            _one_select(connection, query.sql)
            kept = []  # DuckDB does not keep what its views are of.
            for name in self._named(query.sql):
                kept.append(self._relations(connection, name))
                kept[-1][-1].create_view(name)
            asked = connection.sql(query.sql, params=dict(query.values))
            yield asked.to_arrow_reader(_ROWS_AT_ONCE)
            kept.clear()

    def _relations(
        self, connection: duckdb.DuckDBPyConnection, table: str
    ) -> list[duckdb.DuckDBPyRelation]:
        return relations(connection, self.data, table)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except duckdb.Error as error:
            raise UsageError(self._told(error)) from error
        except pa.ArrowException as error:
            raise UsageError(self._changed(error)) from error

    def _changed(self, error: Exception) -> str:
        told, url = str(error).partition("\n")[0], self.data.storage.url
        packs = f"{url}/{PACKS}, which the next run makes again, then " if self.data.packs else ""
        return (
            f"{url} changed while it was read, or a table in it is damaged: ask again; if that does"
            f" not help, delete {packs}the captures that cannot be read ({told})"
        )

    def _told(self, error: duckdb.Error) -> str:
        """What is wrong in one line, with what there is."""
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        if _UNREAD.search(lines[0]):
            return self._changed(error)
        missing = _NO_TABLE.search(lines[0])
        if missing:
            return f"SQL: there is no table {missing[1]}; there are {', '.join(self.names)}"
        kept = [lines[0], *(line for line in lines[1:] if line.startswith("Candidate"))]
        return f"SQL: {'; '.join(kept)}"

    def _named(self, sql: str) -> list[str]:
        """Tables that a statement names, or more; all where it asks which there are."""
        if _LISTING.search(sql):
            return list(self.names)
        return [name for name in self.names if re.search(rf"\b{name}\b", sql, re.IGNORECASE)]


def _one_select(connection: duckdb.DuckDBPyConnection, sql: str) -> None:
    """Raises: UsageError, it is not one SELECT; duckdb.Error, it is no SQL."""
    statements = connection.extract_statements(sql)
    kinds = [statement.type for statement in statements]
    if kinds != [duckdb.StatementType.SELECT]:
        raise UsageError("SQL: write one SELECT; nothing in a data set can be changed by SQL")
