"""Packs: tables of many captures in one file each, which questions read instead of thousands.

A pack repeats what stands in the folders of its captures, and nothing depends on it. A capture that
was changed or taken away since has another stamp, or none: its rows in the pack are not read.
"""

from collections.abc import Iterable
from typing import NamedTuple

import pyarrow as pa

from syncline_analyzer.fleet.captures import CaptureEntry, rows_of_captures, table_rows
from syncline_analyzer.fleet.layout import Partition, pack_file
from syncline_analyzer.fleet.listing import Listing
from syncline_analyzer.fleet.schemas import CAPTURES, PARTITIONS, table_schema
from syncline_analyzer.fleet.storage import Storage

STAMP = "stamp"
"""Column of a pack's `captures`: that of the capture when it was packed."""


class Packed(NamedTuple):
    """A capture that stands as it was packed."""

    pack: str
    entry: CaptureEntry


def packed_captures(storage: Storage, listing: Listing) -> dict[Partition, Packed]:
    """The captures that need no look at their own folders."""
    found = {}
    for pack in listing.packs:
        for partition, (stamp, entry) in _captures_of(storage, pack).items():
            if listing.captures.get(partition) == stamp:
                found[partition] = Packed(pack, entry)
    return found


def _captures_of(storage: Storage, pack: str) -> dict[Partition, tuple[str, CaptureEntry]]:
    """Stamps and entries; of a pack that is gone by now, or of another version, none."""
    found = {}
    try:
        for row in table_rows(storage.read(pack_file(pack, CAPTURES)) or b""):
            partition = Partition(*(row.pop(name) for name in PARTITIONS))
            found[partition] = row.pop(STAMP), CaptureEntry.of_row(row, partition)
    except (pa.ArrowInvalid, KeyError, TypeError):
        return {}
    return found


def pack_index(entries: Iterable[CaptureEntry], listing: Listing) -> pa.Table:
    """The table `captures` of a pack of these."""
    rows = [
        row | {STAMP: listing.captures[Partition(*(row[name] for name in PARTITIONS))]}
        for row in rows_of_captures(entries)
    ]
    return pa.Table.from_pylist(rows, packed_schema(CAPTURES).append(pa.field(STAMP, pa.string())))


def packed_schema(table: str) -> pa.Schema:
    """Columns of a table of a pack, without the stamp."""
    return pa.schema([*((name, pa.string()) for name in PARTITIONS), *table_schema(table)])
