"""Messages of a SocketCAN socket, built byte by byte with struct as the kernel lays them out."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_logger.sources.socketcan_wire import Received, control_of, frames_of
from syncline_schemas.batch import FrameBatch, FrameFlag

S = 1_000_000_000
EXTENDED, REMOTE, ERROR = 1 << 31, 1 << 30, 1 << 29
SOL_SOCKET, SOL_CAN_RAW = 1, 101
OVFL, OLD_STAMPS, NEW_STAMPS = 40, 37, 65
DONTROUTE, CONFIRM = 0x4, 0x800


@dataclass(frozen=True)
class Message:
    """One message as the kernel hands it over."""

    frame: bytes
    flags: int = 0
    control: bytes = b""


def classic(can_id: int, data: bytes, length: int | None = None, raw_dlc: int = 0) -> bytes:
    told = len(data) if length is None else length
    return struct.pack("=IBBBB", can_id, told, 0, 0, raw_dlc) + data.ljust(8, b"\xee")


def fd(can_id: int, data: bytes, bits: int = 0) -> bytes:
    return struct.pack("=IBBBB", can_id, len(data), bits, 0, 0) + data.ljust(64, b"\xee")


def cmsg(kind: int, data: bytes, word: int = 8, level: int = SOL_SOCKET) -> bytes:
    """struct cmsghdr and data, padded to the machine's word."""
    size = word + 8 + len(data)
    header = struct.pack("=Qii" if word == 8 else "=Iii", size, level, kind)
    return header + data + bytes(-size % word)


def stamps(kernel_ns: int, hardware_ns: int, time: str = "q") -> bytes:
    """struct scm_timestamping; its second stamp is always empty."""
    parts = [divmod(kernel_ns, S), (0, 0), divmod(hardware_ns, S)]
    return struct.pack(f"=6{time}", *(number for part in parts for number in part))


def received(messages: Sequence[Message], width: int = 16) -> Received:
    """The memory that recvmmsg fills."""
    frames = np.full((len(messages), width), 0xAA, np.uint8)
    control = np.full((len(messages), 160), 0xAA, np.uint8)
    for row, message in enumerate(messages):
        frames[row, : len(message.frame)] = np.frombuffer(message.frame, np.uint8)
        control[row, : len(message.control)] = np.frombuffer(message.control, np.uint8)
    return Received(
        frames,
        np.array([len(message.frame) for message in messages], np.uint32),
        np.array([message.flags for message in messages], np.int32),
        control,
        np.array([len(message.control) for message in messages], np.uint64),
    )


def parsed(*messages: Message, width: int = 16) -> FrameBatch:
    return frames_of(received(messages, width), np.zeros(len(messages), np.int64), 3)


def one(frame: bytes, flags: int = 0, width: int = 16) -> tuple[int, int, int, bytes]:
    """Identifier, flags, length and all data bytes of a single message."""
    batch = parsed(Message(frame, flags), width=width)
    assert batch.bus.tolist() == [3]
    return int(batch.can_id[0]), int(batch.flags[0]), int(batch.dlc[0]), batch.data[0].tobytes()


def test_a_standard_frame_and_nothing_of_what_lay_behind_its_data() -> None:
    assert one(classic(0x181, b"\x01\x02\x03")) == (0x181, 0, 3, b"\x01\x02\x03\0\0\0\0\0")


def test_identifiers_of_both_lengths() -> None:
    assert one(classic(0x1ABCDEF0 | EXTENDED, b""))[:2] == (0x1ABCDEF0, FrameFlag.EXTENDED)
    assert one(classic(0x1FFFF, b""))[:2] == (0x7FF, 0)


def test_a_remote_frame_has_no_data_but_the_length_asked_for() -> None:
    assert one(classic(0x701 | REMOTE, b"\x01")) == (0x701, FrameFlag.REMOTE, 1, bytes(8))


@pytest.mark.parametrize("class_bits", [0x1, 0x4, 0x40, 0x200, 0x10000000, 0x1FFFFFFF])
def test_error_frames_keep_their_class_bits(class_bits: int) -> None:
    data = bytes(range(1, 9))
    assert one(classic(class_bits | ERROR, data)) == (class_bits, FrameFlag.ERROR, 8, data)


def test_a_raw_dlc_above_eight_means_eight_bytes() -> None:
    assert one(classic(0x181, b"abcdefgh", raw_dlc=15)) == (0x181, 0, 8, b"abcdefgh")


def test_a_length_that_cannot_be_is_marked() -> None:
    assert one(classic(0x181, b"abcdefgh", length=200)) == (
        0x181,
        FrameFlag.DLC_INVALID,
        8,
        b"abcdefgh",
    )


def test_what_this_machine_sent_is_marked() -> None:
    assert one(classic(1, b""), DONTROUTE)[1] == FrameFlag.TX
    assert one(classic(1, b""), DONTROUTE | CONFIRM)[1] == FrameFlag.TX


