"""Whether the recorder's memory stays flat, and nothing is lost meanwhile.

`python -m benchmarks.recorder_soak` simulates as many hours of bus traffic as it is told, as fast as
the machine can (no waiting for the disk), or until it has used `--cpu-minutes`: then it says how far
it got. `--load full` is four buses at 1 Mbit/s and 100 % load, `--load machine` one bus with four
nodes and 780 frames/s. `--real-time MINUTES` records four full buses with all threads and syncs.

Files are cut each hour and the oldest deleted, as a gateway does it. Memory is looked at after each
minute of traffic; what counts is the slope of a line through the second half of the series, when
every cache and every table has its size.
"""

import argparse
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.full_bus import (
    BITRATE,
    BUSES,
    DESCRIPTION,
    SECOND_NS,
    FullBus,
    full_second,
    shifted,
)
from benchmarks.traffic import START_NS, traffic
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record, record_batches
from syncline_logger.retention import Keep
from syncline_logger.segments import Split
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.description import BusDescription

MINUTE_NS = 60 * SECOND_NS
MAX_GROWTH_MB_PER_DAY = 10.0
MAX_PEAK_GROWTH_MB = 3.0
KEEP = 500_000_000


def resident_mb() -> float:
    """Memory of this process now; Linux alone tells."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    line = next(line for line in status.splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


@dataclass
class Memory:
    """Resident memory by hours of traffic."""

    hours: list[float] = field(default_factory=list)
    mb: list[float] = field(default_factory=list)

    def look(self, hours: float) -> None:
        """Note the memory now."""
        self.hours.append(hours)
        self.mb.append(resident_mb())

    def slope_mb_per_day(self) -> float:
        """Growth in the second half."""
        half = len(self.mb) // 2
        return float(np.polyfit(self.hours[half:], self.mb[half:], 1)[0]) * 24

    def report(self) -> int:
        """Print the series, the slope and the peaks of each quarter; 1 when it grows."""
        for at in np.linspace(0, len(self.mb) - 1, min(len(self.mb), 13)).astype(int):
            print(f"  {self.hours[at]:8.2f} h {self.mb[at]:8.1f} MB")
        slope = self.slope_mb_per_day()
        peaks = [max(quarter, default=0.0) for quarter in np.array_split(self.mb, 4)]
        grown = peaks[3] - max(peaks[1:3])
        print(
            f"  slope of the second half {slope:+.2f} MB a day; peaks of the quarters"
            f" {', '.join(f'{peak:.1f}' for peak in peaks)} MB"
        )
        # Memory is a saw: the index of a file grows until the file is closed. A run that is short
        # against a day cannot tell a slope; then it is judged by how its peaks grew.
        return 0 if slope < MAX_GROWTH_MB_PER_DAY or grown < MAX_PEAK_GROWTH_MB else 1


def full_minutes() -> Iterator[FrameBatch]:
    """Seconds of four full buses, for ever."""
    second = FrameBatch.concat([shifted(full_second(bus), 0, bus) for bus in range(BUSES)])
    second = second[np.argsort(second.t_ns, kind="stable")]
    begin_ns = START_NS
    while True:
        batch = FrameBatch(
            second.t_ns + begin_ns,
            second.bus,
            second.can_id,
            second.flags,
            second.dlc,
            second.data,
        )
        yield batch
        begin_ns += SECOND_NS


def machine_minutes() -> Iterator[FrameBatch]:
    """Minutes of one healthy bus, for ever."""
    minute = traffic(780 * 60)
    minute = minute[minute.t_ns < START_NS + MINUTE_NS]
    begin_ns = 0
    while True:
        yield shifted(minute, begin_ns, 0)
        begin_ns += MINUTE_NS


def accelerated(load: str, hours: float, cpu_minutes: float) -> int:
    """Simulated traffic as fast as it goes."""
    memory = Memory()
    buses = BUSES if load == "full" else 1
    frames = 0

    def items() -> Iterator[FrameBatch]:
        nonlocal frames
        next_ns = START_NS
        for batch in full_minutes() if load == "full" else machine_minutes():
            at_ns = int(batch.t_ns[0])
            if at_ns >= next_ns:
                memory.look((at_ns - START_NS) / 3.6e12)
                next_ns = at_ns + MINUTE_NS
            over = at_ns - START_NS >= hours * 3.6e12
            if over or time.process_time() > cpu_minutes * 60:
                return
            frames += len(batch)
            yield batch

    with tempfile.TemporaryDirectory() as folder:
        result = record_batches(
            items(),
            [BusInfo(f"can{n}", n, BITRATE) for n in range(buses)],
            Path(folder),
            RecordOptions(
                sync=False,
                description=BusDescription.loads(DESCRIPTION),
                split=Split(time_ns=60 * MINUTE_NS, size_bytes=100_000_000),
                keep=Keep(size_bytes=KEEP),
            ),
        )
        left = sum(file.stat().st_size for file in Path(folder).iterdir())
    assert result.frame_count == frames, "frames were lost"
    print(
        f"{memory.hours[-1]:.2f} h of {buses} bus(es), {frames:,} frames,"
        f" {time.process_time() / 60:.1f} CPU minutes, {left / 1e6:.0f} MB left of the files"
    )
    return memory.report()


def real_time(minutes: float) -> int:
    """Four full buses as they come, with threads and syncs."""
    memory = Memory()
    start_s = time.monotonic()
    buses = [FullBus(number, end_ns=round(minutes * MINUTE_NS)) for number in range(BUSES)]
    cpu_s = time.process_time()

    def look(_: Any) -> None:
        memory.look((time.monotonic() - start_s) / 3600)

    with tempfile.TemporaryDirectory() as folder:
        result = record(
            buses,
            Path(folder),
            RecordOptions(
                description=BusDescription.loads(DESCRIPTION),
                split=Split(time_ns=5 * MINUTE_NS, size_bytes=100_000_000),
                keep=Keep(size_bytes=KEEP),
            ),
            stop=threading.Event(),
            duration_ns=round(minutes * MINUTE_NS) + SECOND_NS // 2,
            on_status=look,
            status_period_ns=10 * SECOND_NS,
        )
    cpu_s = time.process_time() - cpu_s
    given = sum(bus.given for bus in buses)
    assert result.frame_count == given, f"{given - result.frame_count} frames were lost"
    assert result.gap_count == 0, result.gaps
    share = cpu_s / (time.monotonic() - start_s)
    print(f"{minutes:g} minutes, {given:,} frames, none lost, {share:.1%} of a core")
    return memory.report()


def main() -> None:
    """Run what is asked for; exit with 1 when memory grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--load", choices=["full", "machine"], default="machine")
    parser.add_argument("--hours", type=float, default=24)
    parser.add_argument("--cpu-minutes", type=float, default=5)
    parser.add_argument("--real-time", type=float, metavar="MINUTES")
    args = parser.parse_args()
    if args.real_time:
        sys.exit(real_time(args.real_time))
    sys.exit(accelerated(args.load, args.hours, args.cpu_minutes))


if __name__ == "__main__":
    main()
