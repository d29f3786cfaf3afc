"""The bounded buffer between readers and the writer."""

import threading
from itertools import count

from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_logger.batcher import MAX_LOSSES, FrameBuffer, Loss
from syncline_schemas.batch import FrameBatch, FrameFlag

Row = tuple[int, int, int, int, int, bytes]


def buffer(capacity: int = 100, notify_rows: int = 1000) -> FrameBuffer:
    ticks = count(1)
    return FrameBuffer(lambda: next(ticks), capacity, notify_rows)


def rows_of(frames: FrameBatch) -> list[Row]:
    return [
        (
            int(frames.t_ns[n]),
            int(frames.bus[n]),
            int(frames.can_id[n]),
            int(frames.flags[n]),
            int(frames.dlc[n]),
            frames.data[n, : frames.dlc[n]].tobytes(),
        )
        for n in range(len(frames))
    ]


frames = st.builds(
    lambda t_ns, bus, can_id, flags, data: (t_ns, bus, can_id, flags, len(data), data),
    st.integers(1, 2**62),
    st.integers(0, 255),
    st.integers(0, 2**29 - 1),
    st.sampled_from([0, int(FrameFlag.EXTENDED), int(FrameFlag.FD | FrameFlag.BRS)]),
    st.one_of(st.binary(max_size=8), st.binary(min_size=12, max_size=64)),
)


@given(st.lists(frames, max_size=40), st.lists(st.integers(0, 40), max_size=3))
@settings(max_examples=150)
def test_what_goes_in_comes_out_in_order(rows: list[Row], takes: list[int]) -> None:
    into = buffer()
    out: list[Row] = []
    for position, row in enumerate(rows):
        if position in takes:
            out += rows_of(into.take().frames)
        into.append(*row)
    assert out + rows_of(into.take().frames) == rows


@given(st.lists(frames, max_size=40))
@settings(max_examples=50)
def test_a_batch_goes_in_like_its_frames(rows: list[Row]) -> None:
    one_by_one, at_once = buffer(), buffer()
    for row in rows:
        one_by_one.append(*row)
    at_once.extend(FrameBatch.from_rows(rows))
    assert rows_of(at_once.take().frames) == rows_of(one_by_one.take().frames)


def test_a_frame_without_a_stamp_takes_the_recorders_time() -> None:
    into = buffer()
    into.append(0, 0, 0x181, 0, 1, b"\x05")
    into.append(77, 0, 0x181, 0, 1, b"\x05")
    taken = into.take()
    assert taken.log_ns.tolist() == [1, 2]
    assert taken.frames.t_ns.tolist() == [1, 77]


def test_narrow_again_after_fd_frames() -> None:
    into = buffer()
    into.append(1, 0, 1, int(FrameFlag.FD), 64, bytes(range(64)))
    assert into.take().frames.data.shape == (1, 64)
    into.append(2, 0, 1, 0, 2, b"ab")
    assert into.take().frames.data.shape == (1, 8)


def test_frames_without_room_are_counted_by_bus() -> None:
    into = buffer(capacity=2)
    for bus in (0, 1, 1, 0, 1):
        into.append(1, bus, 0x100, 0, 0, b"")
    taken = into.take()
    assert taken.frames.bus.tolist() == [0, 1]
    assert taken.losses == [
        Loss(0, "queue", 1, 4, 4, 4),
        Loss(1, "queue", 2, 3, 5, 5),
    ]
    assert not into.take().losses


def test_a_batch_without_room_is_counted_by_bus() -> None:
    into = buffer(capacity=3)
    into.extend(FrameBatch.from_rows([(1, bus, 0x100, 0, 0, b"") for bus in (0, 1, 1, 1, 0)]))
    taken = into.take()
    assert len(taken) == 3
    assert {loss.bus: loss.frames for loss in taken.losses} == {0: 1, 1: 1}


def test_losses_elsewhere_are_kept_with_their_times() -> None:
    into = buffer()
    into.lose(1, 5, "kernel", 1000, 2000)
    into.lose(1, None, "controller", 1000, 1500)
    into.lose(1, 7, "kernel", 2500, 3000)
    into.lose(1, 1, "kernel", 10**9, 10**9 + 5)
    assert into.take().losses == [
        Loss(1, "controller", None, 1000, 1500, 2),
        Loss(1, "kernel", 12, 1000, 3000, 3),
        Loss(1, "kernel", 1, 10**9, 10**9 + 5, 4),
    ]


def test_losses_without_end_take_no_memory_without_end() -> None:
    into = buffer()
    for second in range(3000):
        into.lose(0, 2, "kernel", second * 10**9, second * 10**9 + 1)
    losses = into.take().losses
    assert len(losses) == MAX_LOSSES
    assert sum(loss.frames or 0 for loss in losses) == 6000


def test_it_tells_when_enough_waits() -> None:
    into = buffer(notify_rows=2)
    into.append(1, 0, 1, 0, 0, b"")
    assert not into.filled.is_set()
    into.append(1, 0, 1, 0, 0, b"")
    assert into.filled.is_set()
    into.take()
    assert not into.filled.is_set()


def test_threads_lose_nothing() -> None:
    into = FrameBuffer(lambda: 1, 40_000)

    def fill(bus: int) -> None:
        for n in range(10_000):
            into.append(n + 1, bus, n, 0, 0, b"")

    threads = [threading.Thread(target=fill, args=(bus,)) for bus in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    taken = into.take().frames
    for bus in range(4):
        assert taken.can_id[taken.bus == bus].tolist() == list(range(10_000))
