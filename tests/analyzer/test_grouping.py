"""A batch indexed once, against plain loops over its frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.grouping import Grouping, key_of
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.wire_length import wire_bits

pytestmark = pytest.mark.usefixtures("both_ways")

_FLAGS = st.sampled_from(
    [0, 0, 0, FrameFlag.REMOTE, FrameFlag.EXTENDED, FrameFlag.ERROR, FrameFlag.FD, FrameFlag.TX]
)
_ROW = st.tuples(
    st.integers(0, 1000),
    st.sampled_from([0, 1, 2, 200]),
    st.sampled_from([0, 0x80, 0x81, 0x181, 0x182, 0x581, 0x601, 0x701, 0x702, 0x7FF]),
    _FLAGS,
    st.integers(0, 8),
)
_ROWS = st.lists(_ROW, max_size=60)


def batch_of(rows: list[tuple[int, int, int, int, int]]) -> FrameBatch:
    return FrameBatch.from_rows((*row, bytes(range(row[4]))) for row in rows)


@given(_ROWS, st.integers(0, 5000))
@settings(deadline=None)
def test_the_index_is_what_a_loop_finds(
    rows: list[tuple[int, int, int, int, int]], seq0: int
) -> None:
    batch = IndexedBatch(batch_of(rows), seq0)
    no_data = FrameFlag.EXTENDED | FrameFlag.ERROR | FrameFlag.REMOTE | FrameFlag.FD
    expected: dict[tuple[int, int], list[int]] = {}
    for number, (_, bus, can_id, flags, _) in enumerate(rows):
        if not flags & no_data:
            expected.setdefault((bus, can_id), []).append(number)
    assert {key: batch.rows(*key).tolist() for key in batch.ids()} == expected
    assert batch.ids() == sorted(expected)
    assert batch.buses == sorted({row[1] for row in rows})
    for key, places in expected.items():
        assert batch.t_ns_of(*key).tolist() == [rows[place][0] for place in places]
        assert batch.seqs_of(*key).tolist() == [seq0 + place for place in places]
        lengths = [rows[place][4] for place in places]
        assert batch.lengths[key] == (min(lengths), max(lengths))
    assert len(batch.rows(7, 0x181)) == len(batch.t_ns_of(7, 0x181)) == 0
    assert batch.lengths.keys() == expected.keys()


@given(_ROWS, st.booleans())
@settings(deadline=None)
def test_rows_of_a_service_come_in_order(
    rows: list[tuple[int, int, int, int, int]], remote: bool
) -> None:
    batch = IndexedBatch(batch_of(rows))
    wanted = (Service.PDO, Service.ERROR_CONTROL)
    other = FrameFlag.EXTENDED | FrameFlag.ERROR | FrameFlag.FD
    expected = [
        number
        for number, (_, _, can_id, flags, _) in enumerate(rows)
        if not flags & other
        and bool(flags & FrameFlag.REMOTE) == remote
        and SERVICE_OF_ID[can_id] in wanted
    ]
    assert batch.rows_of(*wanted, remote=remote).tolist() == expected


def test_many_rows_and_high_bus_numbers_are_sorted_the_same_way() -> None:
    rng = np.random.default_rng(5)
    count = 70_000
    frames = FrameBatch(
        np.arange(count, dtype=np.int64),
        rng.choice(np.array([0, 3, 250], np.uint8), count),
        rng.integers(0, 0x800, count).astype(np.uint32),
        rng.choice(np.array([0, FrameFlag.REMOTE], np.uint16), count),
        np.zeros(count, np.uint8),
        np.zeros((count, 8), np.uint8),
    )
    for some in (frames, frames[:60_000], frames[frames.bus == 0][:20_000]):
        grouping, key = Grouping.of(some), key_of(some)
        order = np.argsort(key, kind="stable")
        assert np.array_equal(grouping.rows, order)
        assert np.array_equal(grouping.key, key[order])
        assert np.array_equal(grouping.keys, np.unique(key))
        assert np.array_equal(grouping.t_ns, some.t_ns[order])


_INT64 = np.iinfo(np.int64)
_STAMPS = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 40) | st.integers(_INT64.min, _INT64.max))
)


@given(_STAMPS, st.integers(0, 12))
@settings(deadline=None)
def test_frames_soon_behind_another_are_those_of_a_loop(
    stamps: list[tuple[int, int]], limit_ns: int
) -> None:
    grouping = Grouping.of(FrameBatch.from_rows((t, 0, i, 0, 0, b"") for i, t in stamps))
    ordered = [(i, t) for i in range(4) for of, t in stamps if of == i]
    expected = [
        place
        for place in range(1, len(ordered))
        if ordered[place][0] == ordered[place - 1][0]
        # Stamps count modulo 2**64, as the distance of two may be more than an int64.
        and (ordered[place][1] - ordered[place - 1][1]) % 2**64 <= limit_ns
    ]
    assert grouping.soon(limit_ns).tolist() == expected


def test_parts_are_the_same_frames() -> None:
    rows = [(10 * n, 0, 0x181 + n % 3, 0, n % 9) for n in range(40)]
    whole = IndexedBatch(batch_of(rows), 100)
    assert whole.part(slice(0, 40)) is whole
    assert whole.of_bus(0) is whole
    part = whole.part(slice(7, 20))
    assert (part.seq0, part.last_seq, part.seqs.tolist()) == (107, 119, [*range(107, 120)])
    joined = IndexedBatch.joined([whole.part(slice(0, 7)), part])
    assert not joined.scattered
    assert joined.seqs.tolist() == [*range(100, 120)]
    apart = IndexedBatch.joined([part, whole.part(slice(30, 40))])
    assert apart.seqs.tolist() == [*range(107, 120), *range(130, 140)]
    bits = wire_bits(whole.frames)
    assert np.array_equal(whole.wire_bits, bits)
    assert whole.ascending
    assert not IndexedBatch(whole.frames[np.array([3, 1])]).ascending
