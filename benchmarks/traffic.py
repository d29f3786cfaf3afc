"""The bus that all benchmarks share: four nodes, 780 frames/s, made the same way every time."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata
from syncline_schemas.capture.writer import CaptureWriter

FRAMES_PER_SECOND = 780
START_NS = 1_760_000_000_000_000_000
NODES = (1, 2, 3, 4)
PDO_BYTES = {1: 4, 2: 8, 3: 4, 4: 8}
MICROSECOND = 1_000
MILLISECOND = 1_000_000


def traffic(frames: int) -> FrameBatch:
    """At least `frames` frames of a healthy bus in time order, cut to exactly that number.

    SYNC every 10 ms, TPDO1 of each node 0.3 to 1.5 ms after it, TPDO2 every 20 ms, heartbeats
    every 100 ms, an SDO read of 6004h about every 50 ms, an EMCY pair a minute. Stamps lie on a
    1 us grid, so that every log format can carry them.
    """
    rng = np.random.default_rng(301)
    seconds = frames // 780 + 2
    parts = [
        _periodic(rng, seconds, 10 * MILLISECOND, 0x080, 0, offset_us=0, spread_us=20),
        *(_tpdo1(rng, seconds, node) for node in NODES),
        *(_tpdo2(rng, seconds, node) for node in NODES),
        *(_heartbeat(rng, seconds, node) for node in NODES),
        *(_sdo(rng, seconds, node) for node in NODES),
        *(_emcy(rng, seconds, node) for node in NODES),
    ]
    whole = FrameBatch.concat(parts)
    return whole[np.argsort(whole.t_ns, kind="stable")[:frames]]


def write_candump(batch: FrameBatch, path: Path) -> None:
    """The batch as a `candump -L` log; plain Python, so that no code of ours is trusted."""
    with path.open("w", encoding="ascii", newline="\n") as out:
        columns = (batch.t_ns.tolist(), batch.can_id.tolist(), batch.dlc.tolist(), batch.data)
        for t_ns, can_id, dlc, data in zip(*columns, strict=True):
            second, rest = divmod(t_ns, 1_000_000_000)
            payload = data[:dlc].tobytes().hex().upper()
            out.write(f"({second}.{rest // 1000:06d}) can0 {can_id:03X}#{payload}\n")


def _frames(t_ns: NDArray[np.int64], can_id: int, data: NDArray[np.uint8]) -> FrameBatch:
    n, length = data.shape
    wide = np.zeros((n, 8), np.uint8)
    wide[:, :length] = data
    return FrameBatch(
        t_ns,
        np.zeros(n, np.uint8),
        np.full(n, can_id, np.uint32),
        np.zeros(n, np.uint16),
        np.full(n, length, np.uint8),
        wide,
    )


def _stamps(
    rng: np.random.Generator, seconds: int, period_ns: int, offset_us: int, spread_us: int
) -> NDArray[np.int64]:
    n = seconds * 1_000_000_000 // period_ns
    jitter = rng.integers(0, max(spread_us, 1), n) + offset_us
    return START_NS + np.arange(n, dtype=np.int64) * period_ns + jitter * MICROSECOND


def write_by_python_can(log: Path, path: Path) -> None:
    """The frames of a candump log in the format of a file's ending, written by python-can."""
    import can

    with can.LogReader(log) as reader, can.Logger(path) as writer:
        for message in reader:
            writer.on_message_received(message)


def write_recorded(frames: FrameBatch, path: Path) -> Path:
    """A capture as the recorder writes it without decoding: a chunk every second."""
    with path.open("wb") as stream:
        metadata = CaptureMetadata("0", "benchmark", clock="kernel")
        writer = CaptureWriter(stream, metadata, [BusInfo("can0", 0, 500_000, clock="kernel")])
        for start in range(0, len(frames), FRAMES_PER_SECOND):
            writer.write_chunk(frames[start : start + FRAMES_PER_SECOND])
        writer.finish()
    return path


def _periodic(
    rng: np.random.Generator,
    seconds: int,
    period_ns: int,
    can_id: int,
    length: int,
    *,
    offset_us: int,
    spread_us: int,
) -> FrameBatch:
    t_ns = _stamps(rng, seconds, period_ns, offset_us, spread_us)
    return _frames(t_ns, can_id, np.zeros((len(t_ns), length), np.uint8))


def _tpdo1(rng: np.random.Generator, seconds: int, node: int) -> FrameBatch:
    t_ns = _stamps(rng, seconds, 10 * MILLISECOND, 150 + 250 * node, 100)
    position = (np.arange(len(t_ns), dtype=np.uint32) * (37 * node)) % (1 << 17)
    data = np.zeros((len(t_ns), PDO_BYTES[node]), np.uint8)
    data[:, :4] = position.astype("<u4").view(np.uint8).reshape(-1, 4)
    return _frames(t_ns, 0x180 + node, data)


def _tpdo2(rng: np.random.Generator, seconds: int, node: int) -> FrameBatch:
    t_ns = _stamps(rng, seconds, 20 * MILLISECOND, 3000 + 300 * node, 200)
    data = rng.integers(0, 256, (len(t_ns), 6), np.uint8)
    return _frames(t_ns, 0x280 + node, data)


def _heartbeat(rng: np.random.Generator, seconds: int, node: int) -> FrameBatch:
    t_ns = _stamps(rng, seconds, 100 * MILLISECOND, 5000 + 300 * node, 150)
    return _frames(t_ns, 0x700 + node, np.full((len(t_ns), 1), 5, np.uint8))


def _sdo(rng: np.random.Generator, seconds: int, node: int) -> FrameBatch:
    t_ns = _stamps(rng, seconds, 200 * MILLISECOND, 7000 + 500 * node, 100)
    ask = np.tile(np.array([0x40, 0x04, 0x60, 0, 0, 0, 0, 0], np.uint8), (len(t_ns), 1))
    answer = np.tile(np.array([0x43, 0x04, 0x60, 0, 1, 2, 3, 0], np.uint8), (len(t_ns), 1))
    return FrameBatch.concat(
        [_frames(t_ns, 0x600 + node, ask), _frames(t_ns + 400 * MICROSECOND, 0x580 + node, answer)]
    )


def _emcy(rng: np.random.Generator, seconds: int, node: int) -> FrameBatch:
    t_ns = _stamps(rng, seconds, 60_000 * MILLISECOND, 9000 + 200 * node, 100)
    raised = np.tile(np.array([0x10, 0x43, 0x09, 0, 0, 0, 0, 0], np.uint8), (len(t_ns), 1))
    cleared = np.zeros((len(t_ns), 8), np.uint8)
    return FrameBatch.concat(
        [
            _frames(t_ns, 0x080 + node, raised),
            _frames(t_ns + 5_000 * MILLISECOND, 0x080 + node, cleared),
        ]
    )
