"""Files as customers send them: spellings of every text format that are not the usual one."""

from collections.abc import Callable
from pathlib import Path

import pytest

from syncline_analyzer import open_session
from syncline_schemas.batch import FrameFlag, Gap
from syncline_schemas.errors import CaptureError
from tests.analyzer.log_builder import PLAIN, T0_NS, Row, read, read_text, row, rows
from tests.analyzer.text_files import CLX_HEAD

EXTENDED, REMOTE, ERROR, FD = (
    FrameFlag.EXTENDED,
    FrameFlag.REMOTE,
    FrameFlag.ERROR,
    FrameFlag.FD,
)
BRS, ESI, TX = FrameFlag.BRS, FrameFlag.ESI, FrameFlag.TX
DATE = "date Tue Nov 14 10:13:20.000 pm 2023\n"
TWELVE = bytes(range(12))


def _frames(tmp_path: Path, text: str | bytes) -> list[Row]:
    """The frames of a log all of which can be read."""
    found, facts = read_text(tmp_path, text)
    assert facts.unparsed_lines == []
    return found


def _since(t_us: int, can_id: int, data: bytes, **more: object) -> Row:
    """A frame of a log whose times count from its start."""
    t_ns, *rest = row(t_us, can_id, data, **more)  # type: ignore[arg-type]
    return (t_ns - T0_NS, *rest)  # type: ignore[return-value]


def test_candump_in_colours_has_times(tmp_path: Path) -> None:
    line = "\x1b[1;31m (1700000000.000005)\x1b[0m  can0  \x1b[32m123\x1b[0m   [2]  11 22\n"
    assert _frames(tmp_path, line) == [row(5, data=b"\x11\x22")]


@pytest.mark.parametrize("tail", ["", " R", "  ; heartbeat", " # x", " R // 12 34", " \t"])
def test_remarks_behind_candump_lines_are_no_harm(tmp_path: Path, tail: str) -> None:
    assert _frames(tmp_path, f"(1700000000.000005) can0 123#1122{tail}\n") == [
        row(5, data=b"\x11\x22")
    ]


def _fd_line(brs: int, esi: int, code: str, count: int, data: str, bits: str, way: str) -> str:
    head = f"   0.000005 CANFD   1 {way}        291x  {'':32} {brs} {esi} {code} {count:2} {data}"
    return f"{head}   130000  130 {bits:>8} 0 46500250 460a0250 20011736 20010205\n"


@pytest.mark.parametrize(
    ("base", "line", "expected"),
    [
        (
            "hex",
            _fd_line(1, 1, "9", 12, TWELVE.hex(" "), "7000", "Rx"),
            row(5, 0x291, TWELVE, flags=FD | BRS | ESI | EXTENDED),
        ),
        (
            "dec",
            _fd_line(0, 0, "9", 12, " ".join(f"{byte:3}" for byte in TWELVE), "1000", "Tx"),
            row(5, 291, TWELVE, flags=FD | EXTENDED | TX),
        ),
        (
            "dec",
            _fd_line(0, 0, "15", 64, " ".join(["200"] * 64), "1000", "Rx"),
            row(5, 291, b"\xc8" * 64, flags=FD | EXTENDED),
        ),
        (
            "dec",
            _fd_line(0, 0, "2", 0, "", "10", "Rx"),
            row(5, 291, flags=REMOTE | EXTENDED, dlc=2),
        ),
        # Flags that say that it is no CAN FD frame.
        (
            "hex",
            _fd_line(0, 0, "2", 2, "01 02", "200000", "Rx"),
            row(5, 0x291, b"\1\2", flags=EXTENDED),
        ),
        # Flags that say nothing.
        (
            "hex",
            _fd_line(1, 0, "2", 2, "01 02", "0", "Rx"),
            row(5, 0x291, b"\1\2", flags=EXTENDED | FD | BRS),
        ),
        (
            "hex",
            _fd_line(0, 0, "2", 2, "01 02", "0", "Rx"),
            row(5, 0x291, b"\1\2", flags=EXTENDED | FD),
        ),
    ],
)
def test_asc_lines_of_can_fd_channels(tmp_path: Path, base: str, line: str, expected: Row) -> None:
    assert _frames(tmp_path, f"{DATE}base {base}  timestamps absolute\n{line}") == [expected]


