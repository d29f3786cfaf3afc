"""What a log does not tell is a note: requests to send, clocks that were not set, direction."""

from pathlib import Path

import can
import pytest

from syncline_analyzer.readers import open_capture
from syncline_schemas.batch import FrameFlag
from tests.analyzer.log_builder import Row, message, read, read_text, row, rows
from tests.analyzer.text_files import CLX_HEAD

TX = FrameFlag.TX
_UNDATED = row(5, 0x123, b"\5")[0] - row(0)[0]


def _asc(date: str, *lines: str) -> str:
    head = f"date {date}\nbase hex  timestamps absolute\nno internal events logged\n"
    return head + "".join(f"{line}\n" for line in lines)


def test_requests_to_send_in_an_asc_are_counted_and_are_no_frames(tmp_path: Path) -> None:
    text = _asc(
        "Tue Nov 14 22:13:20.000 2023",
        "   0.000001 1  123             TxRq   d 1 05",
        "   0.000002 1  123             Tx   d 1 05",
        "   0.000003 CANFD   1 TxRq     123  0 0 1  1 05  140000  73   1000 7a60 0 0",
    )
    found, facts = read_text(tmp_path, text)
    assert found == [row(2, 0x123, b"\5", flags=TX)]
    assert facts.unparsed_count == 0
    assert any(note.startswith("2 line(s) tell what was asked to be sent") for note in facts.notes)
    _, facts = read_text(tmp_path, _asc("Tue Nov 14 22:13:20.000 2023", " 0.1 1  123  Rx  d 1 05"))
    assert not any("asked to be sent" in note for note in facts.notes)


def test_requests_to_send_in_a_memorator_log_are_counted(tmp_path: Path) -> None:
    text = (
        "        Time Chan   Identifier Flags        DLC  Data     Counter\n"
        "    0.000005  1         123    TxRq          1   05                                       1\n"
        "    0.000006  1         123    Tx            1   05                                       2\n"
    )
    found, facts = read_text(tmp_path, text)
    assert len(found) == 1
    assert any(note.startswith("1 line(s) tell what was asked to be sent") for note in facts.notes)


@pytest.mark.parametrize(
    ("date", "block"),
    [
        ("Thu Jan 1 00:00:00.000 1970", "Begin Triggerblock Thu Jan 1 00:00:00.000 1970"),
        ("Thu Jan 01 01:00:00.000 am 1970", "// version 9.0.0"),
        ("Tue Jan 1 00:00:00.000 1980", "Begin Triggerblock"),
    ],
)
def test_an_asc_of_a_clock_that_was_not_set_has_no_date(
    tmp_path: Path, date: str, block: str
) -> None:
    found, facts = read_text(tmp_path, _asc(date, block, "   0.000005 1  123  Rx   d 1 05"))
    assert [each[0] for each in found] == [_UNDATED]
    assert facts.time_base == "relative"
    assert any("before 2000" in note for note in facts.notes)


def test_a_fraction_of_an_asc_date_is_no_year(tmp_path: Path) -> None:
    text = _asc("Tue Nov 14 22:13:20.1987 2023", "   0.000005 1  123  Rx   d 1 05")
    assert read_text(tmp_path, text)[1].time_base == "utc"


def test_an_asc_whose_block_alone_is_dated_has_that_date(tmp_path: Path) -> None:
    text = _asc(
        "Thu Jan 1 00:00:00.000 1970",
        "Begin Triggerblock Tue Nov 14 22:13:20.000 2023",
        "   0.000005 1  123  Rx   d 1 05",
    )
    found, facts = read_text(tmp_path, text)
    assert (found, facts.time_base) == ([row(5, 0x123, b"\5")], "utc")


@pytest.mark.parametrize("kind", ["asc", "trc"])
def test_what_python_can_writes_of_undated_frames_has_no_date(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"x.{kind}"
    with can.Logger(str(path)) as log:
        for t_s in (0.5, 0.75):
            log.on_message_received(
                can.Message(timestamp=t_s, arbitration_id=0x123, data=b"\5", is_extended_id=False)
            )
    batch, facts, _ = read(path)
    assert facts.time_base == "relative"
    assert int(batch.t_ns[1] - batch.t_ns[0]) == 250_000_000
    assert int(batch.t_ns[1]) < 10**9


@pytest.mark.parametrize("clock", ["1970-01-01 00:00:00.500000", "01.01.1980 00:00:00.500"])
def test_a_table_of_a_clock_that_was_not_set_has_no_date(tmp_path: Path, clock: str) -> None:
    found, facts = read_text(tmp_path, f"time;id;dir;data\n{clock};123;Rx;05\n")
    assert len(found) == 1
    assert facts.time_base == "relative"
    assert any("before 2000" in note for note in facts.notes)


def test_that_a_table_does_not_tell_the_direction_is_a_note(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    with can.CSVWriter(str(path)) as log:
        log.on_message_received(message(row(5, 0x123, b"\5", flags=TX)))
    batch, facts, _ = read(path)
    assert rows(batch) == [row(5, 0x123, b"\5")]
    said = "the log does not tell the direction of frames; all are taken as received"
    assert said in facts.notes
    _, facts = read_text(tmp_path, "time,id,dir,data\n1700000000.5,123,Tx,05\n")
    assert said not in facts.notes


@pytest.mark.parametrize("stamp", ["1700000000.{:03d}", "1700000000,{:03d}", "1700000000{:03d}"])
def test_stamps_of_a_clx000_may_be_seconds_since_1970_with_ms(tmp_path: Path, stamp: str) -> None:
    head = (
        CLX_HEAD.format("20231114T221320", 7, "", ",", "", "T") + "Timestamp;Type;ID;Length;Data\n"
    )
    lines = [f"{stamp.format(ms)};0;123;1;{ms:02x}\n" for ms in range(20)]
    found, facts = read_text(tmp_path, head + "".join(lines))
    assert found == [row(1000 * ms, 0x123, bytes([ms])) for ms in range(20)]
    assert (facts.format, facts.time_base, facts.unparsed_count) == ("clx", "utc", 0)


def test_a_table_below_the_title_of_a_kvaser_log_is_read_as_one(tmp_path: Path) -> None:
    text = (
        "Kvaser Memorator Log\n====================\n\nSettings:\n   Format of data field: HEX\n\n"
        "Time,Channel,ID,Dir,DLC,Data\n"
        "0.000005,1,123,Rx,2,11 22\n0.000006,1,124,Tx,1,33\n"
    )
    found, facts = read_text(tmp_path, text)
    since: list[Row] = [row(5, 0x123, b"\x11\x22"), row(6, 0x124, b"\x33", flags=TX)]
    assert found == [(each[0] - row(0)[0], *each[1:]) for each in since]
    assert facts.unparsed_count == 0 or facts.format == "csv"


def test_a_kvaser_log_without_frames_is_still_one(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text("Kvaser Memorator Log\n====================\n\nSettings:\n", encoding="ascii")
    assert open_capture(path).facts.format == "kvaser"
