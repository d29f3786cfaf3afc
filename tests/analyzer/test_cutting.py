"""Where a capture is cut, by its reader or by the frames of another bus, changes no result."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from syncline_analyzer.bus_batches import BusBatches
from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.engine import analyze
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.results import Analysis
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.description import BusDescription
from tests.analyzer.fuzz_invariants import placed, unlike
from tests.analyzer.timing_builder import MS
from tests.analyzer.whole_run import T0

NODES = (3, 5, 9)
S = 1000 * MS
Ints = np.ndarray[tuple[int], np.dtype[np.int64]]


def frames(t_ns: Ints, can_id: int, data: Sequence[bytes] | bytes = b"") -> FrameBatch:
    """A frame of an identifier at each of these times, which count from the start."""
    each = [data] * len(t_ns) if isinstance(data, bytes) else list(data)
    payload = np.array([list(one.ljust(8, b"\0")) for one in each], np.uint8).reshape(-1, 8)
    return FrameBatch(
        t_ns + T0,
        np.zeros(len(t_ns), np.uint8),
        np.full(len(t_ns), can_id, np.uint32),
        np.zeros(len(t_ns), np.uint16),
        np.array([len(one) for one in each], np.uint8),
        payload,
    )


def in_order(*parts: FrameBatch) -> FrameBatch:
    whole = FrameBatch.concat(parts)
    return whole[np.argsort(whole.t_ns, kind="stable")]


def running(seconds: int, sync_ms: float, seed: int) -> FrameBatch:
    """A bus whose SYNC is restless now and then, whose answers miss, and whose nodes err."""
    rng = np.random.default_rng(seed)
    beats = np.arange(round(seconds * 1000 / sync_ms), dtype=np.int64)
    sync = round(sync_ms * MS) * beats + rng.normal(0, 0.02 * sync_ms * MS, len(beats)).astype(int)
    sync += np.where(beats // 100 % 9 == 4, rng.integers(-1, 2, len(beats)), 0) * MS
    parts = [frames(sync, 0x80, [bytes([1 + n % 240]) for n in range(len(beats))])]
    for place, node in enumerate(NODES):
        said = rng.random(len(beats)) > 0.001
        answers = sync[said] + (
            300_000 * (place + 1) + rng.gamma(2.0, 40_000.0, said.sum())
        ).astype(int)
        turned = np.arange(len(answers)) * 7 % 4096
        parts.append(frames(answers, 0x180 + node, [int(n).to_bytes(4, "little") for n in turned]))
        often = np.arange(20 * MS, seconds * S, (37 + place) * MS)
        parts.append(frames(often + rng.integers(0, MS, len(often)), 0x280 + node, b"\1\2"))
        beating = np.arange(5 * MS, seconds * S, 100 * MS)
        parts.append(frames(beating + rng.integers(0, 2 * MS, len(beating)), 0x700 + node, b"\x05"))
        asked = np.arange(1500 * MS, seconds * S, 11 * S) + place * 50 * MS
        parts.append(frames(asked, 0x600 + node, b"\x40\x18\x10\x01\0\0\0\0"))
        parts.append(frames(asked + 2 * MS, 0x580 + node, b"\x43\x18\x10\x01\x78\x56\x34\x12"))
        erring = np.arange(3 * S, seconds * S, 13 * S) + place * S
        parts.append(frames(erring, 0x80 + node, b"\x10\x81\x11\0\0\0\0\0"))
        parts.append(frames(erring + 700 * MS, 0x80 + node, bytes(8)))
    switched = np.arange(20 * S, seconds * S, 45 * S)
    parts.append(frames(switched, 0x000, b"\x80\x03"))
    parts.append(frames(switched + 40 * MS, 0x000, b"\x01\x03"))
    parts.append(frames(switched + 50 * MS, 0x7E5, b"\x04\0\0\0\0\0\0\0"))
    return in_order(*parts)


def told(
    items: Sequence[FrameBatch | Gap],
    *,
    size: int | None = None,
    buses: tuple[str, ...] = ("can0",),
) -> Analysis:
    """The analysis of a stream that is read in batches of a size."""
    facts = CaptureFacts(Path("run.log"), "test", list(buses))
    stream: list[tuple[int, FrameBatch | Gap]] = []
    seq = 0
    for item in items:
        if isinstance(item, Gap):
            stream.append((seq, item))
            continue
        step = size or max(len(item), 1)
        stream += [(seq + at, item[at : at + step]) for at in range(0, len(item), step)]
        seq += len(item)
    return analyze(
        stream, [facts], list(buses), description=BusDescription(), devices={}, bitrate=500_000
    )


@pytest.fixture(scope="module")
def long() -> FrameBatch:
    found = running(260, 10, 7)
    assert len(found) > 2 << 16, "three blocks at least"
    return found


@pytest.fixture(scope="module")
def alone(long: FrameBatch) -> Analysis:
    return told([long])


def test_the_batches_of_a_reader_change_nothing(long: FrameBatch, alone: Analysis) -> None:
    for size in (1000, 1 << 16):
        assert not list(unlike(f"batches of {size}", alone, told([long], size=size)))


def merged(long: FrameBatch, seconds: int) -> tuple[FrameBatch, Ints]:
    """Both buses in one capture, and where the frames of the first are in it."""
    other = running(seconds, 7.3, 23)
    other = replace(other, bus=np.ones_like(other.bus), t_ns=other.t_ns + 100)
    both = FrameBatch.concat([long, other])
    order = np.argsort(both.t_ns, kind="stable")
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    return both[order], place


def differing(alone: Analysis, analysis: Analysis, place: Ints) -> Iterator[str]:
    """Where the rows of the first bus are not those of its own capture."""
    for name in (each.name for each in fields(Analysis)):
        expected = getattr(alone, name)
        if expected and isinstance(expected, list):
            mine = [row for row in getattr(analysis, name) if row.bus != "can1"]
            yield from unlike(name, placed(expected, place), mine)


@pytest.mark.parametrize("seconds", [240, 20])
def test_another_bus_changes_nothing_of_this_one(
    long: FrameBatch, alone: Analysis, seconds: int
) -> None:
    """It may be as busy, or be heard for a while only."""
    both, place = merged(long, seconds)
    analysis = told([both], buses=("can0", "can1"))
    assert list(differing(alone, analysis, place)) == []


def test_a_gap_of_another_bus_changes_nothing_of_this_one(
    long: FrameBatch, alone: Analysis
) -> None:
    both, place = merged(long, 240)
    cut = int(np.searchsorted(both.t_ns, T0 + 111 * S))
    gap = Gap(int(both.t_ns[cut - 1]), int(both.t_ns[cut]), "overrun", 3, 1)
    analysis = told([both[:cut], gap, both[cut:]], buses=("can0", "can1"))
    assert list(differing(alone, analysis, place)) == []


def test_batches_of_a_bus_are_cut_by_its_own_frames_alone() -> None:
    numbers = np.array([0, 1, 0, 0, 2, 0, 0, 0, 1, 0], np.uint8)
    whole = frames(np.arange(10, dtype=np.int64), 0x181)
    whole = replace(whole, bus=numbers)
    batches = BusBatches(timed=True, frames=3)
    parts = IndexedBatch(whole[:6], 100), IndexedBatch(whole[6:], 106)
    found = [*batches.add(parts[0]), *batches.add(parts[1]), *batches.flush(1)]
    assert [batch.seqs.tolist() for batch in found] == [
        [100, 102, 103],
        [105, 106, 107],
        [101, 108],
    ]
    assert [batch.seqs.tolist() for batch in batches.flush()] == [[109], [104]]
    assert list(batches.flush()) == []
