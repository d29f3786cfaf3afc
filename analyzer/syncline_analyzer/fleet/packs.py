"""Packs: tables of many captures in one file each, which questions read instead of thousands.

A pack repeats what stands in the folders of its captures, and nothing depends on it. A capture that
was changed or taken away since has another stamp, or none: its rows in the pack are not read.
"""

import json
from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from syncline_analyzer.fleet.captures import (
    UNREADABLE,
    CaptureEntry,
    rows_of_captures,
    table_rows,
)
from syncline_analyzer.fleet.identity import short_hash
from syncline_analyzer.fleet.layout import Partition, pack_file
from syncline_analyzer.fleet.listing import Listing, PackFiles
from syncline_analyzer.fleet.schemas import CAPTURES, PARTITIONS, table_schema, tables
from syncline_analyzer.fleet.storage import Storage
from syncline_schemas.named_tuples import NamedTuple

STAMP = "stamp"
"""Column of a pack's `captures`: that of the capture when it was packed."""
_ABOUT = b"syncline.pack"
"""Metadata of that file."""


class Packed(NamedTuple):
    """A capture that stands as it was packed."""

    pack: str
    entry: CaptureEntry


def packed_captures(storage: Storage, listing: Listing) -> dict[Partition, Packed]:
    """The captures that need no look at their own folders."""
    packs = []
    for name, files in listing.packs.items():
        if CAPTURES in files.sizes:
            stamped = _captures_of(storage, name, files)
            packs.append(
                {
                    partition: Packed(name, entry)
                    for partition, (stamp, entry) in stamped.items()
                    if stamp is not None and listing.captures.get(partition) == stamp
                }
            )
    # Of two packs with a capture the larger one is opened anyway.
    return dict(item for pack in sorted(packs, key=len) for item in pack.items())


def _captures_of(
    storage: Storage, name: str, files: PackFiles
) -> dict[Partition, tuple[str | None, CaptureEntry]]:
    """Stamps and entries; none of a pack that is damaged, gone by now, or of another version."""
    found = {}
    try:
        content = storage.read(pack_file(name, CAPTURES)) or b""
        told = pq.read_schema(BytesIO(content)).metadata[_ABOUT]
        if json.loads(told) != _about(files.sizes):
            return {}
        for row in table_rows(content):
            partition = Partition(*(row.pop(name) for name in PARTITIONS))
            found[partition] = row.pop(STAMP), CaptureEntry.of_row(row, partition)
    except UNREADABLE:
        return {}
    return found


def pack_index(
    entries: Sequence[CaptureEntry], listing: Listing, sizes: Mapping[str, int]
) -> pa.Table:
    """The table `captures` of a pack of these, whose other tables have so many bytes."""
    rows = [
        row | {STAMP: listing.captures[entry.partition]}
        for entry, row in zip(entries, rows_of_captures(entries), strict=True)
    ]
    schema = packed_schema(CAPTURES).append(pa.field(STAMP, pa.string()))
    return pa.Table.from_pylist(rows, schema.with_metadata({_ABOUT: json.dumps(_about(sizes))}))


def _about(sizes: Mapping[str, int]) -> dict[str, Any]:
    """What has to be the same when a pack is read: its other files, and the columns of tables."""
    columns = short_hash(*(str(packed_schema(table)) for table in tables()))
    others = {table: size for table, size in sorted(sizes.items()) if table != CAPTURES}
    return {"columns": columns, "sizes": others}


def packed_schema(table: str) -> pa.Schema:
    """Columns of a table of a pack, without the stamp."""
    return pa.schema([*((name, pa.string()) for name in PARTITIONS), *table_schema(table)])
