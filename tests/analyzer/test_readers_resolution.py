"""The step of the times in a text log, as far as its frames tell."""

from collections.abc import Sequence
from pathlib import Path
from random import Random

import pytest

from syncline_analyzer.readers import open_capture


def step_of(path: Path, times_ns: list[int], ids: Sequence[int] = (0x181,), buses: int = 1) -> int:
    """What the reader says of a candump log with frames at these times, and these ids in turn."""
    lines = [
        f"({t // 10**9}.{t % 10**9 // 1000:06d}) can{k % buses} {ids[k % len(ids)]:03X}#0102\n"
        for k, t in enumerate(times_ns)
    ]
    return step_of_lines(path, lines)


def step_of_lines(path: Path, lines: list[str]) -> int:
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


START = 1_700_000_000 * 10**9
MS = 1_000_000


def test_a_steady_rhythm_is_no_coarse_clock(tmp_path: Path) -> None:
    assert step_of(tmp_path, [START + k * 10 * MS for k in range(100)]) == 1000


def test_no_rhythm_keeps_on_whole_milliseconds_for_hundreds_of_frames(tmp_path: Path) -> None:
    assert step_of(tmp_path, [START + k * 10 * MS for k in range(500)]) == MS


@pytest.mark.parametrize("step_ns", [100_000, MS, 10 * MS])
def test_frames_that_share_stamps_tell_their_step(tmp_path: Path, step_ns: int) -> None:
    """A SYNC every 10 ms and two answers: hardly any different distances, in a short log."""
    times = [
        (START + k * 10 * MS + late) // step_ns * step_ns
        for k in range(30)
        for late in (20_000, 130_000 + k % 3 * 600_000, 180_000 + k % 3 * 600_000)
    ]
    assert step_of(tmp_path, times, (0x80, 0x181, 0x182)) == step_ns


def test_a_frame_that_is_written_twice_tells_nothing(tmp_path: Path) -> None:
    times = [START + k // 2 * 10 * MS for k in range(100)]
    assert step_of(tmp_path, times) == 1000


def test_frames_of_two_buses_may_share_a_stamp(tmp_path: Path) -> None:
    times = [START + k // 2 * 10 * MS for k in range(100)]
    assert step_of(tmp_path, times, (0x181, 0x182), buses=2) == 1000


def test_the_coarser_bus_counts(tmp_path: Path) -> None:
    """Two adapters in one log, one of which stamps in milliseconds."""
    lines = [
        f"({t // 10**9}.{t % 10**9 // 1000:06d}) {bus} 181#0102\n"
        for bus, step_ns in (("can0", 1000), ("can1", MS))
        for t in busy(step_ns)
    ]
    assert step_of_lines(tmp_path, sorted(lines)) == MS


@pytest.mark.parametrize(("stamp", "step_ns"), [("5.25", 10 * MS), ("5.250000", 1000)])
def test_no_clock_is_finer_than_it_is_written(tmp_path: Path, stamp: str, step_ns: int) -> None:
    assert step_of_lines(tmp_path, [f"({stamp}) can0 181#0102\n"]) == step_ns
