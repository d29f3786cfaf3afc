"""Each rule on SYNC and PDOs: what triggers it, and what comes near and must not."""

from typing import Any

import numpy as np
import pytest

from syncline_analyzer.findings.timing import pdo
from syncline_analyzer.findings.timing import sync as timing
from syncline_analyzer.findings.timing.sync import MAX_EVIDENCE, MAX_FINDINGS
from syncline_analyzer.results import (
    Analysis,
    Finding,
    HoleRow,
    PdoRow,
    Quantiles,
    Responses,
    SdoTransfers,
    SyncJitterRow,
    SyncRow,
)
from tests.analyzer.analysis_builder import at, capture_row
from tests.analyzer.rule_facts import judge

RULES = (*timing.RULES, *pdo.RULES)
PERIOD = Quantiles(19_900, 20_000, 20_100, 20_200)


def analysis(**tables: Any) -> Analysis:
    empty: dict[str, Any] = {
        name: []
        for name in (
            [
                "nodes",
                "nmt_commands",
                "nmt_states",
                "sync",
                "pdos",
                "emcy",
                "errors",
                "sdo",
                "traces",
                "bus_load",
                "findings",
            ]
        )
    }
    given = empty | tables
    return Analysis(capture_row(), **given | {"sdo": SdoTransfers.of(given["sdo"])})


def sync_row(**changes: Any) -> SyncRow:
    plain: dict[str, Any] = {
        "bus": "can0",
        "cob_id": 0x80,
        "count": 1000,
        "period_us": PERIOD,
        "missing": 3,
        "counter_jumps": 0,
    }
    return SyncRow(**plain | changes)


def hole(start: float, end: float, missing: int = 1, **changes: Any) -> HoleRow:
    plain: dict[str, Any] = {
        "bus": "can0",
        "cob_id": 0x80,
        "service": "sync",
        "start_ns": at(start),
        "end_ns": at(end),
        "missing": missing,
        "evidence": [100, 110],
    }
    return HoleRow(**plain | changes)


def pdo_row(**changes: Any) -> PdoRow:
    plain: dict[str, Any] = {
        "bus": "can0",
        "cob_id": 0x284,
        "node": 4,
        "pdo": "TPDO2",
        "frames": 500,
        "transmission_type": 2,
        "type_source": "sdo-read",
        "period_us": PERIOD,
        "response_us": Quantiles(500, 600, 700, 3000, 50),
        "device_us_low": None,
        "device_us_high": None,
        "missed": 5,
        "extra": 0,
        "late": 0,
    }
    return PdoRow(**plain | changes)


def only(found: list[Finding]) -> Finding:
    (finding,) = found
    return finding


@pytest.mark.triggers("sync.missing")
def test_missing_syncs() -> None:
    finding = only(judge(RULES, analysis(sync=[sync_row()], holes=[hole(10, 10.08, 3)])))
    assert (finding.id, finding.severity, finding.node) == ("sync.missing", "warning", None)
    assert (finding.start_ns, finding.end_ns) == (at(10), at(10.08))
    assert finding.text == (
        "3 SYNCs of 080h are missing: it stayed away for 80 ms at +10.000 s; the period is 20 ms."
    )
    assert finding.evidence == [100, 110]


def test_a_counter_names_the_way_as_a_cause() -> None:
    row = sync_row(counter_jumps=1)
    assert "counter" in only(judge(RULES, analysis(sync=[row], holes=[hole(10, 10.08)]))).cause


def test_holes_near_one_another_are_one_finding_far_ones_are_not() -> None:
    holes = [hole(10, 10.1), hole(15, 15.1), hole(100, 100.1)]
    found = judge(RULES, analysis(sync=[sync_row()], holes=holes))
    assert [(f.start_ns, f.end_ns) for f in found] == [(at(10), at(15.1)), (at(100), at(100.1))]


def test_many_holes_are_one_finding() -> None:
    holes = [hole(30 * k, 30 * k + 0.1) for k in range(MAX_FINDINGS + 1)]
    finding = only(judge(RULES, analysis(sync=[sync_row()], holes=holes)))
    assert f"{MAX_FINDINGS + 1} times" in finding.text


def test_a_silence_of_everything_says_so() -> None:
    finding = only(
        judge(RULES, analysis(sync=[sync_row()], holes=[hole(10, 16, 300, evidence=[7, 8])]))
    )
    assert finding.cause.startswith("Nothing else was heard either")


@pytest.mark.near_miss("sync.missing")
def test_no_holes_no_finding() -> None:
    assert judge(RULES, analysis(sync=[sync_row(missing=0)], pdos=[pdo_row(missed=0)])) == []


