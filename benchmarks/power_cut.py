"""Power cuts under a recorder, in a virtual machine with ext4.

    python -m benchmarks.power_cut --vm ../shared/tools/socketcan-vm --cuts 30

Each boot looks at what the last cut left, then records on until the machine is killed. The guest
tells on its standard output how many frames it gave to the recorder; the next boot tells how many
of them the files hold. What was given more than the bound before the last word that came out must
be there. Odd boots have a frame a second, even ones full load.

`--refusals` runs the other two: a disk that is really full for a while, and one that is remounted
read-only for a while; frames recorded and frames reported lost must be the frames given.
"""

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.cut_check import look_at
from benchmarks.numbered_source import NumberedSource

BOUND_NS = 1_000_000_000
DISK = Path("/mnt/disk/captures")
TELL_NS = 250_000_000
FULL_RATE = 500.0
"""Frames/s; a machine that is emulated in software keeps up with so many."""
QUIET_RATE = 1.0


def say(**values: object) -> None:
    """One line to the host."""
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


class Teller:
    """Says what was given, seldom: each line costs the emulated machine much time."""

    def __init__(self) -> None:
        self._next_ns = 0

    def __call__(self, t_ns: int, given: int) -> None:
        if t_ns >= self._next_ns:
            self._next_ns = t_ns + TELL_NS
            say(t_ns=t_ns, given=given)


def tell_found(recording_id: str, what: str) -> None:
    """Look at a recording and say what it holds."""
    found = look_at(DISK, recording_id)
    say(
        found=recording_id,
        when=what,
        frames=found.frames,
        lost=found.lost,
        intact=found.intact,
        whole=found.whole,
        files=found.files,
    )


def record_for(recording_id: str, rate: float, act: Callable[[], None] | None) -> None:
    """Record until killed, or until `act` returns."""
    from syncline_logger.recorder import record
    from syncline_logger.recording import RecordOptions
    from syncline_logger.retention import Keep
    from syncline_logger.segments import Split

    source = NumberedSource(rate, Teller())
    stop = threading.Event()

    def work() -> None:
        if act:
            act()
            stop.set()

    result = record(
        [source],
        DISK,
        RecordOptions(
            recording_id=recording_id,
            split=Split(size_bytes=30_000),
            # A full disk would make room by deleting; here every frame is to be counted.
            keep=Keep() if act else Keep(size_bytes=40_000_000),
        ),
        stop=stop,
        on_start=lambda path: threading.Thread(target=work, daemon=True).start(),
    )
    say(given=source.given, recorded=result.frame_count, lost=result.lost_frames)
    say(problems=result.problems)


def guest(arguments: argparse.Namespace) -> None:
    """One boot of the virtual machine."""
    DISK.mkdir(exist_ok=True)
    if arguments.previous:
        tell_found(arguments.previous, "after the cut")
    if arguments.recording:
        say(starting=arguments.recording)
        record_for(arguments.recording, arguments.rate, None)
    if arguments.refuse:
        record_for("refused", FULL_RATE, full_disk if arguments.refuse == "full" else read_only)
        tell_found("refused", arguments.refuse)


def full_disk() -> None:
    """Fill the disk to the last byte, wait, and make room again."""
    time.sleep(3)
    stuffing = DISK.parent / "stuffing"
    with stuffing.open("wb", buffering=0) as file:
        size = 1 << 20
        while size:
            try:
                file.write(bytes(size))
            except OSError:
                size //= 2
    say(full=True)
    time.sleep(6)
    stuffing.unlink()
    say(full=False)
    time.sleep(12)


def read_only() -> None:
    """Remount everything read-only as the kernel does in an emergency, and back."""
    time.sleep(3)
    Path("/proc/sysrq-trigger").write_text("u", encoding="ascii")
    say(read_only=True)
    time.sleep(6)
    subprocess.run(["mount", "-o", "remount,rw", "/mnt/disk"], check=True)
    say(read_only=False)
    time.sleep(12)


