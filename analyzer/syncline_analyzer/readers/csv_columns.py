"""What stands in which column of a CSV log: by its header in many languages, or by its contents."""

import re
from collections.abc import Sequence
from typing import Final

from syncline_analyzer.readers.layout import Span
from syncline_schemas.records import dataclass

SEPARATORS: Final = (b",", b";", b"\t", b"|")
_NAMES: Final = {
    "time": "time timestamp time_stamp timestamps epoch t ts time_offset abs_time date_time datetime"
    " zeit zeitstempel uhrzeit temps horodatage tiempo marca_de_tiempo tempo orario tijd tijdstempel czas tid"
    " elapsed elapsed_time rel_time reltime abstime timestampepoch zaman čas время 时间 时间标识 时间戳 時間 時刻",
    "system": "system_time pc_time host_time computer_time 系统时间 系統時間",
    "delta": "delta 增量时间 delta_time time_delta delta_t dt diff time_diff zeitdifferenz differenz écart",
    "date": "date datum fecha data_date дата 日期",
    "id": "id arbitration_id arb_id can_id cob_id identifier arbitrationid canid cobid message_id msg_id frame_id messageid msgid frameid"
    " kennung identifikator nachrichten_id botschaft_id identifiant identificador identificatore identyfikator"
    " идентификатор 帧id id号 帧id_靠右对齐 报文id ид",
    "extended": "extended ext is_extended is_extended_id is_extended_frame ide xtd ext_id extended_id extid eff is_29bit erweitert étendu extendido esteso",
    "remote": "remote rtr is_remote_frame is_remote is_rtr remote_frame rtr_frame",
    "error": "error is_error_frame is_error error_frame errorframe er fehler erreur",
    "fd": "fd is_fd edl fdf canfd can_fd is_canfd is_fd_frame",
    "rx": "is_rx",
    "brs": "brs bitrate_switch",
    "esi": "esi error_state_indicator",
    "way": "dir direction rx_tx tx_rx rxtx richtung sens dirección direccion direzione direção richting kierunek"
    " направление 方向 传输方向 tx is_tx",
    "bus": "bus bus_id bus_channel buschannel bus_name can_channel can_bus port channel chan chn interface iface ch can network kanal kanaal canal canale kanał канал 通道 can通道 通道号 源通道 第几路can",
    "kind": "type kind frame_type frame_format format typ frametype state art rahmentyp tipo 帧类型 帧格式 can类型",
    "lost": "lost lost_frames dropped overrun overruns",
    "flags": "flags flg",
    "length": "len dlc length dl data_length datalength data_len datalen nbytes byte_count size länge laenge datenlänge longueur longitud lunghezza"
    " comprimento lengte długość длина 长度 数据长度",
    "data": "data payload data_bytes databytes bytes daten nutzdaten données donnees datos dati dados gegevens dane"
    " данные 数据 raw_data message msg_data can_data",
}
ROLE_OF: Final = {name: role for role, names in _NAMES.items() for name in names.split()}
_UNITS: Final = {
    "s": 10**9,
    "sec": 10**9,
    "secs": 10**9,
    "seconds": 10**9,
    "sek": 10**9,
    "ms": 10**6,
    "msec": 10**6,
    "millis": 10**6,
    "milliseconds": 10**6,
    "us": 1000,
    "\u00b5s": 1000,
    "\u03bcs": 1000,
    "usec": 1000,
    "micros": 1000,
    "microseconds": 1000,
    "ns": 1,
    "nanoseconds": 1,
}
_BASES: Final = {
    "hex": 16,
    "hexadecimal": 16,
    "h": 16,
    "dec": 10,
    "decimal": 10,
    "dez": 10,
    "dezimal": 10,
    "déc": 10,
}
_FILLERS: Final = frozenset(
    ("abs", "rel", "absolute", "relative", "utc", "of", "day", "epoch", "unix")
)
_BYTE_NAME: Final = re.compile(r"(?:d|b|db|data|byte|data_byte|databyte)_?[0-9]{1,2}")
_ENCODINGS: Final = ("utf-8", "gb18030", "cp1252")
_EPOCH = re.compile(rb"\d{9,10}[.,]\d+$")
_SECONDS = re.compile(rb"\d{1,8}[.,]\d+$")
_CHANNEL = re.compile(rb"[vs]?(?:l)?can\d+$", re.IGNORECASE)
_PREFIXED = re.compile(rb"0[xX][0-9A-Fa-f]{1,8}$")
_PAYLOAD = re.compile(rb"(?:[0-9A-Fa-f]{2}){0,64}$")
_DATA = re.compile(rb"(?:x\|)?[0-9A-Fa-fxXhH\s:;,_\[\]{}()-]*|(?:rtr|remote).*", re.IGNORECASE)
_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")
_MORE = re.compile(rb"(?:0[xX])?[0-9A-Fa-f]{0,3}[\s\])}]*$")
_BYTE_CELL = re.compile(rb"[0-9A-Fa-f]{2}")
_LOOKED_AT = 50
_MAX_COLUMNS = 200


