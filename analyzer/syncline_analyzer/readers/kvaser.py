"""Kvaser's text logs: what CanKing writes, and the plain text that Memorator logs are turned into.

The lines of both have the same columns; which of them are there, and whether numbers are decimal,
is told by no header. Source: logs of CanKing 4 to 6; "ErrorFrame" lines have no identifier of use.
"""

import re
from itertools import islice
from pathlib import Path

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.layout import FrameLayout, regular_bytes
from syncline_analyzer.readers.lines import (
    MAX_PARSED_LINE,
    LineFormat,
    NoFrame,
    OddFrame,
    Parsed,
    bit_flags,
)
from syncline_analyzer.readers.times import SECOND_NS, date_ns, decimal_times, seconds_ns
from syncline_schemas.batch import FrameFlag

_TIME = rb"\s+(?P<s>\d{1,12})\.(?P<f>\d+)"
_WAY = rb"(?:\s+(?P<way>[RrTt]x?)\b)?(?P<tail>\s.*)?$"
_LINE = re.compile(
    rb"\s*(?P<bus>\d{1,2})\s+(?P<id>[0-9A-Fa-f]{1,10})(?P<flags>(?:\s+[A-Z]{1,6}){0,4})"
    rb"\s+(?P<n>\d{1,2})(?P<data>(?:\s+[0-9A-Fa-f]{1,3})*?)" + _TIME + _WAY
)
_ERROR = re.compile(rb"\s*(?P<bus>\d{1,2})\s+(?:[0-9A-Fa-f]+\s+)?ErrorFrame\b.*?" + _TIME + _WAY)
_TITLE = re.compile(rb"\s*Chn\s+Identifier\s+Fl(?:g|ags)", re.IGNORECASE)
_START = re.compile(rb"Logging started at:?\s*(?P<text>[^\r\n]+)|Start time:\s*(?P<t2>[^\r\n]+)")
_REMARK = re.compile(
    rb"\s*(?:Kvaser|Logging|Chn\s|Log(?:ger)?\b|Start|Stop|End|Trigger|Version|File|=|-|;|#|//)",
    re.IGNORECASE,
)
_LOOKED_AT = 2000
_KNOWN_FLAGS = frozenset(b"XRFBEWATDNO")
_HEX_WIDTH = 8


class KvaserFormat(LineFormat):
    """Kvaser text; hexadecimal or decimal is found from the lines."""

    def __init__(self, path: Path) -> None:
        super().__init__(CaptureFacts(path, "kvaser", time_base="relative"))
        self._base = 16

    def prepare(self, head: bytes) -> None:
        """Whether numbers are decimal, and the date of the log, where it has one."""
        lines = (line[:MAX_PARSED_LINE] for line in islice(head.splitlines(), _LOOKED_AT))
        found = [match for line in lines if (match := _LINE.match(line))]
        self._base = 10 if _is_decimal(found) else 16
        if self._base == 10:
            self.facts.notes.append("identifiers and data are taken as decimal numbers")
        start = _START.search(head)
        text = (start["text"] or start["t2"]).decode("latin-1") if start else ""
        start_ns = date_ns(text)
        if start_ns is None:
            self.facts.notes.append("the log has no date")
        else:
            self.facts.time_base, self.origin_ns = "utc", start_ns
            self.facts.notes.append("the log's date names no time zone; it is taken as UTC")

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame, an error frame, or a remark of the logger."""
        if found := _LINE.match(line):
            return self._frame(found)
        if found := _ERROR.match(line):
            return self._error(found)
        return NoFrame() if _REMARK.match(line) else None

    def _error(self, found: re.Match[bytes]) -> Parsed:
        bus = self.bus(found["bus"])
        t_ns = seconds_ns(found["s"], found["f"])
        row = (t_ns, bus or 0, 0, int(FrameFlag.ERROR), 8, bytes(8))
        return None if bus is None else OddFrame(row)

    def _frame(self, found: re.Match[bytes]) -> Parsed:
        marks = set(found["flags"]) - {32, 9}
        # Where channels with names come first, what looks like flags is none.
        if not marks <= _KNOWN_FLAGS:
            return None
        # Only CAN FD frames have an error state indicator.
        if ord("E") in marks and ord("F") not in marks:
            return self._error(found)
        flags = bit_flags(
            extended=ord("X") in marks,
            tx=(found["way"] or b"R")[:1] in b"Tt",
            fd=ord("F") in marks,
            brs=ord("B") in marks,
            esi=ord("E") in marks,
        )
        written = found["data"].split()
        try:
            can_id = int(found["id"], self._base)
            data = bytes(int(byte, self._base) for byte in written)
        except ValueError:
            return None
        limit = 0x1FFFFFFF if flags & FrameFlag.EXTENDED else 0x7FF
        stated, bus = int(found["n"]), self.bus(found["bus"])
        if can_id > limit or bus is None or len(data) > 64:
            return None
        if len(data) > 8:
            flags |= FrameFlag.FD
        dlc = len(data)
        if ord("R") in marks:
            flags, dlc, data = flags | FrameFlag.REMOTE, min(stated, 8), b""
        elif len(data) != stated and not (stated > 8 and flags & FrameFlag.FD):
            flags |= FrameFlag.DLC_INVALID
        start, step = regular_bytes(found["data"], len(data))
        start += found.start("data")
        if self._base != 16 or (data and not step) or len(found["id"]) > _HEX_WIDTH:
            return OddFrame(
                (seconds_ns(found["s"], found["f"]), bus, can_id, int(flags), dlc, data)
            )
        times, digits = decimal_times(found.span("s"), found.span("f"), SECOND_NS)
        count = len(data)
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=dlc,
            id_span=found.span("id"),
            id_limit=limit,
            times=times,
            data_start=start if count else 0,
            data_step=step or 2,
            data_count=count,
            digits=digits,
        )


def _is_decimal(found: list[re.Match[bytes]]) -> bool:
    """Whether the numbers are decimal: none has a letter, and bytes are not all of two digits."""
    bytes_written = [byte for each in found for byte in each["data"].split()]
    numbers = [each["id"] for each in found] + bytes_written
    if not numbers or any(re.search(rb"[A-Fa-f]", number) for number in numbers):
        return False
    return any(len(byte) != 2 for byte in bytes_written) or (
        not bytes_written and not any(len(each["id"]) == _HEX_WIDTH for each in found)
    )


def is_kvaser(lines: list[bytes]) -> bool:
    """Whether these lines are of a Kvaser text log: its title, or frames without one."""
    if any(_TITLE.match(line) for line in lines):
        return True
    filled = [line for line in lines if line.strip()][:50]
    framed = sum(_LINE.match(line) is not None and _ends_with_way(line) for line in filled)
    return framed > 0 and 2 * framed >= len(filled)


def _ends_with_way(line: bytes) -> bool:
    return re.search(rb"\d\.\d+\s+[RrTt]x?\s*$", line) is not None