def test_a_line_of_a_can_fd_channel_that_cannot_be_read_is_counted(tmp_path: Path) -> None:
    line = "   0.000005 CANFD   1 Rx  zz  1 0 2 2 01 02   130000  130 1000 0 0 0 0 0\n"
    _, facts = read_text(tmp_path, f"{DATE}base hex  timestamps absolute\n{line}")
    assert facts.unparsed_count == 1


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_an_asc_date_in_german_of_any_encoding(tmp_path: Path, encoding: str) -> None:
    text = "date Die Mär 14 22:13:20.000 2023\nbase hex  timestamps absolute\n 0.5 1 123 Rx d 0\n"
    found, facts = read_text(tmp_path, text.encode(encoding))
    assert facts.time_base == "utc"
    assert found[0][0] == 1_678_832_000_500_000_000


def test_trc_lengths_in_hexadecimal_and_tenths_of_milliseconds(tmp_path: Path) -> None:
    text = (
        ";$FILEVERSION=2.1\n;$STARTTIME=45244.92592592592592592593\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
        f"  1  0.005 FB 1  18EFC034 Rx -  f  {bytes(64).hex(' ')} \n"
        f"  2  0.005 FD 1  18EFC034 Rx -  15  {bytes(64).hex(' ')} \n"
    )
    assert _frames(tmp_path, text) == [
        row(5, 0x18EFC034, bytes(64), flags=FD | BRS | EXTENDED),
        row(5, 0x18EFC034, bytes(64), flags=FD | EXTENDED),
    ]
    text = ";   Start time: 14.11.2023 22:13:20.123.4\n     1)  1000 0181 1 05\n"
    assert _frames(tmp_path, text) == [row(1_123_400, 0x181, b"\5")]


IXXAT = "ASCII Trace IXXAT {}\nDate: {}\nStart time: {}\nOverruns: 0\nBaudrate: 250 kbit/s\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            IXXAT.format("MiniMon V3", "14.11.2023", "22:13:20")
            + '"Time";"Identifier (hex)";"Format";"Flags";"Data (hex)"\n'
            '"00:00:01.00";"83";"Std";"Self";"01 "\n'
            '"00:00:02.00";"83";"Std";"";"Remote request    DLC = 3"\n',
            [
                row(1_000_000, 0x83, b"\1", flags=TX),
                row(2_000_000, 0x83, flags=REMOTE, dlc=3),
            ],
        ),
        (
            IXXAT.format("MiniMon V3", "14.11.2023", "22:13:20")
            + '"Time";"Identifier (dec)";"Format";"Flags";"Data (dec)"\n'
            '"00:00:01.00";"291";"Std";"";"11 255 7"\n',
            [row(1_000_000, 0x123, b"\x0b\xff\x07")],
        ),
        (
            IXXAT.format("canAnalyser3", "11/14/2023", "10:13:20 PM")
            + '"Time (abs)";"Bus";"Identifier (hex)";"Format";"Flags";"DLC";"Data (hex)"\n'
            '"22:13:20.000005";"CAN1";"123";"Ext";"";"2";"11 22"\n'
            '"22:13:20.000006";"CAN1";"123";"Err";"";"0";""\n'
            '"00:00:01.000000";"CAN1";"123";"Std";"";"2";"11 22"\n',
            [
                row(5, 0x123, b"\x11\x22", flags=EXTENDED),
                row(6, 0x123, bytes(8), flags=ERROR),
                row(6_401_000_000, 0x123, b"\x11\x22"),
            ],
        ),
    ],
    ids=["self", "decimal", "absolute"],
)
def test_ixxat_traces_of_other_columns(tmp_path: Path, text: str, expected: list[Row]) -> None:
    found, facts = read_text(tmp_path, text)
    assert facts.unparsed_lines == []
    assert found == expected
    assert facts.format == "ixxat"


