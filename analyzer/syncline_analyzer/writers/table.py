"""Parquet: one row per frame, for pandas, DuckDB and spreadsheets of data people."""

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.writers.log import LogWriter, Survey
from syncline_schemas.batch import FrameBatch, FrameFlag

_FLAGS = {
    "extended": FrameFlag.EXTENDED,
    "remote": FrameFlag.REMOTE,
    "error": FrameFlag.ERROR,
    "fd": FrameFlag.FD,
    "brs": FrameFlag.BRS,
    "esi": FrameFlag.ESI,
    "tx": FrameFlag.TX,
    "length_contradicts": FrameFlag.DLC_INVALID,
}


class ParquetWriter(LogWriter):
    """Columns `t` (UTC, ns; `t_ns` as a number where the log has no dates), `bus`, `can_id`, flags, `dlc`, `data`."""

    def __init__(self, stream: BinaryIO, survey: Survey) -> None:
        super().__init__(stream, survey)
        import pyarrow as pa
        import pyarrow.parquet as pq

        self._arrow: Any = pa
        dated = survey.time_base == "utc"
        times = ("t", pa.timestamp("ns", "UTC")) if dated else ("t_ns", pa.int64())
        self._schema = pa.schema(
            [
                times,
                ("bus", pa.dictionary(pa.int32(), pa.string())),
                ("can_id", pa.uint32()),
                *((name, pa.bool_()) for name in _FLAGS),
                ("dlc", pa.uint8()),
                ("data", pa.binary()),
            ]
        )
        self._parquet: Any = pq.ParquetWriter(stream, self._schema, compression="zstd")

    def write(self, batch: FrameBatch) -> None:
        """Write frames."""
        if not len(batch):
            return
        pa = self._arrow
        names = pa.array(self._survey.buses, pa.string())
        columns = [
            pa.array(batch.t_ns).cast(self._schema.field(0).type),
            pa.DictionaryArray.from_arrays(pa.array(batch.bus.astype(np.int32)), names),
            pa.array(batch.can_id),
            *(pa.array((batch.flags & flag) != 0) for flag in _FLAGS.values()),
            pa.array(batch.dlc),
            self._payloads(batch),
        ]
        self._parquet.write_batch(pa.record_batch(columns, schema=self._schema))

    def _payloads(self, batch: FrameBatch) -> Any:
        pa = self._arrow
        remote = (batch.flags & FrameFlag.REMOTE) != 0
        count: NDArray[np.int32] = np.where(remote, 0, batch.dlc).astype(np.int32)
        kept = np.arange(batch.data.shape[1]) < count[:, np.newaxis]
        ends = np.concatenate((np.zeros(1, np.int32), np.cumsum(count, dtype=np.int32)))
        buffers = [None, pa.py_buffer(ends.tobytes()), pa.py_buffer(batch.data[kept].tobytes())]
        return pa.Array.from_buffers(pa.binary(), len(batch), buffers)

    def close(self) -> None:
        """Write the footer."""
        self._parquet.close()
