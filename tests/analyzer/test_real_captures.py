"""The control folds on real captures, against facts that other code found in them.

The facts are in `captures/facts` beside the repository; nothing of them is copied. Differences
that are none of ours are named one by one in `_EXPLAINED`.
"""

import json
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.analyzer.control_runs import Run, run_capture

CAPTURES = Path(__file__).parents[3] / "shared" / "captures"
FACTS = CAPTURES / "facts"
NAMES = sorted(path.name.removesuffix(".json") for path in FACTS.glob("*.json"))
STATUS = {
    "ok": "ok",
    "aborted_by_server": "abort",
    "aborted_by_client": "abort",
    "no_response": "no answer",
}

pytestmark = pytest.mark.skipif(not NAMES, reason="the captures are not here")


@cache
def facts_of(name: str) -> dict[str, Any]:
    text = (FACTS / f"{name}.json").read_text(encoding="utf-8")
    facts: dict[str, Any] = json.loads(text)["facts"]
    return facts


@cache
def analyzed(name: str) -> Run:
    path = CAPTURES / name
    return run_capture(path if path.exists() else CAPTURES / f"{name}.gz")


each_capture = pytest.mark.parametrize("name", NAMES)


@each_capture
def test_boot_ups(name: str) -> None:
    expected = {int(node): row["count"] for node, row in facts_of(name)["bootups"].items()}
    found = {node: row.boot_ups for node, row in analyzed(name).nodes.items() if row.boot_ups}
    assert found == expected


@each_capture
def test_nmt_commands(name: str) -> None:
    words = {1: "start", 2: "stop", 128: "enter pre-operational", 129: "reset node"}
    words[130] = "reset communication"
    expected = [
        (row["frame"] - 1, words[row["cs"]], row["node"]) for row in facts_of(name)["nmt_commands"]
    ]
    found = [(c.seq, c.command, c.node) for c in analyzed(name).analysis.nmt_commands]
    assert len(found) == facts_of(name)["nmt_commands_count"]
    assert found[: len(expected)] == expected
    assert analyzed(name).tables.nmt.malformed == len(facts_of(name)["nmt_malformed"])


@each_capture
def test_heartbeats_without_boot_ups_and_guard_answers(name: str) -> None:
    facts = facts_of(name)
    expected = {}
    for node, row in facts["heartbeat"].items():
        boot_ups = facts["bootups"].get(node, {"count": 0})["count"]
        if row["frames_incl_bootup"] > boot_ups:
            expected[int(node)] = row["frames_incl_bootup"] - boot_ups
    found = {node: row.heartbeats for node, row in analyzed(name).nodes.items() if row.heartbeats}
    assert found == expected


@each_capture
def test_heartbeat_period(name: str) -> None:
    for node, row in facts_of(name)["heartbeat"].items():
        if row["interval_all"] and row["frames_incl_bootup"] > 10:
            period = analyzed(name).nodes[int(node)].heartbeat_period_ms
            assert period == pytest.approx(row["interval_all"]["median_ms"], rel=2e-3)


@each_capture
def test_guarding(name: str) -> None:
    expected = {
        int(node): (row["requests"], row["responses"], row["toggle_errors"])
        for node, row in facts_of(name)["node_guarding"].items()
        if row["responses"]
    }
    found = {
        node: (row.guard_requests, row.guard_answers, row.toggle_errors)
        for node, row in analyzed(name).nodes.items()
        if row.guard_requests
    }
    assert found == expected


@each_capture
def test_emcy(name: str) -> None:
    facts = facts_of(name)
    rows = [row for row in analyzed(name).analysis.emcy if row.transition != "reset"]
    found = [
        (row.seq, row.node, row.code, row.error_register, row.manufacturer_hex)
        for row in rows
        if row.transition != "malformed"
    ]
    expected = [
        (e["frame"] - 1, e["node"], int(e["code"], 16), int(e["register"], 16), e["msef"])
        for e in facts["emcy"]
    ]
    assert found == expected
    malformed = [(row.seq, row.node) for row in rows if row.transition == "malformed"]
    assert malformed == [(e["frame"] - 1, e["node"]) for e in facts["emcy_malformed"]]


@each_capture
def test_sdo_by_status(name: str) -> None:
    expected: Counter[str] = Counter()
    for status, count in facts_of(name)["sdo_by_status"].items():
        expected[STATUS[status]] += count
    assert Counter(row.result for row in analyzed(name).analysis.sdo) == expected


@each_capture
def test_sdo_transfers(name: str) -> None:
    """Index, sub, direction, bytes and place of each transfer that the facts list."""
    rows = {row.seq: row for row in analyzed(name).analysis.sdo}
    for fact in facts_of(name).get("sdo_transactions", []):
        row = rows[fact["frame"] - 1]
        assert (row.node, row.index, row.sub) == (fact["node"], int(fact["index"], 16), fact["sub"])
        assert (row.direction, row.result) == (fact["dir"], STATUS[fact["status"]])
        if fact["kind"] != "?":
            assert row.kind == fact["kind"]
        if fact["status"] == "ok":
            assert row.data.hex().upper() == fact["value"]
            assert row.size == fact["size"]


