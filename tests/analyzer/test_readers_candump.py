"""candump's forms, line by line as candump writes them."""

from pathlib import Path

import pytest

from syncline_schemas.batch import FrameFlag, Gap
from tests.analyzer.log_builder import T0_NS, read, read_text, row

pytestmark = pytest.mark.usefixtures("both_ways")

EXTENDED, REMOTE, ERROR, FD = (
    FrameFlag.EXTENDED,
    FrameFlag.REMOTE,
    FrameFlag.ERROR,
    FrameFlag.FD,
)
EIGHT = bytes(range(0x11, 0x99, 0x11))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("(1700000000.000001) can0 123#1122334455667788", row(1, data=EIGHT)),
        ("(1700000000.000001) can0 123#", row(1)),
        ("(1700000000.000001) can0 00000123#01", row(1, data=b"\x01", flags=EXTENDED)),
        ("(1700000000.000001) can0 1FFFFFFF#", row(1, 0x1FFFFFFF, flags=EXTENDED)),
        ("(1700000000.000001) can0 123#R", row(1, flags=REMOTE, dlc=0)),
        ("(1700000000.000001) can0 70A#R8", row(1, 0x70A, flags=REMOTE, dlc=8)),
        ("(1700000000.000001) can0 123#R8_C", row(1, flags=REMOTE, dlc=8)),
        ("(1700000000.000001) can0 123#1122334455667788_E", row(1, data=EIGHT)),
        ("(1700000000.000001) can0 123#01 T", row(1, data=b"\x01", flags=FrameFlag.TX)),
        ("(1700000000.000001) can0 123#01 R", row(1, data=b"\x01")),
        ("(1700000000.000001) can0 123##0", row(1, flags=FD)),
        ("(1700000000.000001) can0 123##1AB", row(1, data=b"\xab", flags=FD | FrameFlag.BRS)),
        (
            "(1700000000.000001) can0 18FF0011##3" + "5A" * 64,
            row(
                1,
                0x18FF0011,
                b"\x5a" * 64,
                flags=FD | EXTENDED | FrameFlag.BRS | FrameFlag.ESI,
            ),
        ),
        # Bus-off and a bus error: the class bits and the eight bytes, bit by bit.
        (
            "(1700000000.000001) can0 20000040#0000000000000000",
            row(1, 0x40, bytes(8), flags=ERROR),
        ),
        (
            "(1700000000.000001) can0 20000088#0000801900001122",
            row(1, 0x88, bytes.fromhex("0000801900001122"), flags=ERROR),
        ),
        (" (1700000000.000001)  can0  123   [2]  01 02", row(1, data=b"\x01\x02")),
        (" (1700000000.000001)  can0  123   [2]  01 02   '..'", row(1, data=b"\x01\x02")),
        (" (1700000000.000001)  can0  123   [0] ", row(1)),
        (
            " (1700000000.000001)  can0  70A   [1]  remote request",
            row(1, 0x70A, flags=REMOTE, dlc=1),
        ),
        (
            " (1700000000.000001)  can0  18FEF100   [1]  05",
            row(1, 0x18FEF100, b"\5", flags=EXTENDED),
        ),
        (" (1700000000.000001)  can0  RX - -  123   [1]  05", row(1, data=b"\5")),
        (
            " (1700000000.000001)  can0  TX - -  123   [1]  05",
            row(1, data=b"\5", flags=FrameFlag.TX),
        ),
        (
            " (1700000000.000001)  can0  RX B E  123  [12]  " + "5A " * 11 + "5A",
            row(1, data=b"\x5a" * 12, flags=FD | FrameFlag.BRS | FrameFlag.ESI),
        ),
        (" (1700000000.000001)  can0  123  [02]  01 02", row(1, data=b"\1\2", flags=FD)),
        (
            " (1700000000.000001)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME",
            row(1, 4, bytes.fromhex("0004000000000000"), flags=ERROR),
        ),
        (" (1700000000.000001)  can0  123   [2]  01 02   # be careful", row(1, data=b"\1\2")),
        (" (1700000000.000001)  can0  123   [2]  01 02 be careful", row(1, data=b"\1\2")),
        ("1700000000.000001 can0 123 [2] 01 02", row(1, data=b"\1\2")),
        (" (2023-11-14 22:13:20.000001)  can0  123   [2]  01 02", row(1, data=b"\1\2")),
        ("\x1b[31m (1700000000.000001)  can0  123   [1]  05\x1b[0m", row(1, data=b"\5")),
        (
            " (1700000000.000001)  can0  123   [4]  01 02",
            row(1, data=b"\1\2", flags=FrameFlag.DLC_INVALID),
        ),
        ("(1700000000.000001) can0 80#", row(1, 0x80)),
    ],
)
def test_one_line(tmp_path: Path, line: str, expected: tuple[object, ...]) -> None:
    other = "(1700000000.000000) can0 7FF#"
    for text in (f"{other}\n{line}\n", f"{other}\r\n{line}\r\n", f"{other}\n{line}"):
        found, facts = read_text(tmp_path, text)
        assert found == [row(0, 0x7FF), expected]
        assert facts.unparsed_lines == []
        assert facts.time_base == "utc"


