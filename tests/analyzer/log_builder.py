"""Builders for the tests of readers and writers."""

from collections.abc import Iterator
from pathlib import Path

import can
from hypothesis import strategies as st

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers import open_capture
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap

PLAIN = FrameFlag(0)
T0_NS = 1_700_000_000_000_000_000
CAPTURES = Path(__file__).parents[3] / "shared" / "captures"

Row = tuple[int, int, int, int, int, bytes]


def read(path: Path, block_bytes: int = 1 << 20) -> tuple[FrameBatch, CaptureFacts, list[Gap]]:
    """All frames of a capture in one batch, its facts, and its gaps."""
    reader = open_capture(path, block_bytes=block_bytes)
    items = list(reader.batches())
    batch = FrameBatch.concat([item for item in items if isinstance(item, FrameBatch)])
    return batch, reader.facts, [item for item in items if isinstance(item, Gap)]


def read_text(
    tmp_path: Path, text: str | bytes, name: str = "capture"
) -> tuple[list[Row], CaptureFacts]:
    """Rows and facts of a log with this text."""
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    batch, facts, _ = read(path)
    return rows(batch), facts


def rows(batch: FrameBatch) -> list[Row]:
    """The frames as tuples, as `FrameBatch.from_rows` takes them."""
    return list(_rows(batch))


def _rows(batch: FrameBatch) -> Iterator[Row]:
    for i in range(len(batch)):
        yield (
            int(batch.t_ns[i]),
            int(batch.bus[i]),
            int(batch.can_id[i]),
            int(batch.flags[i]),
            int(batch.dlc[i]),
            batch.payload(i),
        )


def row(
    t_us: int = 0,
    can_id: int = 0x123,
    data: bytes = b"",
    *,
    bus: int = 0,
    flags: FrameFlag = PLAIN,
    dlc: int | None = None,
) -> Row:
    """One frame, `t_us` after `T0_NS`."""
    length = len(data) if dlc is None else dlc
    return (T0_NS + t_us * 1000, bus, can_id, int(flags), length, data)


FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


@st.composite
def frame_rows(
    draw: st.DrawFn,
    *,
    buses: int = 2,
    fd: bool = True,
    remote: bool = True,
    error: bool = True,
    back: bool = True,
    step_us: int = 1,
) -> list[Row]:
    """Frames of every kind that a format knows, in an order that may step back in time."""
    kinds = ["data"] * 3 + ["fd"] * fd + ["remote"] * remote + ["error"] * error
    listed = []
    t_us = 0
    for _ in range(draw(st.integers(1, 12))):
        t_us += step_us * draw(st.integers(0, 3_000_000))
        at_us = max(0, t_us - step_us * draw(st.integers(0, 1000))) if back else t_us
        kind = draw(st.sampled_from(kinds))
        flags = draw(st.sampled_from([FrameFlag(0), FrameFlag.TX]))
        can_id = draw(st.integers(0, 0x7FF))
        if draw(st.booleans()):
            can_id, flags = draw(st.integers(0, 0x1FFFFFFF)), flags | FrameFlag.EXTENDED
        data, dlc = draw(st.binary(max_size=8)), None
        if kind == "fd":
            length = draw(st.sampled_from(FD_LENGTHS))
            data = draw(st.binary(min_size=length, max_size=length))
            flags |= FrameFlag.FD | draw(
                st.sampled_from([FrameFlag(0), FrameFlag.BRS, FrameFlag.BRS | FrameFlag.ESI])
            )
        elif kind == "remote":
            data, dlc, flags = b"", draw(st.integers(0, 8)), flags | FrameFlag.REMOTE
        elif kind == "error":
            data, flags = draw(st.binary(min_size=8, max_size=8)), FrameFlag.ERROR
            can_id = draw(st.integers(0, 0x1FFFFFFF))
        bus = draw(st.integers(0, buses - 1))
        listed.append(row(at_us, can_id, data, bus=bus, flags=flags, dlc=dlc))
    return listed


def message(frame: Row) -> can.Message:
    """The same frame for python-can's writers."""
    t_ns, bus, can_id, bits, dlc, data = frame
    flags = FrameFlag(bits)
    return can.Message(
        timestamp=t_ns / 1e9,
        channel=bus,
        arbitration_id=can_id,
        is_extended_id=FrameFlag.EXTENDED in flags,
        is_remote_frame=FrameFlag.REMOTE in flags,
        is_error_frame=FrameFlag.ERROR in flags,
        is_fd=FrameFlag.FD in flags,
        bitrate_switch=FrameFlag.BRS in flags,
        error_state_indicator=FrameFlag.ESI in flags,
        is_rx=FrameFlag.TX not in flags,
        dlc=dlc,
        data=data,
    )
