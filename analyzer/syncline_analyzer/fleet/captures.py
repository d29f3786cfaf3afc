"""The rows of `captures` and `failures`: what the data set knows of each recording."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from io import BytesIO
from typing import Any, Self

import pyarrow as pa
import pyarrow.parquet as pq

from syncline_analyzer.fleet.layout import Partition
from syncline_analyzer.fleet.recording import File
from syncline_analyzer.fleet.schemas import CAPTURES, FAILURES, table_schema
from syncline_analyzer.fleet.task import Outcome, Status
from syncline_analyzer.results import Analysis
from syncline_schemas.records import dataclass

HEALTHY = "healthy"
"""Verdict of a capture without findings of severity error or warning."""
UNREADABLE = (pa.ArrowException, OSError, ValueError, KeyError, TypeError, IndexError)
"""What reading a Parquet file raises that is damaged, or of another version."""


@dataclass(frozen=True, slots=True)
class CaptureEntry:
    """The row of a capture in `captures`, and where its tables are.

    Attributes:
        files, copies: what was analyzed, and what holds the same.
        content_sha256, version: of the content, and of the analysis with its settings.
        values: all further columns.
    """

    partition: Partition
    files: tuple[File, ...]
    copies: tuple[File, ...]
    content_sha256: str
    version: str
    values: Mapping[str, Any]

    @property
    def urls(self) -> set[str]:
        """URLs of all files, copies too."""
        return {file.url for file in (*self.files, *self.copies)}

    @property
    def stamps(self) -> set[tuple[str, int, str | int | None]]:
        """Stamps of all files, copies too."""
        return {file.stamp for file in (*self.files, *self.copies)}

    def has(self, wanted: Iterable[str]) -> bool:
        """Whether everything wanted was made: "samples", "report", "recording"."""
        return all(self.values.get(each) for each in wanted)

    def to_bytes(self) -> bytes:
        """The file `captures.parquet` of this capture."""
        return _file(
            CAPTURES,
            {
                "files": _rows(self.files),
                "copies": _rows(self.copies),
                "content_sha256": self.content_sha256,
                "version": self.version,
                **self.values,
            },
        )

    @classmethod
    def of_bytes(cls, content: bytes, partition: Partition) -> Self:
        """The entry that a file `captures.parquet` holds."""
        return cls.of_row(table_rows(content)[0], partition)

    @classmethod
    def of_row(cls, row: dict[str, Any], partition: Partition) -> Self:
        """The entry that a row of it holds, without the columns of the partition."""
        files, copies = _files(row.pop("files")), _files(row.pop("copies"))
        return cls(partition, files, copies, row.pop("content_sha256"), row.pop("version"), row)


@dataclass(frozen=True, slots=True)
class FailureEntry:
    """A recording that could not be analyzed.

    Attributes:
        kind: "capture", "no capture" (nothing says that the file should be one) or "worker died".
        content_sha256: None where it was not read through.
    """

    key: str
    machine: str
    files: tuple[File, ...]
    kind: str
    reason: str
    content_sha256: str | None
    version: str

    def to_bytes(self) -> bytes:
        """The file of this failure."""
        names = (f.name for f in fields(self) if f.name not in ("key", "files"))
        row = {name: getattr(self, name) for name in names}
        return _file(FAILURES, {**row, "files": _rows(self.files)})

    @classmethod
    def of_bytes(cls, content: bytes, key: str) -> Self:
        """The entry that a file of a failure holds."""
        row = table_rows(content)[0]
        return cls(key=key, files=_files(row.pop("files")), **row)


def capture_values(analysis: Analysis) -> dict[str, Any]:
    """The columns of `captures` that an analysis tells."""
    capture = analysis.capture
    counts = {
        severity: sum(finding.severity == severity for finding in analysis.findings)
        for severity in ("error", "warning", "info")
    }
    worst = next((each for each in ("error", "warning") if counts[each]), HEALTHY)
    return {
        "frames": capture.frames,
        "data_frames": capture.data_frames,
        "remote_frames": capture.remote_frames,
        "error_frames": capture.error_frames,
        "unparsed_lines": capture.unparsed_lines,
        "start_utc_ns": capture.start_utc_ns,
        "start": capture.start_utc_ns,
        "first_ns": capture.first_ns,
        "duration_ns": capture.duration_ns,
        "time_base": capture.time_base,
        "blind_ns": sum(gap.end_ns - gap.start_ns for gap in capture.gaps),
        "buses": capture.buses,
        "nodes": len(analysis.nodes),
        "verdict": worst,
        **{f"{severity}s": count for severity, count in counts.items()},
        "notes": capture.notes,
        "damage": capture.damage,
    }


def outcome_of(status: Status, entry: CaptureEntry) -> Outcome:
    """The outcome of a task whose capture stands."""
    values = entry.values
    return Outcome(
        status,
        partition=entry.partition,
        content_sha256=entry.content_sha256,
        frames=values["frames"],
        verdict=values["verdict"],
        errors=values["errors"],
        warnings=values["warnings"],
    )


def _rows(files: Sequence[File]) -> list[dict[str, Any]]:
    return [{key: value for key, value in asdict(file).items() if key != "sure"} for file in files]


def _files(rows: Sequence[Mapping[str, Any]]) -> tuple[File, ...]:
    return tuple(File(**row) for row in rows)


def _file(name: str, row: Mapping[str, Any]) -> bytes:
    sink = pa.BufferOutputStream()
    pq.write_table(
        pa.Table.from_pylist([dict(row)], table_schema(name)),
        sink,
        compression="snappy",
        use_dictionary=False,
        write_statistics=False,
        store_schema=False,
        write_page_checksum=True,
    )
    content: bytes = sink.getvalue().to_pybytes()
    return content


def table_rows(content: bytes) -> list[dict[str, Any]]:
    """The rows of a Parquet file; a stamp in ns stays the number that it is."""
    table = pq.ParquetFile(BytesIO(content), page_checksum_verification=True).read()
    # pandas has no part in it.
    for at, field in enumerate(table.schema):
        if pa.types.is_timestamp(field.type):
            table = table.set_column(at, field.name, table[at].cast(pa.int64()))
    rows: list[dict[str, Any]] = table.to_pylist()
    return rows


def rows_of_captures(entries: Iterable[CaptureEntry]) -> Iterator[dict[str, Any]]:
    """Rows of the table `captures`, with the columns of the partition."""
    for entry in entries:
        yield {
            **entry.partition._asdict(),
            **entry.values,
            "files": _rows(entry.files),
            "copies": _rows(entry.copies),
            "content_sha256": entry.content_sha256,
            "version": entry.version,
        }
