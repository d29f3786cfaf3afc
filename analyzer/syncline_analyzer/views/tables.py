"""The tables as pandas frames and as parquet files.

One column per field of the row's dataclass in `results.py`, except:

- a stamp `x_ns` (int64) has a twin `x` (datetime64[ns, UTC]; `t` for `t_ns`, `x_at` where the row
  has a field `x` of its own), NaT where the capture has no date; the durations `step_ns` and `offset_ns` have none;
- quantiles become `period_us_min`, `_median`, `_p99`, `_max` and `_std` (Float64), jitter
  `jitter_us_std`, `_p99_p1` and `_max_min`;
- `state_share` and `flags` become one column per state or flag, `details`, `chain`, `ahead` and
  `blockers` JSON text;
- an SDO `value` is text, with its number in `value_number` (Float64) where it is one, and so are
  `old` and `new` of a change; `data` is hexadecimal text.

Text is `string`, whole numbers that may be missing are `Int64`, yes and no that may be missing
`boolean`, lists stay lists.
"""

import json
import types
import typing
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from syncline_analyzer.results import (
    TRACE_FLAGS,
    Analysis,
    BusErrorRow,
    BusLoadRow,
    BusShareRow,
    BusSilenceRow,
    BusStateRow,
    ClockStepRow,
    DelayRow,
    DeviceHealthRow,
    DoubledRow,
    EmcyContextRow,
    EmcyRow,
    ErrorControlRow,
    ErrorHistoryRow,
    ErrorRow,
    Finding,
    FollowerRow,
    GapRow,
    HoleRow,
    Jitter,
    LatenessRow,
    LssRow,
    NmtCommandRow,
    NmtStateRow,
    NodeRow,
    NodeShareRow,
    ObjectChangeRow,
    ObjectHistoryRow,
    ObjectRow,
    OverloadRow,
    PdoLengthRow,
    PdoPauseRow,
    PdoRow,
    Quantiles,
    Responses,
    SdoRow,
    Series,
    ShaftRow,
    SyncDoubleRow,
    SyncJitterRow,
    SyncRow,
    TiltRow,
    TiltTrace,
    TimeStampRow,
    Trace,
    TraceEventRow,
    TraceRow,
    WaitRow,
    WorstRow,
)
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.tilt import Angles, TiltFlag, angles_of, slope_deg

ROW_TYPES: dict[str, type] = {
    "nodes": NodeRow,
    "nmt_commands": NmtCommandRow,
    "nmt_states": NmtStateRow,
    "sync": SyncRow,
    "pdos": PdoRow,
    "emcy": EmcyRow,
    "errors": ErrorRow,
    "sdo": SdoRow,
    "traces": TraceRow,
    "bus_load": BusLoadRow,
    "findings": Finding,
    "gaps": GapRow,
    "objects": ObjectRow,
    "object_history": ObjectHistoryRow,
    "holes": HoleRow,
    "sync_jitter": SyncJitterRow,
    "trace_events": TraceEventRow,
    "tilts": TiltRow,
    "shafts": ShaftRow,
    "followers": FollowerRow,
    "emcy_context": EmcyContextRow,
    "error_history": ErrorHistoryRow,
    "object_changes": ObjectChangeRow,
    "device_health": DeviceHealthRow,
    "bus_states": BusStateRow,
    "bus_errors": BusErrorRow,
    "lss": LssRow,
    "time_stamps": TimeStampRow,
    "bus_shares": BusShareRow,
    "node_shares": NodeShareRow,
    "error_control_periods": ErrorControlRow,
    "worst": WorstRow,
    "waits": WaitRow,
    "delays": DelayRow,
    "lateness": LatenessRow,
    "pdo_pauses": PdoPauseRow,
    "unsent_pdos": PdoRow,
    "sync_doubles": SyncDoubleRow,
    "overloads": OverloadRow,
    "clock_steps": ClockStepRow,
    "bus_silences": BusSilenceRow,
    "doubled": DoubledRow,
    "pdo_lengths": PdoLengthRow,
}
"""Row class by table."""

_ROWS_PER_GROUP = 1 << 18
_ROWS_AT_ONCE = 1 << 16
"""Of row objects, which are large."""
_RESPONSE_COLUMNS = (
    "response_us",
    "device_low_us",
    "device_high_us",
    "device_least_us",
    "waiting_us",
)
_DURATIONS = ("step_ns", "offset_ns")
"""Columns in ns that are no stamps."""
_MIXED = ("value", "old", "new")
"""Columns that hold numbers and text."""
_TRACE_COLUMNS = ("position", "turn", "angle_deg", "unwrapped_deg", "speed_rpm")