@dataclass(frozen=True, slots=True)
class CsvColumns:
    """What stands in which column of a CSV log.

    Attributes:
        separator: between the cells.
        roles: of each column; one of the keys of the names above, `byte`, `base64` or `other`.
        header: the line with the names, None where there is none.
        unit_ns: of the times, where the header tells it.
        id_base, data_base: of the identifiers and of the data, where the header tells it.
    """

    separator: bytes
    roles: tuple[str, ...]
    header: bytes | None = None
    unit_ns: int | None = None
    id_base: int | None = None
    data_base: int | None = None

    def cells(self, line: bytes) -> list[Span]:
        """Where each cell of a line stands, without quotes and spaces around.

        Where the data are the last column, separators within them make no cells of their own.
        """
        cells = cells_of(line, self.separator)
        last = len(self.roles) - 1
        more = (line[slice(*span)] for span in cells[last + 1 :])
        if len(cells) > last + 1 and self.roles[last] == "data" and all(map(_MORE.match, more)):
            cells = [*cells[:last], (cells[last][0], cells[-1][1])]
        return cells


def cells_of(line: bytes, separator: bytes) -> list[Span]:
    """Where each cell of a line stands, without quotes and spaces around."""
    spans: list[Span] = []
    at = 0
    while len(spans) < _MAX_COLUMNS:
        end = line.find(separator, at)
        opening = at + len(line[at:]) - len(line[at:].lstrip(b" ")) if at < len(line) else at
        if line[opening : opening + 1] == b'"':
            closing = line.find(b'"', opening + 1)
            if closing >= 0:
                end = line.find(separator, closing)
        stop = len(line) if end < 0 else end
        spans.append(_stripped(line, at, stop))
        if end < 0:
            break
        at = end + 1
    return spans


def _stripped(line: bytes, start: int, end: int) -> Span:
    while start < end and line[start] in b" \"'\t=":
        start += 1
    while end > start and line[end - 1] in b" \"'\t\r":
        end -= 1
    return start, end


def csv_columns(lines: Sequence[bytes]) -> CsvColumns | None:
    """The columns of a CSV log, by its header or by what its first lines hold; None when it is none."""
    filled = [line for line in lines if line.strip()][:_LOOKED_AT]
    for place, line in enumerate(filled):
        columns = _by_header(line)
        if columns is not None and _holds(columns, filled[place + 1 :]):
            return columns
    plain = [line for line in filled if not line.startswith(b"#")]
    for line in plain[:_LOOKED_AT]:
        columns = _by_content(line)
        if columns is not None and _holds(columns, plain) and _sized(columns, plain):
            return columns
    return None


def _holds(columns: CsvColumns, lines: Sequence[bytes]) -> bool:
    """Whether at least half of the lines have an identifier and data where these columns say."""
    at = columns.roles.index("id")
    data = [place for place, role in enumerate(columns.roles) if role in ("data", "byte")]
    good = 0
    for line in lines:
        cells = [line[slice(*span)] for span in columns.cells(line)]
        numbers = (cells[place] for place in data if place < len(cells))
        good += at < len(cells) and is_number(cells[at]) and all(map(_DATA.fullmatch, numbers))
    return good > 0 and 2 * good >= len(lines) - 1


def _sized(columns: CsvColumns, lines: Sequence[bytes]) -> bool:
    """Whether in most lines the column taken for the length tells as many bytes as there are."""
    if not {"length", "data"} <= set(columns.roles):
        return True
    at, data = columns.roles.index("length"), columns.roles.index("data")
    good = 0
    for line in lines:
        cells = [line[slice(*span)] for span in columns.cells(line)]
        if len(cells) > max(at, data) and cells[at].isdigit():
            good += len(cells[data].replace(b" ", b"")) == 2 * int(cells[at][:4])
    return 2 * good >= len(lines) - 1 and (good > 1 or len(lines) < 2)


def is_number(cell: bytes) -> bool:
    """Whether a cell may be an identifier: hexadecimal or decimal digits, `0x`, `x` or `h` allowed.

    >>> [is_number(cell) for cell in (b"0x18F", b"18Fh", b"18FEF100x", b"hello", b"")]
    [True, True, True, False, False]
    """
    return re.fullmatch(rb"(?:0[xX])?[0-9A-Fa-f]{1,10}[xXhH]?", cell) is not None


