"""Every reader on files damaged by seed; `benchmarks.reader_fuzz` runs the same for longer."""

from pathlib import Path

import pytest

from tests.analyzer.log_frames import FRAMES
from tests.analyzer.text_files import candump

reader_fuzz = pytest.importorskip(
    "benchmarks.reader_fuzz", reason="the benchmarks are not installed"
)
reader_seeds = pytest.importorskip("benchmarks.reader_seeds")


@pytest.mark.parametrize("kind", reader_seeds.SEEDS)
def test_damaged_files_are_read_or_refused(kind: str, tmp_path: Path) -> None:
    if kind == "mf4":
        pytest.importorskip("asammdf")
    seeds, others = [make() for make in reader_seeds.SEEDS[kind]], [candump(FRAMES)]
    # Each MDF file is read in a process of its own.
    for number in range(5000, 5004 if kind == "mf4" else 5020):
        path = tmp_path / ("x.eds" if kind == "eds" else "x")
        path.write_bytes(reader_fuzz.case(kind, 0, number, seeds, others))
        reader_fuzz.read_case(path, 1)