def rows_of(analysis: Analysis, table: str) -> Sequence[Any]:
    """The rows of one table by its name in `ROW_TYPES`."""
    rows: Sequence[Any] = analysis.capture.gaps if table == "gaps" else getattr(analysis, table)
    return rows


def is_dated(analysis: Analysis) -> bool:
    """Whether the stamps of this analysis are UTC."""
    return analysis.capture.start_utc_ns is not None


def table(analysis: Analysis, name: str) -> pd.DataFrame:
    """One table of an analysis as a frame, with all its columns also when it has no rows."""
    return to_frame(rows_of(analysis, name), name, dated=is_dated(analysis))


def to_frame(rows: Sequence[Any], name: str | None = None, *, dated: bool = True) -> pd.DataFrame:
    """Rows of one class as a frame; see the module for the columns.

    Args:
        rows: instances of one row class of `results.py`.
        name: the table's name in `ROW_TYPES`, needed where `rows` may be empty.
        dated: False when stamps are not UTC: the datetime twins are then NaT.
    """
    if name is None and not rows:
        return pd.DataFrame()
    kind = ROW_TYPES[name] if name is not None else type(rows[0])
    hints = typing.get_type_hints(kind)
    columns: dict[str, Any] = {}
    names = [f.name for f in fields(kind)]
    listed = list(zip(*map(attrgetter(*names), rows), strict=True)) or [()] * len(names)
    for f, values in zip(fields(kind), listed, strict=True):
        for column, data in _columns(f.name, hints[f.name], values):
            columns[column] = data
            if column.endswith("_ns") and column not in _DURATIONS:
                columns[_twin(column, names)] = datetimes(data, dated=dated)
    return pd.DataFrame(columns, index=pd.RangeIndex(len(rows)))


def _twin(column: str, names: Sequence[str]) -> str:
    """Name of the datetime beside a stamp; another field may have the usual one."""
    usual = column.removesuffix("_ns")
    return f"{usual}_at" if usual in names else usual


def datetimes(t_ns: Any, *, dated: bool = True) -> "pd.Series[Any]":
    """Stamps in ns since 1970 as datetime64[ns, UTC]; missing ones, and all without a date, NaT."""
    stamps = pd.Series(pd.array(t_ns, dtype="Int64"))
    whole = stamps.fillna(0).to_numpy(np.int64).astype("datetime64[ns]")
    known = stamps.notna().to_numpy() & dated
    moments = pd.DatetimeIndex(np.where(known, whole, np.datetime64("NaT", "ns")))
    return pd.Series(moments.tz_localize("UTC"))


def _columns(name: str, hint: Any, values: Sequence[Any]) -> Iterator[tuple[str, Any]]:
    plain, optional = _without_none(hint)
    if name in _MIXED and plain is None:
        yield name, pd.array([None if v is None else str(v) for v in values], dtype="string")
        yield f"{name}_number", _floats([v if isinstance(v, int | float) else None for v in values])
    elif plain in (Quantiles, Jitter):
        for part in (f.name for f in fields(plain)):
            yield f"{name}_{part}", _floats([v and getattr(v, part) for v in values])
    elif name in ("chain", "ahead", "blockers"):
        yield name, pd.array([_json([asdict(each) for each in v]) for v in values], dtype="string")
    elif name == "state_share":
        for state in NmtState:
            column = "share_" + state.lower().replace("-", "_")
            yield column, np.array([v.get(state, 0.0) for v in values], np.float64)
    elif name == "flags":
        for flag in TRACE_FLAGS:
            yield f"flag_{flag}", np.array([v.get(flag, 0) for v in values], np.int64)
    else:
        yield name, _column(plain, optional, values)


def _column(plain: Any, optional: bool, values: Sequence[Any]) -> Any:
    origin = typing.get_origin(plain)
    if origin is list:
        return pd.Series(values, dtype=object)
    if origin is dict:
        return pd.array([_json(v) for v in values], dtype="string")
    if plain is bytes:
        return pd.array([v.hex(" ").upper() for v in values], dtype="string")
    if plain is bool:
        return pd.array(values, dtype="boolean") if optional else np.array(values, np.bool_)
    if plain is int:
        return pd.array(values, dtype="Int64") if optional else np.array(values, np.int64)
    if plain is float:
        return _floats(values) if optional else np.array(values, np.float64)
    return pd.array(values, dtype="string")


def _json(value: Any) -> str:
    return json.dumps(value, default=_hex, sort_keys=True)


def _hex(value: Any) -> str:
    return value.hex(" ").upper() if isinstance(value, bytes) else str(value)


def _floats(values: Sequence[Any]) -> Any:
    return pd.array([np.nan if v is None else float(v) for v in values], dtype="Float64")


