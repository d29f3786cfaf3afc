"""Vector ASC text logs, as CANalyzer, CANoe and many other tools write them."""

import re
from pathlib import Path

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.layout import FrameLayout, Span
from syncline_analyzer.readers.lines import (
    MAX_PARSED_LINE,
    LineFormat,
    NoFrame,
    OddFrame,
    Parsed,
    bit_flags,
    note_requests,
)
from syncline_analyzer.readers.times import SECOND_NS, date_ns, decimal_times, seconds_ns
from syncline_schemas.batch import FrameFlag

_HEX = rb"[0-9A-Fa-f]"
_TIME = rb"\s*(?P<s>\d+)[.,](?P<f>\d+)\s+"
_BYTES = rb"(?P<data>" + _HEX + rb"{1,3}(?: +" + _HEX + rb"{1,3})*)"
_CLASSIC = re.compile(
    _TIME + rb"(?P<bus>[A-Za-z]*\d+)\s+(?P<id>[^\s:]+?)(?P<x>x?)\s+(?P<way>Rx|Tx)\s+"
    rb"(?:d\s+(?P<n>" + _HEX + rb"{1,2})(?:\s+" + _BYTES + rb")?|r(?:\s+(?P<rn>" + _HEX + rb"))?)"
    rb"(?P<tail>\s.*)?$",
    re.IGNORECASE,
)
_FD = re.compile(
    _TIME + rb"CANFD\s+(?P<bus>\d+)\s+(?P<way>Rx|Tx)\s+(?P<id>" + _HEX + rb"+)(?P<x>x?)\s+"
    rb"(?:(?P<name>[A-Za-z_]\w*)\s+)?(?P<brs>[01])\s+(?P<esi>[01])\s+(?P<dlc>"
    + _HEX
    + rb"{1,2})\s+"
    rb"(?P<n>\d{1,2})(?P<rest>\s.*)?$",
    re.IGNORECASE,
)
_ERROR = re.compile(
    _TIME + rb"(?:CANFD\s+)?(?P<bus>[A-Za-z]*\d+)\s+(?:(?:Rx|Tx)\s+)?ErrorFrame\b", re.IGNORECASE
)
_EVENT = re.compile(_TIME + rb"(?P<what>.*)$")
_FRAME_LIKE = re.compile(rb"\s(?:Rx|Tx)\s+[dr](?:\s|$)|\sCANFD\s+\d+\s+(?:Rx|Tx)\s", re.IGNORECASE)
_ASSEMBLED = re.compile(rb"J1939\w*\s")
"""What a tool put together of frames that stand there, too."""
_HEADER = re.compile(
    rb"\s*(?://|$|(?:no\s+)?internal\s+events|begin\s+trigger|end\s+trigger|date\s|base\s"
    rb"|previous\s+log\s+file)",
    re.IGNORECASE,
)
_UNSET = re.compile(rb"(?<!:\d\d[.,])\b19\d\d\b")
"""A year before 2000, and no fraction of a second."""
_REQUEST = re.compile(rb"\sTxRq\s", re.IGNORECASE)
"""What a node was asked to send; it stands there again when it was on the bus."""
_DATE = re.compile(rb"\s*date\s+(?P<text>.+)", re.IGNORECASE)
_TRIGGER = re.compile(rb"\s*begin\s+triggerblock\s+(?P<text>.+)", re.IGNORECASE)
_BASE = re.compile(
    rb"\s*base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<times>absolute|relative))?", re.IGNORECASE
)
_FIRST_TIME = re.compile(rb"^[ \t]*(\d+)[.,](\d+)\s", re.MULTILINE)
_TAIL_NUMBER = re.compile(rb"=\s*(\d+)")
_SYMBOLIC_ID = re.compile(rb"\bID\s*=\s*(?P<id>\d+)(?P<x>x?)", re.IGNORECASE)
_HEADER_LINES = 500
_FD_EDL, _FD_REMOTE = 1 << 12, 1 << 4


