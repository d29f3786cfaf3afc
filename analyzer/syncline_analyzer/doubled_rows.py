"""The rows that tell what a capture holds twice."""

from collections.abc import Mapping, Sequence

from syncline_analyzer.echo import Doubling
from syncline_analyzer.results import DoubledRow


def doubled_rows(doubled: Mapping[int, Doubling], buses: Sequence[str]) -> list[DoubledRow]:
    """One row per bus with copies."""
    return [
        DoubledRow(
            buses[number] if number < len(buses) else str(number),
            "all" if found.whole else "own" if found.own else "some",
            sorted({key & 0x7FF for key in found.told}),
            found.copies,
            found.start_ns,
            found.end_ns,
            found.delay_ns / 1000,
            found.evidence,
        )
        for number, found in sorted(doubled.items())
        if found.copies
    ]
