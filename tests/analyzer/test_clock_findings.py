"""Clock steps, unheard stretches and gaps: each is one statement that accuses no node."""

import pytest

from syncline_schemas.batch import Gap
from tests.analyzer.control_runs import MS, Row
from tests.analyzer.whole_run import T0, beats, every, found, ids, severe, whole

STOP_MS = 30_000


def line(stop_ms: float = STOP_MS) -> list[Row]:
    """Three nodes with heartbeats of their own pace, SYNC of 20 ms, a PDO that answers it."""
    return [
        *every(0x80, 1, stop_ms, 20.003),
        *every(0x185, 2, stop_ms, 20.003, b"\1\2"),
        *beats(5, 7, stop_ms, 100.013),
        *beats(6, 11, stop_ms, 200.021),
        *beats(7, 50, stop_ms, 999.7),
    ]


def stepped(by_ms: float, at_ms: float = 15_000.3) -> list[Row]:
    """The line as a recorder stamps it whose clock is set at that moment."""
    rows = sorted(line(), key=lambda row: row[0])
    return [(t + round(by_ms * MS) * (t >= at_ms * MS), *rest) for t, *rest in rows]  # type: ignore[misc]


@pytest.mark.triggers("clock.step_forward")
@pytest.mark.parametrize("batch", [64, 100_000])
@pytest.mark.parametrize("by_ms", [333.0, 1234.5, 61_437.0, 3_600_000.0, 7_200_000.0])
def test_a_clock_set_forward_accuses_nobody(by_ms: float, batch: int) -> None:
    told = whole(stepped(by_ms), in_order=False, batch=batch)
    (finding,) = told.findings
    assert finding.id == "clock.step_forward"
    assert (finding.bus, finding.node) == ("can0", None)
    (step,) = told.clock_steps
    assert step.step_ns == pytest.approx(by_ms * MS, abs=MS)
    assert step.witnesses == 5
    assert (told.sync[0].missing, told.pdos[0].missed) == (0, 0)


@pytest.mark.near_miss("clock.step_forward")
@pytest.mark.triggers("bus.silent")
@pytest.mark.parametrize(("start_ms", "stop_ms"), [(12_000, 17_000), (12_300, 13_615)])
def test_a_hole_in_the_recording_is_one_statement_on_the_bus(
    start_ms: float, stop_ms: float
) -> None:
    """peers.md 4.1 item 4: one silence per node is wrong, the whole bus was missing."""
    rows = [row for row in line() if not start_ms * MS <= row[0] < stop_ms * MS]
    told = whole(rows)
    (finding,) = told.findings
    assert (finding.id, finding.severity, finding.node) == ("bus.silent", "warning", None)
    assert finding.end_ns - finding.start_ns == pytest.approx((stop_ms - start_ms) * MS, rel=0.03)
    assert "heartbeats of 3 nodes were due: this accuses no node" in finding.text
    assert len(finding.evidence) == 2


@pytest.mark.near_miss("bus.silent")
def test_a_gap_that_the_recorder_noted_is_told_as_such() -> None:
    rows = [row for row in line() if not 12_000 * MS <= row[0] < 17_000 * MS]
    early = [row for row in rows if row[0] < 12_000 * MS]
    late = [row for row in rows if row[0] >= 17_000 * MS]
    told = whole(early, Gap(12_000 * MS, 17_000 * MS, "adapter lost", None, 0), late)
    assert ids(told) == {"capture.gap"}


def test_nodes_that_start_anew_after_a_silence_are_told_by_themselves() -> None:
    rows = line(12_000)
    boots = [(round((18_000 + node) * MS), 0, 0x700 + node, 0, 1, b"\0") for node in (5, 6, 7)]
    again = [row for row in line() if row[0] > 18_100 * MS]
    assert "bus.silent" not in ids(whole(rows, boots, again))


@pytest.mark.triggers("clock.step_back")
@pytest.mark.parametrize("by_ms", [-250.0, -3_600_000.0])
def test_a_clock_set_back_makes_no_negative_duration(by_ms: float) -> None:
    told = whole(stepped(by_ms), in_order=False)
    assert ids(told) == {"clock.step_back"}
    assert " at +14.983 s" in told.findings[0].text
    assert all(row.end_ns - row.start_ns >= by_ms * MS for row in told.nmt_states)
    assert all(each.period_us is None or each.period_us.min >= 0 for each in told.pdos)


