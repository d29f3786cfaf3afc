"""The slcan protocol: bytes to columns, compared with python-can's reader of the same bytes."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_logger.sources.slcan_wire import MAX_LINE, NO_STAMP, LineReader, Lines
from syncline_schemas.batch import FrameFlag

Row = tuple[int, int, int, bytes]


def rows(lines: Lines) -> list[Row]:
    frames = lines.frames
    return [
        (int(i), int(f), int(n), frames.data[k, : n if not f & FrameFlag.REMOTE else 0].tobytes())
        for k, (i, f, n) in enumerate(zip(frames.can_id, frames.flags, frames.dlc, strict=True))
    ]


def read(data: bytes) -> Lines:
    return LineReader().feed(data)


LENGTHS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64]


@st.composite
def frame_lines(draw: st.DrawFn, *, stamps: bool = True) -> bytes:
    """A frame as an adapter sends it."""
    letter = draw(st.sampled_from("tTrRdDbB"))
    extended = letter.isupper()
    can_id = draw(st.integers(0, 0x1FFF_FFFF if extended else 0x7FF))
    code = draw(st.integers(0, 15 if letter in "dDbB" else 8))
    size = 0 if letter in "rR" else LENGTHS[code]
    data = draw(st.binary(min_size=size, max_size=size))
    stamp = draw(st.sampled_from(["", "EA5F", "0000", "FFFFFFFF"])) if stamps else ""
    text = f"{letter}{can_id:0{8 if extended else 3}X}{code:X}{data.hex().upper()}{stamp}"
    return (text if draw(st.booleans()) else letter + text[1:].lower()).encode() + b"\r"


def of_python_can(bus: Any, data: bytes) -> list[Row]:
    bus.flush()
    bus.serialPortOrig.write(data)
    got = []
    for _ in range(data.count(b"\r")):
        message, _ = bus._recv_internal(0)
        if message is not None:
            flags = FrameFlag.EXTENDED if message.is_extended_id else FrameFlag(0)
            flags |= FrameFlag.REMOTE if message.is_remote_frame else 0
            flags |= FrameFlag.FD if message.is_fd else 0
            flags |= FrameFlag.BRS if message.bitrate_switch else 0
            got.append((message.arbitration_id, int(flags), message.dlc, bytes(message.data)))
    return got


@given(data=st.lists(frame_lines(), max_size=20).map(b"".join))
@settings(max_examples=60, deadline=None)
def test_it_reads_what_python_can_reads(data: bytes) -> None:
    pytest.importorskip("serial")
    from can.interfaces.slcan import slcanBus

    bus = slcanBus("loop://", sleep_after_open=0)
    try:
        assert rows(read(data)) == of_python_can(bus, data)
    finally:
        bus.flush()
        bus.shutdown()


@given(st.lists(frame_lines(), max_size=12).map(b"".join), st.lists(st.integers(0, 600)))
@settings(deadline=None)
def test_split_anywhere_it_reads_the_same(data: bytes, cuts: list[int]) -> None:
    reader = LineReader()
    got: list[Row] = []
    places: list[int] = []
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    for begin, end in pairwise(edges):
        lines = reader.feed(data[begin:end])
        got += rows(lines)
        places += (lines.at + begin).tolist()
    whole = read(data)
    assert got == rows(whole)
    assert places == whole.at.tolist() == [n for n, byte in enumerate(data) if byte == 0x0D]


@given(st.lists(st.binary(max_size=400), max_size=8))
@settings(deadline=None)
def test_it_never_raises(parts: list[bytes]) -> None:
    reader = LineReader()
    for part in parts:
        lines = reader.feed(part)
        assert len(lines.frames) == len(lines.at) == len(lines.stamp)


@given(
    st.lists(
        st.tuples(
            frame_lines(), st.sampled_from([b"", b"nonsense\r", b"\x07", b"t12\r", b"\xff\r"])
        ),
        max_size=20,
    )
)
@settings(deadline=None)
def test_what_is_damaged_is_counted_and_costs_no_frame(parts: list[tuple[bytes, bytes]]) -> None:
    data = b"".join(frame + damage for frame, damage in parts)
    lines = read(data)
    assert rows(lines) == rows(read(b"".join(frame for frame, _ in parts)))
    damages = [damage for _, damage in parts]
    assert lines.refused == damages.count(b"\x07")
    assert lines.garbage == sum(damage not in (b"", b"\x07") for damage in damages)
    assert lines.garbage_bytes == sum(len(d) - 1 for d in damages if d not in (b"", b"\x07"))


@pytest.mark.parametrize(
    "line",
    [
        b"t1858001122334455667",
        b"t18580011223344556G77",
        b"t8001AA",
        b"T200000001AA",
        b"t1852AABBC",
        b"t1852AABBCC",
        b"t185300112Z1234",
        b"r1850123",
        b"t18",
        b"hello",
        b"tt1852AABB",
    ],
)
def test_damaged_frames_are_none(line: bytes) -> None:
    lines = read(line + b"\r")
    assert (len(lines.frames), lines.garbage) == (0, 1)


def test_stamps_of_both_widths() -> None:
    lines = read(b"t1851AA1234\rt1851AA\rt1851AA89ABCDEF\rr1852EA5F\r")
    assert lines.stamp.tolist() == [0x1234, NO_STAMP, 0x89AB_CDEF, 0xEA5F]
    assert lines.stamp_digits.tolist() == [4, 0, 8, 4]


def test_the_error_state_indicator_of_an_fd_frame() -> None:
    lines = read(b"d1851AA1\rb1851AA0\rB000001851AA12341\r")
    expected = [FrameFlag.FD | FrameFlag.ESI, FrameFlag.FD | FrameFlag.BRS]
    expected.append(FrameFlag.FD | FrameFlag.BRS | FrameFlag.ESI | FrameFlag.EXTENDED)
    assert lines.frames.flags.tolist() == expected
    assert lines.stamp.tolist() == [NO_STAMP, NO_STAMP, 0x1234]


def test_a_dlc_above_8_has_8_bytes() -> None:
    assert rows(read(b"t185F0011223344556677\r")) == [
        (0x185, 0, 8, bytes.fromhex("0011223344556677"))
    ]


def test_line_feeds_are_no_part_of_a_line() -> None:
    assert rows(read(b"t0800\r\nt0800\r\n")) == [(0x080, 0, 0, b"")] * 2


def test_answers_are_no_frames() -> None:
    lines = read(b"\rV1013\r\x07F09\rsb256256\r")
    assert [answer for _, answer in lines.answers] == [b"V1013", b"F09", b"sb256256"]
    assert (lines.acknowledged, lines.refused, lines.garbage) == (1, 1, 0)


@pytest.mark.parametrize(
    "line",
    [
        b"F1122334455667788",
        b"v1858001122334455667788",
        b"v0800",
        b"v7050",
        b"V00001234811223344556677881234",
        b"s1008",
        b"s1852AABB",
        b"e1852AABB",
        b"e0",
        b"e2a",
        b"FF",
        b"F0",
        b"FG0",
        b"F000",
        b"N",
        b"NA12345",
        b"z1",
    ],
)
def test_a_damaged_frame_is_no_answer_by_its_first_letter(line: bytes) -> None:
    """A bit of the letter turned over, or a head that was lost: the frame is told as lost."""
    lines = read(b"t0800\r" + line + b"\rt0800\r")
    assert (len(lines.frames), lines.answers) == (2, [])
    assert (lines.garbage, lines.garbage_frames) == (1, 1)


@pytest.mark.parametrize(
    "line",
    [b"F00", b"Fff", b"V1013", b"VL2K0", b"NA123", b"z", b"Z", b"sa000000", b"e1a", b"e3abB"],
)
def test_a_whole_answer_costs_nothing(line: bytes) -> None:
    lines = read(b"t0800\r" + line + b"\rt0800\r")
    assert (len(lines.frames), lines.garbage_frames) == (2, 0)
    assert [answer for _, answer in lines.answers] == [line]


@given(st.lists(st.tuples(frame_lines(stamps=False), st.integers(0, 7)), min_size=1, max_size=12))
@settings(deadline=None)
def test_with_one_bit_of_its_letter_turned_over_every_frame_is_told_or_read(
    parts: list[tuple[bytes, int]],
) -> None:
    lines = [bytes([line[0] ^ 1 << bit]) + line[1:] for line, bit in parts]
    got = read(b"".join(lines))
    assert len(got.frames) + got.garbage_frames >= len(lines)
    assert got.answers == []


def test_bytes_without_an_end_do_not_pile_up() -> None:
    reader = LineReader()
    garbage = sum(reader.feed(b"y" * 1000).garbage for _ in range(50))
    assert garbage == 1
    assert rows(reader.feed(b"xx\rt0800\r")) == [(0x080, 0, 0, b"")]
    assert MAX_LINE < 1000


def test_mixed_widths_keep_their_order() -> None:
    data = b"t1851AA\rd2859" + b"11" * 12 + b"\rT000001852BBCC\rt0800\r"
    got = rows(read(data))
    assert [row[0] for row in got] == [0x185, 0x285, 0x185, 0x080]
    assert np.shape(read(data).frames.data) == (4, 64)


@pytest.mark.parametrize(
    ("pieces", "frames"),
    [
        ([b"t08\r"], 1),
        ([b"t18521122#t18521122\r"], 2),
        ([b"#18521122\rt08\r"], 2),
        ([b"noise\r"], 1),
        ([b"t18521122#" * 20, b"t18521122#" * 20, b"t18521122\rt0800\r"], 41),
    ],
)
def test_frames_in_damaged_lines_are_counted(pieces: list[bytes], frames: int) -> None:
    reader = LineReader()
    assert sum(reader.feed(piece).garbage_frames for piece in pieces) == frames
