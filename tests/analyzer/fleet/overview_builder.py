"""A fleet of any size at the level of its tables: what the report of a fleet is made from."""

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa

from syncline_analyzer.fleet.captures import FailureEntry
from syncline_analyzer.fleet.database import Database
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.identity import short_hash
from syncline_analyzer.fleet.layout import UNDATED
from syncline_analyzer.fleet.recording import File
from syncline_analyzer.fleet.schemas import PARTITIONS, table_schema
from syncline_analyzer.fleet.storage import Storage

FIRST_DAY = datetime(2026, 3, 2, 6, tzinfo=UTC)
DAY_NS = 86_400 * 10**9
FIRST_NS = int(FIRST_DAY.timestamp()) * 10**9

Row = dict[str, Any]


class Tables(Database):
    """Tables in memory instead of those of a data set."""

    def __init__(self, rows: Mapping[str, Iterable[Row]]) -> None:
        super().__init__(Dataset(Storage("/nowhere")))
        self._rows = {name: _arrow(name, list(of)) for name, of in rows.items()}

    def _relations(
        self, connection: duckdb.DuckDBPyConnection, table: str
    ) -> list[duckdb.DuckDBPyRelation]:
        return [connection.from_arrow(self._rows.get(table, _empty(table)))]


@cache
def _schema(name: str) -> pa.Schema:
    return pa.schema([*((each, pa.string()) for each in PARTITIONS), *table_schema(name)])


def _empty(name: str) -> pa.Table:
    return _schema(name).empty_table()


def _arrow(name: str, rows: list[Row]) -> pa.Table:
    return pa.Table.from_pylist(rows, _schema(name))


def capture(machine: str, day: int | None = 0, **values: Any) -> Row:
    """The row of a capture of an hour; healthy, undated where `day` is None."""
    begun_ns = None if day is None else FIRST_NS + day * DAY_NS
    date = UNDATED if day is None else f"{FIRST_DAY + timedelta(days=day):%Y-%m-%d}"
    errors, warnings = values.get("errors", 0), values.get("warnings", 0)
    return {
        "machine": machine,
        "date": date,
        "capture_id": f"c{short_hash(machine, str(day), str(values))}",
        "start_utc_ns": begun_ns,
        "verdict": "error" if errors else "warning" if warnings else "healthy",
        "errors": 0,
        "warnings": 0,
        "infos": 0,
        "frames": 100_000,
        "duration_ns": 3600 * 10**9,
        "error_frames": 0,
        "unparsed_lines": 0,
        "blind_ns": 0,
        "damage": [],
        "buses": ["can0"],
        "report": True,
        **values,
    }


def finding(of: Row, id_: str = "nmt.node_lost", severity: str = "error", **values: Any) -> Row:
    """A finding on node 5 in a capture."""
    begun_ns = of["start_utc_ns"]
    return {
        **{name: of[name] for name in PARTITIONS},
        "id": id_,
        "severity": severity,
        "bus": "can0",
        "node": 5,
        "start_ns": begun_ns or 0,
        "start": begun_ns,
        "text": f"Node 5 (boom sensor) fell silent on {of['machine']}.",
        **values,
    }


def node(of: Row, number: int = 5, device: str | None = "jn2100") -> Row:
    """A node in a capture."""
    place = {name: of[name] for name in PARTITIONS}
    return {**place, "bus": "can0", "node": number, "device": device, "name": "boom sensor"}


def said(of: Row, index: int, value: str, sub: int = 0, number: int = 5) -> Row:
    """What node 5 answered when it was asked for an object."""
    place = {name: of[name] for name in PARTITIONS}
    return {
        **place,
        "bus": "can0",
        "node": number,
        "index": index,
        "sub": sub,
        "value": value,
        "source": "sdo-read",
    }


def failure(machine: str, name: str = "night.log", reason: str = "cut off", kind: str = "capture") -> FailureEntry:  # fmt: skip
    """A recording that could not be analyzed."""
    file = File(f"/data/{machine}/{name}", 10, 0, None)
    return FailureEntry(f"f{short_hash(name)}", machine, (file,), kind, reason, None, "1")


def big_fleet(machines: int, days: int) -> Tables:
    """A fleet in which every third capture is not healthy, with many kinds of findings."""
    rows: dict[str, list[Row]] = {"captures": [], "findings": [], "nodes": [], "objects": []}
    for machine in range(machines):
        name = f"press line {machine % 40} / machine-{machine:04}"
        for day in range(days):
            kind = (machine * 7 + day * 3) % 9
            found = {0: {"errors": 1 + day % 40}, 1: {"warnings": 2}, 2: {"warnings": 1}}
            of = capture(name, day, **found.get(kind, {}))
            rows["captures"].append(of)
            rows["nodes"].append(node(of))
            severity = "error" if of["errors"] else "warning"
            for n in range(of["errors"] + of["warnings"]):
                text = (
                    f"Node {n} (the sensor of the upper boom) fell silent at +{day}.123 s for"
                    f" {n * 17} ms although it had been OPERATIONAL, and came back by itself."
                )
                rows["findings"].append(
                    finding(of, f"family.kind_{n % 60}", severity, node=n % 30, text=text)
                )
        rows["objects"].append(said(of, 0x100A, f"V{machine % 60}"))
    return Tables(rows)


def pdo(of: Row, response_us: float, number: int = 5) -> Row:
    """TPDO1 of node 5, which answered a thousand SYNCs of a capture."""
    place = {name: of[name] for name in PARTITIONS}
    return {
        **place,
        "bus": "can0",
        "node": number,
        "cob_id": 0x180 + number,
        "pdo": "TPDO1",
        "response_us_median": response_us,
        "answered": 1000,
    }


def drifting_fleet(machines: int = 12, days: int = 28) -> Tables:
    """A fleet of which one machine answers 300 us later from the 15th day on."""
    rng = np.random.default_rng(7)
    captures = [capture(f"press {n}", day) for n in range(machines) for day in range(days)]
    late = {f"press 3|{day}" for day in range(14, days)}
    pdos = [
        pdo(of, 900 + rng.normal(0, 8) + 300 * (f"{of['machine']}|{n % days}" in late))
        for n, of in enumerate(captures)
    ]
    return Tables({"captures": captures, "nodes": [node(of) for of in captures], "pdos": pdos})
