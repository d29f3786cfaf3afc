"""CSV logs: SavvyCAN (GVRET), python-can, IXXAT, Kvaser, CANTest and home-made ones."""

import base64
import binascii
import re
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Final

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.csv_clock import Clock
from syncline_analyzer.readers.csv_columns import CsvColumns, is_number
from syncline_analyzer.readers.csv_guess import (
    data_are_decimal,
    ids_are_decimal,
    is_false,
    is_true,
    may_be_decimal,
)
from syncline_analyzer.readers.layout import FrameLayout, Span, regular_bytes
from syncline_analyzer.readers.lines import (
    MAX_PARSED_LINE,
    LineFormat,
    LostFrames,
    NoFrame,
    OddFrame,
    Parsed,
    bit_flags,
)
from syncline_analyzer.readers.times import FIRST_UTC_NS, SECOND_NS, Times, decimal_times
from syncline_schemas.batch import FrameFlag
from syncline_schemas.named_tuples import NamedTuple

_DAY_NS: Final = 24 * 3600 * SECOND_NS
_NUMBER = re.compile(rb"(?P<s>\d{1,19})(?:[.,](?P<f>\d+))?")
_LENGTH = re.compile(rb"(0[xX])?(\d{1,2})")
_TOKEN = re.compile(rb"(?:0[xX])?([0-9A-Fa-f]{1,3})[hH]?")
_NAME_OF_FLAG: Final = {
    "remote": re.compile(rb"remote|rtr|\xe8\xbf\x9c\xe7\xa8\x8b|\xd4\xb6\xb3\xcc", re.IGNORECASE),
    "extended": re.compile(rb"ext|xtd|29|\xe6\x89\xa9\xe5\xb1\x95|\xc0\xa9\xd5\xb9", re.IGNORECASE),
    "error": re.compile(rb"err|fehler", re.IGNORECASE),
    "fd": re.compile(rb"fd", re.IGNORECASE),
    "brs": re.compile(rb"brs|\xe5\x8a\xa0\xe9\x80\x9f|\xbc\xd3\xcb\xd9", re.IGNORECASE),
}
_SENT = re.compile(
    rb"t|tx|tx.*|transmit.*|sent|send|sending|out|1|true|\xe5\x8f\x91\xe9\x80\x81|\xb7\xa2\xcb\xcd",
    re.IGNORECASE,
)
_SEPARATOR_TOLD: Final = re.compile(rb"(?:\xef\xbb\xbf)?\s*\"?sep=.\"?\s*$", re.IGNORECASE)
"""First line of a table for Excel."""
_SELF: Final = re.compile(rb"\btx|\bself\b", re.IGNORECASE)
_KVASER_REMOTE, _KVASER_EXTENDED, _KVASER_ERROR, _KVASER_TX = 0x01, 0x04, 0x20, 0x40
_ASKED = re.compile(rb"(?:rtr|remote)\b\D*(?P<n>\d)?", re.IGNORECASE)
_SOCKETCAN_FLAGS: Final = (
    (0x80000000, FrameFlag.EXTENDED),
    (0x40000000, FrameFlag.REMOTE),
    (0x20000000, FrameFlag.ERROR),
)
_HEX_TIME = re.compile(rb"0[xX][0-9A-Fa-f]{1,12}")
_HEX_TICK_NS: Final = 100_000
"""CANTest and its like: the adapter's stamp, a number of 32 bits, counts 0.1 ms."""
_MOST_DIGITS = 19
"""A time of more digits is none."""
_SAMPLE = 500
_ASSUMED_FAST = 200
"""A median step above so many units of an unknown kind is no number of milliseconds."""


class Moment(NamedTuple):
    """The time of a line: fields of it, or its value where they cannot be read in columns."""

    times: Times = ()
    digits: tuple[Span, ...] = ()
    base_ns: int = 0
    value_ns: int | None = None
    known: bool = True


