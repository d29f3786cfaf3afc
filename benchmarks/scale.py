"""Whether memory stays flat and time per frame the same, however long a capture is.

    uv run --group bench python -m benchmarks.scale 1 10 100

The numbers are millions of frames: the bus of `benchmarks.traffic`, a stretch of it repeated with
later times as often as it takes, as our own MCAP (28 MB per million frames, deleted afterwards).
Each is analyzed whole, findings and tables, in a process of its own. Prints peak memory, and CPU
time per frame beside that of the first size.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.__main__ import run_case
from benchmarks.traffic import MILLISECOND, START_NS, traffic
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata
from syncline_schemas.capture.writer import CaptureWriter

STRETCH_FRAMES = 1_000_000
MINUTE_NS = 60_000 * MILLISECOND
"""Every period of the traffic goes into it without rest."""


def repeated(frames: int) -> Iterator[FrameBatch]:
    """So many frames in pieces: whole minutes of the traffic, again and again."""
    whole = traffic(min(frames, STRETCH_FRAMES) + 2 * 60 * 1000)
    minutes = int(whole.t_ns[-1] - START_NS) // MINUTE_NS
    stretch = whole[: int(np.searchsorted(whole.t_ns, START_NS + minutes * MINUTE_NS))]
    made = 0
    while made < frames:
        piece = stretch[: frames - made]
        yield piece
        made += len(piece)
        stretch = replace(stretch, t_ns=stretch.t_ns + minutes * MINUTE_NS)


def write_capture(frames: int, path: Path) -> None:
    """The traffic as a capture of ours, in constant memory."""
    metadata = CaptureMetadata(
        "0", "benchmark", created_ns=START_NS, clock="log", resolution_ns=1000
    )
    with path.open("wb") as stream:
        writer = CaptureWriter(stream, metadata, [BusInfo("can0", 0, 125_000)])
        for piece in repeated(frames):
            writer.write_frames(piece)
        writer.finish()


def main() -> None:
    """Write, analyze and delete one capture after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("millions", type=float, nargs="+", help="millions of frames of each")
    parser.add_argument("--repeats", type=int, default=1, help="runs of each; the fastest counts")
    args = parser.parse_args()
    print(f"{'million frames':>15}{'peak MB':>9}{'wall s':>9}{'CPU us/frame':>14}{'to first':>10}")
    first = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for millions in args.millions:
            path = Path(folder) / "capture.mcap"
            write_capture(round(millions * 1e6), path)
            runs = [
                run_case("analyze_syncline", path, path.with_suffix(""))
                for _ in range(args.repeats)
            ]
            run = min(runs, key=lambda run: run["cpu_s"])
            cpu_us = run["cpu_s"] / run["frames"] * 1e6
            first = first or cpu_us
            print(
                f"{millions:>15g}{run['peak_mb']:>9.0f}{run['wall_s']:>9.1f}"
                f"{cpu_us:>14.3f}{cpu_us / first:>10.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
