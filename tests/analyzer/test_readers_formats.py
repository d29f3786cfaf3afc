"""ASC, TRC, CSV and BLF: what their headers and rarer lines mean."""

import struct
from pathlib import Path

import pytest

from syncline_schemas.batch import FrameFlag
from tests.analyzer.log_builder import CAPTURES, read, read_text, row, rows

EXTENDED, REMOTE, ERROR, FD = (
    FrameFlag.EXTENDED,
    FrameFlag.REMOTE,
    FrameFlag.ERROR,
    FrameFlag.FD,
)
# 14 November 2023, 22:13:20 UTC is 1700000000.
ASC = "date {}\nbase {}  timestamps {}\ninternal events logged\n// version 9.0.0\n"


def _asc(
    *lines: str, date: str = "Tue Nov 14 22:13:20 2023", base: str = "hex", times: str = "absolute"
) -> str:
    return ASC.format(date, base, times) + "".join(f"{line}\n" for line in lines)


@pytest.mark.parametrize(
    "date",
    [
        "Tue Nov 14 22:13:20 2023",
        "Tue Nov 14 22:13:20.000 2023",
        "Tue Nov 14 10:13:20 pm 2023",
        "Tue Nov 14 10:13:20.000 pm 2023",
        "Die Nov 14 22:13:20.000 2023",
        "14.11.2023 22:13:20",
        "Tue 14.11.2023 10:13:20 PM",
        "2023-11-14 22:13:20",
    ],
)
def test_asc_dates_are_read_in_every_spelling(tmp_path: Path, date: str) -> None:
    found, facts = read_text(tmp_path, _asc("   0.000001 1  123  Rx   d 0", date=date))
    assert found == [row(1)]
    assert facts.time_base == "utc"
    assert any("time zone" in note for note in facts.notes)


def test_an_asc_without_a_date_is_relative(tmp_path: Path) -> None:
    found, facts = read_text(tmp_path, "base hex timestamps absolute\n 1.5 1 123 Rx d 0\n")
    assert found[0][0] == 1_500_000_000
    assert facts.time_base == "relative"


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("0.000001 1  123             Rx   d 2 01 02", row(1, data=b"\1\2")),
        ("0.000001 1  123             Tx   d 2 01 02", row(1, data=b"\1\2", flags=FrameFlag.TX)),
        ("0.000001 1  18FEF100x       Rx   d 1 05", row(1, 0x18FEF100, b"\5", flags=EXTENDED)),
        ("0.000001 1  70A             Rx   r", row(1, 0x70A, flags=REMOTE)),
        ("0.000001 1  70A             Rx   r 8", row(1, 0x70A, flags=REMOTE, dlc=8)),
        ("0.000001 1  123  Rx d 1 05  Length = 246016 BitCount = 123 ID = 291", row(1, data=b"\5")),
        ("0.000001 1  EngineData Rx d 1 05  ID = 291", row(1, data=b"\5")),
        ("0.000001 1  EngineData Rx d 1 05  ID = 291x", row(1, data=b"\5", flags=EXTENDED)),
        ("0.000001 1  ErrorFrame", row(1, 0, bytes(8), flags=ERROR)),
        ("0.000001 1  ErrorFrame Flags = 0xe CodeExt = 0x20a2", row(1, 0, bytes(8), flags=ERROR)),
        ("0.000001 1  123 Rx d 4 01 02", row(1, data=b"\1\2", flags=FrameFlag.DLC_INVALID)),
        (
            "0.000001 CANFD   1 Tx     123x  0 0 5  5 01 02 03 04 05  140000  73   1000 7a60 0 0",
            row(1, 0x123, bytes(range(1, 6)), flags=FD | EXTENDED | FrameFlag.TX),
        ),
        (
            "0.000001 CANFD   1 Rx     123  Motor_1  1 1 9 12 " + "5A " * 12 + " 1 2   7000 0",
            row(1, 0x123, b"\x5a" * 12, flags=FD | FrameFlag.BRS | FrameFlag.ESI),
        ),
    ],
)
def test_one_asc_line(tmp_path: Path, line: str, expected: tuple[object, ...]) -> None:
    found, facts = read_text(tmp_path, _asc(line))
    assert found == [expected]
    assert facts.unparsed_count == 0


