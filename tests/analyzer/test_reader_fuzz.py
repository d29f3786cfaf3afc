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
    for number in range(8000, 8020):
        raw = reader_fuzz.case(kind, 0, number, seeds, others)
        path = tmp_path / f"x{reader_fuzz.suffix(kind, raw)}"
        path.write_bytes(raw)
        reader_fuzz.read_case(path, 1)


def test_damaged_mdf_files_are_read_or_refused_by_a_process_of_their_own(tmp_path: Path) -> None:
    pytest.importorskip("asammdf")
    seeds, path = [make() for make in reader_seeds.SEEDS["mf4"]], tmp_path / "x.mf4"
    for number in range(9000, 9003):
        path.write_bytes(reader_fuzz.case("mf4", 0, number, seeds, [candump(FRAMES)]))
        reader_fuzz.read_case(path, reader_fuzz.CHILD_EVERY)
