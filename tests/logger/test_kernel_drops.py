"""The drop counter against a queue of our own that drops what has no room."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_logger.sources.kernel_drops import Dropped, KernelDrops

MS = 1_000_000


def take(drops: KernelDrops, *frames: tuple[int, int]) -> list[Dropped]:
    """Frames as (counter, milliseconds)."""
    return drops.take(
        np.array([counter for counter, _ in frames], np.uint32),
        np.array([t_ms * MS for _, t_ms in frames], np.int64),
    )


def test_a_loss_lies_between_the_frames_around_it() -> None:
    drops = KernelDrops(0)
    assert take(drops, (0, 10), (0, 20), (5, 30), (5, 40)) == [Dropped(5, 20 * MS, 30 * MS)]
    assert take(drops, (5, 50), (7, 60)) == [Dropped(2, 50 * MS, 60 * MS)]
    assert take(drops, (8, 70)) == [Dropped(1, 60 * MS, 70 * MS)]
    assert take(drops) == []


def test_losses_near_each_other_are_one_stretch() -> None:
    frames = [(0, 0), (1, 10), (1, 20), (3, 30), (3, 500), (4, 510)]
    assert take(KernelDrops(0), *frames) == [
        Dropped(3, 0, 30 * MS),
        Dropped(1, 500 * MS, 510 * MS),
    ]


def test_what_was_dropped_behind_the_last_frame() -> None:
    drops = KernelDrops(0)
    take(drops, (0, 10))
    assert drops.settle(4, 90 * MS) == Dropped(4, 10 * MS, 90 * MS)
    assert drops.settle(4, 95 * MS) is None
    # This frame waited already when the socket was asked.
    assert take(drops, (2, 40), (6, 100)) == [Dropped(2, 40 * MS, 100 * MS)]


def test_the_counter_starts_again_after_four_billion() -> None:
    drops = KernelDrops(0)
    for counter in (2**31 - 1, 2**32 - 2):
        take(drops, (counter, 1))
    assert take(drops, (3, 2)) == [Dropped(5, 1 * MS, 2 * MS)]


@pytest.mark.parametrize("start", [0, 2**32 - 5, 2**31 - 5])
@given(
    steps=st.lists(st.sampled_from(["arrive", "arrive", "arrive", "read", "ask"]), max_size=80),
    room=st.integers(1, 4),
)
@settings(max_examples=100)
def test_received_and_lost_are_all(start: int, steps: list[str], room: int) -> None:
    drops = KernelDrops(0)
    told = received = sent = 0
    if start:
        # The signed difference must stay below 2**31 on the way there.
        for counter in (start // 2, start):
            told += sum(each.frames for each in take(drops, (counter, 0)))
            received, sent = received + 1, sent + 1
        sent += start
    counter = start
    queue: list[tuple[int, int]] = []
    for now, step in enumerate([*steps, "read", "ask"]):
        if step == "arrive":
            sent += 1
            if len(queue) < room:
                queue.append((counter & 0xFFFFFFFF, now))
            else:
                counter += 1
        elif step == "read":
            received += len(queue)
            told += sum(each.frames for each in take(drops, *queue))
            queue.clear()
        else:
            settled = drops.settle(counter & 0xFFFFFFFF, now * MS)
            told += settled.frames if settled else 0
    assert received + told == sent