def test_events_of_an_asc_are_no_frames_and_no_faults(tmp_path: Path) -> None:
    found, facts = read_text(
        tmp_path,
        _asc(
            "Begin Triggerblock Tue Nov 14 22:13:20.000 2023",
            "   0.000000 Start of measurement",
            "   0.1 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.0%",
            "   0.1 CAN 1 Status:chip status error active",
            "   0.1 1  123 TxRq d 1 05",
            "   0.5 1  zzz Rx d 1 05",
            "End TriggerBlock",
        ),
    )
    assert found == []
    assert facts.unparsed_lines == [(10, "   0.5 1  zzz Rx d 1 05")]


def test_an_asc_may_be_decimal_and_its_times_differences(tmp_path: Path) -> None:
    lines = ("0.5 1  385 Rx d 2 16 255", "0.25 1  Statistic: D 0", "0.25 1  385 Rx d 1 7")
    found, _ = read_text(tmp_path, _asc(*lines, base="dec", times="relative"))
    assert found == [row(500_000, 0x181, b"\x10\xff"), row(1_000_000, 0x181, b"\7")]


def test_stamps_count_from_the_date_they_agree_with(tmp_path: Path) -> None:
    block = "Begin Triggerblock Tue Nov 14 22:13:30.000 2023"
    found, _ = read_text(tmp_path, _asc(block, "10.5 1  123 Rx d 0"))
    assert found == [row(10_500_000)]
    found, _ = read_text(tmp_path, _asc(block, "0.5 1  123 Rx d 0"))
    assert found == [row(10_500_000)]


TRC_11 = """;$FILEVERSION=1.1
;$STARTTIME=45244.92592592592592592593
;   Start time: 14.11.2023 22:13:20.000.0
     1)      1059.9  Rx         0300  2  00 04 
     2)      1283.2  Rx     00000300  1  03
     3)      1298.9  Tx         0400  0 
     4)      1323.0  Rx         0500  1  RTR
     5)      1334.4  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY
     6)      1346.8  Error      0008  4  00 19 08 08 
"""
TRC_10 = """;   Start time: 14.11.2023 22:13:20.000.0
;----+- ---+--- ----+--- + -+ -- -- ...
     1)  1059 0300 2 00 04
     2)  1060 FFFFFFFF 4 00 00 00 04 BUSLIGHT
     3)  1070 00000300 2 RTR
     4)  1080 0008 4 ERROR 00 19 08 08
"""
TRC_13 = """;$FILEVERSION=1.3
;$STARTTIME=45244.92592592592592592593
     1)      1059.900 1  Rx        0300 -  2    00 04 
     2)      1060.900 2  Tx    00000300 -  2    RTR
"""
TRC_20 = """;$FILEVERSION=2.0
;$STARTTIME=45244.92592592592592592593
;$COLUMNS=N,O,T,I,d,l,D
      1      1059.900 DT     0300 Rx 2  00 04 
      2      1283.231 DT     0300 Rx 0  
      3      1298.945 FB 18EFC034 Tx 12  5A 5A 5A 5A 5A 5A 5A 5A 5A 5A 5A 5A
      4      1323.201 RR     0300 Rx 3
      5      1334.416 ST          Rx    00 00 00 08 
      6      1346.834 ER      -   Rx 5  04 00 02 00 00 
"""
TRC_21 = """;$FILEVERSION=2.1
;$STARTTIME=45244.92592592592592592593
;$COLUMNS=N,O,T,B,I,d,R,L,D
      1      1059.900 DT  1      0300 Rx -  2    00 04 
      2      1298.945 FE  2  18EFC034 Rx -  9    5A 5A 5A 5A 5A 5A 5A 5A 5A 5A 5A 5A
      3      1300.000 BI  2      0034 Rx -  1    5A
      4      1334.416 ST  1         - Rx -  4    00 00 00 08 
      5      1346.834 EC  1         - Rx -  2    08 00 
"""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            TRC_11,
            [
                row(1_059_900, 0x300, b"\0\4"),
                row(1_283_200, 0x300, b"\3", flags=EXTENDED),
                row(1_298_900, 0x400, flags=FrameFlag.TX),
                row(1_323_000, 0x500, flags=REMOTE, dlc=1),
                row(1_346_800, 0x88, bytes(8), flags=ERROR),
            ],
        ),
        (
            TRC_10,
            [
                row(1_059_000, 0x300, b"\0\4"),
                row(1_070_000, 0x300, flags=REMOTE | EXTENDED, dlc=2),
                row(1_080_000, 0x88, bytes(8), flags=ERROR),
            ],
        ),
        (
            TRC_13,
            [
                row(1_059_900, 0x300, b"\0\4"),
                row(1_060_900, 0x300, bus=1, flags=REMOTE | EXTENDED | FrameFlag.TX, dlc=2),
            ],
        ),
        (
            TRC_20,
            [
                row(1_059_900, 0x300, b"\0\4"),
                row(1_283_231, 0x300),
                row(
                    1_298_945,
                    0x18EFC034,
                    b"\x5a" * 12,
                    flags=EXTENDED | FD | FrameFlag.BRS | FrameFlag.TX,
                ),
                row(1_323_201, 0x300, flags=REMOTE, dlc=3),
                row(1_346_834, 0x88, bytes(8), flags=ERROR),
            ],
        ),
        (
            TRC_21,
            [
                row(1_059_900, 0x300, b"\0\4"),
                row(
                    1_298_945,
                    0x18EFC034,
                    b"\x5a" * 12,
                    bus=1,
                    flags=EXTENDED | FD | FrameFlag.ESI,
                ),
                row(1_300_000, 0x34, b"\x5a", bus=1, flags=FD | FrameFlag.BRS | FrameFlag.ESI),
            ],
        ),
    ],
    ids=["1.1", "1.0", "1.3", "2.0", "2.1"],
)
def test_every_version_of_trc(tmp_path: Path, text: str, expected: list[object]) -> None:
    found, facts = read_text(tmp_path, text.replace("\n", "\r\n"))
    assert found == expected
    assert facts.unparsed_lines == []
    assert facts.time_base == "utc"


