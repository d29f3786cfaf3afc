"""The JSON object of `--format json`: the rows of every table under names that do not change.

Beyond the keys of the interface every row also carries what its dataclass in `results.py` holds
(`proof`, `evidence`, `details`, `missed_seq`, `name` ...). Figures that are not known are null.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
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


def to_object(analysis: Analysis, tables: Sequence[str] = TABLES) -> dict[str, Any]:
    """The analysis as one object of plain Python values, ready for any JSON writer."""
    rows = {table: [plain(row) for row in getattr(analysis, table)] for table in tables}
    capture = plain(analysis.capture)
    if analysis.capture.time_base == "none":
        # Stamps that are none have no step.
        for row in (capture, *(row for table in rows.values() for row in table)):
            row.update((key, None) for key in _STEPS if key in row)
    return {"schema": SCHEMA, "capture": capture, **rows}


def to_json(analysis: Analysis) -> str:
    """The analysis as one line of strict JSON: no NaN, and ASCII, whatever the terminal takes."""
    return json.dumps(to_object(analysis), allow_nan=False)


def findings_json(analysis: Analysis) -> str:
    """What `findings.json` holds: schema, capture and findings, for programs that only alarm."""
    return json.dumps(to_object(analysis, ("findings",)), allow_nan=False, indent=2) + "\n"


def plain(value: Any) -> Any:
    """Rows and values as what any JSON writer takes: dicts, lists, text, numbers and None."""
    if value is None or type(value) in (int, str, bool):
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
    if is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    return value


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
