"""Network captures, ROS 2 bags and BLF made by hand from frames."""

import struct
from collections.abc import Callable, Sequence
from io import BytesIO
from itertools import cycle

from mcap.writer import CompressionType, Writer

from tests.analyzer.log_builder import Row, message
from tests.analyzer.log_frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    REMOTE,
    TX,
    flags_of,
    without_direction,
)


def socketcan(frame: Row, order: str = ">") -> bytes:
    """`struct can_frame` or `canfd_frame`, as it stands in a packet."""
    flags = flags_of(frame)
    can_id = frame[2] | (EXTENDED in flags) << 31 | (REMOTE in flags) << 30 | (ERROR in flags) << 29
    fd = FD in flags
    bits = (4 | (BRS in flags) | (ESI in flags) << 1) if fd else 0
    data = frame[5].ljust(64 if fd else 8, b"\0")
    return struct.pack(f"{order}IBBH", can_id, frame[4], bits, 0) + data


def _pcap(
    frames: Sequence[Row],
    order: str,
    magic: int,
    unit_ns: int,
    link: int,
    packet: Callable[[Row], bytes],
) -> bytes:
    out = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 262144, link)
    for frame in frames:
        body = packet(frame)
        out += (
            struct.pack(
                f"{order}IIII", frame[0] // 10**9, frame[0] % 10**9 // unit_ns, len(body), len(body)
            )
            + body
        )
    return out


def pcap(frames: Sequence[Row]) -> bytes:
    """Little endian, microseconds, one interface."""
    return _pcap(frames, "<", 0xA1B2C3D4, 1000, 227, socketcan)


def pcap_big(frames: Sequence[Row]) -> bytes:
    """Big endian, nanoseconds; classic packets only as long as their data, so of odd lengths."""

    def packet(frame: Row) -> bytes:
        whole = socketcan(frame)
        return whole if frame[3] & FD else whole[: 8 + (0 if frame[3] & REMOTE else frame[4])]

    return _pcap(frames, ">", 0xA1B23C4D, 1, 227, packet)


def sll(frames: Sequence[Row]) -> bytes:
    """Cooked packets of the device `any`: identifiers in the order of the host."""

    def packet(frame: Row) -> bytes:
        way, protocol = 4 if frame[3] & TX else 0, 0x0D if frame[3] & FD else 0x0C
        return struct.pack(">HHH8sH", way, 280, 0, bytes(8), protocol) + socketcan(frame, "<")

    return _pcap(frames, "<", 0xA1B23C4D, 1, 113, packet)


def sll2(frames: Sequence[Row]) -> bytes:
    """Cooked packets of the second kind, which number their interfaces."""

    def packet(frame: Row) -> bytes:
        way, protocol = 4 if frame[3] & TX else 0, 0x0D if frame[3] & FD else 0x0C
        head = struct.pack(">HHIHBB8s", protocol, 0, 3 + frame[1], 280, way, 0, bytes(8))
        return head + socketcan(frame, "<")

    return _pcap(frames, "<", 0xA1B23C4D, 1, 276, packet)


def block(order: str, kind: int, body: bytes) -> bytes:
    size = struct.pack(f"{order}I", len(body) + 12)
    return struct.pack(f"{order}I", kind) + size + body + size


def option(order: str, code: int, value: bytes) -> bytes:
    return struct.pack(f"{order}HH", code, len(value)) + value + bytes(-len(value) % 4)


