"""Power cuts under a recorder, in a virtual machine with ext4.

    python -m benchmarks.power_cut --vm ../shared/tools/socketcan-vm --cuts 30

Each boot looks at what the last cut left, then records on until the machine is killed. Odd boots
have a frame a second, even ones full load. Two things are checked, both on the guest's own words:

- What was on the disk by the recorder's own account (its fsync returned) is there after the cut,
  frame by frame. That must hold on any machine, however slow.
- How old the oldest frame of each chunk was when it was on the disk: what a cut at the worst moment
  before would have cost. That is at most the bound on a machine that gives the recorder its CPU; an
  emulator that shares two cores with others does not always (`--slack`, `nice -n -15`).

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
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.cut_check import look_at
from benchmarks.numbered_source import NumberedSource
from syncline_logger.capture_file import Block, CaptureFile
from syncline_logger.live_status import StatusSnapshot
from syncline_schemas.batch import FrameBatch

BOUND_NS = 1_000_000_000
DISK = Path("/mnt/disk/captures")
TELL_NS = 250_000_000
FULL_RATE = 500.0
"""Frames/s; a machine that is emulated in software keeps up with so many."""
QUIET_RATE = 1.0
BEFORE_S = 2.0
"""Recorded before and after the disk refuses."""
LONGEST_WAIT_S = 180.0
LONGEST_BOOT_S = 600


def say(**values: object) -> None:
    """One line to the host."""
    os.write(1, (json.dumps(values) + "\n").encode())


class Teller:
    """Says what was given, seldom (each line costs the emulated machine much time), and what is on
    the disk each time."""

    def __init__(self) -> None:
        self._next_ns = 0
        self._on_disk = 0

    def give(self, t_ns: int, given: int) -> None:
        """Frames up to this number were given to the recorder."""
        if t_ns >= self._next_ns:
            self._next_ns = t_ns + TELL_NS
            say(t_ns=t_ns, given=given)

    def store(self, log_ns: NDArray[np.int64]) -> None:
        """Frames of these log times are on the disk."""
        if len(log_ns):
            self._on_disk += len(log_ns)
            say(on_disk=self._on_disk, oldest_ns=time.time_ns() - int(log_ns[0]))


def telling_file(teller: Teller) -> type[CaptureFile]:
    """A capture file that tells when a chunk is on the disk."""

    class TellingFile(CaptureFile):
        def write(
            self, frames: FrameBatch, log_ns: NDArray[np.int64], blocks: Iterable[Block] = ()
        ) -> None:
            super().write(frames, log_ns, blocks)
            teller.store(log_ns)

    return TellingFile


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


class Trouble:
    """Whether the recorder has trouble with the disk, by its own status."""

    def __init__(self) -> None:
        self._seen = {True: threading.Event(), False: threading.Event()}

    def note(self, snapshot: StatusSnapshot) -> None:
        """Take the recorder's status."""
        present = bool(snapshot.trouble)
        self._seen[present].set()
        self._seen[not present].clear()

    def wait(self, present: bool) -> None:
        """Until it is there, or over."""
        if not self._seen[present].wait(LONGEST_WAIT_S):
            raise TimeoutError(f"no status came with trouble: {present}")


