"""Making packs: the tables of many captures written into one file each."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq

from syncline_analyzer.fleet.captures import CaptureEntry
from syncline_analyzer.fleet.database import Database, Query
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.layout import CAPTURES_FILE, PACKS
from syncline_analyzer.fleet.packs import pack_index, packed_schema
from syncline_analyzer.fleet.publish import put, staging, take_away
from syncline_analyzer.fleet.schemas import CAPTURES, tables
from syncline_analyzer.fleet.storage import Storage

MIN_LOOSE = 200
"""So many captures that are in no pack are worth one."""
FULL = 4000
"""Captures of a pack; one with fewer is written anew together with what has come."""


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
        database = Database(data)
        for table in tables():
            if table != CAPTURES and data.partitions(table):
                _write_table(database, table, staged / f"{table}.parquet")
        pq.write_table(pack_index(data.captures, data.listing), staged / CAPTURES_FILE)
        put(data.storage, staged, f"{PACKS}/{staged.name}")


def _write_table(database: Database, table: str, path: Path) -> None:
    schema = packed_schema(table)
    with (
        database.ask(Query(f'SELECT * FROM "{table}"', {})) as rows,
        pq.ParquetWriter(path, schema, compression="zstd") as writer,
    ):
        for batch in rows:
            writer.write_batch(batch.cast(schema))
