"""SDO transfers, and what they teach the object-dictionary shadow."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.sdo.channel import SdoChannel
from syncline_analyzer.folds.sdo.pairs import SdoFrames
from syncline_analyzer.folds.sdo.rows import SdoRows, shadow_value
from syncline_analyzer.folds.sdo.transfer import Oddity, Strays, Transfer
from syncline_analyzer.results import SdoRow
from syncline_analyzer.shadow import Known
from syncline_schemas.batch import Gap
from syncline_schemas.canopen.sdo import LOAD_SIGNATURE, SAVE_SIGNATURE
from syncline_schemas.canopen.services import Service
from syncline_schemas.devices import quirks

OBJECT_MISSING = 0x06020000
MAX_ROWS = 500_000
"""Transfers that become rows; of a node that is polled for days the rest is counted only."""
_EXTENDED_OR_OFF = 0xA0000000
_SERVERS = range(0x1200, 0x1280)
"""SDO server parameters: 1200h is the default server, the others are additional ones."""
_Rows = NDArray[np.intp]


class _Side(NamedTuple):
    """Whose frames an identifier carries: the client's or the server's of a channel."""

    channel: SdoChannel
    request: bool
    can_id: int

    def feed(self, seq: int, t_ns: int, data: bytes) -> None:
        if self.request:
            self.channel.client_id = self.can_id
        take = self.channel.request if self.request else self.channel.answer
        take(seq, t_ns, data)


class Reset(NamedTuple):
    """A node starts anew with a frame; node 0 means all of the bus.

    The frame may be one of an earlier batch, of which only now is known what it means; `specifier`
    is that of the NMT command, 81h or 82h; 0 where the node booted.
    """

    seq: int
    t_ns: int
    bus: int
    node: int
    specifier: int = 0
    byte: int = 0
    """The state with which it may have booted: a few devices do so, of others it is a heartbeat."""


@dataclass(frozen=True, slots=True)
class SdoNodeCounts:
    """Counts of one node's servers."""

    transfers: int = 0
    aborts: int = 0
    unanswered: int = 0
    answers: int = 0
    """Frames of the server, also those of no transfer that is seen whole."""
    confirmed: int = 0
    """Transfers with an answer of the server that fits the request."""


@dataclass(frozen=True, slots=True)
class SdoTable:
    """Transfers in order of `seq`, counts by (bus number, node), and what is no transfer.

    `unlisted` counts those beyond `MAX_ROWS`. `oddities` are answers that should not be, in the order of their frames. `irregular` holds the
    transfers, by `seq`, of which a rule must know more than the row: broken off, with toggle
    errors, with segments sent again, or not recorded whole.
    """

    rows: list[SdoRow] = field(default_factory=list)
    counts: dict[tuple[int, int], SdoNodeCounts] = field(default_factory=dict)
    strays: dict[tuple[int, int], Strays] = field(default_factory=dict)
    oddities: dict[tuple[int, int], list[Oddity]] = field(default_factory=dict)
    irregular: dict[int, Transfer] = field(default_factory=dict)
    unlisted: int = 0


