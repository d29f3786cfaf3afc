"""A run in real time on a python-can bus, for recorders that listen to one."""

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from syncline_samples.machine import Run
from syncline_schemas.batch import FrameBatch, FrameFlag

if TYPE_CHECKING:
    import can


def play(run: Run, can_bus: "can.BusABC", speed: float = 1.0) -> int:
    """Send the frames of a run at their times; the number of frames sent.

    The messages carry the stamps of the run, which a virtual bus opened with
    `preserve_timestamps=True` hands on. A run whose epoch lies ahead begins then, else at once.

    Args:
        run: not yet streamed.
        speed: how many seconds of the run pass in one.
    """
    first_ns = run.scenario.epoch_ns
    begin = time.monotonic() + max(0, first_ns - time.time_ns()) / 1e9
    sent = 0
    for t_ns, message in _messages(run):
        wait = begin + (t_ns - first_ns) / 1e9 / speed - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        can_bus.send(message)
        sent += 1
    return sent


def _messages(run: Run) -> "Iterator[tuple[int, can.Message]]":
    for item in run.stream():
        if isinstance(item, FrameBatch):
            for row in range(len(item)):
                yield int(item.t_ns[row]), to_message(item, row)


def to_message(batch: FrameBatch, row: int) -> "can.Message":
    """One row as a python-can message."""
    import can

    flags = int(batch.flags[row])
    return can.Message(
        timestamp=int(batch.t_ns[row]) / 1e9,
        arbitration_id=int(batch.can_id[row]),
        is_extended_id=bool(flags & FrameFlag.EXTENDED),
        is_remote_frame=bool(flags & FrameFlag.REMOTE),
        is_error_frame=bool(flags & FrameFlag.ERROR),
        dlc=int(batch.dlc[row]),
        data=batch.payload(row),
    )
