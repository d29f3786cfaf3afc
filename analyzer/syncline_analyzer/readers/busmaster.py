"""BUSMASTER text logs (`.log`), CAN, versions 1 to 3.

Source: BUSMASTER's `LogObjectCAN.cpp` and logs of versions 2.4 and 3.2.
"""

import re
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
from syncline_analyzer.readers.times import MILLISECOND_NS, SECOND_NS, Times, utc_ns
from syncline_schemas.batch import FrameFlag

_HOUR_NS = 3600 * SECOND_NS
_DAY_NS = 24 * _HOUR_NS
_LINE = re.compile(
    rb"\s*(?P<hour>\d{1,4}):(?P<minute>\d{1,2}):(?P<second>\d{1,2}):(?P<part>\d{1,6})\s+"
    rb"(?P<way>Rx|Tx)\s+(?P<bus>\d{1,3})\s+(?P<prefix>0[xX])?(?P<id>[0-9A-Fa-f]{1,10})\s+"
    rb"(?P<kind>s|x|sr|xr|s-fd|x-fd|sfd|xfd)\s+(?P<n>\d{1,2})(?P<data>(?:\s+[0-9A-Fa-f]{1,3})*)\s*$",
    re.IGNORECASE,
)
_ERROR = re.compile(
    rb"\s*(?P<hour>\d{1,4}):(?P<minute>\d{1,2}):(?P<second>\d{1,2}):(?P<part>\d{1,6})\s+"
    rb"(?:(?:Rx|Tx)\s+)?(?:(?P<bus>\d{1,3})\s+)?(?:Err|Error)\w*\b",
    re.IGNORECASE,
)
_TITLE = re.compile(rb"\*\*\*\s*BUSMASTER Ver", re.IGNORECASE)
_PROTOCOL = re.compile(rb"\*\*\*\s*PROTOCOL CAN\b", re.IGNORECASE)
_REMARK = re.compile(rb"\s*\*\*\*")
_START = re.compile(
    rb"START DATE AND TIME\s+(?P<a>\d{1,4})[:/-](?P<b>\d{1,2})[:/-](?P<c>\d{1,4})\s+"
    rb"(?P<hour>\d{1,2}):(?P<minute>\d{1,2}):(?P<second>\d{1,2})(?:[:.](?P<ms>\d{1,3}))?"
)
_RATE = re.compile(
    rb"CHANNEL\s+(?P<bus>\d+)\b.*?(?P<rate>\d+)\s*(?P<k>k)?(?:bps|bit)", re.IGNORECASE
)


class BusmasterFormat(LineFormat):
    """BUSMASTER; times of day, from the start of the log, or from line to line."""

    markers = (b"***",)

    def __init__(self, path: Path) -> None:
        super().__init__(CaptureFacts(path, "busmaster", time_base="relative"))
        self._base = 16
        self._of_day = True
        self._start_ns: int | None = None
        self.wraps_ns = _DAY_NS

    def prepare(self, head: bytes) -> None:
        """Whether the log has a date."""
        if _start_ns(head) is None:
            self.facts.notes.append("the log has no date that can be read")
        else:
            self.facts.time_base = "utc"
            self.facts.notes.append("the log's date names no time zone; it is taken as UTC")

    def control(self, part: bytes) -> bool:
        """Take in a line of the header."""
        line = part[:MAX_PARSED_LINE].split(b"\n", 1)[0].strip().strip(b"*").strip().upper()
        if line in (b"HEX", b"DEC"):
            self._base = 10 if line == b"DEC" else 16
        elif line.endswith(b" MODE"):
            self.differences = line.startswith(b"RELATIVE")
            self._of_day = line.startswith(b"SYSTEM")
        elif line.startswith(b"START DATE"):
            self._start_ns = _start_ns(part)
        elif rate := _RATE.match(line):
            name = self.facts.buses[self.bus(rate["bus"]) or 0]
            self.facts.bitrates[name] = int(rate["rate"]) * (1000 if rate["k"] else 1)
            return False
        else:
            return False
        start_ns = self._start_ns or 0
        self.origin_ns = start_ns - start_ns % _DAY_NS if self._of_day else start_ns
        self.wraps_ns = _DAY_NS if self._of_day else 0
        return True

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame, an error frame, or a line of the header."""
        if _REMARK.match(line):
            return NoFrame()
        if found := _LINE.match(line):
            return self._frame(found)
        if found := _ERROR.match(line):
            bus = self.bus(found["bus"] or b"1")
            t_ns = sum(int(line[a:b]) * worth for (a, b), worth in self._times(found))
            row = (t_ns, bus or 0, 0, int(FrameFlag.ERROR), 8, bytes(8))
            return None if bus is None else OddFrame(row)
        return None

    def _times(self, found: re.Match[bytes]) -> Times:
        start, end = found.span("part")
        return (
            (found.span("hour"), _HOUR_NS),
            (found.span("minute"), 60 * SECOND_NS),
            (found.span("second"), SECOND_NS),
            ((start, end), 10 ** (9 - (end - start))),
        )

    def _frame(self, found: re.Match[bytes]) -> Parsed:
        kind = found["kind"].lower()
        flags = bit_flags(
            extended=kind.startswith(b"x"), tx=found["way"].lower() == b"tx", fd=b"fd" in kind
        )
        base = 16 if found["prefix"] else self._base
        written = found["data"].split()
        try:
            can_id = int(found["id"], base)
            data = bytes(int(byte, self._base) for byte in written)
        except ValueError:
            return None
        limit = 0x1FFFFFFF if flags & FrameFlag.EXTENDED else 0x7FF
        stated, bus, remote = int(found["n"]), self.bus(found["bus"]), kind.endswith(b"r")
        if can_id > limit or bus is None or len(data) > 64 or (remote and data):
            return None
        dlc = len(data)
        if remote:
            flags, dlc = flags | FrameFlag.REMOTE, min(stated, 8)
        elif len(data) != stated:
            flags |= FrameFlag.DLC_INVALID
        if len(data) > 8:
            flags |= FrameFlag.FD
        times = self._times(found)
        start, step = regular_bytes(found["data"], len(data))
        regular = self._base == 16 and base == 16 and len(found["id"]) <= 8
        if not regular or (data and not step):
            t_ns = sum(int(found.string[a:b]) * worth for (a, b), worth in times)
            return OddFrame((t_ns, bus, can_id, int(flags), dlc, data))
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=dlc,
            id_span=found.span("id"),
            id_limit=limit,
            times=times,
            data_start=found.start("data") + start if data else 0,
            data_step=step or 2,
            data_count=len(data),
        )


def _start_ns(head: bytes) -> int | None:
    found = _START.search(head)
    if found is None:
        return None
    day, month, year = int(found["a"]), int(found["b"]), int(found["c"])
    if len(found["a"]) == 4:
        year, day = day, year
    clock = (int(found[name]) for name in ("hour", "minute", "second"))
    whole = utc_ns(year, month, day, *clock)
    return None if whole is None else whole + int(found["ms"] or b"0") * MILLISECOND_NS


def is_busmaster(lines: list[bytes]) -> bool:
    """Whether these lines begin a BUSMASTER log of a CAN bus."""
    head = lines[:20]
    return any(_TITLE.match(line) for line in head) and any(_PROTOCOL.match(line) for line in head)
