"""Making packs: the tables of many captures written into one file each."""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from syncline_analyzer.fleet.captures import UNREADABLE, CaptureEntry
from syncline_analyzer.fleet.database import Database, Query
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.layout import CAPTURES_FILE, PACKS, Partition
from syncline_analyzer.fleet.packs import pack_index, packed_schema
from syncline_analyzer.fleet.publish import put, staging, take_away
from syncline_analyzer.fleet.schemas import CAPTURES, tables
from syncline_analyzer.fleet.storage import Storage
from syncline_schemas.errors import UsageError
from syncline_schemas.processors import processors

MIN_LOOSE = 200
"""So many captures that are in no pack are worth one."""
FULL = 4000
"""Captures of a pack; one with fewer is written anew together with what has come."""
_READERS_S = 86_400
"""So long a pack stays that newer ones replaced: somebody may have the data set open."""
_GROUP_ROWS, _GROUP_BYTES = 50_000, 64 << 20
_PARTS = 200
"""A hundred columns of a few rows each take a hundred times the memory of the rows."""
_AT_ONCE = 32
"""Files that are read at a time: object stores are slow to answer."""


def pack_captures(
    storage: Storage,
    run: str,
    *,
    begun: Callable[[int], None] | None = None,
    min_loose: int = MIN_LOOSE,
    full: int = FULL,
) -> int:
    """Pack the captures that are in no full pack, where enough have come; how many are packed.

    A capture with a table that cannot be read stays as it is. Packs that newer ones have replaced
    for a day are taken away.

    Args:
        run: name of the run, for what it leaves behind.
        begun: called with the number of captures before they are packed.
    """
    data = Dataset.of(storage)
    _take_away_old(data)
    able = [each for each in data.captures if data.listing.captures.get(each.partition)]
    if sum(entry.partition not in data.packs for entry in able) < min_loose:
        return 0
    sizes = Counter(data.packs.values())
    left = [each for each in able if sizes[data.packs.get(each.partition, "")] < full]
    if begun:
        begun(len(left))
    return sum(
        _Pack(replace(data, captures=left[at : at + full])).write(run)
        for at in range(0, len(left), full)
    )


def _take_away_old(data: Dataset) -> None:
    used = set(data.packs.values())
    before_ns = time.time_ns() - _READERS_S * 10**9
    for name, files in data.listing.packs.items():
        if name not in used and (files.modified_ns or 0) < before_ns:
            take_away(data.storage, f"{PACKS}/{name}")


class _Pack:
    """The captures of a data set as a pack."""

    def __init__(self, data: Dataset) -> None:
        self._data = data
        self._unreadable: set[Partition] = set()

    def write(self, run: str) -> int:
        """Write all tables and make the pack stand; how many captures are in it."""
        with staging(self._data.storage, run) as staged:
            wanted = [each for each in tables() if each != CAPTURES and self._data.partitions(each)]
            with ThreadPoolExecutor(processors()) as pool:
                written = pool.map(lambda table: self._write_table(table, staged), wanted)
                sizes = dict(zip(wanted, written, strict=True))
            # Rows of those that are not listed are never read.
            listed = [e for e in self._data.captures if e.partition not in self._unreadable]
            index = pack_index(listed, self._data.listing, sizes)
            pq.write_table(index, staged / CAPTURES_FILE, write_page_checksum=True)
            put(self._data.storage, staged, f"{PACKS}/{staged.name}")
        return len(listed)

    def _write_table(self, table: str, folder: Path) -> int:
        """Write a table; its size [byte]."""
        path = folder / f"{table}.parquet"
        _write(path, self._rows(table), packed_schema(table))
        return path.stat().st_size

    def _rows(self, table: str) -> Iterator[pa.Table]:
        """Rows of a table: of captures that are in a pack already, and of each other one."""
        data = self._data
        packed = [entry for entry in data.captures if entry.partition in data.packs]
        if packed:
            try:
                with _database(data, packed).ask(Query(f'SELECT * FROM "{table}"', {})) as rows:
                    for batch in rows:
                        yield _conformed(pa.Table.from_batches([batch]), packed_schema(table))
            except UsageError:
                self._unreadable.update(entry.partition for entry in packed)
        loose = [each for each in data.partitions(table) if each not in data.packs]
        for partition, content in _contents(data.storage, table, loose):
            try:
                file = pq.ParquetFile(BytesIO(content or b""), page_checksum_verification=True)
                rows_of_one = file.read(use_threads=False)
                yield _conformed(_with_partition(rows_of_one, partition), packed_schema(table))
            except UNREADABLE:
                self._unreadable.add(partition)


def _database(data: Dataset, captures: Sequence[CaptureEntry]) -> Database:
    return Database(replace(data, captures=captures))


def _contents(
    storage: Storage, table: str, partitions: Sequence[Partition]
) -> Iterator[tuple[Partition, bytes | None]]:
    """What the files of captures hold, a few in memory at a time."""
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        for at in range(0, len(partitions), _AT_ONCE):
            some = partitions[at : at + _AT_ONCE]
            paths = [f"{each.folder}/{table}.parquet" for each in some]
            yield from zip(some, pool.map(storage.read, paths), strict=True)


def _with_partition(rows: pa.Table, partition: Partition) -> pa.Table:
    for at, (name, value) in enumerate(partition._asdict().items()):
        rows = rows.add_column(at, name, pa.repeat(pa.scalar(value, pa.string()), len(rows)))
    return rows


def _write(path: Path, parts: Iterator[pa.Table], schema: pa.Schema) -> None:
    """Write parts as few row groups: each costs as much to read as a file."""
    with pq.ParquetWriter(path, schema, compression="zstd", write_page_checksum=True) as writer:
        waiting: list[pa.Table] = []
        rows = size = 0
        for part in parts:
            waiting.append(part)
            rows, size = rows + len(part), size + part.nbytes
            if len(waiting) == _PARTS:
                waiting = [pa.concat_tables(waiting).combine_chunks()]
            if rows >= _GROUP_ROWS or size >= _GROUP_BYTES:
                writer.write_table(pa.concat_tables(waiting))
                waiting, rows, size = [], 0, 0
        if waiting:
            writer.write_table(pa.concat_tables(waiting))


def _conformed(rows: pa.Table, schema: pa.Schema) -> pa.Table:
    """The columns of a table as they are today; an earlier version may have had fewer."""
    if rows.schema.equals(schema):
        return rows
    there = set(rows.column_names)
    columns = [
        rows[field.name].cast(field.type)
        if field.name in there
        else pa.nulls(len(rows), field.type)
        for field in schema
    ]
    return pa.Table.from_arrays(columns, schema=schema)