class Host:
    """Boots the virtual machine again and again on one disk image."""

    def __init__(self, vm: Path, image: Path) -> None:
        self._vm = vm
        self._image = image
        self._pycache = Path(tempfile.gettempdir(), "syncline-power-cut-pycache")
        self._pycache.mkdir(exist_ok=True)

    def boot(
        self, *words: str, kill_on: str = "", kill_after: float = 0
    ) -> list[dict[str, object]]:
        """What one boot told."""
        command = [str(self._vm), "--hw", "0", "--vcan", "0", "--disk", str(self._image)]
        command += ["--disk-size", "64M", "--pycache", str(self._pycache)]
        if kill_on:
            command += ["--kill-on", kill_on, "--kill-after", f"{kill_after:.3f}"]
        command += ["--", sys.executable, "-m", "benchmarks.power_cut", "--guest", *words]
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        done = subprocess.run(
            command, capture_output=True, encoding="utf-8", check=False, env=environment
        )
        told = []
        for line in done.stdout.splitlines():
            try:
                told.append(json.loads(line))
            except ValueError:
                continue
        if not told:
            raise RuntimeError(f"the virtual machine said nothing: {done.stderr[-2000:]}")
        return told


def cut(host: Host, number: int, previous: str, rng: random.Random) -> list[dict[str, object]]:
    """One boot that is cut at a random moment of its recording."""
    rate = QUIET_RATE if number % 2 else FULL_RATE
    return host.boot(
        *(["--previous", previous] if previous else []),
        *("--recording", f"cut{number}", "--rate", str(rate)),
        kill_on='"given"',
        kill_after=rng.uniform(0.2, 4.0),
    )


def given_in_time(told: list[dict[str, object]], slack_ns: int) -> tuple[int, int]:
    """Frames that must be there after a cut, and all that were given."""
    lines = [(_int(each["t_ns"]), _int(each["given"])) for each in told if "t_ns" in each]
    last_ns = lines[-1][0] if lines else 0
    safe = [given for t_ns, given in lines if t_ns < last_ns - BOUND_NS - slack_ns]
    return max(safe, default=0), lines[-1][1] if lines else 0


def run_cuts(host: Host, cuts: int, seed: int, slack_ns: int) -> bool:
    """Cut the power so many times; whether every promise was kept."""
    rng, previous, good = random.Random(seed), "", True
    safe = given = 0
    for number in range(cuts + 1):
        told = (
            cut(host, number, previous, rng) if number < cuts else host.boot("--previous", previous)
        )
        for found in (each for each in told if each.get("found") == previous and previous):
            frames = _int(found["frames"])
            # The last frames may have come between the last line and the cut; what was being
            # finished when the power went is looked at again in the next boot.
            kept = safe <= frames <= given + FULL_RATE and bool(found["intact"])
            good &= kept
            print(
                f"{previous}: given {given}, must be there {safe}, found {frames},"
                f" {found['whole']} of {found['files']} files whole,"
                f" {'good' if kept else 'BAD'}",
                flush=True,
            )
        safe, given = given_in_time(told, slack_ns)
        previous = f"cut{number}"
    return good


def run_refusals(host: Host) -> bool:
    """A full and a read-only disk; whether every frame is recorded or reported."""
    good = True
    for what in ("full", "read-only"):
        told = host.boot("--refuse", what)
        sums = {key: value for each in told for key, value in each.items()}
        # `given` of the last line is the one after the end.
        kept = _int(sums["frames"]) + _int(sums["lost"]) == _int(sums["given"]) and sums["intact"]
        good &= bool(kept)
        print(
            f"{what}: given {sums['given']}, recorded {sums['frames']}, reported lost"
            f" {sums['lost']}, {'good' if kept else 'BAD'}; {sums['problems']}",
            flush=True,
        )
    return good


def _int(value: object) -> int:
    return int(str(value))


def main() -> None:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vm", type=Path, default=Path("../shared/tools/socketcan-vm"))
    parser.add_argument("--cuts", type=int, default=30)
    parser.add_argument("--refusals", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--slack", type=float, default=0, help="seconds that a busy emulator may add to the bound"
    )
    parser.add_argument("--guest", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--previous", default="", help=argparse.SUPPRESS)
    parser.add_argument("--recording", default="", help=argparse.SUPPRESS)
    parser.add_argument("--rate", type=float, default=FULL_RATE, help=argparse.SUPPRESS)
    parser.add_argument("--refuse", default="", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.guest:
        guest(arguments)
        return
    with tempfile.TemporaryDirectory(prefix="power-cut-") as folder:
        os.chdir(Path(__file__).parent.parent)
        good = True
        if arguments.cuts:
            host = Host(arguments.vm, Path(folder, "cuts.img"))
            good &= run_cuts(host, arguments.cuts, arguments.seed, round(arguments.slack * 1e9))
        if arguments.refusals:
            good &= run_refusals(Host(arguments.vm, Path(folder, "refusals.img")))
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