class CsvFormat(LineFormat):
    """A CSV log with known columns; what its header does not tell is guessed from its first lines."""

    def __init__(self, path: Path, columns: CsvColumns) -> None:
        super().__init__(CaptureFacts(path, "csv", time_base="none"))
        self._columns = columns
        self._at = {role: place for place, role in reversed(list(enumerate(columns.roles)))}
        self._kinds = [place for place, role in enumerate(columns.roles) if role == "kind"]
        self._bytes = [place for place, role in enumerate(columns.roles) if role == "byte"]
        self._unit_ns = SECOND_NS
        self._id_base = columns.id_base or 16
        self._data_base = columns.data_base or 16
        self._kvaser_flags = False
        self._hex_times = False
        self._clock = Clock()

    def prepare(self, head: bytes) -> None:
        """Find out from the first lines what the times and numbers are."""
        lines = [line for line in head.splitlines() if line.strip()][: _SAMPLE + 20]
        found = (self._row(line[:MAX_PARSED_LINE]) for line in lines)
        rows = [row for row in found if row is not None][:_SAMPLE]
        if "remote" not in self._at and "kind" not in self._at and "flags" not in self._at:
            self.facts.remote_lost = True
            self.facts.notes.append(
                "remote frames are not marked in this format; they appear as empty data frames"
            )
        if not {"way", "rx", "kind", "flags"} & set(self._at):
            self.facts.notes.append(
                "the log does not tell the direction of frames; all are taken as received"
            )
        if self._columns.header is None:
            said = ", ".join(role for role in self._columns.roles if role not in ("byte", "other"))
            more = " and one for each byte" if self._bytes else ""
            self.facts.notes.append(f"the columns have no names; they are taken as {said}{more}")
        self._guess_numbers(rows)
        self._choose_times(rows)
        times = [row[self._time_role] for row in rows] if self._time_role else []
        self._guess_times(times, [row.get("date", b"") for row in rows])

    @property
    def _time_role(self) -> str | None:
        return next((role for role in ("time", "delta") if role in self._at), None)

    def _choose_times(self, rows: Sequence[dict[str, bytes]]) -> None:
        """Where the adapter's stamps are missing, take the time at which the computer had the frame."""
        if "system" not in self._at:
            return
        if not any(re.search(rb"\d", row.get("time", b"")) for row in rows):
            self._at["time"] = self._at.pop("system")
            for row in rows:
                row["time"] = row["system"]

    def _row(self, line: bytes) -> dict[str, bytes] | None:
        """Cells by role, of a line that may be a frame."""
        cells = self._columns.cells(line)
        row = {
            role: line[slice(*cells[at])] if at < len(cells) else b""
            for role, at in self._at.items()
        }
        if not is_number(row["id"]):
            return None
        row["kind"] = b" ".join(line[slice(*cells[at])] for at in self._kinds if at < len(cells))
        row["bytes"] = b" ".join(line[slice(*cells[at])] for at in self._bytes if at < len(cells))
        return row

    def _guess_numbers(self, rows: Sequence[dict[str, bytes]]) -> None:
        ids = [row["id"] for row in rows]
        texts = [row.get("data", b"") + b" " + row["bytes"] for row in rows]
        if self._columns.id_base is None and (
            ids_are_decimal(ids) or (may_be_decimal(ids) and data_are_decimal(texts, sure=False))
        ):
            self._id_base = 10
            self.facts.notes.append("identifiers are taken as decimal numbers")
        sure = self._id_base == 10 and not any(cell[:2] in (b"0x", b"0X") for cell in ids)
        if self._columns.data_base is None and data_are_decimal(texts, sure=sure):
            self._data_base = 10
            self.facts.notes.append("data bytes are taken as decimal numbers")
        flags = [row.get("flags", b"") for row in rows]
        self._kvaser_flags = any(flags) and all(re.fullmatch(rb"\d{0,6}", each) for each in flags)

    def _guess_times(self, cells: Sequence[bytes], dates: Sequence[bytes]) -> None:
        """What the times are: of the clock, from the start, or from line to line, and in which unit."""
        filled = [cell for cell in cells if cell]
        if not filled:
            self.facts.notes.append("the log has no times")
            return
        self.facts.time_base = "relative"
        self.differences = self._time_role == "delta"
        if all(map(_HEX_TIME.fullmatch, filled)):
            self._unit_ns, self._hex_times = _HEX_TICK_NS, True
            self.wraps_ns = 0 if self.differences else _HEX_TICK_NS << 32
            self.facts.notes.append("hexadecimal times are taken as counts of 0.1 ms")
            return
        clock = Clock.of(filled, dates)
        if clock is not None:
            self._clock = clock
            self.wraps_ns = 0 if clock.dated or self.differences else _DAY_NS
            if clock.dated and self._unset(cells, dates):
                self.facts.notes.append(
                    "the log's dates are before 2000, of a clock that was not set: there is no date"
                )
                return
            if clock.dated:
                self.facts.time_base = "utc"
            if clock.dated and not clock.zoned:
                self.facts.notes.append("the log's dates name no time zone; they are taken as UTC")
            return
        self._guess_unit(filled)
        first = _NUMBER.fullmatch(filled[0])
        if first and not self.differences and int(first["s"]) * self._unit_ns >= FIRST_UTC_NS:
            self.facts.time_base = "utc"
        if self.differences:
            self.facts.notes.append("times are differences; their sum is used")

    def _unset(self, cells: Sequence[bytes], dates: Sequence[bytes]) -> bool:
        """Whether the first date is one that no log can have."""
        for cell, date in zip(cells, dates, strict=True):
            line = cell + b"|" + date
            found = self._clock.read(line, (0, len(cell)), (len(cell) + 1, len(line)))
            if found is not None:
                return found.base_ns < FIRST_UTC_NS - _DAY_NS
        return False

    def _guess_unit(self, cells: Sequence[bytes]) -> None:
        fractions = any(b"." in cell or b"," in cell or b"e" in cell.lower() for cell in cells)
        if self._columns.unit_ns == -1:
            # GVRET counts microseconds; tools that imitate it write seconds with a fraction.
            self._unit_ns = SECOND_NS if fractions else 1000
            return
        if self._columns.unit_ns is not None:
            self._unit_ns = self._columns.unit_ns
            return
        values = [int(cell) for cell in cells if cell.isdigit() and len(cell) <= _MOST_DIGITS]
        if fractions or not values:
            if max(_whole(cells), default=0) * SECOND_NS < FIRST_UTC_NS:
                self.facts.notes.append(
                    "the log does not tell the unit of its times; seconds are assumed"
                )
            return
        largest = max(values)
        for least, unit_ns in (
            (10**17, 1),
            (10**14, 1000),
            (10**11, 10**6),
            (FIRST_UTC_NS // SECOND_NS, SECOND_NS),
        ):
            if largest >= least and not self.differences:
                self._unit_ns = unit_ns
                return
        steps = [b - a for a, b in pairwise(values) if b > a]
        steps = values if self.differences else steps
        fast = bool(steps) and median(steps) >= _ASSUMED_FAST
        self._unit_ns = 1000 if fast else 10**6
        name = "microseconds" if fast else "milliseconds"
        self.facts.notes.append(f"the log does not tell the unit of its times; {name} are assumed")

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame or the header."""
        row = self._row(line)
        if row is None:
            stripped = line.strip().lstrip(b"# ")
            plain = stripped == self._columns.header or line.lstrip()[:1] in b"#;"
            return NoFrame() if plain or _SEPARATOR_TOLD.match(line) else None
        cells = self._columns.cells(line)
        bus = self.bus(row.get("bus") or b"1")
        time = self._time(line, cells)
        flags = self._flags(row)
        lost = _lost(row.get("lost", b""))
        if asked := _ASKED.match(row.get("data", b"")):
            flags |= FrameFlag.REMOTE
            row["length"] = row.get("length") or asked["n"] or b"0"
        if bus is None or not time.known:
            return None
        identified = self._identifier(row["id"], flags, self._stated(row))
        if identified is None:
            return None
        told = flags | (FrameFlag.EXTENDED if row["id"][-1:] in (b"x", b"X") else 0)
        can_id, flags, regular_id = identified
        sized = bool(flags & ~told & FrameFlag.EXTENDED)
        data, start, step = self._data(line, cells, row, flags)
        if data is None or len(data) > 64:
            return None
        flags, dlc, count = _lengths(flags, len(data), self._stated(row), padded=bool(self._bytes))
        data = data[:count]
        odd = time.value_ns is not None or not regular_id or bool(count and not step)
        if odd or lost is not None:
            t_ns = time.value_ns
            if t_ns is None:
                t_ns = time.base_ns + sum(int(line[a:b]) * worth for (a, b), worth in time.times)
            timed = time.value_ns is not None or bool(time.times)
            return OddFrame((t_ns, bus, can_id, flags, dlc, data), timed=timed, lost=lost)
        at = cells[self._at["id"]]
        prefix = 2 if row["id"][:2] in (b"0x", b"0X") else 0
        suffix = row["id"][-1:] in (b"h", b"H", b"x", b"X")
        return FrameLayout(
            bus=bus,
            flags=flags,
            dlc=dlc,
            id_span=(at[0] + prefix, at[1] - suffix),
            id_base=16 if prefix else self._id_base,
            # Where only the size of a number makes it extended, that of its neighbours counts too.
            id_least=0x800 if sized else 0,
            id_limit=0x1FFFFFFF if flags & (FrameFlag.EXTENDED | FrameFlag.ERROR) else 0x7FF,
            times=time.times,
            t_base_ns=time.base_ns,
            data_start=start,
            data_step=step or 2,
            data_count=count,
            digits=time.digits + self._idle_digits(line, cells),
        )

    def _stated(self, row: dict[str, bytes]) -> int | None:
        found = _LENGTH.fullmatch(row.get("length", b""))
        return int(found[2], 16 if found[1] else 10) if found else None

    def _identifier(
        self, cell: bytes, flags: int, stated: int | None
    ) -> tuple[int, int, bool] | None:
        """Identifier, flags with what it tells, and whether a layout can read it."""
        prefixed = cell[:2] in (b"0x", b"0X")
        marked = cell[-1:] in (b"x", b"X") and not prefixed
        digits = (cell[2:] if prefixed else cell).rstrip(b"xXhH")
        try:
            can_id = int(digits, 16 if prefixed else self._id_base)
        except ValueError:
            return None
        regular = len(digits) <= 8
        if 0x1FFFFFFF < can_id <= 0xFFFFFFFF:
            # Flags of SocketCAN in the upper bits.
            for bit, flag in _SOCKETCAN_FLAGS:
                flags |= flag if can_id & bit else 0
            can_id, regular = can_id & 0x1FFFFFFF, False
        if marked or ("extended" not in self._at and can_id > 0x7FF):
            flags |= FrameFlag.EXTENDED
        if flags & FrameFlag.ERROR:
            flags &= ~FrameFlag.EXTENDED
        wide = flags & (FrameFlag.EXTENDED | FrameFlag.ERROR)
        if can_id > (0x1FFFFFFF if wide else 0x7FF):
            return None
        return can_id, flags, regular

    def _flags(self, row: dict[str, bytes]) -> int:
        given = {
            role: is_true(row.get(role)) for role in ("extended", "remote", "error", "fd", "brs")
        }
        kind = row.get("kind", b"")
        if not self._kvaser_flags:
            kind += b" " + row.get("flags", b"")
        for role, pattern in _NAME_OF_FLAG.items():
            given[role] = given[role] or pattern.search(kind) is not None
        tx = (
            _SENT.fullmatch(row.get("way", b"")) is not None
            or is_false(row.get("rx"))
            or _SELF.search(kind) is not None
        )
        if self._kvaser_flags and row.get("flags"):
            bits = int(row["flags"])
            given["remote"] |= bool(bits & _KVASER_REMOTE)
            given["extended"] |= bool(bits & _KVASER_EXTENDED)
            given["error"] |= bool(bits & _KVASER_ERROR)
            tx = tx or bool(bits & _KVASER_TX)
        flags = bit_flags(
            extended=given["extended"],
            tx=tx,
            fd=given["fd"],
            brs=given["fd"] and given["brs"],
            esi=given["fd"] and is_true(row.get("esi")),
        )
        flags |= FrameFlag.REMOTE if given["remote"] else 0
        return int(flags | (FrameFlag.ERROR if given["error"] else 0))

    def _data(
        self, line: bytes, cells: Sequence[Span], row: dict[str, bytes], flags: int
    ) -> tuple[bytes | None, int, int]:
        """The data bytes; where they begin and their step, 0 where a layout cannot read them."""
        if flags & FrameFlag.REMOTE:
            return b"", 0, 0
        if "base64" in self._at:
            try:
                return base64.b64decode(row["base64"], validate=True), 0, 0
            except (binascii.Error, ValueError):
                return None, 0, 0
        if self._bytes:
            filled = [cells[at] for at in self._bytes if at < len(cells)]
            filled = [span for span in filled if span[1] > span[0]]
            if not filled:
                return b"", 0, 0
            begin, end = filled[0][0], filled[-1][1]
            texts = [line[a:b] for a, b in filled]
        else:
            begin, end = cells[self._at["data"]] if self._at["data"] < len(cells) else (0, 0)
            if line[begin : begin + 2] == b"x|":
                begin += 2
            texts = _tokens(line[begin:end], self._data_base)
        data = _data_bytes(texts, self._data_base)
        if data is None or self._data_base != 16:
            return data, 0, 0
        start, step = regular_bytes(
            line[begin:end].replace(b"0x", b"  ").replace(b"0X", b"  "), len(data)
        )
        return data, begin + start, step

    def _time(self, line: bytes, cells: Sequence[Span]) -> Moment:
        role = self._time_role
        if role is None or self.facts.time_base == "none":
            return Moment()
        at = self._at[role]
        start, end = cells[at] if at < len(cells) else (0, 0)
        cell = line[start:end]
        if self._hex_times:
            if not _HEX_TIME.fullmatch(cell):
                return Moment(known=False) if cell else Moment()
            return Moment(value_ns=int(cell, 16) * self._unit_ns)
        if found := _NUMBER.fullmatch(line, start, end):
            times, digits = decimal_times(found.span("s"), found.span("f"), self._unit_ns)
            return Moment(times, digits)
        date = self._at.get("date", len(cells))
        clock = self._clock.read(line, (start, end), cells[date] if date < len(cells) else None)
        if clock is not None:
            return Moment(clock.times, clock.digits, clock.base_ns)
        if not cell:
            return Moment()
        try:
            value = Decimal(cell.replace(b",", b".").decode("ascii", "replace"))
            t_ns = round(value * self._unit_ns) if value.is_finite() and 0 <= value < 10**19 else -1
        except (InvalidOperation, ValueError):
            t_ns = -1
        return Moment(value_ns=t_ns) if t_ns >= 0 else Moment(known=False)

    def _idle_digits(self, line: bytes, cells: Sequence[Span]) -> tuple[Span, ...]:
        """Digits in columns that mean nothing, such as counters."""
        idle = [
            cell
            for cell, role in zip(cells, self._columns.roles, strict=False)
            if role == "other" or (role == "delta" and self._time_role != "delta")
        ]
        if self.facts.time_base == "none":
            idle += [
                cells[self._at[role]]
                for role in ("time", "delta")
                if role in self._at and self._at[role] < len(cells)
            ]
        return tuple(
            run.span()
            for start, end in idle
            for run in re.finditer(rb"\d+", line[:end])
            if run.start() >= start
        )


def _lost(cell: bytes) -> LostFrames | None:
    """The frames that a column says were lost before this one."""
    count = int(cell) if cell.isdigit() and len(cell) <= 9 else 0
    return LostFrames("frames lost by the logger", count) if count else None


def _lengths(flags: int, there: int, stated: int | None, *, padded: bool) -> tuple[int, int, int]:
    """Flags, length, and number of data bytes kept; columns of bytes may be `padded` behind them."""
    if flags & FrameFlag.REMOTE:
        return flags, min(stated or 0, 8), 0
    if flags & FrameFlag.ERROR:
        return flags, min(there, 8) or 8, min(there, 8)
    count = there
    if stated is not None and there != stated:
        code = stated > 8 and there > 8
        if not code:
            invalid = there < stated or not padded
            flags, count = flags | (FrameFlag.DLC_INVALID if invalid else 0), min(there, stated)
    if count > 8:
        flags |= FrameFlag.FD
    return int(flags), count, count


def _tokens(cell: bytes, data_base: int) -> list[bytes]:
    """The bytes in a cell: apart, or two digits each without anything between."""
    cell = cell.strip(b"[](){}")
    tokens = re.split(rb"[\s,;:_-]+", cell.strip())
    if len(tokens) == 1 and data_base == 16:
        whole = tokens[0][2:] if tokens[0][:2] in (b"0x", b"0X") else tokens[0]
        if len(whole) > 2 and len(whole) % 2 == 0:
            return [whole[i : i + 2] for i in range(0, len(whole), 2)]
    return [token for token in tokens if token]


def _data_bytes(texts: Sequence[bytes], base: int) -> bytes | None:
    values = []
    for text in texts:
        found = _TOKEN.fullmatch(text)
        if found is None:
            return None
        try:
            value = int(found[1], 16 if text[:2] in (b"0x", b"0X") else base)
        except ValueError:
            return None
        if value > 255:
            return None
        values.append(value)
    return bytes(values)


def _whole(cells: Sequence[bytes]) -> list[int]:
    """The whole parts of times."""
    return [int(found["s"]) for cell in cells if (found := _NUMBER.fullmatch(cell))]
