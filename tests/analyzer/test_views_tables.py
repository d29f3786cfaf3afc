"""Tables as frames and parquet: documented dtypes, twins in UTC, nothing lost on the way."""

import re
import types
import typing
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from syncline_analyzer.results import Analysis
from syncline_analyzer.views import tables
from syncline_analyzer.views.json_view import TABLES
from syncline_analyzer.views.tables import (
    ROW_TYPES,
    responses_frame,
    rows_of,
    table,
    to_frame,
    traces_frame,
    write_tables,
)
from tests.analyzer.analysis_builder import (
    T0,
    analysis,
    at,
    bad_day,
    capture_row,
    emcy_row,
    responses,
    sdo_row,
    shaft,
    tilt,
)


@pytest.mark.parametrize("name", ROW_TYPES)
def test_frame_of_no_rows_has_the_columns_and_dtypes_of_a_full_one(name: str) -> None:
    full, empty = table(bad_day(), name), to_frame([], name)
    assert list(full.columns) == list(empty.columns)
    assert full.dtypes.to_dict() == empty.dtypes.to_dict()
    assert len(full) == len(rows_of(bad_day(), name))


def test_stamps_have_a_twin_in_utc_to_the_nanosecond() -> None:
    frame = to_frame([emcy_row(t_ns=T0 + 123_456_789)])
    assert str(frame["t"].dtype) == "datetime64[ns, UTC]"
    assert frame["t"][0] == pd.Timestamp("2026-09-21T14:13:20.123456789Z")
    assert frame["t_ns"].dtype == np.int64


def test_twin_is_missing_where_there_is_no_date_or_no_stamp() -> None:
    undated = analysis(capture=capture_row(start_utc_ns=None), emcy=[emcy_row()])
    assert table(undated, "emcy")["t"].isna().all()
    assert table(bad_day(), "errors")["cleared"].isna().tolist() == [True, False, True]


def test_yes_and_no_are_no_text() -> None:
    """A text "False" counts as true in a filter."""
    for name, kind in ROW_TYPES.items():
        hints = typing.get_type_hints(kind)
        frame = to_frame([row_of(kind)], name)
        for column, hint in hints.items():
            if hint is bool:
                assert frame[column].dtype == np.bool_, (name, column)
            elif hint == bool | None:
                assert frame[column].dtype == pd.BooleanDtype(), (name, column)
    told = to_frame([sdo_row(crc_ok=None), sdo_row(crc_ok=False)])
    assert told["crc_ok"].isna().tolist() == [True, False]
    assert not told["crc_ok"][1]


@pytest.mark.parametrize(("name", "column"), [("clock_steps", "step"), ("time_stamps", "offset")])
def test_a_duration_has_no_twin_with_a_date(name: str, column: str) -> None:
    columns = to_frame([], name).columns
    assert f"{column}_ns" in columns
    assert column not in columns


def test_value_of_an_sdo_is_text_with_its_number_beside_it() -> None:
    frame = to_frame([sdo_row(value=100), sdo_row(value="JN2100"), sdo_row(value=None)])
    assert frame["value"].tolist()[:2] == ["100", "JN2100"]
    assert frame["value_number"][0] == 100.0
    assert frame["value_number"].isna().tolist() == [False, True, True]


def test_parquet_gives_back_every_table(tmp_path: Path) -> None:
    shown = bad_day()
    written = {path.stem: path for path in write_tables(shown, tmp_path)}
    for name in ROW_TYPES:
        read, made = pd.read_parquet(written[name]), table(shown, name)
        assert list(read.columns) == list(made.columns)
        assert len(read) == len(made), name
    emcy = pd.read_parquet(written["emcy"])
    assert emcy["code"].tolist()[:2] == [0x3100, 0x8130]
    assert list(emcy["registers"][0]) == ["generic", "voltage"]
    assert str(emcy["t"].dtype) == "datetime64[ns, UTC]"
    states = pd.read_parquet(written["nmt_states"])
    assert states.loc[states["state"] == "LOST", "start_ns"].tolist() == [at(250.0), at(500.0)]


def test_parquet_has_the_same_types_with_and_without_rows(tmp_path: Path) -> None:
    full = {path.stem: pq.read_schema(path) for path in write_tables(bad_day(), tmp_path / "full")}
    empty = {path.stem: pq.read_schema(path) for path in write_tables(analysis(), tmp_path / "no")}
    assert full.keys() == empty.keys()
    for name, schema in full.items():
        assert schema.equals(empty[name]), name


