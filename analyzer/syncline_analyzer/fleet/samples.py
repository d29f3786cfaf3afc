"""Tables with a row per sample, of which a capture may have millions."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from syncline_analyzer.fleet.schemas import plain_type, table_schema
from syncline_analyzer.results import Analysis, Series
from syncline_analyzer.views.tables import (
    is_dated,
    response_frame,
    responses_frame,
    series_frame,
    tilt_frame,
    tilts_frame,
    trace_frame,
    traces_frame,
)

_ROWS_PER_GROUP = 1 << 18
_NO_SERIES = Series("", "", "", np.zeros(0, np.int64), np.zeros(0))


def empty_frame(name: str) -> pd.DataFrame:
    """A table of `SAMPLE_TABLES` without rows."""
    match name:
        case "trace_samples":
            return traces_frame([])
        case "tilt_samples":
            return tilts_frame([])
        case "pdo_responses":
            return responses_frame([])
    return series_frame(_NO_SERIES)


def write_samples(analysis: Analysis, folder: Path) -> list[str]:
    """Write the sample tables that have rows into a folder; their names."""
    return [name for name, frames in _frames(analysis) if _write(folder, name, frames)]


def _frames(analysis: Analysis) -> Iterator[tuple[str, Iterator[pd.DataFrame]]]:
    dated = is_dated(analysis)
    extra = sorted({name for trace in analysis.trace_data for name in trace.columns})
    yield "trace_samples", (trace_frame(x, extra, dated=dated) for x in analysis.trace_data)
    yield "tilt_samples", (tilt_frame(x, dated=dated) for x in analysis.tilt_data)
    yield "pdo_responses", (response_frame(x, dated=dated) for x in analysis.responses)
    yield "series", (series_frame(x, dated=dated) for x in analysis.series)


def _write(folder: Path, name: str, frames: Iterable[pd.DataFrame]) -> bool:
    """Write the frames that have rows as one file; whether there was one."""
    writer = None
    for frame in frames:
        if len(frame):
            table = _arrow(name, frame)
            writer = writer or pq.ParquetWriter(
                folder / f"{name}.parquet",
                table.schema,
                compression="zstd",
                write_page_checksum=True,
            )
            writer.write_table(table, row_group_size=_ROWS_PER_GROUP)
    if writer is not None:
        writer.close()
    return writer is not None


def _arrow(name: str, frame: pd.DataFrame) -> pa.Table:
    """The frame with the columns of its table, and further ones behind them."""
    found = pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata(None)
    known = table_schema(name)
    more = [field for field in found.schema if field.name not in known.names]
    schema = pa.schema([*known, *((field.name, plain_type(field.type)) for field in more)])
    return found.select(schema.names).cast(schema)
