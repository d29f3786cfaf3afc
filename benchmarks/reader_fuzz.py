"""Damaged files of every format: `python -m benchmarks.reader_fuzz all --seconds 60`.

A case is made from the seed, the format and its number alone. What is allowed: frames, or one of
Syncline's own errors. What is not: another exception, a batch that is none, more than `CASE_S` of
processor time, more memory than `MEMORY_BYTES`. Cases that fail are kept in `--out`.
"""

import argparse
import faulthandler
import os
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from random import Random

import numpy as np

from benchmarks.mutation import TAIL_BYTES, mutated
from benchmarks.reader_seeds import REBUILT, SEEDS
from syncline_analyzer.readers import open_capture
from syncline_analyzer.readers.magic import MF4_MAGIC
from syncline_analyzer.readers.mf4_child import messages
from syncline_analyzer.session import open_session
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.devices.check import check_file
from syncline_schemas.errors import SynclineError

CASE_S = 20.0
"""Processor time that a case may take."""
HANG_S = 120.0
"""Time after which a case is given up: the machine may be busy."""
MEMORY_BYTES = 3 << 30
PEAK_BYTES = 800 << 20
"""What a process may hold at most after any case."""
ANALYZED_EVERY = 40
"""One case of so many is analyzed, not only read."""


CHILD_EVERY = 500
"""One case of MDF of so many is read as users have it read, by a process of its own."""


class Broken(Exception):
    """What was read is not what readers promise."""


def case(kind: str, seed: int, number: int, seeds: list[bytes], others: list[bytes]) -> bytes:
    """The bytes of a case: first every cut of the last kilobyte of each file, then by chance."""
    for raw in seeds:
        cuts = min(TAIL_BYTES, len(raw))
        if number < cuts:
            return raw[: len(raw) - 1 - number] or b"\0"
        number -= cuts
    chance = Random(f"{kind} {seed} {number}")
    raw = chance.choice(seeds)
    if kind in REBUILT and chance.random() < 0.7:
        return REBUILT[kind](chance, raw, others)
    return mutated(chance, raw, others)


def suffix(kind: str, raw: bytes) -> str:
    """The ending of a case's file, which tells how it is read."""
    if kind == "eds":
        return ".xdd" if raw[:1] == b"<" else ".eds"
    return ".mf4" if kind == "mf4" else ".x"


def read_case(path: Path, number: int) -> None:
    """Read a file to its end, or have it refused."""
    try:
        if path.suffix in (".eds", ".xdd"):
            check_file(path)
            return
        if path.suffix == ".mf4" and number % CHILD_EVERY:
            _read_mf4_here(path)
            return
        reader = open_capture(path)
        items: Iterator[FrameBatch | Gap] = reader.batches()
        for item in items:
            _check(item, len(reader.facts.buses))
        if number % ANALYZED_EVERY == 0:
            open_session(path).analyze()
    except SynclineError as error:
        if not str(error).strip():
            raise Broken("an error without words") from error


def _read_mf4_here(path: Path) -> None:
    """What the process that reads MDF files does, in this one: to start it takes a second each."""
    if not path.read_bytes().startswith(MF4_MAGIC):
        return
    with redirect_stdout(StringIO()):
        for message in messages(path):
            if message.frames is not None and message.facts is not None:
                _check(message.frames, len(message.facts.buses))


def _check(item: FrameBatch | Gap, buses: int) -> None:
    if isinstance(item, Gap):
        if item.end_ns < item.start_ns:
            raise Broken("a gap ends before it starts")
        return
    n = len(item)
    columns: list[tuple[np.ndarray, type]] = [
        (item.t_ns, np.int64),
        (item.bus, np.uint8),
        (item.can_id, np.uint32),
        (item.flags, np.uint16),
        (item.dlc, np.uint8),
    ]
    if any(column.dtype != kind or column.shape != (n,) for column, kind in columns):
        raise Broken("columns of another kind or length")
    if item.data.shape not in ((n, 8), (n, 64)) or item.data.dtype != np.uint8:
        raise Broken("a data column of another shape")
    if not n:
        return
    extended = (item.flags & FrameFlag.EXTENDED) != 0
    error, remote = (item.flags & FrameFlag.ERROR) != 0, (item.flags & FrameFlag.REMOTE) != 0
    if np.any(item.can_id > np.where(extended | error, 0x1FFFFFFF, 0x7FF)):
        raise Broken("an identifier that there is not")
    if np.any(item.dlc > item.data.shape[1]):
        raise Broken("a length beyond the data")
    if np.any(item.data[np.arange(item.data.shape[1]) >= np.where(remote, 0, item.dlc)[:, None]]):
        raise Broken("bytes behind the data")
    if int(item.bus.max()) >= buses:
        raise Broken("a bus without a name")


