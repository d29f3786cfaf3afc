"""Reads of 1003h and 1001h beside the EMCYs, and what was around each EMCY."""

import numpy as np
import pytest

from syncline_analyzer.folds.emcy.context import MAX_CONTEXTS, emcy_context
from syncline_analyzer.results import BusStateRow, ErrorHistoryRow, NmtStateRow, Trace
from syncline_schemas.batch import Gap
from tests.analyzer.analysis_builder import analysis, emcy_row, sdo_row
from tests.analyzer.control_runs import MS, Run, frame
from tests.analyzer.test_emcy_findings import emcy, heartbeats, node_5, read, written

VOLTAGE = "0031050000000000"
HEAT = "0042090000000000"
SECOND = 1_000_000_000


def history(result: Run) -> list[tuple[int, str, int | None]]:
    """(code or raw value, seen, seq of the EMCY) of every read."""
    return [
        (row.raw if row.code is None else row.code, row.seen, row.emcy_seq)
        for row in result.analysis.error_history
    ]


def entry(
    t_ms: float, sub: int, code: int, size: int = 4
) -> list[tuple[int, int, int, int, int, bytes]]:
    return read(t_ms, 0x1003, sub, code, size)


def test_the_newest_entry_is_the_last_emcy() -> None:
    """JN2100 and LIR: newest at sub 1; the count is no entry; 0 is an empty one."""
    reads = [*read(500, 0x1003, 0, 2, 4), *entry(510, 1, 0x3100), *entry(520, 2, 0x4200)]
    result = node_5(emcy(100, HEAT), emcy(200, VOLTAGE), reads, entry(530, 3, 0))
    assert history(result) == [
        (2, "count", None),
        (0x3100, "seen", 2),
        (0x4200, "seen", 1),
        (0, "empty", None),
    ]


@pytest.mark.parametrize("size", [2, 4])
def test_the_code_is_the_low_half_whatever_the_width(size: int) -> None:
    """LIR traps 29 and C3: U32 or U16."""
    value = 0x3100 if size == 2 else 0x0012_3100
    (row,) = node_5(emcy(100, VOLTAGE), entry(500, 1, value, size)).analysis.error_history
    assert (row.code, row.info) == (0x3100, None if size == 2 else 0x12)
    assert (row.seen, row.meaning) == ("seen", "mains voltage")


def test_one_emcy_stands_for_one_entry() -> None:
    reads = [*entry(500, 1, 0x3100), *entry(510, 2, 0x3100)]
    assert history(node_5(emcy(100, VOLTAGE), reads)) == [
        (0x3100, "seen", 1),
        (0x3100, "older", None),
    ]


def test_an_entry_between_two_that_were_seen_was_missed() -> None:
    reads = [*entry(500, 1, 0x3100), *entry(510, 2, 0x5000), *entry(520, 3, 0x4200)]
    rows = node_5(emcy(100, HEAT), emcy(200, VOLTAGE), reads).analysis.error_history
    assert [row.seen for row in rows] == ["seen", "missed", "seen"]
    assert rows[1].note == "it came during the capture; no EMCY told it"


def test_a_list_that_was_cleared_holds_nothing_old() -> None:
    """LB15: writing 0 to 1003h:0 empties it."""
    result = node_5(emcy(100, VOLTAGE), written(300, 0x1003, 0, 1), entry(500, 1, 0x3100))
    assert history(result) == [(0x3100, "missed", None)]


def test_after_a_gap_an_entry_may_be_old_or_missed() -> None:
    gap = Gap(100 * MS, 300 * MS, "adapter lost", None, None)
    (row,) = node_5(gap, entry(500, 1, 0x3100)).analysis.error_history
    assert row.seen == "unknown"
    assert "the recorder was blind" in row.note
    stopped = node_5(heartbeats(100, 400, "04"), heartbeats(400, 600), entry(650, 1, 0x3100))
    assert [row.seen for row in stopped.analysis.error_history] == ["unknown"]


def test_a_node_whose_emcys_are_switched_off_was_not_missed() -> None:
    """CiA 301 7.5.2.17: bit 31 of 1014h."""
    off = written(100, 0x1014, 0x8000_0085)
    (row,) = node_5(off, entry(500, 1, 0x3100)).analysis.error_history
    assert (row.seen, "1014h switched its EMCYs off" in row.note) == ("unknown", True)


def test_a_list_with_the_oldest_first_accuses_nobody() -> None:
    reads = [*entry(500, 1, 0x4200), *entry(510, 2, 0x5000), *entry(520, 3, 0x3100)]
    result = node_5(emcy(100, HEAT), emcy(200, VOLTAGE), reads)
    assert [seen for _, seen, _ in history(result)] == ["seen", "unknown", "seen"]


def test_refused_entries_are_none() -> None:
    """LB17: 0609 0011h above the number stored."""
    asked = [frame(500, 0x605, "4003100300000000"), frame(501, 0x585, "8003100311000906")]
    assert node_5(asked).analysis.error_history == []


def registers(*values: int, device: str | None) -> list[ErrorHistoryRow]:
    reads = [
        row for n, value in enumerate(values) for row in read(500 + 100 * n, 0x1001, 0, value, 1)
    ]
    return node_5(emcy(100, "3055800000000000"), reads, device=device).analysis.error_history