@each_capture
def test_sdo_aborts(name: str) -> None:
    expected = [
        (f["node"], f["by"], int(f["index"], 16), f["sub"], int(f["code"], 16))
        for f in facts_of(name)["sdo_aborts"]
    ]
    run = analyzed(name)
    found = [
        (row.node, row.abort_by, row.index, row.sub, row.abort_code)
        for row in run.analysis.sdo
        if row.result == "abort"
    ]
    assert found == expected


@each_capture
def test_nodes_are_those_that_something_proves(name: str) -> None:
    facts = facts_of(name)
    proven = {int(node) for node in facts["nodes_proven_alive"]}
    found = {row.node: row.proof for row in analyzed(name).analysis.nodes}
    assert proven <= set(found)
    only_by_pdo = set(found) - proven
    assert all(found[node] in (["pdo (guess)"], ["pdo"]) for node in only_by_pdo)
    assert not only_by_pdo & set(facts["nodes_addressed_by_sdo_only"])


@pytest.mark.parametrize("name", [n for n in NAMES if n.startswith("neg_")])
def test_no_node_on_a_bus_that_is_not_canopen(name: str) -> None:
    analysis = analyzed(name).analysis
    assert (analysis.nodes, analysis.nmt_states, analysis.emcy) == ([], [], [])
    assert not analysis.sdo
    assert analyzed(name).findings() == []


@pytest.mark.parametrize("rows", [1, 97])
@pytest.mark.parametrize("name", [n for n in NAMES if "sevcon_20090331" not in n])
def test_how_a_capture_is_cut_into_batches_does_not_matter(name: str, rows: int) -> None:
    """A moved identifier counts from the next batch on: that is the only difference there is."""
    if rows == 1 and name == "hilch_pcan2.trc":
        pytest.skip("long, and like the others")
    path = CAPTURES / name
    pieces = run_capture(path if path.exists() else CAPTURES / f"{name}.gz", rows=rows)
    whole = analyzed(name)
    for table in ("nodes", "nmt_commands", "nmt_states", "emcy", "errors", "sdo"):
        assert getattr(pieces.analysis, table) == getattr(whole.analysis, table), table
    assert pieces.findings() == whole.findings()


def _named(name: str) -> Run:
    if name not in NAMES:
        pytest.skip("this capture is not here")
    return analyzed(name)


def test_node_15_of_the_press_is_lost_for_87_s() -> None:
    run = _named("hilch_pcan2.trc")
    lost = [f for f in run.findings() if f.id == "nmt.node_lost"]
    assert [(f.node, f.severity) for f in lost] == [(15, "error")]
    assert (lost[0].end_ns - lost[0].start_ns) / 1e9 == pytest.approx(87.3, abs=0.3)
    assert "boot-up" in lost[0].text
    assert {f.node for f in run.findings() if f.severity == "error"} == {15}


def test_the_charger_misses_its_master_in_one_story() -> None:
    run = _named("deltaq_can1_log.csv")
    stories = run.findings()
    assert [(f.id, f.node) for f in stories] == [("nmt.guarding_lost", 10)]
    assert len(stories[0].evidence) == 4
    assert "node 1" in stories[0].cause
    assert "PRE-OPERATIONAL" in stories[0].text


def test_the_guarded_node_of_the_printing_press_is_lost_and_nobody_else() -> None:
    run = _named("hilch_ixxat1.trc")
    lost = [f for f in run.findings() if f.id == "nmt.node_lost"]
    assert [f.node for f in lost] == [9]
    assert 2 not in {f.node for f in run.findings()}
    assert 2 not in run.nodes


def test_key_cycles_are_told_as_the_whole_bus_and_pairs_of_boot_ups_once() -> None:
    run = _named("sevcon_20090331.candump.log")
    lost = [f for f in run.findings() if f.id == "nmt.bus_silent"]
    assert [(f.severity, f.node) for f in lost] == [("warning", 1)]
    assert "whole bus was silent 10 times (at +20.742 s, " in lost[0].text
    assert "for 3.348 s to 92.48 s; node 1 came back with a boot-up each time" in lost[0].text
    assert len(lost[0].evidence) == 20
    assert not [f for f in run.findings() if f.id == "nmt.unexpected_reset"]
    assert sum(boot.repeated for boot in run.tables.nmt.boot_ups) == 10
    states = [row.state for row in run.analysis.nmt_states if row.node == 1]
    assert states.count("LOST") == 10
    assert 3 not in run.nodes
