"""Text logs made by hand from frames: none of Syncline's writers helps."""

from collections.abc import Sequence
from datetime import UTC, datetime
from decimal import Decimal

from tests.analyzer.log_builder import FD_LENGTHS, T0_NS, Row
from tests.analyzer.log_frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    REMOTE,
    TX,
    flags_of,
    plain_errors,
)


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
        flags, data = flags_of(frame), frame[5].hex().upper()
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
        flags = flags_of(frame)
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
        flags, t = flags_of(frame), _seconds(frame[0] - T0_NS)
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
        flags, ms = flags_of(frame), (frame[0] - T0_NS) // 1000
        kind = "DT"
        if REMOTE in flags:
            kind = "RR"
        elif FD in flags:
            kind = ("FD", "FB", "FE", "BI")[(BRS in flags) + 2 * (ESI in flags)]
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
        flags, t = flags_of(frame), _seconds(frame[0] - T0_NS)
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


def memorator(frames: Sequence[Row]) -> bytes:
    """Kvaser's plain text of a Memorator log, hexadecimal, with room for 64 bytes."""
    lines = [
        "                              Kvaser Memorator Log",
        "                              ====================",
        "",
        "Memorator Binary logfile created at: 2023-11-14 22:13:20",
        "",
        "Settings:",
        "   Format of data field: HEX",
        "   Format of id field:   HEX",
        "   Timestamp Offset:     0.000000           s",
        "   CAN channel:          1 2",
        "",
        "        Time Chan   Identifier Flags        DLC  Data                Counter",
        "=" * 80,
        "    0.000000  Trigger (type=0x1, active=0x00, pre-trigger=0, post-trigger=-1)",
    ]
    for number, frame in enumerate(frames, 1):
        flags = flags_of(frame)
        error, fd, remote = ERROR in flags, FD in flags, REMOTE in flags
        name = "ErrorFrame" if error else f"{frame[2]:10X}"
        marks = "".join(
            mark if given else " "
            for mark, given in zip(
                "EFBPRW#",
                (error, fd, BRS in flags, ESI in flags, remote, False, False),
                strict=True,
            )
        )
        code = FD_LENGTHS.index(frame[4]) if fd else frame[4]
        data = "".join(f"{byte:02X} " for byte in frame[5])
        text = "ERROR FRAME" if error else "RTR" if remote else data
        lines.append(
            f"{_seconds(frame[0] - T0_NS):>12}  {frame[1] + 1}  {name}{'x' if EXTENDED in flags else ' '}   "
            f"{'Tx' if TX in flags else 'Rx'}   {marks}{'     ' if error else f'{code:3}  '}{text:<192} {number:12}"
        )
    return "\r\n".join([*lines, ""]).encode()


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
        flags = flags_of(frame)
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
        flags = flags_of(frame)
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
        flags = flags_of(frame)
        if flags & (FD | ERROR | REMOTE):
            continue
        data = "".join(f"{byte:02X}," for byte in frame[5])
        way, us = "Tx" if TX in flags else "Rx", (frame[0] - T0_NS) // 1000
        lines.append(
            f"{us},{frame[2]:08X},{'true' if EXTENDED in flags else 'false'},{way},{frame[1]},{frame[4]},{data}"
        )
    return "\n".join([*lines, ""]).encode()


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
        flags, t_ns = flags_of(frame), frame[0] - T0_NS
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


def canhacker(frames: Sequence[Row]) -> bytes:
    """CANHacker: milliseconds from the start, no buses."""
    lines = ["Time   ID     DLC Data                    Comment"]
    for frame in frames:
        flags, ms = flags_of(frame), (frame[0] - T0_NS) // 10**6
        if flags & (FD | ERROR):
            continue
        name = f"{frame[2]:08X}" if EXTENDED in flags else f"{frame[2]:03X}     "
        data = "RTR" if REMOTE in flags else frame[5].hex(" ").upper()
        lines.append(f"{ms // 1000:02d}.{ms % 1000:03d} {name} {frame[4]} {data} ")
    return "\r\n".join([*lines, ""]).encode()


