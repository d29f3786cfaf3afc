"""Builders for the tests of fleets: small captures, runs in this process, what a data set holds."""

import json
import pickle
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.machine import MachineRule
from syncline_analyzer.fleet.plan import Order, plan
from syncline_analyzer.fleet.publish import remove_staging
from syncline_analyzer.fleet.run import tell
from syncline_analyzer.fleet.schemas import COSTS
from syncline_analyzer.fleet.source import find_captures
from syncline_analyzer.fleet.storage import open_storage
from syncline_analyzer.fleet.task import Outcome, Settings, analyze_task
from syncline_samples.fleet import HEALTHY, Planted, Template, write_capture
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata
from syncline_schemas.capture.writer import CaptureWriter

T0_NS = 1_772_431_200_000_000_000
"""2026-03-02 06:00 UTC."""


@cache
def template() -> Template:
    """A run of twelve seconds."""
    return Template(12.0)


def capture(folder: Path, machine: int = 0, day: int = 0, planted: Planted = HEALTHY) -> Path:
    """The small capture of a machine and day."""
    return write_capture(folder, template(), machine, day, planted)


def small_mcap(
    path: Path,
    *,
    recording_id: str = "",
    segment: int = 0,
    created_ns: int = T0_NS,
    host: str = "gateway",
    start_ns: int = T0_NS,
    frames: int = 20,
    machine: str = "",
) -> Path:
    """A capture of a few heartbeats of node 5."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [(start_ns + n * 100_000_000, 0, 0x705, 0, 1, b"\x05") for n in range(frames)]
    metadata = CaptureMetadata(
        "test",
        recording_id,
        segment=segment,
        host=host,
        created_ns=created_ns,
        extra={"machine": machine} if machine else {},
    )
    with path.open("wb") as stream:
        writer = CaptureWriter(stream, metadata, [BusInfo("can0", 0, 500_000)])
        writer.write_frames(FrameBatch.from_rows(rows))
        writer.finish()
    return path


def small_log(path: Path, *, frames: int = 20, start_ns: int = T0_NS) -> Path:
    """A candump log of a few heartbeats of node 5."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = (f"({start_ns // 10**9 + n}.000000) can0 705#05\n" for n in range(frames))
    path.write_text("".join(lines), encoding="ascii")
    return path


def order(
    source: Path | str | Sequence[str],
    out: Path | str,
    *,
    machine_from: str | None = None,
    settings: Settings | None = None,
    options: Mapping[str, Any] | None = None,
    retry_failed: bool = False,
) -> Order:
    """What a user would ask for."""
    storage = open_storage(str(out), options)
    sources = [str(source)] if isinstance(source, Path | str) else source
    return Order(
        find_captures(sources, storage, options),
        storage,
        MachineRule.of(machine_from),
        settings or Settings(),
        options or {},
        retry_failed,
    )


def analyze(source: Path | str | Sequence[str], out: Path | str, **wanted: Any) -> list[Outcome]:
    """A whole run in this process; what came of each task."""
    asked = order(source, out, **wanted)
    planned = plan(asked)
    outcomes = []
    for task in planned.tasks:
        # As it comes to a worker.
        outcome = analyze_task(pickle.loads(pickle.dumps(task)))
        tell(task, outcome, planned)
        outcomes.append(outcome)
    remove_staging(asked.out, asked.run)
    return outcomes


def statuses(outcomes: Sequence[Outcome]) -> list[str]:
    """How the tasks ended, sorted."""
    return sorted(outcome.status for outcome in outcomes)


def content(out: Path | str, options: Mapping[str, Any] | None = None) -> dict[str, str]:
    """What every file of a data set holds, by path; what a run cost is left out."""
    storage = open_storage(str(out), options)
    return {relative: _text(storage.read(relative) or b"") for relative in storage.files()}


def _text(data: bytes) -> str:
    from io import BytesIO

    table = pq.read_table(BytesIO(data))
    kept = table.drop_columns([name for name in COSTS if name in table.column_names])
    return json.dumps([str(kept.schema), kept.to_pylist()], default=str)


def standing(out: Path | str) -> list[tuple[str, str, str]]:
    """Machine, date and verdict of the captures that stand."""
    entries = Dataset.open(str(out)).captures
    return [(e.partition.machine, e.partition.date, e.values["verdict"]) for e in entries]
