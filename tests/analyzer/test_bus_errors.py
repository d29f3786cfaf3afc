"""Error frames: the state of the recorder's controller over time, kinds, and what is told of them."""

from pathlib import Path

import pytest
from can.io.blf import CAN_ERROR_EXT, CAN_ERROR_EXT_STRUCT, BLFWriter
from hypothesis import given, settings

from syncline_analyzer.deafness import without_classes
from syncline_analyzer.results import Analysis
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from tests.analyzer.control_runs import MS, Row, S
from tests.analyzer.log_builder import T0_NS, frame_rows, read
from tests.analyzer.whole_run import T0, beats, error, every, found, ids, severe, whole, write

CRTL, PROT, ACK, OFF, BUS, RESTARTED, CNT = 0x004, 0x008, 0x020, 0x040, 0x080, 0x100, 0x200


def line(stop_ms: float = 20_000) -> list[Row]:
    """Two nodes, SYNC, and an answer to it."""
    sync = every(0x80, 1, stop_ms, 20)
    return [
        *sync,
        *every(0x185, 2, stop_ms, 20, b"\1\2"),
        *beats(5, 7, stop_ms),
        *beats(6, 11, stop_ms),
    ]


def states(analysis: Analysis, bus: str = "can0") -> list[tuple[str, float, float]]:
    return [
        (row.state, (row.start_ns - T0) / S, (row.end_ns - T0) / S)
        for row in analysis.bus_states
        if row.bus == bus
    ]


@pytest.mark.parametrize("batch", [1, 7, 10_000])
def test_the_states_of_the_controller_over_time(batch: int) -> None:
    rows = [
        error(2000, CRTL, d1=0x04, d7=96),
        error(3000, CRTL, d1=0x10, d7=130),
        error(3500, PROT | BUS, d2=0x04, d7=140),
        error(4000, OFF),
        error(5000, RESTARTED),
        error(5005, CRTL, d1=0x40),
    ]
    hearing = [row for row in line(8000) if not 4000 * MS < row[0] < 5001 * MS]
    told = whole(rows, hearing, batch=batch if batch > 1 else 50)
    assert states(told) == [
        ("unknown", 0.001, 2.0),
        ("warning", 2.0, 3.0),
        ("passive", 3.0, 4.0),
        ("bus-off", 4.0, 5.0),
        ("restarted", 5.0, 5.001),
        ("active", 5.001, pytest.approx(7.999, abs=0.1)),
    ]
    passive = told.bus_states[2]
    assert (passive.tx_errors, passive.rx_errors) == (0, 130)
    assert passive.cause == "controller: error-passive by receive errors"
    assert passive.evidence is not None
    assert [row.start_ns for row in told.bus_states[1:]] == [
        row.end_ns for row in told.bus_states[:-1]
    ]


def test_a_bus_off_without_a_word_of_the_restart_ends_when_frames_are_heard() -> None:
    told = whole(beats(5, 0, 1000), [error(1000, OFF)], beats(5, 3000, 5000))
    assert states(told)[1:] == [("bus-off", 1.0, 3.0), ("active", 3.0, 4.9)]
    assert told.bus_states[-1].cause == "frames are heard again"


def test_the_counters_alone_tell_the_state() -> None:
    rows = [
        error(t, PROT | BUS | CNT, d2=0x04, d7=c) for t, c in ((100, 1), (200, 100), (300, 128))
    ]
    told = whole(beats(5, 0, 1000), rows)
    assert [state for state, _, _ in states(told)] == ["unknown", "active", "warning", "passive"]


def test_after_a_gap_the_state_is_unknown() -> None:
    gap = Gap(2000 * MS, 4000 * MS, "adapter lost", None, 0)
    told = whole([*line(2000), error(1000, CRTL, d1=0x10)], gap, line(6000)[300:])
    assert states(told)[-1][:2] == ("unknown", 2.0)


def test_a_bus_without_error_frames_has_no_states() -> None:
    told = whole(line(2000))
    assert (told.bus_states, told.bus_errors) == ([], [])


def test_each_bus_has_its_own_controller() -> None:
    rows = [error(1000, CRTL, d1=0x10, bus=1)]
    told = whole(line(3000), rows, beats(9, 0, 3000, bus=1), buses=("can0", "can1"))
    assert states(told) == []
    assert [row[0] for row in states(told, "can1")] == ["unknown", "passive"]


