"""What a fleet run costs beside its analyses, and the figures of the sizing model of docs/fleet.md.

    uv run python -m benchmarks.fleet 1000 100000

Makes so many captures of so many frames (2.7 MB each at 100,000), then measures, in this order:

- **alone**: CPU time of the analysis of every n-th capture in one process that has done one before,
  imports left out: once with nothing written, once with all tables of `syncline analyze --out`
  (`write_tables`, with every sample), and the whole process `syncline analyze` with its imports.
  The first two again after each run, since other work on a machine changes what a second is worth.
- a run with one worker and one with two: wall time, CPU time of all processes from their start to
  their end, and the peak memory of the workers along the captures.
- a run over captures of a fiftieth of the frames: what a capture costs, whatever is in it.
- `syncline fleet query` over the data set, the whole process.

The machine should do nothing else meanwhile: then it takes about 15 minutes.
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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

from syncline_analyzer.fleet.plan import Order
from syncline_analyzer.fleet.progress import Silent
from syncline_analyzer.fleet.run import Summary, run
from syncline_analyzer.fleet.source import find_captures
from syncline_analyzer.fleet.storage import open_storage
from syncline_analyzer.fleet.task import Outcome, Task
from syncline_samples.fleet import Planted, Template, write_capture
from syncline_schemas.processors import processors

_FRAMES_PER_SECOND = 440
"""At least so many the template has."""
_DAYS = 30
_SMALLER = 50
"""Captures of this part of the frames tell what a capture costs without its frames."""
_SINGLE = """
import json, sys, tempfile, time
from pathlib import Path
from syncline_analyzer import open_session

paths, written = json.load(sys.stdin)
with tempfile.TemporaryDirectory() as folder:
    def work(path):
        analysis = open_session(path).analyze()
        if written:
            from syncline_analyzer.views.tables import write_tables
            write_tables(analysis, Path(folder))
    work(paths[0])
    begun = time.process_time()
    for path in paths:
        work(path)
    print((time.process_time() - begun) / len(paths))
