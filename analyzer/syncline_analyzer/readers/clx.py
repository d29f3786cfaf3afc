"""Logs of the CSS Electronics CL1000, CL2000 and CL3000: a head that tells how, then a table.

Source: CSS Electronics, "CLX000 docs", "Log file": a stamp is the lower part of `YYYYMMDDThhmmsskkk`
(k: ms), with separators that the head names; types 0 and 1 are received standard and extended frames,
8 and 9 transmitted ones; `Lost` counts the frames lost before this one.
"""

import re
from calendar import monthrange
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from syncline_analyzer.readers.csv_columns import CsvColumns
from syncline_analyzer.readers.csv_log import CsvFormat, Moment
from syncline_analyzer.readers.layout import Span
from syncline_analyzer.readers.lines import bit_flags
from syncline_analyzer.readers.times import MILLISECOND_NS, SECOND_NS, utc_ns

_LOGGER: Final = re.compile(rb"#\s*Logger type:", re.IGNORECASE)
_FIELD: Final = re.compile(rb"^#[ \t]*([^:\r\n]+):[ \t]*([^\r\n]*)", re.MULTILINE)
_DAY_NS: Final = 86_400 * SECOND_NS
_PARTS: Final = ((4, 0), (2, 0), (2, _DAY_NS), (2, 3600 * SECOND_NS), (2, 60 * SECOND_NS))
_PARTS_MS: Final = (*_PARTS, (2, SECOND_NS), (3, MILLISECOND_NS))
"""Digits of year, month, day, hour, minute, second and ms, and what one is worth."""
_DIGITS: Final = {17: 0, 13: 1, 11: 2, 9: 3, 7: 4, 5: 5, 3: 6}
"""By the number of digits of a stamp: its first part."""
_EPOCH: Final = re.compile(rb"1[3-9]\d{8}[.,]?\d{3}")
"""Seconds since 1970 with ms: no month is the 13th."""
_SET_NS: Final = 978_307_200 * SECOND_NS
"""2001-01-01: a CL1000 has no clock and begins in 2000."""
_TYPES: Final = {b"0": (False, False), b"1": (True, False), b"8": (False, True), b"9": (True, True)}
"""By type: whether extended, whether transmitted."""


class ClxFormat(CsvFormat):
    """A CLX000 log; its stamps are completed by the date in the head."""

    def __init__(self, path: Path, columns: CsvColumns) -> None:
        super().__init__(path, replace(columns, id_base=16, data_base=16))
        self.facts.format = "clx"
        self._start: tuple[int, ...] = ()
        self._epoch = False

    def prepare(self, head: bytes) -> None:
        """Date, bit rate and spelling of times from the head."""
        fields = {
            found[1].decode("latin-1").strip(): found[2].decode("latin-1").strip()
            for found in _FIELD.finditer(head)
        }
        self.facts.metadata.update(fields)
        found = re.match(r"(\d{4})(\d\d)(\d\d)T?(\d\d)(\d\d)(\d\d)", fields.get("Time", ""))
        self._start = tuple(int(part) for part in found.groups()) if found else ()
        super().prepare(head)
        self.facts.remote_lost = True
        self.facts.notes.append("remote frames are not marked in this format")
        rate = fields.get("Bit-rate", "")
        if re.fullmatch(r"[0-9]{1,7}", rate) and 0 < int(rate) <= 10**6:
            self.facts.bitrates[self.facts.buses[self.bus(b"1") or 0]] = int(rate)

    def _guess_times(self, cells: Sequence[bytes], dates: Sequence[bytes]) -> None:
        digits = [_digits_of(cell) for cell in cells]
        first = next((each for each in digits if len(each) in _DIGITS), None)
        self._epoch = any(map(_EPOCH.fullmatch, cells))
        if first is None or self._epoch:
            super()._guess_times(cells, dates)
            return
        start_ns = utc_ns(*self._start) if self._start else None
        dated = start_ns is not None and start_ns >= _SET_NS
        self.facts.time_base = "utc" if dated else "relative"
        self.facts.notes.append(
            "the log's date names no time zone; it is taken as UTC"
            if dated
            else "the logger's clock was not set: the log has no date"
        )
        begin = _DIGITS[len(first)]
        if start_ns is None or begin <= 1:
            return
        year, month = self._start[:2]
        wraps = {2: monthrange(year, month)[1] * _DAY_NS, 3: _DAY_NS}
        self.wraps_ns = wraps.get(begin, _PARTS_MS[begin - 1][1])
        self.late_ns = 0
        # Days count from the 1st.
        base_ns = utc_ns(year, month, 1) if begin == 2 else start_ns - start_ns % self.wraps_ns
        assert base_ns is not None
        first_ns = base_ns + _value_ns(first, begin)
        if first_ns < start_ns - self.wraps_ns // 2:
            base_ns += self.wraps_ns
        self.origin_ns = base_ns

    def _time(self, line: bytes, cells: Sequence[Span]) -> Moment:
        at = self._at.get("time", len(cells))
        start, end = cells[at] if at < len(cells) else (0, 0)
        places = [place for place in range(start, end) if 48 <= line[place] <= 57]
        begin = None if self._epoch else _DIGITS.get(len(places))
        if begin is None:
            return super()._time(line, cells)
        base_ns, times = 0, []
        for size, worth in _PARTS_MS[begin:]:
            field, places = places[:size], places[size:]
            if field[-1] - field[0] != size - 1:
                return Moment(known=False)
            if worth:
                times.append(((field[0], field[-1] + 1), worth))
        if begin <= 1:
            digits = _digits_of(line[start:end])
            year = int(digits[:4]) if begin == 0 else self._start[0] if self._start else 1970
            month_ns = utc_ns(year, int(digits[-13:-11]), 1)
            if month_ns is None:
                return Moment(known=False)
            base_ns = month_ns
        return Moment(tuple(times), base_ns=base_ns - (_DAY_NS if begin <= 2 else 0))

    def _flags(self, row: dict[str, bytes]) -> int:
        known = _TYPES.get(row.get("kind", b"").strip())
        if known is None:
            return super()._flags(row)
        return bit_flags(extended=known[0], tx=known[1])


def _digits_of(cell: bytes) -> bytes:
    return re.sub(rb"\D", b"", cell)


def _value_ns(digits: bytes, begin: int) -> int:
    """A stamp of ms, seconds, minutes, hours and days at most [ns], the 1st of a month being 0."""
    value, at = -_DAY_NS if begin == 2 else 0, 0
    for size, worth in _PARTS_MS[begin:]:
        value += int(digits[at : at + size]) * worth
        at += size
    return value


def is_clx(lines: list[bytes]) -> bool:
    """Whether these lines begin a log of a CLX000."""
    return any(_LOGGER.match(line) for line in lines[:40])
