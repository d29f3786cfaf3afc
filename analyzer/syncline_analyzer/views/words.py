"""How numbers, codes and times are written for people; the same in text, HTML and Rerun."""

import math
import unicodedata
from collections.abc import Sequence

import numpy as np

from syncline_analyzer.extent import Stretch
from syncline_analyzer.results import CaptureRow, NodeRow, SdoRow
from syncline_schemas.records import dataclass

_SECOND = 1_000_000_000
_NEARLY = 0.9995
"""What is written as 1 of a unit with three digits."""


def hex_code(value: int | None, digits: int = 4) -> str:
    """A code, index or COB-ID as CANopen people write it; "-" when there is none.

    >>> hex_code(0x8130), hex_code(0x80, 3), hex_code(None)
    ('8130h', '080h', '-')
    """
    return "-" if value is None else f"{value:0{digits}X}h"


def object_name(index: int | None, sub: int | None) -> str:
    """An object of the dictionary by index and sub-index.

    >>> object_name(0x1A00, 1), object_name(None, None)
    ('1A00h:01', '?')
    """
    return "?" if index is None else f"{index:04X}h:{sub or 0:02X}"


def sdo_result(row: SdoRow) -> str:
    """How an SDO transfer ended, an abort with its code and what that means."""
    if row.result != "abort":
        return row.result
    code = "" if row.abort_code is None else f" {hex_code(row.abort_code, 8)}"
    return f"abort{code}" + (f": {row.abort_text}" if row.abort_text else "")


def trace_object(number: int) -> str:
    """The object of a trace, whose number is index << 8 | sub.

    >>> trace_object(0x600400)
    '6004h:00'
    """
    return object_name(number >> 8, number & 0xFF)


def printable(text: str) -> str:
    r"""Text from a bus or file without what a terminal would obey; such characters become \xNN.

    >>> printable("tilt\x1b[31m")
    'tilt\\x1b[31m'
    """
    if text.isprintable():
        return text
    return "".join(c if unicodedata.category(c)[0] != "C" else ascii(c)[1:-1] for c in text)


def node_label(node: int | None, name: str | None = None) -> str:
    """A node by number and name; 0 is all nodes.

    >>> node_label(10, "boom tilt"), node_label(5), node_label(0), node_label(None)
    ('10 boom tilt', '5', 'all', '-')
    """
    if node is None:
        return "-"
    if node == 0:
        return "all"
    return f"{node} {printable(name)}" if name else str(node)


def number(value: float | None, unit: str = "", digits: int = 4) -> str:
    """A figure with so many significant digits; "-" when it is not known.

    >>> number(10000.123, "us"), number(0.04321), number(None), number(1234567)
    ('10000 us', '0.04321', '-', '1234567')
    >>> number(999.8, digits=3)
    '1000'
    """
    if value is None or not math.isfinite(value):
        return "-"
    whole = value == int(value) or abs(value) >= 10**digits - 0.5
    text = f"{value:.0f}" if whole else f"{value:.{digits}g}"
    return f"{text} {unit}" if unit else text