MEMORATOR = (
    "                              Kvaser Memorator Log\n                              ====================\n\n"
    "Converted from Memorator Binary format at: 2024-01-01 00:00:00\n\n\nSettings:\n"
    "   Format of data field: {0}\n   Format of id field:   {0}\n   Timestamp Offset:     0.000000    s\n"
    "   CAN channel:          1 2\n\n        Time Chan   Identifier Flags        DLC  Data     Counter\n"
    "===================================================================================\n"
    "    0.000000  Trigger (type=0x1, active=0x00, pre-trigger=0, post-trigger=-1)\n"
)


def test_memorator_logs_may_be_decimal_cut_to_eight_bytes_and_tell_of_losses(
    tmp_path: Path,
) -> None:
    text = MEMORATOR.format("DEC") + (
        "    0.000005  2   419361024x   Tx            2   17 255                                   1\n"
        "    0.000006  1         291    Rx         #  9    0   1   2   3   4   5   6   7            2\n"
        "    0.000007  1         291    TxRq          1    5                                       3\n"
        "    0.000008  1         291    Rx    F       9    0   1   2   3   4   5   6   7            4\n"
        "    0.000009  1  ErrorFrame    Rx   E            ERROR FRAME                               5\n"
    )
    found, facts = read_text(tmp_path, text)
    assert found == [
        _since(5, 0x18FEF100, b"\x11\xff", flags=EXTENDED | TX),
        _since(6, 291, bytes(range(8)), bus=1),
        _since(8, 291, bytes(range(8)), bus=1, flags=FD | FrameFlag.DLC_INVALID),
        _since(9, 0, bytes(8), bus=1, flags=ERROR),
    ]
    assert facts.unparsed_lines == []
    # When it was converted is no date of the log.
    assert facts.time_base == "relative"
    assert any("lost frames" in note for note in facts.notes)


@pytest.mark.parametrize(
    ("time", "t_us"),
    [
        ("2023-11-14T22:13:20.000005Z", 5),
        ("2023-11-14 23:13:20.000005+01:00", 5),
        ("2023-11-14T17:43:20.000005-0430", 5),
        ("11/14/2023 10:13:20.000005 PM", 5),
        ("14/11/2023 22:13:20.000005", 5),
        ("14.11.2023 22:13:20,000005", 5),
        ("14-11-2023 22:13:20.000005", 5),
        ("2023/11/14 22:13:20.000005", 5),
        ("1700000000.000005", 5),
        ("1700000000000005", 5),
        ("1700000000000005000", 5),
        ("1700000000005", 5_000),
    ],
)
@pytest.mark.parametrize("separator", [";", "\t", "|"])
def test_tables_with_any_spelling_of_a_date(
    tmp_path: Path, time: str, t_us: int, separator: str
) -> None:
    lines = (["Timestamp", "CAN ID", "Data"], [time, "0x123", "11 22"])
    text = "".join(separator.join(line) + "\n" for line in lines)
    assert _frames(tmp_path, text) == [row(t_us, data=b"\x11\x22")]


def test_noon_and_midnight_of_twelve_hours(tmp_path: Path) -> None:
    times = ("12:00:00", "12:00:01 AM", "12:00:02 PM", "10:00:03 PM", "12:59:03 AM")
    lines = [f"11/14/2023 {time if ' ' in time else time + ' PM'},123,11\n" for time in times]
    found = _frames(tmp_path, "Time,ID,Data\n" + "".join(lines))
    midnight = T0_NS - (22 * 3600 + 13 * 60 + 20) * 10**9
    assert [(t_ns - midnight) // 10**9 for t_ns, *_ in found] == [
        12 * 3600,
        1,
        12 * 3600 + 2,
        22 * 3600 + 3,
        59 * 60 + 3,
    ]


