"""CSV logs: SavvyCAN (GVRET), python-can, and home-made ones with or without a header."""

import base64
import binascii
import re
from dataclasses import dataclass
from pathlib import Path

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.layout import FrameLayout, Span
from syncline_analyzer.readers.lines import LineFormat, NoFrame, OddFrame, Parsed, bit_flags
from syncline_analyzer.readers.times import FIRST_UTC_NS, SECOND_NS, Times, decimal_times
from syncline_schemas.batch import FrameFlag

_NAMES = {
    "time": "time timestamp time_stamp epoch t time_s timestamp_s time_offset timestamps",
    "time_ms": "time_ms timestamp_ms",
    "time_us": "time_us timestamp_us",
    "time_ns": "time_ns timestamp_ns t_ns",
    "id": "id arbitration_id can_id cob_id identifier arbitrationid canid id_hex cobid",
    "extended": "extended ext is_extended is_extended_id ide",
    "remote": "remote rtr is_remote_frame is_remote",
    "error": "error is_error_frame is_error",
    "way": "dir direction rx_tx",
    "bus": "bus channel interface ch can",
    "length": "len dlc length dl",
    "data": "data payload data_hex data_bytes bytes",
}
_ROLE_OF = {name: role for role, names in _NAMES.items() for name in names.split()}
_HEX = rb"[0-9A-Fa-f]"
_FLAG = rb"(?:0|1|[Tt]rue|[Ff]alse|TRUE|FALSE)?"
_TIME = rb"(?P<s>\d{1,19})(?:\.(?P<f>\d+))?"
_PATTERNS = {
    "time": _TIME,
    "time_ms": _TIME,
    "time_us": _TIME,
    "time_ns": _TIME,
    "id": rb"(?P<prefix>0[xX])?(?P<id>" + _HEX + rb"{1,8})",
    "extended": rb"(?P<extended>" + _FLAG + rb")",
    "remote": rb"(?P<remote>" + _FLAG + rb")",
    "error": rb"(?P<error>" + _FLAG + rb")",
    "way": rb"(?P<way>\w*)",
    "bus": rb"(?P<bus>[^,;\t]*)",
    "length": rb"(?P<length>\d{1,2})",
    "bytes": rb"(?P<data>" + _HEX + rb"{2}(?:[ ,;\t]" + _HEX + rb"{2})*)?[ ,;\t]*",
    "data": rb"(?:0[xX])?(?P<data>(?:"
    + _HEX
    + rb"{2})*|"
    + _HEX
    + rb"{2}(?: "
    + _HEX
    + rb"{2})*) *",
    "base64": rb"(?P<base64>[A-Za-z0-9+/=]*)",
    "other": rb"(?P<other{}>[^,;\t]*)",
}
_UNIT_NS = {"time": SECOND_NS, "time_ms": 10**6, "time_us": 1000, "time_ns": 1}
_EPOCH = re.compile(rb"\d{9,10}\.\d+$")
_SECONDS = re.compile(rb"\d{1,8}\.\d+$")
_CHANNEL = re.compile(rb"[vs]?(?:l)?can\d+$", re.IGNORECASE)
_PREFIXED = re.compile(rb"0[xX]" + _HEX + rb"{1,8}$")
_PAYLOAD = re.compile(rb"(?:" + _HEX + rb"{2}){0,64}$")


@dataclass(frozen=True, slots=True)
class CsvColumns:
    """What stands in which column of a CSV log."""

    separator: bytes
    roles: tuple[str, ...]
    header: bytes | None = None

    def pattern(self) -> re.Pattern[bytes]:
        """A line of this log."""
        quoted = re.escape(self.separator)
        parts = [
            _PATTERNS[role].replace(b"{}", b"%d" % place) for place, role in enumerate(self.roles)
        ]
        if self.roles[-1] == "bytes":
            last = parts.pop()
            joined = rb'"? *' + (rb' *"?' + quoted + rb'"? *').join(parts) + rb' *"?'
            return re.compile(joined + rb"(?:" + quoted + last + rb")?\s*$")
        return re.compile(
            rb'"? *' + (rb' *"?' + quoted + rb'"? *').join(parts) + rb' *"?' + quoted + rb"?\s*$"
        )


