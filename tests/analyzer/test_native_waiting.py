"""Compiled loops of arbitration and waiting against plain loops, and against numpy, bit for bit."""

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.folds.timing.delay_sums import DelaySums
from syncline_analyzer.folds.timing.device_times import DeviceTimes
from syncline_analyzer.folds.timing.senders import Sender, _seen, _sent_by
from syncline_analyzer.folds.timing.waiting import (
    MASTER,
    UNKNOWN,
    Arbitration,
    Asked,
    Ready,
    close_ns,
    rank,
)
from syncline_analyzer.folds.timing.waiting_bus import BusBlock, Carried
from syncline_schemas import native
from syncline_schemas.batch import FrameBatch, FrameFlag

pytestmark = pytest.mark.skipif(not native.available(), reason="the library is not built")

SEEDS = st.integers(0, 2**32 - 1)
FAR = (np.iinfo(np.int64).min, np.iinfo(np.int64).max)


@contextmanager
def alone() -> Iterator[None]:
    """Numpy without the library."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "available", lambda: False)
        yield


def frames_of(rng: np.random.Generator, count: int, bit_ns: float) -> Carried:
    """Frames back to back or not, some of which are errors, and stamps that step back or swing."""
    error = rng.random(count) < rng.choice([0.0, 0.1])
    bits = rng.integers(47, 135, count)
    apart = bits * bit_ns + rng.choice([0, 0, 0, 5, 60, -20, -900], count) * bit_ns
    t_ns = 10**18 + np.cumsum(apart.astype(np.int64))
    if rng.random() < 0.2:
        t_ns[rng.integers(0, count, 2)] = FAR
    can_id = rng.choice([0x80, 0x181, 0x182, 0x285, 0x583, 0x701], count).astype(np.uint32)
    kinds = [0, 0, 0, int(FrameFlag.REMOTE), int(FrameFlag.EXTENDED)]
    flags = rng.choice(kinds[: int(rng.choice([1, 4, 5]))], count).astype(np.uint16)
    flags[error] |= np.uint16(FrameFlag.ERROR)
    nothing = np.zeros(count, np.uint8)
    batch = FrameBatch(t_ns, nothing, can_id, flags, nothing, np.zeros((count, 8), np.uint8))
    sender = (can_id & 0x7F).astype(np.int16)
    sender[rng.random(count) < rng.choice([0.0, 0.2])] = rng.choice([UNKNOWN, MASTER, 2])
    untold = rng.random(count) < rng.choice([0.0, 0.05])
    wire_ns = np.where(error | untold, np.nan, bits * bit_ns)
    return Carried(100 + np.arange(count), t_ns, can_id, flags, wire_ns, rank(batch), sender)


def bus_of(carried: Carried, bit_ns: float, slack_ns: float) -> Arbitration:
    return Arbitration(
        carried.t_ns,
        carried.wire_ns,
        carried.rank,
        carried.sender,
        bit_ns=bit_ns,
        noise_ns=slack_ns,
    )


def asked_of(rng: np.random.Generator, carried: Carried) -> Asked:
    """Answers of a few PDOs to any SYNCs before or behind them, each row one at most."""
    count = len(carried.seq)
    pdos = int(rng.integers(1, 5))
    rows = rng.permutation(count)[: int(rng.integers(pdos, count))]
    parts = [np.sort(part) for part in np.array_split(rows, pdos)]
    sync_rows = np.sort(rng.integers(-1, count, int(rng.integers(1, 6))))
    low = rng.integers(0, 10**6, len(rows)).astype(np.float64)
    return Asked(
        np.cumsum([0, *map(len, parts[:-1])]),
        rng.choice([0x181, 0x285, 0x701], pdos).astype(np.uint32) << np.uint32(21),
        rng.choice([UNKNOWN, MASTER, 1, 5], pdos).astype(np.int16),
        np.concatenate(parts),
        rng.integers(0, len(sync_rows), len(rows)),
        sync_rows,
        carried.t_ns.take(sync_rows) - rng.integers(0, 1000, len(sync_rows)),
        low,
        low + rng.integers(0, 10**6, len(rows)),
    )


def told(ready: Ready) -> list[object]:
    return [getattr(ready, name).tolist() for name in Ready.__slots__]


def cases(seed: int) -> tuple[np.random.Generator, Carried, Arbitration, float]:
    rng = np.random.default_rng(seed)
    bit_ns = float(rng.choice([1000.0, 2000.0, 1e9 / 33_333]))
    # The compiled loops take some thousands of rows at a time.
    count = int(rng.integers(5, 80)) if rng.random() < 0.95 else 9_000
    carried = frames_of(rng, count, bit_ns)
    return rng, carried, bus_of(carried, bit_ns, float(rng.choice([0.0, 5000.0]))), bit_ns


def last_by_hand(bus: Arbitration, row: int, pdo_rank: int, node: int, itself: bool) -> int:
    """Back from a row, frame by frame, as `Arbitration.last_without` tells in words."""
    sound = np.isfinite(bus._wire_ns)
    own = False
    for at in range(row, -1, -1):
        if bus.idle[at]:
            return at
        lower = at > 0 and int(bus.rank[at]) > pdo_rank
        if node <= MASTER or own or not lower or (at == row and not itself):
            continue
        others = bus.sender[at] != node and bus.sender[at - 1] != node
        if others and bus.exact[at] and sound[at - 1] and bus.sender[at] != UNKNOWN:
            return at
        own = at < row and bus.sender[at] == node
    return -1


@given(seed=SEEDS, itself=st.booleans(), stopped=st.booleans())
@settings(max_examples=200, deadline=None)
def test_the_walk_back_is_that_of_a_plain_loop(seed: int, itself: bool, stopped: bool) -> None:
    rng, carried, bus, _ = cases(seed)
    rows = rng.integers(0, len(carried.seq), 30)
    ranks = rng.choice([0x181, 0x285, 0x701], 30).astype(np.uint32) << np.uint32(21)
    senders = rng.choice([UNKNOWN, MASTER, 1, 2, 5], 30).astype(np.int16)
    stops = rng.integers(-1, len(carried.seq), 30) if stopped else np.full(30, -1)
    expected = [
        max(last_by_hand(bus, row, pdo, node, itself), stop)
        for row, pdo, node, stop in zip(
            *(c.tolist() for c in (rows, ranks, senders, stops)), strict=True
        )
    ]
    given = stops if stopped else None
    assert bus.last_without(rows, ranks, senders, given, itself=itself).tolist() == expected
    with alone():
        assert bus.last_without(rows, ranks, senders, given, itself=itself).tolist() == expected


@given(seed=SEEDS)
@settings(max_examples=200, deadline=None)
def test_moments_and_figures_are_those_of_numpy(seed: int) -> None:
    rng, carried, bus, _ = cases(seed)
    asked = asked_of(rng, carried)
    ready, figures = bus.ready(asked)
    with alone():
        plain, plain_figures = bus.ready(asked)
    np.testing.assert_equal(told(ready), told(plain))
    assert figures == plain_figures


def block_of(carried: Carried, bus: Arbitration) -> BusBlock:
    """A block of which all 11-bit identifiers are told."""
    names = {(id_, remote): Sender(3, "PDO") for id_ in range(2048) for remote in (False, True)}
    return BusBlock(0, carried, bus, cast(Any, None), names)


def summed(carried: Carried, bus: Arbitration, asked: Asked, ready: Ready) -> list[object]:
    """What two blocks tell of the waiting of each PDO."""
    sums, names = DelaySums(), [0x180 + number for number in range(len(asked.starts))]
    for _ in range(2):
        sums.add(block_of(carried, bus), names, asked, ready)
    return [(vars(each)["by_key"], vars(each)["by_sender"]) for each in map(sums.of, names)]


@given(seed=SEEDS, part=st.sampled_from([1, 3, 4096]))
@settings(max_examples=200, deadline=None)
def test_sums_of_waiting_are_those_of_numpy(seed: int, part: int) -> None:
    rng, carried, bus, _ = cases(seed)
    asked = asked_of(rng, carried)
    ready, _ = bus.ready(asked)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("syncline_analyzer.folds.timing.delay_sums._AT_ONCE", part)
        ours = summed(carried, bus, asked, ready)
        with alone():
            assert ours == summed(carried, bus, asked, ready)


def test_several_frames_of_a_sender_are_one_delay() -> None:
    """Of three answers, the first waits for 80h, 583h and 583h again, the second for one of these."""
    can_id = np.array([0x80, 0x583, 0x583, 0x181, 0x583, 0x182], np.uint32)
    nothing = np.zeros(6, np.uint16)
    sender = np.array([0, 3, 3, 1, 3, 2], np.int16)
    wire_ns = np.array([100.0, 200.0, 300.0, 50.0, 450.0, 50.0])
    carried = Carried(np.arange(6), np.arange(6), can_id, nothing, wire_ns, can_id, sender)
    rows, first = np.array([3, 5]), np.array([0, 4])
    ready = Ready(wire_ns[:2], wire_ns[:2], first, first < 0, first >= 0)
    ranks = np.array([0x181, 0x182], np.uint32) << np.uint32(21)
    starts, senders = np.array([0, 1]), np.array([1, 2], np.int16)
    asked = Asked(starts, ranks, senders, rows, rows, rows, rows, wire_ns, wire_ns)
    sums = DelaySums()
    sums.add(block_of(carried, bus_of(carried, 1.0, 0.0)), [0x181, 0x182], asked, ready)
    one, other = sums.of(0x181).by_sender, sums.of(0x182).by_sender
    assert [(n, d.frames, d.delayed, d.ns, d.worst_ns, d.worst_seq) for n, d in one.items()] == [
        (0, 1, 1, 100.0, 100.0, 3),
        (3, 2, 1, 500.0, 500.0, 3),
    ]
    assert [(d.frames, d.delayed, d.worst_ns, d.worst_seq) for d in other.values()] == [
        (1, 1, 450.0, 5)
    ]


@given(seed=SEEDS)
@settings(max_examples=100, deadline=None)
def test_identifiers_and_distances_are_those_of_numpy(seed: int) -> None:
    _, carried, bus, bit_ns = cases(seed)

    def asked() -> list[object]:
        block = block_of(carried, bus)
        close = close_ns(carried.t_ns, carried.wire_ns, bit_ns)
        return [block.names, block.places.tolist(), close.tolist()]

    ours = asked()
    with alone():
        assert ours == asked()


@given(seed=SEEDS)
@settings(max_examples=100, deadline=None)
def test_senders_are_those_of_a_plain_loop(seed: int) -> None:
    rng, carried, _, _ = cases(seed)
    can_id = np.where(carried.flags & FrameFlag.EXTENDED, 0x1FFFFF85, carried.can_id)
    nothing = np.zeros(len(can_id), np.uint8)
    frames = FrameBatch(
        carried.t_ns, nothing, can_id.astype(np.uint32), carried.flags, nothing, nothing[:, None]
    )
    node = rng.integers(-1, 128, 4096).astype(np.int16)
    others = FrameFlag.EXTENDED | FrameFlag.ERROR | FrameFlag.FD
    senders, ids = [], set()
    for each, flags in zip(can_id.tolist(), carried.flags.tolist(), strict=True):
        place = each + 2048 * bool(flags & FrameFlag.REMOTE)
        senders.append(UNKNOWN if flags & others else int(node[place]))
        ids |= set() if flags & others else {place}

    def asked() -> list[object]:
        return [_sent_by(frames, node).tolist(), set(np.flatnonzero(_seen(frames)).tolist())]

    assert asked() == [senders, ids]
    with alone():
        assert asked() == [senders, ids]


@given(seed=SEEDS)
@settings(max_examples=100, deadline=None)
def test_sdo_beside_answers_is_that_of_a_plain_loop(seed: int) -> None:
    rng, carried, bus, _ = cases(seed)
    block, rows = block_of(carried, bus), np.flatnonzero(np.isin(carried.can_id, (0x181, 0x583)))
    since_ns = carried.t_ns.take(rows) - rng.choice([0, 10**5, 10**6], len(rows))
    since_ns[since_ns == FAR[0]] += 1
    sdo = (carried.can_id == 0x583) & (carried.flags == 0)
    expected = []
    for row, since in zip(rows.tolist(), since_ns.tolist(), strict=True):
        before = np.flatnonzero(sdo[:row])
        expected.append(bool(len(before)) and int(carried.t_ns[before[-1]]) >= since)
    assert block.sdo_since(3, rows, since_ns).tolist() == expected
    with alone():
        assert block.sdo_since(3, rows, since_ns).tolist() == expected


@given(seed=SEEDS)
@settings(max_examples=100, deadline=None)
def test_bounds_of_devices_are_those_of_numpy(seed: int) -> None:
    rng, carried, _, bit_ns = cases(seed)
    count, asked = len(carried.seq), asked_of(rng, carried)
    numbers = rng.integers(-(10**6), 10**12, (4, count))
    numbers[:, rng.random(count) < 0.1] = rng.choice(FAR)
    answers = SimpleNamespace(
        starts=asked.starts,
        rows=asked.rows,
        position=asked.position,
        response=numbers[0].take(asked.rows),
        sync=SimpleNamespace(bits=numbers[1][: len(asked.sync_rows)]),
    )
    times = DeviceTimes.__new__(DeviceTimes)
    times._sent, times._block = numbers[2], cast(Any, SimpleNamespace(wire_bits=numbers[3]))
    times._slack_ns = float(rng.choice([0.0, 500.0]))
    ours = times._bounds(cast(Any, answers), bit_ns)
    with alone():
        np.testing.assert_equal(ours, times._bounds(cast(Any, answers), bit_ns))


def test_rows_outside_are_refused() -> None:
    rng, carried, bus, _ = cases(1)
    asked, count = asked_of(rng, carried), len(carried.seq)
    for wrong in (-1, count, FAR[1]):
        rows = asked.rows.copy()
        rows[0] = wrong
        refused(bus, asked._replace(rows=rows))
        refused(bus, asked._replace(sync_rows=asked.sync_rows * 0 - 2))
        refused(bus, asked._replace(position=asked.position + len(asked.sync_rows)))
        refused(bus, asked._replace(starts=asked.starts + 1))
        with pytest.raises(ValueError, match="columns of other"):
            bus.last_without(rows, rows.astype(np.uint32), rows.astype(np.int16))
    ready, _ = bus.ready(asked)
    one = {name: getattr(asked, name)[:1] for name in ("starts", "ranks", "senders")}
    backwards = asked._replace(rows=asked.rows[::-1], **one)
    with pytest.raises(ValueError, match="columns of other"):
        DelaySums().add(block_of(carried, bus), [1], backwards, ready)


def refused(bus: Arbitration, asked: Asked) -> None:
    with pytest.raises(ValueError, match="columns of other"):
        bus.ready(asked)
