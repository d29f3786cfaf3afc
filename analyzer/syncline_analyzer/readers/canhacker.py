"""Traces of CANHacker (`.trc`, but not PEAK's): columns apart by spaces, seconds of the adapter's clock.

Source: traces of CANHacker 2; the adapter's clock (Lawicel protocol, command `Z1`) begins again at 0
every 60,000 ms.
"""

import re
from itertools import islice
from pathlib import Path
from typing import Final

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.layout import FrameLayout
from syncline_analyzer.readers.lines import LineFormat, NoFrame, Parsed, bit_flags
from syncline_analyzer.readers.times import SECOND_NS, decimal_times
from syncline_schemas.batch import FrameFlag

_MINUTE_NS: Final = 60 * SECOND_NS
_TITLE = re.compile(rb"\s*Time\s+ID\s+DLC\s+Data\s+Comment\s*$", re.IGNORECASE)
_HEX = rb"[0-9A-Fa-f]"
_LINE = re.compile(
    rb"\s*(?P<s>\d{1,9})[.,](?P<f>\d{1,6})\s+(?P<id>"
    + _HEX
    + rb"{3}|"
    + _HEX
    + rb"{8})\s+(?P<n>[0-8])(?:\s+(?P<remote>RTR|Remote\b.*)|\s+(?P<data>"
    + _HEX
    + rb"{2}(?: "
    + _HEX
    + rb"{2}){0,7})(?=\s|$))?(?P<tail>\s.*)?$",
    re.IGNORECASE,
)
_TIME = re.compile(rb"^[ \t]*(\d{1,9})[.,]\d{1,6}[ \t]+[0-9A-Fa-f]{3,8}[ \t]", re.MULTILINE)
_LOOKED_AT = 20_000


class CanhackerFormat(LineFormat):
    """CANHacker; one bus, no date."""

    def __init__(self, path: Path) -> None:
        super().__init__(CaptureFacts(path, "canhacker", time_base="relative"))

    def prepare(self, head: bytes) -> None:
        """Whether the clock began again at 0 each minute."""
        self.facts.notes.append("the log has no date")
        seconds = [int(found[1]) for found in islice(_TIME.finditer(head), _LOOKED_AT)]
        if max(seconds, default=0) < 60:
            self.wraps_ns, self.late_ns = _MINUTE_NS, 0
            self.facts.notes.append(
                "times begin again at 0 each minute; that more than a minute passed between two frames"
                " cannot be seen"
            )

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame, or the title."""
        found = _LINE.match(line)
        if found is None:
            return NoFrame() if _TITLE.match(line) else None
        extended = len(found["id"]) == 8
        flags, stated = bit_flags(extended=extended), int(found["n"])
        start, end = found.span("data")
        count = (end - start + 1) // 3 if start >= 0 else 0
        # A length without data is that of a remote frame.
        remote = found["remote"] is not None or (stated > 0 and start < 0)
        if remote:
            flags |= FrameFlag.REMOTE
        elif count != stated:
            if found["tail"] is None or not found["tail"].strip():
                flags |= FrameFlag.DLC_INVALID
            # What follows is a comment that begins with what looks like bytes.
            count = min(count, stated)
        bus = self.bus(b"1")
        if bus is None:
            return None
        times, digits = decimal_times(found.span("s"), found.span("f"), SECOND_NS)
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=stated if remote else count,
            id_span=found.span("id"),
            id_limit=0x1FFFFFFF if extended else 0x7FF,
            times=times,
            data_start=max(start, 0),
            data_step=3,
            data_count=count,
            digits=digits,
        )


def is_canhacker(lines: list[bytes]) -> bool:
    """Whether these lines begin a CANHacker trace."""
    return any(_TITLE.match(line) for line in lines[:5])