"""


@dataclass
class Memory(Silent):
    """Peak memory of the workers in the order in which tasks are done [MB]."""

    peaks_mb: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)

    def done(self, task: Task, outcome: Outcome) -> None:
        """Note that of a task."""
        self.peaks_mb.append(outcome.peak_mb or 0.0)
        self.cpu_s.append(outcome.cpu_s)

    def along(self) -> str:
        """The peak after so many captures, median of ten each, and the most."""
        count = len(self.peaks_mb)
        places = [at for at in (10, 50, 100, 300, 1000, 3000) if at < count] + [count]
        told = (f"{statistics.median(self.peaks_mb[max(0, at - 10) : at]):.0f}" for at in places)
        where = ", ".join(map(str, places))
        return f"after {where} captures: {', '.join(told)} MB, most {max(self.peaks_mb):.0f} MB"


@dataclass
class Alone:
    """CPU time of single analyses, by round [s]."""

    paths: Sequence[Path]
    bare_s: list[float] = field(default_factory=list)
    written_s: list[float] = field(default_factory=list)

    def measure(self) -> None:
        """One more round."""
        self.bare_s.append(single_cpu_s(self.paths, written=False))
        self.written_s.append(single_cpu_s(self.paths[::4], written=True))
        print(
            f"one analysis alone: {self.bare_s[-1] * 1000:.1f} ms CPU,"
            f" with its tables {self.written_s[-1] * 1000:.1f} ms",
            flush=True,
        )


def make_captures(folder: Path, captures: int, frames: int) -> list[Path]:
    """Write the captures, of a machine for each month of them."""
    with ProcessPoolExecutor(processors(), get_context("spawn")) as pool:
        made = pool.map(_make, repeat(folder), range(captures), repeat(frames), chunksize=_DAYS)
        return list(made)


def _make(folder: Path, number: int, frames: int) -> Path:
    template = _template(frames)
    planted = Planted(emcys=1, share=frames / len(template.frames))
    return write_capture(folder, template, number // _DAYS, number % _DAYS, planted)


@cache
def _template(frames: int) -> Template:
    return Template(frames / _FRAMES_PER_SECOND + 5)


def single_cpu_s(paths: Sequence[Path], *, written: bool) -> float:
    """CPU time of one analysis in a process that has done one before [s]."""
    done = subprocess.run(
        [sys.executable, "-c", _SINGLE],
        input=json.dumps(([str(path) for path in paths], written)),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return float(done.stdout)


def process_cpu_s(*words: str, times: int = 5) -> float:
    """Least CPU time of a whole `syncline` process [s]."""
    command = [str(Path(sys.executable).with_name("syncline")), *words]
    taken = []
    for _ in range(times):
        begun_s = _cpu_s()
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
        taken.append(_cpu_s() - begun_s)
    return min(taken)


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


def measured_run(source: Path, workers: int, alone: Alone, first_wall_s: float) -> float:
    """A run, told beside what came before it; its wall time."""
    out = source.with_name(f"out{workers}")
    summary, wall_s, cpu_s, memory = fleet_run(source, out, workers)
    assert not summary.failed, summary.failures
    alone.measure()
    each_s = cpu_s / summary.analyzed
    bare_s, written_s = statistics.mean(alone.bare_s[-2:]), statistics.mean(alone.written_s[-2:])
    print(
        f"{workers} workers: {wall_s:.1f} s ({(first_wall_s or wall_s) / wall_s:.2f} times the speed"
        f" of the first), CPU {cpu_s:.1f} s = {each_s * 1000:.1f} ms a capture (tasks"
        f" {summary.cpu_s / summary.analyzed * 1000:.1f} ms) = {each_s / bare_s:.2f} times an analysis"
        f" with nothing written, {each_s / written_s:.2f} times one with its tables\n"
        f"  peak of the workers {memory.along()}",
        flush=True,
    )
    return wall_s


def sizing(source: Path, small: Path) -> None:
    """Print what a capture costs and what a frame of it, from captures of two sizes."""
    figures = []
    for folder in (small, source):
        out = folder.with_name(f"{folder.name}-sized")
        summary, _, _, memory = fleet_run(folder, out, 1)
        assert not summary.failed, summary.failures
        count = summary.analyzed
        parquet = [path.stat().st_size for path in out.rglob("*.parquet")]
        figures.append(
            (
                summary.frames / count,
                statistics.median(memory.cpu_s) * 1000,
                sum(parquet) / count / 1e3,
                sum(path.stat().st_size for path in folder.rglob("*.mcap")) / count / 1e3,
                len(parquet) / count,
            )
        )
        if folder is source:
            query_s = process_cpu_s("fleet", "query", str(out), "--question", "emcy", times=3)
            print(f"fleet query --question emcy over {count} captures: {query_s:.2f} s CPU")
    (few, *at_few), (many, *at_many) = figures
    print(f"model, from captures of {few:,.0f} and {many:,.0f} frames (files {at_many[3]:.0f}):")
    names = ("ms CPU", "kB of parquet", "kB of MCAP")
    for name, low, high in zip(names, at_few, at_many, strict=False):
        slope = (high - low) / (many - few)
        print(f"  {name}: {low - slope * few:.1f} a capture and {slope * 1e6:.1f} a million frames")


def main() -> None:
    """Make the captures, measure, and delete them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("captures", type=int)
    parser.add_argument("frames", type=int, help="of each capture")
    parser.add_argument("--single", type=int, default=60, help="analyses to be timed alone")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="syncline-fleet-") as name:
        folder = Path(name)
        begun_s = time.perf_counter()
        paths = make_captures(folder / "in", args.captures, args.frames)
        sample = min(len(paths), 100)
        few = make_captures(folder / "small", sample, max(args.frames // _SMALLER, 100))
        megabytes = sum(path.stat().st_size for path in paths) / 1e6
        made_s = time.perf_counter() - begun_s
        print(f"{len(paths)} captures of {args.frames} frames, {megabytes:.0f} MB: {made_s:.0f} s")
        whole_s = process_cpu_s("analyze", str(paths[0]))
        small_s = process_cpu_s("analyze", str(few[0]))
        print(
            f"whole process `syncline analyze`: {whole_s:.2f} s CPU, of a small one {small_s:.2f} s"
        )
        alone = Alone(paths[:: max(1, len(paths) // args.single)])
        alone.measure()
        first_wall_s = 0.0
        for workers in args.workers:
            wall_s = measured_run(folder / "in", workers, alone, first_wall_s)
            first_wall_s = first_wall_s or wall_s
        for path in paths[sample:]:
            path.unlink()
        sizing(folder / "in", folder / "small")


if __name__ == "__main__":
    main()
