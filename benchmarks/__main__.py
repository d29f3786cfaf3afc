"""Prints frames/s of recording, converting and analyzing, with the peers beside them."""

import argparse
import json
import platform
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.traffic import traffic, write_candump

REPOSITORY = Path(__file__).parent.parent


@dataclass(frozen=True)
class Group:
    """Cases that do the same job; the first is ours and the ratio's numerator."""

    title: str
    cases: tuple[tuple[str, str], ...]
    """(function in benchmarks.cases, kind of input: "log", "small log" or "mcap")"""


GROUPS = (
    Group(
        "record: virtual bus -> file",
        (
            ("record_syncline", "small log"),
            ("record_syncline_raw", "small log"),
            ("record_naive_mcap", "small log"),
            ("record_python_can", "small log"),
        ),
    ),
    Group(
        "receive from a serial adapter (slcan)",
        (("slcan_syncline", "small log"), ("slcan_python_can", "small log")),
    ),
    Group(
        "convert a candump log",
        (("convert_syncline", "log"), ("convert_python_can", "log")),
    ),
    Group(
        "analyze our MCAP",
        (("analyze_syncline", "mcap"), ("analyze_canopen_lens", "log"), ("read_mcap", "mcap")),
    ),
    Group(
        "analyze the same as candump text",
        (
            ("analyze_syncline", "log"),
            ("analyze_canopen_lens", "log"),
            ("read_python_can", "log"),
        ),
    ),
    Group(
        "exact wire length of every frame",
        (("wire_lengths_syncline", "log"), ("wire_lengths_bit_by_bit", "small log")),
    ),
)


def run_case(name: str, source: Path, out: Path) -> dict[str, float]:
    """One measured run in a fresh process."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.cases", name, str(source), str(out)],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        print(f"  {name}: {done.stderr.strip().splitlines()[-1]}", file=sys.stderr)
        return {}
    measured: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return measured


def run_group(group: Group, inputs: dict[str, Path], out: Path, repeats: int) -> None:
    """The cases of a group in turn, A B C A B C ..., and a table of their medians."""
    runs: dict[int, list[dict[str, float]]] = {i: [] for i in range(len(group.cases))}
    for repeat in range(repeats):
        for i, (name, kind) in enumerate(group.cases):
            if measured := run_case(name, inputs[kind], out / f"{i}-{repeat}"):
                runs[i].append(measured)
    print(f"\n{group.title}")
    print(f"  {'':24}{'frames/s':>12}{'CPU us/frame':>14}{'peak MB':>9}{'ours / it':>11}")
    ours = 0.0
    for i, (name, _) in enumerate(group.cases):
        if not runs[i]:
            print(f"  {name:24}{'not installed or failed':>26}")
            continue
        rate = statistics.median(run["frames"] / run["wall_s"] for run in runs[i])
        cpu = statistics.median(run["cpu_s"] / run["frames"] * 1e6 for run in runs[i])
        peak = statistics.median(run["peak_mb"] or 0 for run in runs[i])
        ours = ours or rate
        print(f"  {name:24}{rate:>12,.0f}{cpu:>14.2f}{peak:>9.0f}{ours / rate:>11.2f}")


def main() -> None:
    """Make the traffic, run all groups, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000, help="frames of the captures")
    parser.add_argument("--record-frames", type=int, default=100_000, help="frames recorded")
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        inputs = {"log": out / "capture.log", "small log": out / "small.log"}
        write_candump(traffic(args.frames), inputs["log"])
        write_candump(traffic(args.record_frames), inputs["small log"])
        run_case("convert_syncline", inputs["log"], out / "capture")
        inputs["mcap"] = out / "capture.mcap"
        print(f"{args.frames:,} frames, {args.repeats} repeats, medians; {platform.platform()}")
        for group in GROUPS:
            run_group(group, inputs, out, args.repeats)


if __name__ == "__main__":
    main()
