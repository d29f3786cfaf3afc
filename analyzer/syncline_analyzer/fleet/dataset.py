"""The data set as its readers see it: which captures stand, and where the tables are.

A capture stands when its `captures.parquet` does: in a folder all tables of a capture appear and
go by one rename, in an object store `captures.parquet` is the last to come and the first to go.
Whoever reads the files by a glob instead may see tables of captures that are being written.

    data = Dataset.open("s3://fleet/analysis")
    files = data.files("emcy")         # of the captures that stand
    duckdb.sql("SELECT machine, count(*) FROM read_parquet(?, hive_partitioning = true,"
               " hive_types = {machine: VARCHAR, date: VARCHAR, capture_id: VARCHAR}) GROUP BY 1",
               params=[files])
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import field
from typing import Any, Self, TypeVar

import pyarrow as pa

from syncline_analyzer.fleet.captures import (
    UNREADABLE,
    CaptureEntry,
    FailureEntry,
    rows_of_captures,
)
from syncline_analyzer.fleet.layout import (
    CAPTURES_FILE,
    Partition,
    failure_file,
    recording_file,
    report_file,
)
from syncline_analyzer.fleet.listing import Listing
from syncline_analyzer.fleet.packs import packed_captures, packed_schema
from syncline_analyzer.fleet.schemas import CAPTURES
from syncline_analyzer.fleet.storage import Storage, open_storage
from syncline_schemas.records import dataclass

_AT_ONCE = 32
_E = TypeVar("_E", CaptureEntry, FailureEntry)


@dataclass(frozen=True)
class Dataset:
    """A data set that `syncline fleet analyze` writes, as it was when it was opened.

    Attributes:
        storage: where it is.
        captures: those that stand, by machine, date and id.
        failures: recordings that could not be analyzed, by key.
        packs: of captures that are in one, its name.
        listing: what was seen.
    """

    storage: Storage
    captures: Sequence[CaptureEntry] = ()
    failures: Sequence[FailureEntry] = ()
    packs: Mapping[Partition, str] = field(default_factory=dict, repr=False)
    listing: Listing = field(default_factory=Listing, repr=False)

    @classmethod
    def open(cls, url: str, options: Mapping[str, Any] | None = None) -> Self:
        """Look which captures stand.

        Args:
            url: folder or URL of the data set; one that is not there is empty.
            options: of the file system of a URL, as fsspec takes them.

        Raises:
            UsageError: it cannot be opened.
        """
        return cls.of(open_storage(url, options))

    @classmethod
    def of(cls, storage: Storage) -> Self:
        """The data set at a place."""
        listing = Listing.of(storage)
        packed = packed_captures(storage, listing)
        captures = [each.entry for each in packed.values()]
        captures += _entries(
            storage,
            [
                (f"{partition.folder}/{CAPTURES_FILE}", partition)
                for partition in listing.captures
                if partition not in packed
            ],
            CaptureEntry.of_bytes,
        )
        failed = [(failure_file(key), key) for key in listing.failures]
        return cls(
            storage,
            sorted(captures, key=lambda each: each.partition),
            sorted(_entries(storage, failed, FailureEntry.of_bytes), key=lambda each: each.key),
            {partition: each.pack for partition, each in packed.items()},
            listing,
        )

    def files(self, table: str) -> list[str]:
        """Paths or URLs of a table of the captures that stand; captures without rows have none."""
        return [
            self.storage.url_of(f"{partition.folder}/{table}.parquet")
            for partition in self.partitions(table)
        ]

    def partitions(self, table: str) -> list[Partition]:
        """The captures that stand and have rows of a table."""
        return [entry.partition for entry in self.captures if table in entry.values["tables"]]

    def schema(self, table: str) -> pa.Schema:
        """Columns of a table, those of the path first: what a reader of no file at all returns."""
        return packed_schema(table)

    def captures_table(self) -> pa.Table:
        """The table `captures`, one row a capture."""
        return pa.Table.from_pylist(list(rows_of_captures(self.captures)), self.schema(CAPTURES))

    def report(self, entry: CaptureEntry) -> str | None:
        """Path or URL of a capture's report, where one was made."""
        made = entry.values.get("report")
        return self.storage.url_of(report_file(entry.partition.capture_id)) if made else None

    def recording(self, entry: CaptureEntry) -> str | None:
        """Path or URL of a capture's Rerun recording, where one was made."""
        made = entry.values.get("recording")
        return self.storage.url_of(recording_file(entry.partition.capture_id)) if made else None


def _entries(
    storage: Storage, places: Sequence[tuple[str, Any]], parse: Callable[[bytes, Any], _E]
) -> Iterator[_E]:
    """What the files hold; one that is gone by now, damaged, or of another version, counts as not there."""

    def read(place: tuple[str, Any]) -> _E | None:
        content = storage.read(place[0])
        try:
            return None if content is None else parse(content, place[1])
        except UNREADABLE:
            return None

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        yield from (entry for entry in pool.map(read, places) if entry is not None)
