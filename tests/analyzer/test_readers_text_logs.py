"""Kvaser, BUSMASTER, home-made CSV and candump's screen: forms that only some files have."""

from pathlib import Path

import pytest

from syncline_analyzer.readers.formats import KNOWN_FORMATS
from syncline_schemas.batch import FrameFlag, Gap
from tests.analyzer.log_builder import T0_NS, read, read_text, row

EXTENDED, REMOTE, ERROR, TX, FD, ESI = (
    FrameFlag.EXTENDED,
    FrameFlag.REMOTE,
    FrameFlag.ERROR,
    FrameFlag.TX,
    FrameFlag.FD,
    FrameFlag.ESI,
)
MS = 1_000_000
KVASER = "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"
BUSMASTER = (
    "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n"
    "***START DATE AND TIME 14:11:2023 22:13:20:000***\n***{}***\n***{} MODE***\n"
)


def test_kvaser_decimal_numbers_are_found(tmp_path: Path) -> None:
    found, facts = read_text(
        tmp_path,
        KVASER
        + " 0         385         3   1  20 255                           1.000000 R\n"
        + " 0        1793         1   5                                   1.100000 T\n",
    )
    assert [frame[2:] for frame in found] == [
        (385, 0, 3, b"\x01\x14\xff"),
        (1793, int(TX), 1, b"\5"),
    ]
    assert "identifiers and data are taken as decimal numbers" in facts.notes
    assert facts.time_base == "relative"


def test_kvaser_text_without_its_title(tmp_path: Path) -> None:
    text = " 0    0000014B         1  00                                1675.570498 T\n" * 3
    found, facts = read_text(tmp_path, text + "Logging stopped.\n")
    assert found == [(1_675_570_498_000, 0, 0x14B, int(TX), 1, b"\0")] * 3
    assert (facts.format, facts.unparsed_count) == ("kvaser", 0)


def test_kvaser_error_frame(tmp_path: Path) -> None:
    line = "0    00000000            ErrorFrame                          29.095270 R\n"
    found, _ = read_text(tmp_path, KVASER + line)
    assert found == [(29_095_270_000, 0, 0, int(ERROR), 8, bytes(8))]


def test_kvaser_error_flag_of_a_classic_frame_is_no_error_state_indicator(tmp_path: Path) -> None:
    text = " 0    00000000  E      0                                4.500000 R\n"
    text += " 0    00000123  F  E   2  01  02                         5.500000 R\n"
    found, _ = read_text(tmp_path, KVASER + text)
    assert found == [
        (4_500_000_000, 0, 0, int(ERROR), 8, bytes(8)),
        (5_500_000_000, 0, 0x123, int(FD | ESI), 2, b"\1\2"),
    ]


@pytest.mark.parametrize(
    ("mode", "lines", "times_ns"),
    [
        ("SYSTEM", ("22:13:21:0000", "22:13:21:5000"), (T0_NS + 1000 * MS, T0_NS + 1500 * MS)),
        (
            "SYSTEM",
            ("23:59:59:9999", "0:0:0:0001"),
            (1_700_006_399_999_900_000, 1_700_006_400_000_100_000),
        ),
        ("ABSOLUTE", ("00:00:01:0000", "00:00:01:5000"), (T0_NS + 1000 * MS, T0_NS + 1500 * MS)),
        ("RELATIVE", ("00:00:01:0000", "00:00:01:5000"), (T0_NS + 1000 * MS, T0_NS + 2500 * MS)),
    ],
)
def test_busmaster_time_modes(
    tmp_path: Path, mode: str, lines: tuple[str, ...], times_ns: tuple[int, ...]
) -> None:
    text = BUSMASTER.format("HEX", mode) + "".join(f"{t} Rx 1 0x181 s 1 05\n" for t in lines)
    found, facts = read_text(tmp_path, text)
    assert tuple(frame[0] for frame in found) == times_ns
    assert facts.time_base == "utc"


