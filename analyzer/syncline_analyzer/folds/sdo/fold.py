"""SDO transfers, and what they teach the object-dictionary shadow."""

from collections.abc import Iterable, Iterator
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.sdo.channel import SdoChannel
from syncline_analyzer.folds.sdo.log import Ended, SdoLog
from syncline_analyzer.folds.sdo.pairs import SERVERS, Plain
from syncline_analyzer.folds.sdo.stretch import Side, Stretch
from syncline_analyzer.folds.sdo.teacher import Lesson, Teacher
from syncline_analyzer.folds.sdo.transfer import Oddity, Strays, Transfer
from syncline_analyzer.results import SdoTransfers
from syncline_schemas.batch import Gap
from syncline_schemas.canopen.services import Service
from syncline_schemas.devices import quirks
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

OBJECT_MISSING = 0x06020000
_EXTENDED_OR_OFF = 0xA0000000
_Rows = NDArray[np.intp]


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

    `unlisted` counts those that are too many to be listed. `oddities` are answers that should not
    be, in the order of their frames.
    """

    rows: SdoTransfers = field(default_factory=SdoTransfers.of)
    counts: dict[tuple[int, int], SdoNodeCounts] = field(default_factory=dict)
    strays: dict[tuple[int, int], Strays] = field(default_factory=dict)
    oddities: dict[tuple[int, int], list[Oddity]] = field(default_factory=dict)
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
        self._usual: dict[int, Side] = {}
        self._moved: dict[int, Side] = {}
        self._told: set[tuple[int, int, int]] = set()
        """(bus, node, index) of servers of which the bus told something."""
        self._buses: set[int] = set()
        self._locate_again = True
        self._stretch: Stretch | None = None
        """Frames that are just being taken in."""
        self._ended: list[Ended] = []
        self._lessons: list[Lesson] = []
        """Of what ended since the log and the shadow were told last."""
        self._turned = False
        """Whether one of them may tell where a server is."""
        self._teacher = Teacher(context.shadow)
        self._log = SdoLog()
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
        self._settle()

    def finish(self, end_ns: int) -> SdoTable:
        """All transfers; those still running end with the capture."""
        for channel in self._channels.values():
            channel.finish(end_ns, self._context.timed)
        self._settle()
        table = SdoTable(self._log.table(self._context), unlisted=self._log.unlisted)
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
        """Row at which a server was moved, -1 where none was.

        Plain transfers are taken in in runs, all others frame by frame.
        """
        if not len(rows):
            return -1
        self._stretch = stretch = Stretch(batch, rows, self._side)
        for at in stretch.singles():
            stretch.feed(at)
            if self._turned:
                self._settle(stretch.catch_up(at))
            if self._locate_again:
                stretch.open_asks(at)
                self._settle()
                self._stretch = None
                return int(rows[at])
        self._settle(stretch.catch_up())
        self._stretch = None
        return -1

    def _side(self, key: int) -> Side:
        """Side of an identifier: where a moved server is, else by the identifier itself."""
        if key in self._moved:
            return self._moved[key]
        if key not in self._usual:
            channel = self._channel(key >> 11, key & 0x7F, 0x1200)
            self._usual[key] = Side(channel, key & 0x780 == 0x600, key & 0x7FF)
        return self._usual[key]

    def _channel(self, bus: int, node: int, server: int) -> SdoChannel:
        key = (bus, node, server)
        if key not in self._channels:
            self._channels[key] = SdoChannel(bus, node, self._done)
        return self._channels[key]

    def _servers(self) -> Iterator[tuple[int, Side]]:
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
                    yield bus << 11 | can_id, Side(channel, sub == 1, can_id)

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
        """Take in a transfer that is not plain; what it tells, before a later answer changes it."""
        place = self._stretch.place if self._stretch is not None else 0
        transfer.client_id = channel.client_id
        self._ended.append(Ended(place, channel, transfer))
        numbers = self._numbers(channel)
        numbers[0] += 1
        numbers[1] += transfer.result == "abort"
        numbers[2] += transfer.result == "no answer"
        numbers[4] += transfer.answered_ns is not None
        refused = transfer.abort_code == OBJECT_MISSING and transfer.abort_by == "server"
        if refused or (transfer.result == "ok" and transfer.whole):
            self._lessons.append(_lesson(place, channel, transfer))
            self._turned |= transfer.result == "ok" and transfer.index in SERVERS

    def _numbers(self, channel: SdoChannel) -> list[int]:
        return self._counts.setdefault((channel.bus, channel.node), [0, 0, 0, 0, 0])

    def _settle(self, plain: Plain | None = None) -> None:
        """Tell the log and the shadow what ended, in the order in which it did."""
        ended = sorted(self._ended, key=lambda each: each.place)
        lessons = sorted(self._lessons, key=lambda each: each.place)
        self._ended, self._lessons, self._turned = [], [], False
        if self._stretch is None or plain is None:
            self._log.add(ended)
            told = [(each, self._teacher.take(each)) for each in lessons]
        else:
            channels = self._stretch.channels
            for channel, count in zip(channels, np.bincount(plain.channel).tolist(), strict=False):
                self._numbers(channel)[0] += count
                self._numbers(channel)[4] += count
            self._log.add(ended, plain, channels)
            told = self._teacher.teach(lessons, plain, channels)
        for lesson, value in told:
            self._follow(lesson, value)

    def _follow(self, lesson: Lesson, value: int | bytes | None) -> None:
        """Look for servers anew, unless one only says that it is where it always was."""
        index, sub = lesson.key
        if index not in SERVERS or sub not in (1, 2) or value is None:
            return
        server = (lesson.bus, lesson.node, index)
        usual = (index, value) == (0x1200, (0x600 if sub == 1 else 0x580) + lesson.node)
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


def _lesson(place: int, channel: SdoChannel, transfer: Transfer) -> Lesson:
    return Lesson(
        place,
        channel.bus,
        channel.node,
        (transfer.index, transfer.sub),
        transfer.direction == "download",
        bytes(transfer.data) if transfer.result == "ok" else None,
        transfer.end_seq,
        transfer.end_ns,
    )
