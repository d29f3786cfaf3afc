"""PEAK TRC text logs, versions 1.0 to 2.1.

Source: PEAK-System, "PCAN trace file formats" (developer documentation of `.trc`).
"""

import re
from collections import Counter
from pathlib import Path

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.layout import FrameLayout
from syncline_analyzer.readers.lines import LineFormat, NoFrame, OddFrame, Parsed, bit_flags
from syncline_analyzer.readers.times import MILLISECOND_NS, date_ns, decimal_times, ole_date_ns
from syncline_schemas.batch import FrameFlag

_HEX = rb"[0-9A-Fa-f]"
_DATA = (
    rb"(?:\s+(?P<remote>RTR)|\s+(?P<error>ERROR)\b|\s+(?P<data>"
    + _HEX
    + rb"{2}(?: "
    + _HEX
    + rb"{2})*)(?=\s|$))?"
)
_TAIL = rb"(?P<tail>\s.*)?$"
_TIME = rb"(?P<s>\d+)(?:\.(?P<f>\d+))?"
_VERSION_1 = re.compile(
    rb"\s*(?P<num>\d+)\)\s+" + _TIME + rb"\s+(?:(?P<bus>\d{1,3})\s+)?"
    rb"(?:(?P<type>Rx|Tx|Warng|Error)\s+)?(?P<id>"
    + _HEX
    + rb"{3,8})\s+(?:-\s+)?(?P<n>\d{1,2})"
    + _DATA
    + _TAIL
)
_COLUMNS = {
    "N": rb"(?P<num>\d+)",
    "O": _TIME,
    "T": rb"(?P<type>[A-Z]{2})",
    "B": rb"(?P<bus>\d+)",
    "I": rb"(?P<id>" + _HEX + rb"{3,8}|-)",
    "d": rb"(?P<way>Rx|Tx)",
    "R": rb"\S+",
    "L": rb"(?P<code>\d{1,2}|[A-Fa-f])",
    "l": rb"(?P<n>\d{1,2})",
}
_DEFAULT_COLUMNS = {"2.0": "N,O,T,I,d,l,D", "2.1": "N,O,T,B,I,d,R,L,D"}
_SETTING = re.compile(rb"\s*;\$(?P<key>FILEVERSION|STARTTIME|COLUMNS)=(?P<value>[^\r\n]*)")
_START_SETTING = re.compile(rb"^[ \t]*;\$STARTTIME=(?P<value>[^\r\n]{0,100})", re.MULTILINE)
_START_COMMENT = re.compile(rb"^[ \t]*;[ \t]*Start time:[ \t]*(?P<text>[^\r\n]+)", re.MULTILINE)
_COMMENT = re.compile(rb"\s*;")
_RULER = re.compile(rb"\s*;-+\+-")
_EVENT_2 = re.compile(
    rb"\s*(?:\d+\s+)?(?P<s>\d+)\.(?P<f>\d+)\s+(?P<type>ST|ER|EC|EV)\s+"
    rb"(?:(?P<bus>\d{1,3})\s+)?(?:-\s+)?(?:(?:Rx|Tx)\b)?(?P<text>.*)$"
)
_BUS_STATUS_ID = b"FFFFFFFF"
_FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_FRAME_TYPES = {
    b"DT": FrameFlag(0),
    b"RR": FrameFlag.REMOTE,
    b"FD": FrameFlag.FD,
    b"FB": FrameFlag.FD | FrameFlag.BRS,
    # PEAK's description 2.0, "Type"; python-can takes these two for each other.
    b"FE": FrameFlag.FD | FrameFlag.ESI,
    b"BI": FrameFlag.FD | FrameFlag.BRS | FrameFlag.ESI,
}
_ERROR_CLASS = 0x88
"""SocketCAN CAN_ERR_PROT | CAN_ERR_BUSERROR: what an error frame of this format says at least."""


