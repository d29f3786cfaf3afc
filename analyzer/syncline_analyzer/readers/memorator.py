"""Kvaser's plain text of Memorator logs, as Kvaser Memorator Tools and kvlclib convert them.

Source: Kvaser's converter library, the writer "Plain text"; lines after the head are a frame, an error
frame, a trigger, or a `DateTime:`.
"""

import re
from pathlib import Path

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.csv_columns import csv_columns
from syncline_analyzer.readers.layout import FrameLayout, regular_bytes
from syncline_analyzer.readers.lines import (
    LineFormat,
    NoFrame,
    OddFrame,
    Parsed,
    bit_flags,
    note_requests,
)
from syncline_analyzer.readers.times import SECOND_NS, date_ns, decimal_times, seconds_ns
from syncline_schemas.batch import FrameFlag

_LINE = re.compile(
    rb"\s*(?P<s>\d{1,12})\.(?P<f>\d+)\s+(?P<bus>\d{1,2})\s+"
    rb"(?:(?P<error>ErrorFrame)\s*x?|(?P<id>[0-9A-Fa-f]{1,10})(?P<x>x?))\s+(?P<way>Rx|TxRq|Tx)"
    rb"(?P<flags>[ EFBPRW#]*)(?<=\s)(?:(?P<n>\d{1,3})(?P<rest>\s.*)?|ERROR FRAME\b.*)$"
)
_TITLE = re.compile(rb"\s*Kvaser Memorator Log")
_HEAD = re.compile(rb"\s*Time\s+Chan\s+Identifier\s+Flags\s+DLC\s+Data", re.IGNORECASE)
_CREATED = re.compile(rb"logfile created at:[ \t]*(?P<text>[^\r\n]+)")
_CALENDAR = re.compile(rb"^DateTime:[ \t]*(?P<text>[^\r\n]+)", re.MULTILINE)
_BASE = re.compile(rb"Format of (?P<what>data|id) field:\s*(?P<base>HEX|DEC)")
_REMARK = re.compile(
    rb"\s*(?:$|=+|DateTime:|\d+\.\d+\s+Trigger|Memorator|Converted|Settings|Format of|Timestamp Offset"
    rb"|CAN channel|.*overrun)",
    re.IGNORECASE,
)
_FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


class MemoratorFormat(LineFormat):
    """Plain text of a Memorator; its times count from the start of the log."""

    def __init__(self, path: Path) -> None:
        super().__init__(CaptureFacts(path, "kvaser", time_base="relative"))
        self._id_base = self._data_base = 16
        self._overruns = 0
        self._requests = 0

    def prepare(self, head: bytes) -> None:
        """The bases of numbers, and the date of the log, where it has one."""
        for found in _BASE.finditer(head):
            base = 16 if found["base"] == b"HEX" else 10
            if found["what"] == b"id":
                self._id_base = base
            else:
                self._data_base = base
        start = _CREATED.search(head) or _CALENDAR.search(head)
        start_ns = date_ns(start["text"].decode("latin-1")) if start else None
        if start_ns is None:
            self.facts.notes.append("the log has no date")
        else:
            self.facts.time_base, self.origin_ns = "utc", start_ns
            self.facts.notes.append(
                "the log's date names no time zone and tells whole seconds; it is taken as UTC"
            )

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame, an error frame, or a remark of the logger."""
        found = _LINE.match(line)
        if found is None:
            known = _REMARK.match(line) or _TITLE.match(line) or _HEAD.match(line)
            return NoFrame() if known else None
        self._overruns += b"#" in found["flags"]
        bus = self.bus(found["bus"])
        if bus is None or (found["error"] is None and found["n"] is None):
            return None
        if found["error"] is not None:
            return OddFrame(
                (seconds_ns(found["s"], found["f"]), bus, 0, int(FrameFlag.ERROR), 8, bytes(8))
            )
        # What the logger was asked to send is on the bus when it says so in another line.
        if found["way"] == b"TxRq":
            self._requests += 1
            return NoFrame()
        return self._frame(found, bus)

    def _frame(self, found: re.Match[bytes], bus: int) -> Parsed:
        marks, extended = found["flags"], bool(found["x"])
        fd = b"F" in marks
        flags = bit_flags(
            extended=extended,
            tx=found["way"] == b"Tx",
            fd=fd,
            brs=fd and b"B" in marks,
            esi=fd and b"P" in marks,
        )
        code, rest = min(int(found["n"]), 15), found["rest"] or b""
        limit = 0x1FFFFFFF if extended else 0x7FF
        try:
            can_id = int(found["id"], self._id_base)
            data = self._data(rest, _FD_LENGTHS[code] if fd else min(code, 8))
        except ValueError:
            return None
        if can_id > limit:
            return None
        dlc, written = len(data), rest.split()
        if b"R" in marks or written[:1] == [b"RTR"]:
            flags, dlc, data = flags | FrameFlag.REMOTE, min(code, 8), b""
        elif dlc < (_FD_LENGTHS[code] if fd else min(code, 8)):
            flags |= FrameFlag.DLC_INVALID
        start, step = regular_bytes(rest.lstrip()[: 3 * dlc - 1], len(data)) if data else (0, 2)
        start += found.start("rest") + len(rest) - len(rest.lstrip())
        irregular = self._id_base != 16 or self._data_base != 16 or (data and not step)
        if irregular or len(found["id"]) > 8 or int(flags) & FrameFlag.REMOTE:
            return OddFrame(
                (seconds_ns(found["s"], found["f"]), bus, can_id, int(flags), dlc, data)
            )
        times, digits = decimal_times(found.span("s"), found.span("f"), SECOND_NS)
        behind = start + (3 * dlc - 1 if data else 0)
        counters = re.compile(rb"\d+").finditer(found.string, behind) if data else ()
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=dlc,
            id_span=found.span("id"),
            id_limit=limit,
            times=times,
            data_start=start if data else 0,
            data_step=step or 2,
            data_count=len(data),
            digits=digits + tuple(each.span() for each in counters),
        )

    def _data(self, rest: bytes, count: int) -> bytes:
        """The data bytes; of the numbers behind the length the last is a counter of frames."""
        written = rest.split()
        if written[:1] == [b"RTR"]:
            return b""
        shown = written[: min(count, max(0, len(written) - 1) if len(written) <= count else count)]
        return bytes(int(byte, self._data_base) for byte in shown)

    def finish(self, last_ns: int | None) -> None:
        """Say it when the logger lost frames, or was asked to send some."""
        note_requests(self.facts, self._requests)
        if self._overruns:
            self.facts.notes.append(f"the logger lost frames before {self._overruns} of those here")


def is_memorator(lines: list[bytes]) -> bool:
    """Whether these lines are of a Memorator log: the head of its columns, or frames, or its title alone.

    Below the title there may be a table with commas: another of the forms that Kvaser's tools write.
    """
    if any(_HEAD.match(line) for line in lines[:60]):
        return True
    filled = [line for line in lines if line.strip()][:50]
    framed = sum(_LINE.match(line) is not None for line in filled)
    if framed > 0 and 2 * framed >= len(filled):
        return True
    titled = any(_TITLE.match(line) for line in lines[:60])
    return titled and (framed > 0 or csv_columns(lines) is None)