HOME_MADE = {
    "a list of numbers": ('Time,ID,Data\n0.1,0x181,"[17, 34]"\n0.2,0x181,"[1, 234]"\n', None),
    "a list without quotes": (
        "Time,ID,Data\n0.1,0x181,[0x11, 0x22]\n0.2,0x181,[0x01, 0xEA]\n",
        None,
    ),
    "decimal all through": ("time,id,dlc,d0,d1\n0.1,385,2,17,34\n0.2,385,2,1,234\n", None),
    "no header": ("0.1,181,2,1122\n0.2,181,2,01EA\n", None),
    "no header, bytes apart": ("0.1;181;2;11;22\n0.2;181;2;01;EA\n", None),
    "no header, flags": ("0.1,can0,0x181,2,1122\n0.2,can0,0x181,2,01EA\n", None),
    "humps": ("timestampMs,canId,dataLen,payload\n100,0x181,2,1122\n200,0x181,2,01EA\n", None),
    "lengths with 0x": ("Time,ID,DLC,Data\n0.1,0x181,0x02,11 22\n0.2,0x181,0x02,01 EA\n", None),
    "a type that says extended": (
        "Time,Dir,Type,ID,DLC,Data\n0.1,Rx,Ext,181,2,11 22\n0.2,Rx,Ext,181,2,01 EA\n",
        EXTENDED,
    ),
    "SocketCAN's upper bits": (
        "Time,ID,Data\n0.1,0x80000181,1122\n0.2,0x80000181,01EA\n",
        EXTENDED,
    ),
    "who sent it": ("Time,ID,is_rx,Data\n0.1,181,0,1122\n0.2,181,False,01EA\n", TX),
}


@pytest.mark.parametrize("name", HOME_MADE)
def test_home_made_tables(tmp_path: Path, name: str) -> None:
    text, flags = HOME_MADE[name]
    assert _frames(tmp_path, text) == [
        _since(100_000, 0x181, b"\x11\x22", flags=flags or PLAIN),
        _since(200_000, 0x181, b"\x01\xea", flags=flags or PLAIN),
    ]


def test_frames_of_one_moment_in_a_table_without_names(tmp_path: Path) -> None:
    frame = _since(100_000, 0x181, b"\x11\x22")
    assert _frames(tmp_path, "0.1,0x181,1122\n0.1,0x181,1122\n") == [frame, frame]


def test_error_frames_of_tables_have_eight_bytes_and_no_contradiction(tmp_path: Path) -> None:
    text = "Time,ID,Type,DLC,Data\n0.1,0,Error,0,\n0.2,4,Error,8,0102030405060708\n"
    assert _frames(tmp_path, text) == [
        _since(100_000, 0, bytes(8), flags=ERROR),
        _since(200_000, 4, bytes(range(1, 9)), flags=ERROR),
    ]


def test_a_canedge_table(tmp_path: Path) -> None:
    text = (
        "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes\n"
        "1700000000.000005;1;181;0;2;2;0;0;0;0;0;1122\n"
        f"1700000000.000006;1;18FEF100;1;9;12;1;1;1;0;0;{TWELVE.hex()}\n"
        "1700000000.000007;2;701;0;1;0;0;0;0;0;1;\n"
    )
    assert _frames(tmp_path, text) == [
        row(5, 0x181, b"\x11\x22"),
        row(6, 0x18FEF100, TWELVE, flags=EXTENDED | FD | BRS | TX),
        row(7, 0x701, bus=1, flags=REMOTE, dlc=1),
    ]


@pytest.mark.parametrize(
    ("text", "lost"),
    [
        ("Time,ID,Data\n0.1,701,05\n", True),
        ("Time,ID,RTR,Data\n0.1,701,0,05\n", False),
        ("  1.000000  can0  701  [1]  05\n", True),
        ("  can0  701   [1]  05\n", False),
    ],
)
def test_logs_that_mark_no_remote_frames_say_so(tmp_path: Path, text: str, lost: bool) -> None:
    _, facts = read_text(tmp_path, text)
    assert facts.remote_lost is lost
    assert open_session(tmp_path / "capture").analysis.capture.remote_lost is lost


