"""SIGKILL at random moments, on a quiet bus and at full load.

    python -m benchmarks.crash --kills 200

A recorder runs in a process of its own on frames that it numbers itself, and is killed at a random
moment; the next one starts in the same folder and finishes what the last one left. Checked after
each kill: every frame that the recorder got more than the bound before is in the files, and every
frame that can be read is intact and in order. Prints how old the oldest lost frame was.

On a machine that others use as well, a recorder that gets no CPU cannot write: run it before them
(`nice -n -15 python -m benchmarks.crash`) to see the recorder and not the machine.
"""

import argparse
import random
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from benchmarks.cut_check import Found, look_at
from benchmarks.numbered_source import NumberedSource

BOUND_NS = 1_000_000_000
FULL_RATE = 32_000.0
"""Frames/s: four full buses at 1 Mbit/s."""
QUIET_RATE = 1.0
_ROW = struct.Struct("<qq")


@dataclass(frozen=True)
class Killed:
    """One kill.

    Attributes:
        rate: frames/s.
        given: frames that the recorder had got.
        safe: those that it had got in time.
        found: what the files hold.
        lost_ns: how old the oldest lost frame was; 0 when nothing was lost.
    """

    rate: float
    given: int
    safe: int
    found: Found
    lost_ns: int

    @property
    def kept(self) -> bool:
        """Whether the promise was kept."""
        return self.found.intact and self.safe <= self.found.frames <= self.given + self.rate


def child(folder: Path, recording_id: str, rate: float) -> None:
    """Record until killed; what was given goes to a sidecar that a kill cannot undo."""
    from syncline_logger.record_options import RecordOptions
    from syncline_logger.recorder import record
    from syncline_logger.segments import Split

    with (folder / f"{recording_id}.given").open("wb", buffering=0) as sidecar:

        def told(t_ns: int, given: int) -> None:
            sidecar.write(_ROW.pack(t_ns, given))

        source = NumberedSource(rate, told)
        record(
            [source],
            folder,
            RecordOptions(recording_id=recording_id, split=Split(size_bytes=200_000)),
            on_start=lambda path: print("started", flush=True),
        )


def kill_once(folder: Path, recording_id: str, rate: float, after_s: float) -> Killed:
    """Start a recorder, kill it after a while, and look at what is there."""
    command = [sys.executable, "-m", "benchmarks.crash", "--child", str(folder)]
    command += ["--recording", recording_id, "--rate", str(rate)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parent.parent) as it:
        assert it.stdout is not None
        it.stdout.readline()
        time.sleep(after_s)
        if it.poll() is not None:
            raise RuntimeError(f"{recording_id} ended by itself, with {it.returncode}")
        killed_ns = time.time_ns()
        it.kill()
    data = (folder / f"{recording_id}.given").read_bytes()
    rows = list(_ROW.iter_unpack(data[: len(data) // _ROW.size * _ROW.size]))
    found = look_at(folder, recording_id)
    late = [t_ns for t_ns, given in rows if given > found.frames]
    return Killed(
        rate,
        rows[-1][1] if rows else 0,
        max((given for t_ns, given in rows if t_ns < killed_ns - BOUND_NS), default=0),
        found,
        max(killed_ns - late[0], 0) if late else 0,
    )


def kill_in_a_row(folder: Path, kills: int, rate: float, seed: int) -> list[Killed]:
    """Kills one after the other in one folder; each start finishes what the last kill left."""
    rng = random.Random(seed)
    folder.mkdir()
    done = []
    for n in range(kills):
        after_s = rng.uniform(0.05, 3.5) if rate > 1 else rng.uniform(1.5, 5.5)
        done.append(kill_once(folder, f"kill{n:03d}", rate, after_s))
        if not done[-1].kept:
            print(f"broken: {done[-1]}", flush=True)
    return done


def unfinished(folder: Path) -> int:
    """Files that are still without an end after one more recording, which nobody kills."""
    from syncline_logger.recorder import record

    record([NumberedSource(QUIET_RATE, lambda t_ns, given: None)], folder, duration_ns=0)
    return len(list(folder.glob("*.part.mcap")))


def tell(killed: Sequence[Killed]) -> None:
    """Print what all kills of each rate cost."""
    for rate in sorted({each.rate for each in killed}):
        mine = [each for each in killed if each.rate == rate]
        ages = sorted(each.lost_ns / 1e9 for each in mine)
        print(
            f"{rate:.0f} frames/s: {len(mine)} kills, {sum(e.found.frames for e in mine)} frames"
            f" found of {sum(e.given for e in mine)} given; oldest lost frame: median"
            f" {ages[len(ages) // 2]:.2f} s, worst {ages[-1]:.2f} s;"
            f" not intact: {sum(not e.found.intact for e in mine)},"
            f" promise broken: {sum(not e.kept for e in mine)}",
            flush=True,
        )


def main() -> None:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--at-once", type=int, default=2, help="recorders side by side")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--recording", default="", help=argparse.SUPPRESS)
    parser.add_argument("--rate", type=float, default=FULL_RATE, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(arguments.child, arguments.recording, arguments.rate)
        return
    rates = [QUIET_RATE, FULL_RATE] * (arguments.at_once // 2 or 1)
    with tempfile.TemporaryDirectory(prefix="crash-") as name:
        folders = [Path(name, str(n)) for n in range(len(rates))]
        share = -(-arguments.kills // len(rates))
        with ThreadPoolExecutor(arguments.at_once) as pool:
            rows = [
                pool.submit(kill_in_a_row, folder, share, rate, arguments.seed + n)
                for n, (folder, rate) in enumerate(zip(folders, rates, strict=True))
            ]
            killed = [each for row in rows for each in row.result()]
        tell(killed)
        left = sum(unfinished(folder) for folder in folders)
    print(f"files of killed recorders that the next start did not finish: {left}")
    sys.exit(0 if all(each.kept for each in killed) else 1)


if __name__ == "__main__":
    main()
