"""Bus load by hand: frames of known length in known windows."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.results import BusLoadRow
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.wire_length import data_phase_bits, wire_bits
from tests.analyzer.timing_builder import (
    MS,
    SECOND,
    T0,
    US,
    context,
    frame,
    ordered,
    regular,
    timing,
)
from tests.analyzer.wire_builder import Sent, arbitrated, machine, recorded

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
    # The frame that ends at 10 s was on the wire before.
    assert ((zero - T0) // SECOND).tolist() == [2, 8]


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


@pytest.mark.parametrize("back_ns", [5 * MS, 50 * MS])
def test_a_small_step_back_of_the_clock_makes_no_peak(back_ns: int) -> None:
    """Stamps that were held back until the clock has caught up would come all at once."""
    times = regular(1001, 2 * MS)
    stepped = [t - back_ns * (k >= 500) for k, t in enumerate(times)]
    plain, row = (
        load(FrameBatch.from_rows([frame(t, 0x321, DATA) for t in each]))
        for each in (times, stepped)
    )
    assert plain.burst_percent is not None
    assert row.peak_100ms_percent == pytest.approx(plain.peak_100ms_percent)
    assert row.burst_percent == pytest.approx(plain.burst_percent)
    assert row.longest_busy_us == pytest.approx(plain.longest_busy_us)


def unheard(by_ns: int) -> FrameBatch:
    """Heartbeats of four nodes for 100 s, and again after a jump of the stamps."""
    return ordered(
        frame(t + 25 * MS * node + by_ns * (t > 50 * SECOND), 0x700 + node, b"\5")
        for node in (1, 2, 3, 4)
        for t in regular(1000, 100 * MS)
    )


def test_the_mean_is_told_with_and_without_a_silence() -> None:
    """A bus that nobody heard for 40 s, a whole number of all periods."""
    tables = timing(context(bitrate=100_000), unheard(40 * SECOND))
    (row,), (plain,) = (tables.bus_load, timing(context(bitrate=100_000), unheard(0)).bus_load)
    assert len(tables.bus_silences) == 1
    assert row.silent_ns == pytest.approx(40 * SECOND, rel=0.01)
    assert plain.mean_percent is not None
    assert row.mean_percent == pytest.approx(plain.mean_percent / 1.4, rel=0.01)
    assert row.heard_percent == pytest.approx(plain.mean_percent, rel=0.01)
    assert (plain.silent_ns, plain.heard_percent) == (0, plain.mean_percent)


def test_time_that_never_passed_is_not_listened_to() -> None:
    """The clock was set forward by no whole number of the periods."""
    tables = timing(context(bitrate=100_000), unheard(1000 * SECOND + 37 * MS))
    (plain,) = timing(context(bitrate=100_000), unheard(0)).bus_load
    assert len(tables.clock_steps) == 1
    assert tables.bus_load[0].mean_percent == pytest.approx(plain.mean_percent, rel=0.01)


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
    assert (row.mean_percent, row.frames_per_s) == (None, None)


def busy_ns(sent: list[Sent], bitrate: int, low_ns: float, high_ns: float) -> float:
    """Time in which the wire carried a frame, each from its start to its intermission, by hand."""
    total = 0.0
    for each in sent:
        end_ns = each.end_ns
        start_ns = end_ns - each.bits * 1e9 / bitrate
        total += max(0.0, min(end_ns, high_ns) - max(start_ns, low_ns))
    return total


@given(
    st.sampled_from([125_000, 250_000, 500_000, 1_000_000]),
    st.floats(0.05, 0.98),
    st.integers(0, 1 << 30),
    st.integers(1, 700),
)
@settings(max_examples=15, deadline=None)
def test_load_equals_the_busy_time_of_the_wire(
    bitrate: int, wanted: float, seed: int, block: int
) -> None:
    sent = arbitrated(machine(bitrate, wanted, 1500, seed=seed), bitrate)
    frames = recorded(sent, start_ns=T0)
    tables = timing(context(bitrate=bitrate), frames, block_frames=block)
    (row,) = tables.bus_load
    first, last = sent[0].end_ns, sent[-1].end_ns
    assert row.mean_percent == pytest.approx(
        100 * busy_ns(sent, bitrate, first, last) / (last - first), rel=1e-5
    )
    tenths = [
        busy_ns(sent, bitrate, low, low + 100 * MS) / MS
        for low in np.arange(first, last - 100 * MS, 100 * MS)
    ]
    if tenths:
        assert row.peak_100ms_percent == pytest.approx(max(tenths), rel=1e-4)
    moments = [each.end_ns - 10 * MS for each in sent[::7]]
    moments += [e.end_ns - e.bits * 1e9 / bitrate for e in sent[::7] if e.end_ns < last - 10 * MS]
    moments = [low for low in moments if low >= first]
    bursts = [busy_ns(sent, bitrate, low, low + 10 * MS) / (MS / 10) for low in moments]
    if row.burst_percent is not None:
        assert max(bursts, default=0.0) <= row.burst_percent + 0.01
        assert row.burst_ns is not None
        start = row.burst_ns - T0
        there = busy_ns(sent, bitrate, start, start + 10 * MS) / (MS / 10)
        assert there == pytest.approx(row.burst_percent, abs=0.01)


@given(st.sampled_from([125_000, 500_000]), st.floats(0.1, 0.95), st.integers(0, 1 << 30))
@settings(max_examples=15, deadline=None)
def test_the_longest_busy_stretch_has_no_pause(bitrate: int, wanted: float, seed: int) -> None:
    sent = arbitrated(machine(bitrate, wanted, 1500, seed=seed), bitrate)
    (row,) = timing(
        context(bitrate=bitrate), recorded(sent, start_ns=T0), block_frames=100
    ).bus_load
    longest, begun, frames = 0.0, 0, 0
    for k, each in enumerate(sent):
        start_ns = each.end_ns - each.bits * 1e9 / bitrate
        if k == 0 or start_ns - sent[k - 1].end_ns > 4e9 / bitrate + 1.5:
            begun = k
        lasts = each.end_ns - (sent[begun].end_ns - sent[begun].bits * 1e9 / bitrate)
        if lasts > longest:
            longest, frames = lasts, k - begun + 1
    assert row.longest_busy_us == pytest.approx(longest / 1000, abs=0.01)
    assert row.longest_busy_frames == frames


def test_shares_add_up_and_name_their_senders() -> None:
    rows = [frame(k * MS, 0x18A, DATA) for k in range(300)]
    rows += [frame(k * MS + 500 * US, 0x60A, DATA) for k in range(100)]
    rows += [frame(k * 10 * MS + 300 * US, 0x80) for k in range(30)]
    rows += [frame(k * 10 * MS + 700 * US, 0x70A, b"\5") for k in range(30)]
    rows += [frame(k * 10 * MS + 800 * US, 0x70A, flags=FrameFlag.REMOTE) for k in range(3)]
    rows += [frame(k * 10 * MS + 900 * US, 0x18FEF128, DATA, flags=1) for k in range(3)]
    tables = timing(context(), ordered(rows))
    named = {(r.cob_id, r.remote): (r.node, r.service, r.frames) for r in tables.bus_shares}
    assert named == {
        (0x18A, False): (10, "TPDO1", 300),
        (0x60A, False): (None, "SDO request to node 10", 100),
        (0x80, False): (None, "SYNC", 30),
        (0x70A, False): (10, "error control", 30),
        (0x70A, True): (None, "guard request to node 10", 3),
        (0x18FEF128, False): (None, "29-bit", 3),
    }
    assert sum(row.share_percent for row in tables.bus_shares) == pytest.approx(100)
    first = tables.bus_shares[0]
    assert first.share_percent == max(row.share_percent for row in tables.bus_shares)
    assert [row.node for row in tables.node_shares] == [10, None]
    assert sum(row.load_percent or 0 for row in tables.node_shares) == pytest.approx(
        tables.bus_load[0].mean_percent, rel=0.01
    )


def test_a_node_has_the_exact_sum_of_its_shares() -> None:
    """A hundredth ten times is a tenth, in whatever order and version of Python it is added."""
    ids = [*range(0x181, 0x18B), *range(0x201, 0x20B), *range(0x281, 0x28B)]
    frames = ordered(frame(k * MS, ids[k % 30], DATA[: k % 9]) for k in range(997))
    tables = timing(context(bitrate=125_000), frames)
    for node in tables.node_shares:
        own = [row for row in tables.bus_shares if row.node == node.node]
        exact = sum((Fraction(row.share_percent) for row in own), Fraction())
        assert node.share_percent == float(exact)
        assert node.load_percent == float(sum(Fraction(row.load_percent or 0) for row in own))


def test_peaks_say_when() -> None:
    times = [
        *regular(100, 10 * MS),
        *regular(50, 2 * MS, 1000 * MS),
        *regular(200, 10 * MS, 1100 * MS),
    ]
    row = load(traffic(times))
    assert row.peak_100ms_ns == T0 + 1000 * MS
    assert row.peak_100ms_percent == pytest.approx(100 * 50 * BITS / 10_000)
    assert row.peak_ns == T0 + 1 * SECOND
    assert row.longest_busy_frames == 1


def test_stamps_of_bundles_tell_no_stretch_and_no_burst() -> None:
    """Five frames at once every 10 ms: the wire cannot have carried them so."""
    times = [t + k * 5 * US for t in regular(100, 10 * MS) for k in range(5)]
    row = load(traffic(times), bitrate=500_000)
    assert row.mean_percent == pytest.approx(100 * 500 * BITS / 500_000 / 0.99, rel=0.02)
    assert (row.longest_busy_us, row.burst_percent) == (None, None)


def test_coarse_stamps_tell_no_stretch() -> None:
    rows = traffic([t // MS * MS for t in regular(2000, 1300 * US)])
    (row,) = timing(context(bitrate=125_000, resolution_ns=MS), rows).bus_load
    assert row.longest_busy_us is None
    assert row.mean_percent is not None


def test_what_a_recorder_delivers_late_is_no_peak() -> None:
    """A backlog of 600 frames in 30 ms is more than the wire carries."""
    times = [
        *regular(400, 5 * MS),
        *regular(600, 50 * US, 3 * SECOND),
        *regular(400, 5 * MS, 4 * SECOND),
    ]
    row = load(traffic(times), bitrate=500_000)
    assert row.peak_100ms_percent is not None
    assert row.peak_100ms_percent < 10
    assert row.burst_percent is None or row.burst_percent <= 100


def test_frames_of_switched_bit_rate_count_where_both_are_known() -> None:
    frames = traffic(regular(301, 10 * MS))
    flags = np.full(len(frames), FrameFlag.FD | FrameFlag.BRS, np.uint16)
    fd = FrameBatch(frames.t_ns, frames.bus, frames.can_id, flags, frames.dlc, frames.data)
    ctx = context(bitrate=500_000)
    ctx.data_bitrates["can0"] = 2_000_000
    (row,) = timing(ctx, fd).bus_load
    each_ns = wire_bits(fd[:1])[0] * 2000 + data_phase_bits(fd[:1])[0] * 500
    assert row.mean_percent == pytest.approx(100 * 300 * each_ns / 3e9)
    assert row.data_bitrate == 2_000_000


def test_series_of_both_windows_are_kept() -> None:
    names = [s.name for s in timing(context(), traffic(regular(3000, 1 * MS))).series]
    assert names == ["bus load", "bus load in 100 ms"]


def test_a_stretch_begins_no_earlier_than_a_stamp_can_be() -> None:
    earliest_ns = int(np.iinfo(np.int64).min)
    begin = earliest_ns - T0
    back_to_back = [begin + BITS * 10 * US * number for number in range(9)]
    row = load(traffic([*back_to_back, begin + SECOND]))
    assert row.longest_busy_ns == earliest_ns
