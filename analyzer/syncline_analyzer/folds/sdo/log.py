"""SDO transfers kept as records until the end of the capture."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.sdo.channel import SdoChannel
from syncline_analyzer.folds.sdo.pairs import Plain
from syncline_analyzer.folds.sdo.transfer import Transfer
from syncline_analyzer.folds.sdo.values import type_code
from syncline_analyzer.objects import named
from syncline_analyzer.results import SdoTransfers
from syncline_analyzer.results.sdo_records import (
    DIRECTIONS,
    ENDERS,
    KINDS,
    NONE,
    RECORD,
    RESULTS,
    SIDES,
    Decoded,
    Records,
    SdoObject,
    joined,
)
from syncline_schemas.named_tuples import NamedTuple

MAX_ROWS = 500_000
"""Transfers that become rows; of a node that is polled for days the rest is counted only."""
_WAITING = 4096
"""Transfers that are kept as they are before they become records."""
_U16 = 0xFFFF


class Ended(NamedTuple):
    """A transfer that ended with a frame at a place of its stretch."""

    place: int
    channel: SdoChannel
    transfer: Transfer


class SdoLog:
    """Takes transfers in the order in which they end; failed ones are kept twice as long.

    Attributes:
        unlisted: transfers beyond `MAX_ROWS`.
    """

    def __init__(self) -> None:
        self.unlisted = 0
        self._listed = 0
        self._objects: dict[tuple[int, int, int], int] = {}
        """Number by bus number, node, and index with the sub-index from bit 16 on."""
        self._waiting: list[Ended] = []
        self._records: list[Records] = []
        self._payloads: list[NDArray[np.uint8]] = []
        self._size = 0

    def add(
        self,
        ended: Sequence[Ended],
        plain: Plain | None = None,
        channels: Sequence[SdoChannel] = (),
    ) -> None:
        """Take in what ended in a stretch; `ended` in order of the places."""
        answers = plain.answer if plain is not None else np.zeros(0, np.intp)
        kept = self._kept(answers, ended)
        whole = kept[: len(answers)]
        if plain is not None and whole.any():
            chosen = plain if whole.all() else plain.part(np.flatnonzero(whole))
            self._add_plain(chosen, channels)
        others = kept[len(answers) :].tolist()
        self._waiting += [each for each, keep in zip(ended, others, strict=True) if keep]
        if len(self._waiting) > _WAITING:
            self._write(lasting=False)

    def table(self, context: Context) -> SdoTransfers:
        """All transfers in order of `seq`, with types and names as they are known at the end."""
        self._write(lasting=True)
        records = joined(self._records)
        payload = np.concatenate([np.zeros(0, np.uint8), *self._payloads])
        self._payloads = []
        objects = [_object(context, *place) for place in self._objects]
        maker = Decoded(objects, payload, timed=context.timed)
        return SdoTransfers(records, objects, maker)

    def _kept(self, answers: NDArray[np.intp], ended: Sequence[Ended]) -> NDArray[np.bool_]:
        """Which of the plain transfers, then of the others, still become rows."""
        count = len(answers) + len(ended)
        room = MAX_ROWS - self._listed
        kept = np.ones(count, np.bool_)
        if count > room:
            places = np.concatenate([answers, [each.place for each in ended]])
            failed = np.zeros(count, np.bool_)
            failed[len(answers) :] = [each.transfer.result != "ok" for each in ended]
            order = np.argsort(places, kind="stable")[max(0, room) :]
            more = failed[order]
            room = 2 * MAX_ROWS - max(self._listed, MAX_ROWS)
            kept[order] = more & (np.cumsum(more) <= room)
        listed = int(np.count_nonzero(kept))
        self._listed += listed
        self.unlisted += count - listed
        return kept

    def _add_plain(self, plain: Plain, channels: Sequence[SdoChannel]) -> None:
        records = np.zeros(len(plain), RECORD)
        records["seq"], records["start_ns"] = plain.seq, plain.start_ns
        records["end_seq"] = plain.end_seq
        records["end_ns"] = np.maximum(plain.start_ns, plain.end_ns)
        records["answer_ns"] = records["end_ns"] - plain.start_ns
        stated = plain.size.astype(np.int64)
        records["announced"] = np.where(stated, stated, NONE)
        records["abort_code"] = records["crc"] = NONE
        records["at"] = self._size + 4 * np.arange(len(plain))
        records["length"] = np.where(stated, stated, 4)
        records["object"] = self._numbers(plain, channels)
        records["client"] = plain.client
        records["direction"] = np.where(
            plain.read, DIRECTIONS.index("upload"), DIRECTIONS.index("download")
        )
        records["whole"] = True
        self._put(records, plain.word.astype("<u4").view(np.uint8))

    def _numbers(self, plain: Plain, channels: Sequence[SdoChannel]) -> NDArray[np.intp]:
        """Number of the object of each plain transfer."""
        keys = plain.channel.astype(np.int64) << 24 | plain.name
        distinct, of = np.unique(keys, return_inverse=True)
        owners = [channels[key >> 24] for key in distinct.tolist()]
        numbers = [
            self._number(owner.bus, owner.node, key & 0xFFFFFF)
            for owner, key in zip(owners, distinct.tolist(), strict=True)
        ]
        found: NDArray[np.intp] = np.array(numbers, np.intp)[of]
        return found

    def _number(self, bus: int, node: int, name: int) -> int:
        return self._objects.setdefault((bus, node, name), len(self._objects))

    def _write(self, *, lasting: bool) -> None:
        """Make records of the transfers that wait; a channel may still change its last one."""
        done = [each for each in self._waiting if lasting or each.channel.settled(each.transfer)]
        self._waiting = [
            each for each in self._waiting if not (lasting or each.channel.settled(each.transfer))
        ]
        if not done:
            return
        records = np.array([self._record(each) for each in done], RECORD)
        records["at"] = self._size + np.cumsum(records["length"]) - records["length"]
        payload = b"".join(bytes(each.transfer.data) for each in done)
        self._put(records, np.frombuffer(payload, np.uint8))

    def _put(self, records: Records, payload: NDArray[np.uint8]) -> None:
        self._records.append(records)
        self._payloads.append(payload)
        self._size += len(payload)

    def _record(self, ended: Ended) -> tuple[int | bool, ...]:
        """The record of a transfer, its place in the payloads left out."""
        channel, each = ended.channel, ended.transfer
        answered = each.answered_ns
        crc = each.crc_good
        return (
            each.seq,
            each.start_ns,
            each.end_seq,
            max(each.end_ns, each.start_ns),
            NONE if answered is None else max(0, answered - each.start_ns),
            NONE if each.announced is None else each.announced,
            NONE if each.abort_code is None else each.abort_code,
            0,
            len(each.data),
            self._number(channel.bus, channel.node, each.index | each.sub << 16),
            NONE if each.client_id is None else each.client_id,
            min(each.toggle_errors, _U16),
            min(each.repeated, _U16),
            DIRECTIONS.index(each.direction),
            KINDS.index(each.kind),
            RESULTS.index(each.result),
            SIDES.index(each.abort_by),
            ENDERS.index(each.ended_by),
            NONE if crc is None else crc,
            each.whole,
        )


def _object(context: Context, bus: int, node: int, name: int) -> SdoObject:
    index, sub = name & 0xFFFF, name >> 16
    device = context.shadow.device(bus, node)
    words, _ = named(device, index, sub)
    return SdoObject(context.bus_name(bus), node, index, sub, words, type_code(device, index, sub))
