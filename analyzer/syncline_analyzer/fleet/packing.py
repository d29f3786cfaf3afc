"""Making packs: the tables of many captures written into one file each."""

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from syncline_analyzer.fleet.captures import CaptureEntry
from syncline_analyzer.fleet.database import Database, Query
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.layout import CAPTURES_FILE, PACKS, Partition
from syncline_analyzer.fleet.packs import pack_index, packed_schema
from syncline_analyzer.fleet.publish import put, staging, take_away
from syncline_analyzer.fleet.schemas import CAPTURES, tables
from syncline_analyzer.fleet.storage import Storage

MIN_LOOSE = 200
"""So many captures that are in no pack are worth one."""
FULL = 4000
"""Captures of a pack; one with fewer is written anew together with what has come."""
_GROUP_ROWS = 50_000
_PARTS = 200
"""A hundred columns of a few rows each take a hundred times the memory of the rows."""
_AT_ONCE = 8
"""Files that are read at a time: object stores are slow to answer."""


def pack_captures(
    storage: Storage, run: str, *, min_loose: int = MIN_LOOSE, full: int = FULL
) -> int:
    """Pack the captures that are in no full pack, where enough have come; how many are packed.

    What nobody reads any more, since newer packs hold it, is taken away.

    Args:
        run: name of the run, for what it leaves behind.
    """
    data = Dataset.of(storage)
    if sum(entry.partition not in data.packs for entry in data.captures) < min_loose:
        return 0
    sizes = Counter(data.packs.values())
    kept = {name for name, size in sizes.items() if size >= full}
    left = [entry for entry in data.captures if data.packs.get(entry.partition) not in kept]
    for part in _parts(left, full):
        _write_pack(replace(data, captures=part), run)
    for name in data.listing.packs:
        if name not in kept:
            take_away(storage, f"{PACKS}/{name}")
    return len(left)


def _parts(entries: Sequence[CaptureEntry], size: int) -> Iterator[Sequence[CaptureEntry]]:
    for begin in range(0, len(entries), size):
        yield entries[begin : begin + size]


def _write_pack(data: Dataset, run: str) -> None:
    with staging(data.storage, run) as staged:
        for table in tables():
            if table != CAPTURES and data.partitions(table):
                _write(staged / f"{table}.parquet", _rows(data, table), packed_schema(table))
        pq.write_table(pack_index(data.captures, data.listing), staged / CAPTURES_FILE)
        put(data.storage, staged, f"{PACKS}/{staged.name}")


def _rows(data: Dataset, table: str) -> Iterator[pa.Table]:
    """Rows of a table: of captures that are in a pack already, and of each other one."""
    packed = [entry for entry in data.captures if entry.partition in data.packs]
    if packed:
        database = Database(replace(data, captures=packed))
        with database.ask(Query(f'SELECT * FROM "{table}"', {})) as rows:
            yield from (pa.Table.from_batches([batch]) for batch in rows)
    loose = [each for each in data.partitions(table) if each not in data.packs]
    paths = [f"{each.folder}/{table}.parquet" for each in loose]
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        for partition, content in zip(loose, pool.map(data.storage.read, paths), strict=True):
            if content is not None:  # else the stamp of the capture is another one by now
                rows_of_one = pq.ParquetFile(BytesIO(content)).read(use_threads=False)
                yield _with_partition(rows_of_one, partition)


def _with_partition(rows: pa.Table, partition: Partition) -> pa.Table:
    for at, (name, value) in enumerate(partition._asdict().items()):
        rows = rows.add_column(at, name, pa.repeat(pa.scalar(value, pa.string()), len(rows)))
    return rows


def _write(path: Path, parts: Iterator[pa.Table], schema: pa.Schema) -> None:
    """Write parts as few row groups: each costs as much to read as a file."""
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        waiting: list[pa.Table] = []
        count = 0
        for part in parts:
            waiting.append(_conformed(part, schema))
            count += len(part)
            if len(waiting) == _PARTS:
                waiting = [pa.concat_tables(waiting).combine_chunks()]
            if count >= _GROUP_ROWS:
                writer.write_table(pa.concat_tables(waiting))
                waiting, count = [], 0
        if waiting:
            writer.write_table(pa.concat_tables(waiting))


def _conformed(rows: pa.Table, schema: pa.Schema) -> pa.Table:
    """The columns of a table as they are today; an earlier version may have had fewer."""
    there = set(rows.column_names)
    columns = [
        rows[field.name].cast(field.type)
        if field.name in there
        else pa.nulls(len(rows), field.type)
        for field in schema
    ]
    return pa.Table.from_arrays(columns, schema=schema)
