"""Converting and inspecting: what arrives, and what is said to be lost."""

import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest

from syncline_analyzer.convert import convert
from syncline_analyzer.info import inspect
from syncline_analyzer.writers.formats import (
    BUS_NAMES,
    ERROR_CONTENTS,
    GAPS,
    MARKS,
    WRITE_FORMATS,
    WriteFormat,
)
from syncline_schemas.batch import FrameFlag, Gap
from syncline_schemas.errors import CaptureError, UsageError
from tests.analyzer.binary_files import sll2
from tests.analyzer.log_builder import T0_NS, read, rows
from tests.analyzer.log_frames import FRAMES
from tests.analyzer.text_files import busmaster
from tests.logger.capture_contents import doctor_complaints, read_capture

LOG = """(1700000000.000001) can0 123#1122
(1700000000.000002) can0 20000040#0001020304050607
(1700000000.000003) vcan7 18FF0011##15A
(1700000000.000004) can0 70A#R1
(1700000000.000003) can0 181#00 T
"""
DROPPED = "DROPCOUNT: dropped 5 CAN frames on 'can0' socket (total drops 5)\n"


def _source(tmp_path: Path, text: str = LOG, name: str = "a.log") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="ascii")
    return path


@pytest.mark.parametrize(
    ("name", "lost"),
    [
        ("x.mcap", {}),
        ("x.log", {}),
        ("x.log.gz", {}),
        ("x.asc", {"bus names": 2, "contents of error frames": 1}),
        ("x.blf", {"bus names": 2}),
        ("x.trc", {"bus names": 2, "contents of error frames": 1}),
        ("x.log.zst", {}),
        ("x.pcapng", {}),
        ("x.pcapng.gz", {}),
        ("x.csv", {}),
        ("x.csv.zst", {}),
    ],
)
def test_what_a_format_cannot_hold_is_counted(
    tmp_path: Path, name: str, lost: dict[str, int]
) -> None:
    result = convert([_source(tmp_path)], tmp_path / name)
    assert result.frames == 5
    assert result.lost == lost
    assert result.complete == (not lost)
    assert len(read(tmp_path / name)[0]) == 5


def test_parquet_holds_every_column(tmp_path: Path) -> None:
    import pandas as pd

    result = convert([_source(tmp_path)], tmp_path / "x.parquet")
    assert (result.frames, result.lost) == (5, {})
    table = pd.read_parquet(tmp_path / "x.parquet")
    assert table.t.astype("int64").tolist() == [T0_NS + k * 1000 for k in (1, 2, 3, 4, 3)]
    assert table.t.dt.tz is not None
    assert table.bus.tolist() == ["can0", "can0", "vcan7", "can0", "can0"]
    assert table.can_id.tolist() == [0x123, 0x40, 0x18FF0011, 0x70A, 0x181]
    assert table.data.tolist() == [b"\x11\x22", bytes(range(8)), b"\x5a", b"", b"\0"]
    assert table.dlc.tolist() == [2, 8, 1, 1, 1]
    marked = {
        name: table.index[table[name]].tolist() for name in table if table[name].dtype == bool
    }
    assert marked == {
        "extended": [2],
        "remote": [3],
        "error": [1],
        "fd": [2],
        "brs": [2],
        "esi": [],
        "tx": [4],
        "length_contradicts": [],
    }


def test_a_name_that_a_format_has_to_change_is_counted(tmp_path: Path) -> None:
    capture = tmp_path / "bag"
    capture.write_bytes(sll2(FRAMES))
    assert convert([capture], tmp_path / "x.log").lost == {"bus names": 2}
    assert convert([capture], tmp_path / "x.pcapng").lost == {}


def test_what_is_known_besides_the_frames_is_not_lost_silently(tmp_path: Path) -> None:
    capture = tmp_path / "bm.log"
    capture.write_bytes(busmaster(FRAMES))
    assert convert([capture], tmp_path / "x.mcap").lost == {}
    assert convert([capture], tmp_path / "x.pcapng").lost == {}
    assert read(tmp_path / "x.pcapng")[1].bitrates == {"1": 500_000}
    assert convert([capture], tmp_path / "x.csv").lost == {"bit rates": 1}


@pytest.mark.parametrize("form", WRITE_FORMATS, ids=[form.name for form in WRITE_FORMATS])
def test_what_a_format_loses_is_what_its_entry_says(tmp_path: Path, form: WriteFormat) -> None:
    contradictory = "  (1700000005.000000)  can0  123   [4]  05\n"
    text = LOG + DROPPED + contradictory
    known = {GAPS, MARKS, BUS_NAMES, ERROR_CONTENTS}
    if form.name not in ("asc", "trc", "blf"):
        known -= {BUS_NAMES}  # only numbered buses lose these names
    result = convert([_source(tmp_path, text)], tmp_path / f"x{form.endings[0]}")
    assert result.frames == 6
    assert set(result.lost) == set(form.cannot) & known


def test_a_capture_keeps_gaps_and_a_log_counts_them(tmp_path: Path) -> None:
    source = _source(tmp_path, LOG + DROPPED + LOG)
    assert convert([source], tmp_path / "x.mcap").lost == {}
    assert read(tmp_path / "x.mcap")[2] == read(source)[2]
    assert convert([source], tmp_path / "x.csv").lost["gaps in the recording"] == 1


def test_files_are_joined_in_order_of_time(tmp_path: Path) -> None:
    first = _source(tmp_path)
    second = _source(tmp_path, LOG.replace("(17000000", "(17000001"), "b.log")
    convert([second, first], tmp_path / "x.log")
    batch, facts, _ = read(tmp_path / "x.log")
    assert rows(batch)[:5] == rows(read(first)[0])
    assert rows(batch)[5:] == rows(read(second)[0])
    assert facts.buses == ["can0", "vcan7"]


