"""The tables of the data set and their columns: the same in every file of a table."""

from collections.abc import Sequence
from functools import cache

import pyarrow as pa

from syncline_analyzer.fleet.columns import STAMP, schema_of
from syncline_analyzer.views.tables import ROW_TYPES

CAPTURES = "captures"
"""One row a capture: what it is of, whether it stands, how it came out."""
FAILURES = "failures"
"""One row for what could not be analyzed."""
SAMPLE_TABLES = ("trace_samples", "tilt_samples", "pdo_responses", "series")
"""Tables with a row per sample or answer, larger than all others together; only where asked for."""
PARTITIONS = ("machine", "date", "capture_id")
"""Columns that every row has by the path of its file; all are text."""
COSTS = ("cpu_s", "peak_mb")
"""Columns of `captures` that tell of the run, not of the capture."""

FILES = pa.list_(
    pa.struct(
        [
            ("url", pa.string()),
            ("size_bytes", pa.int64()),
            ("modified_ns", pa.int64()),
            ("etag", pa.string()),
            ("recording_id", pa.string()),
            ("host", pa.string()),
            ("machine", pa.string()),
            ("segment", pa.int64()),
            ("created_ns", pa.int64()),
        ]
    )
)
_TEXTS = pa.list_(pa.string())
_SCHEMAS = {
    CAPTURES: pa.schema(
        [
            ("files", FILES),
            ("copies", FILES),
            ("content_sha256", pa.string()),
            ("version", pa.string()),
            ("frames", pa.int64()),
            ("data_frames", pa.int64()),
            ("remote_frames", pa.int64()),
            ("error_frames", pa.int64()),
            ("unparsed_lines", pa.int64()),
            ("start_utc_ns", pa.int64()),
            ("start", STAMP),
            ("first_ns", pa.int64()),
            ("duration_ns", pa.int64()),
            ("time_base", pa.string()),
            ("blind_ns", pa.int64()),
            ("buses", _TEXTS),
            ("nodes", pa.int64()),
            ("verdict", pa.string()),
            ("errors", pa.int64()),
            ("warnings", pa.int64()),
            ("infos", pa.int64()),
            ("notes", _TEXTS),
            ("damage", _TEXTS),
            ("tables", _TEXTS),
            ("samples", pa.bool_()),
            ("report", pa.bool_()),
            ("recording", pa.bool_()),
            ("cpu_s", pa.float64()),
            ("peak_mb", pa.float64()),
        ]
    ),
    FAILURES: pa.schema(
        [
            ("machine", pa.string()),
            ("files", FILES),
            ("kind", pa.string()),
            ("reason", pa.string()),
            ("content_sha256", pa.string()),
            ("version", pa.string()),
        ]
    ),
    "response_histograms": pa.schema(
        [
            ("bus", pa.string()),
            ("cob_id", pa.int64()),
            ("low_us", pa.float64()),
            ("high_us", pa.float64()),
            ("count", pa.int64()),
        ]
    ),
}


def tables(*, samples: bool = False) -> Sequence[str]:
    """Names of the tables of a capture, with those of `SAMPLE_TABLES` or without."""
    return (CAPTURES, *ROW_TYPES, "response_histograms", *(SAMPLE_TABLES if samples else ()))


@cache
def table_schema(name: str) -> pa.Schema:
    """Columns of a table, without those of `PARTITIONS`; all of them, also where none has rows.

    `trace_samples` may have further columns in some files: quantities of one device only.
    """
    if name in ROW_TYPES:
        return schema_of(ROW_TYPES[name])
    if name in SAMPLE_TABLES:
        return _sample_schema(name)
    return _SCHEMAS[name]


def _sample_schema(name: str) -> pa.Schema:
    from syncline_analyzer.fleet.samples import empty_frame

    schema = pa.Schema.from_pandas(empty_frame(name), preserve_index=False)
    return pa.schema([(field.name, plain_type(field.type)) for field in schema])


def plain_type(type_: pa.DataType) -> pa.DataType:
    """The type with which text is written, whatever pandas makes of it."""
    return pa.string() if pa.types.is_large_string(type_) or pa.types.is_null(type_) else type_
