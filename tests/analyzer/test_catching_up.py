"""SYNCs behind a queue that waits for a full bus: late ones, and those that are really missing."""

import pytest

from syncline_analyzer.results import SyncRow
from syncline_schemas.batch import FrameBatch
from tests.analyzer.timing_builder import MS, US, Row, context, frame, ordered, syncs, timing

PERIOD = 10 * MS


def held_back(first: int, count: int, apart: int = 300 * US) -> list[int]:
    """200 SYNCs, of which `count` wait for the one after them and then come at once."""
    times = [k * PERIOD for k in range(200)]
    for k in range(count):
        times[first + k] = times[first + count] + (k - count) * apart
    return times


def others(start: int, end: int, apart: int = 250 * US) -> list[Row]:
    """Frames that keep the bus busy at 500 kbit/s."""
    return [frame(t, 0x17F, b"\x55" * 8) for t in range(start, end, apart)]


def sync_row(frames: FrameBatch) -> SyncRow:
    (row,) = timing(context(), frames).sync
    return row


@pytest.mark.parametrize("count", [1, 3, 11, 40])
def test_syncs_that_come_in_a_bunch_are_not_missing(count: int) -> None:
    times = held_back(50, count)
    busy = others(times[49] + MS, times[50] - MS)
    row = sync_row(ordered(syncs(times), busy))
    assert (row.count, row.missing, row.backlog) == (200, 0, 0)


def test_a_bunch_that_is_too_small_leaves_some_missing() -> None:
    times = held_back(50, 20)
    del times[52:62]
    row = sync_row(ordered(syncs(times), others(times[49] + MS, times[50] - MS)))
    assert row.missing == pytest.approx(10, abs=2)


def test_slow_catching_up_is_seen_to_the_end() -> None:
    """Between the SYNCs the producer sends what else has waited."""
    times = [k * PERIOD for k in range(50)]
    late = 30 * PERIOD
    while late > 0:
        times.append(len(times) * PERIOD + late)
        late -= PERIOD * 6 // 10
    times += [k * PERIOD for k in range(len(times), 250)]
    assert sync_row(ordered(syncs(times), others(times[49] + MS, times[50] - MS))).missing == 0


def test_a_faster_sync_after_an_outage_makes_up_for_nothing() -> None:
    before = [k * PERIOD for k in range(100)]
    after = [before[-1] + 50 * MS + k * 4 * MS for k in range(60)]
    assert sync_row(ordered(syncs(before + after))).missing == 4


def test_an_outage_is_an_outage_beside_a_full_bus() -> None:
    times = [k * PERIOD for k in range(200)]
    del times[100:107]
    row = sync_row(ordered(syncs(times), others(times[99] + MS, times[100] - MS)))
    assert row.missing == 7


def test_many_syncs_with_one_stamp_are_no_reason_to_divide_by_nothing() -> None:
    times = [k * PERIOD for k in range(100)] + [99 * PERIOD] * 60
    assert sync_row(ordered(syncs(times))).count == 160