def test_busmaster_decimal(tmp_path: Path) -> None:
    text = BUSMASTER.format("DEC", "SYSTEM") + "22:13:20:0000 Tx 2 385 s 2 16 255\n"
    found, facts = read_text(tmp_path, text)
    assert found == [row(0, 0x181, b"\x10\xff", flags=TX)]
    assert facts.buses == ["2"]


def test_busmaster_sessions_in_one_file_keep_their_dates(tmp_path: Path) -> None:
    session = (
        BUSMASTER.format("HEX", "SYSTEM") + "{} Rx 1 0x181 s 0 \n***[STOP LOGGING SESSION]***\n"
    )
    later = session.replace("14:11:2023", "16:11:2023")
    found, _ = read_text(tmp_path, session.format("22:13:20:0000") + later.format("22:13:20:0000"))
    assert [frame[0] - T0_NS for frame in found] == [0, 2 * 86_400 * 1000 * MS]


@pytest.mark.parametrize(
    ("head", "line"),
    [
        ("Timestamp,CAN ID,DLC,Data", "1700000000.5,0x181,2,11 a4"),
        ("timestamp_ms,id,data", "1700000000500,181,11A4"),
        ("Time (us);Identifier (hex);Len;Data (hex)", "1700000000500000;181;2;11-A4"),
        ("t_ns\tcob-id\tlength\tpayload", "1700000000500000000\t181h\t2\t0x11,0xA4"),
        ("Zeit;Kennung (dez);Länge;Daten", "1700000000,5;385;2;11 A4"),
        ("Datum;Uhrzeit;ID;B0;B1", "14.11.2023;22:13:20,500;0x181;11;A4"),
        ("Horodatage,Identifiant,Données", "2023-11-14T22:13:20.5Z,181,11 A4"),
        (
            "时间标识,帧ID,帧格式,帧类型,数据长度,数据(HEX)",
            "1700000000.5,0x181,标准帧,数据帧,2,11 A4",
        ),
        ("No,Time,Name,ID,Type,Data", '17,"1700000000.5","Motor 1","181","Std","11 A4"'),
        ("Tiempo|ID|Datos", "2023/11/14 22:13:20.500|181|11 a4"),
    ],
)
def test_home_made_tables(tmp_path: Path, head: str, line: str) -> None:
    found, facts = read_text(tmp_path, f"{head}\n{line}\n{line}\n")
    assert found == [row(500_000, 0x181, b"\x11\xa4")] * 2
    assert (facts.format, facts.time_base) == ("csv", "utc")
    assert facts.unparsed_count == 0


def test_a_table_in_a_chinese_encoding(tmp_path: Path) -> None:
    text = "序号,传输方向,时间标识,帧ID,帧格式,帧类型,数据长度,数据\n0,发送,1.5,0x70A,标准帧,远程帧,1,\n"
    found, _ = read_text(tmp_path, text.encode("gb18030"))
    assert found == [(1_500_000_000, 0, 0x70A, int(REMOTE | TX), 1, b"")]


def test_decimal_identifiers_and_bytes_are_found_and_told(tmp_path: Path) -> None:
    rows = "".join(
        f"{i * 10},{can_id},2,{i},255\n" for i, can_id in enumerate((128, 385, 1793) * 4)
    )
    found, facts = read_text(tmp_path, "time,id,dlc,b0,b1\n" + rows)
    assert [frame[2] for frame in found[:3]] == [128, 385, 1793]
    assert found[2][5] == b"\x02\xff"
    assert [frame[0] for frame in found[:3]] == [0, 10 * MS, 20 * MS]
    assert {
        "identifiers are taken as decimal numbers",
        "data bytes are taken as decimal numbers",
        "the log does not tell the unit of its times; milliseconds are assumed",
    } <= set(facts.notes)


def test_hexadecimal_identifiers_without_letters_stay_hexadecimal(tmp_path: Path) -> None:
    found, _ = read_text(tmp_path, "time,id,data\n0.1,080,\n0.2,181,11\n0.3,701,05\n")
    assert [frame[2] for frame in found] == [0x80, 0x181, 0x701]


