"""Where the time of an analysis goes: `python -m benchmarks.profile CAPTURE [--frames N]`.

Prints, of one process, the share of each stage under the profiler; beside it what each half costs
where two processes share the work, and the limit, which is to read and unpack.
"""

import argparse
import cProfile
import os
import pstats
import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path

from benchmarks.cases import convert_syncline, read_syncline, unpack_mcap
from benchmarks.traffic import traffic, write_candump

READING = (
    ("reading the files", "merge.py", "stream"),
    ("joining to batches of one length", "joining.py", "joined"),
    ("copies of frames, index by identifier", "echo.py", "_mark"),
    ("counting", "census.py", "update"),
    ("parting by bus", "bus_batches.py", "add"),
)
ANALYSIS = (
    ("control fold: NMT, SDO, EMCY, LSS, errors", "folds/control.py", "update"),
    ("timing fold: SYNC, PDO, load, waiting", "folds/timing/fold.py", "update"),
    ("angle fold: traces", "folds/angle/fold.py", "update"),
    ("control fold, end", "folds/control.py", "finish"),
    ("timing fold, end", "folds/timing/fold.py", "finish"),
    ("angle fold, end", "folds/angle/fold.py", "finish"),
    ("findings", "findings/__init__.py", "find_all"),
)
"""(name, end of the file's path, function): cumulative time; joining contains reading, and lengths
on the wire are computed where the first fold asks for them, in one process."""


def stage_seconds(stats: pstats.Stats, path: str, function: str) -> float:
    """Cumulative seconds of a stage."""
    raw: dict[tuple[str, int, str], tuple[int, int, float, float, object]] = stats.stats  # type: ignore[attr-defined]
    return sum(
        figures[3]
        for (file, _, name), figures in raw.items()
        if name == function and Path(file).as_posix().endswith(f"syncline_analyzer/{path}")
    )


def print_stages(capture: Path) -> None:
    """One process that does everything, under the profiler."""
    from syncline_analyzer import open_session
    from syncline_schemas import second_process

    two_processes = second_process.LEAST_BYTES
    second_process.LEAST_BYTES = sys.maxsize
    profiler = cProfile.Profile()
    begin = time.perf_counter()
    analysis = profiler.runcall(lambda: open_session(capture).analysis)
    whole = time.perf_counter() - begin
    second_process.LEAST_BYTES = two_processes
    frames, stats = analysis.capture.frames, pstats.Stats(profiler)
    print(f"{frames:,} frames, {whole / frames * 1e9:.0f} ns/frame under the profiler, of which")
    for name, path, function in (*READING, *ANALYSIS):
        _print(name, stage_seconds(stats, path, function), frames, whole)


def print_processes(capture: Path) -> None:
    """Two processes, and what reading costs alone."""
    from syncline_analyzer import open_session
    from syncline_schemas import second_process

    second_process.LEAST_BYTES = 0
    begin, parent, child = time.perf_counter(), time.process_time(), _children_s()
    frames = open_session(capture).analysis.capture.frames
    wall, parent = time.perf_counter() - begin, time.process_time() - parent
    child = _children_s() - child
    print(f"two processes: {wall / frames * 1e9:.0f} ns/frame, of which each computes")
    _print("the process that analyzes", parent, frames, wall)
    _print("the process that reads, with its start", child, frames, wall)
    for name, case in (
        ("reading alone", read_syncline),
        ("limit: read and unpack", unpack_mcap),
    ):
        work = case(capture, capture)
        begin = time.process_time()
        work()
        _print(name, time.process_time() - begin, frames, wall)


def _print(name: str, seconds: float, frames: int, whole: float) -> None:
    print(f"  {name:46}{seconds / frames * 1e9:8.1f} ns/frame{seconds / whole * 100:7.1f} %")


def _children_s() -> float:
    times = os.times()
    return times.children_user + times.children_system


def print_profile(capture: Path) -> None:
    """Both."""
    import_module("syncline_analyzer.engine")
    import_module("syncline_analyzer.reading")
    print_stages(capture)
    print_processes(capture)


def main() -> None:
    """Profile a capture, or the benchmarks' traffic."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", nargs="?", type=Path)
    parser.add_argument("--frames", type=int, default=4_000_000)
    args = parser.parse_args()
    if args.capture is not None:
        print_profile(args.capture)
        return
    with tempfile.TemporaryDirectory() as folder:
        log, capture = Path(folder, "traffic.log"), Path(folder, "traffic.mcap")
        write_candump(traffic(args.frames), log)
        convert_syncline(log, capture)()
        print_profile(capture)


if __name__ == "__main__":
    main()
