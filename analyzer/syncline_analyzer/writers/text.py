"""Text logs: candump, Vector ASC, PEAK TRC 2.1 and CSV."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from decimal import Decimal
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.writers.compose import (
    Chars,
    Piece,
    compose,
    data_digits,
    decimal,
    has,
    hexadecimal,
    payload_length,
)
from syncline_analyzer.writers.formats import ERROR_CONTENTS
from syncline_analyzer.writers.log import LogWriter, Survey
from syncline_schemas.batch import FrameBatch, FrameFlag

_SECOND_NS: Final = 10**9
_ERROR_BIT: Final = 0x20000000
_FD_CODES: Final = {12: 9, 16: 10, 20: 11, 24: 12, 32: 13, 48: 14, 64: 15}
# strftime would name them in the language of the machine.
_DAYS: Final = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
_MONTHS: Final = tuple("JanFebMarAprMayJunJulAugSepOctNovDec"[i : i + 3] for i in range(0, 36, 3))
_IN_NO_WORD: Final = re.compile(r"[\s\x00-\x1f\x7f]")
_IN_NO_CELL: Final = re.compile(r"[,;\"\x00-\x1f\x7f\x85\u2028\u2029]|^[\s=+@'-]+")
"""A cell that begins with `=`, `+`, `-` or `@` would be a formula to a spreadsheet."""
_FRAMES_AT_ONCE: Final = 65_536


class TextWriter(LogWriter):
    """A log of one line per frame."""

    def write(self, batch: FrameBatch) -> None:
        """Write frames."""
        self._count_lost(batch)
        for start in range(0, len(batch), _FRAMES_AT_ONCE):
            self._stream.write(compose(batch[start : start + _FRAMES_AT_ONCE], self._pieces))

    def _count_lost(self, batch: FrameBatch) -> None:
        self._count_marks(batch)

    def _pieces(self, batch: FrameBatch) -> Sequence[Piece]:
        raise NotImplementedError

    def _times(
        self, t_ns: NDArray[np.int64], whole: int, unit_ns: int = _SECOND_NS
    ) -> Sequence[Piece]:
        """A decimal number of units, its fraction down to 1 us, or 1 ns where the log is finer."""
        step_ns = 1000 if self._survey.whole_us else 1
        places = len(str(unit_ns // step_ns)) - 1
        units, rest = np.divmod(t_ns, unit_ns)
        width = max(whole, len(str(int(units.max()))))
        pad = b"0" if whole == 10 else b" "
        return decimal(units, width, pad=pad), b".", decimal(rest // step_ns, places)


class CandumpWriter(TextWriter):
    """`candump -L`; a frame sent by the recorder ends with ` T`, as `candump -L -x` has it."""

    def __init__(self, stream: BinaryIO, survey: Survey) -> None:
        super().__init__(stream, survey)
        self._names = self._plain_names(_IN_NO_WORD)

    def _pieces(self, batch: FrameBatch) -> Sequence[Piece]:
        name = self._names[int(batch.bus[0])]
        tail = b" T\n" if has(batch, FrameFlag.TX) else b"\n"
        head = (b"(", *self._times(batch.t_ns, 10), b") " + name + b" ", _candump_id(batch))
        if has(batch, FrameFlag.REMOTE):
            return *head, b"#R%X" % batch.dlc[0], tail
        mark = b"#"
        if has(batch, FrameFlag.FD):
            mark = b"##%X" % (has(batch, FrameFlag.BRS) + 2 * has(batch, FrameFlag.ESI))
        return *head, mark, data_digits(batch.data, payload_length(batch)), tail


def _candump_id(batch: FrameBatch) -> Chars:
    if has(batch, FrameFlag.ERROR):
        return hexadecimal(batch.can_id | np.uint32(_ERROR_BIT), 8)
    return hexadecimal(batch.can_id, 8 if has(batch, FrameFlag.EXTENDED) else 3)


class AscWriter(TextWriter):
    """Vector ASC, hexadecimal, times from the earliest stamp's millisecond on."""

    def __init__(self, stream: BinaryIO, survey: Survey) -> None:
        super().__init__(stream, survey)
        self._count_bus_names()
        self._origin_ns = survey.origin_ns - survey.origin_ns % 10**6
        date = _asc_date(self._origin_ns)
        dated = survey.time_base == "utc"
        lines = ["base hex  timestamps absolute", "internal events logged"]
        if dated:
            lines = [f"date {date}", *lines, f"Begin Triggerblock {date}"]
        stream.write("\n".join([*lines, " 0.000000 Start of measurement", ""]).encode())

    def _count_lost(self, batch: FrameBatch) -> None:
        self._count_marks(batch)
        self._count_flag(batch, FrameFlag.ERROR, ERROR_CONTENTS)

    def _pieces(self, batch: FrameBatch) -> Sequence[Piece]:
        bus = b" %d  " % (int(batch.bus[0]) + 1)
        times = (b" ", *self._times(batch.t_ns - self._origin_ns, 1))
        if has(batch, FrameFlag.ERROR):
            return *times, bus + b"ErrorFrame\n"
        extended = has(batch, FrameFlag.EXTENDED)
        can_id = hexadecimal(batch.can_id, 8 if extended else 3)
        mark = b"x" if extended else b""
        way = b"Tx" if has(batch, FrameFlag.TX) else b"Rx"
        if has(batch, FrameFlag.FD):
            return *times, *self._fd_pieces(batch, bus.strip(), can_id, mark, way)
        count = payload_length(batch)
        kind = b"r" if has(batch, FrameFlag.REMOTE) else b"d"
        head = mark.ljust(13) + way + b"   " + kind + b" %X" % batch.dlc[0]
        return *times, bus, can_id, head, data_digits(batch.data, count, before=b" "), b"\n"

    def _fd_pieces(
        self, batch: FrameBatch, bus: bytes, can_id: Chars, mark: bytes, way: bytes
    ) -> Sequence[Piece]:
        count = payload_length(batch)
        brs, esi = has(batch, FrameFlag.BRS), has(batch, FrameFlag.ESI)
        state = b" %d %d %x %d" % (brs, esi, _fd_code(count), count)
        flags = 1 << 12 | brs << 13 | esi << 14
        tail = b"        0    0 %8X        0        0        0        0        0\n" % flags
        head = b" CANFD " + bus.rjust(3) + b" " + way + b" "
        return head, can_id, mark, state, data_digits(batch.data, count, before=b" "), tail

    def close(self) -> None:
        """Write the end of the trigger block."""
        if self._survey.time_base == "utc":
            self._stream.write(b"End TriggerBlock\n")