def test_kinds_are_counted() -> None:
    rows = [error(1000 + t, PROT | BUS, d2=0x04, d3=0x0A, d7=t % 90) for t in range(30)]
    rows += [error(1200 + t, 0x002, d0=5) for t in range(4)]
    rows += [error(1300, 0)]
    told = whole(line(3000), rows)
    assert {row.kind: row.count for row in told.bus_errors} == {
        "bus error: stuff error in the data field": 30,
        "arbitration lost in bit 5": 4,
        "error frame, kind not recorded": 1,
    }
    kind = told.bus_errors[0]
    assert (kind.first_ns, kind.last_ns) == (T0 + 1000 * MS, T0 + 1029 * MS)
    assert len(kind.evidence) == 20


@pytest.mark.triggers("error.passive")
def test_error_passive() -> None:
    rows = [error(2000, CRTL, d1=0x10, d7=131), error(2500, CRTL, d1=0x40)]
    (finding,) = found(whole(line(5000), rows), "error.passive")
    assert (finding.severity, finding.bus, finding.node) == ("warning", "can0", None)
    assert "receive 131" in finding.text
    assert "500 ms" in finding.text
    assert len(finding.evidence) == 1


@pytest.mark.near_miss("error.passive")
@pytest.mark.triggers("error.warning_level")
def test_the_warning_level_alone_is_a_note() -> None:
    told = whole(line(5000), [error(2000, CRTL, d1=0x04, d7=96), error(2100, CRTL, d1=0x40)])
    assert ids(told) == {"error.warning_level"}
    assert found(told, "error.warning_level")[0].severity == "info"


@pytest.mark.triggers("error.warning_level")
def test_the_warning_level_is_told_though_another_time_it_went_on_to_passive() -> None:
    worse = [error(1000, CRTL, d1=0x04, d7=96), error(1100, CRTL, d1=0x10, d7=130)]
    again = [error(3000, CRTL, d1=0x04, d7=96), error(3500, CRTL, d1=0x40)]
    told = whole(line(5000), worse, [error(1500, CRTL, d1=0x40)], again)
    (finding,) = found(told, "error.warning_level")
    assert finding.start_ns == T0 + 3000 * MS


@pytest.mark.near_miss("error.warning_level")
def test_counters_below_the_warning_level_are_none() -> None:
    assert ids(whole(line(5000), [error(2000, PROT | BUS | CNT, d2=0x04, d7=95)])) == set()


@pytest.mark.triggers("error.frames")
def test_a_burst_of_error_frames_and_whose_frame_they_hit() -> None:
    """The frame of node 5 is destroyed again and again, and repeated at once (ISO 11898-1)."""
    rows = [error(5002.0 - 0.3 + 20 * k, PROT | BUS, d2=0x04, d3=0x0A) for k in range(25)]
    setup = write(0.2, 5, 0x1800, 1, 0x185)
    told = whole(setup, line(10_000), rows)
    (finding,) = found(told, "error.frames")
    assert finding.severity == "warning"
    assert finding.node == 5
    assert finding.text.startswith("25 error frames on can0 within 480 ms, all of them: bus error:")
    assert "after 25 of 25 the frame 185h of node 5 came at once" in finding.text


def test_error_frames_that_hit_everybody_accuse_nobody() -> None:
    rows = [error(5000 + 7.7 * k, 0) for k in range(40)]
    (finding,) = found(whole(line(10_000), rows), "error.frames")
    assert finding.node is None
    assert "kind not recorded" in finding.text
    assert "came at once" not in finding.text


@pytest.mark.near_miss("error.frames")
def test_few_error_frames_and_lost_arbitration_are_no_burst() -> None:
    rows = [error(1000 + k, 0x002, d0=3) for k in range(100)]
    rows += [error(500 + 1500 * k, PROT | BUS, d2=0x04) for k in range(9)]
    assert severe(whole(line(20_000), rows)) == []


@pytest.mark.triggers("error.no_ack")
def test_nobody_acknowledges() -> None:
    (finding,) = found(whole(line(3000), [error(1000 + k, ACK) for k in range(5)]), "error.no_ack")
    assert "5 error frames" in finding.text


