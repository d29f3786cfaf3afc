"""The JSON object of `--format json`: the rows of every table under names that do not change.

Beyond the keys of the interface every row also carries what its dataclass in `results.py` holds
(`proof`, `evidence`, `details`, `missed_seq`, `name` ...). Figures that are not known are null.
"""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np

from syncline_analyzer.results import Analysis, PdoRow, Quantiles

SCHEMA = "syncline.analysis/1"

TABLES = (
    "nodes",
    "nmt_commands",
    "nmt_states",
    "sync",
    "pdos",
    "emcy",
    "errors",
    "sdo",
    "traces",
    "trace_events",
    "tilts",
    "shafts",
    "followers",
    "bus_load",
    "findings",
    "emcy_context",
    "error_history",
    "object_changes",
    "device_health",
    "bus_states",
    "bus_errors",
    "lss",
    "time_stamps",
    "bus_shares",
    "node_shares",
    "error_control_periods",
    "worst",
    "waits",
    "delays",
    "lateness",
    "pdo_pauses",
    "unsent_pdos",
    "sync_doubles",
    "overloads",
    "clock_steps",
    "bus_silences",
    "doubled",
    "pdo_lengths",
)
"""Lists of the object, in the order of the interface."""

_STEPS = ("resolution_ns", "resolution_us")
_AS_IT_IS = frozenset({int, str, bool, type(None)})
_ENCODER = json.JSONEncoder(allow_nan=False)


def to_object(analysis: Analysis, tables: Sequence[str] = TABLES) -> dict[str, Any]:
    """The analysis as one object of plain Python values, ready for any JSON writer."""
    rows = {table: list(_rows(analysis, getattr(analysis, table))) for table in tables}
    return {"schema": SCHEMA, "capture": _capture(analysis), **rows}


def to_json(analysis: Analysis) -> str:
    """The analysis as one line of strict JSON: no NaN, and ASCII, whatever the terminal takes."""
    return "".join(json_parts(analysis))


def json_parts(analysis: Analysis) -> Iterator[str]:
    """What `to_json` tells, row by row: half a million rows are a gigabyte when held at once."""
    capture = _ENCODER.encode(_capture(analysis))
    yield f'{{"schema": {_ENCODER.encode(SCHEMA)}, "capture": {capture}'
    for table in TABLES:
        yield f', "{table}": ['
        before = ""
        for row in _rows(analysis, getattr(analysis, table)):
            yield before + _ENCODER.encode(row)
            before = ", "
        yield "]"
    yield "}"


def _capture(analysis: Analysis) -> dict[str, Any]:
    """The capture as a whole; its stretches only where the clock was set back."""
    (capture,) = _rows(analysis, [analysis.capture])
    capture["stretches"] = [each._asdict() for each in analysis.capture.stretches]
    if not capture["stretches"]:
        del capture["stretches"]
    return capture


def _rows(analysis: Analysis, rows: Iterable[Any]) -> Iterator[dict[str, Any]]:
    """Rows as plain values."""
    untimed = analysis.capture.time_base == "none"
    for row in map(plain, rows):
        if untimed:
            # Stamps that are none have no step.
            row.update((key, None) for key in _STEPS if key in row)
        yield row


def findings_json(analysis: Analysis) -> str:
    """What `findings.json` holds: schema, capture and findings, for programs that only alarm."""
    return json.dumps(to_object(analysis, ("findings",)), allow_nan=False, indent=2) + "\n"


def plain(value: Any) -> Any:
    """Rows and values as what any JSON writer takes: dicts, lists, text, numbers and None."""
    if type(value) in _AS_IT_IS:
        return value
    match value:
        case Quantiles():
            return _quantiles(value)
        case PdoRow():
            return _pdo(value)
        case bytes():
            return value.hex(" ").upper()
        case dict():
            return {str(key): plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
        case np.generic():
            return plain(value.item())
        case float():
            return value if math.isfinite(value) else None
    return _record(value) if is_dataclass(value) else value


def _record(row: Any) -> dict[str, Any]:
    return {
        name: value if type(value := getattr(row, name)) in _AS_IT_IS else plain(value)
        for name in _names(row.__class__)
    }


@cache
def _names(row: type[Any]) -> tuple[str, ...]:
    """Names of the fields of a dataclass."""
    return tuple(field.name for field in fields(row))


def _quantiles(quantiles: Quantiles) -> dict[str, float | None]:
    named = {f.name: plain(getattr(quantiles, f.name)) for f in fields(quantiles)}
    if quantiles.std is None:
        del named["std"]
    return named


def _pdo(row: PdoRow) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for f in fields(row):
        if f.name == "device_us_low":
            bounds = {"low": plain(row.device_us_low), "high": plain(row.device_us_high)}
            named["device_us"] = bounds if any(bounds.values()) else None
        elif f.name == "response_us" and row.response_us is not None:
            named[f.name] = {**_quantiles(row.response_us), "std": plain(row.response_us.std)}
        elif f.name != "device_us_high":
            named[f.name] = plain(getattr(row, f.name))
    return named