class TrcWriter(TextWriter):
    """PEAK TRC 2.1, times from the earliest stamp on."""

    def __init__(self, stream: BinaryIO, survey: Survey) -> None:
        super().__init__(stream, survey)
        self._count_bus_names()
        self._number = 0
        lines = [";$FILEVERSION=2.1"]
        if survey.time_base == "utc":
            days = Decimal(survey.origin_ns) / (86400 * _SECOND_NS) + 25569
            lines.append(f";$STARTTIME={days:.16f}")
        lines += [";$COLUMNS=N,O,T,B,I,d,R,L,D", ";", ";   Message   Time    Type    ID     Rx/Tx"]
        lines += [";   Number    Offset  |  Bus  [hex]  |  Reserved"]
        lines += [";   |         [ms]    |  |    |      |  |  Data Length Code"]
        lines += [";   |         |       |  |    |      |  |  |    Data [hex] ..."]
        lines += [";---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --", ""]
        stream.write("\r\n".join(lines).encode())

    def _count_lost(self, batch: FrameBatch) -> None:
        self._count_marks(batch)
        self._count_flag(batch, FrameFlag.ERROR, ERROR_CONTENTS)

    def write(self, batch: FrameBatch) -> None:
        """Write frames, numbered from 1."""
        self._count_lost(batch)
        for start in range(0, len(batch), _FRAMES_AT_ONCE):
            part = batch[start : start + _FRAMES_AT_ONCE]
            # The number of a line has to travel with its frame: it is put in after composing.
            lines = compose(part, self._pieces)
            numbers = np.arange(self._number + 1, self._number + len(part) + 1)
            self._number += len(part)
            self._stream.write(_numbered(lines, decimal(numbers, 10, pad=b" ")))

    def _pieces(self, batch: FrameBatch) -> Sequence[Piece]:
        offset = self._times(batch.t_ns - self._survey.origin_ns, 9, 10**6)
        bus = b" %2d " % (int(batch.bus[0]) + 1)
        way = b" Tx -  " if has(batch, FrameFlag.TX) else b" Rx -  "
        if has(batch, FrameFlag.ERROR):
            return b"." * 10 + b" ", *offset, b" ER" + bus + b"       -" + way + b"0   \r\n"
        can_id = hexadecimal(batch.can_id, 8 if has(batch, FrameFlag.EXTENDED) else 4)
        count = payload_length(batch)
        length = b"%-4d" % (_fd_code(count) if has(batch, FrameFlag.FD) else batch.dlc[0])
        head = b" " + _trc_type(batch) + bus + b" " * (8 - can_id.shape[1])
        data = data_digits(batch.data, count, before=b" ")
        return b"." * 10 + b" ", *offset, head, can_id, way + length, data, b"\r\n"


