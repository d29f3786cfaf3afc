"""What a fleet run costs beside its analyses: processor time, workers, memory.

    uv run python -m benchmarks.fleet 1000 100000

Makes so many captures of so many frames (2.9 MB each at 100,000), then measures:

- the CPU time of the analyses alone: one process that opens and analyzes every n-th capture, one
  after the other, nothing written, imports left out;
- a run with one worker and one with two: wall time, CPU time of all processes from their start to
  their end, and the peak memory of the workers while they did the first and the last tenth.

The machine should do nothing else meanwhile.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from syncline_analyzer.fleet.plan import Order
from syncline_analyzer.fleet.progress import Silent
from syncline_analyzer.fleet.run import Summary, run
from syncline_analyzer.fleet.source import find_captures
from syncline_analyzer.fleet.storage import open_storage
from syncline_analyzer.fleet.task import Outcome, Task
from syncline_samples.fleet import Planted, Template, write_capture

_FRAMES_PER_SECOND = 440
"""At least so many the template has."""
_DAYS = 30
_SINGLE = """
import json, sys, time
from syncline_analyzer import open_session

paths = json.load(sys.stdin)
open_session(paths[0]).analyze()
begun = time.process_time()
for path in paths:
    open_session(path).analyze()
print((time.process_time() - begun) / len(paths))
"""


@dataclass
class Memory(Silent):
    """Peak memory of the workers in the order in which tasks are done [MB]."""

    peaks_mb: list[float] = field(default_factory=list)

    def done(self, task: Task, outcome: Outcome) -> None:
        """Note that of a task."""
        self.peaks_mb.append(outcome.peak_mb or 0.0)

    def tenths(self) -> tuple[float, float]:
        """Medians of the first and of the last tenth."""
        count = max(1, len(self.peaks_mb) // 10)
        return statistics.median(self.peaks_mb[:count]), statistics.median(self.peaks_mb[-count:])


def make_captures(folder: Path, captures: int, frames: int) -> list[Path]:
    """Write the captures, of a machine for each month of them."""
    template = Template(frames / _FRAMES_PER_SECOND + 5)
    planted = Planted(emcys=1, share=frames / len(template.frames))
    return [
        write_capture(folder, template, number // _DAYS, number % _DAYS, planted)
        for number in range(captures)
    ]


def single_cpu_s(paths: Sequence[Path], at_most: int) -> float:
    """CPU time of one analysis in a process that has done one before [s]."""
    chosen = [str(path) for path in paths[:: max(1, len(paths) // at_most)]]
    done = subprocess.run(
        [sys.executable, "-c", _SINGLE],
        input=json.dumps(chosen),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return float(done.stdout)


def fleet_run(source: Path, out: Path, workers: int) -> tuple[Summary, float, float, Memory]:
    """A run: its summary, its wall time, CPU time of all processes, memory."""
    storage, memory = open_storage(str(out)), Memory()
    begun_s, begun_cpu_s = time.perf_counter(), _cpu_s()
    summary = run(Order(find_captures([str(source)], storage), storage), memory, workers=workers)
    return summary, time.perf_counter() - begun_s, _cpu_s() - begun_cpu_s, memory


def _cpu_s() -> float:
    """CPU time of this process and of those that it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def main() -> None:
    """Make the captures, measure, and delete them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("captures", type=int)
    parser.add_argument("frames", type=int, help="of each capture")
    parser.add_argument("--single", type=int, default=100, help="analyses to be timed alone")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="syncline-fleet-") as name:
        folder = Path(name)
        begun_s = time.perf_counter()
        paths = make_captures(folder / "in", args.captures, args.frames)
        megabytes = sum(path.stat().st_size for path in paths) / 1e6
        made_s = time.perf_counter() - begun_s
        print(f"{len(paths)} captures of {args.frames} frames, {megabytes:.0f} MB: {made_s:.0f} s")
        alone_s = single_cpu_s(paths, args.single)
        print(f"one analysis alone: {alone_s * 1000:.1f} ms CPU")
        first_wall_s = 0.0
        for workers in args.workers:
            out = folder / f"out{workers}"
            summary, wall_s, cpu_s, memory = fleet_run(folder / "in", out, workers)
            assert summary.analyzed == len(paths), summary.failures
            first_wall_s = first_wall_s or wall_s
            begin_mb, end_mb = memory.tenths()
            size_kb = sum(p.stat().st_size for p in out.rglob("*.parquet")) / len(paths) / 1e3
            print(
                f"{workers} workers: {wall_s:.1f} s ({first_wall_s / wall_s:.2f} times the speed of"
                f" {args.workers[0]}), CPU {cpu_s:.1f} s = {cpu_s / (alone_s * len(paths)):.2f}"
                f" times the analyses (tasks {summary.cpu_s:.1f} s), peak of a worker"
                f" {begin_mb:.0f} MB in the first tenth, {end_mb:.0f} MB in the last, most"
                f" {max(memory.peaks_mb):.0f} MB; {size_kb:.0f} kB a capture",
                flush=True,
            )


if __name__ == "__main__":
    main()
