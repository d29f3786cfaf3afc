"""Where the time of an analysis goes: `python -m benchmarks.profile CAPTURE [--frames N]`.

Prints the share of each stage in the main thread, and beside it what reading costs in threads of
its own: the whole of it, and its limit, which is to read and unpack.
"""

import argparse
import cProfile
import pstats
import tempfile
import time
from pathlib import Path

from benchmarks.cases import convert_syncline, read_syncline, unpack_mcap
from benchmarks.traffic import traffic, write_candump

STAGES = (
    ("reading, as far as it is not done ahead", "merge.py", "stream"),
    ("joining batches", "joining.py", "joined"),
    ("parting batches by bus, index by identifier", "bus_batches.py", "add"),
    ("control fold: NMT, SDO, EMCY, LSS, errors", "folds/control.py", "update"),
    ("timing fold: SYNC, PDO, load, waiting", "folds/timing/fold.py", "update"),
    ("angle fold: traces", "folds/angle/fold.py", "update"),
    ("control fold, end", "folds/control.py", "finish"),
    ("timing fold, end", "folds/timing/fold.py", "finish"),
    ("angle fold, end", "folds/angle/fold.py", "finish"),
    ("findings", "findings/__init__.py", "find_all"),
)
"""(name, end of the file's path, function): cumulative time; joining contains reading."""


def stage_seconds(stats: pstats.Stats) -> dict[str, float]:
    """Cumulative seconds of each stage."""
    raw: dict[tuple[str, int, str], tuple[int, int, float, float, object]] = stats.stats  # type: ignore[attr-defined]
    return {
        name: sum(
            figures[3]
            for (file, _, function), figures in raw.items()
            if function == wanted and Path(file).as_posix().endswith(f"syncline_analyzer/{path}")
        )
        for name, path, wanted in STAGES
    }


def print_profile(capture: Path) -> None:
    """Analyze once under the profiler, and read alone."""
    from syncline_analyzer import open_session

    profiler = cProfile.Profile()
    begin = time.perf_counter()
    analysis = profiler.runcall(lambda: open_session(capture).analysis)
    whole = time.perf_counter() - begin
    frames = analysis.capture.frames
    print(f"{frames:,} frames, {whole / frames * 1e9:.0f} ns/frame under the profiler, of which")
    for name, seconds in stage_seconds(pstats.Stats(profiler)).items():
        print(f"  {name:46}{seconds / frames * 1e9:8.1f} ns/frame{seconds / whole * 100:7.1f} %")
    for name, case in (
        ("reading alone, all threads", read_syncline),
        ("limit: read and unpack", unpack_mcap),
    ):
        work = case(capture, capture)
        begin = time.process_time()
        work()
        print(f"  {name:46}{(time.process_time() - begin) / frames * 1e9:8.1f} ns/frame")


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