def test_a_long_table_is_written_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = bad_day()
    whole = {path.stem: pq.read_table(path) for path in write_tables(shown, tmp_path / "whole")}
    monkeypatch.setattr(tables, "_ROWS_AT_ONCE", 2)
    parts = {path.stem: path for path in write_tables(shown, tmp_path / "parts")}
    assert pq.ParquetFile(parts["findings"]).num_row_groups == -(-len(shown.findings) // 2) > 1
    for name, path in parts.items():
        assert pq.read_table(path).equals(whole[name]), name


def sample(hint: Any) -> Any:
    """A value of a type, lists and objects with something in them."""
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        return sample(typing.get_args(hint)[0])
    if typing.get_origin(hint) is typing.Literal:
        return typing.get_args(hint)[0]
    if typing.get_origin(hint) is list:
        return [sample(typing.get_args(hint)[0])]
    if typing.get_origin(hint) is dict:
        return {}
    if is_dataclass(hint):
        return row_of(hint)
    return {int: 7, float: 1.5, str: "word", bool: True, bytes: b"\x01"}.get(hint, {})


def row_of(kind: Any) -> Any:
    """A row in which nothing is empty and nothing missing."""
    return kind(**{name: sample(hint) for name, hint in typing.get_type_hints(kind).items()})


def test_parquet_of_full_rows_has_the_types_of_an_empty_one(tmp_path: Path) -> None:
    full = analysis(
        **{name: [row_of(kind)] for name, kind in ROW_TYPES.items() if name != "gaps"},
        capture=capture_row(gaps=[row_of(ROW_TYPES["gaps"])]),
    )
    filled = {path.stem: path for path in write_tables(full, tmp_path / "full")}
    empty = {path.stem: path for path in write_tables(analysis(), tmp_path / "no")}
    for name in ROW_TYPES:
        assert len(pq.read_table(filled[name])) == 1, name
        schema, other = pq.read_schema(filled[name]), pq.read_schema(empty[name])
        assert [(f.name, f.type) for f in schema] == [(f.name, f.type) for f in other], name


def test_every_table_of_rows_is_written_and_told_as_json() -> None:
    """What is not a table of rows: samples, which the parquet files hold, and plots."""
    columns = {"trace_data", "tilt_data", "shaft_data", "responses", "series"}
    rows = {f.name for f in fields(Analysis) if f.name != "capture"} - columns
    assert rows <= set(ROW_TYPES)
    with_evidence_only = {"holes", "sync_jitter", "objects", "object_history"}
    assert rows - with_evidence_only <= set(TABLES)


def test_trace_samples_keep_every_sample_and_flag(tmp_path: Path) -> None:
    encoder, slope = shaft(1000), tilt(0x601000, "Slope long", 40.0)
    shown = analysis(trace_data=[encoder, slope], responses=[responses(count=500)])
    write_tables(shown, tmp_path)
    samples = pd.read_parquet(tmp_path / "trace_samples.parquet")
    assert len(samples) == len(encoder.t_ns) + len(slope.t_ns)
    own = samples[samples["node"] == 5]
    np.testing.assert_array_equal(own["t_ns"], encoder.t_ns)
    np.testing.assert_array_equal(own["angle_deg"], encoder.columns["angle_deg"])
    assert own["jump"].sum() == 1
    assert samples.loc[samples["node"] == 10, "angle_deg"].isna().all()
    assert len(pd.read_parquet(tmp_path / "pdo_responses.parquet")) == 500
    assert len(traces_frame([])) == len(responses_frame([])) == 0


def test_columns_are_those_of_the_rows() -> None:
    for name, kind in ROW_TYPES.items():
        columns = set(to_frame([], name).columns)
        split = {f.name for f in fields(kind) if re.search("Quantiles|Jitter", str(f.type))}
        split |= {"state_share", "flags"}
        assert {f.name for f in fields(kind)} - split <= columns, name


def test_no_table_loses_a_field_to_the_twin_of_a_stamp() -> None:
    for name, kind in ROW_TYPES.items():
        frame, known = to_frame([], name), {f.name for f in fields(kind)}
        for column in known:
            if f"{column}_ns" in known:
                assert frame[column].dtype.kind != "M", f"{name}.{column}"
                assert frame[f"{column}_at"].dtype.kind == "M"
    assert {"parted", "parted_ns", "parted_at"} <= {*to_frame([], "shafts")}