def work(kind: str, seed: int, first: int, seconds: float, out: Path) -> int:
    """Run cases for a while; their number so far is in the file `at`, failures stand beside it."""
    warnings.simplefilter("ignore")
    warnings.filterwarnings("error", category=RuntimeWarning, module=r"syncline_.*")
    _limit_memory()
    seeds = [make() for make in SEEDS[kind]]
    others = [make() for name in ("candump", "asc", "mcap", "blf", "csv") for make in SEEDS[name]]
    # A reader's imports are no part of a case.
    number, end, failures = first, time.monotonic() + seconds, 0
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    while time.monotonic() < end:
        raw = case(kind, seed, number, seeds, others)
        path = folder / f"case{suffix(kind, raw)}"
        path.write_bytes(raw)
        (out / f"{kind}.at").write_text(f"{number}", encoding="ascii")
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        problem = _tried(path, number)
        faulthandler.cancel_dump_traceback_later()
        if problem:
            failures += 1
            (out / f"{kind}-{seed}-{number}{path.suffix}").write_bytes(raw)
            print(f"{kind} {seed} {number}: {problem}", flush=True)
        number += 1
    return failures


def _tried(path: Path, number: int) -> str | None:
    begun, peak = time.process_time(), _peak_bytes()
    try:
        read_case(path, number)
    except Exception as error:  # noqa: BLE001 - every other exception is a failure
        at = traceback.extract_tb(error.__traceback__)
        ours = next((f for f in reversed(at) if "syncline_" in f.filename), at[-1])
        name = Path(ours.filename).name
        return f"{type(error).__name__} at {name}:{ours.lineno}: {str(error)[:100]!r}"
    if time.process_time() - begun > CASE_S:
        return f"{time.process_time() - begun:.0f} s of processor time"
    if _peak_bytes() > max(peak, PEAK_BYTES):
        return f"{_peak_bytes() >> 20} MiB of memory"
    return None


def _limit_memory() -> None:
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))


def _peak_bytes() -> int:
    try:
        import resource
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def run(kind: str, seed: int, seconds: float, out: Path, first: int = 0) -> tuple[str, int, int]:
    """Fuzz a format in a process of its own; (its name, cases, failures)."""
    begun, failures, at = time.monotonic(), 0, first
    while (left := seconds - (time.monotonic() - begun)) > 0:
        command = [sys.executable, "-m", "benchmarks.reader_fuzz", kind, "--worker", f"{at}"]
        command += ["--seed", f"{seed}", "--seconds", f"{left}", "--out", str(out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        sys.stdout.write(done.stdout)
        sys.stdout.flush()
        failures += done.stdout.count("\n")
        place = out / f"{kind}.at"
        at = int(place.read_text(encoding="ascii")) + 1 if place.exists() else at
        if done.returncode == 0:
            break
        failures += 1
        last = [line for line in done.stderr.splitlines() if line.strip()][-12:]
        print(f"{kind} {seed} {at - 1}: the process ended: {' | '.join(last)}", flush=True)
        if not place.exists():
            break
    return kind, at - first, failures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("format", choices=[*SEEDS, "all"])
    parser.add_argument("--seconds", type=float, default=10.0, help="for each format")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, help="where cases that fail are kept")
    parser.add_argument("--worker", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    out = args.out or Path(tempfile.mkdtemp(prefix="reader-fuzz-"))
    out.mkdir(parents=True, exist_ok=True)
    if args.worker is not None:
        work(args.format, args.seed, args.worker, args.seconds, out)
        return
    kinds = list(SEEDS) if args.format == "all" else [args.format]
    failed = 0
    with ThreadPoolExecutor(args.jobs) as pool:
        done = pool.map(lambda kind: run(kind, args.seed, args.seconds, out, args.first), kinds)
        for kind, cases, failures in done:
            failed += failures
            print(f"{kind:9} {cases:9,} cases, {failures} fail", flush=True)
    if failed:
        print(f"the cases that fail are in {out}")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