class SdoFold:
    """Follows every SDO server: 600h + n and 580h + n, or where 1200h says, and 1201h to 127Fh.

    Confirmed transfers go into the shadow in the order in which they end. A server that is moved
    is followed from the frame on that tells it, where it is and where it was: a device may take
    the new identifiers over only after a reset.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._channels: dict[tuple[int, int, int], SdoChannel] = {}
        self._usual: dict[int, _Side] = {}
        self._moved: dict[int, _Side] = {}
        self._told: set[tuple[int, int, int]] = set()
        """(bus, node, index) of servers of which the bus told something."""
        self._buses: set[int] = set()
        self._locate_again = True
        self._ended: list[tuple[int, int, Transfer]] = []
        self._unlisted = 0
        self._counts: dict[tuple[int, int], list[int]] = {}

    def update(self, batch: IndexedBatch, resets: Iterable[Reset] = ()) -> None:
        """Take in the next frames; `resets` in order of `seq`."""
        usual = batch.rows_of(Service.SDO_REQUEST, Service.SDO_ANSWER)
        buses = {bus for bus, _ in batch.ids()}
        self._locate_again = self._locate_again or not buses <= self._buses
        self._buses |= buses
        begin = 0
        for reset in resets:
            row = batch.row_at(reset.seq)
            self._feed(batch, usual, begin, row)
            begin = row
            if self._boots_so(reset):
                self._reset(reset)
        self._feed(batch, usual, begin, len(batch))

    def gap(self, gap: Gap) -> None:
        """Transfers that run into a gap end as interrupted, or unanswered if they waited long."""
        begin_ns = gap.start_ns if self._context.timed else None
        for (bus, _, _), channel in self._channels.items():
            if gap.bus in (None, bus):
                channel.cut(begin_ns)

    def finish(self, end_ns: int) -> SdoTable:
        """All transfers; those still running end with the capture."""
        for channel in self._channels.values():
            channel.finish(end_ns, self._context.timed)
        self._ended.sort(key=lambda entry: entry[2].seq)
        rows = SdoRows(self._context)
        table = SdoTable(
            [rows.row(*entry) for entry in self._ended],
            irregular={each.seq: each for _, _, each in self._ended if _irregular(each)},
            unlisted=self._unlisted,
        )
        self._count(table)
        return table

    def _feed(self, batch: IndexedBatch, usual: _Rows, begin: int, stop: int) -> None:
        """Hand the frames of a stretch of rows to their channels."""
        while begin < stop:
            if self._locate_again:
                self._moved = dict(self._servers())
                self._locate_again = False
            rows = usual
            if self._moved:
                moved = [batch.rows(key >> 11, key & 0x7FF) for key in self._moved]
                rows = np.unique(np.concatenate([usual, *moved]))
            first, last = np.searchsorted(rows, (begin, stop))
            begin = self._feed_rows(batch, rows[first:last]) + 1 or stop

    def _feed_rows(self, batch: IndexedBatch, rows: _Rows) -> int:
        """Row at which a server was moved, -1 where none was; SDO frames allow for a loop.

        A plain transfer is taken in at its answer, all others frame by frame.
        """
        if not len(rows):
            return -1
        sides, frames = self._frames(batch, rows)
        asks, answers = frames.pairs()
        ended = dict(zip(answers.tolist(), frames.transfers(asks, answers), strict=True))
        alone = np.ones(len(rows), np.bool_)
        alone[asks] = False
        data, length = frames.data.tobytes(), frames.length.tolist()
        ask_of = np.zeros(len(rows), np.intp)
        ask_of[answers] = asks

        def feed(at: int) -> None:
            payload = data[at * 8 : at * 8 + length[at]]
            sides[at].feed(batch.seq(rows[at]), int(frames.t_ns[at]), payload)

        for at in np.flatnonzero(alone).tolist():
            transfer = ended.get(at)
            if transfer is None:
                feed(at)
            else:
                ask = int(ask_of[at])
                if sides[at].channel.expects(data[ask * 8]):
                    sides[at].channel.client_id = sides[ask].can_id
                    sides[at].channel.take(transfer, data[at * 8 : at * 8 + 8])
                else:
                    feed(ask)
                    feed(at)
            if self._locate_again:
                for ask in asks[(asks < at) & (answers > at)].tolist():
                    feed(ask)
                return int(rows[at])
        return -1

    def _frames(self, batch: IndexedBatch, rows: _Rows) -> tuple[list[_Side], SdoFrames]:
        """SDO frames as columns, and the side of each."""
        frames = batch.frames
        keys = frames.bus[rows].astype(np.uint32) << 11 | frames.can_id[rows]
        distinct, of = np.unique(keys, return_inverse=True)
        sides = [self._side(key) for key in distinct.tolist()]
        numbers: dict[int, int] = {}
        channel = [numbers.setdefault(id(side.channel), len(numbers)) for side in sides]
        columns = SdoFrames(
            batch.seqs[rows],
            frames.t_ns[rows],
            np.minimum(frames.dlc[rows], 8).astype(np.uint8),
            np.ascontiguousarray(frames.data[rows, :8]),
            np.array(channel, np.uint16)[of],
            np.array([side.request for side in sides])[of],
        )
        return [sides[number] for number in of.tolist()], columns

    def _side(self, key: int) -> _Side:
        """Side of an identifier: where a moved server is, else by the identifier itself."""
        if key in self._moved:
            return self._moved[key]
        if key not in self._usual:
            channel = self._channel(key >> 11, key & 0x7F, 0x1200)
            self._usual[key] = _Side(channel, key & 0x780 == 0x600, key & 0x7FF)
        return self._usual[key]

    def _channel(self, bus: int, node: int, server: int) -> SdoChannel:
        key = (bus, node, server)
        if key not in self._channels:
            self._channels[key] = SdoChannel(bus, node, self._done)
        return self._channels[key]

    def _servers(self) -> Iterator[tuple[int, _Side]]:
        """Side by bus and identifier of servers that are not where CiA 301 puts them."""
        shadow = self._context.shadow
        usual = {(bus, node, 0x1200) for bus in self._buses for node in shadow.nodes_of(bus)}
        for bus, node, index in sorted(usual | self._told):
            for sub, base in ((1, 0x600), (2, 0x580)):
                can_id = self._moved_to(bus, node, index, sub)
                if can_id is None or (index, can_id) == (0x1200, base + node):
                    continue
                if not self._taken(bus, node, can_id):
                    channel = self._channel(bus, node, index)
                    yield bus << 11 | can_id, _Side(channel, sub == 1, can_id)

    def _moved_to(self, bus: int, node: int, index: int, sub: int) -> int | None:
        """Identifier of a server as the bus or its description tells; an EDS is often wrong."""
        shadow = self._context.shadow
        known = shadow.get(bus, node, index, sub)
        number = shadow.number(bus, node, index, sub)
        if known is None or number is None or known.source == "eds-default":
            return None
        return None if number & _EXTENDED_OR_OFF else number & 0x7FF or None

    def _taken(self, bus: int, node: int, can_id: int) -> bool:
        """Whether another node's server was heard on its usual identifiers: it is there."""
        other = self._channels.get((bus, can_id & 0x7F, 0x1200))
        usual = 0x580 < can_id < 0x680 and can_id & 0x7F != node
        return usual and other is not None and other.answers > 0

    def _boots_so(self, reset: Reset) -> bool:
        """Whether a device starts with a state byte, and did not fall by an error (1029h:1 = 0)."""
        shadow, key = self._context.shadow, (reset.bus, reset.node)
        if not reset.byte:
            return True
        boots = reset.byte in quirks(shadow.device(*key)).bootup_bytes
        return boots and shadow.confirmed(*key, 0x1029, 1, reset.seq) != 0

    def _reset(self, reset: Reset) -> None:
        shadow = self._context.shadow
        nodes = [node for bus, node in shadow.nodes() if bus == reset.bus]
        for node in nodes if reset.node == 0 else [reset.node]:
            shadow.reset(reset.bus, node, reset.seq, reset.t_ns, reset.specifier)
        for (bus, node, _), channel in self._channels.items():
            if bus == reset.bus and reset.node in (0, node):
                channel.interrupt(reset.seq, reset.t_ns)
        self._locate_again = True

    def _done(self, channel: SdoChannel, transfer: Transfer) -> None:
        bus, node = channel.bus, channel.node
        transfer.client_id = channel.client_id
        self._note(bus, node, transfer)
        if transfer.result == "ok":
            if transfer.whole:
                self._learn(bus, node, transfer)
        elif transfer.abort_code == OBJECT_MISSING and transfer.abort_by == "server":
            self._context.shadow.refuse(bus, node, transfer.index, transfer.sub)

    def _note(self, bus: int, node: int, transfer: Transfer) -> None:
        """Count a transfer, and keep it for its row; failed ones are kept twice as long."""
        numbers = self._counts.setdefault((bus, node), [0, 0, 0, 0, 0])
        numbers[0] += 1
        numbers[1] += transfer.result == "abort"
        numbers[2] += transfer.result == "no answer"
        numbers[4] += transfer.answered_ns is not None
        failed = transfer.result != "ok"
        if len(self._ended) < MAX_ROWS * (1 + failed):
            self._ended.append((bus, node, transfer))
        else:
            self._unlisted += 1

    def _learn(self, bus: int, node: int, transfer: Transfer) -> None:
        shadow = self._context.shadow
        value = shadow_value(shadow.device(bus, node), transfer)
        write = transfer.direction == "download"
        if write and transfer.index == 0x1010 and value == SAVE_SIGNATURE:
            shadow.save(bus, node, transfer.end_seq, transfer.sub)
        elif write and transfer.index == 0x1011 and value == LOAD_SIGNATURE:
            shadow.restore(bus, node, transfer.end_seq, transfer.sub)
        else:
            source = "sdo-write" if write else "sdo-read"
            known = Known(value, source, transfer.end_seq, transfer.end_ns)  # type: ignore[arg-type]
            shadow.learn(bus, node, transfer.index, transfer.sub, known)
            if transfer.index in _SERVERS and transfer.sub in (1, 2):
                self._follow(bus, node, transfer, value)

    def _follow(self, bus: int, node: int, transfer: Transfer, value: int | bytes) -> None:
        """Look for servers anew, unless one only says that it is where it always was."""
        server = (bus, node, transfer.index)
        base = 0x600 if transfer.sub == 1 else 0x580
        usual = (transfer.index, value) == (0x1200, base + node)
        if usual and server not in self._told and not self._moved:
            return
        self._told.add(server)
        self._locate_again = True

    def _count(self, table: SdoTable) -> None:
        counts = {key: list(numbers) for key, numbers in self._counts.items()}
        for (bus, node, _), channel in self._channels.items():
            counts.setdefault((bus, node), [0, 0, 0, 0, 0])[3] += channel.answers
            strays = table.strays.setdefault((bus, node), Strays())
            strays.add(channel.strays)
            table.oddities.setdefault((bus, node), []).extend(channel.oddities)
        for key, numbers in counts.items():
            table.counts[key] = SdoNodeCounts(*numbers)
            table.oddities[key].sort(key=lambda odd: odd.seq)


def _irregular(transfer: Transfer) -> bool:
    return bool(
        transfer.ended_by or transfer.toggle_errors or transfer.repeated or not transfer.whole
    )
