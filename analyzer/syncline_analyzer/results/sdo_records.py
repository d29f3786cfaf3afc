"""SDO transfers as records of fixed size, and the rows that they stand for."""

from collections.abc import Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results.sdo import SdoRow
from syncline_schemas.canopen.datatypes import DATA_TYPES, decode_value
from syncline_schemas.canopen.sdo import abort_meaning
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

DIRECTIONS = ("upload", "download")
KINDS = ("expedited", "segmented", "block")
RESULTS = ("ok", "abort", "no answer", "interrupted")
SIDES = (None, "client", "server")
ENDERS = (None, "request", "reset", "gap", "end")
NONE = -1
"""In a record: not there, or not known."""
RECORD = np.dtype(
    [
        ("seq", "<i8"),
        ("start_ns", "<i8"),
        ("end_seq", "<i8"),
        ("end_ns", "<i8"),
        ("answer_ns", "<i8"),
        ("announced", "<i8"),
        ("abort_code", "<i8"),
        ("at", "<i8"),
        ("length", "<u4"),
        ("object", "<u4"),
        ("client", "<i2"),
        ("toggle_errors", "<u2"),
        ("repeated", "<u2"),
        ("direction", "u1"),
        ("kind", "u1"),
        ("result", "u1"),
        ("abort_by", "u1"),
        ("ended_by", "u1"),
        ("crc", "i1"),
        ("whole", "?"),
    ],
    align=True,
)
"""One transfer: 88 bytes.

`answer_ns` counts from the request to the first answer; `object` is a number in the list of
objects; the data are `length` bytes of the payloads from `at` on; the words are numbers in
`DIRECTIONS`, `KINDS`, `RESULTS`, `SIDES` and `ENDERS`; `crc` is 1 where it fits, 0 where it does not.
"""
Records = NDArray[np.void]
_WHOLE = np.dtype((np.void, RECORD.itemsize))
"""A record as bytes: numpy copies these many times as fast as it copies field by field."""


def joined(parts: list[Records]) -> Records:
    """All records of several, in order of `seq`; the list is empty then.

    Each is copied once, straight to its place: new memory costs more than what is written to it.
    """
    seq = np.concatenate([np.zeros(0, np.int64), *(each["seq"] for each in parts)])
    order = np.argsort(seq, kind="stable")
    places = np.empty_like(order)
    places[order] = np.arange(len(order))
    found, begin = np.empty(len(order), _WHOLE), 0
    while parts:
        part = np.ascontiguousarray(parts.pop(0)).view(_WHOLE)
        found[places[begin : begin + len(part)]] = part
        begin += len(part)
    return found.view(RECORD)


def picked(records: Records, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Records:
    """Some of the records, a view where `rows` is a slice."""
    if isinstance(rows, slice) or not records.flags.c_contiguous:
        return records[rows]
    return records.view(_WHOLE)[rows].view(RECORD)


@dataclass(frozen=True, slots=True)
class SdoObject:
    """An object that transfers name, as it is known at the end: its name and its data type."""

    bus: str
    node: int
    index: int | None
    sub: int | None
    name: str | None = None
    code: int | None = None

    @property
    def key(self) -> tuple[int | None, int]:
        """Index and sub-index, which is 0 where none is told."""
        return self.index, self.sub or 0


class RowMaker(Protocol):
    """Makes the rows that records stand for."""

    def rows(self, records: Records) -> Iterator[SdoRow]:
        """Their rows, in their order."""
        ...


class Decoded:
    """Rows from records and payloads, with values by the type of their objects.

    Args:
        objects: by number.
        payload: (n,) uint8, the data of all transfers.
        timed: whether the stamps mean anything.
    """

    def __init__(
        self, objects: Sequence[SdoObject], payload: NDArray[np.uint8], *, timed: bool
    ) -> None:
        self._objects = objects
        self._payload = payload
        self._timed = timed

    def rows(self, records: Records) -> Iterator[SdoRow]:
        """Their rows, in their order."""
        return map(self._row, map(_Record._make, records.tolist()))

    def _row(self, record: "_Record") -> SdoRow:
        of = self._objects[record.object]
        data = self._payload[record.at : record.at + record.length].tobytes()
        code = _known(record.abort_code)
        aborted = RESULTS[record.result] == "abort"
        timed = self._timed and record.answer_ns != NONE
        words: Any = DIRECTIONS[record.direction], KINDS[record.kind], RESULTS[record.result]
        return SdoRow(
            bus=of.bus,
            node=of.node,
            seq=record.seq,
            start_ns=record.start_ns,
            end_ns=record.end_ns,
            index=of.index,
            sub=of.sub,
            direction=words[0],
            kind=words[1],
            size=_size(record, of.code, data),
            value=_value(of.code, data) if data and record.whole else None,
            result=words[2],
            abort_code=code,
            answer_us=record.answer_ns / 1000 if timed else None,
            name=of.name,
            data=data,
            end_seq=record.end_seq,
            announced=_known(record.announced),
            crc_ok=None if record.crc == NONE else bool(record.crc),
            abort_by=SIDES[record.abort_by],  # type: ignore[arg-type]
            abort_text=_abort_text(code) if aborted else None,
            client_cob_id=_known(record.client),
        )


class Given:
    """Rows that were there first; `at` of their records is their place."""

    def __init__(self, rows: Sequence[SdoRow]) -> None:
        self._rows = rows

    def rows(self, records: Records) -> Iterator[SdoRow]:
        """Their rows, in their order."""
        return (self._rows[at] for at in records["at"].tolist())


class _Record(NamedTuple):
    """A record as plain numbers: fields in the order of `RECORD`."""

    seq: int
    start_ns: int
    end_seq: int
    end_ns: int
    answer_ns: int
    announced: int
    abort_code: int
    at: int
    length: int
    object: int
    client: int
    toggle_errors: int
    repeated: int
    direction: int
    kind: int
    result: int
    abort_by: int
    ended_by: int
    crc: int
    whole: bool


def record_of(row: SdoRow, number: int, at: int) -> tuple[Any, ...]:
    """The record of a row that was there first, with the number of its object."""
    return _Record(
        row.seq,
        row.start_ns,
        row.seq if row.end_seq is None else row.end_seq,
        row.end_ns,
        NONE if row.answer_us is None else round(row.answer_us * 1000),
        NONE if row.announced is None else row.announced,
        NONE if row.abort_code is None else row.abort_code,
        at,
        len(row.data),
        number,
        NONE if row.client_cob_id is None else row.client_cob_id,
        0,
        0,
        DIRECTIONS.index(row.direction),
        KINDS.index(row.kind),
        RESULTS.index(row.result),
        SIDES.index(row.abort_by),
        0,
        NONE if row.crc_ok is None else row.crc_ok,
        row.value is not None,
    )


def _known(value: int) -> int | None:
    return None if value == NONE else value


def _value(code: int | None, data: bytes) -> int | float | str:
    value = decode_value(code, data)
    return value.hex().upper() if isinstance(value, bytes) else value


def _size(record: _Record, code: int | None, data: bytes) -> int | None:
    """Bytes of the value: as received, as announced, or as the type says for size-less frames."""
    if KINDS[record.kind] == "expedited" and data:
        if record.announced != NONE:
            return record.announced
        known = DATA_TYPES.get(code) if code is not None else None
        return (known.bits + 7) // 8 if known is not None and known.bits else None
    if RESULTS[record.result] == "ok" and (record.whole or record.announced == NONE):
        return len(data) if record.whole else None
    return _known(record.announced)


def _abort_text(code: int | None) -> str:
    return abort_meaning(code) if code is not None else "no code given"