def test_transport_messages_that_asc_logs_tell_besides_their_frames_are_no_lost_lines(
    tmp_path: Path,
) -> None:
    text = (
        f"{DATE}base hex  timestamps absolute\n"
        "   0.000005 J1939TP FEE3p 6 0 0 - Rx d 12 A0 0F A6 60 3B D1 40 1F DE 80 3E E4\n"
        "   0.000005 1  123             Rx   d 1 11\n"
        "   0.000006 1  zz?             Rx   d 1 11\n"
    )
    found, facts = read_text(tmp_path, text)
    assert found == [row(5, data=b"\x11")]
    assert [number for number, _ in facts.unparsed_lines] == [5]


def _sdo_write(t_us: int, index: int, sub: int, value: int) -> list[tuple[int, int, bytes, bool]]:
    head = index.to_bytes(2, "little") + bytes([sub])
    written = b"\x23" + head + value.to_bytes(4, "little")
    return [(t_us, 0x606, written, False), (t_us + 900, 0x586, b"\x60" + head + bytes(4), False)]


def _asked_nodes(missed: range) -> list[tuple[int, int, bytes, bool]]:
    """Node 5 is guarded, but for what it misses; TPDO1 of node 6 is asked for by remote frames."""
    start = [(0, 0x705, b"\0", False), (1_000, 0x706, b"\0", False)]
    mapped = [(0x1A00, 0, 0), (0x1A00, 1, 0x60040020), (0x1A00, 0, 1)]
    for number, write in enumerate(mapped):
        start += _sdo_write(20_000 + 10_000 * number, *write)
    start += [(70_000, 0, b"\1\5", False), (71_000, 0, b"\1\6", False)]
    answers = 0
    for number in range(60):
        t_us = 100_000 + 500_000 * number
        start.append((t_us, 0x705, b"", True))
        if number not in missed:
            start.append((t_us + 600, 0x705, bytes([5 | answers % 2 << 7]), False))
            answers += 1
        start += [(t_us + 50_000, 0x186, b"", True), (t_us + 50_800, 0x186, bytes(4), False)]
    return start


def _marked(frames: list[tuple[int, int, bytes, bool]]) -> str:
    return "".join(
        f"({1_700_000_000 + t_us / 1e6:.6f}) can0 {can_id:03X}#{'R' if asks else data.hex()}\n"
        for t_us, can_id, data, asks in frames
    )


def _unmarked(frames: list[tuple[int, int, bytes, bool]]) -> str:
    head = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    return head + "".join(
        f"{t_us},{can_id:08X},false,Rx,0,{len(data)},{data.hex(',').upper()}\n"
        for t_us, can_id, data, _ in frames
    )


@pytest.mark.parametrize("written", [_marked, _unmarked])
def test_remote_frames_that_a_log_does_not_mark_accuse_nobody(
    tmp_path: Path, written: Callable[[list[tuple[int, int, bytes, bool]]], str]
) -> None:
    (tmp_path / "log").write_text(written(_asked_nodes(range(0))), encoding="utf-8")
    assert open_session(tmp_path / "log").analyze().findings == []


@pytest.mark.parametrize("sends", [True, False], ids=["there", "away"])
@pytest.mark.parametrize(
    ("written", "assumed"),
    [
        (_marked, []),
        (_unmarked, ["empty data frames are remote frames, which the log does not mark"]),
    ],
)
def test_what_rests_on_unmarked_remote_frames_says_so(
    tmp_path: Path,
    written: Callable[[list[tuple[int, int, bytes, bool]]], str],
    assumed: list[str],
    sends: bool,
) -> None:
    """Four answers that do not come, of a node whose PDOs go on or do not."""
    frames = _asked_nodes(range(20, 24))
    if sends:
        frames += [(170_000 + 500_000 * n, 0x185, bytes([n]), False) for n in range(60)]
    (tmp_path / "log").write_text(written(sorted(frames)), encoding="utf-8")
    (finding,) = open_session(tmp_path / "log").analyze().findings
    told = "nmt.guard_unanswered" if sends else "nmt.node_lost"
    assert (finding.id, finding.node, finding.assumed) == (told, 5, assumed)


