"""A loaded bus with every table of timing filled in, for what views make of it."""

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from syncline_analyzer.results import (
    Ahead,
    Analysis,
    BusLoadRow,
    BusShareRow,
    DelayRow,
    ErrorControlRow,
    Jitter,
    LatenessRow,
    NodeShareRow,
    PdoRow,
    Quantiles,
    SyncRow,
    WaitRow,
    WorstRow,
)
from tests.analyzer.analysis_builder import (
    analysis,
    at,
    capture_row,
    node_row,
    pdo_row,
    responses,
    series,
    usual_states,
)

Source = Literal["bus-description", "recorded", "command-line", "estimated"]


def busy_bus(
    nodes: int = 7,
    pdos: int = 2,
    *,
    answers: int = 500,
    step_us: float = 1.0,
    source: Source = "recorded",
    **changes: Any,
) -> Analysis:
    """Nodes 1 to `nodes` that answer each SYNC by `pdos` TPDOs; stamps in steps of `step_us`."""
    pairs = [(node, k) for node in range(1, nodes + 1) for k in range(pdos)]
    rows: dict[str, Any] = {
        "capture": capture_row(resolution_ns=round(step_us * 1000)),
        "nodes": [node_row(node, name=f"drive {node}") for node in range(1, nodes + 1)],
        "nmt_states": [row for node in range(1, nodes + 1) for row in usual_states(node)],
        "sync": [_sync(step_us)],
        "pdos": [_pdo(node, k, step_us) for node, k in pairs],
        "responses": [_responses(node, k, answers) for node, k in pairs],
        "bus_load": [_load(source)],
        "series": [
            series("bus load", "%", np.full(600, 41.0)),
            series("bus load in 100 ms", "%", 41 + np.tile([0.0, 9.0], 3_000)),
            series("SYNC 080h period", "us", np.full(5_000, 10_000.0)),
        ],
        "node_shares": [
            *(NodeShareRow("can0", node, 60_000, 60 / nodes, 25 / nodes) for node in range(1, nodes + 1)),
            NodeShareRow("can0", None, 60_000, 40.0, 16.0),
        ],
        "bus_shares": [
            BusShareRow("can0", cob_id(node, k), False, False, node, f"TPDO{k + 1}", 60_000, 2.0, 1.0)
            for node, k in pairs
        ],
        "error_control_periods": [_heartbeat(node, step_us) for node in range(1, nodes + 1)],
        "worst": [
            WorstRow("can0", 0x80, None, "sync period", "longest", 19_987.0, 4_711, at(300.0))
        ],
        "waits": [_wait(node, k) for node, k in pairs],
        "delays": [
            DelayRow("can0", None, 1, "all", 900, 850, 95_000.0, 230.0, cob_id(nodes, 0), 99),
            DelayRow("can0", cob_id(1, 0), 1, "TPDO1", 900, 850, 95_000.0, 230.0, cob_id(nodes, 0), 99),
        ],
        "lateness": [_lateness(node, k) for node, k in pairs],
    }  # fmt: skip
    return analysis(**rows | changes)


def cob_id(node: int, k: int) -> int:
    """Identifier of TPDO k + 1."""
    return 0x180 + 0x100 * k + node


def _pdo(node: int, k: int, step_us: float) -> PdoRow:
    fine = step_us < 50
    late = 4 if (node, k) == (3, 0) else 0
    return pdo_row(
        cob_id(node, k), node, pdo=f"TPDO{k + 1}", late=late, every=1, answered=59_840,
        response_us=Quantiles(402.0, 655.0, 902.0, 1_480.0 + node, 71.5 if fine else None),
        jitter_us=Jitter(71.5, 410.0, 1_078.0) if fine else Jitter(None, None, 1_000.0),
        device_us_least=Quantiles(140.0, 333.0, 520.0, 900.0),
        device_us_free=Quantiles(300.0, 350.0, 400.0, 410.0),
        waiting_us=Quantiles(0.0, 120.0, 480.0, 777.0), resolution_us=step_us,
    )  # fmt: skip


def _responses(node: int, k: int, answers: int) -> Any:
    waited = np.where(np.arange(answers) % 7 == 0, 480.0, np.nan)
    return replace(
        responses(cob_id(node, k), node, answers, seed=node), pdo=f"TPDO{k + 1}", waiting_us=waited
    )


def _sync(step_us: float) -> SyncRow:
    return SyncRow(
        "can0", 0x80, 59_990, Quantiles(9_812.0, 10_000.0, 10_031.0, 19_987.0), 1, 0,
        jitter_us=Jitter(None, None, None) if step_us > 50 else Jitter(9.5, 44.0, 219.0),
        expected_us=10_000, expected_source="1006h of node 1 (sdo-read)", drift_ppm=12.5,
        drift_resolution_ppm=0.1, resolution_us=step_us,
    )  # fmt: skip


def _load(source: Source) -> BusLoadRow:
    sure: Literal["told", "high"] = "high" if source == "estimated" else "told"
    return BusLoadRow(
        "can0", 250_000, 41.0, 44.0, 2_100.0, source, sure, 250_000, None, at(30.0), 50.0, at(31.1),
        97.0, at(31.15), 12_345.0, 51, at(31.152),
    )  # fmt: skip


def _heartbeat(node: int, step_us: float) -> ErrorControlRow:
    return ErrorControlRow(
        "can0", node, "heartbeat", 6_000, Quantiles(99_000.0, 100_000.0, 101_000.0, 104_000.0),
        Jitter(240.0, 900.0, 5_000.0), 100_000, "sdo-write", 18.0, 0, worst_us=104_000.0,
        worst_seq=777, resolution_us=step_us,
    )  # fmt: skip


def _wait(node: int, k: int) -> WaitRow:
    ahead = [Ahead(0x181, 1, "TPDO1", 2, 508.0, [91, 93]), Ahead(0x605, None, "SDO request", 1, 254.0, [95])]  # fmt: skip
    return WaitRow(
        "can0", cob_id(node, k), node, f"TPDO{k + 1}", 96, at(31.2), 80, 1_480.0, 146.0, 1_188.0,
        762.0 + node, ahead,
    )  # fmt: skip


def _lateness(node: int, k: int) -> LatenessRow:
    late = 4 if (node, k) == (3, 0) else 0
    by_bus = 3 if late else 0
    return LatenessRow(
        "can0", cob_id(node, k), node, f"TPDO{k + 1}", 59_840, 30_000, 29_840, 1_400, late, 0,
        by_bus, 0, 0, 0, 0, 0, None, None,
    )  # fmt: skip
