"""The tables of a data set as DuckDB sees them: files of single captures, and packs of many."""

from collections.abc import Iterable, Mapping
from functools import reduce
from operator import and_
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.fs

from syncline_analyzer.fleet.captures import FailureEntry
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.layout import Partition, pack_file
from syncline_analyzer.fleet.packs import packed_schema
from syncline_analyzer.fleet.schemas import (
    CAPTURES,
    FAILURES,
    PARTITIONS,
    SAMPLE_TABLES,
    table_schema,
)
from syncline_analyzer.fleet.storage import Storage

_PACK = "pack"
"""Column that only the join of a pack with its captures sees."""


def relations(
    connection: duckdb.DuckDBPyConnection, data: Dataset, table: str
) -> list[duckdb.DuckDBPyRelation]:
    """A table of the captures that stand, at the end of what has to be kept while it is read."""
    if table == CAPTURES:
        return [connection.from_arrow(data.captures_table())]
    if table == FAILURES:
        return [connection.from_arrow(_failures_table(data.failures))]
    partitions = data.partitions(table)
    packs = {} if table in SAMPLE_TABLES else data.packs
    packed = {each: packs[each] for each in partitions if each in packs}
    loose = [each for each in partitions if each not in packed]
    found = connection.from_arrow(_of_captures(data.storage, table, loose))
    if not packed:
        return [found]
    return [found, *_with_packs(connection, data.storage, table, found, packed)]


def _with_packs(
    connection: duckdb.DuckDBPyConnection,
    storage: Storage,
    table: str,
    loose: duckdb.DuckDBPyRelation,
    packed: Mapping[Partition, str],
) -> list[duckdb.DuckDBPyRelation]:
    """Rows of loose captures, and those rows of packs that are of these captures."""
    wanted = [{**partition._asdict(), _PACK: pack} for partition, pack in packed.items()]
    rows = connection.from_arrow(_of_packs(storage, table, set(packed.values()))).set_alias("rows")
    of_these = connection.from_arrow(pa.Table.from_pylist(wanted)).set_alias("of_these")
    same = " AND ".join(f"rows.{name} = of_these.{name}" for name in (*PARTITIONS, _PACK))
    columns = ", ".join(f'"{name}"' for name in packed_schema(table).names)
    found = rows.join(of_these, same, how="semi").project(columns)
    return [rows, of_these, found, loose.union(found)]


def _of_captures(
    storage: Storage, table: str, partitions: Iterable[Partition]
) -> pa.Table | ds.Dataset:
    places = {
        f"{each.folder}/{table}.parquet": reduce(
            and_, (ds.field(name) == getattr(each, name) for name in PARTITIONS)
        )
        for each in partitions
    }
    return _files(storage, packed_schema(table), places)


def _of_packs(storage: Storage, table: str, packs: Iterable[str]) -> pa.Table | ds.Dataset:
    schema = packed_schema(table).append(pa.field(_PACK, pa.string()))
    places = {pack_file(pack, table): ds.field(_PACK) == pack for pack in packs}
    return _files(storage, schema, places)


def _files(
    storage: Storage, schema: pa.Schema, places: Mapping[str, ds.Expression]
) -> pa.Table | ds.Dataset:
    """The files as one, each with what is true of all its rows."""
    if storage.local:
        filesystem = pyarrow.fs.LocalFileSystem()
    else:
        filesystem = pyarrow.fs.PyFileSystem(pyarrow.fs.FSSpecHandler(storage.fs))
    form = ds.ParquetFileFormat(
        default_fragment_scan_options=ds.ParquetFragmentScanOptions(page_checksum_verification=True)
    )
    fragments = [
        form.make_fragment(storage.path(path), filesystem, partition_expression=told)
        for path, told in places.items()
    ]
    if not fragments:
        return schema.empty_table()
    return ds.FileSystemDataset(fragments, schema, form, filesystem)


def _failures_table(failures: Iterable[FailureEntry]) -> pa.Table:
    rows = [_failure_row(entry) for entry in failures]
    return pa.Table.from_pylist(rows, table_schema(FAILURES))


def _failure_row(entry: FailureEntry) -> dict[str, Any]:
    names = [field.name for field in table_schema(FAILURES) if field.name != "files"]
    return {name: getattr(entry, name) for name in names} | {
        "files": [
            {field.name: getattr(file, field.name) for field in _file_fields()}
            for file in entry.files
        ]
    }


def _file_fields() -> pa.StructType:
    return table_schema(FAILURES).field("files").type.value_type