@pytest.mark.parametrize(("unit", "worth"), [("ns", 1), ("us", 1_000), ("ms", 1_000_000)])
def test_times_in_any_unit_may_have_a_fraction(tmp_path: Path, unit: str, worth: int) -> None:
    text = (
        f"Time [{unit}];Bus;ID (hex);DLC;RTR;Data\n2000000.000;1;181;0;1;\n5000000.0;1;181;1;0;11\n"
    )
    assert _frames(tmp_path, text) == [
        (2_000_000 * worth, 0, 0x181, REMOTE, 0, b""),
        (5_000_000 * worth, 0, 0x181, 0, 1, b"\x11"),
    ]


@pytest.mark.parametrize(
    "written",
    ["123#11.22.A4", "123#1122A4", "123#11.22A4", "123#11.22.A4.", "123##0.11.22.A4"],
)
def test_dots_between_bytes_as_cansend_takes_them(tmp_path: Path, written: str) -> None:
    flags = FD if "##" in written else FrameFlag(0)
    line = f"(1700000000.000005) can0 {written}\n"
    assert _frames(tmp_path, line * 3) == [row(5, data=b"\x11\x22\xa4", flags=flags)] * 3


def test_a_stamp_of_endless_digits_is_an_unread_line(tmp_path: Path) -> None:
    good = "(1700000000.000005) can0 123#11\n"
    found, facts = read_text(tmp_path, f"({'17' * 4000}.0) can0 123#11\n{good}")
    assert found == [row(5, data=b"\x11")]
    assert facts.unparsed_count == 1


def test_canhacker_begins_again_each_minute_and_knows_decimal_commas(tmp_path: Path) -> None:
    head = "Time   ID     DLC Data                    Comment\n"
    lines = (
        "18,876 070      8 00 B0 C8 64 9D B0 01 D6 \n"
        "59,999 18EA0003 3 BE FE 00 \n"
        "00,001 705      1\n"
        "00,002 301      2 01 02 ignition on\n"
        "00,003 301      0\n"
    )
    found, facts = read_text(tmp_path, head + lines)
    ms = 1000
    assert found == [
        _since(18_876 * ms, 0x70, bytes.fromhex("00B0C8649DB001D6")),
        _since(59_999 * ms, 0x18EA0003, bytes.fromhex("BEFE00"), flags=EXTENDED),
        _since(60_001 * ms, 0x705, b"", flags=REMOTE, dlc=1),
        _since(60_002 * ms, 0x301, b"\1\2"),
        _since(60_003 * ms, 0x301, b""),
    ]
    assert (facts.format, facts.unparsed_lines) == ("canhacker", [])
    assert any("each minute" in note for note in facts.notes)


CLX_STAMPS = {
    "days": ("T", "", "", "T", "14T221320005", "14T221320006"),
    "hours": ("", ":", ",", "T", "22:13:20,005", "22:13:20,006"),
    "minutes": ("", "", "", "", "1320005", "1320006"),
    "seconds": ("", "", "", "", "20005", "20006"),
    "milliseconds": ("", "", "", "", "005", "006"),
    "months": ("/", ".", ",", " ", "11/14 22.13.20,005", "11/14 22.13.20,006"),
    "years": ("", "", "", "", "20231114221320005", "20231114221320006"),
}


@pytest.mark.parametrize("stamps", CLX_STAMPS)
def test_stamps_of_a_clx000_are_completed_by_its_head(tmp_path: Path, stamps: str) -> None:
    date, clock, ms, between, *written = CLX_STAMPS[stamps]
    text = CLX_HEAD.format("20231114T221320", 4, clock, ms, date, between)
    text += "Timestamp;Type;ID;Data\n"
    text += f"{written[0]};0;123;1122\n{written[1]};9;18fef100;05\n"
    found, facts = read_text(tmp_path, text)
    assert found == [
        row(5_000, 0x123, b"\x11\x22"),
        row(6_000, 0x18FEF100, b"\5", flags=EXTENDED | TX),
    ]
    assert (facts.format, facts.time_base, facts.bitrates) == ("clx", "utc", {"1": 250_000})
    assert facts.remote_lost


