"""Wire lengths against a model that builds every frame bit by bit from ISO 11898-1."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.wire_length import INTERMISSION_BITS, crc15, longest_bits, wire_bits


def bits_of(value: int, width: int) -> list[int]:
    return [value >> shift & 1 for shift in reversed(range(width))]


def crc_bits(bits: list[int]) -> list[int]:
    register = 0
    for bit in bits:
        feedback = bit ^ (register >> 14)
        register = (register << 1) & 0x7FFF
        if feedback:
            register ^= 0x4599
    return bits_of(register, 15)


def modelled_bits(can_id: int, data: bytes, *, extended: bool, remote: bool, dlc: int) -> int:
    """Bits on the wire with intermission: SOF .. CRC stuffed, then 1 + 2 + 7 + 3 bits."""
    if extended:
        head = [*bits_of(can_id >> 18, 11), 1, 1, *bits_of(can_id & 0x3FFFF, 18), remote, 0, 0]
    else:
        head = [*bits_of(can_id, 11), int(remote), 0, 0]
    bits = [0, *map(int, head), *bits_of(dlc, 4)]
    for byte in data:
        bits += bits_of(byte, 8)
    bits += crc_bits(bits)
    sent: list[int] = []
    for bit in bits:
        sent.append(bit)
        if len(sent) >= 5 and len(set(sent[-5:])) == 1:
            sent.append(1 - bit)
    return len(sent) + 13


Row = tuple[int, int, int, int, int, bytes]


@st.composite
def rows(draw: st.DrawFn) -> Row:
    extended, remote = draw(st.booleans()), draw(st.booleans())
    can_id = draw(st.integers(0, (1 << 29) - 1 if extended else 0x7FF))
    dlc = draw(st.integers(0, 8))
    # Long runs of equal bits are where stuffing happens.
    byte = st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0x1F, 0x83]) | st.integers(0, 255)
    data = b"" if remote else bytes(draw(st.lists(byte, min_size=dlc, max_size=dlc)))
    flags = extended * FrameFlag.EXTENDED | remote * FrameFlag.REMOTE
    return 0, 0, can_id, int(flags), dlc, data


@given(st.lists(rows(), min_size=1, max_size=40))
@settings(max_examples=100, deadline=None)
def test_equals_the_bit_by_bit_model(frames: list[Row]) -> None:
    expected = [
        modelled_bits(
            can_id,
            data,
            extended=bool(flags & FrameFlag.EXTENDED),
            remote=bool(flags & FrameFlag.REMOTE),
            dlc=dlc,
        )
        for _, _, can_id, flags, dlc, data in frames
    ]
    assert wire_bits(FrameBatch.from_rows(frames)).tolist() == expected


def test_crc_check_value() -> None:
    assert crc15(b"123456789") == 0x059E


def test_lengths_stay_within_the_bounds_of_the_literature() -> None:
    # 11-bit, 8 bytes: 108 + 3 bits without a stuff bit, 135 at worst (Tindell, Davis).
    rng = np.random.default_rng(1)
    n = 20_000
    dlc = rng.integers(0, 9, n).astype(np.uint8)
    data = rng.choice(np.array([0, 0xFF, 0x1E], np.uint8), (n, 8))
    data[np.arange(8) >= dlc[:, None]] = 0
    zero = np.zeros(n, np.uint8)
    batch = FrameBatch(
        np.arange(n),
        zero,
        rng.integers(0, 2048, n).astype(np.uint32),
        zero.astype(np.uint16),
        dlc,
        data,
    )
    bits = wire_bits(batch)
    assert (bits >= 47 + 8 * dlc.astype(int)).all()
    assert (bits <= [longest_bits(length) for length in range(9)][-1]).all()
    assert (bits <= np.array([longest_bits(length) for length in range(9)])[dlc]).all()
    assert longest_bits(8) == 135
    assert longest_bits(8, extended=True) == 160


def test_intermission_can_be_left_out() -> None:
    batch = FrameBatch.from_rows([(0, 0, 0x181, 0, 2, b"\1\2")])
    without = wire_bits(batch, intermission=False)
    assert (wire_bits(batch) - without).tolist() == [INTERMISSION_BITS]


def test_error_frames_have_no_length() -> None:
    error = (0, 0, 0x88, int(FrameFlag.ERROR), 8, bytes(8))
    assert wire_bits(FrameBatch.from_rows([error])).tolist() == [0]


@pytest.mark.parametrize("length", [0, 8, 12, 16, 20, 64])
def test_fd_frames_get_an_upper_bound(length: int) -> None:
    frame = (0, 0, 0x123, int(FrameFlag.FD), length, bytes(length))
    bits = int(wire_bits(FrameBatch.from_rows([frame]))[0])
    # SOF, 11-bit id, RRS, IDE, FDF, res, BRS, ESI, DLC; data; stuff count and CRC; trailer.
    least = 22 + 8 * length + 4 + (17 if length <= 16 else 21) + 10 + 3
    assert least < bits <= least + (22 + 8 * length) // 4 + 9


def test_no_frames() -> None:
    assert len(wire_bits(FrameBatch.empty())) == 0
