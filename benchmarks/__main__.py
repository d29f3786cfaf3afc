"""Prints frames/s of recording, converting and analyzing, with the peers beside them."""

import argparse
import json
import platform
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from benchmarks.traffic import traffic, write_by_python_can, write_candump, write_recorded

REPOSITORY = Path(__file__).parent.parent


@dataclass(frozen=True)
class Group:
    """Cases that do the same job; the first is ours and the ratio's numerator."""

    title: str
    cases: tuple[tuple[str, str], ...]
    """(function in benchmarks.cases, key of the input that `inputs` makes)"""


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
        "convert a candump log (issue 7, outcome 6: to MCAP at least 1 M frames/s)",
        (("convert_syncline", "log"), ("convert_python_can", "log")),
    ),
    Group(
        "convert our MCAP to candump text (outcome 6: at least 1 M frames/s)",
        (("convert_to_candump", "mcap"), ("convert_to_candump_mcap", "mcap")),
    ),
    Group(
        "analyze our MCAP, imports left out",
        (("analyze_syncline", "mcap"), ("analyze_canopen_lens", "log"), ("read_mcap", "mcap")),
    ),
    Group(
        "analyze the same as candump text, imports left out",
        (
            ("analyze_syncline", "log"),
            ("analyze_canopen_lens", "log"),
            ("read_python_can", "log"),
        ),
    ),
    Group(
        "analyze our MCAP, whole processes (outcome 1: 2.5 times canopen-lens, 40 times tshark)",
        (
            ("process_analyze", "mcap"),
            ("process_canopen_lens", "log"),
            ("process_tshark", "log"),
        ),
    ),
    Group(
        "analyze candump text, whole processes (outcome 1: 1.5 times canopen-lens)",
        (("process_analyze", "log"), ("process_canopen_lens", "log")),
    ),
    Group(
        "analyze our MCAP with two processors and with one (outcome 4: at least 1.5 times)",
        (("process_analyze", "mcap"), ("process_analyze_one_processor", "mcap")),
    ),
    Group(
        "read our MCAP, no analysis",
        (
            ("read_syncline", "mcap"),
            ("read_syncline_one_thread", "mcap"),
            ("unpack_mcap", "mcap"),
            ("read_mcap", "mcap"),
        ),
    ),
    Group(
        "read a recording with a chunk a second",
        (
            ("read_syncline", "recorded"),
            ("read_syncline_one_thread", "recorded"),
            ("unpack_mcap", "recorded"),
        ),
    ),
    *(
        Group(
            f"import {name} (outcome 5: at least {least} M frames/s)",
            (("read_syncline", kind), ("read_python_can", kind)),
        )
        for name, kind, least in (
            ("candump text", "log", "4"),
            ("BLF", "blf", "3"),
            ("ASC", "asc", "1.5"),
            ("TRC", "trc", "1.5"),
        )
    ),
    Group("start: syncline --help (outcome 7: under 0.3 s)", (("process_help", "tiny log"),)),
    Group(
        "start: syncline analyze of 1,000 frames (outcome 7: under 1.5 s)",
        (
            ("process_analyze", "tiny log"),
            ("process_canopen_lens", "tiny log"),
            ("process_tshark", "tiny log"),
        ),
    ),
    Group(
        "10 M samples as session.rrd (outcome 8: under 6 s)",
        (("write_rrd", "tiny log"),),
    ),
    Group(
        "ten seconds out of the middle of our MCAP (outcome 9)",
        (("stretch_syncline", "mcap"), ("stretch_mcap", "mcap")),
    ),
    Group(
        "exact wire length of every frame",
        (("wire_lengths_syncline", "log"), ("wire_lengths_bit_by_bit", "small log")),
    ),
)


def make_inputs(
    folder: Path, kinds: Collection[str], frames: int, record_frames: int
) -> dict[str, Path]:
    """The same traffic in every format that is wanted; BLF, ASC and TRC are python-can's own."""
    inputs: dict[str, Path] = {}
    for kind, count in (("log", frames), ("small log", record_frames), ("tiny log", 1_000)):
        if kind in {*kinds, "log"}:
            inputs[kind] = folder / f"{kind.replace(' ', '_')}.log"
            write_candump(traffic(count), inputs[kind])
    if "mcap" in kinds:
        run_case("convert_syncline", inputs["log"], folder / "capture")
        inputs["mcap"] = folder / "capture.mcap"
    for kind in {"blf", "asc", "trc"} & set(kinds):
        inputs[kind] = folder / f"python_can.{kind}"
        write_by_python_can(inputs["log"], inputs[kind])
    if "recorded" in kinds:
        inputs["recorded"] = write_recorded(traffic(frames), folder / "recorded.mcap")
    return inputs


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
    print(f"\n{group.title}", flush=True)
    heads = f"{'wall s':>9}{'frames/s':>12}{'CPU us/frame':>14}{'peak MB':>9}{'ours / it':>11}"
    print(f"  {'':32}{heads}")
    ours = 0.0
    for i, (name, _) in enumerate(group.cases):
        if not runs[i]:
            print(f"  {name:32}{'not installed or failed':>26}")
            continue
        rate = statistics.median(run["frames"] / run["wall_s"] for run in runs[i])
        wall = statistics.median(run["wall_s"] for run in runs[i])
        cpu = statistics.median(run["cpu_s"] / run["frames"] * 1e6 for run in runs[i])
        peak = statistics.median(run["peak_mb"] or 0 for run in runs[i])
        ours = ours or rate
        figures = f"{wall:>9.2f}{rate:>12,.0f}{cpu:>14.3f}{peak:>9.0f}{ours / rate:>11.2f}"
        print(f"  {name:32}{figures}")


def main() -> None:
    """Make the traffic, run all groups, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000, help="frames of the captures")
    parser.add_argument("--record-frames", type=int, default=100_000, help="frames recorded")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", default="", help="only groups with this word in their title")
    args = parser.parse_args()
    groups = [group for group in GROUPS if args.only in group.title]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        kinds = {kind for group in groups for _, kind in group.cases}
        inputs = make_inputs(out, kinds, args.frames, args.record_frames)
        print(f"{args.frames:,} frames, {args.repeats} repeats, medians; {platform.platform()}")
        for group in groups:
            run_group(group, inputs, out, args.repeats)


if __name__ == "__main__":
    main()
