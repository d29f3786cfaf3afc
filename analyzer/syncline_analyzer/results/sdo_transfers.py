"""All SDO transfers of a capture: columns that read like a list of rows."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import overload

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results.sdo import SdoRow
from syncline_analyzer.results.sdo_records import (
    DIRECTIONS,
    KINDS,
    RECORD,
    RESULTS,
    Given,
    Records,
    RowMaker,
    SdoObject,
    picked,
    record_of,
)

Rows = NDArray[np.bool_] | NDArray[np.intp] | slice
_BLOCK = 4096
"""Rows that are made at a time."""
_OK, _UPLOAD, _DOWNLOAD = RESULTS.index("ok"), *map(DIRECTIONS.index, ("upload", "download"))
_EXPEDITED = KINDS.index("expedited")


class SdoTransfers(Sequence[SdoRow]):
    """Transfers in order of `seq`; a row is made when it is asked for, and is not kept.

    What many rows are asked for is asked of `records` (see `RECORD`), and of parts of the
    transfers: `transfers.accepted.of_objects(...)` looks at no row at all.

    Args:
        records: (n,) of `RECORD`.
        objects: by the number in `records["object"]`.
        maker: makes the rows.
    """

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, records: Records, objects: Sequence[SdoObject], maker: RowMaker) -> None:
        self.records = records
        self._objects = objects
        self._maker = maker

    @classmethod
    def of(cls, rows: Iterable[SdoRow] = ()) -> "SdoTransfers":
        """The same of rows that are there already."""
        listed = list(rows)
        numbers: dict[SdoObject, int] = {}
        records = np.zeros(len(listed), RECORD)
        for at, row in enumerate(listed):
            place = SdoObject(row.bus, row.node, row.index, row.sub, row.name)
            records[at] = record_of(row, numbers.setdefault(place, len(numbers)), at)
        return cls(records, list(numbers), Given(listed))

    def __len__(self) -> int:
        return len(self.records)

    @overload
    def __getitem__(self, at: int) -> SdoRow: ...
    @overload
    def __getitem__(self, at: slice) -> "SdoTransfers": ...
    def __getitem__(self, at: int | slice) -> "SdoRow | SdoTransfers":
        if isinstance(at, slice):
            return self.part(at)
        place = range(len(self))[at]
        return next(self._maker.rows(self.records[place : place + 1]))

    def __iter__(self) -> Iterator[SdoRow]:
        for begin in range(0, len(self), _BLOCK):
            yield from self._maker.rows(self.records[begin : begin + _BLOCK])

    def __reversed__(self) -> Iterator[SdoRow]:
        return iter(self.part(slice(None, None, -1)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SdoTransfers | list | tuple):
            return NotImplemented
        return len(self) == len(other) and all(
            mine == its for mine, its in zip(self, other, strict=True)
        )

    def __repr__(self) -> str:
        return f"SdoTransfers({len(self)} rows)"

    def part(self, rows: Rows) -> "SdoTransfers":
        """Some of the transfers, by a mask (n,), by places, or by a slice."""
        if isinstance(rows, np.ndarray) and rows.dtype == np.bool_ and rows.all():
            return self
        return SdoTransfers(picked(self.records, rows), self._objects, self._maker)

    def named(self, wanted: Callable[[SdoObject], bool]) -> NDArray[np.bool_]:
        """(n,) Whether the object of each transfer is wanted; asked once for each object."""
        chosen = np.fromiter(map(wanted, self._objects), np.bool_, len(self._objects))
        mask: NDArray[np.bool_] = chosen[self._object]
        return mask

    def of_objects(self, wanted: Callable[[SdoObject], bool]) -> "SdoTransfers":
        """Transfers of the objects that are wanted."""
        return self.part(self.named(wanted))

    def of_object(self, index: int, sub: int) -> "SdoTransfers":
        """Transfers of one object, of all nodes."""
        return self.of_objects(lambda each: each.key == (index, sub))

    def nodes(self) -> list[tuple[str, int]]:
        """(bus, node) of which there are transfers."""
        return list(self._by_node)

    def of_node(self, bus: str, node: int) -> "SdoTransfers":
        """Transfers of one node's servers."""
        places = self._by_node.get((bus, node))
        return self.part(places if places is not None else slice(0))

    @cached_property
    def ok(self) -> "SdoTransfers":
        """Those that went well."""
        return self.part(self.records["result"] == _OK)

    @cached_property
    def unusual(self) -> "SdoTransfers":
        """Few of many: all but those that went well with one request and one answer."""
        records = self.records
        return self.part((records["result"] != _OK) | (records["kind"] != _EXPEDITED))

    @cached_property
    def failed(self) -> "SdoTransfers":
        """Those that did not go well."""
        return self.unusual.part(self.unusual.records["result"] != _OK)

    @cached_property
    def reads(self) -> "SdoTransfers":
        """Uploads, however they ended."""
        return self.part(self.records["direction"] == _UPLOAD)

    @cached_property
    def writes(self) -> "SdoTransfers":
        """Downloads, however they ended."""
        return self.part(self.records["direction"] == _DOWNLOAD)

    @cached_property
    def aborted(self) -> "SdoTransfers":
        """Those that the client or the server broke off."""
        return self.failed.part(self.failed.records["result"] == RESULTS.index("abort"))

    @property
    def accepted(self) -> "SdoTransfers":
        """Writes that the node acknowledged."""
        return self.writes.ok

    @cached_property
    def _object(self) -> NDArray[np.uint32]:
        """(n,) Number of the object; asked for often, and far apart in the records."""
        return np.ascontiguousarray(self.records["object"])

    @cached_property
    def _by_node(self) -> dict[tuple[str, int], NDArray[np.intp]]:
        """Places of each node's transfers, in their order."""
        numbers: dict[tuple[str, int], int] = {}
        of = [numbers.setdefault((o.bus, o.node), len(numbers)) for o in self._objects]
        node = np.array(of, np.uint16)[self._object] if of else np.zeros(0, np.uint16)
        order = np.argsort(node, kind="stable")
        edges = np.searchsorted(node[order], np.arange(len(numbers) + 1))
        found = {key: order[edges[n] : edges[n + 1]] for key, n in numbers.items()}
        return {key: places for key, places in found.items() if len(places)}