@pytest.mark.parametrize(
    ("start", "stamps", "seconds"),
    [
        ("20231114T235959", ("235959000", "000001000"), (1_700_006_399, 1_700_006_401)),
        ("20231130T235959", ("30T235959000", "01T000001000"), (1_701_388_799, 1_701_388_801)),
        # The head was written just before the hour.
        ("20231114T225959", ("0001000", "0002000"), (1_700_002_801, 1_700_002_802)),
    ],
)
def test_stamps_of_a_clx000_begin_again(
    tmp_path: Path, start: str, stamps: tuple[str, str], seconds: tuple[int, int]
) -> None:
    head = CLX_HEAD.format(start, 4, "", "", "", "T") + "Timestamp;Type;ID;Data\n"
    found = _frames(tmp_path, head + "".join(f"{stamp};0;123;11\n" for stamp in stamps))
    assert [frame[0] // 10**9 for frame in found] == list(seconds)


def test_a_clx000_without_a_clock_has_no_date_and_its_losses_are_gaps(tmp_path: Path) -> None:
    head = CLX_HEAD.format("20000101T000000", 4, "", "", "", "T")
    path = tmp_path / "x"
    path.write_text(
        f"{head}Timestamp;Lost;Type;ID;Length;Data\n"
        "01T000000683;0;8;7df;8;02010d5555555555\n"
        "01T000000688;3;0;7e8;8;03410d00aaaaaaaa\n",
        encoding="ascii",
    )
    batch, facts, gaps = read(path)
    (first, second) = rows(batch)
    assert second[0] - first[0] == 5_000_000
    assert facts.time_base == "relative"
    assert gaps == [Gap(first[0], second[0], "frames lost by the logger", 3)]


def test_cantest_of_newer_versions_with_half_open_quotes(tmp_path: Path) -> None:
    text = (
        "序号,系统时间,时间标识,CAN通道,ID号,帧类型,帧格式,CAN类型,长度,数据\n"
        '1000000,="17:54:13.761949,385.624895,ch1,0x27,数据帧,标准帧,CAN,8,x| 01 02 03 04 05 06 07 08\n'
        '1000001,="17:54:13.761950,385.624995,ch2,0x28,数据帧,标准帧,CANFD加速,2,x| 01 02\n'
    )
    assert _frames(tmp_path, text.encode("gb18030")) == [
        (385_624_895_000, 0, 0x27, 0, 8, bytes(range(1, 9))),
        (385_624_995_000, 1, 0x28, int(FD | BRS), 2, b"\1\2"),
    ]


def test_cantest_without_stamps_has_the_times_of_the_computer(tmp_path: Path) -> None:
    text = (
        "序号,系统时间,时间标识,CAN通道,传输方向,ID号,帧类型,帧格式,长度,数据\r\n"
        '0,="12:04:59.533",无,ch1,发送,0x123,数据帧,扩展帧,0x02,x| 01 02\r\n'
        '1,="12:05:00.033",无,ch1,发送,0x123,数据帧,扩展帧,0x02,x| 01 02\r\n'
    )
    found = _frames(tmp_path, text)
    assert found[1][0] - found[0][0] == 500_000_000
    assert found[0][1:] == (0, 0x123, int(EXTENDED | TX), 2, b"\1\2")


def test_excels_line_of_the_separator_is_no_unread_line(tmp_path: Path) -> None:
    text = "sep=;\nDatum;Uhrzeit;CAN-ID;DLC;D0\n14.11.2023;22:13:20,000005;701h;1;05\n"
    assert _frames(tmp_path, text) == [row(5, 0x701, b"\5")]


def test_cantest_in_english(tmp_path: Path) -> None:
    text = (
        "Index,System Time,Time Stamp,Channel,Direction,Frame ID,Type,Format,DLC,Data\n"
        '0,"22:13:20.123.456",0x00000A,ch1,Receive,0x0123,Data,Standard,0x02,x| 11 22\n'
        '1,"22:13:20.223.456",0x0003F2,ch1,Transmit,0x0123,Data,Standard,0x02,x| 11 22\n'
    )
    assert [frame[3] for frame in _frames(tmp_path, text)] == [0, int(TX)]


@pytest.mark.parametrize(
    ("start", "stop", "first", "last", "first_ns"),
    [
        ("22:13:20", "22:13:30", "22:13:20.500", "22:13:30.000", T0_NS + 500_000_000),
        ("22:13:20", "22:13:30", "00:00:00.500", "00:00:10.000", T0_NS + 500_000_000),
        ("22:13:20", "23:13:30", "00:13:20.500", "00:13:30.000", T0_NS + 800_500_000_000),
        ("23:59:50", "00:01:00", "23:59:59.500", "00:00:09.000", T0_NS + 6_399_500_000_000),
    ],
)
def test_minimon_times_of_day_are_known_by_start_and_stop(
    tmp_path: Path, start: str, stop: str, first: str, last: str, first_ns: int
) -> None:
    head = IXXAT.format("MiniMon V3", "14.11.2023", start)
    lines = "".join(f'"{time}";"83";"Std";"";"01"\n' for time in (first, last))
    found = _frames(tmp_path, head.replace("Overruns", f"Stop time: {stop}\nOverruns") + lines)
    assert [frame[0] for frame in found] == [first_ns, first_ns + 9_500_000_000]


BARE = {
    "three columns": "0.100000,181,11A4\n0.110000,181,01EA\n",
    "with 0x": "0.1;0x181;0x11 0xA4\n0.11;0x181;0x01 0xEA\n",
    "milliseconds": "100\t181\t11 A4\n110\t181\t01 EA\n",
    "decimal": "100,385,17 164\n110,385,1 234\n",
    "a list": "0.1;385;[17, 164]\n0.11;385;[1, 234]\n",
    "bytes in cells": "0.1,181,11,A4\n0.11,181,01,EA\n",
    "numbered": "1,0.1,can0,Rx,181,11,A4\n2,0.11,can0,Rx,181,01,EA\n",
    "a remark first": "# my log\n0.1,181,11A4\n0.11,181,01EA\n",
    "flags": "0.1,0,181,11A4\n0.11,0,181,01EA\n",
    "clock": "12:00:00.1,181,11A4\n12:00:00.11,181,01EA\n",
    "dates": "2023-11-14 22:13:20.1,181,11A4\n2023-11-14 22:13:20.11,181,01EA\n",
}


@pytest.mark.parametrize("name", BARE)
def test_tables_of_nothing_but_frames(tmp_path: Path, name: str) -> None:
    found, facts = read_text(tmp_path, BARE[name])
    assert [frame[1:] for frame in found] == [
        (0, 0x181, 0, 2, b"\x11\xa4"),
        (0, 0x181, 0, 2, b"\x01\xea"),
    ]
    assert found[1][0] - found[0][0] == 10_000_000
    assert any("have no names" in note for note in facts.notes)


@pytest.mark.parametrize(
    "text",
    [
        "1,2,3\n4,5,6\n",
        "Anna,17,22\nBert,18,23\n",
        "1,22,33\n2,23,34\n",
        "5.1,3.5,1.4\n4.9,3.0,1.4\n",
        "2023-01-01,100,12\n2023-01-02,101,13\n",
        "3,181,11A4\n1,181,01EA\n2,181,01EB\n",
    ],
)
def test_tables_that_are_no_logs_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(CaptureError, match="no known format"):
        read_text(tmp_path, text)


@pytest.mark.parametrize("rate", ["\u00b250000", "9" * 5000, "-1", ""])
def test_a_clx000_whose_bit_rate_is_no_number_is_read_without_one(
    tmp_path: Path, rate: str
) -> None:
    path = tmp_path / "x.csv"
    head = CLX_HEAD.format("20231114T221320", 6, ":", ".", "/", " ").replace("250000", rate)
    row = "Timestamp;Type;ID;Length;Data\n2023/11/14 22:13:20.000;0;123;1;05\n"
    path.write_bytes((head + row).encode("latin-1"))
    assert read(path)[1].bitrates == {}


def test_times_of_thousands_of_digits_are_none(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text(f"Time,ID,Data\n{'9' * 5000},123,05\n1,123,05\n", encoding="ascii")
    batch, _, _ = read(path)
    assert len(batch) <= 2