def test_bus_status_lines_of_trc_are_noted(tmp_path: Path) -> None:
    _, facts = read_text(tmp_path, TRC_11)
    assert "1 status line(s) 'Warng BUSHEAVY'" in facts.notes


def test_savvycan_csv(tmp_path: Path) -> None:
    found, facts = read_text(
        tmp_path,
        "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
        "166064000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,\n"
        "166065000,18FEF100,true,Tx,1,2,FE,36,,,,,,,\n"
        "166066000,00000080,false,Rx,0,0,,,,,,,,,\n",
    )
    assert [frame[0] for frame in found] == [166_064_000_000, 166_065_000_000, 166_066_000_000]
    assert [frame[1:] for frame in found] == [
        (0, 0x21A, 0, 8, bytes.fromhex("FE3612FE690507AD")),
        (1, 0x18FEF100, int(EXTENDED | FrameFlag.TX), 2, b"\xfe\x36"),
        (0, 0x80, 0, 0, b""),
    ]
    assert facts.time_base == "relative"


@pytest.mark.parametrize(
    "encode",
    [
        lambda text: text.encode("utf-8-sig"),
        lambda text: text.encode("utf-16"),
        lambda text: text.encode("utf-16-le"),
        lambda text: ("\ufeff" + text).encode("utf-16-be"),
        lambda text: text.replace("\n", "\r\n").encode(),
        lambda text: text.replace("\n", "\r").encode(),
        lambda text: ("Größe\n" + text).encode("latin-1"),
    ],
    ids=["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "CRLF", "CR", "latin-1"],
)
def test_text_in_other_encodings(tmp_path: Path, encode: object) -> None:
    text = "".join(f"(170000000{i}.000000) can0 123#11\n" for i in range(5))
    found, _ = read_text(tmp_path, encode(text))  # type: ignore[operator]
    assert found == [row(i * 1_000_000, data=b"\x11") for i in range(5)]


@pytest.mark.skipif(not CAPTURES.exists(), reason="the real captures are not here")
def test_a_capture_is_the_same_packed(tmp_path: Path) -> None:
    import zstandard

    path = CAPTURES / "hilch_pcan2.trc"
    packed = tmp_path / "capture"
    packed.write_bytes(zstandard.compress(path.read_bytes()))
    assert (read(packed)[0].t_ns == read(path)[0].t_ns).all()


@pytest.mark.parametrize(("stop", "told"), [("10:49:43", True), ("10:51:00", False), ("", False)])
def test_ixxat_frames_past_the_stop_time_are_noted(tmp_path: Path, stop: str, told: bool) -> None:
    head = (
        f"ASCII Trace IXXAT MiniMon V3\nDate: 28.01.2025\nStart time: 10:47:15\nStop time: {stop}\n"
    )
    _, facts = read_text(tmp_path, head + '"00:03:34.48";"389";"Std";"";"D8 "\n')
    assert any("stop time" in note for note in facts.notes) is told


def _blf_object(kind: int, stamp_ns: int, body: bytes) -> bytes:
    size = 32 + len(body)
    head = struct.pack("<4sHHLL", b"LOBJ", 32, 1, size, kind)
    return head + struct.pack("<LHHQ", 2, 0, 0, stamp_ns) + body + bytes(size % 4)


def test_blf_objects_as_vector_describes_them(tmp_path: Path) -> None:
    """Written by hand: object types 86, 2, 73, 104, 100, 101, 1, and one that is no frame (4)."""
    data8, data12 = bytes(range(1, 9)), bytes(range(12))
    error_ext = struct.pack("<HHLBBBBLLHH8s", 2, 0, 0xE, 0x42, 5, 8, 0, 0, 0x181, 0, 0, data8)
    fd_error = struct.pack("<BBBBHHBBHLLLLLLLHH", 2, 9, 0, 0x42, 1, 0, 0, 0, 0, 0x181, *[0] * 8)
    fd = struct.pack("<HBBLLBBBBL64s", 1, 1, 9, 0x123, 0, 0, 7, 12, 0, 0, data12.ljust(64, b"\0"))
    head64 = struct.pack("<BBBBLLL", 1, 9, 12, 0, 0x98FEF100, 0, 0x3000)
    fd64 = head64 + struct.pack("<LLLLHBBL", 0, 0, 0, 0, 0, 0, 0, 0) + data12
    remote = struct.pack("<HBBL8s", 1, 0x80, 1, 0x701, bytes(8))
    objects = [
        _blf_object(86, 1_000, struct.pack("<HBBL8sLBBH", 1, 0, 8, 0x181, data8, 0, 0, 0, 0)),
        _blf_object(2, 2_000, struct.pack("<HHL", 2, 0, 0)),
        _blf_object(4, 2_500, bytes(24)),
        _blf_object(73, 3_000, error_ext),
        _blf_object(104, 4_000, fd_error),
        _blf_object(100, 5_000, fd),
        _blf_object(101, 6_000, fd64),
        _blf_object(1, 7_000, remote),
    ]
    inner = b"".join(objects)
    container = struct.pack("<HHLLL", 0, 0, 0, len(inner), 0) + inner
    size = 16 + len(container)
    outer = struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, 10) + container + bytes(size % 4)
    start = struct.pack("<8H", 2023, 11, 2, 14, 22, 13, 20, 0)
    head = struct.pack("<4sL", b"LOGG", 144) + bytes(32) + start + start
    path = tmp_path / "log"
    path.write_bytes(head.ljust(144, b"\0") + outer)
    batch, facts, _ = read(path)
    found = [(t, int(facts.buses[bus]) - 1, *rest) for t, bus, *rest in rows(batch)]
    assert found == [
        row(1, 0x181, data8),
        row(2, 0, bytes(8), bus=1, flags=ERROR),
        row(3, 0, bytes(8), bus=1, flags=ERROR),
        row(4, 0, bytes(8), bus=1, flags=ERROR),
        row(5, 0x123, data12, flags=FD | FrameFlag.TX | FrameFlag.BRS | FrameFlag.ESI),
        row(6, 0x18FEF100, data12, flags=FD | EXTENDED | FrameFlag.BRS),
        row(7, 0x701, flags=REMOTE, dlc=1),
    ]
