"""IXXAT MiniMon ASCII traces (`.trc`, but not PEAK's)."""

import re
from pathlib import Path

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.layout import FrameLayout
from syncline_analyzer.readers.lines import LineFormat, NoFrame, Parsed, bit_flags
from syncline_analyzer.readers.times import SECOND_NS, date_ns, decimal_times
from syncline_schemas.batch import FrameFlag

_HEX = rb"[0-9A-Fa-f]"
_LINE = re.compile(
    rb'"(?P<hour>\d{1,4}):(?P<minute>\d\d):(?P<s>\d\d)(?:[.,](?P<f>\d+))?"[;,]"(?P<id>'
    + _HEX
    + rb"+)"
    rb'"[;,]"(?P<form>Std|Ext)"[;,]"(?P<flags>[^"]*)"[;,]"'
    rb"(?:Remote request\s+DLC = (?P<rn>\d+)|(?P<data>"
    + _HEX
    + rb"{2}(?: "
    + _HEX
    + rb'{2})*))?\s*"\s*$'
)
DAY_NS = 86_400 * SECOND_NS
_TITLE = re.compile(rb"ASCII Trace IXXAT")
_PLAIN = re.compile(
    rb'"Time"[;,]"Identifier \(hex\)"[;,]"Format"[;,]"Flags"[;,]"Data \(hex\)"', re.IGNORECASE
)
_FIELD = re.compile(rb"^(?P<key>[A-Z][\w ]*):[ \t]*(?P<value>[^\r\n]*)", re.MULTILINE)


class IxxatFormat(LineFormat):
    """IXXAT MiniMon; one bus, times from the start of the trace, or of the day it was made."""

    def __init__(self, path: Path) -> None:
        super().__init__(CaptureFacts(path, "ixxat", time_base="relative"))
        self._start_ns = 0

    def prepare(self, head: bytes) -> None:
        """Date, bit rate and lost frames from the header."""
        start_ns = take_header(self.facts, head)
        if start_ns is not None:
            self.facts.time_base, self._start_ns, self.origin_ns = "utc", start_ns, start_ns
            stop_ns = _stop_ns(self.facts, start_ns)
            if stop_ns is not None and _tells_time_of_day(head, start_ns, stop_ns):
                self.origin_ns, self.wraps_ns = start_ns - start_ns % DAY_NS, DAY_NS
        if rate := bit_rate(self.facts):
            self.facts.bitrates[self.facts.buses[self.bus(b"1") or 0]] = rate

    def finish(self, last_ns: int | None) -> None:
        """Say it when the frames run past the time at which the trace was stopped."""
        check_stop(self.facts, self._start_ns, last_ns)

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame, or the header."""
        found = _LINE.match(line)
        if found is None:
            return NoFrame() if is_header(line) or line.startswith(b'"Time"') else None
        flags = bit_flags(extended=found["form"] == b"Ext", tx=b"self" in found["flags"].lower())
        start, end = found.span("data")
        count = (end - start + 1) // 3 if start >= 0 else 0
        if found["rn"] is not None or b"rtr" in found["flags"].lower():
            flags |= FrameFlag.REMOTE
            count = 0
        bus = self.bus(b"1")
        if bus is None or count > 8 or len(found["id"]) > 8:
            return None
        times, digits = decimal_times(found.span("s"), found.span("f"), SECOND_NS)
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=min(int(found["rn"] or b"0"), 8) if flags & FrameFlag.REMOTE else count,
            id_span=found.span("id"),
            id_limit=0x1FFFFFFF if flags & FrameFlag.EXTENDED else 0x7FF,
            times=(
                (found.span("hour"), 3600 * SECOND_NS),
                (found.span("minute"), 60 * SECOND_NS),
                *times,
            ),
            data_start=max(start, 0),
            data_step=3,
            data_count=count,
            digits=digits,
        )


def take_header(facts: CaptureFacts, head: bytes) -> int | None:
    """Take what the lines before the columns tell into the facts; when the trace starts [ns]."""
    title = head[: head.find(b'"')]
    fields = {
        found["key"].decode(): found["value"].decode("latin-1").strip()
        for found in _FIELD.finditer(title)
    }
    facts.metadata.update(fields)
    if fields.get("Overruns", "0") not in ("", "0"):
        facts.notes.append(f"the recorder lost frames: {fields['Overruns']} overruns")
    start_ns = date_ns(f"{fields.get('Date', '')} {fields.get('Start time', '')}")
    dated = start_ns is not None
    facts.notes.append(
        "the trace's date names no time zone; it is taken as UTC"
        if dated
        else "the trace has no date that can be read"
    )
    return start_ns


def bit_rate(facts: CaptureFacts) -> int | None:
    """Bit rate [bit/s] that the header told."""
    found = re.match(r"(\d{1,7})\s*([kM]?)bit", facts.metadata.get("Baudrate", ""))
    return int(found[1]) * {"": 1, "k": 1000, "M": 10**6}[found[2]] if found else None


def check_stop(facts: CaptureFacts, start_ns: int, last_ns: int | None) -> None:
    """Note it when the frames run past the time at which the trace was stopped."""
    stop_ns = _stop_ns(facts, start_ns)
    if stop_ns is None or last_ns is None or facts.time_base != "utc":
        return
    past_ns = last_ns - stop_ns
    if 0 < past_ns < DAY_NS and last_ns - start_ns < DAY_NS:
        facts.notes.append(
            f"the last frame is {past_ns / SECOND_NS:.0f} s later than the stop time in the"
            " header: the times do not count from the start time there, so dates may be off"
        )


def _stop_ns(facts: CaptureFacts, start_ns: int) -> int | None:
    fields = facts.metadata
    stop_ns = date_ns(f"{fields.get('Date', '')} {fields.get('Stop time', '')}")
    return stop_ns if stop_ns is None or stop_ns >= start_ns else stop_ns + DAY_NS


def _tells_time_of_day(head: bytes, start_ns: int, stop_ns: int) -> bool:
    """Whether the first frame fits between start and stop as a time of day, and only so."""
    found = next((match for line in head.splitlines() if (match := _LINE.match(line))), None)
    if found is None:
        return False
    seconds = 3600 * int(found["hour"]) + 60 * int(found["minute"]) + int(found["s"])
    t_ns = seconds * SECOND_NS
    of_day_ns = start_ns + (t_ns - start_ns) % DAY_NS
    return of_day_ns <= stop_ns < start_ns + t_ns


def is_header(line: bytes) -> bool:
    """Whether a line is one of those before the columns."""
    return _TITLE.match(line) is not None or _FIELD.match(line) is not None


def is_plain(lines: list[bytes]) -> bool:
    """Whether the trace has MiniMon's five columns, numbers in hexadecimal."""
    return any(_PLAIN.fullmatch(line.strip()) for line in lines)


def is_ixxat(lines: list[bytes]) -> bool:
    """Whether these lines begin an IXXAT trace."""
    return any(_TITLE.match(line) for line in lines[:5])
