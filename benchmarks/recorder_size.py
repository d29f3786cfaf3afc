"""How long a gigabyte lasts, by load: `python -m benchmarks.recorder_size` prints the table of docs/recording.md.

A bus at 1 Mbit/s and full load (`benchmarks.full_bus`), of which only so many cycles are there, and
one healthy machine (`benchmarks.traffic`); two minutes of each.
"""

import argparse
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from benchmarks.full_bus import BITRATE, DESCRIPTION, SECOND_NS, full_second, load_percent, shifted
from benchmarks.traffic import START_NS, traffic
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record_batches
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.description import BusDescription

DAY_S = 86_400
GB = 1e9


def thinned(one_of: int) -> FrameBatch:
    """A full second of which one cycle of `one_of` is left."""
    second = full_second(0)
    cycle = (second.can_id == 0x80).cumsum()
    return second[cycle % one_of == 0]


def of_second(second: FrameBatch, seconds: int) -> Iterator[FrameBatch]:
    """A second again and again."""
    for number in range(seconds):
        yield shifted(second, START_NS + number * SECOND_NS, 0)


def bytes_a_second(
    items: Callable[[], Iterator[FrameBatch]], seconds: int, **options: object
) -> float:
    """Size of a recording of these, beyond what every file has, by second."""

    def size(batches: Iterator[FrameBatch]) -> int:
        with tempfile.TemporaryDirectory() as folder:
            chosen = RecordOptions(sync=False, description=BusDescription.loads(DESCRIPTION))
            chosen = replace(chosen, **options)  # type: ignore[arg-type]
            bus = BusInfo("can0", 0, BITRATE, clock="kernel")
            result = record_batches(batches, [bus], Path(folder), chosen)
            return result.path.stat().st_size

    return (size(items()) - size(iter([]))) / seconds


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=120)
    args = parser.parse_args()
    seconds = args.seconds
    machine = traffic(780 * seconds)
    cases: list[tuple[str, float, Callable[[], Iterator[FrameBatch]]]] = [
        ("one machine, 4 nodes", 780, lambda: iter([machine]))
    ]
    for one_of in (100, 20, 10, 4, 2, 1):
        second = thinned(one_of)
        name = f"1 Mbit/s at {load_percent(second):.0f} %"
        cases.append((name, len(second), lambda second=second: of_second(second, seconds)))  # type: ignore[misc]
    print("| bus | frames/s | GB a day | days per GB | GB a day, `--no-decode` | days per GB |")
    print("|---|---|---|---|---|---|")
    for name, rate, items in cases:
        decoded = bytes_a_second(items, seconds) * DAY_S / GB
        raw = bytes_a_second(items, seconds, decode=False) * DAY_S / GB
        print(
            f"| {name} | {rate:,.0f} | {decoded:.2f} | {1 / decoded:.2g} | {raw:.2f} | {1 / raw:.2g} |"
        )


if __name__ == "__main__":
    main()
