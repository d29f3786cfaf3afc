"""Whatever is on the bus: no fold raises, no number is impossible."""

import numpy as np
import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.angle.fold import AngleFold
from syncline_analyzer.folds.control import ControlFold
from syncline_analyzer.folds.timing.fold import TimingFold
from syncline_analyzer.folds.timing.silences import Silences
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from tests.analyzer.timing_builder import T0, context

IDS = [0, 0x80, 0x81, 0x181, 0x182, 0x18A, 0x28A, 0x38A, 0x333, 0x601, 0x581, 0x60A, 0x58A, 0x701]
OBJECTS = [0x1005, 0x1007, 0x1019, 0x1800, 0x1801, 0x1A00, 0x2040, 0x6000, 0x6001, 0x6002, 0x6003]


def noise(rng: np.random.Generator, count: int) -> FrameBatch:
    """Random frames, among them SDO transfers that set parameters to random values."""
    can_id = rng.choice(np.array(IDS, np.uint32), count)
    kinds = [0] * 6 + [FrameFlag.EXTENDED, FrameFlag.REMOTE, FrameFlag.ERROR, FrameFlag.FD]
    dlc = rng.integers(0, 9, count).astype(np.uint8)
    data = rng.integers(0, 256, (count, 8)).astype(np.uint8)
    sdo = np.flatnonzero((can_id > 0x580) & (can_id < 0x680))
    index = rng.choice(np.array(OBJECTS), len(sdo))
    data[sdo, 0] = rng.choice(np.array([0x23, 0x43, 0x4B, 0x60, 0x80], np.uint8), len(sdo))
    data[sdo, 1], data[sdo, 2] = index & 0xFF, index >> 8
    data[sdo, 3] = rng.integers(0, 4, len(sdo))
    dlc[sdo] = 8
    data[np.arange(8) >= dlc[:, None]] = 0
    return FrameBatch(
        T0 + np.cumsum(rng.integers(-1_000_000, 10_000_000, count)),
        rng.integers(0, 2, count).astype(np.uint8),
        can_id,
        rng.choice(np.array(kinds, np.uint16), count),
        dlc,
        data,
    )


def any_context(rng: np.random.Generator) -> Context:
    devices = {1: "lir-da158", 2: "haomiao-38", 10: "jn2100"} if rng.random() < 0.5 else {}
    return context(
        devices=dict(devices),
        bitrate=125_000 if rng.random() < 0.8 else None,
        timed=bool(rng.random() < 0.9),
        resolution_ns=int(rng.choice([1, 1000, 10_000_000])),
        buses=("can0", "can1"),
    )


@pytest.mark.parametrize("seed", range(40))
def test_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ctx = any_context(rng)
    block = int(rng.integers(1, 300))
    silences = Silences(timed=ctx.timed, block_frames=block)
    folds = (ControlFold(ctx), TimingFold(ctx, block), AngleFold(ctx, block), silences)
    _, timing, angle, _ = folds
    seq = 0
    for _ in range(4):
        frames = noise(rng, int(rng.integers(0, 200)))
        for fold in folds:
            fold.update(IndexedBatch(frames, seq, timed=ctx.timed))
            if rng.random() < 0.1:
                fold.gap(Gap(T0, T0 + 1, "overrun", bus=int(rng.integers(0, 2))))
        seq += len(frames)
    tables, angles = timing.finish(T0, silence=silences.found), angle.finish(T0)
    for row in tables.pdos:
        for quantiles in (row.period_us, row.response_us, row.device_us_low, row.device_us_high):
            assert quantiles is None or 0 <= quantiles.min <= quantiles.median <= quantiles.max
    for responses in tables.responses:
        low, high = responses.device_low_us, responses.device_high_us
        assert ((low <= high) | np.isnan(low)).all()
        assert responses.histogram.sum() == len(responses.seq)
    for trace in angles.trace_data:
        assert (np.diff(trace.seq) > 0).all()
        assert (np.diff(trace.segment) >= 0).all()