def test_fd_frames_beside_classic_ones() -> None:
    data = bytes(range(100, 148))
    batch = parsed(
        Message(fd(0x181, data, 0x01)),
        Message(classic(0x182, b"ab"), DONTROUTE),
        Message(fd(0x12345 | EXTENDED, b"", 0x02 | 0x04)),
        width=72,
    )
    assert batch.data.shape == (3, 64)
    assert batch.can_id.tolist() == [0x181, 0x182, 0x12345]
    assert batch.flags.tolist() == [
        FrameFlag.FD | FrameFlag.BRS,
        FrameFlag.TX,
        FrameFlag.FD | FrameFlag.ESI | FrameFlag.EXTENDED,
    ]
    assert batch.dlc.tolist() == [48, 2, 0]
    assert batch.data[0].tobytes() == data + bytes(16)
    assert batch.data[1].tobytes() == b"ab" + bytes(62)
    assert not batch.data[2].any()


def test_a_wide_buffer_without_fd_frames_makes_a_narrow_batch() -> None:
    assert parsed(Message(classic(1, b"abc")), width=72).data.tolist() == [
        [97, 98, 99, 0, 0, 0, 0, 0]
    ]


def test_the_batch_does_not_share_the_buffer() -> None:
    memory = received([Message(classic(1, b"abc"))])
    batch = frames_of(memory, np.zeros(1, np.int64), 0)
    memory.frames[:] = 0
    assert batch.data[0, :3].tobytes() == b"abc"


def test_nothing_received() -> None:
    assert len(parsed()) == 0
    assert len(control_of(received([])).drops) == 0


@dataclass(frozen=True)
class Beside:
    """What a message carries beside the frame, and what that means."""

    kernel_ns: int = 0
    hardware_ns: int = 0
    drops: int = 0
    parts: tuple[bytes, ...] = field(default=())


def beside(word: int, kernel_ns: int, hardware_ns: int, drops: int, layout: str) -> Beside:
    """Control messages in the order of `layout`: s stamps, o overflow, x another, l another level."""
    short = word == 4 and kernel_ns < 2**31 * S and hardware_ns < 2**31 * S
    parts, seen = [], set()
    for letter in layout:
        if letter in seen:
            continue
        seen.add(letter)
        if letter == "s":
            data = stamps(kernel_ns, hardware_ns, "i" if short else "q")
            parts.append(cmsg(OLD_STAMPS if short else NEW_STAMPS, data, word))
        elif letter == "o":
            parts.append(cmsg(OVFL, struct.pack("=I", drops), word))
        elif letter == "x":
            parts.append(cmsg(36, b"12345", word))
        else:
            parts.append(cmsg(OVFL, b"\xff\xff\xff\xff", word, SOL_CAN_RAW))
    return Beside(
        kernel_ns if "s" in seen else 0,
        hardware_ns if "s" in seen else 0,
        drops if "o" in seen else 0,
        tuple(parts),
    )


times = st.integers(0, 2**33 * S)


@given(
    word=st.sampled_from([4, 8]),
    rows=st.lists(
        st.tuples(times, times, st.integers(0, 2**32 - 1), st.text("soxl", max_size=4)), max_size=12
    ),
)
@settings(max_examples=200)
def test_stamps_and_drop_counters_of_any_layout(
    word: int, rows: list[tuple[int, int, int, str]]
) -> None:
    carried = [beside(word, *row) for row in rows]
    messages = [Message(classic(1, b""), control=b"".join(each.parts)) for each in carried]
    found = control_of(received(messages), word)
    assert found.kernel_ns.tolist() == [each.kernel_ns for each in carried]
    assert found.hardware_ns.tolist() == [each.hardware_ns for each in carried]
    assert found.drops.tolist() == [each.drops for each in carried]


@given(st.lists(st.binary(max_size=160), max_size=5))
@settings(max_examples=200)
def test_any_control_bytes_are_survived(controls: list[bytes]) -> None:
    found = control_of(received([Message(classic(1, b""), control=c) for c in controls]), 8)
    assert len(found.kernel_ns) == len(controls)


@given(
    st.lists(
        st.tuples(
            st.integers(0, 2**32 - 1),
            st.binary(max_size=8),
            st.sampled_from([0, DONTROUTE, CONFIRM, DONTROUTE | CONFIRM]),
        ),
        max_size=20,
    )
)
@settings(max_examples=200)
def test_any_classic_frames(frames: list[tuple[int, bytes, int]]) -> None:
    batch = parsed(*(Message(classic(word, data), flags) for word, data, flags in frames))
    for row, (word, data, flags) in enumerate(frames):
        long_id = word & (EXTENDED | ERROR)
        assert batch.can_id[row] == word & (0x1FFFFFFF if long_id else 0x7FF)
        assert bool(batch.flags[row] & FrameFlag.EXTENDED) == bool(word & EXTENDED)
        assert bool(batch.flags[row] & FrameFlag.REMOTE) == bool(word & REMOTE)
        assert bool(batch.flags[row] & FrameFlag.ERROR) == bool(word & ERROR)
        assert bool(batch.flags[row] & FrameFlag.TX) == bool(flags & DONTROUTE)
        assert batch.dlc[row] == len(data)
        assert batch.payload(row) == (b"" if word & REMOTE else data)
        assert not batch.data[row, len(data) :].any()