class CsvFormat(LineFormat):
    """A CSV log with known columns."""

    def __init__(self, path: Path, columns: CsvColumns) -> None:
        super().__init__(CaptureFacts(path, "csv", time_base="none"))
        self._columns = columns
        self._line = columns.pattern()
        self._unit_ns = next(
            (_UNIT_NS[role] for role in columns.roles if role in _UNIT_NS), SECOND_NS
        )

    def prepare(self, head: bytes) -> None:
        """What the times are."""
        lines = (self._line.match(line) for line in head.splitlines()[:100])
        first = next((found for found in lines if found), None)
        if first is None or "s" not in first.groupdict():
            self.facts.notes.append("the log has no times")
            return
        utc = int(first["s"]) * self._unit_ns >= FIRST_UTC_NS
        self.facts.time_base = "utc" if utc else "relative"
        if "remote" not in self._columns.roles:
            self.facts.notes.append(
                "remote frames are not marked in this format; they appear as empty data frames"
            )

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame or the header."""
        found = self._line.match(line)
        if found is None:
            return NoFrame() if line.strip() == self._columns.header else None
        groups = found.groupdict()
        bus = self.bus((groups.get("bus") or b"").strip(b'" ') or b"1")
        if bus is None:
            return None
        flags, limit = self._flags(found, groups)
        times, digits = self._times(found)
        if groups.get("base64") is not None:
            return self._base64_frame(found, bus, flags, limit, times)
        start, end = found.span("data") if groups.get("data") else (0, 0)
        step = 3 if end - start > 2 and not _PAYLOAD.match(found["data"]) else 2
        count = (end - start + step - 2) // step
        stated = int(groups.get("length") or count)
        if flags & FrameFlag.REMOTE:
            count = 0
        elif count != stated:
            flags |= FrameFlag.DLC_INVALID
            count = min(count, stated)
        if count > 8:
            flags |= FrameFlag.FD
        if count > 64:
            return None
        return FrameLayout(
            bus=bus,
            flags=int(flags),
            dlc=min(stated, 8) if flags & FrameFlag.REMOTE else count,
            id_span=found.span("id"),
            id_limit=limit,
            times=times,
            data_start=start,
            data_step=step,
            data_count=count,
            digits=digits,
        )

    def _flags(self, found: re.Match[bytes], groups: dict[str, bytes | None]) -> tuple[int, int]:
        can_id = int(found["id"], 16)
        extended = len(found["id"]) > 4 and can_id > 0x7FF
        if groups.get("extended"):
            extended = _is_true(groups["extended"])
        flags = bit_flags(extended=extended, tx=(groups.get("way") or b"").lower() == b"tx")
        if _is_true(groups.get("remote")):
            flags |= FrameFlag.REMOTE
        if _is_true(groups.get("error")):
            flags = (flags | FrameFlag.ERROR) & ~FrameFlag.EXTENDED
            return int(flags), 0x1FFFFFFF
        return int(flags), 0x1FFFFFFF if extended else 0x7FF

    def _times(self, found: re.Match[bytes]) -> tuple[Times, tuple[Span, ...]]:
        digits: tuple[Span, ...] = tuple(
            span
            for name in self._line.groupindex
            if name.startswith("other")
            for span in _digit_spans(found, name)
        )
        if self.facts.time_base == "none":
            return (), digits
        times, finer = decimal_times(found.span("s"), found.span("f"), self._unit_ns)
        return times, digits + finer

    def _base64_frame(
        self, found: re.Match[bytes], bus: int, flags: int, limit: int, times: Times
    ) -> Parsed:
        try:
            data = base64.b64decode(found["base64"], validate=True)
        except (binascii.Error, ValueError):
            return None
        can_id = int(found["id"], 16)
        if can_id > limit or len(data) > 64:
            return None
        t_ns = sum(int(found.string[a:b]) * worth for (a, b), worth in times)
        flags |= FrameFlag.FD if len(data) > 8 else 0
        dlc = len(data)
        if flags & FrameFlag.REMOTE:
            data, dlc = b"", min(int(found["length"] or b"0"), 8)
        return OddFrame((t_ns, bus, can_id, flags, dlc, data), timed=bool(times))


def _digit_spans(found: re.Match[bytes], name: str) -> list[Span]:
    start, end = found.span(name)
    return [run.span() for run in re.finditer(rb"\d+", found.string[:end]) if run.start() >= start]


def _is_true(value: bytes | None) -> bool:
    return (value or b"").lower() in (b"1", b"true")


def csv_columns(lines: list[bytes]) -> CsvColumns | None:
    """The columns of a CSV log, by its header or by what its first lines hold; None when it is none."""
    filled = [line.strip() for line in lines if line.strip() and not line.startswith(b"#")][:50]
    if not filled:
        return None
    counts = {separator: filled[0].count(separator) for separator in (b",", b";", b"\t")}
    separator = max(counts, key=lambda one: counts[one])
    if counts[separator] < 2:
        return None
    columns = _by_header(filled, separator) or _by_content(filled, separator)
    if columns is None or "id" not in columns.roles:
        return None
    pattern = columns.pattern()
    matching = sum(pattern.match(line) is not None for line in filled)
    return columns if 2 * matching >= len(filled) - 1 and matching else None


def _by_header(lines: list[bytes], separator: bytes) -> CsvColumns | None:
    cells = [_normal(cell) for cell in lines[0].rstrip(separator).split(separator)]
    roles: list[str] = []
    for cell in cells:
        role = _ROLE_OF.get(cell, "other")
        if re.fullmatch(r"(?:d|b|data|byte|data_byte_?)_?[0-9]{1,2}", cell):
            roles.append("bytes")
            break
        roles.append("other" if role in roles or (role in _UNIT_NS and _has_time(roles)) else role)
    if "id" not in roles or not {"bytes", "data"} & set(roles):
        return None
    if cells[0] == "time_stamp" and "bytes" in roles:
        roles[0] = "time_us"  # SavvyCAN's GVRET form counts microseconds
    if "data" in roles and cells[:2] == ["timestamp", "arbitration_id"] and "error" in roles:
        roles[roles.index("data")] = "base64"  # python-can's CSVWriter
    return CsvColumns(separator, tuple(roles), lines[0])


def _has_time(roles: list[str]) -> bool:
    return bool(_UNIT_NS.keys() & set(roles))


def _normal(cell: bytes) -> str:
    text = cell.decode("utf-8", "replace").strip('" ').lower()
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


def _by_content(lines: list[bytes], separator: bytes) -> CsvColumns | None:
    for line in lines:
        roles = _guessed(line.split(separator))
        if roles is not None:
            return CsvColumns(separator, roles)
    return None


def _guessed(cells: list[bytes]) -> tuple[str, ...] | None:
    cells = [cell.strip(b'" ') for cell in cells]
    roles = ["other"] * len(cells)
    for wanted, pattern in (("id", _PREFIXED), ("bus", _CHANNEL)):
        place = next((i for i, cell in enumerate(cells) if pattern.match(cell)), None)
        if place is not None:
            roles[place] = wanted
    times = [i for i, cell in enumerate(cells) if _EPOCH.match(cell)]
    times += [i for i, cell in enumerate(cells) if _SECONDS.match(cell)]
    if times:
        roles[times[0]] = "time"
    if not _guess_data(cells, roles) or "id" not in roles:
        return None
    return tuple(roles)


def _guess_data(cells: list[bytes], roles: list[str]) -> bool:
    for i in range(len(cells) - 1, 0, -1):
        length = cells[i - 1]
        if length.isdigit() and len(length) <= 2 and roles[i - 1] == "other":
            compact = cells[i].replace(b" ", b"")
            if _PAYLOAD.match(compact) and len(compact) == 2 * int(length):
                roles[i - 1], roles[i] = "length", "data"
                if i >= 2 and cells[i - 2] in (b"0", b"1") and roles[i - 2] == "other":
                    roles[i - 2] = "extended"
                return True
    return False
