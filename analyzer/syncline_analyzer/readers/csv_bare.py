"""What stands in which column of a home-made CSV log without names and without lengths."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final

from syncline_analyzer.readers.csv_clock import is_clock
from syncline_analyzer.readers.csv_columns import SEPARATORS, CsvColumns, cells_of, is_number

_LOOKED_AT: Final = 200
_NUMBER = re.compile(rb"\d{1,19}(?:[.,]\d+)?(?:[eE][+-]?\d{1,2})?")
_PAYLOAD = re.compile(
    rb"(?:0[xX])?(?:[0-9A-Fa-f]{2}){1,64}"
    rb"|[\[({]?(?:0[xX])?[0-9A-Fa-f]{1,3}(?:[ ,:_-]+(?:0[xX])?[0-9A-Fa-f]{1,3}){0,63}[\])}]?"
)
_BYTE = re.compile(rb"(?:0[xX])?[0-9A-Fa-f]{2}")
_CHANNEL = re.compile(rb"[A-Za-z]*can[ _-]?\d{1,2}|ch?\d{1,2}", re.IGNORECASE)
_WAY = re.compile(rb"[rt]x?", re.IGNORECASE)
_KIND = re.compile(rb"std|ext|xtd|standard|extended|data|remote|[sx]d?", re.IGNORECASE)
_FLAG = re.compile(rb"[01]|true|false", re.IGNORECASE)
_PROOF = re.compile(rb"0[xX]|[A-Fa-f]|^0\d|[ :_-]|^[0-9A-Fa-f]{4,}$")
"""What numbers of a table that is no log seldom are."""
_MOST_BYTES: Final = 8
_LONG: Final = 5
_Column = list[bytes]


def bare_columns(lines: Sequence[bytes]) -> CsvColumns | None:
    """The columns of a log of nothing but frames, by what all of its lines hold; None where they tell too little.

    >>> bare_columns([b"0.1,181,11A4", b"0.2,70A,05"]).roles
    ('time', 'id', 'data')
    """
    filled = [line for line in lines if line.strip() and line[:1] not in b"#;"][:_LOOKED_AT]
    if not filled:
        return None
    separator = max(SEPARATORS, key=lambda each: sum(line.count(each) for line in filled))
    rows = [[line[slice(*span)] for span in cells_of(line, separator)] for line in filled]
    for row in rows:
        while len(row) > 2 and not row[-1]:
            row.pop()
    width = max(map(len, rows))
    if not 2 <= width <= 2 * _MOST_BYTES:
        return None
    whole = [row + [b""] * (width - len(row)) for row in rows]
    roles = _roles([list(column) for column in zip(*whole, strict=True)])
    return None if roles is None else CsvColumns(separator, roles)


def _roles(columns: list[_Column]) -> tuple[str, ...] | None:
    data = _data_columns(columns)
    if not data:
        return None
    roles = ["other"] * len(columns)
    roles[data[0] :] = ["data"] if len(data) == 1 else ["byte"] * len(data)
    left = list(range(data[0]))
    for role, fits in _MARKED:
        place = next((at for at in left if fits(columns[at])), None)
        if place is not None:
            roles[place] = role
            left.remove(place)
    ids = [at for at in left if _are_ids(columns[at])]
    if not ids:
        return None
    at = ids[-1]
    roles[at] = "id"
    before = [place for place in left if place < at]
    times = [place for place in before if _are_times(columns[place])]
    if times:
        roles[_finest(columns, times)] = "time"
    told = columns[at] + columns[data[0]]
    proven = sum(_PROOF.search(cell) is not None for cell in told)
    return tuple(roles) if proven and (times or len(columns) == 2) else None


def _data_columns(columns: list[_Column]) -> list[int]:
    """The last columns: one with all bytes, or one for each byte; none where they hold none."""
    last = len(columns) - 1
    if _are(_PAYLOAD, columns[last]) and not _are(_BYTE, columns[last]):
        return [last]
    first = len(columns)
    # Identifier and data at least are columns.
    while first > 1 and _are(_BYTE, columns[first - 1]) and len(columns) - first < _MOST_BYTES:
        first -= 1
    return list(range(first, len(columns)))


def _are(pattern: re.Pattern[bytes], column: _Column) -> bool:
    filled = [cell for cell in column if cell]
    good = sum(pattern.fullmatch(cell) is not None for cell in filled)
    return good > 0 and _enough(good, len(filled))


def _enough(good: int, cells: int) -> bool:
    """Whether all cells fit, or of a longer column all but one in eight."""
    return cells - good <= (max(1, cells // 8) if cells >= _LONG else 0)


def _matching(pattern: re.Pattern[bytes]) -> Callable[[_Column], bool]:
    return lambda column: _are(pattern, column)


def _is_flag(column: _Column) -> bool:
    return len(column) > 1 and _are(_FLAG, column)


_MARKED: Final = (
    ("bus", _matching(_CHANNEL)),
    ("way", _matching(_WAY)),
    ("kind", _matching(_KIND)),
    ("extended", _is_flag),
)


def _are_ids(column: _Column) -> bool:
    good = [cell for cell in column if is_number(cell) and int(cell.strip(b"xXhH"), 16) < 1 << 32]
    return _enough(len(good), len(column))


def _are_times(column: _Column) -> bool:
    """Whether these are times of the clock, or numbers that seldom decrease.

    Whole numbers must increase; frames of one moment have the same seconds.
    """
    if _enough(sum(map(is_clock, column)), len(column)):
        return True
    if not _are(_NUMBER, column):
        return False
    values = [_value(cell) for cell in column if _NUMBER.fullmatch(cell)]
    back = sum(b < a for a, b in pairwise(values))
    grows = len(values) == 1 or values[-1] > values[0] or b"." in column[0]
    return grows and _enough(len(values) - back, len(values))


def _finest(columns: list[_Column], places: list[int]) -> int:
    """Of columns that may be times the first that does not merely count the lines."""

    def counts(at: int) -> bool:
        values = [_value(cell) for cell in columns[at] if _NUMBER.fullmatch(cell)]
        steps = Counter(b - a for a, b in pairwise(values))
        return len(values) == len(columns[at]) > 1 and set(steps) == {1}

    return next((at for at in places if not counts(at)), places[0])


def _value(cell: bytes) -> float:
    return float(cell.replace(b",", b"."))