class AscFormat(LineFormat):
    """ASC: hexadecimal or decimal, times from the start or from line to line."""

    markers = (b"rigger", b"base ", b"date ")

    def __init__(self, path: Path) -> None:
        super().__init__(CaptureFacts(path, "asc", time_base="relative"))
        self._base = 16
        self._date_ns: int | None = None
        self._trigger_ns: int | None = None
        self._requests = 0

    def prepare(self, head: bytes) -> None:
        """Whether the log has a date, and which."""
        lines = [
            line[:MAX_PARSED_LINE] for line in head.split(b"\n", _HEADER_LINES)[:_HEADER_LINES]
        ]
        # A block's date counts before the header's, which may be when the log was written.
        dates = [
            found
            for kind in (_TRIGGER, _DATE)
            if (found := next(filter(None, map(kind.match, lines)), None))
        ]
        unset = bool(dates) and _UNSET.search(dates[0]["text"]) is not None
        if not unset and any(map(_date_ns, dates)):
            self.facts.time_base = "utc"
            self.facts.notes.append("the log's date names no time zone; it is taken as UTC")
            return
        self.facts.notes.append(
            "the log's date is before 2000, of a clock that was not set: it is taken for none"
            if unset
            else "the log has no date that can be read"
        )

    def control(self, part: bytes) -> bool:
        """Take in a header line or the start of a trigger block."""
        line = part[:MAX_PARSED_LINE].split(b"\n", 1)[0]
        changed = self._header(line)
        if self._trigger_ns is not None:
            first = _FIRST_TIME.search(part)
            if first is not None:
                self._resolve_origin(seconds_ns(first[1], first[2]))
        return changed

    def _header(self, line: bytes) -> bool:
        if base := _BASE.match(line):
            self._base = 10 if base["base"].lower() == b"dec" else 16
            self.differences = (base["times"] or b"").lower() == b"relative"
        elif date := _DATE.match(line):
            self._date_ns = _date_ns(date)
            self.origin_ns = self._date_ns or 0
        elif trigger := _TRIGGER.match(line):
            self._trigger_ns = _date_ns(trigger)
            if _UNSET.search(trigger["text"]):
                self.origin_ns = 0
        else:
            return False
        return True

    def _resolve_origin(self, first_ns: int) -> None:
        # Stamps count from the header's date (Vector) or from the block's (python-can, whose
        # header holds the time of writing): the one that the block's first stamp agrees with.
        block_ns, self._trigger_ns = self._trigger_ns or 0, None
        if self._date_ns is None or first_ns <= abs(block_ns - self._date_ns - first_ns):
            self.origin_ns = block_ns
        else:
            self.origin_ns = self._date_ns

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame, an error frame, or one of the many other events."""
        if found := _CLASSIC.match(line):
            return self._classic(found)
        if found := _FD.match(line):
            return self._fd(found)
        if found := _ERROR.match(line):
            bus = self.bus(found["bus"])
            row = (
                seconds_ns(found["s"], found["f"]),
                bus or 0,
                0,
                int(FrameFlag.ERROR),
                8,
                bytes(8),
            )
            return None if bus is None else OddFrame(row)
        if _HEADER.match(line):
            return NoFrame()
        found = _EVENT.match(line)
        if found is None or (_FRAME_LIKE.search(line) and not _ASSEMBLED.match(found["what"])):
            return None
        self._requests += _REQUEST.search(line) is not None
        return NoFrame(seconds_ns(found["s"], found["f"]))

    def finish(self, last_ns: int | None) -> None:
        """Say how many lines are of what was only asked to be sent."""
        note_requests(self.facts, self._requests)

    def _classic(self, found: re.Match[bytes]) -> Parsed:
        can_id, extended = self._identifier(found)
        if can_id is None:
            return None
        flags = bit_flags(extended=extended, tx=found["way"].lower() == b"tx")
        if found["n"] is None:
            dlc = min(int(found["rn"] or b"0", 16), 8)
            return self._layout(found, flags | FrameFlag.REMOTE, dlc, 0, can_id)
        written = (found["data"] or b"").split()
        try:
            stated = min(int(found["n"], self._base), 8)
            data = bytes(int(byte, self._base) for byte in written[:stated])
        except ValueError:
            return None
        # What follows the data may look like more of them.
        count = min(len(written), stated)
        if count < stated or (count < len(written) and not (found["tail"] or b"").strip()):
            flags |= FrameFlag.DLC_INVALID
        two_digits = self._base == 16 and all(len(byte) == 2 for byte in written)
        regular = two_digits and len(found["data"] or b"") == max(0, 3 * len(written) - 1)
        if self._regular_id(found) and regular and len(written) == count:
            return self._layout(found, flags, count, count, can_id)
        bus = self.bus(found["bus"])
        return (
            None
            if bus is None
            else OddFrame((seconds_ns(found["s"], found["f"]), bus, can_id, flags, count, data))
        )

    def _regular_id(self, found: re.Match[bytes]) -> bool:
        return (
            len(found["id"]) <= 8
            and re.fullmatch(_HEX + rb"+" if self._base == 16 else rb"\d+", found["id"]) is not None
        )

    def _identifier(self, found: re.Match[bytes]) -> tuple[int | None, bool]:
        extended = bool(found["x"])
        try:
            can_id = int(found["id"], self._base)
        except ValueError:
            symbolic = _SYMBOLIC_ID.search(found.groupdict().get("tail") or b"")
            if symbolic is None:
                return None, False
            can_id, extended = int(symbolic["id"]), bool(symbolic["x"])
        limit = 0x1FFFFFFF if extended else 0x7FF
        return (can_id if 0 <= can_id <= limit else None), extended

    def _layout(
        self, found: re.Match[bytes], flags: int, dlc: int, count: int, can_id: int
    ) -> Parsed:
        bus = self.bus(found["bus"])
        if bus is None:
            return None
        if not self._regular_id(found):
            return OddFrame((seconds_ns(found["s"], found["f"]), bus, can_id, int(flags), dlc, b""))
        times, digits = decimal_times(found.span("s"), found.span("f"), SECOND_NS)
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=dlc,
            id_span=found.span("id"),
            id_base=self._base,
            id_limit=0x1FFFFFFF if flags & FrameFlag.EXTENDED else 0x7FF,
            times=times,
            data_start=found.start("data") if count else 0,
            data_step=3,
            data_count=count,
            digits=digits + _tail_digits(found),
        )

    def _fd(self, found: re.Match[bytes]) -> Parsed:
        count, rest = int(found["n"]), found["rest"] or b""
        byte = _HEX + rb"{2}" if self._base == 16 else rb" {0,2}\d{1,3}"
        pattern = rb"\s+?(?P<data>" + byte + rb"(?: " + byte + rb"){%d})(?=\s|$)" % (count - 1)
        data = re.match(pattern, rest) if count else None
        bus, (can_id, extended) = self.bus(found["bus"]), self._identifier(found)
        if bus is None or can_id is None or count > 64 or (count and data is None):
            return None
        after = rest[data.end() if data else 0 :].split()
        bits = _FD_EDL
        if len(after) >= 3 and re.fullmatch(_HEX + rb"{1,8}", after[2]):
            bits = int(after[2], 16)
        # Some tools leave the flags empty; what is faster in its data phase is CAN FD all the same.
        fd = bool(bits & _FD_EDL) or not bits or b"1" in (found["brs"], found["esi"])
        flags = bit_flags(
            extended=extended,
            tx=found["way"].lower() == b"tx",
            fd=fd,
            brs=fd and found["brs"] == b"1",
            esi=fd and found["esi"] == b"1",
        )
        dlc = count
        if not fd and bits & _FD_REMOTE and not count:
            flags, dlc = flags | FrameFlag.REMOTE, min(int(found["dlc"], self._base), 8)
        if count > 8 and not fd:
            return None
        if self._base == 10:
            return self._decimal_fd(found, (bus, can_id, flags, dlc), data)
        times, digits = decimal_times(found.span("s"), found.span("f"), SECOND_NS)
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=dlc,
            id_span=found.span("id"),
            id_limit=0x1FFFFFFF if extended else 0x7FF,
            times=times,
            data_start=found.start("rest") + data.start("data") if data else 0,
            data_step=3,
            data_count=count,
            digits=digits,
        )

    def _decimal_fd(
        self,
        found: re.Match[bytes],
        head: tuple[int, int, int, int],
        data: re.Match[bytes] | None,
    ) -> Parsed:
        numbers = [int(number) for number in data["data"].split()] if data else []
        if any(number > 255 for number in numbers):
            return None
        return OddFrame((seconds_ns(found["s"], found["f"]), *head, bytes(numbers)))


def _date_ns(found: re.Match[bytes]) -> int | None:
    """A date, whose month's name may be in the encoding of an older Windows."""
    try:
        return date_ns(found["text"].decode("utf-8"))
    except UnicodeDecodeError:
        return date_ns(found["text"].decode("latin-1"))


def _tail_digits(found: re.Match[bytes]) -> tuple[Span, ...]:
    start, end = found.span("tail")
    if start < 0:
        return ()
    return tuple(number.span(1) for number in _TAIL_NUMBER.finditer(found.string, start, end))


def is_asc(lines: list[bytes]) -> bool:
    """Whether any of these lines is of an ASC log."""
    return any(
        _CLASSIC.match(line) or _FD.match(line) or _BASE.match(line) or _TRIGGER.match(line)
        for line in lines
    )