def canhacker_keeps(frame: Row) -> Row | None:
    """One bus; stamps of 1 ms, no direction."""
    if frame[3] & (FD | ERROR):
        return None
    t_ns = T0_NS + (frame[0] - T0_NS) // 10**6 * 10**6
    return (t_ns, 0, frame[2], frame[3] & ~TX, *frame[4:])


CLX_HEAD = (
    '# Logger type: CL2000\n# HW rev: 6.xx\n# Time: {}\n# Value separator: ";"\n# Time format: {}\n'
    '# Time separator: "{}"\n# Time separator ms: "{}"\n# Date separator: "{}"\n'
    '# Time and date separator: "{}"\n# Bit-rate: 250000\n# Silent mode: false\n'
)


def clx(frames: Sequence[Row]) -> bytes:
    """A CL2000's log with whole dates."""
    lines = [
        CLX_HEAD.format("20231114T221320", 6, ":", ".", "/", " ") + "Timestamp;Type;ID;Length;Data"
    ]
    for frame in frames:
        flags = flags_of(frame)
        if flags & (FD | ERROR | REMOTE):
            continue
        moment = datetime.fromtimestamp(frame[0] // 10**9, UTC)
        ms = frame[0] % 10**9 // 10**6
        kind = (EXTENDED in flags) + 8 * (TX in flags)
        lines.append(
            f"{moment:%Y/%m/%d %H:%M:%S}.{ms:03d};{kind};{frame[2]:x};{frame[4]};{frame[5].hex()}"
        )
    return "\n".join([*lines, ""]).encode()


def clx_keeps(frame: Row) -> Row | None:
    """Data frames of one bus; stamps of 1 ms."""
    if frame[3] & (FD | ERROR | REMOTE):
        return None
    return (frame[0] - frame[0] % 10**6, 0, *frame[2:])


def cantest(frames: Sequence[Row]) -> bytes:
    """ZLG's CANTest: Chinese, hexadecimal stamps of 0.1 ms, times of the computer for Excel."""
    lines = ["序号,系统时间,时间标识,CAN通道,传输方向,ID号,帧类型,帧格式,长度,数据"]
    for number, frame in enumerate(frames):
        flags = flags_of(frame)
        if flags & (FD | ERROR):
            continue
        ticks = (frame[0] - T0_NS) // 100_000
        way, form = "发送" if TX in flags else "接收", "扩展帧" if EXTENDED in flags else "标准帧"
        kind = "远程帧" if REMOTE in flags else "数据帧"
        data = "x| " + "".join(f"{byte:02X} " for byte in frame[5])
        lines.append(
            f'{number:05d},="12:04:59.533",0x{ticks:X},ch{frame[1] + 1},{way},0x{frame[2]:08X},'
            f"{kind},{form},0x{frame[4]:02X},{data}"
        )
    return "\r\n".join([*lines, ""]).encode("gb18030")


def cantest_keeps(frame: Row) -> Row | None:
    """Neither CAN FD nor error frames; stamps of 0.1 ms."""
    if frame[3] & (FD | ERROR):
        return None
    return (T0_NS + (frame[0] - T0_NS) // 100_000 * 100_000, *frame[1:])


def bare(frames: Sequence[Row]) -> bytes:
    """Nothing but time, identifier and data."""
    lines = []
    for frame in frames:
        flags, us = flags_of(frame), (frame[0] - T0_NS) // 1000
        if flags & (FD | ERROR | REMOTE) or not frame[5]:
            continue
        name = f"{frame[2]:08X}" if EXTENDED in flags else f"{frame[2]:03X}"
        lines.append(f"{us // 10**6}.{us % 10**6:06d},0x{name},{frame[5].hex().upper()}")
    return "\n".join([*lines, ""]).encode()


def bare_keeps(frame: Row) -> Row | None:
    """Data frames with data, of one bus; identifiers above 7FFh are extended."""
    if frame[3] & (FD | ERROR | REMOTE) or not frame[5]:
        return None
    return (frame[0], 0, frame[2], int(EXTENDED) if frame[2] > 0x7FF else 0, *frame[4:])