def _without_none(hint: Any) -> tuple[Any, bool]:
    """The type without None, None itself when several types remain, and whether None was in it."""
    if typing.get_origin(hint) not in (types.UnionType, typing.Union):
        return hint, False
    members = typing.get_args(hint)
    left = [member for member in members if member is not type(None)]
    return (left[0] if len(left) == 1 else None), len(left) < len(members)


def trace_frame(trace: Trace, extra: Sequence[str] = (), *, dated: bool = True) -> pd.DataFrame:
    """Samples of one trace: its columns, the twin `t`, and one boolean column per flag.

    Columns that the trace does not have, but an encoder would or `extra` names, are NaN.
    """
    frame = pd.DataFrame({"t_ns": trace.t_ns, "t": datetimes(trace.t_ns, dated=dated)})
    for name in ("seq", "raw", "value", "segment"):
        frame[name] = getattr(trace, name)
    for name in dict.fromkeys((*_TRACE_COLUMNS, *extra, *trace.columns)):
        frame[name] = trace.columns.get(name, np.nan)
    for bit, flag in enumerate(TRACE_FLAGS):
        frame[flag] = (trace.flags >> bit & 1).astype(np.bool_)
    for name in ("name", "object", "node", "bus", "unit"):
        frame.insert(0, name, getattr(trace, name))
    return frame


def tilt_frame(tilt: TiltTrace, *, dated: bool = True) -> pd.DataFrame:
    """Poses of one inclinometer: both angles as sent, gravity, and both by every definition.

    Angles that a pose does not have by a definition are NaN; `<definition>_singular` marks those
    that are meaningless. See `syncline_schemas.tilt` for the frame and the definitions.
    """
    frame = pd.DataFrame({"t_ns": tilt.t_ns, "t": datetimes(tilt.t_ns, dated=dated)})
    for name in ("seq", "longitudinal_deg", "lateral_deg"):
        frame[name] = getattr(tilt, name)
    for name in ("definition", "angles", "reference", "reason"):
        words = np.array([getattr(each, name) for each in tilt.settings], object)
        frame[name] = pd.array(words[tilt.setting], dtype="string")
    for axis, name in enumerate("xyz"):
        frame[f"gravity_{name}"] = tilt.gravity[:, axis]
    frame["slope_deg"] = slope_deg(tilt.gravity)
    for angles in Angles:
        found = angles_of(tilt.gravity, angles)
        first, second = angles.names
        frame[f"{angles}_{first}_deg"] = found.first_deg
        frame[f"{angles}_{second}_deg"] = found.second_deg
        frame[f"{angles}_singular"] = found.singular
    for flag in TiltFlag:
        frame[str(flag.name).lower()] = (tilt.flags & flag).astype(np.bool_)
    for name in ("object", "node", "bus"):
        frame.insert(0, name, getattr(tilt, name))
    return frame


def tilts_frame(tilts: Sequence[TiltTrace], *, dated: bool = True) -> pd.DataFrame:
    """Poses of several inclinometers, one below the other."""
    frames = [tilt_frame(each, dated=dated) for each in tilts or [_NO_TILT]]
    return pd.concat(frames, ignore_index=True)


def response_frame(responses: Responses, *, dated: bool = True) -> pd.DataFrame:
    """Answers of one PDO to its SYNCs, one row each."""
    frame = pd.DataFrame(
        {
            "bus": responses.bus,
            "cob_id": responses.cob_id,
            "node": pd.array([responses.node] * len(responses.t_ns), dtype="Int64"),
            "pdo": pd.array([responses.pdo] * len(responses.t_ns), dtype="string"),
            "seq": responses.seq,
            "t_ns": responses.t_ns,
        }
    )
    frame["t"] = datetimes(responses.t_ns, dated=dated)
    for name in _RESPONSE_COLUMNS:
        frame[name] = getattr(responses, name)
    return frame


def traces_frame(traces: Sequence[Trace], *, dated: bool = True) -> pd.DataFrame:
    """Samples of several traces, one below the other."""
    extra = [name for trace in traces for name in trace.columns]
    frames = [trace_frame(trace, extra, dated=dated) for trace in traces or [_NO_TRACE]]
    return pd.concat(frames, ignore_index=True)


def responses_frame(responses: Sequence[Responses], *, dated: bool = True) -> pd.DataFrame:
    """Answers of several PDOs, one below the other."""
    frames = [response_frame(each, dated=dated) for each in responses or [_NO_RESPONSES]]
    return pd.concat(frames, ignore_index=True)


def histogram_frame(responses: Responses) -> pd.DataFrame:
    """Response histogram of one PDO: one row per bin with its edges in us."""
    return pd.DataFrame(
        {
            "bus": responses.bus,
            "cob_id": responses.cob_id,
            "low_us": responses.edges_us[:-1],
            "high_us": responses.edges_us[1:],
            "count": responses.histogram,
        }
    )


