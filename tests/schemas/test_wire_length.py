"""Wire lengths against frames built bit by bit, measured frames, and the bounds of the literature."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.wire_length import (
    FD_LENGTHS,
    INTERMISSION_BITS,
    crc15,
    data_phase_bits,
    longest_bits,
    wire_bits,
    wire_ns,
)
from tests.schemas.wire_model import (
    CRC_15,
    CRC_17,
    CRC_21,
    Sent,
    Shape,
    Wire,
    send_classic,
    send_fd,
)

pytestmark = pytest.mark.usefixtures("both_ways")

CLASSIC_SHAPES = [
    Shape(length, extended, remote)
    for extended, remote, length in product([False, True], [False, True], range(9))
]
FD_SHAPES = [
    Shape(length, extended, fd=True, brs=brs, esi=esi)
    for extended, brs, esi, length in product(
        [False, True], [False, True], [False, True], FD_LENGTHS
    )
]
COUNTING = bytes(range(64))


def batch_of(can_id: NDArray[np.uint32], data: NDArray[np.uint8], shape: Shape) -> FrameBatch:
    n = len(can_id)
    flags = (
        shape.extended * FrameFlag.EXTENDED
        | shape.remote * FrameFlag.REMOTE
        | shape.fd * FrameFlag.FD
        | shape.brs * FrameFlag.BRS
        | shape.esi * FrameFlag.ESI
    )
    return FrameBatch(
        np.arange(n),
        np.zeros(n, np.uint8),
        can_id,
        np.full(n, flags, np.uint16),
        np.full(n, shape.length, np.uint8),
        data,
    )


def random_frames(
    rng: np.random.Generator, n: int, shape: Shape
) -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
    """Identifiers and data of which a part is made of long runs, where stuffing happens."""
    can_id = rng.integers(0, 1 << (29 if shape.extended else 11), n).astype(np.uint32)
    sparse = rng.random(n) < 0.3
    can_id[sparse] &= can_id[sparse] >> 2
    width = 64 if shape.fd else 8
    data = rng.integers(0, 256, (n, width), dtype=np.uint8)
    runs = np.array([0x00, 0xFF, 0x0F, 0xF0, 0x1F, 0x87, 0x78, 0x83, 0xC1], np.uint8)
    data = np.where(rng.random((n, width)) < rng.random((n, 1)), rng.choice(runs, (n, width)), data)
    data[:, 0 if shape.remote else shape.length :] = 0
    return can_id, data


def one(can_id: int, data: bytes, shape: Shape) -> FrameBatch:
    padded = np.frombuffer(data.ljust(64 if shape.fd else 8, b"\0"), np.uint8)[None]
    return batch_of(np.array([can_id], np.uint32), padded, shape)


def sent_one(can_id: int, data: bytes, shape: Shape) -> Sent:
    frame = one(can_id, data, shape)
    return (send_fd if shape.fd else send_classic)(frame.can_id, frame.data, shape)


def bits_of(can_id: int, data: bytes, shape: Shape) -> int:
    """All bits on the wire with intermission, as computed."""
    frame = one(can_id, data, shape)
    return int((wire_bits(frame) + data_phase_bits(frame))[0])


# Frames of real controllers, measured with a logic analyser: the expected annotations of the CAN
# decoder's tests of the sigrok project (sigrok-test, decoder/test/can). Length in bits from SOF to
# the end of frame, and the bits of the CRC field as they were on the wire.
MEASURED = [
    (0x222, Shape(5), 87, "110011011011010"),
    (0x11223344, Shape(7, extended=True), 123, "000110100110000"),
    (0x042, Shape(8, fd=True), 133, "001101010101010111001110100"),
    (0x042, Shape(8, extended=True, fd=True), 155, "011110000100110111001010101"),
    (0x042, Shape(64, fd=True), None, "00110111010110100110110001100101"),
    (0x042, Shape(64, True, fd=True), None, "01111011010111010011010110011101"),
    (0x042, Shape(8, fd=True, brs=True), None, "001101110101011010110111101"),
    (0x042, Shape(8, True, fd=True, brs=True), None, "011110100100111010110011100"),
    (0x042, Shape(64, fd=True, brs=True), None, "00110110101101011110110010110101"),
    (0x042, Shape(64, True, fd=True, brs=True), None, "01111010101100101011010101001101"),
]
# The same project's frames with bit rate switch at 1 and 2 Mbit/s: time from SOF to end of frame.
MEASURED_NS = [
    (Shape(8, fd=True, brs=True), 80_170),
    (Shape(8, True, fd=True, brs=True), 102_180),
    (Shape(64, fd=True, brs=True), 314_710),
    (Shape(64, True, fd=True, brs=True), 336_710),
]


def measured_data(shape: Shape) -> bytes:
    return COUNTING[: shape.length] if shape.fd else bytes(17 * k for k in range(shape.length))


@pytest.mark.parametrize(("can_id", "shape", "bits", "crc_field"), MEASURED)
def test_measured_frames(can_id: int, shape: Shape, bits: int | None, crc_field: str) -> None:
    sent = sent_one(can_id, measured_data(shape), shape)
    assert sent.crc_text(0) == crc_field
    ours = bits_of(can_id, measured_data(shape), shape) - INTERMISSION_BITS
    assert ours == sent.length[0] - INTERMISSION_BITS
    assert bits in (None, ours)


@pytest.mark.parametrize(("shape", "measured_ns"), MEASURED_NS)
def test_measured_times(shape: Shape, measured_ns: int) -> None:
    frame = one(0x42, measured_data(shape), shape)
    ours_ns = float(wire_ns(frame, 1_000_000, 2_000_000, intermission=False)[0])
    # The receivers' ACK came a fraction of a bit late and moved the end of frame.
    assert 0 <= measured_ns - ours_ns < 300


@pytest.mark.parametrize(
    ("crc", "check"), [(CRC_15, 0x059E), (CRC_17, 0x04F03), (CRC_21, 0x0ED841)]
)
def test_crc_check_values_of_the_model(crc: tuple[int, int], check: int) -> None:
    wire = Wire(1, crc)
    for byte in b"123456789":
        for shift in reversed(range(8)):
            wire.check(byte >> shift & 1)
    assert wire.crc.tolist() == [check]


def test_crc_check_value() -> None:
    assert crc15(b"123456789") == 0x059E


def test_stuff_bits_of_the_model() -> None:
    # SOF and 11 dominant identifier bits: a stuff bit after five, then after each four more.
    assert sent_one(0, b"", Shape(0)).text(0).startswith("00000" + "1" + "00000" + "1" + "00000")
    # ESI and DLC of an empty frame are five dominant bits: the fixed stuff bit stands behind them.
    sent = sent_one(0x555, b"", Shape(0, fd=True, brs=True))
    assert sent.text(0)[:17] == "0" + "10101010101" + "00" + "1" + "0" + "1"
    assert sent.text(0)[17:28] == "00000" + "1" + "0000" + "1"


@pytest.mark.parametrize("seed", range(2))
def test_a_million_classic_and_fd_frames(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for shape in CLASSIC_SHAPES:
        can_id, data = random_frames(rng, 4500, shape)
        sent = send_classic(can_id, data, shape)
        bits = wire_bits(batch_of(can_id, data, shape))
        np.testing.assert_array_equal(bits, sent.length)
        assert bits.max() <= longest_bits(
            0 if shape.remote else shape.length, extended=shape.extended
        )
    for shape in FD_SHAPES:
        can_id, data = random_frames(rng, 750, shape)
        sent = send_fd(can_id, data, shape)
        frames = batch_of(can_id, data, shape)
        np.testing.assert_array_equal(data_phase_bits(frames), sent.data_phase)
        np.testing.assert_array_equal(wire_bits(frames), sent.length - sent.data_phase)
        assert sent.length.max() <= longest_bits(shape.length, extended=shape.extended, fd=True)


@st.composite
def frames_of_any_shape(draw: st.DrawFn) -> tuple[int, bytes, Shape]:
    shape = draw(st.sampled_from(CLASSIC_SHAPES + FD_SHAPES))
    byte = st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0x1F, 0x83]) | st.integers(0, 255)
    length = 0 if shape.remote else shape.length
    can_id = draw(st.integers(0, (1 << (29 if shape.extended else 11)) - 1))
    return can_id, bytes(draw(st.lists(byte, min_size=length, max_size=length))), shape


@given(st.lists(frames_of_any_shape(), min_size=1, max_size=20))
@settings(max_examples=60, deadline=None)
def test_frames_of_all_kinds_in_one_batch(frames: list[tuple[int, bytes, Shape]]) -> None:
    sent = [sent_one(*frame) for frame in frames]
    batch = FrameBatch.concat([one(*frame) for frame in frames])
    data_phase = [int(frame.data_phase[0]) for frame in sent]
    assert data_phase_bits(batch).tolist() == data_phase
    nominal = [int(frame.length[0]) - bits for frame, bits in zip(sent, data_phase, strict=True)]
    assert wire_bits(batch).tolist() == nominal
    backwards = batch[::-1]
    assert wire_bits(backwards).tolist() == nominal[::-1]
    assert data_phase_bits(backwards).tolist() == data_phase[::-1]


@pytest.mark.parametrize(
    ("shape", "overhead"),
    [
        (Shape(8), 47),
        (Shape(8, extended=True), 67),
        (Shape(64, fd=True), 67),
        (Shape(64, extended=True, fd=True), 86),
    ],
)
def test_frames_without_stuff_bits_have_the_bits_of_their_fields(
    shape: Shape, overhead: int
) -> None:
    # The overheads are those of Linux (include/linux/can/length.h), intermission included. Bytes
    # that alternate need no stuff bits; only a classic frame's CRC may.
    lengths = {
        bits_of(can_id, bytes([byte] * shape.length), shape)
        for can_id, byte in product([0x555, 0x2AA, 0x15555555], [0x55, 0xAA, 0x99, 0x66])
        if can_id < 0x800 or shape.extended
    }
    assert min(lengths) == overhead + 8 * shape.length


def test_lengths_stay_within_the_bounds_of_the_literature() -> None:
    # Davis, Burns, Bril, Lukkien 2007: 8 s + g + 13 + floor((g + 8 s - 1) / 4) bits at most, with
    # g = 34 or 54 and intermission; without stuff bits the shortest has 108 and 3 bits.
    assert [longest_bits(s) for s in range(9)] == [55, 65, 75, 85, 95, 105, 115, 125, 135]
    assert [longest_bits(s, extended=True) for s in (0, 8)] == [80, 160]
    rng = np.random.default_rng(1)
    shape = Shape(8)
    bits = wire_bits(batch_of(*random_frames(rng, 50_000, shape), shape))
    assert bits.min() >= 108 + INTERMISSION_BITS
    assert bits.max() > 125


def test_longest_data_phase() -> None:
    # Stuff bits behind the first and each fourth bit of the data. For the CRC field of the first
    # CAN FD specification the literature has 673 bits; ISO added the stuff count with its stuff bit.
    frame = one(0x555, b"\x87" * 64, Shape(64, fd=True, brs=True))
    assert data_phase_bits(frame).tolist() == [673 + 5]


@pytest.mark.parametrize(("last", "stuff_bits"), [(0xE0, 0), (0xC1, 1), (0xDF, 0), (0xBE, 1)])
def test_a_run_that_ends_with_the_data_makes_no_stuff_bit(last: int, stuff_bits: int) -> None:
    # 0xE0 and 0xDF end in five equal bits, the others have theirs before the last bit.
    shape = Shape(2, fd=True)
    without = bits_of(0x555, b"\x55\x55", shape)
    first = 0x55 if last & 0x80 == 0 else 0xAA
    assert bits_of(0x555, bytes([first, last]), shape) - without == stuff_bits
    classic = replace(shape, fd=False)
    sent = sent_one(0x555, bytes([first, last]), classic)
    assert bits_of(0x555, bytes([first, last]), classic) == sent.length[0]


@pytest.mark.parametrize(("length", "sent_length"), [(9, 12), (13, 16), (33, 48), (63, 64)])
def test_fd_lengths_that_do_not_exist_count_as_the_next(length: int, sent_length: int) -> None:
    shape = Shape(sent_length, fd=True, brs=True)
    data = COUNTING[1 : length + 1].ljust(sent_length, b"\0")
    odd = one(0x123, data, replace(shape, length=length))
    assert (wire_bits(odd) + data_phase_bits(odd)).tolist() == [bits_of(0x123, data, shape)]


def test_any_flags_and_lengths_are_taken() -> None:
    """Rows that no bus can have sent: every combination of flags, more bytes told than kept."""
    rows = list(product(range(1 << 8), [0, 3, 8, 9, 64, 255]))
    n = len(rows)
    flags, dlc = np.array(rows).T
    narrow = FrameBatch(
        np.arange(n),
        np.zeros(n, np.uint8),
        np.full(n, 0x1FFFFFFF, np.uint32) >> np.where(flags & FrameFlag.EXTENDED, 0, 18),
        flags.astype(np.uint16),
        dlc.astype(np.uint8),
        np.zeros((n, 8), np.uint8),
    )
    nominal, data = wire_bits(narrow), data_phase_bits(narrow)
    error = (flags & FrameFlag.ERROR) != 0
    switched = ~error & (flags & FrameFlag.FD != 0) & (flags & FrameFlag.BRS != 0)
    assert ((nominal == 0) == error).all()
    assert ((data > 0) == switched).all()
    # There are no remote frames in CAN FD; a flag that says so changes nothing.
    fd = (flags & FrameFlag.FD) != 0
    plain = replace_flags(narrow, flags & ~int(FrameFlag.REMOTE))
    assert (wire_bits(plain)[fd] == nominal[fd]).all()


def replace_flags(batch: FrameBatch, flags: NDArray[np.integer]) -> FrameBatch:
    return replace(batch, flags=flags.astype(np.uint16))


def test_intermission_can_be_left_out() -> None:
    for shape in (Shape(2), Shape(2, fd=True), Shape(2, fd=True, brs=True)):
        batch = one(0x181, b"\1\2", shape)
        without = wire_bits(batch, intermission=False)
        assert (wire_bits(batch) - without).tolist() == [INTERMISSION_BITS]


def test_error_frames_have_no_length() -> None:
    error = FrameBatch.from_rows([(0, 0, 0x88, int(FrameFlag.ERROR), 8, bytes(8))])
    assert wire_bits(error).tolist() == data_phase_bits(error).tolist() == [0]


def test_time_on_the_wire() -> None:
    frames = FrameBatch.concat(
        [one(0x42, COUNTING[:8], Shape(8, fd=True, brs=brs)) for brs in (False, True)]
    )
    # 133 bits without intermission, of which 106 in the data phase.
    assert wire_ns(frames, 500_000, 2_000_000).tolist() == [272_000, 60_000 + 53_000]
    # Without a data bit rate the data phase is taken to be as slow as the rest.
    assert wire_ns(frames, 500_000).tolist() == [272_000, 272_000]
    assert wire_ns(frames, 500_000, intermission=False)[0] == 266_000


def test_no_frames() -> None:
    assert len(wire_bits(FrameBatch.empty())) == len(data_phase_bits(FrameBatch.empty())) == 0