def test_reading_1001h_clears_it_on_a_lir_only() -> None:
    lir = registers(0x80, 0x00, 0x00, device="lir-da158")
    assert [row.seen for row in lir] == ["register", "cleared by read", "register"]
    assert lir[0].meaning == "eeprom"
    assert lir[0].note == "this read clears it"
    plain = registers(0x80, 0x00, device=None)
    assert [row.seen for row in plain] == ["register", "register"]
    assert [row.note for row in plain] == ["", "the last EMCY said 80h"]


def shaft(times_s: list[float], values: list[float], node: int = 10) -> Trace:
    count = len(times_s)
    t_ns = (np.array(times_s) * SECOND).astype(np.int64)
    return Trace(
        "can0", node, 0x600400, "Position value", "counts", t_ns, (t_ns // MS),
        np.zeros(count, np.int64), np.array(values), np.zeros(count, np.uint16),
        np.zeros(count, np.int32),
    )  # fmt: skip


def test_what_was_around_an_emcy() -> None:
    """Times in seconds, `seq` in milliseconds."""
    message = emcy_row(10, 0, 0x3100, t_ns=100 * SECOND, seq=100_000)
    states = [
        NmtStateRow("can0", 10, "PRE-OPERATIONAL", 0, 50 * SECOND, "boot-up", "observed", 0),
        NmtStateRow(
            "can0", 10, "OPERATIONAL", 50 * SECOND, 200 * SECOND, "heartbeat", "observed", 50_000
        ),
    ]
    writes = [
        sdo_row(10, start_ns=at, end_ns=at + MS, seq=at // MS, end_seq=at // MS + 1, index=index)
        for at, index in ((80 * SECOND, 0x6001), (95 * SECOND, 0x6002), (99 * SECOND, 0x6003))
    ]
    writes.append(sdo_row(10, start_ns=99 * SECOND, end_ns=99 * SECOND, direction="upload"))
    whole = analysis(
        emcy=[message],
        nmt_states=states,
        sdo=writes,
        trace_data=[
            shaft([98.0, 99.5, 99.99, 100.001, 100.7, 101.5], [1, 2, 3, np.nan, 5, 6]),
            shaft([99.9], [7.0], node=11),
        ],
    )
    bus = [BusStateRow("can0", "passive", 90 * SECOND, 110 * SECOND, "", None)]
    (row,) = emcy_context(whole, bus, timed=True)
    assert (row.state, row.certainty, row.bus_state) == ("OPERATIONAL", "observed", "passive")
    assert (row.write_index, round(row.write_ms or 0)) == (0x6003, 999)
    assert [text[:5] for text in row.writes] == ["6003h", "6002h"]
    value = row.values["6004h:00"]
    assert (value["before"], value["after"], value["low"], value["high"]) == (3.0, 5.0, 2.0, 5.0)
    assert (value["name"], value["unit"], value["samples"]) == ("Position value", "counts", 3)


def test_a_storm_costs_a_bounded_number_of_contexts() -> None:
    rows = [emcy_row(10, n / 10) for n in range(MAX_CONTEXTS + 500)]
    assert len(emcy_context(analysis(emcy=rows), [], timed=True)) == MAX_CONTEXTS
    assert emcy_context(analysis(), [], timed=True) == []


def test_a_write_to_another_node_is_no_context() -> None:
    row = node_5(written(100, 0x6003, 1), emcy(110, VOLTAGE, node=9)).analysis.emcy_context[0]
    assert (row.node, row.write_index, row.writes) == (9, None, [])


@pytest.mark.near_miss("emcy.history_unseen")
def test_a_gap_may_hide_the_emcy_of_a_new_entry() -> None:
    """Only a gap after what shows the entry to be new, and before what shows it to be older."""
    reads = [*entry(500, 1, 0x3100), *entry(510, 2, 0x5000), *entry(520, 3, 0x4200)]
    for start, end, seen in ((120, 180, "unknown"), (20, 80, "missed"), (220, 280, "missed")):
        gap = Gap(start * MS, end * MS, "adapter lost", None, None)
        result = node_5(emcy(100, HEAT), gap, emcy(200, VOLTAGE), reads)
        assert [row.seen for row in result.analysis.error_history] == ["seen", seen, "seen"]
        told = [each.severity for each in result.findings() if each.id == "emcy.history_unseen"]
        assert told == ["info" if seen == "unknown" else "warning"]
    gap = Gap(320 * MS, 380 * MS, "adapter lost", None, None)
    cleared = node_5(written(300, 0x1003, 0, 1), gap, entry(500, 1, 0x3100))
    assert history(cleared) == [(0x3100, "unknown", None)]


@pytest.mark.near_miss("emcy.history_unseen")
def test_a_gap_may_hide_the_emcys_by_which_the_list_grew() -> None:
    gap = Gap(320 * MS, 380 * MS, "adapter lost", None, None)
    reads = (read(300, 0x1003, 0, 0, 1), read(500, 0x1003, 0, 2, 1), read(600, 0x1003, 0, 3, 1))
    notes = [row.note for row in node_5(reads[0], gap, *reads[1:]).analysis.error_history]
    assert notes == ["", "", "1 error more than at the read before; EMCYs told 0"]
