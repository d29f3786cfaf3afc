"""TIME: what the bus takes for the time, against the recorder's clock (CiA 301 7.2.6)."""

from datetime import UTC, datetime, timedelta

import pytest

from syncline_schemas.batch import Gap
from tests.analyzer.control_runs import MS, Row, S, frame
from tests.analyzer.whole_run import T0, beats, found, ids, whole, write

EPOCH = datetime(1984, 1, 1, tzinfo=UTC)
START = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=T0 // 1000)


def stamp(t_ms: float, ahead_s: float = 0.0, *, can_id: int = 0x100) -> Row:
    """TIME_OF_DAY of the recorder's own clock at that moment, so many seconds ahead of it."""
    since = START + timedelta(milliseconds=t_ms, seconds=ahead_s) - EPOCH
    ms = since.seconds * 1000 + since.microseconds // 1000
    data = ms.to_bytes(4, "little") + since.days.to_bytes(2, "little")
    return frame(t_ms, can_id, data.hex())


def test_what_time_says_and_how_far_it_is_off() -> None:
    told = whole(beats(9, 0, 3000), [stamp(1000, 0.25)])
    (row,) = told.time_stamps
    assert (row.bus, row.cob_id, row.t_ns) == ("can0", 0x100, T0 + S)
    assert row.offset_ns == 250 * MS
    assert row.text == "2026-09-21 14:13:21.250"
    assert row.utc_ns == T0 + S + 250 * MS


def test_the_first_day_of_the_calendar() -> None:
    (row,) = whole(beats(9, 0, 1000), [frame(10, 0x100, "000000000000")]).time_stamps
    assert row.text == "1984-01-01 00:00:00.000"


def test_bits_above_the_milliseconds_are_reserved() -> None:
    """TIME_OF_DAY has 28 bits of ms and 4 reserved ones (CiA 301 7.1.6.7)."""
    (row,) = whole(beats(9, 0, 1000), [frame(10, 0x100, "010000F00000")]).time_stamps
    assert row.text == "1984-01-01 00:00:00.001"


@pytest.mark.parametrize("length", [0, 1, 5, 7, 8])
def test_a_wrong_length_is_told_and_never_raises(length: int) -> None:
    told = whole(beats(9, 0, 3000), [frame(1000, 0x100, "11" * length)])
    (row,) = told.time_stamps
    assert (row.utc_ns, row.offset_ns) == (None, None)
    assert row.text == f"malformed: {length} bytes instead of 6"
    assert ids(told) == set()


def test_time_moved_by_1012h() -> None:
    rows = [*write(10, 9, 0x1012, 0, 0x4000_0200), stamp(1000, can_id=0x200), stamp(1100)]
    told = whole(beats(9, 0, 3000), rows)
    assert [row.cob_id for row in told.time_stamps] == [0x200]


def test_one_row_a_minute() -> None:
    told = whole(beats(9, 0, 400_000, 1000), [stamp(1000 * k) for k in range(400)])
    assert 7 <= len(told.time_stamps) <= 9
    assert ids(told) == set()


def test_without_dates_there_is_no_offset() -> None:
    told = whole(beats(9, 0, 3000), [stamp(1000)], base="relative")
    assert [row.offset_ns for row in told.time_stamps] == [None]
    assert ids(told) == set()


@pytest.mark.triggers("clock.time_differs")
def test_time_far_from_the_recorders_clock() -> None:
    told = whole(beats(9, 0, 3000), [stamp(1000, -86_400 * 400.4)])
    (finding,) = found(told, "clock.time_differs")
    assert finding.severity == "info"
    assert "behind the recorder's clock" in finding.text
    assert "not set" in finding.cause


def test_whole_hours_are_local_time() -> None:
    (finding,) = found(whole(beats(9, 0, 3000), [stamp(1000, 7200.2)]), "clock.time_differs")
    assert "2.0 h ahead of" in finding.text
    assert "local time" in finding.cause


@pytest.mark.near_miss("clock.time_differs", "clock.time_jump")
def test_a_producer_a_second_off_is_fine() -> None:
    rows = [stamp(1000 * k, 1.0 + 0.0004 * k) for k in range(100)]
    assert ids(whole(beats(9, 0, 100_000), rows)) == set()


@pytest.mark.triggers("clock.time_jump")
@pytest.mark.parametrize("batch", [50, 10_000])
def test_time_that_is_set_on_the_bus(batch: int) -> None:
    rows = [stamp(1000 * k, 30.0 if k > 50 else 0.0) for k in range(100)]
    told = whole(beats(9, 0, 100_000), rows, batch=batch)
    (finding,) = found(told, "clock.time_jump")
    assert (finding.start_ns, finding.end_ns) == (T0 + 50 * S, T0 + 51 * S)
    assert "jumped forward by 30 s" in finding.text
    assert [row.seq for row in told.time_stamps][-1] == finding.evidence[-1]


def test_over_a_gap_nothing_jumps() -> None:
    gap = Gap(50_500 * MS, 60_500 * MS, "adapter lost", None, None)
    early = [*[stamp(1000 * k) for k in range(50)], *beats(9, 0, 50_500)]
    late = [*[stamp(1000 * k, 30) for k in range(61, 90)], *beats(9, 60_600, 90_000)]
    assert ids(whole(early, gap, late)) == {"capture.gap"}


def still(from_ms: int, stop_ms: int, every_ms: int) -> list[Row]:
    """TIME that says the time of the first message over and over."""
    _, *rest = stamp(from_ms)
    return [(k * MS, *rest) for k in range(from_ms, stop_ms, every_ms)]  # type: ignore[misc]


@pytest.mark.triggers("clock.time_still")
@pytest.mark.parametrize("batch", [3, 10_000])
@pytest.mark.parametrize("every_ms", [1000, 5000])
def test_time_that_stands_still_is_told_once(every_ms: int, batch: int) -> None:
    told = whole(
        beats(9, 0, 60_000),
        [stamp(1000 * k) for k in range(1, 5)],
        still(5000, 45_001, every_ms),
        [stamp(1000 * k) for k in range(46, 60)],
        batch=batch,
    )
    (finding,) = found(told, "clock.time_still")
    assert "stood still: it said 2026-09-21 14:13:25.000 for 40 s" in finding.text
    assert (finding.start_ns - T0, finding.end_ns - T0) == (5 * S, 45 * S)
    (jump,) = found(told, "clock.time_jump")
    assert "forward by 40 s" in jump.text


@pytest.mark.near_miss("clock.time_still")
def test_time_that_is_read_once_a_second_or_not_heard_does_not_stand_still() -> None:
    slow = [stamp(1000 * (k // 4)) for k in range(4, 240)]
    told = whole(
        beats(9, 0, 60_000),
        [(k * 250 * MS, *row[1:]) for k, row in enumerate(slow, 4)],
    )
    assert found(told, "clock.time_still") == []
    gap = Gap(2500 * MS, 20_500 * MS, "restart", None, None)
    told = whole(beats(9, 0, 60_000), gap, still(1000, 2001, 1000), [stamp(1000 * 21)])
    assert found(told, "clock.time_still") == []
