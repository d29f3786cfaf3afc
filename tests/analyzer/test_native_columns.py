"""Compiled columns of the timing analyses are those of numpy, bit for bit."""

import pickle
from collections import Counter
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.sdo.pairs import SdoFrames
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.pdo import running
from syncline_analyzer.folds.timing.pdo_columns import PdoColumns
from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.repeats import Repeats, Runs
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_analyzer.series import Thinner, extreme_rows
from syncline_schemas import native
from syncline_schemas.batch import FrameBatch

pytestmark = pytest.mark.skipif(not native.available(), reason="the library is not built")

SEEDS = st.integers(0, 2**32 - 1)


def both(ask: "Ask") -> tuple[object, object]:
    """What the library tells, and what numpy does."""
    ours = ask()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "available", lambda: False)
        return ours, ask()


class Ask:
    """Something to be computed anew at each call, from one seed."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    @property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng(self.seed)

    def __call__(self) -> object:
        raise NotImplementedError


class Spread(Ask):
    """A distribution of values in several parts, some far away from most."""

    def __call__(self) -> object:
        rng, spread = self.rng, Distribution(moments=bool(self.seed % 2))
        for _ in range(4):
            values = rng.normal(1e6, 10.0 ** rng.integers(0, 6), 5000)
            values[rng.random(5000) < 0.01] *= rng.choice([1e-3, 1e6])
            values = np.abs(values)
            spread.add(values if self.seed % 3 else values.astype(np.int64))
        counts, edges = spread.histogram()
        quantiles = [spread.quantile(share) for share in (0.0, 0.01, 0.5, 0.99, 1.0)]
        return counts.tolist(), edges.tolist(), quantiles, spread.mean, spread.std


class Peaks(Ask):
    """Extreme rows of numbers some of which are equal, infinite or none."""

    def __call__(self) -> object:
        rng = self.rng
        values = rng.integers(0, 5, int(rng.integers(1, 200))).astype(np.float64)
        for each in (np.nan, np.inf, -np.inf):
            if rng.random() < 0.5:
                values[rng.random(len(values)) < rng.random()] = each
        return extreme_rows(values, int(rng.integers(1, 12))).tolist()


class Thinned(Ask):
    """Columns over time, added in parts some of which are empty; not all can be thinned compiled."""

    def __call__(self) -> object:
        rng = self.rng
        kept, found = Thinner("value", 4 * int(rng.integers(1, 8))), []
        types: list[type[np.generic]] = [
            (np.int64, np.float64)[kind] for kind in rng.integers(0, 2, 3)
        ]
        more = rng.random() < 0.2
        if rng.random() < 0.2:
            types[1] = np.uint8
        for part in rng.integers(0, rng.choice([5, 6000]), int(rng.integers(1, 8))):
            values = rng.integers(0, 9, part), np.arange(2 * part)[:: rng.integers(1, 3)][:part]
            columns = {
                name: column.astype(dtype)
                for name, column, dtype in zip(
                    ("value", "row", "bound"), (*values, values[1]), types, strict=True
                )
            }
            if types[0] == np.float64:
                columns["value"][rng.random(part) < 0.1] = np.nan
            if more and rng.random() < 0.5:
                del columns["bound"]
            kept.add(columns)
            now = kept.columns()
            found.append({name: (str(now[name].dtype), now[name].tolist()) for name in now})
        return found


class Pdos(Ask):
    """Columns of the PDOs of a block with SYNCs, after some or no frames before."""

    def __call__(self) -> object:
        rng = self.rng
        count = int(rng.integers(20, 400))
        ids, shares = [0x80, 0x181, 0x182, 0x281, 0x701], rng.dirichlet(np.full(5, 0.5))
        can_id = rng.choice(ids, count, p=shares).astype(np.uint32)
        can_id[:3] = (0x80, 0x181, 0x281)
        data = rng.integers(0, 2, (count, 8)).astype(np.uint8)
        t_ns = 10**18 + np.cumsum(rng.integers(-(10**3), 10**6, count))
        nothing = np.zeros(count, np.uint8)
        frames = FrameBatch(
            t_ns, nothing, can_id, nothing.astype(np.uint16), nothing + np.uint8(8), data
        )
        block = Block(IndexedBatch(frames, 100))
        states = [PdoState(), PdoState()]
        for state in states:
            if rng.random() < 0.7:
                state.last_ns, state.rhythm.last = 10**18 - 5, int(rng.integers(0, 9))
        places = [block.batch.place(0, each) for each in (0x181, 0x281)]
        columns, sync = PdoColumns(block, places, states), index(block, int(rng.integers(-1, 500)))
        after = columns.after(sync)
        found: list[object] = [columns.runs, after.responses, after.phases.tolist()]
        for number, place in enumerate(places):
            found += [columns.periods[place].tolist(), columns.period_limits(number)]
            found += [after.position[place].tolist(), after.since[place].tolist()]
            found.append(columns.steps(sync, number))
        return [*found, sync.before.tolist()]


class Sums(Ask):
    """Numbers added up from a first one on, beyond what 64 bits hold."""

    def __call__(self) -> object:
        rng = self.rng
        most = int(rng.choice([10, 2**63 - 1]))
        values = rng.integers(-most - 1, most, int(rng.integers(0, 50)), endpoint=True)
        return running(values, int(rng.integers(-most, most))).tolist()


class SdoPairs(Ask):
    """Plain SDO transfers among frames of three channels that mostly fit together."""

    def __call__(self) -> object:
        rng = self.rng
        count = int(rng.integers(0, 300))
        data = rng.integers(0, 2, (count, 8)).astype(np.uint8)
        data[:, 0] = rng.choice([0x40, 0x43, 0x4F, 0x2F, 0x23, 0x60, 0x80], count)
        data[:, 2] = rng.choice([0x10, 0x12, 0x20], count)
        if rng.random() < 0.5:
            data[:, 1:4] = data[:1, 1:4]
        length = np.where(rng.random(count) < 0.1, 7, 8).astype(np.uint8)
        channel = rng.integers(0, 3, count).astype(np.uint16)
        request = np.isin(data[:, 0], (0x40, 0x2F, 0x23)) ^ (rng.random(count) < 0.1)
        place, ids = np.arange(count), np.zeros(count, np.int16)
        frames = SdoFrames(place, place, length, data, channel, request, ids)
        return [places.tolist() for places in frames.pairs()]


def index(block: Block, first_ordinal: int) -> SyncIndex:
    rows = block.batch.rows(0, 0x80)
    t_ns = np.concatenate(([0], block.frames.t_ns[rows]))
    nothing = np.zeros(len(t_ns), np.int64)
    return SyncIndex(
        rows,
        first_ordinal,
        True,
        t_ns,
        nothing,
        nothing,
        nothing == 0,
        nothing != 0,
        0.0,
        nothing,
        len(block.batch),
    )


@pytest.mark.parametrize("kind", [Spread, Peaks, Thinned, Pdos, Sums, SdoPairs])
@given(seed=SEEDS)
@settings(max_examples=60, deadline=None)
def test_columns_are_those_of_numpy(kind: type[Ask], seed: int) -> None:
    ours, theirs = both(kind(seed))
    np.testing.assert_equal(ours, theirs)


@given(data=st.lists(st.integers(0, 2), min_size=1), cuts=st.sets(st.integers(1, 40)))
def test_repeats_are_those_of_the_whole_line(data: list[int], cuts: set[int]) -> None:
    repeats, words = Repeats(), np.array(data, np.uint64) << np.uint64(63)
    for part in np.split(words, sorted(cut for cut in cuts if cut < len(data))):
        table, rows = np.array([[0, len(part)]]), np.arange(len(part))
        found = Runs(*native.runs(table, rows, part.view(np.uint8).reshape(-1, 8)).tolist()[0])
        assert found == Runs.of(part)
        repeats.add(found)
    runs = [len(list(group)) for _, group in groupby(words.tolist())]
    assert (repeats.count, repeats.longest) == (len(data) - len(runs), max(runs))


def test_a_spread_goes_on_in_another_process() -> None:
    """Arrays that stand behind a message are views of its bytes."""
    values = np.random.default_rng(0).normal(1e6, 1e3, 20_000)
    here = Distribution()
    here.add(values)
    buffers: list[pickle.PickleBuffer] = []
    sent = pickle.dumps(here, 5, buffer_callback=buffers.append)
    there = pickle.loads(sent, buffers=[bytearray(each.raw()) for each in buffers])
    for each in (here, there):
        each.add(values[::-1].copy())
    assert there.quantile(0.3) == here.quantile(0.3)
    assert there.std == here.std


STAMPS = st.integers(-(2**63), 2**63 - 1) | st.integers(0, 100)


@given(t_ns=st.lists(STAMPS, max_size=40), limit_ns=st.integers(0, 60))
def test_times_between_frames_are_those_of_numpy(t_ns: list[int], limit_ns: int) -> None:
    column = np.array(t_ns, np.int64)
    apart = column[1:] - column[:-1]
    later = (np.flatnonzero(apart > limit_ns) + 1).tolist()
    assert native.later(column, limit_ns).tolist() == later
    assert native.sooner(column, limit_ns) == np.count_nonzero((apart >= 0) & (apart < limit_ns))


@given(
    spaced=st.lists(st.tuples(st.integers(-2, 60) | STAMPS, st.integers(0, 30)), min_size=1),
    frames=st.integers(1, 5),
    within_ns=st.integers(0, 50),
)
def test_close_spacings_are_those_of_a_plain_loop(
    spaced: list[tuple[int, int]], frames: int, within_ns: int
) -> None:
    frames = min(frames, len(spaced))
    sums = []
    for first in range(len(spaced) - frames + 1):
        each = spaced[first : first + frames]
        if min(apart_ns for apart_ns, _ in each) >= 0:
            sums.append(tuple(map(sum, zip(*each, strict=True))))
    # As 64 bits hold them.
    sums = [((time_ns + 2**63) % 2**64 - 2**63, bits) for time_ns, bits in sums]
    apart_ns, bits = np.array(spaced, np.int64).T
    close_ns, close_bits, lengths = native.close_runs(apart_ns, bits, frames, 1.5, within_ns)
    close = [(time_ns, bits) for time_ns, bits in sums if time_ns - bits * 1.5 <= within_ns]
    assert list(zip(close_ns.tolist(), close_bits.tolist(), strict=True)) == close
    assert Counter(np.repeat(np.arange(len(lengths)), lengths).tolist()) == Counter(
        bits for _, bits in sums
    )


def test_rows_outside_are_refused() -> None:
    column = np.arange(4)
    data, place = np.zeros((4, 8), np.uint8), np.array([[0, 1]])
    for row in (4, -1):
        with pytest.raises(ValueError, match="columns of other"):
            native.runs(place, np.array([row]), data)
    with pytest.raises(ValueError, match="columns of other"):
        native.runs(place, column, data[:, :7])
    for places in ([[2, 5]], [[-1, 2]], [[2, 2]], [[3, 1]]):
        with pytest.raises(ValueError, match="columns of other"):
            native.differences(np.array(places), column, column[:1])
    for marks_ns, last, kind in ((3, 1, 0), (5, 2, 0), (5, 1, 7), (5, 1, -1)):
        with pytest.raises(ValueError, match="columns of other"):
            native.after(
                *(place, column, column, column, np.zeros(marks_ns, np.int64)),
                *(np.zeros(last, np.int64), kind, 7),
            )
    for bits, frames in ((column, 0), (column, 5), (column - 1, 2), (column[:3], 2)):
        with pytest.raises(ValueError, match="columns of other"):
            native.close_runs(column, bits, frames, 1.0, 1.0)
    with pytest.raises(ValueError, match="columns of other"):
        native.before(np.array([2, 1]), 4)
    with pytest.raises(ValueError, match="columns of other"):
        native.before(np.array([5]), 4)
    for run, count in ((0, 4), (2, 5), (2, -1)):
        with pytest.raises(ValueError, match="columns of other"):
            native.thinned([{"key": column}], "key", run, count)
    with pytest.raises(ValueError, match="columns of other"):
        native.thinned([{"key": column, "other": column[:3]}], "key", 2, 4)
