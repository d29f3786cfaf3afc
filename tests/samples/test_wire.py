from hypothesis import given
from hypothesis import strategies as st

from syncline_samples.wire import crc15, frame_bits, stuff, to_bits, wire_bits


def test_crc_gives_the_published_check_value() -> None:
    """CRC-15/CAN of "123456789" (catalogue of parametrised CRC algorithms)."""
    assert crc15(to_bits(int.from_bytes(b"123456789", "big"), 72)) == 0x059E


def test_length_without_stuff_bits_is_the_textbook_one() -> None:
    """44 bits and eight per byte, and three of intermission."""
    for length in range(9):
        data = b"\x55" * length
        stuffed = len(stuff(frame_bits(0x555, data))) - len(frame_bits(0x555, data))
        assert wire_bits(0x555, data) - stuffed == 44 + 8 * length + 3


def test_worst_case_stays_below_the_textbook_bound() -> None:
    """At most (34 + 8 n - 1) / 4 stuff bits.

    Identifier 0 and eight zero bytes: three stuff bits in the fifteen zeros before the DLC,
    thirteen in the 67 after its leading one, and whatever the CRC adds.
    """
    zeros = wire_bits(0x000, bytes(8)) - (44 + 64 + 3)
    assert 3 + 13 <= zeros <= (34 + 64 - 1) // 4


def test_known_frame_bit_by_bit() -> None:
    """SYNC (080h, no data), stuffed by hand.

    SOF 0, identifier 000 1000 0000, RTR IDE r0 = 000, DLC 0000: a one after SOF and three zeros,
    then fourteen zeros, into which a stuff bit falls after every five.
    """
    head = frame_bits(0x080, b"")[:19]
    assert head == [0, 0, 0, 0, 1, *[0] * 14]
    assert stuff(head) == [0, 0, 0, 0, 1, *[0] * 5, 1, *[0] * 5, 1, *[0] * 4]


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_tables_agree_with_counting_the_bits(can_id: int, data: bytes) -> None:
    assert wire_bits(can_id, data) == len(stuff(frame_bits(can_id, data))) + 13


@given(st.integers(0, 0x7FF), st.integers(0, 8))
def test_remote_frames_carry_no_data_bits(can_id: int, dlc: int) -> None:
    assert wire_bits(can_id, b"", dlc) == len(stuff(frame_bits(can_id, b"", dlc))) + 13


@given(st.lists(st.integers(0, 1), max_size=150))
def test_stuffed_bits_never_hold_six_equal_ones(bits: list[int]) -> None:
    sent = "".join(map(str, stuff(bits)))
    assert "000000" not in sent
    assert "111111" not in sent
