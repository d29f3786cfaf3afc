"""A day of one bus, recorded in segments, analyzed as one session: `python -m benchmarks.day`.

Issue 7, outcomes 2 and 3. A 500 kbit/s bus at 40 % load: SYNC every 5 ms, two encoders and five
inclinometers, 2,080 frames/s; 24 hours in 288 segments are 180 million frames and 5 GB of disk.
The whole process `syncline analyze --out` is measured, report and .rrd included, and the same of a
tenth of the segments: with `--hours 24` the cost of a frame may not be more than 15 % higher.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.cases import cpu_s
from benchmarks.full_bus import SECOND_NS, full_second, shifted
from benchmarks.memory import PeakMemory
from benchmarks.traffic import START_NS
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.wire_length import wire_ns

SYNC = 0x080
BITRATE = 500_000
CYCLE_NS = 5_000_000
"""From SYNC to SYNC. What fills a millisecond at 1 Mbit/s is 40 % of it."""
BLOCK_S = 5
SEGMENT_S = 300


def spread() -> FrameBatch:
    """The frames of a full second in five: after each SYNC back to back, then nothing."""
    block = full_second(0)
    ends_ns = np.cumsum(wire_ns(block, BITRATE)).astype(np.int64)
    cycle = np.cumsum(block.can_id == SYNC) - 1
    begins_ns = np.concatenate(([0], ends_ns))[np.flatnonzero(block.can_id == SYNC)]
    block.t_ns[:] = cycle * CYCLE_NS + ends_ns - begins_ns[cycle]
    return block


def seconds_of_segment(number: int) -> Iterator[FrameBatch]:
    """The frames of a segment, a second at a time, as the recorder writes its chunks."""
    block = spread()
    edges = np.searchsorted(block.t_ns, np.arange(BLOCK_S + 1) * SECOND_NS)
    for at in range(number * SEGMENT_S, (number + 1) * SEGMENT_S, BLOCK_S):
        for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            yield shifted(block[begin:end], START_NS + at * SECOND_NS, 0)


def write_segment(folder: Path, number: int) -> tuple[Path, int]:
    """One segment of the recording, and its frames."""
    path = folder / f"segment{number:04}.mcap"
    with path.open("wb") as stream:
        metadata = CaptureMetadata("0", "day", segment=number, clock="kernel")
        writer = CaptureWriter(stream, metadata, [BusInfo("can0", 0, BITRATE, clock="kernel")])
        for second in seconds_of_segment(number):
            writer.write_chunk(second)
        writer.finish()
        return path, writer.frames_written


def analyze(paths: list[Path], frames: int, out: Path) -> None:
    """Run `syncline analyze` and print what it took."""
    command = [str(Path(sys.executable).with_name("syncline")), "analyze", "--out", str(out)]
    with PeakMemory().sampled() as memory:
        wall, cpu = time.perf_counter(), cpu_s()
        done = subprocess.run([*command, *map(str, paths)], stdout=subprocess.DEVNULL, check=False)
        wall, cpu = time.perf_counter() - wall, cpu_s() - cpu
    print(
        f"{len(paths):4} segments {frames:12,} frames {wall:8.1f} s {frames / wall:12,.0f} frames/s"
        f" {cpu / frames * 1e6:8.3f} CPU us/frame {memory.started_mb or 0:6.0f} MB"
        f" exit {done.returncode}",
        flush=True,
    )


def main() -> None:
    """Write the recording, analyze a tenth of it and all of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24)
    args = parser.parse_args()
    count = max(10, round(args.hours * 3600 / SEGMENT_S))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        written = [write_segment(folder, number) for number in range(count)]
        for part in (written[: count // 10], written):
            paths = [path for path, _ in part]
            analyze(paths, sum(frames for _, frames in part), folder / f"report{len(part)}")


if __name__ == "__main__":
    main()