def pcapng(frames: Sequence[Row], order: str = "<") -> bytes:
    """Two interfaces of different resolution, comments before the direction, a name resolution block."""
    out = block(order, 0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
    for number, resolution in ((0, 6), (1, 9)):
        options = option(order, 2, b"can%d" % number) + option(order, 9, bytes([resolution]))
        out += block(order, 1, struct.pack(f"{order}HHI", 227, 0, 0) + options + bytes(4))
    out += block(order, 4, bytes(8))
    for frame in frames:
        ticks = frame[0] // (1 if frame[1] else 1000)
        packet = socketcan(frame)
        head = struct.pack(
            f"{order}IIIII", frame[1], ticks >> 32, ticks & 0xFFFFFFFF, len(packet), len(packet)
        )
        options = option(order, 1, b"hello") + option(
            order, 2, struct.pack(f"{order}I", 2 if frame[3] & TX else 1)
        )
        out += block(order, 6, head + packet + bytes(-len(packet) % 4) + options + bytes(4))
    return out


def pcapng_big(frames: Sequence[Row]) -> bytes:
    """A section of each byte order, one behind the other."""
    half = len(frames) // 2
    return pcapng(frames[:half], ">") + pcapng(frames[half:], "<")


def _bag(frames: Sequence[Row], schema: str, payload: Callable[[Row], bytes]) -> bytes:
    stream = BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD, chunk_size=400)
    writer.start("ros2", "rosbag2")
    number = writer.register_schema(schema, "ros2msg", b"std_msgs/Header header\n")
    channels = [writer.register_channel(f"/can{bus}/from_can_bus", "cdr", number) for bus in (0, 1)]
    for frame in frames:
        writer.add_message(channels[frame[1]], frame[0] + 5000, payload(frame), frame[0] + 5000)
    writer.finish()
    return stream.getvalue()


def _header(frame: Row, order: str) -> bytes:
    name = b"can\0" if frame[2] % 2 else b"can_link\0"
    stamp = struct.pack(f"{order}iI", frame[0] // 10**9, frame[0] % 10**9)
    told = b"\0\1\0\0" if order == "<" else bytes(4)
    return told + stamp + struct.pack(f"{order}I", len(name)) + name + bytes(-len(name) % 4)


def ros2(frames: Sequence[Row], orders: str = "<") -> bytes:
    """A bag of `can_msgs/msg/Frame`, its messages in these byte orders by turns."""
    order_of = dict(zip(map(id, frames), cycle(orders), strict=False))

    def payload(frame: Row) -> bytes:
        flags = flags_of(frame)
        marks = (REMOTE in flags, EXTENDED in flags, ERROR in flags)
        order = order_of[id(frame)]
        fields = struct.pack(f"{order}I???B", frame[2], *marks, frame[4])
        return _header(frame, order) + fields + frame[5].ljust(8, b"\0")

    return _bag([f for f in frames if not f[3] & FD], "can_msgs/msg/Frame", payload)


def ros2_keeps(frame: Row) -> Row | None:
    """Neither CAN FD nor the direction."""
    return None if frame[3] & FD else without_direction(frame)


def ros2_fd(frames: Sequence[Row], order: str = "<") -> bytes:
    """A bag of `ros2_socketcan_msgs/msg/FdFrame`."""

    def payload(frame: Row) -> bytes:
        flags = flags_of(frame)
        marks = (EXTENDED in flags, ERROR in flags)
        fields = struct.pack(f"{order}I??BB", frame[2], *marks, frame[4], 0)
        count = struct.pack(f"{order}I", len(frame[5]))
        return _header(frame, order) + fields + count + frame[5]

    return _bag([f for f in frames if f[3] & FD], "ros2_socketcan_msgs/msg/FdFrame", payload)


def ros2_fd_keeps(frame: Row) -> Row | None:
    """CAN FD alone, without its switches and the direction."""
    return (*frame[:3], frame[3] & ~(TX | BRS | ESI), *frame[4:]) if frame[3] & FD else None


def python_can_blf(frames: Sequence[Row]) -> bytes:
    """BLF by python-can: its writer keeps all but the last 238 ns."""
    import can

    stream = BytesIO()
    writer = can.BLFWriter(_Kept(stream))
    for frame in frames:
        writer.on_message_received(message(frame))
    writer.stop()
    return stream.getvalue()


class _Kept(BytesIO):
    """A stream whose bytes outlive its closing."""

    def __init__(self, kept: BytesIO) -> None:
        super().__init__()
        self._kept = kept

    def close(self) -> None:
        self._kept.write(self.getvalue())
        super().close()
