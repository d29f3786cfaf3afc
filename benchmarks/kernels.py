"""What each compiled loop of reading is worth: `python -m benchmarks.kernels [CAPTURE LOG]`.

Every loop beside numpy's, on the same columns in the same process, taking turns; the least of many
times, in nanoseconds of processor time per frame.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from benchmarks.cases import convert_syncline
from benchmarks.traffic import traffic, write_candump
from syncline_analyzer.grouping import Grouping
from syncline_analyzer.readers import layout, open_capture
from syncline_analyzer.readers import lines as text_lines
from syncline_schemas import native, wire_length
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture import chunk_content, chunk_group
from syncline_schemas.capture.record_file import RecordFile

TURNS = 40


def compared(name: str, frames: int, compiled: Callable[[], Any], plain: Callable[[], Any]) -> None:
    """Print the least time of both."""
    least = [float("inf")] * 2
    for _ in range(TURNS):
        for place, work in enumerate((compiled, plain)):
            begin = time.process_time_ns()
            work()
            least[place] = min(least[place], (time.process_time_ns() - begin) / frames)
    print(f"  {name:44}{least[1]:8.1f}{least[0]:10.1f} ns/frame{least[1] / least[0]:7.1f} x")


def batch_of(capture: Path) -> FrameBatch:
    """The second batch of a capture; the first is short."""
    batches = (item for item in open_capture(capture).batches() if isinstance(item, FrameBatch))
    next(batches)
    return next(batches)


def given_to(module: Any, name: str, work: Callable[[], object]) -> tuple[Any, ...]:
    """What a function was called with the last time that some work called it."""
    function, seen = getattr(module, name), []

    def watched(*arguments: Any) -> Any:
        seen.append(arguments)
        return function(*arguments)

    setattr(module, name, watched)
    try:
        work()
    finally:
        setattr(module, name, function)
    return seen[-1]


def first(items: Iterable[object], count: int) -> None:
    """Go through so many items."""
    for _, _ in zip(range(count), items, strict=False):
        pass


def print_kernels(capture: Path, log: Path) -> None:
    """All of them."""
    print(f"  {'':44}{'numpy':>8}{'compiled':>10}")
    batch = batch_of(capture)
    count = len(batch)
    compared(
        "lengths on the wire",
        count,
        lambda: wire_length._native_bits(batch, 3),
        lambda: wire_length._numpy_bits(batch, 3),
    )
    compared(
        "order by identifier",
        count,
        lambda: Grouping.of(batch),
        lambda: Grouping._by_sorting(batch, 0),
    )
    group, channels = given_to(
        chunk_group, "_by_walk", lambda: first(open_capture(capture).batches(), 3)
    )
    ((_, plain),) = chunk_group._by_walk(group, channels)
    assert plain is not None
    with capture.open("rb") as file:
        records = RecordFile(file)
        indexed = [records.indexed(raw) for raw in group]
    assert chunk_group._plain_by_index(indexed, channels) is not None
    unpack = chunk_content.unpacked
    compared(
        "columns out of unpacked chunks, and unpacking",
        len(plain.frames),
        lambda: list(chunk_group._by_walk(group, channels)),
        lambda: chunk_group._plain_by_index(indexed, channels),
    )
    compared("  of which unpacking", len(plain.frames), *[lambda: [*map(unpack, group)]] * 2)
    part, matchers = given_to(
        text_lines, "known_lines", lambda: first(open_capture(log).batches(), 3)
    )
    reader = text_lines.TextReader(log, open_capture(log)._form)  # type: ignore[attr-defined]
    reader._matchers.update(matchers)

    def by_numpy() -> None:
        lines, lengths = layout.lines_of(part)
        reader._read_known(lines, lengths)

    compared(
        "columns out of lines of candump",
        part.count(b"\n"),
        lambda: layout.known_lines(part, matchers),
        by_numpy,
    )


def main() -> None:
    """Compare on a capture and a log, or on the benchmarks' traffic."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", nargs="*", type=Path, metavar="CAPTURE LOG")
    given = parser.parse_args().captures
    if not native.available():
        raise SystemExit(
            "the library was not built: python schemas/syncline_schemas/native/build.py"
        )
    if len(given) == 2:
        print_kernels(*given)
        return
    with tempfile.TemporaryDirectory() as folder:
        log, capture = Path(folder, "traffic.log"), Path(folder, "traffic.mcap")
        write_candump(traffic(500_000), log)
        convert_syncline(log, capture)()
        print_kernels(capture, log)


if __name__ == "__main__":
    main()