@pytest.mark.near_miss("clock.step_back")
def test_stamps_in_the_drivers_order_are_a_note() -> None:
    rows = sorted(line(5000), key=lambda row: row[0])
    rows[100], rows[101] = (rows[101][0], *rows[100][1:]), (rows[101][0] - 40_000, *rows[101][1:])
    assert severe(whole(rows, in_order=False)) == []


@pytest.mark.triggers("capture.gap")
def test_a_gap_is_told_once_and_accuses_nobody() -> None:
    early = [row for row in line() if row[0] < 12_000 * MS]
    late = [row for row in line() if row[0] >= 17_000 * MS]
    told = whole(early, Gap(12_000 * MS, 17_000 * MS, "adapter lost", 812, 0), late)
    (finding,) = told.findings
    assert finding.severity == "info"
    assert "(adapter lost); 812 frames were lost" in finding.text


def test_many_gaps_of_one_reason_are_one_finding() -> None:
    rows = sorted(line(), key=lambda row: row[0])
    gaps = [
        Gap((1000 + 700 * k) * MS, (1001 + 700 * k) * MS, "frames dropped by the kernel", 2, 0)
        for k in range(30)
    ]
    told = whole(rows, *gaps)
    (finding,) = found(told, "capture.gap")
    assert (
        "blind 30 times, for up to 1 ms (frames dropped by the kernel); 60 frames" in finding.text
    )


@pytest.mark.near_miss("capture.gap", "capture.damaged", "capture.unparsed")
def test_a_whole_recording_has_neither_gap_nor_damage() -> None:
    assert whole(line(5000)).findings == []


@pytest.mark.triggers("capture.damaged")
def test_damage_is_told() -> None:
    (finding,) = found(whole(line(5000), damage="chunk 7: wrong CRC"), "capture.damaged")
    assert finding.severity == "warning"
    assert "chunk 7: wrong CRC" in finding.text


def test_a_recording_that_was_not_closed_is_a_note() -> None:
    text = "no footer: the recording was cut off or still runs"
    (finding,) = found(whole(line(5000), damage=text), "capture.damaged")
    assert finding.severity == "info"


@pytest.mark.triggers("capture.unparsed")
@pytest.mark.parametrize(("count", "severity"), [(1, "info"), (500, "warning")])
def test_lines_that_could_not_be_read(count: int, severity: str) -> None:
    (finding,) = found(whole(line(5000), unparsed=count), "capture.unparsed")
    assert finding.severity == severity


@pytest.mark.triggers("bus.overload")
def test_a_full_bus() -> None:
    """A frame of eight bytes AAh has 111 bits and few stuff bits: 0.9 ms at 125 kbit/s."""
    flood = every(0x701, 5000, 15_000, 1.0, b"\xaa" * 8)
    told = whole(line(20_000), flood, bitrate=125_000)
    (finding,) = found(told, "bus.overload")
    assert finding.severity == "warning"
    assert "above 90 % for" in finding.text
    assert told.overloads[0].start_ns - T0 == pytest.approx(5000 * MS, abs=1000 * MS)


@pytest.mark.near_miss("bus.overload")
def test_a_busy_second_or_a_backlog_is_no_overload() -> None:
    busy = every(0x6FF, 5000, 7000, 1.0, b"\xaa" * 8)
    backlog = every(0x6FF, 12_000, 16_000, 0.5, b"\xaa" * 8)
    told = whole(line(20_000), busy, backlog, bitrate=125_000)
    assert told.overloads == []


@pytest.mark.near_miss("bus.silent")
def test_between_two_heartbeats_of_the_last_node_nobody_else_is_due() -> None:
    """A Delta-Q charger whose master fell silent: only a heartbeat a second is left."""
    rows = [*beats(1, 0, 20_000), *beats(10, 3, 60_000, 1000), *every(0x18A, 5, 21_000, 200, b"\1")]
    assert "bus.silent" not in ids(whole(rows))