def _numbered(lines: bytes, numbers: Chars) -> bytes:
    raw = np.frombuffer(bytearray(lines), np.uint8)
    ends = np.flatnonzero(raw == 10)
    starts = np.concatenate((np.zeros(1, np.intp), ends[:-1] + 1))
    view = np.ndarray((len(raw) - 9,), "V10", raw, 0, (1,))
    view[starts] = np.ascontiguousarray(numbers).view("V10").reshape(-1)
    return raw.tobytes()


class CsvWriter(TextWriter):
    """CSV with a header; seconds, hexadecimal identifier and data."""

    def __init__(self, stream: BinaryIO, survey: Survey) -> None:
        super().__init__(stream, survey)
        self._names = self._plain_names(_IN_NO_CELL)
        stream.write(b"timestamp,bus,id,extended,remote,error,fd,brs,esi,dir,dlc,data\n")

    def _pieces(self, batch: FrameBatch) -> Sequence[Piece]:
        extended, error = has(batch, FrameFlag.EXTENDED), has(batch, FrameFlag.ERROR)
        name = self._names[int(batch.bus[0])]
        state = b",%d,%d,%d,%d,%d,%d,%s,%d," % (
            extended,
            has(batch, FrameFlag.REMOTE),
            error,
            has(batch, FrameFlag.FD),
            has(batch, FrameFlag.BRS),
            has(batch, FrameFlag.ESI),
            b"Tx" if has(batch, FrameFlag.TX) else b"Rx",
            batch.dlc[0],
        )
        can_id = hexadecimal(batch.can_id, 8 if extended or error else 3)
        data = data_digits(batch.data, payload_length(batch))
        return *self._times(batch.t_ns, 1), b"," + name + b",0x", can_id, state, data, b"\n"


def _trc_type(batch: FrameBatch) -> bytes:
    if has(batch, FrameFlag.REMOTE):
        return b"RR"
    if not has(batch, FrameFlag.FD):
        return b"DT"
    brs, esi = has(batch, FrameFlag.BRS), has(batch, FrameFlag.ESI)
    return {(False, False): b"FD", (True, False): b"FB", (False, True): b"FE"}.get(
        (brs, esi), b"BI"
    )


def _fd_code(length: int) -> int:
    return length if length <= 8 else _FD_CODES.get(length, 15)


def _asc_date(t_ns: int) -> str:
    seconds, rest = divmod(t_ns, _SECOND_NS)
    moment = datetime.fromtimestamp(seconds, UTC)
    day, month = _DAYS[moment.weekday()], _MONTHS[moment.month - 1]
    return f"{day} {month} {moment.day:02d} {moment:%H:%M:%S}.{rest // 10**6:03d} {moment.year}"