class TrcFormat(LineFormat):
    """TRC; bus status lines are no frames and are counted in the notes."""

    markers = (b"$",)

    def __init__(self, path: Path) -> None:
        super().__init__(CaptureFacts(path, "trc", time_base="relative"))
        self._line = _VERSION_1
        self._version = "1.0"
        self._status: Counter[str] = Counter()

    def prepare(self, head: bytes) -> None:
        """The start time, from the setting or else from the comment that older versions have."""
        setting = _START_SETTING.search(head)
        if setting and ole_date_ns(setting["value"].decode("latin-1")) is not None:
            self.facts.time_base = "utc"
        elif setting:
            self.facts.notes.append(
                "the log's start time is none, or before 2000: it is taken for none"
            )
            return
        else:
            comment = _START_COMMENT.search(head)
            start_ns = _comment_ns(comment["text"].decode("latin-1")) if comment else None
            if start_ns is None:
                self.facts.notes.append("the log has no start time")
                return
            self.facts.time_base, self.origin_ns = "utc", start_ns
        self.facts.notes.append("the log's start time names no time zone; it is taken as UTC")

    def control(self, part: bytes) -> bool:
        """Take in a setting."""
        found = _SETTING.match(part)
        if found is None:
            return False
        value = found["value"].decode("latin-1").strip()
        if found["key"] == b"STARTTIME":
            self.origin_ns = ole_date_ns(value) or 0
        elif found["key"] == b"FILEVERSION":
            self._version = value
            self.facts.metadata["version"] = value
            self._line = _VERSION_1
            if value.startswith("2"):
                self._line = _version_2(_DEFAULT_COLUMNS.get(value, _DEFAULT_COLUMNS["2.1"]))
        else:
            self._line = _version_2(value)
        return True

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame, an error frame, a bus status, or a comment."""
        if _COMMENT.match(line):
            return NoFrame()
        event = _EVENT_2.match(line) if self._line is not _VERSION_1 else None
        if event is not None:
            return self._event(event, event["type"], event["text"])
        found = self._line.match(line)
        if found is None:
            return None
        kind = b"Error" if found["error"] else found["type"] or b"Rx"
        if kind in (b"Warng", b"Error") or found["id"] == _BUS_STATUS_ID:
            return self._event(found, kind, (found["tail"] or b"").strip() or found["data"] or b"")
        bus = self.bus(found.groupdict().get("bus") or b"1")
        return None if bus is None else self._frame(found, kind, bus)

    def _event(self, found: re.Match[bytes], kind: bytes, text: bytes) -> Parsed:
        if kind not in (b"Error", b"ER"):
            shown = b" ".join([kind, *text.split()]).decode("latin-1")
            self._status[shown] += 1
            return NoFrame()
        bus = self.bus(found["bus"] or b"1")
        if bus is None:
            return None
        times, _ = decimal_times(found.span("s"), found.span("f"), MILLISECOND_NS)
        t_ns = sum(int(found.string[a:b][-12:]) * worth for (a, b), worth in times)
        return OddFrame((t_ns, bus, _ERROR_CLASS, int(FrameFlag.ERROR), 8, bytes(8)))

    def _frame(self, found: re.Match[bytes], kind: bytes, bus: int) -> Parsed:
        groups = found.groupdict()
        stated = _stated_length(groups)
        way = groups.get("way") or kind
        flags = bit_flags(extended=len(found["id"]) > 4, tx=way == b"Tx")
        if self._line is not _VERSION_1:
            if kind not in _FRAME_TYPES:
                return None
            flags |= _FRAME_TYPES[kind]
        start, end = found.span("data")
        count = (end - start + 1) // 3 if start >= 0 else 0
        remote = groups["remote"] is not None or bool(flags & FrameFlag.REMOTE)
        if found["id"] == b"-" or count > 64 or (remote and count):
            return None
        if remote:
            flags |= FrameFlag.REMOTE
        elif count != stated:
            flags |= FrameFlag.DLC_INVALID
            count = min(count, stated)
        if count > 8 and not flags & FrameFlag.FD:
            return None
        times, digits = decimal_times(found.span("s"), found.span("f"), MILLISECOND_NS)
        number = (found.span("num"),) if "num" in groups else ()
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=min(stated, 8) if remote else count,
            id_span=found.span("id"),
            id_limit=0x1FFFFFFF if flags & FrameFlag.EXTENDED else 0x7FF,
            times=times,
            data_start=max(start, 0),
            data_step=3,
            data_count=count,
            digits=digits + number,
        )

    def finish(self, last_ns: int | None) -> None:
        """Say how many lines told the bus's state."""
        for text, count in self._status.most_common(10):
            self.facts.notes.append(f"{count} status line(s) {text!r}")


def _comment_ns(text: str) -> int | None:
    """A date such as `14.11.2023 22:13:20.123.4`, whose last digit counts tenths of a millisecond."""
    start_ns, tenths = date_ns(text), re.search(r"[.,]\d{3}\.(\d)\s*$", text)
    return start_ns + int(tenths[1]) * MILLISECOND_NS // 10 if start_ns and tenths else start_ns


def _stated_length(groups: dict[str, bytes | None]) -> int:
    if (length := groups.get("n")) is not None:
        return int(length)
    code = groups.get("code") or b"0"
    return _FD_LENGTHS[min(int(code, 16 if code.isalpha() else 10), 15)]


def _version_2(columns: str) -> re.Pattern[bytes]:
    names = [name for name in columns.replace(" ", "").split(",") if name in _COLUMNS]
    if len(set(names)) < len(names) or not {"O", "T", "I"} <= set(names):
        names = _DEFAULT_COLUMNS["2.1"].split(",")[:-1]
    return re.compile(rb"\s*" + rb"\s+".join(_COLUMNS[name] for name in names) + _DATA + _TAIL)


def is_trc(lines: list[bytes]) -> bool:
    """Whether any of these lines is of a PEAK trace."""
    return any(
        _SETTING.match(line) or _RULER.match(line) or _VERSION_1.match(line) for line in lines
    )