@pytest.mark.parametrize("name", ["x.mcap", "x.asc", "x.blf", "x.trc", "x.pcapng", "x.csv"])
def test_times_without_a_date_count_on_from_where_they_did(tmp_path: Path, name: str) -> None:
    source = _source(tmp_path, "Time [s];ID;DLC;Data\n7200.5;0x702;1;05\n7201.5;0x702;1;05\n")
    convert([source], tmp_path / name)
    batch, facts, _ = read(tmp_path / name)
    assert batch.t_ns.tolist() == [7_200_500_000_000, 7_201_500_000_000]
    assert facts.time_base == "relative"


def test_what_the_inputs_could_not_tell_is_handed_on(tmp_path: Path) -> None:
    source = _source(tmp_path, "candump can0\n  can0  123   [1]  05\n")
    result = convert([source], tmp_path / "x.asc")
    assert result.unparsed_lines == 1
    assert not result.complete
    assert result.notes == ["a.log: the log has no times"]
    assert result.lost == {"bus names": 1, "that there are no times": 1}


@pytest.mark.parametrize("name", ["x.doc", "x", "x.mcap.gz", "x.parquet.zst", "a.log"])
def test_an_output_that_makes_no_sense_is_refused(tmp_path: Path, name: str) -> None:
    source = _source(tmp_path)
    with pytest.raises(UsageError):
        convert([source], tmp_path / name)
    assert source.read_text(encoding="ascii") == LOG


def test_an_output_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="cannot be written"):
        convert([_source(tmp_path)], tmp_path / "nowhere" / "x.log")
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]


@pytest.mark.skipif(shutil.which("log2asc") is None, reason="can-utils are not here")
def test_log2asc_reads_our_candump_and_we_read_its_asc(tmp_path: Path) -> None:
    text = "\n".join(
        line for line in LOG.splitlines() if "##" not in line and "20000040" not in line
    )
    convert([_source(tmp_path, text.replace(" T", "") + "\n")], tmp_path / "x.log")
    made = subprocess.run(
        ["log2asc", "-I", str(tmp_path / "x.log"), "can0"], capture_output=True, check=True
    )
    (tmp_path / "x.asc").write_bytes(made.stdout)
    batch, facts, _ = read(tmp_path / "x.asc")
    ours = rows(read(tmp_path / "x.log")[0])
    # Its ASC has steps of 100 us, and a remote frame without its length.
    assert [(frame[2], frame[3], frame[5]) for frame in rows(batch)] == [
        (frame[2], frame[3], frame[5]) for frame in ours
    ]
    assert facts.unparsed_count == 0


def test_info_counts_what_is_in_a_capture(tmp_path: Path) -> None:
    info = inspect(_source(tmp_path, LOG + DROPPED + "what\n"))
    assert (info.format, info.frames, info.data_frames) == ("candump", 5, 3)
    assert (info.remote_frames, info.error_frames) == (1, 1)
    assert (info.extended_frames, info.fd_frames) == (1, 1)
    assert info.frames_by_bus == {"can0": 4, "vcan7": 1}
    assert (info.first_ns, info.last_ns) == (T0_NS + 1000, T0_NS + 4000)
    assert (info.start_utc_ns, info.duration_ns, info.steps_back) == (T0_NS + 1000, 3000, 1)
    assert info.unparsed_lines == [(7, "what")]
    assert info.gaps == [Gap(T0_NS + 3000, T0_NS + 3000, "frames dropped by the kernel", 5, 0)]
    assert info.whole


def test_info_of_a_log_without_times_has_none(tmp_path: Path) -> None:
    info = inspect(_source(tmp_path, "  can0  123   [1]  05\n"))
    assert (info.first_ns, info.start_utc_ns, info.duration_ns) == (None, None, 0)


def test_info_of_a_cut_blf_says_that_it_is_not_whole(tmp_path: Path) -> None:
    convert([_source(tmp_path)], tmp_path / "x.blf")
    raw = (tmp_path / "x.blf").read_bytes()
    (tmp_path / "cut").write_bytes(raw[:-7])
    assert not inspect(tmp_path / "cut").whole
    assert inspect(tmp_path / "x.blf").whole


def test_a_frame_with_a_contradictory_length_stays_marked(tmp_path: Path) -> None:
    source = _source(tmp_path, "  (1700000000.000000)  can0  123   [4]  05\n")
    assert rows(read(source)[0])[0][3] == FrameFlag.DLC_INVALID
    result = convert([source], tmp_path / "x.log")
    assert result.lost == {"marks of a contradictory length": 1}


def test_a_long_capture_of_ours_satisfies_strangers(tmp_path: Path) -> None:
    lines = (
        f"({1_700_000_000 + k // 1000}.{k % 1000:03}000) can{k % 2} {0x181 + k % 5:03X}#{k:08X}\n"
        for k in range(70_000)
    )
    log = tmp_path / "long.log"
    log.write_text("".join(lines), encoding="ascii")
    capture = tmp_path / "long.mcap"
    assert convert([log], capture).frames == 70_000
    if shutil.which("pymcap-cli", path=sysconfig.get_path("scripts")):
        assert doctor_complaints(capture) == []
    contents = read_capture(capture)
    assert contents.frames("can1") == [
        (0x181 + k % 5, 0, 4, bytes.fromhex(f"{k:08X}")) for k in range(1, 70_000, 2)
    ]
    assert contents.log_times == sorted(contents.log_times)
