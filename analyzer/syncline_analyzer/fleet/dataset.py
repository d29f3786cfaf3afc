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

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Self, TypeVar

import pyarrow as pa

from syncline_analyzer.fleet.captures import CaptureEntry, FailureEntry
from syncline_analyzer.fleet.layout import (
    CAPTURES_FILE,
    FAILURES,
    STAGING,
    Partition,
    recording_file,
    report_file,
)
from syncline_analyzer.fleet.schemas import CAPTURES, PARTITIONS, table_schema
from syncline_analyzer.fleet.storage import Storage, open_storage

_AT_ONCE = 32
_E = TypeVar("_E", CaptureEntry, FailureEntry)


@dataclass(frozen=True)
class Dataset:
    """A data set that `syncline fleet analyze` writes, as it was when it was opened.

    Attributes:
        storage: where it is.
        captures: those that stand, by machine, date and id.
        failures: recordings that could not be analyzed, by key.
    """

    storage: Storage
    captures: Sequence[CaptureEntry] = ()
    failures: Sequence[FailureEntry] = ()
    _tables: Mapping[Partition, frozenset[str]] = field(default_factory=dict, repr=False)

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
        listed = [path for path in storage.files() if not path.startswith(STAGING)]
        standing = [
            (path, partition)
            for path in listed
            if path.endswith(f"/{CAPTURES_FILE}") and (partition := Partition.of_path(path))
        ]
        failed = [
            (path, path.removeprefix(f"{FAILURES}/").removesuffix(".parquet"))
            for path in listed
            if path.startswith(f"{FAILURES}/") and path.endswith(".parquet")
        ]
        captures = _entries(storage, standing, CaptureEntry.of_bytes)
        failures = _entries(storage, failed, FailureEntry.of_bytes)
        return cls(
            storage,
            sorted(captures, key=lambda each: each.partition),
            sorted(failures, key=lambda each: each.key),
            _tables_of(listed),
        )

    def files(self, table: str) -> list[str]:
        """Paths or URLs of a table of the captures that stand; captures without rows have none."""
        return [
            self.storage.url_of(f"{partition.folder}/{table}.parquet")
            for partition in self.partitions(table)
        ]

    def partitions(self, table: str) -> list[Partition]:
        """The captures that stand and have rows of a table."""
        return [
            entry.partition
            for entry in self.captures
            if table in self._tables.get(entry.partition, ())
        ]

    def schema(self, table: str) -> pa.Schema:
        """Columns of a table, those of the path first: what a reader of no file at all returns."""
        return pa.schema([*((name, pa.string()) for name in PARTITIONS), *table_schema(table)])

    def captures_table(self) -> pa.Table:
        """The table `captures`, one row a capture."""
        rows = [
            {
                **entry.partition._asdict(),
                **entry.values,
                "files": _listed(entry.files),
                "copies": _listed(entry.copies),
                "content_sha256": entry.content_sha256,
                "version": entry.version,
            }
            for entry in self.captures
        ]
        return pa.Table.from_pylist(rows, self.schema(CAPTURES))

    def report(self, entry: CaptureEntry) -> str | None:
        """Path or URL of a capture's report, where one was made."""
        made = entry.values.get("report")
        return self.storage.url_of(report_file(entry.partition.capture_id)) if made else None

    def recording(self, entry: CaptureEntry) -> str | None:
        """Path or URL of a capture's Rerun recording, where one was made."""
        made = entry.values.get("recording")
        return self.storage.url_of(recording_file(entry.partition.capture_id)) if made else None


def _tables_of(paths: Iterable[str]) -> dict[Partition, frozenset[str]]:
    found: dict[str, set[str]] = {}
    for path in paths:
        folder, _, name = path.rpartition("/")
        if name.endswith(".parquet"):
            found.setdefault(folder, set()).add(name.removesuffix(".parquet"))
    return {
        partition: frozenset(names)
        for folder, names in found.items()
        if (partition := Partition.of_path(folder))
    }


def _entries(
    storage: Storage, places: Sequence[tuple[str, Any]], parse: Callable[[bytes, Any], _E]
) -> Iterator[_E]:
    """What the files hold; one that is gone by now, or of another version, counts as not there."""

    def read(place: tuple[str, Any]) -> _E | None:
        content = storage.read(place[0])
        try:
            return None if content is None else parse(content, place[1])
        except (pa.ArrowInvalid, KeyError, TypeError, IndexError):
            return None

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        yield from (entry for entry in pool.map(read, places) if entry is not None)


def _listed(files: Iterable[Any]) -> list[dict[str, Any]]:
    from dataclasses import asdict

    return [{key: value for key, value in asdict(file).items() if key != "sure"} for file in files]