def record_for(recording_id: str, rate: float, act: Callable[[Trouble], None] | None) -> None:
    """Record until killed, or until `act` returns."""
    from syncline_logger.record_options import RecordOptions
    from syncline_logger.recorder import record
    from syncline_logger.retention import Keep
    from syncline_logger.segments import Split

    teller = Teller()
    source = NumberedSource(rate, teller.give)
    stop, trouble = threading.Event(), Trouble()

    def work() -> None:
        if act is None:
            return
        try:
            time.sleep(BEFORE_S)
            act(trouble)
            time.sleep(BEFORE_S)
        except Exception as error:  # noqa: BLE001 - the host is told
            say(failed=f"{type(error).__name__}: {error}")
        finally:
            stop.set()

    options = RecordOptions(
        recording_id=recording_id,
        split=Split(size_bytes=30_000),
        # A full disk would make room by deleting; here every frame is to be counted.
        keep=Keep() if act else Keep(size_bytes=40_000_000),
    )
    with patch("syncline_logger.capture_store.CaptureFile", telling_file(teller)):
        result = record(
            [source],
            DISK,
            options,
            stop=stop,
            on_start=lambda path: threading.Thread(target=work, daemon=True).start(),
            on_status=trouble.note,
            status_period_ns=TELL_NS,
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
        # The two share a disk: each counts its own recording only.
        recording = f"refused-{arguments.refuse}"
        record_for(recording, FULL_RATE, full_disk if arguments.refuse == "full" else read_only)
        tell_found(recording, arguments.refuse)


def full_disk(trouble: Trouble) -> None:
    """Fill the disk to the last block, and make room again when the recorder has seen it."""
    stuffing = DISK.parent / "stuffing"
    with stuffing.open("wb") as file:
        size, end = 1 << 24, 0
        while size >= 1 << 9:
            try:
                os.posix_fallocate(file.fileno(), end, size)
                end += size
            except OSError:
                size //= 2
    say(full=True)
    trouble.wait(True)
    stuffing.unlink()
    say(full=False)
    trouble.wait(False)


def read_only(trouble: Trouble) -> None:
    """Remount everything read-only as the kernel does in an emergency, and back."""
    Path("/proc/sysrq-trigger").write_text("u", encoding="ascii")
    say(read_only=True)
    trouble.wait(True)
    subprocess.run(["mount", "-o", "remount,rw", "/dev/vda", str(DISK.parent)], check=True)
    say(read_only=False)
    trouble.wait(False)


class Host:
    """Boots the virtual machine again and again on one disk image."""

    def __init__(self, vm: Path, image: Path) -> None:
        self._vm = vm
        self._image = image
        self._pycache = Path(tempfile.gettempdir(), "syncline-power-cut-pycache")
        self._pycache.mkdir(exist_ok=True)
        # Compiling the libraries takes a minute in the emulator.
        subprocess.run(
            [sys.executable, "-c", "import benchmarks.power_cut, syncline_logger.recorder"],
            check=True,
            env=_compiling() | {"PYTHONPYCACHEPREFIX": str(self._pycache)},
        )

    def boot(
        self, *words: str, kill_on: str = "", kill_after: float = 0
    ) -> list[dict[str, object]]:
        """What one boot told."""
        command = [str(self._vm), "--hw", "0", "--vcan", "0", "--disk", str(self._image)]
        command += ["--disk-size", "64M", "--pycache", str(self._pycache)]
        command += ["--cpus", "1", "--timeout", str(LONGEST_BOOT_S)]
        if kill_on:
            command += ["--kill-on", kill_on, "--kill-after", f"{kill_after:.3f}"]
        command += ["--", sys.executable, "-m", "benchmarks.power_cut", "--guest", *words]
        done = subprocess.run(
            command, capture_output=True, encoding="utf-8", check=False, env=_compiling()
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


@dataclass(frozen=True)
class Told:
    """What a boot told before the power went.

    Attributes:
        given: frames that the recorder had got.
        on_disk: those of them that were on the disk by its own account.
        ages_ns: by chunk, how old its oldest frame was when it was there.
        at_ns: by line, the time and the number of frames that were given.
    """

    given: int = 0
    on_disk: int = 0
    ages_ns: tuple[int, ...] = ()
    at_ns: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, lines: Sequence[Mapping[str, object]]) -> "Told":
        """From the lines of a boot."""
        given = [(_int(each["t_ns"]), _int(each["given"])) for each in lines if "t_ns" in each]
        chunks = [each for each in lines if "on_disk" in each]
        return cls(
            given[-1][1] if given else 0,
            _int(chunks[-1]["on_disk"]) if chunks else 0,
            tuple(_int(each["oldest_ns"]) for each in chunks),
            tuple(given),
        )

    def lost_ns(self, found: int) -> int:
        """How long before the last word the oldest frame was given that is not there."""
        lost = [t_ns for t_ns, given in self.at_ns if given > found]
        return self.at_ns[-1][0] - lost[0] if lost else 0


def _compiling() -> dict[str, str]:
    """The environment, with bytecode."""
    return {name: v for name, v in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def cut(host: Host, number: int, previous: str, rng: random.Random) -> list[dict[str, object]]:
    """One boot that is cut at a random moment of its recording."""
    rate = QUIET_RATE if number % 2 else FULL_RATE
    return host.boot(
        *(["--previous", previous] if previous else []),
        *("--recording", f"cut{number:03d}", "--rate", str(rate)),
        kill_on='"given"',
        kill_after=rng.uniform(0.2, 6.0),
    )


def run_cuts(host: Host, cuts: int, seed: int, slack_ns: int) -> bool:
    """Cut the power so many times; whether every promise was kept."""
    rng, previous, before = random.Random(seed), "", Told()
    durable = intact = 0
    ages_ns: list[int] = []
    losses_ns: list[int] = []
    for number in range(cuts + 1):
        lines = (
            cut(host, number, previous, rng) if number < cuts else host.boot("--previous", previous)
        )
        for found in (each for each in lines if previous and each.get("found") == previous):
            frames = _int(found["frames"])
            # The last frames may have come between the last line and the cut.
            kept = before.on_disk <= frames <= before.given + FULL_RATE
            durable += kept
            intact += bool(found["intact"])
            losses_ns.append(before.lost_ns(frames))
            ages_ns += before.ages_ns
            print(
                f"{previous}: given {before.given}, on the disk {before.on_disk}, found {frames},"
                f" {found['whole']} of {found['files']} files whole; oldest lost"
                f" {losses_ns[-1] / 1e9:.2f} s, chunks on the disk after at most"
                f" {max(before.ages_ns, default=0) / 1e9:.2f} s, {'good' if kept else 'BAD'}",
                flush=True,
            )
        before, previous = Told.of(lines), f"cut{number:03d}"
    late = sum(age_ns > BOUND_NS + slack_ns for age_ns in ages_ns)
    print(
        f"{cuts} cuts: {durable} kept what was on the disk, {intact} intact; oldest lost frame:"
        f" {spread(losses_ns)}; oldest frame of a chunk when it was on the disk: {spread(ages_ns)},"
        f" {late} of {len(ages_ns)} chunks later than the bound"
    )
    return durable == intact == cuts and not late


def spread(values_ns: Iterable[int]) -> str:
    """Median and worst, in seconds.

    >>> spread([3_000_000_000, 1_000_000_000, 2_000_000_000])
    'median 2.00 s, worst 3.00 s'
    """
    ordered = sorted(values_ns) or [0]
    return f"median {ordered[len(ordered) // 2] / 1e9:.2f} s, worst {ordered[-1] / 1e9:.2f} s"


def run_refusals(host: Host) -> bool:
    """A full and a read-only disk; whether every frame is recorded or reported."""
    good = True
    for what in ("full", "read-only"):
        told = host.boot("--refuse", what)
        sums = {key: value for each in told for key, value in each.items()}
        # `given` of the last line is the one after the end.
        counted = _int(sums["frames"]) + _int(sums["lost"])
        kept = counted == _int(sums["given"]) and sums["intact"] and "failed" not in sums
        good &= bool(kept)
        print(
            f"{what}: given {sums['given']}, recorded {sums['frames']}, reported lost"
            f" {sums['lost']}, {'good' if kept else 'BAD'}; {sums.get('failed', sums['problems'])}",
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
