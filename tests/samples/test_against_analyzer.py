"""The analyzer against the script's truth: two programs written from the same sheets."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_analyzer import open_session
from syncline_analyzer.session import Session
from syncline_samples.comparison import compare
from syncline_samples.generate import samples
from syncline_samples.machine import Run
from syncline_samples.truth import ExpectedFinding

SAMPLES = Path(__file__).parents[2] / "samples"
NAMES = {"healthy_line": "mcap", "bad_day": "mcap", "jittery_sync": "log"}
BIT_US = {"healthy_line": 2.0, "bad_day": 2.0, "jittery_sync": 4.0}


class Sample:
    """One sample: the analysis of its file, its expected results, and the run behind it."""

    def __init__(self, name: str) -> None:
        self.name = name
        path = SAMPLES / f"{name}.{NAMES[name]}"
        self.session: Session = open_session(path, description=SAMPLES / f"{name}.toml")
        text = (SAMPLES / f"{name}.expected.json").read_text(encoding="utf-8")
        self.expected: dict[str, Any] = json.loads(text)
        self.run: Run = samples()[name][0].run()


@pytest.fixture(scope="module", params=list(NAMES))
def sample(request: pytest.FixtureRequest) -> Sample:
    return Sample(request.param)


def test_findings_are_those_of_the_script(sample: Sample) -> None:
    entries = [
        ExpectedFinding(**{**row, "or_as": tuple(row["or_as"])})
        for row in sample.expected["findings"]
    ]
    outcome = compare(entries, sample.session.analysis.findings)
    assert outcome.missing == []
    assert outcome.unexpected == []


def test_capture_counts(sample: Sample) -> None:
    row, wanted = sample.session.analysis.capture, sample.expected["capture"]
    assert row.frames == wanted["frames"]
    assert row.remote_frames == wanted["remote_frames"]
    assert row.error_frames == wanted["error_frames"]
    assert [gap.lost_frames for gap in row.gaps] == [gap["lost_frames"] for gap in wanted["gaps"]]


COUNTS = (
    "boot_ups",
    "guard_requests",
    "guard_answers",
    "emcy",
    "sdo_transfers",
    "sdo_aborts",
    "sdo_unanswered",
    "pdo_frames",
)


def test_node_counts(sample: Sample) -> None:
    rows = sample.session.analysis.nodes
    found = {row.node: {key: getattr(row, key) for key in COUNTS} for row in rows}
    wanted = {row["node"]: {key: row[key] for key in COUNTS} for row in sample.expected["nodes"]}
    assert found == wanted


def test_heartbeat_counts(sample: Sample) -> None:
    """Whether a heartbeat that carries no state is counted as one is left open here."""
    found = {row.node: row.heartbeats for row in sample.session.analysis.nodes}
    for row in sample.expected["nodes"]:
        assert found[row["node"]] in (
            row["heartbeats"],
            row["heartbeats"] - row["empty_heartbeats"],
        )


def test_emcy_messages(sample: Sample) -> None:
    found = [
        (row.node, row.code, row.error_register, row.t_ns) for row in sample.session.analysis.emcy
    ]
    wanted = [
        (row["node"], row["code"], row["register"], row["t_ns"] // 1000 * 1000)
        for row in sample.expected["emcy"]
    ]
    assert found == wanted


def test_sdo_transfers_carry_the_same_bytes(sample: Sample) -> None:
    found = Counter(
        (row.node, row.index, row.sub, row.direction, row.kind, row.result, row.abort_code)
        for row in sample.session.analysis.sdo
    )
    wanted = Counter(
        (row.node, row.index, row.sub, row.direction, row.kind, row.result, row.abort_code)
        for row in sample.run.truth.sdo
    )
    assert found == wanted
    uploads = {
        (row.node, row.index, row.sub): row.data
        for row in sample.run.truth.sdo
        if row.result == "ok" and row.direction == "upload"
    }
    for row in sample.session.analysis.sdo:
        if row.result == "ok" and row.direction == "upload" and row.index is not None:
            assert row.data == uploads[row.node, row.index, row.sub or 0]


def test_states_are_those_of_the_nodes(sample: Sample) -> None:
    """In the middle of each long interval, unless the bus did not tell."""
    for truth in sample.run.truth.states:
        if truth.state in ("OFF", "INITIALISING") or truth.end_ns - truth.start_ns < 2e9:
            continue
        middle = (truth.start_ns + truth.end_ns) // 2
        told = [
            row.state
            for row in sample.session.analysis.nmt_states
            if row.node == truth.node and row.start_ns <= middle < row.end_ns
        ]
        assert told in ([truth.state], ["UNKNOWN"]), truth


def test_every_position_is_the_true_one(sample: Sample) -> None:
    counts = {(row.node, row.end_ns // 1000 * 1000): row.values[0] for row in sample.run.truth.pdos}
    checked = 0
    for trace in sample.session.analysis.trace_data:
        if trace.object >> 8 != 0x6004:
            continue
        for t_ns, raw in zip(trace.t_ns.tolist(), trace.raw.tolist(), strict=True):
            if (trace.node, t_ns) in counts:
                assert raw == counts[trace.node, t_ns]
                checked += 1
    assert checked > 500


def test_every_tilt_is_the_true_one(sample: Sample) -> None:
    """6010h and 6110h in tenths of a degree; the truth is in millidegrees."""
    angles = {
        (row.cob_id, row.end_ns // 1000 * 1000): row.values[0] / 1000
        for row in sample.run.truth.pdos
    }
    checked = 0
    for trace in sample.session.analysis.trace_data:
        cob_id = {0x6010: 0x18A, 0x6110: 0x28A}.get(trace.object >> 8)
        for t_ns, value in zip(trace.t_ns.tolist(), trace.value.tolist(), strict=True):
            if cob_id is not None and (cob_id, t_ns) in angles:
                assert value == pytest.approx(angles[cob_id, t_ns], abs=0.1)
                checked += 1
    assert checked > 200


def test_the_true_device_time_lies_between_the_bounds(sample: Sample) -> None:
    """The bounds count whole frames with their intermission: three bits and a step of the stamps."""
    slack_us = 3 * BIT_US[sample.name] + 2.1
    true_us = {
        (row.cob_id, row.end_ns // 1000 * 1000): (row.queued_ns - row.sync_ns) / 1000
        for row in sample.run.truth.pdos
        if row.sync_ns is not None
    }
    checked = 0
    for responses in sample.session.analysis.responses:
        keys = [(responses.cob_id, int(t_ns)) for t_ns in responses.t_ns]
        rows = [row for row, key in enumerate(keys) if key in true_us]
        device = np.array([true_us[keys[row]] for row in rows])
        assert (responses.device_low_us[rows] <= device + slack_us).all()
        assert (device - slack_us <= responses.device_high_us[rows]).all()
        checked += len(rows)
    assert checked > 1000


def test_missed_answers_are_counted(sample: Sample) -> None:
    wanted = Counter(row.cob_id for row in sample.run.truth.missed)
    for row in sample.session.analysis.pdos:
        if wanted[row.cob_id]:
            assert row.missed == wanted[row.cob_id]


def test_bus_load_is_the_true_one(sample: Sample) -> None:
    if sample.name == "bad_day":
        pytest.skip("the recorder was blind for a while, and error frames have no length")
    load = sample.session.analysis.bus_load[0].mean_percent
    assert load == pytest.approx(sample.expected["bus_load_percent"], rel=0.02)
