"""When a frame can have been ready: by hand, and against buses of which the truth is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_analyzer.folds.timing.waiting import UNKNOWN, Arbitration, Asked, Ready, rank
from syncline_schemas.batch import FrameBatch, FrameFlag
from tests.analyzer.arbitration_model import BIT_NS, Line, Request, Sent, arbitration, seen

SYNC = Request(0, 0x80, 0, 47)
SYNC_END = 44 * BIT_NS
WIRE = 111 * BIT_NS
BODY = 108 * BIT_NS


def asked(bus: Arbitration, sent: list[Sent], can_id: int = 0x185, node: int = 5) -> Ready:
    """When the only frame of an identifier can have been ready; the SYNC is the first frame."""
    row = next(k for k, each in enumerate(sent) if each.request.can_id == can_id)
    return bus.ready(one(row, bus._base_ns, can_id, node))[0]


def one(row: int, sync_ns: int, can_id: int, node: int) -> Asked:
    """One answer to the first frame, of which nothing else is known."""
    return Asked(
        np.array([0]),
        np.array([can_id << 21], np.uint32),
        np.array([node], np.int16),
        np.array([row]),
        np.array([0]),
        np.array([0]),
        np.array([sync_ns]),
        np.array([0.0]),
        np.array([np.inf]),
    )


def line(*requests: Request, in_turn: frozenset[int] = frozenset()) -> list[Sent]:
    return Line([SYNC, *requests], in_turn).run()


def test_on_an_idle_bus_a_frame_starts_when_it_is_ready() -> None:
    sent = line(Request(300_000, 0x185, 5))
    ready = asked(seen(sent), sent)
    assert ready.free.all()
    assert ready.waiting_ns[0] == 0
    assert ready.least_ns[0] == pytest.approx(300_000 - SYNC_END - BIT_NS)


def test_a_frame_of_lower_priority_shows_that_none_was_ready() -> None:
    sent = line(Request(90_000, 0x585, 9), Request(100_000, 0x185, 5))
    ready = asked(seen(sent), sent)
    assert ready.first.tolist() == [1]
    assert ready.least_ns[0] == pytest.approx(sent[1].start_ns - SYNC_END - BIT_NS)
    assert ready.waiting_ns[0] == pytest.approx(WIRE + BIT_NS)
    assert not ready.free.any()


def test_frames_of_higher_priority_may_have_kept_it_waiting_since_the_sync() -> None:
    sent = line(Request(90_000, 0x181, 1), Request(90_000, 0x182, 2), Request(95_000, 0x185, 5))
    ready = asked(seen(sent), sent)
    assert ready.first.tolist() == [1]
    assert ready.least_ns.tolist() == [0]
    assert ready.waiting_ns[0] == pytest.approx(2 * WIRE + 3 * BIT_NS)


def test_idle_before_the_frames_ahead_ends_what_it_can_have_waited() -> None:
    sent = line(Request(400_000, 0x181, 1), Request(410_000, 0x182, 2), Request(420_000, 0x185, 5))
    ready = asked(seen(sent), sent)
    assert ready.least_ns[0] == pytest.approx(400_000 - SYNC_END - BIT_NS)
    assert ready.waiting_ns[0] == pytest.approx(2 * WIRE + BIT_NS)


def test_a_frame_of_its_own_node_proves_nothing() -> None:
    """The SDO answer went first because the device sends in the order of its own queue."""
    sent = line(Request(90_000, 0x585, 5), Request(91_000, 0x185, 5), in_turn=frozenset({5}))
    ready = asked(seen(sent), sent)
    assert ready.least_ns.tolist() == [0]
    assert ready.first.tolist() == [1]


def test_behind_its_own_frame_of_low_priority_it_may_stand_in_line() -> None:
    """585h of node 5 waits for 582h; 185h, asked for before that, stands behind 585h."""
    sent = line(
        Request(89_000, 0x181, 1),
        Request(90_000, 0x585, 5),
        Request(91_000, 0x185, 5),
        Request(92_000, 0x582, 2),
        in_turn=frozenset({5}),
    )
    assert [each.request.can_id for each in sent] == [0x80, 0x181, 0x582, 0x585, 0x185]
    assert asked(seen(sent), sent).least_ns[0] <= 91_000 - SYNC_END


def test_right_behind_its_own_frame_it_may_not_be_loaded_yet() -> None:
    """Node 5 has one buffer: it asked for both at 90 us and loads 285h while 586h begins."""
    sent = line(
        Request(90_000, 0x185, 5),
        Request(200_000, 0x586, 6),
        Request(90_000 + WIRE + 10_000, 0x285, 5),
    )
    assert [each.request.can_id for each in sent] == [0x80, 0x185, 0x586, 0x285]
    assert asked(seen(sent), sent, 0x285).least_ns[0] <= 90_000 - SYNC_END + 1
    assert asked(seen(sent), sent, 0x285, node=7).least_ns[0] > 90_000


def test_a_frame_of_nobody_knows_whom_proves_nothing() -> None:
    sent = line(Request(90_000, 0x6F0, UNKNOWN), Request(100_000, 0x185, 5))
    assert asked(seen(sent), sent).least_ns.tolist() == [0]


def test_around_an_error_frame_nothing_is_certain() -> None:
    sent = line(Request(90_000, 0x181, 1), Request(400_000, 0x582, 2), Request(420_000, 0x185, 5))
    bus = seen(sent)
    assert asked(bus, sent).least_ns[0] > 300_000
    wire_ns = np.array([each.request.bits * BIT_NS for each in sent], np.float64)
    wire_ns[1] = np.nan
    blind = Arbitration(
        np.array([each.end_ns for each in sent], np.int64),
        wire_ns,
        bus.rank,
        bus.sender,
        bit_ns=BIT_NS,
    )
    assert asked(blind, sent).least_ns.tolist() == [0]


def test_stamps_that_step_back_tell_no_waiting() -> None:
    sent = line(Request(90_000, 0x181, 1), Request(400_000, 0x185, 5))
    bus = arbitration([each.end_ns for each in sent[:-1]] + [sent[1].end_ns - 50_000], sent)
    assert not asked(bus, sent).known.any()
    assert asked(seen(sent), sent).known.all()


def test_stamps_of_a_millisecond_tell_nothing() -> None:
    sent = line(Request(90_000, 0x181, 1), Request(400_000, 0x185, 5))
    assert not seen(sent, step_ns=1_000_000).usable
    assert seen(sent, step_ns=10_000).usable


def test_stamps_closer_than_the_wire_allows_widen_the_bounds() -> None:
    """A recorder that stamps 30 us late now and then: frames 80 us behind one another."""
    requests = [
        Request(100_000 + 3_000_000 * (k // 3), 0x181 + k % 3, 1 + k % 3) for k in range(300)
    ]
    sent = Line([SYNC, *requests]).run()
    late = np.random.default_rng(4).integers(0, 30_000, len(sent))
    noisy = arbitration([each.end_ns + int(d) for each, d in zip(sent, late, strict=True)], sent)
    assert seen(sent).noise_ns == 0
    assert noisy.noise_ns in (20_000, 50_000)
    assert noisy.usable
    wild = arbitration([each.end_ns + 8 * int(d) for each, d in zip(sent, late, strict=True)], sent)
    assert not wild.usable


def test_one_stamp_that_is_late_makes_no_idle_bus() -> None:
    """Of many exact frames one is stamped 90 us late; the PDO right behind it was not free."""
    many = [Request(10_000_000 + 300_000 * k, 0x181, 1) for k in range(200)]
    burst = [Request(90_000, 0x181 + k, 1 + k) for k in range(5)]
    sent = Line([SYNC, *burst, *many]).run()
    stamps = [each.end_ns for each in sent]
    assert asked(arbitration(stamps, sent), sent).least_ns.tolist() == [0]
    stamps[4] += 90_000
    assert asked(arbitration(stamps, sent), sent).least_ns.tolist() == [0]


def test_rank_is_the_order_of_arbitration() -> None:
    extended, remote = int(FrameFlag.EXTENDED), int(FrameFlag.REMOTE)
    ordered = [
        (0x080, 0),
        (0x185, 0),
        (0x185, remote),
        (0x185 << 18, extended),
        (0x185 << 18, extended | remote),
        (0x185 << 18 | 1, extended),
        (0x186, 0),
        (0x7FF, 0),
        (0x1FFFFFFF, extended),
    ]
    batch = FrameBatch.from_rows([(0, 0, can_id, flags, 0, b"") for can_id, flags in ordered])
    assert (np.diff(rank(batch)) > 0).all()


@st.composite
def buses(draw: st.DrawFn) -> tuple[list[Sent], int, frozenset[int]]:
    nodes = draw(st.integers(2, 6))
    in_turn = frozenset(draw(st.sets(st.integers(1, nodes))))
    count = draw(st.integers(1, 30))
    requests = [SYNC]
    ids = st.sampled_from([0x81, 0x181, 0x281, 0x381, 0x581, 0x701])
    for _ in range(count):
        node = draw(st.integers(1, nodes))
        requests.append(
            Request(
                draw(st.integers(SYNC_END, 3_000_000)),
                draw(ids) + node - 1,
                node,
                draw(st.integers(47, 135)),
            )
        )
    step = draw(st.sampled_from([1, 1000, 10_000]))
    return Line(requests, in_turn).run(), step, in_turn


@given(buses())
def test_the_true_moment_lies_within_the_bounds(
    bus: tuple[list[Sent], int, frozenset[int]],
) -> None:
    sent, step, _ = bus
    recorded = seen(sent, step_ns=step)
    assert recorded.noise_ns == 0
    synced = sent[0].end_ns // step * step
    for row, each in enumerate(sent[1:], start=1):
        request = each.request
        ready, _ = recorded.ready(one(row, synced, request.can_id, request.node))
        device_ns = request.ready_ns - sent[0].end_ns
        assert ready.least_ns[0] <= device_ns + 1e-6
        assert each.start_ns - request.ready_ns <= ready.waiting_ns[0] + 1e-6
        if ready.free[0]:
            assert each.start_ns == request.ready_ns
