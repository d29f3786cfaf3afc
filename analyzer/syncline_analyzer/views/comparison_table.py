"""A comparison as pandas frames and as JSON."""

import json
import typing
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

import pandas as pd

from syncline_analyzer.comparison.rows import Comparison, ComparisonRow, UnseenRow
from syncline_analyzer.views.json_view import plain

SCHEMA = "syncline.comparison/1"

_TYPES = {str: "string", int: "Int64", float: "Float64"}


def rows_frame(rows: Sequence[ComparisonRow]) -> pd.DataFrame:
    """One row per difference, one column per field; evidence stays lists."""
    return _frame(ComparisonRow, rows)


def unseen_frame(rows: Sequence[UnseenRow]) -> pd.DataFrame:
    """One row per thing that one of both could not have shown."""
    return _frame(UnseenRow, rows)


def comparison_json(comparison: Comparison) -> str:
    """The comparison as one line of strict JSON: facts of both captures, differences, not seen."""
    return json.dumps(comparison_object(comparison), allow_nan=False)


def comparison_object(comparison: Comparison) -> dict[str, Any]:
    """The same as plain Python values."""
    sides = (
        ("golden", comparison.golden, comparison.golden_heard_s),
        ("capture", comparison.capture, comparison.capture_heard_s),
    )
    return {
        "schema": SCHEMA,
        **{name: {**plain(facts), "heard_s": heard_s} for name, facts, heard_s in sides},
        "differences": [plain(asdict(row)) for row in comparison.rows],
        "not_seen": [plain(asdict(row)) for row in comparison.unseen],
    }


def _frame(kind: type, rows: Sequence[Any]) -> pd.DataFrame:
    hints = typing.get_type_hints(kind)
    columns = {
        f.name: pd.Series([getattr(row, f.name) for row in rows], dtype=_dtype(hints[f.name]))
        for f in fields(kind)
    }
    return pd.DataFrame(columns, index=pd.RangeIndex(len(rows)))


def _dtype(hint: Any) -> str:
    """Text, whole numbers and figures that may be missing; lists are objects."""
    if typing.get_origin(hint) is list:
        return "object"
    named = {hint, *typing.get_args(hint)} & _TYPES.keys()
    return _TYPES[named.pop()] if named else "string"