def _by_header(line: bytes) -> CsvColumns | None:
    separator = max(SEPARATORS, key=line.count)
    if line.count(separator) < 1:
        return None
    line = line.lstrip(b"# ")
    names = [_normal(line[slice(*span)]) for span in cells_of(line, separator)]
    columns: list[str] = []
    unit_ns = id_base = data_base = None
    for name in names:
        role, unit, base = _role(name)
        if role in columns and role not in ("byte", "kind"):
            # Of two kinds of times the first counts, but a time counts more than a difference.
            role = "other"
        if role in ("time", "delta") and unit is not None and unit_ns is None:
            unit_ns = unit
        if role == "id":
            id_base = base
        if role in ("data", "byte") and base is not None:
            data_base = base
        columns.append(role)
    if "system" in columns and "time" not in columns:
        columns[columns.index("system")] = "time"
    if "time" in columns and "delta" in columns:
        columns[columns.index("delta")] = "other"
    if "byte" in columns and "data" in columns:
        columns[columns.index("data")] = "other"
    if "id" not in columns or not {"byte", "data"} & set(columns):
        return None
    if names[0] == "time_stamp" and "byte" in columns and unit_ns is None:
        unit_ns = -1  # SavvyCAN's GVRET form: microseconds, whatever their size
    if names[:2] == ["timestamp", "arbitration_id"] and "data" in columns and "error" in columns:
        columns[columns.index("data")] = "base64"  # python-can's CSVWriter
    return CsvColumns(separator, tuple(columns), line.strip(), unit_ns, id_base, data_base)


def _role(name: str) -> tuple[str, int | None, int | None]:
    """Role of a column, and unit or base that its name tells."""
    unit = base = None
    words = name.split("_")
    while words:
        plain = "_".join(words)
        if plain in ROLE_OF:
            return ROLE_OF[plain], unit, base
        if _BYTE_NAME.fullmatch(plain):
            return "byte", unit, base
        last = words.pop()
        if last in _UNITS:
            unit = _UNITS[last]
        elif last in _BASES:
            base = _BASES[last]
        elif last not in _FILLERS:
            break
    return "other", None, None


def _normal(cell: bytes) -> str:
    for encoding in _ENCODINGS:
        try:
            text = cell.decode(encoding).strip("\ufeff\"' ")
        except UnicodeDecodeError:
            continue
        name = _joined(text)
        if (
            _role(name)[0] == "other"
            and _role(camel := _joined(_HUMP.sub("_", text)))[0] != "other"
        ):
            return camel
        if name.isascii() or _role(name)[0] != "other":
            return name
    return ""


def _joined(text: str) -> str:
    return re.sub(r"[^\w]+", "_", text.lower()).strip("_")


def _by_content(line: bytes) -> CsvColumns | None:
    separator = max(SEPARATORS, key=line.count)
    if line.count(separator) < 2:
        return None
    cells = [line[slice(*span)] for span in cells_of(line, separator)]
    roles = _guessed(cells)
    return None if roles is None else CsvColumns(separator, roles)


def _guessed(cells: list[bytes]) -> tuple[str, ...] | None:
    roles = ["other"] * len(cells)
    for wanted, pattern in (("id", _PREFIXED), ("bus", _CHANNEL)):
        place = next((i for i, cell in enumerate(cells) if pattern.match(cell)), None)
        if place is not None:
            roles[place] = wanted
    times = [i for i, cell in enumerate(cells) if _EPOCH.match(cell)]
    times += [i for i, cell in enumerate(cells) if _SECONDS.match(cell)]
    if times:
        roles[times[0]] = "time"
    if not _guess_data(cells, roles) and not (times and _guess_bytes(cells, roles)):
        return None
    if "id" not in roles and times:
        _guess_id(cells, roles)
    return tuple(roles) if "id" in roles else None


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


def _guess_bytes(cells: list[bytes], roles: list[str]) -> bool:
    """Bytes in cells of their own behind their number."""
    for i in range(len(cells) - 1):
        behind = [cell for cell in cells[i + 1 :] if cell]
        told = roles[i] == "other" and cells[i] == b"%d" % len(behind) and 0 < len(behind) <= 8
        if told and all(map(_BYTE_CELL.fullmatch, behind)):
            roles[i] = "length"
            roles[i + 1 :] = ["byte"] * (len(cells) - i - 1)
            return True
    return False


def _guess_id(cells: list[bytes], roles: list[str]) -> None:
    """The identifier without a mark: the last number before the length, or the flag before that."""
    ends = [roles.index(role) for role in ("extended", "length") if role in roles]
    at = min(ends, default=0) - 1
    if at >= 0 and roles[at] == "other" and is_number(cells[at]):
        roles[at] = "id"
