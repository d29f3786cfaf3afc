"""Runs of the SDO fold alone, over frames that tests encode."""

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.sdo.fold import SdoFold, SdoTable
from syncline_analyzer.shadow import Shadow
from syncline_schemas.batch import FrameBatch
from syncline_schemas.devices import Device

Row = tuple[int, int, int, int, int, bytes]
"""As `FrameBatch.from_rows` takes them."""


def sdo_frame(t_us: float, side: str, node: int, data: bytes, *, bus: int = 0) -> Row:
    """A frame of the client (">") or the server ("<")."""
    can_id = (0x600 if side == ">" else 0x580) + node
    return (round(t_us * 1000), bus, can_id, 0, len(data), data)


def fold_table(
    rows: list[Row],
    *,
    batch: int = 1 << 20,
    timed: bool = True,
    devices: dict[int, Device] | None = None,
) -> SdoTable:
    """What the SDO fold makes of frames, fed in batches of so many."""
    buses = ["can0", "can1"]
    context = Context(buses, Shadow(lambda number: buses[number], None, devices), timed=timed)
    fold = SdoFold(context)
    for start in range(0, len(rows), batch):
        frames = FrameBatch.from_rows(rows[start : start + batch])
        fold.update(IndexedBatch(frames, start, timed=timed))
    return fold.finish(rows[-1][0] if rows else 0)
