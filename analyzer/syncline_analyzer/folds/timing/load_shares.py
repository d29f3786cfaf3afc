"""Whose frames fill a bus: bits and frames per identifier and per node."""

from collections.abc import Callable, Iterable
from math import fsum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.pdo_binding import Pdo
from syncline_analyzer.results import BusShareRow, NodeShareRow
from syncline_schemas import native
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.records import dataclass

MAX_IDS = 4096
"""29-bit identifiers that are told apart per bus; the rest is one row."""
_REMOTE = 1 << 11
_EXTENDED = 1 << 29
_KINDS = int(FrameFlag.EXTENDED | FrameFlag.REMOTE | FrameFlag.ERROR)

Bits = NDArray[np.int64] | NDArray[np.float64]
"""Lengths of frames; whole numbers unless a part of them is faster than the rest."""
Owner = Callable[[int], Pdo | None]
"""The PDO that an identifier carries."""
Producer = Callable[[int], int | None]
"""The node whose EMCY an identifier carries."""


@dataclass(slots=True)
class _Sum:
    """What one identifier, or one node, has sent."""

    frames: int = 0
    bits: float = 0.0


class Shares:
    """Frames and bits of every identifier of one bus."""

    def __init__(self) -> None:
        self._frames = np.zeros(2 * _REMOTE, np.int64)
        self._bits = np.zeros(2 * _REMOTE)
        self._extended: dict[int, _Sum] = {}
        self._rest = _Sum()

    def add(self, frames: FrameBatch, bits: Bits, flags_seen: int) -> None:
        """Take in frames, and every flag that any of them may have; errors have no identifier."""
        if not flags_seen & _KINDS:
            self._add_short(frames.can_id, bits)
            return
        kind = frames.flags & np.uint16(_KINDS)
        remote = (kind & FrameFlag.REMOTE) != 0
        rows = np.flatnonzero((kind & (FrameFlag.EXTENDED | FrameFlag.ERROR)) == 0)
        self._add_short(
            (frames.can_id[rows] & 0x7FF) | np.where(remote[rows], _REMOTE, 0), bits[rows]
        )
        rows = np.flatnonzero((kind & FrameFlag.ERROR) == 0)
        rows = rows[(kind[rows] & FrameFlag.EXTENDED) != 0]
        if not len(rows):
            return
        wide = frames.can_id[rows].astype(np.int64) | np.where(remote[rows], _EXTENDED, 0)
        keys, place = np.unique(wide, return_inverse=True)
        sums = zip(keys, np.bincount(place), np.bincount(place, bits[rows]), strict=True)
        for each, count, total in sums:
            self._add_extended(int(each), int(count), float(total))

    def rows(
        self,
        bus: str,
        seconds: float,
        bitrate: int | None,
        owner: Owner,
        emcy_of: Producer,
        syncs: Iterable[int],
    ) -> tuple[list[BusShareRow], list[NodeShareRow]]:
        """Rows by identifier and by node, the largest first.

        `seconds` were listened to; without `bitrate` there is no load. A row of the nodes without
        a node holds what masters sent, and frames that are nobody's.
        """
        whole = float(self._bits.sum() + self._rest.bits)
        whole += sum(each.bits for each in self._extended.values())
        sync_ids = {0x80, *syncs}

        def percent(bits: float) -> tuple[float, float | None]:
            load = 100 * bits / bitrate / seconds if bitrate and seconds else None
            return 100 * bits / whole if whole else 0.0, load

        rows: list[BusShareRow] = []
        for key in np.flatnonzero(self._frames).tolist():
            cob_id, remote = key & 0x7FF, key >= _REMOTE
            node, service = _named(cob_id, remote, owner, emcy_of, sync_ids)
            count, bits = int(self._frames[key]), float(self._bits[key])
            rows.append(
                BusShareRow(bus, cob_id, False, remote, node, service, count, *percent(bits))
            )
        for key, each in self._extended.items():
            cob_id, remote = key & (_EXTENDED - 1), key >= _EXTENDED
            rows.append(
                BusShareRow(
                    bus, cob_id, True, remote, None, "29-bit", each.frames, *percent(each.bits)
                )
            )
        if self._rest.frames:
            rest = f"further 29-bit identifiers after the first {MAX_IDS}"
            shares = percent(self._rest.bits)
            rows.append(BusShareRow(bus, None, True, False, None, rest, self._rest.frames, *shares))
        rows.sort(key=lambda row: (-row.share_percent, row.cob_id or 0, row.remote))
        return rows, _by_node(bus, rows)

    def _add_short(self, key: NDArray[np.integer[Any]], bits: Bits) -> None:
        if native.available():
            sums = np.zeros(2 * _REMOTE)
            native.tally(key, bits, self._frames, sums)
            self._bits += sums
            return
        self._frames += np.bincount(key, minlength=2 * _REMOTE)
        self._bits += np.bincount(key, bits, minlength=2 * _REMOTE)

    def _add_extended(self, key: int, frames: int, bits: float) -> None:
        full = key not in self._extended and len(self._extended) >= MAX_IDS
        into = self._rest if full else self._extended.setdefault(key, _Sum())
        into.frames += frames
        into.bits += bits


def _by_node(bus: str, rows: list[BusShareRow]) -> list[NodeShareRow]:
    nodes = {row.node for row in rows}
    found = []
    for node in nodes:
        own = [row for row in rows if row.node == node]
        loads = [row.load_percent for row in own if row.load_percent is not None]
        found.append(
            NodeShareRow(
                bus,
                node,
                sum(row.frames for row in own),
                # sum() adds floats otherwise from Python 3.12 on: a capture tells the same to all.
                fsum(row.share_percent for row in own),
                fsum(loads) if len(loads) == len(own) else None,
            )
        )
    return sorted(found, key=lambda row: (-row.share_percent, row.node or 0))


_MASTERS = {0x000: "NMT", 0x100: "TIME", 0x7E4: "LSS answer", 0x7E5: "LSS request"}


def _named(
    cob_id: int, remote: bool, owner: Owner, emcy_of: Producer, syncs: set[int]
) -> tuple[int | None, str]:
    """(node that sends it, service) of an 11-bit identifier; what a master sends has no node."""
    node = cob_id & 0x7F
    if cob_id in syncs:
        return None, "SYNC"
    emcy = emcy_of(cob_id)
    if emcy is not None:
        return emcy, "EMCY"
    pdo = owner(cob_id)
    if pdo is not None:
        name = f"{pdo.kind.upper()}{pdo.number}"
        if remote:
            return None, f"request for {name} of node {pdo.node}"
        return (pdo.node, name) if pdo.kind == "tpdo" else (None, f"{name} of node {pdo.node}")
    if cob_id in _MASTERS:
        return None, _MASTERS[cob_id]
    match cob_id - node:
        case 0x080 if node and not remote:
            return node, "EMCY"
        case 0x580 if node and not remote:
            return node, "SDO answer"
        case 0x600 if node and not remote:
            return None, f"SDO request to node {node}"
        case 0x700 if node:
            return (None, f"guard request to node {node}") if remote else (node, "error control")
    return None, "not CANopen"
