"""A session as a user opens it in Python: ranges, places of frames, dates, descriptions."""

from pathlib import Path

import pytest

pd = pytest.importorskip("pandas")

from syncline_analyzer import open_session
from syncline_analyzer.moments import Moment, parse_moment
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


@pytest.mark.parametrize("text", ["2s", "0:02", "0:02.000", "0:00:02.0", "+2.000 s", "+2.000s"])
def test_a_time_is_taken_as_it_is_printed(tmp_path: Path, text: str) -> None:
    session = open_session(log(tmp_path))
    assert sum(map(len, session.frames(text))) == sum(map(len, session.frames("2s"))) > 0
    assert parse_moment(text) == Moment(2_000_000_000, relative=True)


def test_utc_is_taken_as_it_is_printed() -> None:
    written, printed = "2026-03-01T12:00:00.5Z", "2026-03-01 12:00:00.500000 UTC"
    assert parse_moment(printed) == parse_moment(written)


@pytest.mark.parametrize("text", ["0:99", "1:2:3:04", "+2", "12:00:0", ":30"])
def test_what_is_half_a_time_is_a_mistake(text: str) -> None:
    with pytest.raises(UsageError, match="is no time"):
        parse_moment(text)


def test_findings_are_a_frame_and_dataclasses(tmp_path: Path) -> None:
    session = open_session(log(tmp_path))
    assert isinstance(session.findings(), pd.DataFrame)
    assert session.analysis.findings == []


@pytest.mark.parametrize(
    ("start", "end", "what"),
    [("6s", "5s", "not before"), ("1h", None, "no frame lies")],
)
def test_an_empty_range_is_a_mistake(
    tmp_path: Path, start: str, end: str | None, what: str
) -> None:
    with pytest.raises(UsageError, match=what):
        open_session(log(tmp_path), start=start, end=end).findings()


def test_dates_on_an_undated_log_are_a_mistake(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no dates"):
        open_session(log(tmp_path, UNDATED), start="2026-03-01T00:00:00Z").findings()


@pytest.mark.parametrize("back_s", [1, 5, 30, 60, 3600])
def test_a_clock_step_back_loses_no_node(tmp_path: Path, back_s: int) -> None:
    def beat(k: int) -> str:
        t_ms = 1_700_000_000_000 + k * 100 - (back_s * 1000 if k >= 100 else 0)
        return "".join(
            f"({t_ms // 1000}.{t_ms % 1000 + node:03d}000) can0 70{node}#05\n" for node in (5, 6)
        )

    session = open_session(log(tmp_path, "".join(beat(k) for k in range(200))))
    assert session.findings()["id"].tolist() == ["clock.step_back"]
    assert session.nodes()["final_state"].tolist() == ["OPERATIONAL"] * 2
    assert set(session.nmt_states()["state"]) <= {"OPERATIONAL", "UNKNOWN"}


def test_a_steady_rhythm_is_no_coarse_clock(tmp_path: Path) -> None:
    assert open_session(log(tmp_path)).analysis.capture.resolution_ns == 1000


def test_a_described_bus_that_is_not_there_is_said(tmp_path: Path) -> None:
    description = tmp_path / "bus.toml"
    description.write_text("[bus.can9]\nbitrate = 125000\n", encoding="utf-8")
    session = open_session(log(tmp_path), description=description)
    assert "can9" in session.analysis.capture.notes[-1]


def test_a_packed_capture_of_ours(tmp_path: Path) -> None:
    import gzip

    from syncline_analyzer.convert import convert

    convert([log(tmp_path)], tmp_path / "a.mcap")
    packed = tmp_path / "a.mcap.gz"
    packed.write_bytes(gzip.compress((tmp_path / "a.mcap").read_bytes()))
    capture = open_session(packed).analysis.capture
    assert (capture.frames, capture.files, capture.damage) == (20, [str(packed)], [])
