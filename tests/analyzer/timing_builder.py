"""Frames on a time line, and folds run over them; every test states only what differs."""

from collections.abc import Iterable, Sequence

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.angle.fold import AngleFold, AngleTables
from syncline_analyzer.folds.timing.fold import TimingFold
from syncline_analyzer.folds.timing.silences import Silences
from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_analyzer.results import NmtStateRow
from syncline_analyzer.shadow import Known, Shadow, Source
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device, load_device

T0 = 1_700_000_000_000_000_000
MS = 1_000_000
US = 1_000
SECOND = 1_000_000_000

Row = tuple[int, int, int, int, int, bytes]


def frame(t_ns: int, can_id: int, data: bytes = b"", *, bus: int = 0, flags: int = 0) -> Row:
    """A frame so many ns after the start."""
    return T0 + t_ns, bus, can_id, flags, len(data), data


def syncs(times_ns: Iterable[int], can_id: int = 0x80) -> list[Row]:
    return [frame(t, can_id) for t in times_ns]


def ordered(*parts: Iterable[Row]) -> FrameBatch:
    """All frames in order of time."""
    rows = [row for part in parts for row in part]
    return FrameBatch.from_rows(sorted(rows, key=lambda row: row[0]))


def context(
    *,
    bitrate: int | None = 500_000,
    timed: bool = True,
    resolution_ns: int = 1,
    devices: dict[int, str | Device] | None = None,
    description: BusDescription | None = None,
    buses: Sequence[str] = ("can0",),
) -> Context:
    names = list(buses)
    loaded = {node: load_device(device) for node, device in (devices or {}).items()}
    return Context(
        names,
        Shadow(lambda bus: names[bus], description, loaded),
        timed,
        {} if bitrate is None else dict.fromkeys(names, bitrate),
        resolution_ns,
        description or BusDescription(),
    )


def learn(
    ctx: Context,
    node: int,
    index: int,
    sub: int,
    value: int,
    *,
    seq: int = 0,
    t_ns: int = 0,
    source: Source = "sdo-read",
    bus: int = 0,
) -> None:
    """Let the shadow have seen a value."""
    ctx.shadow.learn(bus, node, index, sub, Known(value, source, seq, T0 + t_ns))


def batches(frames: FrameBatch, size: int, *, timed: bool = True) -> list[IndexedBatch]:
    """The frames in batches of a size."""
    return [
        IndexedBatch(frames[slice(at, at + size)], at, timed=timed)
        for at in range(0, len(frames), size)
    ]


def timing(
    ctx: Context,
    *parts: FrameBatch | Gap,
    states: Sequence[NmtStateRow] | None = None,
    size: int = 1 << 20,
    block_frames: int = 1 << 16,
) -> TimingTables:
    """The timing tables of frames and gaps in order."""
    fold, silences = (
        TimingFold(ctx, block_frames),
        Silences(timed=ctx.timed, block_frames=block_frames),
    )
    seq = end_ns = 0
    for part in parts:
        if isinstance(part, Gap):
            fold.gap(part)
            silences.gap(part)
            continue
        for batch in batches(part, size, timed=ctx.timed):
            indexed = IndexedBatch(batch.frames, seq, timed=ctx.timed)
            fold.update(indexed)
            silences.update(indexed)
            seq += len(batch)
        end_ns = int(part.t_ns[-1]) if len(part) else end_ns
    silences.close()
    return fold.finish(end_ns, states, silence=silences.found)


def angles(
    ctx: Context, *parts: FrameBatch | Gap, size: int = 1 << 20, block_frames: int = 1 << 16
) -> AngleTables:
    """The angle tables of frames and gaps in order."""
    fold = AngleFold(ctx, block_frames)
    seq = end_ns = 0
    for part in parts:
        if isinstance(part, Gap):
            fold.gap(part)
            continue
        for batch in batches(part, size, timed=ctx.timed):
            fold.update(IndexedBatch(batch.frames, seq, timed=ctx.timed))
            seq += len(batch)
        end_ns = int(part.t_ns[-1]) if len(part) else end_ns
    return fold.finish(end_ns)


def state(node: int, name: str, start_ns: int, end_ns: int) -> NmtStateRow:
    return NmtStateRow("can0", node, name, T0 + start_ns, T0 + end_ns, "test", "observed", None)


def position(*counts: int, bits: int = 32) -> bytes:
    """Counts as a PDO carries them."""
    return b"".join((c & ((1 << bits) - 1)).to_bytes(bits // 8, "little") for c in counts)


def regular(count: int, period_ns: int, start_ns: int = 0) -> list[int]:
    return (np.arange(count) * period_ns + start_ns).tolist()