def duration(ns: int) -> str:
    """A stretch of time in the unit that people would say it in.

    >>> duration(320_000_000), duration(3_210_000_000), duration(3_723 * 10**9), duration(1_500)
    ('320 ms', '3.21 s', '1 h 2 min 3 s', '1.5 us')
    >>> duration(999_800_000), duration(999)
    ('1 s', '999 ns')
    """
    if ns < 0:
        return f"-{duration(-ns)}"
    if ns < 60 * _SECOND:
        size, unit = next(
            (size, unit)
            for size, unit in ((_SECOND, "s"), (10**6, "ms"), (1000, "us"), (1, "ns"))
            if ns >= size * _NEARLY or size == 1
        )
        return f"{ns / size:.3g} {unit}"
    seconds = round(ns / _SECOND)
    parts = (
        (seconds // 86400, "d"),
        (seconds // 3600 % 24, "h"),
        (seconds // 60 % 60, "min"),
        (seconds % 60, "s"),
    )
    first = next(i for i, (count, _) in enumerate(parts) if count)
    return " ".join(f"{count} {unit}" for count, unit in parts[first : first + 3] if count)


def capture_time(ns: int) -> str:
    """Capture time as hours, minutes and seconds, rounded to milliseconds as in the findings.

    >>> capture_time(723_250_000_000), capture_time(3_723_000_000_000), capture_time(1_000_600_000)
    ('12:03.250', '1:02:03.000', '0:01.001')
    """
    sign, ms = ("-" if ns < 0 else "", (abs(ns) + 500_000) // 10**6)
    minutes, ms = divmod(ms, 60_000)
    hours, minutes = divmod(minutes, 60)
    head = f"{hours}:{minutes:02}" if hours else f"{minutes}"
    return f"{sign}{head}:{ms // 1000:02}.{ms % 1000:03}"


@dataclass(frozen=True, slots=True)
class Clock:
    """Writes the times of one capture: `dated` when they are UTC, `timed` when there are any."""

    first_ns: int
    dated: bool
    timed: bool

    @classmethod
    def of(cls, capture: CaptureRow) -> "Clock":
        """The clock of a capture."""
        return cls(capture.first_ns, capture.start_utc_ns is not None, capture.time_base != "none")

    def short(self, t_ns: int) -> str:
        """Capture time of a stamp, "-" where there are no times."""
        return capture_time(t_ns - self.first_ns) if self.timed else "-"

    def full(self, t_ns: int) -> str:
        """UTC of a stamp to the microsecond where the capture has a date, else its capture time.

        >>> Clock(0, True, True).full(1_790_000_000_123_456_789)
        '2026-09-21 14:13:20.123456 UTC'
        """
        if not (self.dated and self.timed):
            return self.short(t_ns)
        return f"{str(np.datetime64(t_ns, 'ns').astype('datetime64[us]')).replace('T', ' ')} UTC"

    def stretch(self, start_ns: int, end_ns: int) -> str:
        """A stretch in capture time; one moment where it is shorter than can be written."""
        start, end = self.short(start_ns), self.short(end_ns)
        return start if end_ns <= start_ns or start == end else f"{start} to {end}"


MOST_STRETCHES = 4
"""Stretches of stamps that are told one by one."""


def extent_words(capture: CaptureRow, clock: Clock) -> str:
    """From when to when a capture was made, around every step back of its clock."""
    stretches = capture.stretches or [Stretch(capture.begin_ns, capture.end_ns)]
    return told_stretches(clock, stretches)


def told_stretches(clock: Clock, stretches: Sequence[Stretch]) -> str:
    """Stretches of stamps, each after a step back of the clock.

    >>> told_stretches(Clock(0, False, True), [Stretch(0, 2 * 10**9), Stretch(10**9, 3 * 10**9)])
    '0:00.000 to 0:02.000; then the clock stepped back: 0:01.000 to 0:03.000'
    """
    pairs = [(clock.full(start), clock.full(end)) for start, end in stretches[:MOST_STRETCHES]]
    told = [start if start == end else f"{start} to {end}" for start, end in pairs]
    left = len(stretches) - len(told)
    more = [f"and so {left} times more"] if left else []
    return "; then the clock stepped back: ".join([*told, *more])


def undrawn(capture: CaptureRow) -> str:
    """What pictures over time do not show as it was, where the clock stepped back; else nothing."""
    later = capture.stretches[1:]
    before = [Stretch(s, min(e, capture.begin_ns)) for s, e in later if s < capture.begin_ns]
    told = []
    if before_ns := sum(each.end_ns - each.start_ns for each in before):
        told.append(f"{duration(before_ns)} stamped before the first frame are not drawn")
    if any(each.end_ns > capture.begin_ns for each in later):
        told.append("what comes at the same times again is drawn over what was there")
    return f"The clock stepped back: {'; '.join(told)}." if told else ""


def frame_kinds(capture: CaptureRow) -> str:
    """How many frames of each kind there are."""
    counts = {
        "data": capture.data_frames,
        "remote": capture.remote_frames,
        "error": capture.error_frames,
        "29-bit": capture.extended_frames,
    }
    return ", ".join(f"{count:,} {kind}" for kind, count in counts.items())


def names_of(nodes: list[NodeRow]) -> dict[tuple[str, int], str]:
    """Label by (bus, node) of every node."""
    return {(row.bus, row.node): node_label(row.node, row.name) for row in nodes}
