"""The clock of an adapter: its fit is told, and stands at the begin of every file."""

import errno
import json
from pathlib import Path
from typing import Any

from syncline_analyzer.info import inspect
from syncline_analyzer.views.info_text import info_text
from syncline_logger.adapter_clock import Knot
from syncline_logger.clock import ClockReading
from syncline_logger.segments import Split
from syncline_logger.status_view import status_json
from syncline_logger.triggers.plan import TriggerPlan
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.scan import CaptureScan
from syncline_schemas.capture.scan import ClockReading as Sample
from tests.logger.store_runs import FailingDisk, Run, S, files_of, numbers_in


def run_of(folder: Path, **options: Any) -> Run:
    return Run(folder, buses=("a", "b"), **options)


def tie(run: Run, bus: int, number: int) -> None:
    """Note the knot of this number: stamps begin at it, with an error of as many milliseconds."""
    knot = Knot(number, run.now_ns, -1_500 * number, number * 1_000_000)
    run.recording.add_knot(bus, knot, ClockReading(run.now_ns, run.now_ns, 0), run.now_ns)


def knots_in(path: Path) -> list[tuple[int, int, int]]:
    """Bus, number and log time of the knots in a file."""
    return [
        (item.sample.bus, item.sample.adapter_ns, item.t_ns)
        for item in CaptureScan(path).items()
        if isinstance(item, Sample) and item.sample.HasField("bus")
    ]


def times_in(path: Path) -> list[int]:
    """Times of the frames of a file."""
    batches = CaptureScan(path).batches()
    return [t for item in batches if isinstance(item, FrameBatch) for t in item.t_ns.tolist()]


def test_every_file_begins_with_the_knots_in_force(tmp_path: Path) -> None:
    run = run_of(tmp_path, split=Split(6_000))
    for number in range(1, 10):
        tie(run, 0, number)
        if number == 2:
            tie(run, 1, 70)
        run.step(5)
    run.finish()
    latest: dict[int, int] = {}
    paths = files_of(tmp_path)
    assert len(paths) > 5
    for path in paths:
        knots = knots_in(path)
        first_ns = int(times_in(path)[0])
        head: dict[int, int] = {}
        for bus, number, at_ns in knots:
            if at_ns <= first_ns:
                head.setdefault(bus, number)
        assert path == paths[0] or {bus: head[bus] for bus in latest} == latest
        latest.update({bus: number for bus, number, _ in knots})
    assert latest == {0: 9, 1: 70}
    assert numbers_in(*paths) == list(range(run.sent))


def test_an_event_begins_with_the_knots_of_its_time(tmp_path: Path) -> None:
    only = TriggerPlan(before_ns=3 * S, after_ns=2 * S, only=True)
    run = run_of(tmp_path, triggers=only)
    tie(run, 0, 1)
    run.step(6)
    tie(run, 0, 2)
    run.step(6)
    tie(run, 0, 3)
    run.step(1)
    run.recording.mark("now", run.now_ns)
    run.step(6)
    tie(run, 0, 4)
    run.step(20)
    run.recording.mark("again", run.now_ns)
    run.step(2).finish()
    first, second = files_of(tmp_path)
    assert [number for _, number, _ in knots_in(first)] == [2, 3]
    assert [number for _, number, _ in knots_in(second)] == [4]


def test_a_knot_that_the_disk_refused_is_in_the_next_file(tmp_path: Path) -> None:
    full = [False]
    disk = FailingDisk(lambda what, path: errno.ENOSPC if full[0] and what == "write" else 0)
    run = run_of(tmp_path, disk=disk, split=Split(6_000))
    run.store.waiting.max_frames = 150
    tie(run, 0, 1)
    run.step(1)
    full[0] = True
    run.step(3)
    tie(run, 0, 2)
    run.step(2)
    assert run.store.waiting.lost_frames
    full[0] = False
    run.step(20).finish()
    heads = [knots_in(path)[0][1] for path in files_of(tmp_path)]
    assert (heads[0], heads[-1]) == (1, 2)


def test_the_fit_is_told(tmp_path: Path) -> None:
    run = run_of(tmp_path)
    tie(run, 1, 9)
    tie(run, 1, 3)
    run.step(2)
    told = json.loads(status_json(run.recording.snapshot(run.now_ns)))
    assert [bus["clock_residual_ns"] for bus in told["buses"]] == [None, 3_000_000]
    run.finish()
    info = inspect(files_of(tmp_path)[0])
    [(bus, fit)] = info.adapter_fits.items()
    assert (bus, fit.samples, fit.residual_ns, fit.rate_ppb) == ("b", 2, 3_000_000, -4_500)
    [line] = [line for line in info_text(info).splitlines() if "clock b" in line]
    assert line.split(maxsplit=2)[2] == (
        "of the adapter, 4.5 ppm fast, onto UTC to 3 ms, 9 ms at worst"
    )
