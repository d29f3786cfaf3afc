"""The step of the times in a text log, as far as its frames tell."""

from pathlib import Path
from random import Random

import pytest

from syncline_analyzer.readers import open_capture


def step_of(path: Path, times_ns: list[int]) -> int:
    """What the reader says of a candump log with frames at these times."""
    lines = [f"({t // 10**9}.{t % 10**9 // 1000:06d}) can0 181#0102\n" for t in times_ns]
    log = path / "run.log"
    log.write_text("".join(lines), encoding="ascii")
    reader = open_capture(log)
    for _ in reader.batches():
        pass
    return reader.facts.resolution_ns


def busy(step_ns: int, count: int = 2000, mean_ns: int = 300_000) -> list[int]:
    """Frames at random, no two sooner than 50 us, with stamps of a step."""
    random, now, times = Random(1), 1_700_000_000 * 10**9, []
    for _ in range(count):
        now += 50_000 + int(random.expovariate(1) * mean_ns)
        times.append(now // step_ns * step_ns)
    return times


@pytest.mark.parametrize("step_ns", [1000, 10_000, 100_000, 1_000_000])
def test_the_stamps_of_a_busy_bus_tell_their_step(tmp_path: Path, step_ns: int) -> None:
    assert step_of(tmp_path, busy(step_ns)) == step_ns


def test_a_steady_rhythm_is_no_coarse_clock(tmp_path: Path) -> None:
    start = 1_700_000_000 * 10**9
    assert step_of(tmp_path, [start + k * 10_000_000 for k in range(500)]) == 1000


def test_pairs_in_a_steady_rhythm_are_stamped_in_milliseconds_at_most(tmp_path: Path) -> None:
    start = 1_700_000_000 * 10**9
    assert step_of(tmp_path, [start + k // 2 * 10_000_000 for k in range(500)]) == 1_000_000
