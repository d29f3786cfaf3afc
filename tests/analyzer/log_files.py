"""Files of every format that is read, made by hand from frames: none of Syncline's writers helps."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from io import BytesIO

from mcap.writer import CompressionType, Writer

from syncline_schemas.batch import FrameFlag
from tests.analyzer.log_builder import FD_LENGTHS, T0_NS, Row, row

EXTENDED, REMOTE, ERROR, FD = (
    FrameFlag.EXTENDED,
    FrameFlag.REMOTE,
    FrameFlag.ERROR,
    FrameFlag.FD,
)
BRS, ESI, TX = FrameFlag.BRS, FrameFlag.ESI, FrameFlag.TX

FRAMES: tuple[Row, ...] = (
    row(0, 0x080),
    row(150, 0x181, bytes(range(8))),
    row(300, 0x701, b"\x05", flags=TX),
    row(450, 0x18FEF100, bytes.fromhex("FF00A5"), flags=EXTENDED),
    row(600, 0x123, bytes.fromhex("0DF00D"), flags=EXTENDED, bus=1),
    row(750, 0x70A, flags=REMOTE, dlc=1),
    row(900, 0x1ABCDE01, flags=REMOTE | EXTENDED, dlc=8),
    row(1_050, 0x40, bytes(range(0x10, 0x18)), flags=ERROR),
    row(1_200, 0x88, bytes.fromhex("0004190000001122"), flags=ERROR, bus=1),
    row(1_350, 0x7FF, bytes(range(0x40, 0x4C)), flags=FD),
    row(1_500, 0x18DAF110, bytes(range(64)), flags=FD | BRS | EXTENDED),
    row(1_650, 0x111, b"\x01\x02", flags=FD | BRS | ESI, bus=1),
    row(3_601_000_000, 0x000, bytes.fromhex("0100"), flags=TX),
    row(30_000_000_000, 0x085, bytes.fromhex("3081110000000000")),
)
"""Every kind of frame, on two buses, past midnight."""

Encoder = Callable[[Sequence[Row]], bytes]
Keeper = Callable[[Row], Row | None]


@dataclass(frozen=True, slots=True)
class LogFile:
    """A format with what of a frame it holds.

    Attributes:
        keep: the frame as it is read, None where the format has no room for it.
        buses: the names that the two buses get.
        corrupt: a damaged line of it, for text formats.
        step_ns: of its stamps.
        origin_ns: what its times count from, for those without dates.
    """

    name: str
    encode: Encoder
    keep: Keeper
    buses: tuple[str, str] = ("can0", "can1")
    corrupt: bytes | None = None
    origin_ns: int = 0

    def expected(self, frames: Sequence[Row] = FRAMES) -> list[Row]:
        """The frames as the reader must give them."""
        kept = [found for frame in frames if (found := self.keep(frame)) is not None]
        return [(t_ns - self.origin_ns, *rest) for t_ns, *rest in kept]  # type: ignore[misc]


def everything(frame: Row) -> Row | None:
    """Nothing is lost."""
    return frame


def plain_errors(frame: Row) -> Row | None:
    """Nothing but the contents of error frames is lost."""
    if frame[3] & ERROR:
        return (frame[0], frame[1], 0, int(ERROR), 8, bytes(8))
    return frame


def classic(frame: Row) -> Row | None:
    """CAN FD cannot be told."""
    return None if frame[3] & FD else frame


def _flags(frame: Row) -> FrameFlag:
    return FrameFlag(frame[3])


def _candump_id(frame: Row) -> str:
    if frame[3] & ERROR:
        return f"{frame[2] | 0x20000000:08X}"
    return f"{frame[2]:08X}" if frame[3] & EXTENDED else f"{frame[2]:03X}"


def _seconds(t_ns: int, places: int = 6) -> str:
    return f"{t_ns // 10**9}.{t_ns % 10**9 // 10 ** (9 - places):0{places}d}"


def candump(frames: Sequence[Row]) -> bytes:
    """`candump -L -x`."""
    lines = []
    for frame in frames:
        flags, data = _flags(frame), frame[5].hex().upper()
        if REMOTE in flags:
            text = f"#R{frame[4]}"
        elif FD in flags:
            text = f"##{(BRS in flags) + 2 * (ESI in flags)}{data}"
        else:
            text = f"#{data}"
        way = "T" if TX in flags else "R"
        lines.append(f"({_seconds(frame[0])}) can{frame[1]} {_candump_id(frame)}{text} {way}\n")
    return "".join(lines).encode()


def screen(frames: Sequence[Row]) -> bytes:
    """`candump -ta -x -a -e any`."""
    lines = []
    for frame in frames:
        flags = _flags(frame)
        state = f"{'TX' if TX in flags else 'RX'} {'B' if BRS in flags else '-'} {'E' if ESI in flags else '-'}"
        length = f"[{frame[4]:02d}]" if FD in flags else f" [{frame[4]}]"
        text = "remote request" if REMOTE in flags else frame[5].hex(" ").upper()
        shown = f"   '{'.' * len(frame[5])}'" if frame[5] and ERROR not in flags else ""
        lines.append(
            f" ({_seconds(frame[0])})  can{frame[1]}  {state}  {_candump_id(frame):>8}  {length}  {text}{shown}\n"
        )
        if ERROR in flags:
            lines[-1] = lines[-1].rstrip("\n") + "   ERRORFRAME\n\tbus-off\n"
    return "".join(lines).encode()


def asc(frames: Sequence[Row]) -> bytes:
    """Vector ASC, version 9."""
    lines = ["date Tue Nov 14 10:13:20.000 pm 2023", "base hex  timestamps absolute"]
    lines += [
        "internal events logged",
        "// version 9.0.0",
        "Begin Triggerblock Tue Nov 14 10:13:20.000 pm 2023",
    ]
    for frame in frames:
        flags, t = _flags(frame), _seconds(frame[0] - T0_NS)
        name = f"{frame[2]:X}" + ("x" if EXTENDED in flags else "")
        way = "Tx" if TX in flags else "Rx"
        if ERROR in flags:
            lines.append(f"   {t} {frame[1] + 1}  ErrorFrame")
        elif FD in flags:
            bits = 0x1000 | (BRS in flags) << 13 | (ESI in flags) << 14
            lines.append(
                f"   {t} CANFD {frame[1] + 1:3d} {way} {name:>10}  {'':32} {int(BRS in flags)} {int(ESI in flags)} "
                f"{FD_LENGTHS.index(frame[4]):x} {frame[4]:2d} {frame[5].hex(' ').upper()}   140000  73 {bits:8x} 0 0 0 0 0"
            )
        elif REMOTE in flags:
            lines.append(f"   {t} {frame[1] + 1}  {name:<15} {way}   r {frame[4]}")
        else:
            lines.append(
                f"   {t} {frame[1] + 1}  {name:<15} {way}   d {frame[4]} {frame[5].hex(' ').upper()}  Length = 220000 BitCount = 113"
            )
    return "\n".join([*lines, "End TriggerBlock", ""]).encode()


def trc(frames: Sequence[Row]) -> bytes:
    """PEAK TRC 2.1."""
    days = Decimal(T0_NS // 10**9) / 86400 + 25569
    lines = [";$FILEVERSION=2.1", f";$STARTTIME={days:.20f}", ";$COLUMNS=N,O,T,B,I,d,R,L,D", ";"]
    for number, frame in enumerate(frames, 1):
        flags, ms = _flags(frame), (frame[0] - T0_NS) // 1000
        kind = "DT"
        if REMOTE in flags:
            kind = "RR"
        elif FD in flags:
            kind = "FE" if ESI in flags else "FB" if BRS in flags else "FD"
        offset = f"{ms // 1000}.{ms % 1000:03d}"
        way = "Tx" if TX in flags else "Rx"
        name = f"{frame[2]:08X}" if EXTENDED in flags else f"{frame[2]:04X}"
        code = FD_LENGTHS.index(frame[4]) if FD in flags else frame[4]
        if ERROR in flags:
            lines.append(
                f"{number:7d} {offset:>13} ER {frame[1] + 1}         - Rx -  5    04 00 02 00 00 "
            )
        else:
            lines.append(
                f"{number:7d} {offset:>13} {kind} {frame[1] + 1}  {name:>8} {way} -  {code:<4} {frame[5].hex(' ').upper()} "
            )
    return "\r\n".join([*lines, ""]).encode()


def trc_keeps(frame: Row) -> Row | None:
    """Of an error frame only that there was one."""
    if frame[3] & ERROR:
        return (frame[0], frame[1], 0x88, int(ERROR), 8, bytes(8))
    return frame


def kvaser(frames: Sequence[Row]) -> bytes:
    """CanKing text, hexadecimal."""
    lines = ["Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir"]
    for frame in frames:
        flags, t = _flags(frame), _seconds(frame[0] - T0_NS)
        mark = ("X" if EXTENDED in flags else "") + ("R" if REMOTE in flags else "")
        way = "T" if TX in flags else "R"
        if ERROR in flags:
            lines.append(
                f" {frame[1]}    00000000            ErrorFrame                     {t:>14} {way}"
            )
        elif FD not in flags:
            data = "  ".join(f"{byte:02X}" for byte in frame[5])
            lines.append(
                f" {frame[1]}    {frame[2]:08X} {mark:<3}     {frame[4]}  {data:<30}  {t:>14} {way}"
            )
    return "\r\n".join([*lines, "Logging stopped.", ""]).encode()


def kvaser_keeps(frame: Row) -> Row | None:
    """Neither CAN FD nor contents of error frames."""
    return None if frame[3] & FD else plain_errors(frame)


def busmaster(frames: Sequence[Row]) -> bytes:
    """BUSMASTER 3.2, hexadecimal, times of day: midnight is passed."""
    lines = [
        "***BUSMASTER Ver 3.2.2***",
        "***PROTOCOL CAN***",
        "***NOTE: PLEASE DO NOT EDIT THIS DOCUMENT***",
        "***[START LOGGING SESSION]***",
        "***START DATE AND TIME 14:11:2023 22:13:19:965***",
        "***HEX***",
        "***SYSTEM MODE***",
        "***START CHANNEL BAUD RATE***",
        "***CHANNEL 1 - Kvaser - Leaf Light HS #0 (Channel 0), Serial Number- 0 - 500000 bps***",
        "***END CHANNEL BAUD RATE***",
        "***START DATABASE FILES***",
        "***END OF DATABASE FILES***",
        "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***",
    ]
    for frame in frames:
        flags = _flags(frame)
        if flags & (FD | ERROR):
            continue
        moment = datetime.fromtimestamp(frame[0] // 10**9, UTC)
        clock = f"{moment.hour}:{moment:%M:%S}:{frame[0] % 10**9 // 10**5:04d}"
        kind = ("x" if EXTENDED in flags else "s") + ("r" if REMOTE in flags else "")
        name = f"0x{frame[2]:08X}" if EXTENDED in flags else f"0x{frame[2]:03X}"
        way = "Tx" if TX in flags else "Rx"
        lines.append(
            f"{clock} {way} {frame[1] + 1} {name} {kind} {frame[4]} {frame[5].hex(' ').upper()}"
        )
    return "\n".join(
        [
            *lines,
            "***END DATE AND TIME 15:11:2023 23:59:59:0***",
            "***[STOP LOGGING SESSION]***",
            "",
        ]
    ).encode()


def busmaster_keeps(frame: Row) -> Row | None:
    """Neither CAN FD nor error frames; stamps of 100 us."""
    if frame[3] & (FD | ERROR):
        return None
    return (frame[0] - frame[0] % 100_000, *frame[1:])


def german_csv(frames: Sequence[Row]) -> bytes:
    """A home-made table: German names, semicolons, decimal commas, one column per byte."""
    lines = [
        "Nr;Zeit [ms];Kanal;Kennung (hex);Erweitert;RTR;Richtung;Länge;"
        + ";".join(f"B{i}" for i in range(8))
    ]
    for number, frame in enumerate(frames, 1):
        flags = _flags(frame)
        if flags & (FD | ERROR):
            continue
        us = (frame[0] - T0_NS) // 1000
        data = [f"{byte:02x}" for byte in frame[5]] + [""] * (8 - len(frame[5]))
        cells = [f"{number}", f"{us // 1000},{us % 1000:03d}", f"can{frame[1]}", f"{frame[2]:X}"]
        cells += [f"{int(EXTENDED in flags)}", "ja" if REMOTE in flags else "nein"]
        lines.append(";".join([*cells, "Tx" if TX in flags else "Rx", f"{frame[4]}", *data]))
    return "\n".join([*lines, ""]).encode()


def gvret(frames: Sequence[Row]) -> bytes:
    """SavvyCAN's native form."""
    lines = ["Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"]
    for frame in frames:
        flags = _flags(frame)
        if flags & (FD | ERROR | REMOTE):
            continue
        data = "".join(f"{byte:02X}," for byte in frame[5])
        way, us = "Tx" if TX in flags else "Rx", (frame[0] - T0_NS) // 1000
        lines.append(
            f"{us},{frame[2]:08X},{'true' if EXTENDED in flags else 'false'},{way},{frame[1]},{frame[4]},{data}"
        )
    return "\n".join([*lines, ""]).encode()


