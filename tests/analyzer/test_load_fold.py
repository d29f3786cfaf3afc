"""Bus load by hand: frames of known length in known windows."""

import numpy as np
import pytest

from syncline_analyzer.results import BusLoadRow
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.wire_length import wire_bits
from tests.analyzer.timing_builder import MS, SECOND, T0, context, frame, ordered, regular, timing

DATA = bytes(range(8))
BITS = int(wire_bits(FrameBatch.from_rows([frame(0, 0x321, DATA)]))[0])


def traffic(times: list[int]) -> FrameBatch:
    return ordered(frame(t, 0x321, DATA) for t in times)


def load(*parts: FrameBatch | Gap, bitrate: int | None = 100_000) -> BusLoadRow:
    (row,) = timing(context(bitrate=bitrate), *parts).bus_load
    return row


def test_load_is_bits_over_bit_rate_and_time() -> None:
    row = load(traffic(regular(5001, 2 * MS)))
    assert row.mean_percent == pytest.approx(100 * 5000 * BITS / (100_000 * 10))
    assert row.peak_percent == pytest.approx(100 * 500 * BITS / 100_000)
    assert row.frames_per_s == pytest.approx(500.1)


def test_the_peak_is_the_busiest_second() -> None:
    times = [
        *regular(300, 10 * MS),
        *regular(500, 2 * MS, 3 * SECOND),
        *regular(300, 10 * MS, 4 * SECOND),
    ]
    row = load(traffic(times))
    assert row.peak_percent == pytest.approx(100 * 500 * BITS / 100_000)
    series = timing(context(bitrate=100_000), traffic(times)).series[0]
    assert (series.name, series.unit) == ("bus load", "%")
    assert series.value.tolist() == pytest.approx(
        [100 * n * BITS / 100_000 for n in (100, 100, 100, 500, 100, 100)]
    )
    assert ((series.t_ns - T0) // SECOND).tolist() == [0, 1, 2, 3, 4, 5]


def test_a_silent_stretch_is_drawn_as_nothing_but_is_listened_to() -> None:
    times = [*regular(200, 10 * MS), *regular(201, 10 * MS, 10 * SECOND)]
    row = load(traffic(times))
    assert row.mean_percent == pytest.approx(100 * 400 * BITS / (100_000 * 12))
    series = timing(context(bitrate=100_000), traffic(times)).series[0]
    zero = series.t_ns[series.value == 0]
    assert ((zero - T0) // SECOND).tolist() == [2, 9]


def test_a_gap_is_not_listened_to() -> None:
    gap = Gap(T0 + 2 * SECOND, T0 + 60 * SECOND, "adapter lost")
    row = load(traffic(regular(201, 10 * MS)), gap, traffic(regular(201, 10 * MS, 60 * SECOND)))
    assert row.mean_percent == pytest.approx(100 * 400 * BITS / (100_000 * 4))


def test_a_step_back_of_the_clock_makes_no_peak() -> None:
    forward = regular(301, 10 * MS)
    stepped = [*forward, *(t - 2 * SECOND for t in regular(300, 10 * MS, 3_010 * MS))]
    rows = [frame(t, 0x321, DATA) for t in stepped]
    row = load(FrameBatch.from_rows(rows))
    assert row.peak_percent == pytest.approx(100 * 100 * BITS / 100_000)


def test_without_a_bit_rate_there_are_frames_per_second_only() -> None:
    row = load(traffic(regular(301, 10 * MS)), bitrate=None)
    assert (row.bitrate, row.mean_percent, row.peak_percent) == (None, None, None)
    assert row.frames_per_s == pytest.approx(100, rel=0.01)
    series = timing(context(bitrate=None), traffic(regular(301, 10 * MS))).series[0]
    assert (series.name, series.unit) == ("frame rate", "1/s")
    assert series.value.tolist() == [100, 100, 100]


def test_a_switched_bit_rate_makes_no_percentage() -> None:
    frames = traffic(regular(301, 10 * MS))
    flags = np.full(len(frames), FrameFlag.FD | FrameFlag.BRS, np.uint16)
    fd = FrameBatch(frames.t_ns, frames.bus, frames.can_id, flags, frames.dlc, frames.data)
    assert load(fd).mean_percent is None


def test_without_times_nothing_is_claimed() -> None:
    (row,) = timing(context(timed=False), traffic([0] * 20)).bus_load
    assert (row.mean_percent, row.frames_per_s) == (None, 0.0)
