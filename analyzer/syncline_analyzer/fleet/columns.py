"""Rows of the tables as Arrow columns of types that never depend on the values.

The columns and their values are those of `syncline_analyzer.views.tables`; written straight from
the rows, because forty small pandas frames cost four times what the analysis of a capture costs.
"""

import json
import types
import typing
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from operator import attrgetter
from typing import Any

import pyarrow as pa

from syncline_analyzer.results import TRACE_FLAGS, Jitter, Quantiles
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.records import dataclass

STAMP = pa.timestamp("ns", "UTC")
_DURATIONS = ("step_ns", "offset_ns")
_MIXED = ("value", "old", "new")
_STORIES = ("chain", "ahead", "blockers")
_LISTS = {list[int]: pa.list_(pa.int64()), list[str]: pa.list_(pa.string())}

Values = Sequence[Any]


@dataclass(frozen=True, slots=True)
class Column:
    """One column: made from the values of one field.

    Attributes:
        stamped: a moment, made from ns since 1970; null where the capture has no date.
    """

    field: str
    name: str
    type: pa.DataType
    convert: Callable[[Values], Values]
    stamped: bool = False

    def array(self, values: Values, *, dated: bool) -> pa.Array:
        """The column of these values of its field."""
        if self.stamped and not dated:
            return pa.nulls(len(values), self.type)
        converted = self.convert(values)
        if self.stamped:
            return pa.array(converted, pa.int64()).cast(self.type)
        return pa.array(converted, self.type, from_pandas=True)


@cache
def columns_of(kind: type) -> tuple[Column, ...]:
    """All columns of a row class, in order."""
    hints = typing.get_type_hints(kind)
    columns = (column for f in fields(kind) for column in _columns(f.name, hints[f.name]))
    # Beside `parted_ns` the moment cannot be `parted` where that is a count.
    return tuple(
        replace(each, name=f"{each.name}_at") if each.stamped and each.name in hints else each
        for each in columns
    )


def schema_of(kind: type) -> pa.Schema:
    """The schema of a table of this row class."""
    return pa.schema([(column.name, column.type) for column in columns_of(kind)])


def arrow_table(rows: Sequence[Any], kind: type, *, dated: bool) -> pa.Table:
    """Rows of one class as a table, with all columns also when there are no rows.

    Args:
        rows: instances of `kind`.
        dated: False when stamps are not UTC: the moments are then null.
    """
    names = [f.name for f in fields(kind)]
    listed = zip(*map(attrgetter(*names), rows), strict=True) if rows else ((),) * len(names)
    values = dict(zip(names, listed, strict=True))
    arrays = [column.array(values[column.field], dated=dated) for column in columns_of(kind)]
    return pa.Table.from_arrays(arrays, schema=schema_of(kind))


def _columns(name: str, hint: Any) -> Iterator[Column]:
    plain = _without_none(hint)
    if name in _MIXED and plain is None:
        yield Column(name, name, pa.string(), _texts)
        yield Column(name, f"{name}_number", pa.float64(), _numbers)
    elif plain in (Quantiles, Jitter):
        for part in (f.name for f in fields(plain)):
            yield Column(name, f"{name}_{part}", pa.float64(), _part(part))
    elif name in _STORIES:
        yield Column(name, name, pa.string(), _jsons)
    elif name == "state_share":
        for state in NmtState:
            column = "share_" + state.lower().replace("-", "_")
            yield Column(name, column, pa.float64(), _entry(state, 0.0))
    elif name == "flags":
        for flag in TRACE_FLAGS:
            yield Column(name, f"flag_{flag}", pa.int64(), _entry(flag, 0))
    else:
        yield _plain(name, plain)
        if name.endswith("_ns") and name not in _DURATIONS:
            yield Column(name, name.removesuffix("_ns"), STAMP, _same, stamped=True)


def _plain(name: str, plain: Any) -> Column:
    if plain in _LISTS:
        return Column(name, name, _LISTS[plain], _same)
    if typing.get_origin(plain) is dict:
        return Column(name, name, pa.string(), _jsons)
    if plain is bytes:
        return Column(name, name, pa.string(), _hexes)
    for kind, type_ in ((bool, pa.bool_()), (int, pa.int64()), (float, pa.float64())):
        if plain is kind:
            return Column(name, name, type_, _same)
    return Column(name, name, pa.string(), _texts)


def _without_none(hint: Any) -> Any:
    """The type without None; None itself when several types remain."""
    if typing.get_origin(hint) not in (types.UnionType, typing.Union):
        return hint
    left = [member for member in typing.get_args(hint) if member is not type(None)]
    return left[0] if len(left) == 1 else None


def _same(values: Values) -> Values:
    return values


def _texts(values: Values) -> Values:
    return [None if value is None else str(value) for value in values]


def _numbers(values: Values) -> Values:
    return [float(value) if isinstance(value, int | float) else None for value in values]


def _hexes(values: Values) -> Values:
    return [None if value is None else _hex(value) for value in values]


def _jsons(values: Values) -> Values:
    return [_encoded(value) for value in values]


def _part(name: str) -> Callable[[Values], Values]:
    return lambda values: [value and getattr(value, name) for value in values]


def _entry(key: str, missing: float) -> Callable[[Values], Values]:
    return lambda values: [value.get(key, missing) for value in values]


def _hex(value: Any) -> str:
    return value.hex(" ").upper() if isinstance(value, bytes) else str(value)


def _object(value: Any) -> Any:
    """What JSON writes of what it does not know: rows, bytes, words."""
    if is_dataclass(value):
        return {f.name: getattr(value, f.name) for f in fields(value)}
    return _hex(value)


_encoded = json.JSONEncoder(default=_object, sort_keys=True).encode
