"""`--format json` against the interface: every key, with its type."""

import json
import math
from collections.abc import Iterator
from typing import Any

import pytest

from syncline_analyzer.results import Quantiles
from syncline_analyzer.views.json_view import findings_json, json_parts, to_json, to_object
from tests.analyzer.analysis_builder import (
    analysis,
    bad_day,
    capture_row,
    finding,
    node_row,
    pdo_row,
    sdo_row,
    services,
    untimed,
)

INT, TEXT, NUMBER = int, str, (int, float)
MAYBE_INT, MAYBE_TEXT, MAYBE_NUMBER = (int, type(None)), (str, type(None)), (int, float, type(None))
QUANTILES = {"min": NUMBER, "median": NUMBER, "p99": NUMBER, "max": NUMBER}

INTERFACE: dict[str, dict[str, Any]] = {
    "nodes": {
        "bus": TEXT, "node": INT, "name": MAYBE_TEXT, "device": MAYBE_TEXT, "boot_ups": INT,
        "heartbeats": INT, "heartbeat_period_ms": MAYBE_NUMBER, "guard_requests": INT,
        "guard_answers": INT, "toggle_errors": INT, "emcy": INT, "sdo_transfers": INT,
        "sdo_aborts": INT, "sdo_unanswered": INT, "pdo_frames": INT, "state_share": dict,
        "final_state": TEXT,
    },
    "nmt_commands": {
        "bus": TEXT, "seq": INT, "t_ns": INT, "command": TEXT, "node": INT,
        "confirmed_ms": MAYBE_NUMBER,
    },
    "nmt_states": {
        "bus": TEXT, "node": INT, "state": TEXT, "start_ns": INT, "end_ns": INT, "cause": TEXT,
        "certainty": TEXT, "evidence": MAYBE_INT,
    },
    "sync": {
        "bus": TEXT, "cob_id": INT, "count": INT, "period_us": QUANTILES, "missing": INT,
        "counter_jumps": INT,
    },
    "pdos": {
        "bus": TEXT, "cob_id": INT, "node": MAYBE_INT, "pdo": MAYBE_TEXT, "frames": INT,
        "transmission_type": MAYBE_INT, "type_source": TEXT, "period_us": QUANTILES,
        "response_us": QUANTILES | {"std": NUMBER},
        "device_us": {"low": QUANTILES, "high": QUANTILES}, "missed": INT, "extra": INT,
        "late": INT,
    },
    "emcy": {
        "bus": TEXT, "node": INT, "seq": INT, "t_ns": INT, "code": MAYBE_INT, "meaning": TEXT,
        "error_register": MAYBE_INT, "registers": list, "manufacturer_hex": TEXT,
        "transition": TEXT,
    },
    "errors": {
        "bus": TEXT, "node": INT, "code": INT, "meaning": TEXT, "raised_ns": INT,
        "cleared_ns": MAYBE_INT, "status": TEXT, "count": INT,
    },
    "sdo": {
        "bus": TEXT, "node": INT, "seq": INT, "start_ns": INT, "end_ns": INT, "index": MAYBE_INT,
        "sub": MAYBE_INT, "direction": TEXT, "kind": TEXT, "size": MAYBE_INT,
        "value": (int, float, str, type(None)), "result": TEXT, "abort_code": MAYBE_INT,
        "answer_us": MAYBE_NUMBER,
    },
    "traces": {
        "bus": TEXT, "node": INT, "object": INT, "name": TEXT, "unit": TEXT, "samples": INT,
        "min": MAYBE_NUMBER, "max": MAYBE_NUMBER, "cuts": INT, "flags": dict,
    },
    "bus_load": {
        "bus": TEXT, "bitrate": MAYBE_INT, "mean_percent": MAYBE_NUMBER,
        "peak_percent": MAYBE_NUMBER, "frames_per_s": MAYBE_NUMBER,
    },
    "findings": {
        "id": TEXT, "severity": TEXT, "bus": MAYBE_TEXT, "node": MAYBE_INT, "start_ns": INT,
        "end_ns": INT, "text": TEXT, "cause": TEXT, "check_next": TEXT, "evidence": list,
    },
}  # fmt: skip

CAPTURE = {
    "files": list, "frames": INT, "data_frames": INT, "remote_frames": INT, "error_frames": INT,
    "extended_frames": INT, "unparsed_lines": INT, "start_utc_ns": MAYBE_INT, "duration_ns": INT,
    "buses": list, "gaps": list,
}  # fmt: skip


