"""SIGKILL at full load and on a quiet bus, again and again in one folder (benchmarks/crash.py)."""

from pathlib import Path

import pytest

crash = pytest.importorskip("benchmarks.crash", reason="the benchmarks are not installed")

MARGIN_FRAMES_S = 0.5
"""On a busy machine the recorder may get its share of time so much later."""


@pytest.mark.parametrize(("rate", "kills"), [(32_000.0, 3), (2.0, 2)])
def test_kills_in_a_row_lose_no_more_than_the_bound(
    tmp_path: Path, rate: float, kills: int
) -> None:
    folder = tmp_path / "captures"
    killed = crash.kill_in_a_row(folder, kills, rate, seed=7)
    for each in killed:
        assert each.found.intact
        assert each.found.frames <= each.given + rate
        assert each.lost_ns < crash.BOUND_NS + MARGIN_FRAMES_S * 1e9
    assert any(each.found.frames for each in killed)
    last = max(path.stem for path in folder.glob("*.given"))
    cut = [path for path in folder.glob("*.part.mcap") if last not in path.name]
    assert len(cut) <= 1