@pytest.mark.parametrize(
    "line",
    [
        "candump can0",
        "(1700000000.000001) can0 FFF#00",
        "(1700000000.000001) can0 40000000#00",
        "(1700000000.000001) can0 123#1",
        "(1700000000.000001) can0 123#112233445566778899",
        "(99999999999999999999.000001) can0 123#11",
        "(1700000000.000001) can0 123#81:00:12345678#11.22",
        "  can0  123   [9]  " + "00 " * 9,
        "9" * 5000,
    ],
)
def test_a_line_that_is_no_frame_is_counted(tmp_path: Path, line: str) -> None:
    found, facts = read_text(tmp_path, f"(1700000000.000000) can0 7FF#\n{line}\n\n")
    assert found == [row(0, 0x7FF)]
    assert facts.unparsed_lines == [(2, line[:200])]
    assert facts.buses == ["can0"]


def test_nanoseconds_are_kept_exactly(tmp_path: Path) -> None:
    found, facts = read_text(
        tmp_path, "".join(f"(1700000000.12345678{i}) can0 123#\n" for i in range(9))
    )
    assert [frame[0] for frame in found] == [T0_NS + 123_456_780 + i for i in range(9)]
    assert facts.resolution_ns == 1


def test_lines_that_explain_an_error_frame_are_no_frames_and_no_faults(tmp_path: Path) -> None:
    text = (
        " (1700000000.000000)  can0  20000088   [8]  00 00 80 19 00 00 00 00   ERRORFRAME\n"
        "\tprotocol-violation{{}{acknowledge-slot}}\n\tbus-error\n"
    )
    found, facts = read_text(tmp_path, text)
    assert found == [row(0, 0x88, bytes.fromhex("0000801900000000"), flags=ERROR)]
    assert facts.unparsed_count == 0


def test_dropped_frames_are_a_gap_between_their_neighbours(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text(
        "  (1700000000.000000)  can1  123   [0] \n"
        "DROPCOUNT: dropped 5 CAN frames on 'can1' socket (total drops 5)\n"
        "  (1700000000.000009)  can1  123   [0] \n",
        encoding="ascii",
    )
    for block_bytes in (64, 1 << 20):
        batch, _, gaps = read(path, block_bytes)
        assert len(batch) == 2
        assert gaps == [Gap(T0_NS, T0_NS + 9000, "frames dropped by the kernel", 5, 0)]


def test_differences_are_summed_and_times_from_a_start_are_not(tmp_path: Path) -> None:
    line = " ({:010.6f})  can0  123   [0] \n"
    found, facts = read_text(tmp_path, "".join(map(line.format, (0.0, 0.5, 0.25, 2.0, 0.125))))
    assert [frame[0] for frame in found] == [
        0,
        500_000_000,
        750_000_000,
        2_750_000_000,
        2_875_000_000,
    ]
    assert facts.time_base == "relative"
    found, facts = read_text(tmp_path, "".join(map(line.format, (0.0, 0.25, 0.5, 2.0, 2.125))))
    assert found[-1][0] == 2_125_000_000
    # A bus with one cyclic message: the differences are all the same.
    found, facts = read_text(tmp_path, "".join(map(line.format, (0.0, *[0.01] * 20))))
    assert found[-1][0] == 200_000_000


def test_times_step_back_where_the_log_steps_back(tmp_path: Path) -> None:
    found, _ = read_text(
        tmp_path, "".join(f"({1700000000 + s}.000000) can0 123#\n" for s in (5, 0, 1, 2, 3))
    )
    assert [frame[0] - T0_NS for frame in found] == [5 * 10**9, 0, 10**9, 2 * 10**9, 3 * 10**9]


def test_a_log_without_times_says_so(tmp_path: Path) -> None:
    found, facts = read_text(tmp_path, "candump can0\n  can0  123   [1]  05\n  can0  080   [0] \n")
    assert [frame[0] for frame in found] == [0, 0]
    assert facts.time_base == "none"
    assert facts.unparsed_lines == [(1, "candump can0")]


def test_buses_are_numbered_as_they_appear(tmp_path: Path) -> None:
    lines = ["slcan7 123#", "can0 123#1122", "vcan1 123#", "can0 123#", "slcan7 1#00"]
    found, facts = read_text(tmp_path, "".join(f"(1700000000.000000) {line}\n" for line in lines))
    assert facts.buses == ["slcan7", "can0", "vcan1"]
    assert [frame[1] for frame in found] == [0, 1, 2, 1, 0]


def test_a_bus_too_many_is_a_line_that_cannot_be_read(tmp_path: Path) -> None:
    found, facts = read_text(
        tmp_path, "".join(f"(1700000000.000000) can{i} 123#\n" for i in range(300))
    )
    assert len(found) == 256
    assert facts.unparsed_count == 44


def test_guard_requests_in_a_format_without_them_are_noted(tmp_path: Path) -> None:
    _, facts = read_text(tmp_path, "1700000000.000001 can0 70A [0]\n")
    assert any("remote frames are not marked" in note for note in facts.notes)