@pytest.mark.near_miss("error.no_ack")
def test_the_first_frames_of_a_bus_may_be_alone() -> None:
    rows = [error(1, ACK), error(2, ACK), error(3, ACK), error(9, PROT | BUS, d2=0x04, d3=0x19)]
    assert "error.no_ack" not in ids(whole(line(3000), rows))


@pytest.mark.triggers("error.overrun")
def test_an_overrun_is_the_recorders_loss() -> None:
    """SYNCs and PDOs that are missing there accuse nobody."""
    hearing = [row for row in line() if not 9999 * MS < row[0] < 10_200 * MS]
    told = whole(hearing, [error(10_200, CRTL, d1=0x01)])
    assert ids(told) == {"error.overrun"}
    (gap,) = told.capture.gaps
    assert gap.end_ns == T0 + 10_200 * MS
    assert "overflowed once at +" in found(told, "error.overrun")[0].text


@pytest.mark.near_miss("error.overrun")
def test_a_full_transmit_buffer_loses_nothing() -> None:
    told = whole(line(), [error(10_200, CRTL, d1=0x02)])
    assert (ids(told), told.capture.gaps) == (set(), [])


def test_a_flood_of_overruns_is_bounded() -> None:
    rows = [error(1000 + 5 * k, CRTL, d1=0x01) for k in range(1000)]
    told = whole(line(8000), rows)
    assert len(told.capture.gaps) <= 51
    assert "1000 times" in found(told, "error.overrun")[0].text


@pytest.mark.triggers("error.bus_off")
def test_the_recorder_goes_bus_off_and_restarts() -> None:
    hearing = [row for row in line() if not 5000 * MS < row[0] < 8000 * MS]
    told = whole(hearing, [error(5000, OFF), error(8000, RESTARTED)])
    assert ids(told) == {"error.bus_off"}
    assert "it was back after 3 s" in told.findings[0].text


@pytest.mark.near_miss("error.bus_off")
def test_an_identifier_that_is_no_class_is_no_bus_off() -> None:
    """As loggers write the identifier of the destroyed frame there."""
    assert "error.bus_off" not in ids(whole(line(), [error(5000, 0x740)]))


def test_without_times_error_frames_are_told_too() -> None:
    rows = [error(1000, CRTL, d1=0x10), *[error(1001 + k, 0) for k in range(12)]]
    told = whole(line(3000), rows, base="none")
    assert {"error.passive", "error.frames"} <= ids(told)


def test_error_frames_of_another_driver_only_say_that_there_was_one() -> None:
    batch = FrameBatch.from_rows([error(1, OFF, d1=7), error(2, OFF, bus=1), *beats(5, 3, 4, 1)])
    plain = without_classes(batch, [1])
    assert plain.can_id.tolist() == [OFF, 0, 0x705]
    assert plain.data[0, 1] == 7
    assert without_classes(batch, []) is batch


def test_the_identifier_in_a_vector_error_object_is_no_class(tmp_path: Path) -> None:
    """VBLCANErrorFrameExt: with an error code, the identifier is the disturbed frame's."""
    path = tmp_path / "errors.blf"
    writer = BLFWriter(path)
    for ecc, can_id in ((0xA7, 0x1C5), (0, 0x40)):
        payload = CAN_ERROR_EXT_STRUCT.pack(1, 0, int(bool(ecc)), ecc, 0, 8, 0, can_id, 0, bytes(8))
        writer._add_object(CAN_ERROR_EXT, payload, 1_700_000_000.0)
    writer.stop()
    batch, _, _ = read(path)
    assert batch.can_id.tolist() == [0, 0x40]
    assert (batch.flags == int(FrameFlag.ERROR)).all()


@given(frame_rows(fd=False))
@settings(max_examples=60, deadline=None)
def test_whatever_comes_nothing_raises(rows: list[Row]) -> None:
    told = whole([(t - T0_NS, *rest) for t, *rest in rows], in_order=False, buses=("a", "b"))  # type: ignore[misc]
    assert sum(row.count for row in told.bus_errors) == told.capture.error_frames
    for row in told.bus_states:
        assert row.state in ("unknown", "active", "warning", "passive", "bus-off", "restarted")