def assert_shape(row: dict[str, Any], shape: dict[str, Any], where: str) -> None:
    for key, kind in shape.items():
        assert key in row, f"{where}.{key} is missing"
        if isinstance(kind, dict):
            if row[key] is not None:
                assert_shape(row[key], kind, f"{where}.{key}")
        else:
            assert isinstance(row[key], kind), f"{where}.{key} is {row[key]!r}"


def test_every_key_of_the_interface_is_there_with_its_type() -> None:
    told = json.loads(to_json(bad_day()))
    assert told["schema"] == "syncline.analysis/1"
    assert_shape(told["capture"], CAPTURE, "capture")
    gap = {"start_ns": INT, "end_ns": INT, "reason": TEXT, "lost_frames": MAYBE_INT}
    assert_shape(told["capture"]["gaps"][0], gap, "gaps")
    for table, shape in INTERFACE.items():
        assert told[table], f"the example has no {table}"
        for row in told[table]:
            assert_shape(row, shape, table)


@pytest.mark.parametrize("empty", [analysis(), untimed()])
def test_every_table_is_a_list_also_when_it_has_no_rows(empty: Any) -> None:
    told = json.loads(to_json(empty))
    assert [key for key in INTERFACE if not isinstance(told[key], list)] == []


def test_figures_are_integers_and_unknown_ones_null() -> None:
    told = json.loads(to_json(bad_day()))
    by_id = {row["cob_id"]: row for row in told["pdos"]}
    assert by_id[0x18A]["device_us"]["low"]["min"] == 120.0
    assert by_id[0x28A]["device_us"] is None
    assert by_id[0x28A]["response_us"] is None
    assert "std" not in by_id[0x18A]["period_us"]
    assert told["sync"][0]["cob_id"] == 0x80


def test_nan_and_odd_names_make_strict_ascii_json() -> None:
    odd = analysis(
        capture=capture_row(files=["caf\udce9.log"]),
        nodes=[node_row(name="Dreh\u00adgeber \u2028 </script>", heartbeat_period_ms=math.nan)],
        pdos=[pdo_row(period_us=Quantiles(math.nan, 1.0, math.inf, 2.0))],
        sdo=[sdo_row(value=math.nan, data=b"\x00\xff")],
        emcy=bad_day().emcy,
    )
    text = to_json(odd)
    assert text.isascii()
    told = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert told["nodes"][0]["heartbeat_period_ms"] is None
    assert told["pdos"][0]["period_us"] == {"min": None, "median": 1.0, "p99": None, "max": 2.0}
    assert told["sdo"][0]["data"] == "00 FF"


def test_stamps_that_are_none_have_no_step() -> None:
    log = untimed()
    log.pdos.append(pdo_row())
    told = json.loads(to_json(log))
    assert told["capture"]["resolution_ns"] is None
    assert told["pdos"][0]["resolution_us"] is None
    assert json.loads(to_json(bad_day()))["capture"]["resolution_ns"] == 1


def test_findings_file_holds_capture_and_findings_only() -> None:
    told = json.loads(findings_json(analysis(findings=[finding()])))
    assert set(told) == {"schema", "capture", "findings"}
    assert told["findings"][0]["id"] == "nmt.node_lost"


def test_services_and_context_are_rows_of_their_own() -> None:
    told = json.loads(to_json(services()))
    assert [row["state"] for row in told["bus_states"]] == ["active", "passive", "active"]
    assert told["bus_errors"][0]["kind"] == "stuff error"
    assert told["lss"][0]["command"] == "switch"
    assert [row["offset_ns"] for row in told["time_stamps"]] == [500_000_000, 1_000_000_000]
    assert told["emcy_context"][0]["values"]["6010h:00"]["before"] == 5.25
    assert [row["seen"] for row in told["error_history"]] == ["seen", "older", "register"]
    assert told["trace_events"] == []


@pytest.mark.parametrize("told", [bad_day(), services(), analysis(), untimed()])
def test_the_line_is_what_the_standard_library_writes(told: Any) -> None:
    assert to_json(told) == json.dumps(to_object(told), allow_nan=False)


def test_rows_are_made_one_after_the_other() -> None:
    made = []

    def rows() -> Iterator[Any]:
        for number in range(3):
            made.append(number)
            yield finding(text=f"finding {number}")

    for part in json_parts(analysis(findings=rows())):
        if "finding 0" in part:
            assert made == [0]
    assert made == [0, 1, 2]
