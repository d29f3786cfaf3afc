"""The tables of the data set are those of a single analysis, in columns that never change type."""

import pyarrow as pa
import pytest

from syncline_analyzer import open_session
from syncline_analyzer.fleet.columns import arrow_table
from syncline_analyzer.fleet.samples import empty_frame
from syncline_analyzer.fleet.schemas import SAMPLE_TABLES, table_schema, tables
from syncline_analyzer.results import Analysis
from syncline_analyzer.views.tables import ROW_TYPES, rows_of, table
from syncline_samples.generate import mcap_capture
from syncline_samples.scenarios import bad_day


@pytest.fixture(scope="module")
def analysis(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    """A day on which everything goes wrong: most tables have rows."""
    path = tmp_path_factory.mktemp("bad") / "bad.mcap"
    path.write_bytes(mcap_capture(bad_day(110.0, 250_000).run()))
    return open_session(path).analysis


@pytest.mark.parametrize("name", ROW_TYPES)
def test_columns_and_values_are_those_of_the_pandas_tables(name: str, analysis: Analysis) -> None:
    expected = pa.Table.from_pandas(table(analysis, name), preserve_index=False)
    found = arrow_table(rows_of(analysis, name), ROW_TYPES[name], dated=True)
    assert set(found.column_names) == set(expected.column_names)
    for column in found.column_names:
        assert found[column].to_pylist() == expected[column].to_pylist(), column


def test_the_bad_day_fills_most_tables(analysis: Analysis) -> None:
    assert sum(bool(len(rows_of(analysis, name))) for name in ROW_TYPES) > 25


@pytest.mark.parametrize("name", ROW_TYPES)
def test_types_do_not_depend_on_the_rows(name: str, analysis: Analysis) -> None:
    rows = rows_of(analysis, name)
    full = arrow_table(rows, ROW_TYPES[name], dated=True)
    undated = arrow_table(rows, ROW_TYPES[name], dated=False)
    empty = arrow_table([], ROW_TYPES[name], dated=True)
    assert full.schema == undated.schema == empty.schema == table_schema(name)
    assert not any(pa.types.is_null(field.type) for field in full.schema)
    stamps = [field.name for field in full.schema if pa.types.is_timestamp(field.type)]
    assert all(undated[stamp].null_count == len(rows) for stamp in stamps)


@pytest.mark.parametrize("name", SAMPLE_TABLES)
def test_sample_tables_have_types_too(name: str) -> None:
    schema = table_schema(name)
    assert set(schema.names) == set(empty_frame(name).columns)
    assert not any(pa.types.is_null(field.type) for field in schema)


def test_names_of_the_tables() -> None:
    assert tables()[0] == "captures"
    assert set(tables(samples=True)) - set(tables()) == set(SAMPLE_TABLES)
    assert all(table_schema(name) for name in (*tables(samples=True), "failures"))
