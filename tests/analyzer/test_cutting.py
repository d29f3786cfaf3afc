"""Where a capture is cut, by its reader or by the frames of another bus, changes no result."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from syncline_analyzer.bit_rates import BitRates
from syncline_analyzer.bus_batches import BusBatches
from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.context import Context
from syncline_analyzer.echo import BLOCK, COPY, Echoes
from syncline_analyzer.engine import analyze
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.bus.clock import MAX_SILENCES
from syncline_analyzer.folds.control import ControlFold, ControlTables
from syncline_analyzer.joining import JOINED_FRAMES
from syncline_analyzer.preparing import Step
from syncline_analyzer.results import Analysis
from syncline_analyzer.shadow import Shadow
from syncline_analyzer.spacings import SpacingGauge
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.description import BusDescription
from tests.analyzer.fuzz_invariants import placed, unlike
from tests.analyzer.timing_builder import MS
from tests.analyzer.whole_run import T0
from tests.analyzer.wire_builder import arbitrated, machine, recorded

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
    found = running(280, 10, 7)
    assert len(found) > JOINED_FRAMES, "two batches at least"
    return found


@pytest.fixture(scope="module")
def alone(long: FrameBatch) -> Analysis:
    return told([long])


def test_the_batches_of_a_reader_change_nothing(long: FrameBatch, alone: Analysis) -> None:
    for size in (1000, 1 << 16):
        assert not list(unlike(f"batches of {size}", alone, told([long], size=size)))


def of_control(whole: FrameBatch, size: int) -> ControlTables:
    """What the control folds tell of frames in batches of a size."""
    context = Context(["can0"], Shadow(lambda number: "can0"))
    fold = ControlFold(context)
    for at in range(0, len(whole), size):
        fold.update(IndexedBatch(whole[at : at + size], at))
    return fold.finish(int(whole.t_ns[-1]))


SIZES = (1, 7, 50)


def test_a_pdo_is_its_nodes_from_the_frame_on_that_binds_it() -> None:
    """It is a sign of life: when the node is silent begins with its last PDO."""
    beating = np.arange(0, 4 * S, 100 * MS)
    sent = np.arange(3 * MS, 4200 * MS, 20 * MS)
    asked = np.array([1 * S])
    back = np.arange(6 * S, 9 * S, 100 * MS)
    whole = in_order(
        frames(np.concatenate((beating, back)), 0x705, b"\x05"),
        frames(sent, 0x2A7, b"\1\2"),
        frames(asked, 0x605, b"\x40\x00\x18\x01\0\0\0\0"),
        frames(asked + MS, 0x585, b"\x43\x00\x18\x01\xa7\x02\0\0"),
        frames(np.arange(0, 9 * S, 50 * MS), 0x080),
    )
    for size in (*SIZES, len(whole)):
        (lost,) = [s for s in of_control(whole, size).nmt.states if s.state == "LOST"]
        assert lost.start_ns == T0 + sent[-1] + 150 * MS, size


def test_a_boot_up_that_is_understood_late_parts_the_pdos_at_its_frame() -> None:
    """Heartbeats that a remote frame emptied; the last 00h before states come again is a boot-up."""
    emptied = np.arange(0, 5 * S, 100 * MS)
    told = np.arange(5 * S, 9 * S, 100 * MS)
    asked = replace(frames(np.array([50 * MS]), 0x705), flags=np.array([2], np.uint16))
    whole = in_order(
        asked,
        frames(emptied, 0x705, [b"\x05"] + [b"\0"] * (len(emptied) - 1)),
        frames(told, 0x705, b"\x05"),
        frames(np.arange(3 * MS, 9 * S, 20 * MS), 0x185, b"\1\2"),
        frames(np.arange(0, 9 * S, 50 * MS), 0x080),
    )
    states = of_control(whole, len(whole)).nmt.states
    for size in SIZES:
        assert of_control(whole, size).nmt.states == states, size


def test_00h_before_a_request_waits_for_what_follows_it() -> None:
    """Requests behind it do not tell whether it is a boot-up: the next message does."""
    asked = [
        replace(frames(np.array([at * MS]), 0x705), flags=np.array([FrameFlag.REMOTE], np.uint16))
        for at in (20, 310)
    ]
    told = [
        frames(np.array([at * MS]), 0x705, byte)
        for at, byte in ((0, b"\5"), (150, b"\5"), (250, b"\0"), (450, b"\5"), (550, b"\5"))
    ]
    whole = in_order(*asked, *told)
    found = of_control(whole, len(whole)).nmt
    for size in (1, 5):
        nmt = of_control(whole, size).nmt
        assert (nmt.states, nmt.nodes[0, 5].counts) == (found.states, found.nodes[0, 5].counts)


def test_of_equal_silences_of_a_bus_the_first_are_kept() -> None:
    whole = frames(np.arange(3000, dtype=np.int64) * MS, 0x185, b"\1")
    kept = of_control(whole, len(whole)).clock.silences
    assert len(kept[0]) == MAX_SILENCES
    assert kept[0][-1].end_ns == T0 + MAX_SILENCES * MS
    for size in (1, 100):
        assert of_control(whole, size).clock.silences == kept


def test_what_follows_a_destroyed_frame_may_come_in_the_next_batch() -> None:
    often = np.arange(0, 2 * S, 10 * MS)
    hit = replace(
        frames(often[::5] + 9 * MS, 0x8, bytes(8)),
        flags=np.full(len(often[::5]), FrameFlag.ERROR, np.uint16),
    )
    whole = in_order(hit, frames(often + 100_000, 0x185, b"\1"), frames(often, 0x080))
    (stretch,) = of_control(whole, len(whole)).bus_errors.destroyed
    assert stretch.runs == len(hit)
    for size in SIZES:
        assert of_control(whole, size).bus_errors.destroyed == [stretch]


def test_time_is_told_alike() -> None:
    """One row a minute, and where it jumped or stood still."""
    every = np.arange(0, 400 * S, 100 * MS)
    says = every // MS + np.where(every > 90 * S, 5000, 0)
    says[1500:1600] = says[1500]
    data = [int(ms).to_bytes(4, "little") + b"\x10\x3a" for ms in says]
    whole = in_order(frames(every, 0x100, data), frames(every + MS, 0x705, b"\x05"))
    found = of_control(whole, len(whole)).time
    assert (len(found.jumps), len(found.stands)) == (2, 1)
    assert 7 <= len(found.rows) <= 10
    for size in (7, 333):
        assert of_control(whole, size).time == found


def test_more_lss_frames_than_are_listed_are_counted() -> None:
    whole = frames(np.arange(30_000, dtype=np.int64) * MS, 0x7E5, b"\x04\1\0\0\0\0\0\0")
    for size in (1000, len(whole)):
        assert of_control(whole, size).lss.beyond == 20_000


def test_a_bus_with_a_sync_that_is_too_long_now_and_then_is_canopen() -> None:
    beats = np.arange(0, 10 * S, 10 * MS)
    data = [b"\1\2" if n % 50 == 49 else b"" for n in range(len(beats))]
    for size in (30, len(beats)):
        assert of_control(frames(beats, 0x080, data), size).nmt.canopen == {0}


def test_the_bit_rate_is_found_from_the_same_frames() -> None:
    """Where the frames of a stream are cut does not show in its estimate."""
    ready = recorded(arbitrated(machine(250_000, 0.5, 70_000), 250_000), 1000, start_ns=T0)
    told_by = []
    for size in (5000, 1 << 16, 1 << 17):
        gauge, context = SpacingGauge(timed=True), Context(["can0"], Shadow(lambda _: "can0"))
        parts = [ready[at : at + size] for at in range(0, len(ready), size)]
        steps, seq = [], 0
        for part in parts:
            seq += len(part)
            spacings = gauge.measured(IndexedBatch(part, seq - len(part)))
            steps.append(Step(seq, [], spacings=spacings))
        facts = [CaptureFacts(Path("x"), "test", ["can0"], resolution_ns=1000)]
        list(BitRates(context, facts, None, None).settled([*steps, Step(seq, [], last=True)]))
        told_by.append(context.estimates["can0"])
    assert told_by[0].frames > 1000
    assert told_by == told_by[:1] * 3


def test_what_stands_twice_is_judged_in_blocks() -> None:
    """Batches of one block and of two tell the same, also of a stretch of copies within a block."""
    rng = np.random.default_rng(3)
    t_ns = np.cumsum(rng.integers(MS // 2, MS, 2 << 16))
    data = [int(n).to_bytes(2, "little") for n in np.arange(2 << 16) % 60_000]
    sent = frames(t_ns, 0x605, data)
    copies = FrameBatch.concat([sent[60_000:62_000], sent[66_000:100_000:2]])
    whole = in_order(sent, replace(copies, t_ns=copies.t_ns + 20_000))
    marks = []
    for size in (BLOCK, 2 * BLOCK):
        parts = [IndexedBatch(whole[at : at + size], at) for at in range(0, len(whole), size)]
        flags = [part.frames.flags for part in Echoes().marked(parts) if not isinstance(part, Gap)]
        marks.append(np.concatenate(flags))
    assert (marks[0] & COPY).any()
    assert (marks[0] == marks[1]).all()
    assert JOINED_FRAMES % BLOCK == 0


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