def data_frames(frame: Row) -> Row | None:
    """Nothing but classic data frames."""
    return None if frame[3] & (FD | ERROR | REMOTE) else frame


def data_and_remote(frame: Row) -> Row | None:
    """Classic data and remote frames."""
    return None if frame[3] & (FD | ERROR) else frame


def socketcan(frame: Row, order: str = ">") -> bytes:
    """`struct can_frame` or `canfd_frame`, as it stands in a packet."""
    flags = _flags(frame)
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


def _block(order: str, kind: int, body: bytes) -> bytes:
    size = struct.pack(f"{order}I", len(body) + 12)
    return struct.pack(f"{order}I", kind) + size + body + size


def _option(order: str, code: int, value: bytes) -> bytes:
    return struct.pack(f"{order}HH", code, len(value)) + value + bytes(-len(value) % 4)


def pcapng(frames: Sequence[Row], order: str = "<") -> bytes:
    """Two interfaces of different resolution, comments before the direction, a name resolution block."""
    out = _block(order, 0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
    for number, resolution in ((0, 6), (1, 9)):
        options = _option(order, 2, b"can%d" % number) + _option(order, 9, bytes([resolution]))
        out += _block(order, 1, struct.pack(f"{order}HHI", 227, 0, 0) + options + bytes(4))
    out += _block(order, 4, bytes(8))
    for frame in frames:
        ticks = frame[0] // (1 if frame[1] else 1000)
        packet = socketcan(frame)
        head = struct.pack(
            f"{order}IIIII", frame[1], ticks >> 32, ticks & 0xFFFFFFFF, len(packet), len(packet)
        )
        options = _option(order, 1, b"hello") + _option(
            order, 2, struct.pack(f"{order}I", 2 if frame[3] & TX else 1)
        )
        out += _block(order, 6, head + packet + bytes(-len(packet) % 4) + options + bytes(4))
    return out


def pcapng_big(frames: Sequence[Row]) -> bytes:
    """A section of each byte order, one behind the other."""
    half = len(frames) // 2
    return pcapng(frames[:half], ">") + pcapng(frames[half:], "<")


def without_direction(frame: Row) -> Row | None:
    """Everything but who sent it."""
    return (*frame[:3], frame[3] & ~TX, *frame[4:])


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


def _header(frame: Row) -> bytes:
    name = b"can\0" if frame[2] % 2 else b"can_link\0"
    stamp = struct.pack("<iI", frame[0] // 10**9, frame[0] % 10**9)
    return stamp + struct.pack("<I", len(name)) + name + bytes(-len(name) % 4)


def ros2(frames: Sequence[Row]) -> bytes:
    """A bag of `can_msgs/msg/Frame`."""

    def payload(frame: Row) -> bytes:
        flags = _flags(frame)
        marks = (REMOTE in flags, EXTENDED in flags, ERROR in flags)
        fields = struct.pack("<I???B", frame[2], *marks, frame[4])
        return b"\0\1\0\0" + _header(frame) + fields + frame[5].ljust(8, b"\0")

    return _bag([f for f in frames if not f[3] & FD], "can_msgs/msg/Frame", payload)


def ros2_keeps(frame: Row) -> Row | None:
    """Neither CAN FD nor the direction."""
    return None if frame[3] & FD else without_direction(frame)


def ros2_fd(frames: Sequence[Row]) -> bytes:
    """A bag of `ros2_socketcan_msgs/msg/FdFrame`."""

    def payload(frame: Row) -> bytes:
        flags = _flags(frame)
        fields = struct.pack("<I??BB", frame[2], EXTENDED in flags, ERROR in flags, frame[4], 0)
        return b"\0\1\0\0" + _header(frame) + fields + struct.pack("<I", len(frame[5])) + frame[5]

    return _bag([f for f in frames if f[3] & FD], "ros2_socketcan_msgs/msg/FdFrame", payload)


def ros2_fd_keeps(frame: Row) -> Row | None:
    """CAN FD alone, without its switches and the direction."""
    return (*frame[:3], frame[3] & ~(TX | BRS | ESI), *frame[4:]) if frame[3] & FD else None


def ixxat(frames: Sequence[Row]) -> bytes:
    """MiniMon: one bus, hundredths of a second."""
    lines = [
        "ASCII Trace IXXAT MiniMon V3  Version: 3.1",
        "Date: 14.11.2023",
        "Start time: 22:13:20",
        "Stop time: 23:59:59",
        "Overruns: 0",
        "Baudrate: 250 kbit/s",
        '"Time";"Identifier (hex)";"Format";"Flags";"Data (hex)"',
    ]
    for frame in frames:
        flags, t_ns = _flags(frame), frame[0] - T0_NS
        if flags & (FD | ERROR) or frame[1]:
            continue
        hours, rest = divmod(t_ns // 10**7, 360_000)
        clock = f"{hours:02d}:{rest // 6000:02d}:{rest % 6000 // 100:02d}.{rest % 100:02d}"
        text = (
            f"Remote request   DLC = {frame[4]}"
            if REMOTE in flags
            else frame[5].hex(" ").upper() + " "
        )
        form = "Ext" if EXTENDED in flags else "Std"
        lines.append(f'"{clock}";"{frame[2]:X}";"{form}";"";"{text}"')
    return "\r\n".join([*lines, ""]).encode()


def ixxat_keeps(frame: Row) -> Row | None:
    """One bus; stamps of 10 ms, no direction."""
    if frame[3] & (FD | ERROR) or frame[1]:
        return None
    return (frame[0] - frame[0] % 10**7, 0, frame[2], frame[3] & ~TX, *frame[4:])


def python_can_blf(frames: Sequence[Row]) -> bytes:
    """BLF by python-can: its writer keeps all but the last 238 ns."""
    import can

    from tests.analyzer.log_builder import message

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


NUMBERED = ("1", "2")
LOG_FILES = (
    LogFile("candump", candump, everything, corrupt=b"(1700000001.0000) can0 12\n"),
    LogFile("candump", screen, everything, corrupt=b" (1700000001.000000)  can0  RX - -  123 \n"),
    LogFile("asc", asc, plain_errors, NUMBERED, corrupt=b"   1.000000 1  zzz  Rx   d 2 01 02\n"),
    LogFile("trc", trc, trc_keeps, NUMBERED, corrupt=b"      3   1.000 DT 1   zz\n"),
    LogFile("kvaser", kvaser, kvaser_keeps, ("0", "1"), b" 0    0000018  garbled\n", T0_NS),
    LogFile(
        "busmaster", busmaster, busmaster_keeps, NUMBERED, b"22:13:20:0000 Rx 1 0x181 s 8 0\xff\n"
    ),
    LogFile("csv", german_csv, data_and_remote, corrupt=b"5;0,2;can0;zz\n", origin_ns=T0_NS),
    LogFile("csv", gvret, data_frames, ("0", "1"), b"300,0000zz,false,Rx\n", T0_NS),
    LogFile("ixxat", ixxat, ixxat_keeps, NUMBERED, b'"00:00:02.00";"18\n'),
    LogFile("pcap", pcap, lambda frame: without_direction((frame[0], 0, *frame[2:]))),
    LogFile("pcap", pcap_big, lambda frame: without_direction((frame[0], 0, *frame[2:]))),
    LogFile("pcap", sll, lambda frame: (frame[0], 0, *frame[2:])),
    LogFile("pcap", sll2, everything, ("interface 3", "interface 4")),
    LogFile("pcapng", pcapng, everything),
    LogFile("pcapng", pcapng_big, everything),
    LogFile("ros2", ros2, ros2_keeps, ("/can0/from_can_bus", "/can1/from_can_bus")),
    LogFile("ros2", ros2_fd, ros2_fd_keeps, ("/can0/from_can_bus", "/can1/from_can_bus")),
    LogFile("blf", python_can_blf, everything, NUMBERED),
)
IDS = [log.encode.__name__ for log in LOG_FILES]