def test_times_that_are_differences_are_summed(tmp_path: Path) -> None:
    found, facts = read_text(tmp_path, "delta_ms,id,data\n0,181,11\n10,181,12\n5,181,13\n")
    assert [frame[0] for frame in found] == [0, 10 * MS, 15 * MS]
    assert "times are differences; their sum is used" in facts.notes


def test_times_of_day_pass_midnight(tmp_path: Path) -> None:
    found, facts = read_text(tmp_path, "time,id,data\n23:59:59.5,181,11\n00:00:00.5,181,12\n")
    assert found[1][0] - found[0][0] == 1000 * MS
    assert facts.time_base == "relative"


def test_size_makes_an_identifier_extended_only_where_no_column_tells(tmp_path: Path) -> None:
    text = "time,id,data\n" + "0.1,18FEF100,11\n" * 5 + "0.2,00000701,05\n"
    found, _ = read_text(tmp_path, text)
    assert [frame[3] for frame in found] == [int(EXTENDED)] * 5 + [0]


def test_kvaser_table_flags_are_bits(tmp_path: Path) -> None:
    text = "Time,Channel,ID,Flags,DLC,Data0,Data1,Counter,AbsTime\n"
    text += (
        "0.1,1,419361024,4,2,16,255,1,2023\n0.2,1,1802,3,1,,,2,2023\n"
        + "0.3,1,128,2,1,9,,3,2023\n" * 9
    )
    found, _ = read_text(tmp_path, text)
    assert found[0][2:] == (0x18FEF100, int(EXTENDED), 2, b"\x10\xff")
    assert found[1][2:] == (0x70A, int(REMOTE), 1, b"")


SCREEN_FORMS = {
    "plain": "  can0  181   [2]  11 A4\n",
    "-a": "  can0  181   [2]  11 A4   '..'\n",
    "-ta": " (1700000000.000000)  can0  181   [2]  11 A4\n",
    "-tA": " (2023-11-14 22:13:20.000000)  can0  181   [2]  11 A4\n",
    "-tz": " (000.000000)  can0  181   [2]  11 A4\n",
    "-x": "  can0  RX - -  181   [2]  11 A4\n",
    "-x -ta": " (1700000000.000000)  can0  RX - -  181   [2]  11 A4\n",
    "-c": "  \x1b[34mcan0  181   [2]  11 A4\x1b[0m\n",
    "comment": "  can0  181   [2]  11 A4   # hello 42\n",
    "-i": "  can0  181   [2]  00010001 10100100\n",
    "-S": "  can0  181   [2]  A4`11\n",
}


@pytest.mark.parametrize("form", SCREEN_FORMS)
def test_every_form_of_the_screen(tmp_path: Path, form: str) -> None:
    found, facts = read_text(tmp_path, SCREEN_FORMS[form] * 3)
    assert [frame[1:] for frame in found] == [(0, 0x181, 0, 2, b"\x11\xa4")] * 3
    assert facts.unparsed_count == 0


def test_dropped_frames_of_one_bus_are_a_gap_of_it(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text(
        " (1700000000.000000)  can0  181   [0]\n"
        " (1700000000.100000)  can1  181   [0]\n"
        "DROPCOUNT: dropped 3 CAN frames on 'can1' socket (total drops 3)\n"
        " (1700000001.000000)  can1  181   [0]\n",
        encoding="ascii",
    )
    assert read(path)[2] == [
        Gap(T0_NS + 100 * MS, T0_NS + 1000 * MS, "frames dropped by the kernel", 3, 1)
    ]


def test_the_message_of_an_unknown_file_names_every_format() -> None:
    from syncline_analyzer.readers.formats import READ_FORMATS

    told = KNOWN_FORMATS.lower()
    for each in READ_FORMATS:
        assert each.name in told or any(ending in told for ending in each.endings), each.name