def series_frame(series: Series, *, dated: bool = True) -> pd.DataFrame:
    """One quantity over time."""
    frame = pd.DataFrame(
        {"bus": series.bus, "name": series.name, "unit": series.unit, "t_ns": series.t_ns}
    )
    frame["t"] = datetimes(series.t_ns, dated=dated)
    frame["value"] = series.value
    return frame


def write_tables(analysis: Analysis, folder: Path) -> list[Path]:
    """Write every table as `<name>.parquet` into a folder, and return the files.

    Besides the tables of `ROW_TYPES`: `trace_samples`, `tilt_samples`, `pdo_responses`,
    `response_histograms` and `series`. All of them are always there, with all columns, also when they have no rows.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return [
        _write(folder / f"{name}.parquet", frames, ROW_TYPES.get(name))
        for name, frames in _all_frames(analysis).items()
    ]


def _all_frames(analysis: Analysis) -> dict[str, Iterator[pd.DataFrame]]:
    dated = is_dated(analysis)
    traces = analysis.trace_data or [_NO_TRACE]
    responses = analysis.responses or [_NO_RESPONSES]
    extra = [name for trace in traces for name in trace.columns]
    return {
        **{name: _parts(analysis, name) for name in ROW_TYPES},
        "trace_samples": (trace_frame(x, extra, dated=dated) for x in traces),
        "tilt_samples": (tilt_frame(x, dated=dated) for x in analysis.tilt_data or [_NO_TILT]),
        "pdo_responses": (response_frame(x, dated=dated) for x in responses),
        "response_histograms": (histogram_frame(x) for x in responses),
        "series": (series_frame(x, dated=dated) for x in analysis.series or [_NO_SERIES]),
    }


def _parts(analysis: Analysis, name: str) -> Iterator[pd.DataFrame]:
    """One table in frames of so many rows that not all of a long one are there at once."""
    rows, dated = rows_of(analysis, name), is_dated(analysis)
    for begin in range(0, max(len(rows), 1), _ROWS_AT_ONCE):
        yield to_frame(rows[begin : begin + _ROWS_AT_ONCE], name, dated=dated)


def _write(path: Path, frames: Iterator[pd.DataFrame], kind: type | None) -> Path:
    """One file from frames of equal columns, each at least one row group of its own."""
    first = _arrow(next(frames), kind)
    with pq.ParquetWriter(path, first.schema, compression="zstd") as writer:
        writer.write_table(first, row_group_size=_ROWS_PER_GROUP)
        for frame in frames:
            writer.write_table(
                _arrow(frame, kind).cast(first.schema), row_group_size=_ROWS_PER_GROUP
            )
    return path


def _arrow(frame: pd.DataFrame, kind: type | None) -> pa.Table:
    """The frame as Arrow; rows of `kind` tell the type of their lists, which may all be empty."""
    schema = pa.Schema.from_pandas(frame, preserve_index=False)
    for name, hint in typing.get_type_hints(kind).items() if kind else ():
        at = schema.get_field_index(name)
        if at >= 0 and typing.get_origin(hint) is list and hint in _LIST_TYPES:
            schema = schema.set(at, pa.field(name, _LIST_TYPES[hint]))
    for at, field in enumerate(schema):
        # pandas 2 does not know that a column without rows is of text.
        if pa.types.is_null(field.type):
            schema = schema.set(at, field.with_type(pa.string()))
    return pa.Table.from_pandas(frame, schema=schema, preserve_index=False)


_LIST_TYPES = {list[int]: pa.list_(pa.int64()), list[str]: pa.list_(pa.string())}

_NO_INTEGERS = np.zeros(0, np.int64)
_NO_TILT = TiltTrace(
    "", 0, 0, _NO_INTEGERS, _NO_INTEGERS, np.zeros(0), np.zeros(0), np.zeros((0, 3)),
    np.zeros(0, np.uint8), _NO_INTEGERS,
)  # fmt: skip
_NO_FLOATS = np.zeros(0, np.float64)
_NO_TRACE = Trace(
    "", 0, 0, "", "", _NO_INTEGERS, _NO_INTEGERS, _NO_INTEGERS, _NO_FLOATS,
    np.zeros(0, np.uint16), np.zeros(0, np.int32),
)  # fmt: skip
_NO_RESPONSES = Responses(
    "", 0, None, None, _NO_INTEGERS, _NO_INTEGERS, _NO_FLOATS, _NO_FLOATS, _NO_FLOATS,
    _NO_INTEGERS, np.zeros(1, np.float64), _NO_FLOATS, _NO_FLOATS,
)  # fmt: skip
_NO_SERIES = Series("", "", "", _NO_INTEGERS, _NO_FLOATS)
