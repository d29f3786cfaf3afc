"""candump: log files (`-l`, `-L`) and what it prints on a screen, with any of its options.

Source: can-utils `candump.c` and `lib.c` (`sprint_canframe`, `sprint_long_canframe`).
"""

import re
from itertools import islice, pairwise
from pathlib import Path

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.layout import FrameLayout, Span, regular_bytes
from syncline_analyzer.readers.lines import (
    LineFormat,
    LostFrames,
    NoFrame,
    OddFrame,
    Parsed,
    bit_flags,
)
from syncline_analyzer.readers.times import FIRST_UTC_NS, SECOND_NS, Times, decimal_times, utc_ns
from syncline_schemas.batch import FrameFlag

_HEX = rb"[0-9A-Fa-f]"
LOG_LINE = re.compile(
    rb"\s*\((?P<s>\d+)\.(?P<f>\d+)\)\s+(?P<bus>\S+)\s+(?P<id>" + _HEX + rb"{1,8})#"
    rb"(?:\#(?P<fd>" + _HEX + rb")(?P<fd_data>\.?(?:" + _HEX + rb"{2}\.?){0,64})"
    rb"|R(?P<remote>[0-9A-Fa-f]?)(?:_" + _HEX + rb")?"
    rb"|(?P<data>\.?(?:" + _HEX + rb"{2}\.?){0,8})(?:_" + _HEX + rb")?)"
    rb"(?:\s+(?P<way>[RT]))?\s*(?:\s(?:[;#]|//).*)?$"
)
SCREEN_LINE = re.compile(
    rb"\s*(?:\((?:(?P<date>\d{4}-\d\d-\d\d)[ T](?P<hour>\d\d):(?P<minute>\d\d):(?P<second>\d\d)"
    rb"\.(?P<df>\d+)|(?P<s>\d+)\.(?P<f>\d+))\)\s*|(?P<bs>\d+)\.(?P<bf>\d+)\s+)?"
    rb"(?P<bus>[A-Za-z_][^\s()\[\]#]*)\s+(?:(?P<way>RX|TX)\s+(?P<brs>[B-])\s+(?P<esi>[E-])\s+)?"
    rb"(?P<id>" + _HEX + rb"{1,8})\s+(?:\[(?P<n>\d{1,2})\]|\{" + _HEX + rb"\})"
    rb"(?:\s+(?P<remote>remote request)|\s+(?P<swapped>(?:[01]{8}|"
    + _HEX
    + rb"{2})(?:`(?:[01]{8}|"
    + _HEX
    + rb"{2}))+)(?=\s|$)|\s+(?P<bits>[01]{8}(?: [01]{8})*)(?=\s|$)|\s+(?P<data>"
    + _HEX
    + rb"{2}(?: "
    + _HEX
    + rb"{2})*)(?=\s|$))?"
    rb"(?P<tail>\s.*)?$"
)
_DROPPED = re.compile(rb"DROPCOUNT: dropped (?P<n>\d+) CAN frames? on '(?P<bus>[^']*)' socket")
_SCREEN_TIME = re.compile(
    rb"^[ \t]*\((\d{1,19})\.(\d+)\)[ \t]+\S+[ \t]+(?:[RT]X\s\S+\s\S+\s+)?[0-9A-Fa-f]+\s+[\[{]",
    re.MULTILINE,
)
_ANY_TIME = re.compile(
    rb"^[ \t]*\(?(?P<t>\d{1,19}\.\d+|\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d\.\d+)\)?[ \t]+\S+[ \t]",
    re.MULTILINE,
)
_BARE_TIME = re.compile(rb"^[ \t]*\d+\.\d+[ \t]+\S+\s+[0-9A-Fa-f]+\s+\[", re.MULTILINE)
_QUOTED = re.compile(rb"\s+'")
_ESCAPES = re.compile(rb"\x1b\[[0-9;]*[A-Za-z]")
_COMPARED_TIMES = 4000
_ERROR_BIT = 0x2
"""CAN_ERR_FLAG in the first of eight hexadecimal digits."""


