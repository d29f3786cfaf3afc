"""A session as a user opens it in Python: ranges, places of frames, dates, descriptions."""

from pathlib import Path

import pytest

pd = pytest.importorskip("pandas")

from syncline_analyzer import open_session
from syncline_schemas.errors import CaptureError, DescriptionError, UsageError

HEARTBEATS = "".join(f"({1_700_000_000 + k}.000000) can0 705#05\n" for k in range(20))
UNDATED = "".join("  can0  705   [1]  05\n" for _ in range(5))


def log(folder: Path, text: str = HEARTBEATS, name: str = "line.log") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_range_keeps_the_place_of_each_frame_and_the_origin_of_time(tmp_path: Path) -> None:
    session = open_session(log(tmp_path), start="5s", end="8s")
    states = session.nmt_states()
    assert session.analysis.capture.frames == 3
    assert session.analysis.capture.first_ns == 1_700_000_000_000_000_000
    assert states["evidence"].dropna().tolist() == [5]


def test_ranges_are_half_open_and_may_be_utc(tmp_path: Path) -> None:
    session = open_session(log(tmp_path), start="2023-11-14T22:13:22Z", end="4s")
    assert [int(t) // 10**9 for batch in session.frames() for t in batch.t_ns] == [
        1_700_000_002,
        1_700_000_003,
    ]


def test_frames_of_a_range_within_the_session(tmp_path: Path) -> None:
    session = open_session(log(tmp_path))
    assert sum(len(batch) for batch in session.frames("1s", "3s")) == 2


def test_an_undated_log_shows_no_dates(tmp_path: Path) -> None:
    session = open_session(log(tmp_path, UNDATED))
    assert session.nmt_states()["start"].isna().all()


def test_every_table_of_the_interface_is_a_frame(tmp_path: Path) -> None:
    session = open_session(log(tmp_path))
    frames = [
        session.nodes(), session.nmt_states(), session.nmt_commands(), session.sync(),
        session.pdos(), session.pdo_responses(0x185), session.emcy(), session.errors(),
        session.sdo(), session.objects(5), session.traces(), session.bus_load(), session.gaps(),
    ]  # fmt: skip
    assert all(isinstance(frame, pd.DataFrame) for frame in frames)
    assert session.nodes()["node"].tolist() == [5]


def test_mistakes_are_our_errors(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no capture given"):
        open_session([])
    with pytest.raises(CaptureError, match="absent"):
        open_session(tmp_path / "absent.log").findings()
    with pytest.raises(DescriptionError, match="jn2100"):
        open_session(log(tmp_path), devices={10: "jn2101"})
    with pytest.raises(UsageError, match="is no time"):
        open_session(log(tmp_path), start="soon")
