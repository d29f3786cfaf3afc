"""Frames on one wire: who stands ready when, and when each frame has passed."""

from collections.abc import Iterable, Sequence
from heapq import heappop, heappush
from random import Random
from typing import NamedTuple

from syncline_samples.wire import wire_bits
from syncline_schemas.batch import FrameBatch


class Ready(NamedTuple):
    """A frame that stands ready at a time [ns]."""

    t_ns: float
    can_id: int
    data: bytes


class Sent(NamedTuple):
    """A frame that has passed: its end [ns], its bits with intermission, and what it was."""

    end_ns: float
    bits: int
    can_id: int = 0
    data: bytes = b""


def arbitrated(ready: Iterable[Ready], bitrate: int) -> list[Sent]:
    """The frames as they pass the wire: the lowest identifier first whenever it is free."""
    waiting: list[tuple[int, int, Ready]] = []
    sent: list[Sent] = []
    bit_ns, free_ns = 1e9 / bitrate, 0.0
    rest = sorted(ready)
    at = 0
    while at < len(rest) or waiting:
        if not waiting:
            free_ns = max(free_ns, rest[at].t_ns)
        while at < len(rest) and rest[at].t_ns <= free_ns:
            heappush(waiting, (rest[at].can_id, at, rest[at]))
            at += 1
        _, _, frame = heappop(waiting)
        bits = wire_bits(frame.can_id, frame.data)
        sent.append(Sent(free_ns + (bits - 3) * bit_ns, bits, frame.can_id, frame.data))
        free_ns += bits * bit_ns
    return sent


def machine(
    bitrate: int,
    load: float,
    count: int = 3000,
    *,
    seed: int = 1,
    lengths: Sequence[int] = (0, 1, 2, 4, 8, 8, 8),
) -> list[Ready]:
    """Nodes that send by their own clocks and on a SYNC, so often that they make this load."""
    rng = Random(seed)
    ids = rng.sample(range(0x181, 0x580), 12)
    sizes = [rng.choice(lengths) for _ in ids]
    mean_bits = sum(55 + 9 * size for size in sizes) / len(sizes)
    period = len(ids) * mean_bits * 1e9 / bitrate / load
    ready: list[Ready] = []
    for number, (can_id, size) in enumerate(zip(ids, sizes, strict=True)):
        clock = 1 + rng.gauss(0, 5e-5)
        start = rng.random() * period if number % 2 else 50_000 + 1000 * rng.random()
        for k in range(count // len(ids)):
            ready.append(Ready(start + k * period * clock, can_id, rng.randbytes(size)))
    return ready


def recorded(sent: Iterable[Sent], step_ns: int = 1, *, start_ns: int = 0) -> FrameBatch:
    """The batch of a recorder whose stamps have this step."""
    return FrameBatch.from_rows(
        (
            start_ns + int(each.end_ns) // step_ns * step_ns,
            0,
            each.can_id,
            0,
            len(each.data),
            each.data,
        )
        for each in sent
    )