class CandumpFormat(LineFormat):
    """candump's log and screen forms, also mixed."""

    def __init__(self, path: Path) -> None:
        super().__init__(CaptureFacts(path, "candump", time_base="none"))

    def prepare(self, head: bytes) -> None:
        """Find out from the first lines what their times are."""
        head = _ESCAPES.sub(b"", head) if b"\x1b" in head else head
        first = _ANY_TIME.search(head)
        if first is None:
            self.facts.notes.append("the log has no times")
            return
        dated = b"-" in first["t"]
        utc = dated or int(first["t"].split(b".")[0]) * SECOND_NS >= FIRST_UTC_NS
        self.facts.time_base = "utc" if utc else "relative"
        if dated:
            self.facts.notes.append("the log's dates name no time zone; they are taken as UTC")
        self.differences = not utc and _are_differences(head)
        if self.differences:
            self.facts.notes.append("times are differences (candump -td); their sum is used")
        if _BARE_TIME.search(head):
            self.facts.remote_lost = True
            self.facts.notes.append(
                "remote frames are not marked in this format; they appear as empty data frames"
            )

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame, a count of dropped frames, or the text of an error frame."""
        found = LOG_LINE.match(line) if b"#" in line else None
        if found is not None:
            return self._log_frame(found)
        found = SCREEN_LINE.match(line)
        if found is not None:
            return self._screen_frame(found)
        return self._other(line)

    def _other(self, line: bytes) -> Parsed:
        if line[:1] == b"\t":
            return NoFrame()
        dropped = _DROPPED.match(line.strip())
        if dropped:
            return LostFrames(
                "frames dropped by the kernel", int(dropped["n"]), self.bus(dropped["bus"])
            )
        plain = _ESCAPES.sub(b"", line)
        return None if plain == line else _odd(self.parse(plain), plain)

    def _log_frame(self, found: re.Match[bytes]) -> Parsed:
        fd, remote = found["fd"], found["remote"]
        field = "data" if fd is None else "fd_data"
        flags = bit_flags(
            tx=found["way"] == b"T",
            fd=fd is not None,
            brs=fd is not None and bool(int(fd, 16) & 1),
            esi=fd is not None and bool(int(fd, 16) & 2),
        )
        # `cansend` takes dots between the bytes; people log as they send.
        compact = (found[field] or b"").replace(b".", b"")
        count = dlc = len(compact) // 2
        if remote is not None:
            flags |= FrameFlag.REMOTE
            dlc = min(int(remote or b"0", 16), 8)
        times, digits = decimal_times(found.span("s"), found.span("f"), SECOND_NS)
        start, step = regular_bytes(found[field] or b"", count)
        if count and not step:
            layout = self._layout(found, flags, dlc, times, digits, data_start=0, data_count=0)
            return _with_data(layout, found.string, bytes.fromhex(compact.decode()))
        start += found.start(field)
        return self._layout(
            found,
            flags,
            dlc,
            times,
            digits,
            data_start=start if count else 0,
            data_step=step or 2,
            data_count=count,
        )

    def _screen_frame(self, found: re.Match[bytes]) -> Parsed:
        stated = int(found["n"] or b"8")
        flags = bit_flags(
            tx=found["way"] == b"TX",
            fd=len(found["n"] or b"") == 2,
            brs=found["brs"] == b"B",
            esi=found["esi"] == b"E",
        )
        start, end = found.span("data")
        count = (end - start + 1) // 3 if start >= 0 else 0
        tail = found.span("tail")
        if count > stated and found["tail"] is not None and found["tail"].strip():
            # A comment that begins with what looks like a byte.
            count, tail = stated, (start + max(0, 3 * stated - 1), tail[1])
        if count > (64 if flags & FrameFlag.FD else 8) or stated > 64:
            return None
        dlc = count
        odd = _odd_data(found)
        if odd is not None and len(odd) <= 64:
            return self._odd_screen_frame(found, int(flags), stated, odd)
        if found["remote"] is not None:
            flags |= FrameFlag.REMOTE
            dlc = min(stated, 8)
        elif count != stated and found["n"] is not None:
            flags |= FrameFlag.DLC_INVALID
        times, digits, base_ns = self._screen_times(found)
        if base_ns is None:
            return None
        return self._layout(
            found,
            flags,
            dlc,
            times,
            digits,
            data_start=start,
            data_step=3,
            data_count=count,
            anything=_tail(found, tail) if 0 < count == stated else (),
            t_base_ns=base_ns,
        )

    def _odd_screen_frame(
        self, found: re.Match[bytes], flags: int, stated: int, data: bytes
    ) -> Parsed:
        """A frame whose data are printed as bits (`-i`) or from the last to the first (`-S`)."""
        times, digits, base_ns = self._screen_times(found)
        if base_ns is None:
            return None
        flags |= FrameFlag.DLC_INVALID if len(data) != stated else 0
        layout = self._layout(
            found, flags, len(data), times, digits, data_start=0, data_count=0, t_base_ns=base_ns
        )
        return _with_data(layout, found.string, data)

    def _screen_times(self, found: re.Match[bytes]) -> tuple[Times, tuple[Span, ...], int | None]:
        if found["date"] is not None:
            year, month, day = (int(part) for part in found["date"].split(b"-"))
            times, digits = decimal_times(found.span("second"), found.span("df"), SECOND_NS)
            clock = ((found.span("hour"), 3600 * SECOND_NS), (found.span("minute"), 60 * SECOND_NS))
            return clock + times, digits, utc_ns(year, month, day)
        for whole, fraction in (("s", "f"), ("bs", "bf")):
            if found[whole] is not None:
                return *decimal_times(found.span(whole), found.span(fraction), SECOND_NS), 0
        return (), (), 0

    def _layout(
        self,
        found: re.Match[bytes],
        flags: int,
        dlc: int,
        times: Times,
        digits: tuple[Span, ...],
        *,
        data_start: int,
        data_count: int,
        data_step: int = 2,
        anything: tuple[Span, ...] = (),
        t_base_ns: int = 0,
    ) -> FrameLayout | None:
        start, end = found.span("id")
        constant, limit = 0, 0x7FF
        if end - start > 3:
            limit = 0x1FFFFFFF
            flags |= FrameFlag.EXTENDED
        if end - start == 8:
            top = int(found["id"][:1], 16)
            if top > _ERROR_BIT + 1:
                return None
            if top & _ERROR_BIT:
                flags = flags & ~FrameFlag.EXTENDED | FrameFlag.ERROR
            start, constant = start + 1, (top & 1) << 28
        if constant + int(found["id"][start - found.start("id") :] or b"0", 16) > limit:
            return None
        bus = self.bus(found["bus"])
        if bus is None:
            return None
        if self.facts.time_base == "none":
            digits += tuple(span for span, _ in times)
            times, t_base_ns = (), 0
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=dlc,
            id_span=(start, end),
            times=times,
            data_start=data_start,
            data_step=data_step,
            data_count=data_count,
            t_base_ns=t_base_ns,
            id_limit=limit,
            id_constant=constant,
            digits=digits,
            anything=anything,
        )


def _with_data(layout: FrameLayout | None, line: bytes, data: bytes) -> Parsed:
    """The frame of a line whose data no layout can read."""
    row = None if layout is None else layout.row(line)
    if layout is None or row is None:
        return None
    return OddFrame((*row[:5], data), timed=bool(layout.times))


def _odd_data(found: re.Match[bytes]) -> bytes | None:
    if found["swapped"] is None and found["bits"] is None:
        return None
    written = (found["swapped"] or found["bits"]).replace(b"`", b" ").split()
    data = bytes(int(byte, 2 if len(byte) == 8 else 16) for byte in written)
    return data[::-1] if found["swapped"] else data


def _tail(found: re.Match[bytes], tail: Span) -> tuple[Span, ...]:
    # Only a column in quotes cannot be taken for something else in another line.
    if tail[0] < 0:
        return ()
    opening = _QUOTED.match(found.string, tail[0])
    return ((opening.end(), tail[1]),) if opening else ()


def _odd(parsed: Parsed, line: bytes) -> Parsed:
    if not isinstance(parsed, FrameLayout):
        return parsed
    row = parsed.row(line)
    return None if row is None else OddFrame(row, timed=bool(parsed.times))


def _are_differences(head: bytes) -> bool:
    """Whether the times on a screen dump are differences: they go back and forth, or stay equal."""
    times = [
        int(found[1]) * SECOND_NS + int(found[2].ljust(9, b"0")[:9])
        for found in islice(_SCREEN_TIME.finditer(head), _COMPARED_TIMES)
    ]
    if len(times) < 2:
        return False
    back = sum(later < earlier for earlier, later in pairwise(times))
    constant = max(times) > 0 and len(times) >= 8 and 2 * times.count(max(times)) > len(times)
    return 10 * back >= len(times) - 1 or constant


def is_candump_log(lines: list[bytes]) -> bool:
    """Whether these lines begin with one of candump's log file: no other format does."""
    return bool(lines) and LOG_LINE.match(lines[0]) is not None


def is_candump(lines: list[bytes]) -> bool:
    """Whether any of these lines is one of candump's."""
    plain = (_ESCAPES.sub(b"", line) for line in lines)
    return any(LOG_LINE.match(line) or SCREEN_LINE.match(line) for line in plain)