def jitter(start: float = 5.0, **changes: Any) -> SyncJitterRow:
    plain: dict[str, Any] = {
        "bus": "can0",
        "cob_id": 0x80,
        "start_ns": at(start),
        "end_ns": at(start + 8),
        "off": 64,
        "periods": 400,
        "period_us": 20_000.0,
        "worst_us": 4_900.0,
        "evidence": [5, 6],
    }
    return SyncJitterRow(**plain | changes)


@pytest.mark.triggers("sync.jitter")
def test_jitter_gives_its_numbers() -> None:
    finding = only(judge(RULES, analysis(sync=[sync_row()], sync_jitter=[jitter()])))
    assert (finding.id, finding.start_ns, finding.end_ns) == ("sync.jitter", at(5), at(13))
    assert "64 of 400 periods" in finding.text
    assert "4.9 ms" in finding.text


def test_jitter_all_the_time_is_one_finding() -> None:
    rows = [jitter(20.0 * k) for k in range(MAX_FINDINGS + 1)]
    finding = only(judge(RULES, analysis(sync=[sync_row()], sync_jitter=rows)))
    assert (finding.start_ns, finding.end_ns) == (rows[0].start_ns, rows[-1].end_ns)


@pytest.mark.triggers("pdo.missed")
def test_missed_pdos() -> None:
    gone = hole(38, 38.2, 5, cob_id=0x284, service="pdo", evidence=[7, 9, 11])
    finding = only(judge(RULES, analysis(pdos=[pdo_row()], holes=[gone])))
    assert (finding.id, finding.node) == ("pdo.missed", 4)
    assert finding.text == (
        "Node 4: TPDO2 (284h) did not come 5 times, up to 5 in a row, each time after a SYNC that it"
        " had to answer; its transmission type is 2 (sdo-read)."
    )
    assert finding.evidence == [7, 9, 11]


def test_a_missed_pdo_of_an_inferred_type_says_so() -> None:
    row = pdo_row(type_source="inferred: synchronous, every 2nd SYNC", pdo=None, node=None)
    gone = hole(38, 38.2, 1, cob_id=0x284, service="pdo")
    text = only(judge(RULES, analysis(pdos=[row], holes=[gone]))).text
    assert text.startswith("A PDO (284h) did not come at +38.000 s after a ")
    assert "inferred: synchronous, every 2nd SYNC" in text


def test_a_cyclic_pdo_misses_periods_of_its_timer() -> None:
    row = pdo_row(transmission_type=0xFE, response_us=None)
    gone = hole(38, 38.2, 2, cob_id=0x284, service="pdo", evidence=[7])
    assert (
        "period of its event timer" in only(judge(RULES, analysis(pdos=[row], holes=[gone]))).text
    )


@pytest.mark.near_miss("pdo.missed")
def test_a_pdo_that_only_error_frames_held_back_accuses_no_node() -> None:
    plain = {"cob_id": 0x284, "service": "pdo"}
    gone = [hole(38, 38.2, 1, held_back=1, **plain), hole(50, 50.2, 2, held_back=1, **plain)]
    assert judge(RULES, analysis(pdos=[pdo_row(missed=1)], holes=gone[:1])) == []
    finding = only(judge(RULES, analysis(pdos=[pdo_row(missed=3)], holes=gone)))
    assert (finding.start_ns, finding.end_ns) == (at(50), at(50.2))


@pytest.mark.near_miss("pdo.missed")
def test_holes_of_another_bus_are_not_mixed_in() -> None:
    gone = hole(38, 38.2, 5, cob_id=0x284, service="pdo", bus="can1")
    assert judge(RULES, analysis(pdos=[pdo_row()], holes=[gone])) == []


def responses(values: list[float]) -> Responses:
    column = np.array(values)
    seq = np.arange(len(values))
    return Responses(
        "can0", 0x284, 4, "TPDO2", seq, at(1) + seq, column, column, column, seq, column,
        column, column,
    )  # fmt: skip


@pytest.mark.triggers("pdo.late")
def test_late_answers_are_the_slowest_ones() -> None:
    tables = {"pdos": [pdo_row(missed=0, late=2)], "responses": [responses([500, 3000, 600, 2500])]}
    finding = only(judge(RULES, analysis(**tables)))
    assert finding.id == "pdo.late"
    assert finding.evidence == [1, 3]
    assert (finding.start_ns, finding.end_ns) == (at(1) + 1, at(1) + 4)
    assert "2 times of 500" in finding.text


@pytest.mark.near_miss("pdo.late")
@pytest.mark.parametrize("late", [0, 1])
def test_late_needs_a_window_and_answers(late: int) -> None:
    assert judge(RULES, analysis(pdos=[pdo_row(missed=0, late=late)])) == []


def test_evidence_is_bounded() -> None:
    gone = hole(1, 2, 500, cob_id=0x284, service="pdo", evidence=list(range(500)))
    assert (
        len(only(judge(RULES, analysis(pdos=[pdo_row()], holes=[gone]))).evidence) == MAX_EVIDENCE
    )
