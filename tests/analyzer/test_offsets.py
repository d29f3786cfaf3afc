"""Files of one session whose clocks went differently."""

from pathlib import Path

import numpy as np
import pytest

from syncline_analyzer import open_session
from syncline_analyzer.convert import convert
from syncline_analyzer.offsets import Offset, parse_offset
from syncline_schemas.batch import FrameBatch
from syncline_schemas.errors import UsageError
from tests.analyzer.log_builder import T0_NS, rows

HOUR_NS = 3_600_000_000_000


def _dated(tmp_path: Path, name: str, start_s: int, can_id: int, bus: str = "can0") -> Path:
    path = tmp_path / name
    lines = [f"({start_s + i}.000000) {bus} {can_id:03X}#0{i}\n" for i in range(3)]
    path.write_text("".join(lines), encoding="ascii")
    return path


def _undated(tmp_path: Path, name: str, start_s: int, can_id: int) -> Path:
    path = tmp_path / name
    lines = [f" {start_s + i}.000000 1 {can_id:03X} Rx d 1 0{i}\n" for i in range(3)]
    path.write_text("base hex timestamps absolute\n" + "".join(lines), encoding="ascii")
    return path


def _times(session_of: list[Path], **offsets: str) -> list[tuple[int, int]]:
    frames = FrameBatch.concat(list(open_session(session_of, offsets=offsets).frames()))
    return [(t_ns, can_id) for t_ns, _, can_id, *_ in rows(frames)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("3600", Offset(HOUR_NS)),
        ("+0.000001", Offset(1000)),
        ("-2.5", Offset(-2_500_000_000)),
        ("-1h30m", Offset(-HOUR_NS * 3 // 2)),
        ("2h", Offset(2 * HOUR_NS)),
        ("2023-11-14T22:13:20Z", Offset(T0_NS, dated=True)),
        ("2023-11-14T23:13:20+01:00", Offset(T0_NS, dated=True)),
    ],
)
def test_offsets_are_lengths_or_times(text: str, expected: Offset) -> None:
    assert parse_offset(text) == expected


@pytest.mark.parametrize("text", ["", "soon", "+2023-11-14T22:13:20Z", "1e5", "--3", "12:00:00"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is no offset"):
        parse_offset(text)


def test_a_file_whose_clock_was_an_hour_off_falls_into_its_place(tmp_path: Path) -> None:
    right = _dated(tmp_path, "right.log", 1_700_000_000, 0x181)
    late = _dated(tmp_path, "late.log", 1_700_003_600, 0x282, "can1")
    found = _times([late, right], **{"late.log": "-3599.5"})
    second = 1_000_000_000
    assert found == [
        (T0_NS, 0x181),
        (T0_NS + second // 2, 0x282),
        (T0_NS + second, 0x181),
        (T0_NS + 3 * second // 2, 0x282),
        (T0_NS + 2 * second, 0x181),
        (T0_NS + 5 * second // 2, 0x282),
    ]


def test_a_log_without_date_gets_one(tmp_path: Path) -> None:
    dated = _dated(tmp_path, "dated.log", 1_700_000_000, 0x181)
    undated = _undated(tmp_path, "undated.asc", 154, 0x282)
    with pytest.raises(UsageError, match=r"--offset\s+undated\.asc="):
        _times([dated, undated])
    with pytest.raises(UsageError, match=r"seconds do not place it .* --offset undated\.asc=20"):
        _times([dated, undated], **{"undated.asc": "5"})
    found = _times([undated, dated], **{"undated.asc": "2023-11-14T22:13:21.5Z"})
    assert [can_id for _, can_id in found] == [0x181, 0x181, 0x282, 0x181, 0x282, 0x282]
    assert found[2][0] == T0_NS + 1_500_000_000
    session = open_session(undated, offsets={"undated.asc": "2023-11-14T22:13:21.5Z"})
    assert session.analysis.capture.start_utc_ns == T0_NS + 1_500_000_000


def test_logs_without_dates_join_where_each_has_an_offset(tmp_path: Path) -> None:
    one, two = _undated(tmp_path, "1.asc", 0, 0x181), _undated(tmp_path, "2.asc", 0, 0x282)
    told = r"has no dates, .* --offset 1\.asc=0 --offset 2\.asc=0$"
    with pytest.raises(UsageError, match=told):
        _times([one, two], **{"1.asc": "0"})
    found = _times([two, one], **{"1.asc": "0", str(two): "+10"})
    assert [can_id for _, can_id in found] == [0x181] * 3 + [0x282] * 3
    assert np.diff([t_ns for t_ns, _ in found]).tolist() == [10**9, 10**9, 8 * 10**9] + [10**9] * 2
    assert open_session([one, two], offsets={"1.asc": "0", "2.asc": "10"}).analysis.capture.gaps


def test_a_name_that_is_no_file_of_the_session_is_refused(tmp_path: Path) -> None:
    path = _dated(tmp_path, "x.log", 1_700_000_000, 0x181)
    with pytest.raises(UsageError, match=r"--offset y\.log: is none of the captures"):
        _times([path], **{"y.log": "1"})


def test_a_converted_file_holds_the_moved_times(tmp_path: Path) -> None:
    path = _dated(tmp_path, "x.log", 1_700_000_000, 0x181)
    moved = tmp_path / "moved.mcap"
    result = convert([path], moved, offsets={"x.log": "1h"})
    assert any("3600 s" in note for note in result.notes)
    assert _times([moved])[0][0] == T0_NS + HOUR_NS
    assert _times([moved], **{"moved.mcap": "-1h"})[0][0] == T0_NS


def test_what_has_no_times_cannot_be_moved(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text("  can0  123   [1]  05\n  can0  124   [1]  06\n", encoding="ascii")
    for offset in ("1", "2023-11-14T22:13:20Z"):
        with pytest.raises(UsageError, match="has no times"):
            _times([path], **{"x.log": offset})
