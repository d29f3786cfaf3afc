"""What the fold carries from block to block, over gaps, and what buses keep apart."""

from dataclasses import asdict, replace

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_analyzer.results import Responses
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from tests.analyzer.timing_builder import context, learn, timing
from tests.analyzer.waiting_runs import US, Wish, answers, burst, sent_rows, syncs

COUNT = 60
T0 = 1_700_000_000_000_000_000
EVENTS = [0x181, 0x182, 0x383]


def wishes() -> list[Wish]:
    """Bursts ahead of two PDOs, and one frame behind them, at every third SYNC."""
    ahead = [w for k in range(0, COUNT, 3) for w in burst(k, EVENTS, 1, after_us=250)]
    behind = [w for k in range(1, COUNT, 3) for w in burst(k, [0x7E1], 0x61, after_us=280)]
    pdos = [*answers(COUNT, 0x285, 5), *answers(COUNT, 0x486, 6)]
    return [*syncs(COUNT), *pdos, *ahead, *behind]


def told(*buses: str) -> Context:
    ctx = context(resolution_ns=1000, buses=buses or ("can0",))
    for can_id in (*EVENTS, 0x285, 0x486):
        index = 0x1800 + ((can_id - 0x180) >> 8)
        learn(ctx, can_id & 0x7F, index, 1, can_id)
        learn(ctx, can_id & 0x7F, index, 2, 0xFE if can_id in EVENTS else 1)
    return ctx


def batch(listed: list[Wish], *, bus: int = 0) -> FrameBatch:
    frames = FrameBatch.from_rows(sent_rows(listed))
    return replace(frames, t_ns=frames.t_ns + T0, bus=np.full(len(frames), bus, np.uint8))


def merged(*parts: FrameBatch) -> FrameBatch:
    whole = FrameBatch.concat(parts)
    return whole[np.argsort(whole.t_ns, kind="stable")]


def responses(tables: TimingTables, cob_id: int, bus: str = "can0") -> Responses:
    return next(r for r in tables.responses if (r.bus, r.cob_id) == (bus, cob_id))


def test_where_blocks_end_changes_nothing() -> None:
    frames = batch(wishes())
    whole = timing(told(), frames)
    cut = timing(told(), frames, size=7, block_frames=11)
    assert len(whole.delays) > 4
    assert cut.delays == whole.delays
    assert cut.waits == whole.waits
    assert cut.lateness == whole.lateness
    for cob_id in (0x285, 0x486):
        one, other = responses(whole, cob_id), responses(cut, cob_id)
        assert one.device_least_us.tolist() == other.device_least_us.tolist()
        assert one.waiting_us.tolist() == other.waiting_us.tolist()


def test_the_delays_are_the_time_of_the_frames_ahead() -> None:
    """Each third SYNC 285h waits for three frames at most; 486h for 285h besides."""
    tables = timing(told(), batch(wishes()))
    by_id = {row.cob_id: row for row in tables.delays if row.cob_id is not None}
    of_node = {row.node: row for row in tables.delays if row.cob_id is None}
    assert {0x181, 0x182, 0x285, 0x383} <= set(by_id)
    assert by_id[0x181].service == "TPDO1"
    assert by_id[0x7E1].service == "other"
    assert by_id[0x182].node == 2
    assert of_node[1].us == by_id[0x181].us
    assert by_id[0x285].delayed == by_id[0x285].frames
    assert by_id[0x285].worst_cob_id == 0x486
    worst = max(tables.waits, key=lambda row: row.waiting_us)
    assert (worst.cob_id, worst.node, worst.pdo) == (0x486, 6, "TPDO4")
    assert {each.cob_id for each in worst.ahead} == {0x181, 0x182, 0x285, 0x383}
    assert sum(each.us for each in worst.ahead) >= worst.waiting_us - 10


def test_nothing_is_concluded_over_a_gap() -> None:
    """The gap swallows a SYNC and what was ahead of its answer."""
    frames = batch(wishes())
    at = int(np.flatnonzero(frames.can_id == 0x182)[3])
    gap = Gap(int(frames.t_ns[at - 1]) + 1, int(frames.t_ns[at]) - 1, "adapter lost")
    tables = timing(told(), frames[slice(0, at)], gap, frames[slice(at, len(frames))])
    found = responses(tables, 0x285)
    assert len(found.seq) == COUNT - 1
    assert (found.device_least_us <= found.device_high_us).all()


def test_buses_do_not_wait_for_one_another() -> None:
    """The second bus carries twice as much at the same moments."""
    noise = [w for k in range(COUNT) for w in burst(k, [0x101, 0x102, 0x103] * 4, 1, after_us=200)]
    alone = timing(told(), batch(wishes()))
    both = timing(
        told("can0", "can1"), merged(batch(wishes()), batch([*syncs(COUNT), *noise], bus=1))
    )
    one, other = responses(alone, 0x486), responses(both, 0x486)
    assert one.waiting_us.tolist() == other.waiting_us.tolist()
    assert one.device_least_us.tolist() == other.device_least_us.tolist()
    assert [replace(row, worst_seq=0) for row in alone.delays] == [
        replace(row, worst_seq=0) for row in both.delays if row.bus == "can0"
    ]


def test_an_error_frame_between_makes_the_bounds_wide() -> None:
    listed = [*syncs(COUNT), *answers(COUNT, 0x285, 5)]
    frames = batch(listed)
    assert (responses(timing(told(), frames), 0x285).waiting_us == 0).all()
    errors = frames[np.flatnonzero(frames.can_id == 0x285)]
    errors = replace(
        errors,
        t_ns=errors.t_ns - 300 * US,
        can_id=np.full(len(errors), 0x88, np.uint32),
        flags=np.full(len(errors), FrameFlag.ERROR, np.uint16),
    )
    broken = responses(timing(told(), merged(frames, errors)), 0x285)
    assert len(broken.seq) == COUNT
    assert (broken.device_least_us == 0).all()
    assert (broken.waiting_us > 200).all()


def test_a_frame_of_29_bits_loses_against_11_bits_of_the_same_beginning() -> None:
    """1214xxxxh begins with 485h; it was under way when 486h became ready."""
    listed = [*syncs(COUNT), *answers(COUNT, 0x486, 6)]
    frames = batch(listed)
    pdos = frames[np.flatnonzero(frames.can_id == 0x486)]
    wide = replace(
        pdos,
        t_ns=pdos.t_ns - 246 * US,
        can_id=np.full(len(pdos), 0x485 << 18, np.uint32),
        flags=np.full(len(pdos), FrameFlag.EXTENDED, np.uint16),
    )
    tables = timing(told(), merged(frames, wide))
    ahead = [each for row in tables.waits for each in row.ahead]
    assert {(each.cob_id, each.service, each.node) for each in ahead} == {
        (0x485 << 18, "29-bit", None)
    }


def test_rows_hold_only_figures_that_are_told() -> None:
    tables = timing(told(), batch(wishes()))
    rows = [asdict(row) for table in (tables.waits, tables.delays) for row in table]
    rows += [asdict(row) for row in tables.lateness]
    figures = [value for row in rows for value in row.values() if isinstance(value, float)]
    assert np.isfinite(figures).all()
