"""Batches of frames in, parts with words out: the state that decoding needs, and who is meant."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.decode.choice import Choice
from syncline_analyzer.decode.part import Head, Part, Rows, Tone, Words, distinct
from syncline_analyzer.decode.pdo_words import pdo_words
from syncline_analyzer.decode.sdo_words import SdoTalk, plain_words, stands_alone
from syncline_analyzer.decode.services import (
    GUARD_REQUEST,
    emcy_words,
    error_control_words,
    error_words,
    lss_words,
    nmt_words,
    sync_words,
    time_words,
)
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.emcy.ids import SYNC_BYTES, EmcyIds
from syncline_analyzer.folds.nmt.fold import NmtFold
from syncline_analyzer.folds.sdo.fold import Reset, SdoFold
from syncline_analyzer.grouping import BUS_SHIFT, REMOTE_KEY
from syncline_analyzer.pdo_binding import Pdo, PdoBindings
from syncline_analyzer.redaction import Redaction, Veil
from syncline_analyzer.service_ids import cob_id, sync_id
from syncline_analyzer.views.words import node_label
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.devices import quirks
from syncline_schemas.devices.model import Key

REDACTED = Words("payload dropped (redacted)", Tone.PLAIN)
_SYNC_ID, _TIME_ID = 0x80, 0x100
_SERVERS = range(0x1200, 0x1280)
_LSS_REQUEST = 0x7E5
LAST_11_BIT = 0x7FF
_FAMILIES = {
    Service.NMT: ("NMT", "nmt"),
    Service.SYNC: ("SYNC", "sync"),
    Service.EMCY: ("EMCY", "emcy"),
    Service.TIME: ("TIME", "time"),
    Service.PDO: ("PDO", "pdo"),
    Service.SDO_ANSWER: ("SDO ans", "sdo"),
    Service.SDO_REQUEST: ("SDO req", "sdo"),
    Service.ERROR_CONTROL: ("heartbeat", "heartbeat"),
    Service.LSS: ("LSS", "lss"),
    Service.NONE: ("-", "other"),
}
_WITH_NODE = (
    Service.EMCY,
    Service.PDO,
    Service.SDO_ANSWER,
    Service.SDO_REQUEST,
    Service.ERROR_CONTROL,
)


class FrameDecoder:
    """Tells of every frame what it says by what was seen before it.

    Batches come in capture order; mappings and identifiers that SDO transfers change hold from the
    very frame on. What a later batch reveals is not known of an earlier one.
    """

    def __init__(self, context: Context, redaction: Redaction | None = None) -> None:
        self._context = context
        self._redaction = redaction or Redaction()
        self._veil = Veil(self._redaction)
        self._nmt = NmtFold(context)
        self._sdo = SdoFold(context)
        self._emcy_ids = EmcyIds(context)
        self._bindings = PdoBindings(context.shadow)
        self._guarded: set[tuple[int, int]] = set()
        self._talks: dict[tuple[int, int, int], SdoTalk] = {}
        self._labels: dict[tuple[int, int], str] = {}
        self._version = -1

    def gap(self, gap: Gap) -> None:
        """Take in that nothing was heard for a while."""
        self._nmt.gap(gap)
        self._sdo.gap(gap)
        for key in [key for key in self._talks if gap.bus in (None, key[0])]:
            del self._talks[key]

    def update(self, batch: IndexedBatch, choice: Choice) -> Iterator[Part]:
        """Take in the next frames, and tell what the chosen ones of them say."""
        wanted = choice.rows(batch)
        hidden = self._redaction.covers(batch.frames) if self._redaction else None
        shown = batch
        if hidden is not None:
            batch = batch.showing(self._veil.hidden(batch.frames))
        resets = self._nmt.update(batch)
        self._sdo.update(batch, resets)
        boots = {reset.seq for reset in resets if not reset.specifier and self._boots_so(reset)}
        if self._version != self._context.shadow.version:
            self._version = self._context.shadow.version
            self._labels.clear()
        if hidden is not None:
            yield from self._redacted(shown.frames, np.flatnonzero(hidden & wanted), choice)
            wanted = wanted & ~hidden
        yield from _Batch(self, batch, choice, wanted, boots).parts()

    def _boots_so(self, reset: Reset) -> bool:
        """Whether the device of a node starts with this state byte; of others it is a heartbeat."""
        device = self._context.shadow.device(reset.bus, reset.node)
        return not reset.byte or reset.byte in quirks(device).bootup_bytes

    def label(self, bus: int, node: int) -> str:
        """A node by number, and its name or that of its device."""
        key = bus, node
        if key not in self._labels:
            shadow = self._context.shadow
            device = shadow.device(bus, node)
            name = shadow.name(bus, node) or (device.name if device else None)
            self._labels[key] = node_label(node, name)
        return self._labels[key]

    def labels(self, bus: int) -> dict[int, str]:
        """Label by node of everything that is known on a bus."""
        return {node: self.label(bus, node) for node in self._context.shadow.nodes_of(bus)}

    def _redacted(self, frames: FrameBatch, rows: Rows, choice: Choice) -> Iterator[Part]:
        for number in np.unique(frames.can_id[rows]).tolist():
            mine = rows[frames.can_id[rows] == number]
            service = Service(int(SERVICE_OF_ID[number])) if number < 0x800 else Service.NONE
            name, family = _FAMILIES[service]
            node = number & 0x7F if service in _WITH_NODE else None
            head = Head(int(frames.bus[mine[0]]), number, name, family, node, number > 0x7FF)
            if choice.head(head):
                yield Part(head, mine, mine[:1], [REDACTED], np.zeros(len(mine), np.intp))


class _Batch:
    """One batch on its way through the decoder."""

    def __init__(
        self,
        owner: FrameDecoder,
        batch: IndexedBatch,
        choice: Choice,
        wanted: NDArray[np.bool_],
        boots: set[int],
    ) -> None:
        self._owner = owner
        self._context = owner._context
        self._bindings = owner._bindings
        self._batch = batch
        self._frames = batch.frames
        self._choice = choice
        self._wanted = wanted
        self._boots = boots
        self._all_wanted = bool(wanted.all())
        self._emcy = np.zeros(len(batch), np.uint8)
        self._moved: dict[tuple[int, int], tuple[int, bool, int]] = {}
        self._syncs: dict[int, set[int]] = {}
        self._times: dict[int, set[int]] = {}

    def parts(self) -> Iterator[Part]:
        """All parts of the batch, in no order."""
        batch = self._batch
        rows, nodes = self._owner._emcy_ids.frames(batch)
        self._emcy[rows] = nodes
        for bus in batch.buses:
            self._bindings.refresh(bus)
            self._locate(bus)
        grouping = batch.grouping
        edges = grouping.edges.tolist()
        self._note_guarding(grouping.keys.tolist())
        talks: dict[tuple[int, int, int], list[tuple[Rows, bool, int]]] = {}
        for place, key in enumerate(grouping.keys.tolist()):
            bus, can_id = key >> BUS_SHIFT, key & 0x7FF
            mine = grouping.rows[edges[place] : edges[place + 1]]
            if batch.flags_seen & FrameFlag.FD:
                fd = (self._frames.flags[mine] & FrameFlag.FD) != 0
                yield from self._opaque(bus, can_id, mine[fd], "CAN FD")
                mine = mine[~fd]
            if not len(mine):
                continue
            if key & REMOTE_KEY:
                yield from self._remote(bus, can_id, mine)
            elif (talk := self._talk(bus, can_id)) is not None:
                node, request, server = talk
                talks.setdefault((bus, node, server), []).append((mine, request, can_id))
            else:
                yield from self._group(bus, can_id, mine)
        for (bus, node, server), sides in talks.items():
            yield from self._sdo_parts(bus, node, server, sides)
        yield from self._others()

    def _note_guarding(self, keys: list[int]) -> None:
        """Note which nodes are asked for their state, so that their answers are told as such."""
        for key in keys:
            can_id = key & 0x7FF
            if key & REMOTE_KEY and SERVICE_OF_ID[can_id] == Service.ERROR_CONTROL:
                self._owner._guarded.add((key >> BUS_SHIFT, can_id & 0x7F))

    def _locate(self, bus: int) -> None:
        """Where the nodes of a bus put SYNC, TIME and SDO servers, now or before this batch."""
        shadow = self._context.shadow
        syncs, times = {_SYNC_ID}, {_TIME_ID}
        for node in shadow.nodes_of(bus):
            for seq in (self._batch.seq0, self._batch.last_seq):
                syncs.add(sync_id(shadow, bus, node, seq))
                value = shadow.number(bus, node, 0x1012, 0, seq)
                if value is not None and (moved := cob_id(value & 0x7FFFFFFF)):
                    times.add(moved)
            for (index, sub), _ in shadow.history(bus, node):
                if index in _SERVERS and sub in (1, 2):
                    value = shadow.confirmed(bus, node, index, sub)
                    if value is not None and (moved := cob_id(value)):
                        self._moved[bus, moved] = (node, sub == 1, index)
        self._syncs[bus], self._times[bus] = syncs, times

    def _talk(self, bus: int, can_id: int) -> tuple[int, bool, int] | None:
        """Node, direction and server of an SDO identifier."""
        if (bus, can_id) in self._moved:
            return self._moved[bus, can_id]
        service = SERVICE_OF_ID[can_id]
        if service not in (Service.SDO_ANSWER, Service.SDO_REQUEST):
            return None
        pdo = self._bindings.owner(bus, can_id, self._batch.last_seq)
        if pdo is not None and not pdo.guess:
            return None
        return can_id & 0x7F, service == Service.SDO_REQUEST, _SERVERS.start

    def _chosen(self, head: Head, rows: Rows) -> Rows:
        if not self._choice.head(head):
            return rows[:0]
        return rows if self._all_wanted else rows[self._wanted[rows]]

    def _parts(self, head: Head, rows: Rows, say: Callable[[Rows], list[Words]]) -> Iterator[Part]:
        """The chosen ones of these rows, those of equal content put into words once."""
        rows = self._chosen(head, rows)
        if len(rows):
            first, which = distinct(self._frames, rows)
            yield Part(head, rows, first, say(first), which)

    def _simple(self, head: Head, rows: Rows, say: Callable[[bytes], Words]) -> Iterator[Part]:
        """The same, where the bytes of a frame say everything."""
        payload = self._frames.payload
        yield from self._parts(
            head, rows, lambda first: [say(payload(row)) for row in first.tolist()]
        )

    def _group(self, bus: int, can_id: int, rows: Rows) -> Iterator[Part]:
        """Data frames of one 11-bit identifier that is none of SDO."""
        service = SERVICE_OF_ID[can_id]
        if service == Service.NMT:
            yield from self._nmt(bus, rows)
        elif service == Service.LSS:
            request = can_id == _LSS_REQUEST
            head = Head(bus, can_id, "LSS req" if request else "LSS ans", "lss")
            yield from self._simple(head, rows, partial(lss_words, request=request))
        elif service == Service.ERROR_CONTROL:
            yield from self._error_control(bus, can_id, rows)
        else:
            yield from self._mixed(bus, can_id, rows)

    def _nmt(self, bus: int, rows: Rows) -> Iterator[Part]:
        """NMT commands; each node that is commanded has a head of its own."""
        names = self._owner.labels(bus)
        target = np.where(self._frames.dlc[rows] == 2, self._frames.data[rows, 1], 255)
        for node in np.unique(target).tolist():
            head = Head(bus, 0, "NMT", "nmt", node if node < 128 else None)
            yield from self._simple(head, rows[target == node], partial(nmt_words, names=names))

    def _error_control(self, bus: int, can_id: int, rows: Rows) -> Iterator[Part]:
        node = can_id & 0x7F
        guarded = (bus, node) in self._owner._guarded
        device = self._context.shadow.device(bus, node)
        empty = guarded and quirks(device).empty_heartbeat_after_rtr
        boots = np.isin(self._batch.seqs_at(rows), list(self._boots))
        for mine, boot in ((rows[~boots], False), (rows[boots], True)):
            service = "guarding" if guarded and not boot else "heartbeat"
            head = Head(bus, can_id, service, "heartbeat", node)
            say = partial(error_control_words, guarded=guarded, boots=boot, empty=empty)
            yield from self._simple(head, mine, say)

    def _mixed(self, bus: int, can_id: int, rows: Rows) -> Iterator[Part]:
        """Frames that are EMCY, SYNC, TIME or PDO by what nodes were told."""
        senders = self._emcy[rows]
        for node in np.unique(senders[senders > 0]).tolist():
            yield from self._emcys(bus, can_id, node, rows[senders == node])
        rows = rows[senders == 0]
        if not len(rows):
            return
        if can_id in self._syncs[bus]:
            sync = self._frames.dlc[rows] <= SYNC_BYTES
            yield from self._simple(Head(bus, can_id, "SYNC", "sync"), rows[sync], sync_words)
            rows = rows[~sync]
        if can_id in self._times[bus]:
            yield from self._simple(Head(bus, can_id, "TIME", "time"), rows, time_words)
        elif len(rows):
            yield from self._pdos(bus, can_id, rows)

    def _emcys(self, bus: int, can_id: int, node: int, rows: Rows) -> Iterator[Part]:
        device = self._context.shadow.device(bus, node)
        head = Head(bus, can_id, "EMCY", "emcy", node)
        yield from self._simple(head, rows, partial(emcy_words, device))

    def _pdos(self, bus: int, can_id: int, rows: Rows) -> Iterator[Part]:
        """Frames of one identifier, from cut to cut of what it carries."""
        seqs = self._batch.seqs_at(rows)
        cuts = self._bindings.cuts(bus, can_id, int(seqs[0]), int(seqs[-1]))
        edges = [0, *np.searchsorted(seqs, cuts).tolist(), len(rows)]
        for begin, stop in pairwise(edges):
            if begin == stop:
                continue
            pdo = self._bindings.owner(bus, can_id, int(seqs[begin]))
            if pdo is None:
                yield from self._opaque(bus, can_id, rows[begin:stop], "-")
            else:
                yield from self._pdo(pdo, can_id, rows[begin:stop], int(seqs[begin]))

    def _pdo(self, pdo: Pdo, can_id: int, rows: Rows, seq: int) -> Iterator[Part]:
        guess = "?" if pdo.guess else ""
        service = f"{pdo.kind.upper()}{pdo.number}{guess}"
        head = Head(pdo.bus, can_id, service, "pdo", pdo.node)

        def say(first: Rows) -> list[Words]:
            mapping = self._bindings.mapping(pdo, seq)
            device = self._context.shadow.device(pdo.bus, pdo.node)
            return pdo_words(mapping, device, self._frames, first, self._assumed(pdo, seq))

        yield from self._parts(head, rows, say)

    def _assumed(self, pdo: Pdo, seq: int) -> Callable[[Key], bool]:
        """Whether nobody told the value of an object of the PDO's node, but its device's file."""

        def assumed(key: Key) -> bool:
            known = self._context.shadow.get(pdo.bus, pdo.node, *key, seq)
            return known is None or known.source == "eds-default"

        return assumed

    def _remote(self, bus: int, can_id: int, rows: Rows) -> Iterator[Part]:
        if SERVICE_OF_ID[can_id] == Service.ERROR_CONTROL:
            head = Head(bus, can_id, "guarding", "heartbeat", can_id & 0x7F)
            words = GUARD_REQUEST
        else:
            pdo = self._bindings.owner(bus, can_id, self._batch.last_seq)
            if pdo is None:
                head = Head(bus, can_id, "-", "other")
                words = Words("remote frame", Tone.PLAIN)
            else:
                head = Head(bus, can_id, f"{pdo.kind.upper()}{pdo.number}", "pdo", pdo.node)
                words = Words("request for the PDO (remote frame)", Tone.QUIET)
        rows = self._chosen(head, rows)
        if len(rows):
            yield Part(head, rows, rows[:1], [words], np.zeros(len(rows), np.intp))

    def _sdo_parts(
        self, bus: int, node: int, server: int, sides: list[tuple[Rows, bool, int]]
    ) -> Iterator[Part]:
        """Requests and answers of one server, in their order where they belong together."""
        talk = self._owner._talks.setdefault((bus, node, server), SdoTalk())
        device = self._context.shadow.device(bus, node)
        if talk.idle and all(self._stand_alone(rows, request) for rows, request, _ in sides):
            for rows, request, can_id in sides:
                head = _sdo_head(bus, can_id, node, request)
                yield from self._simple(head, rows, partial(plain_words, device, request=request))
            return
        yield from self._in_order(bus, node, talk, sides)

    def _in_order(
        self, bus: int, node: int, talk: SdoTalk, sides: list[tuple[Rows, bool, int]]
    ) -> Iterator[Part]:
        """Segments and blocks say something only by what went before."""
        device = self._context.shadow.device(bus, node)
        said: dict[int, Words] = {}
        frames = sorted((row, request) for rows, request, _ in sides for row in rows.tolist())
        for row, request in frames:
            speak = talk.request if request else talk.answer
            said[row] = speak(device, self._frames.payload(row))
        for rows, request, can_id in sides:
            head = _sdo_head(bus, can_id, node, request)
            mine = self._chosen(head, rows)
            if len(mine):
                words = [said[row] for row in mine.tolist()]
                yield Part(head, mine, mine, words, np.arange(len(mine)))

    def _stand_alone(self, rows: Rows, request: bool) -> bool:
        alone = _ALONE[request][self._frames.data[rows, 0]]
        return bool(alone.all()) and bool((self._frames.dlc[rows] > 0).all())

    def _opaque(self, bus: int, can_id: int, rows: Rows, service: str) -> Iterator[Part]:
        words = Words("" if service == "-" else "not of CANopen", opaque=True)
        head = Head(bus, can_id, service, "other", extended=can_id > LAST_11_BIT)
        yield from self._parts(head, rows, lambda first: [words] * len(first))

    def _others(self) -> Iterator[Part]:
        """Error frames and frames with 29-bit identifiers."""
        if not self._batch.flags_seen & (FrameFlag.ERROR | FrameFlag.EXTENDED):
            return
        frames = self._frames
        error = (frames.flags & FrameFlag.ERROR) != 0
        extended = ~error & ((frames.flags & FrameFlag.EXTENDED) != 0)
        for bus, can_id, rows in _by_id(frames, np.flatnonzero(error)):
            head = Head(bus, can_id, "error", "error", extended=True)
            yield from self._simple(head, rows, partial(error_words, can_id))
        for bus, can_id, rows in _by_id(frames, np.flatnonzero(extended)):
            head = Head(bus, can_id, "29-bit", "other", extended=True)
            yield from self._parts(head, rows, _not_canopen)


def _not_canopen(first: Rows) -> list[Words]:
    return [Words("not of CANopen", opaque=True)] * len(first)


def _by_id(frames: FrameBatch, rows: Rows) -> Iterator[tuple[int, int, Rows]]:
    """Bus, identifier and rows of each group of them."""
    key = frames.bus[rows].astype(np.int64) << 32 | frames.can_id[rows]
    for each in np.unique(key).tolist():
        yield each >> 32, each & 0xFFFFFFFF, rows[key == each]


def _sdo_head(bus: int, can_id: int, node: int, request: bool) -> Head:
    return Head(bus, can_id, "SDO req" if request else "SDO ans", "sdo", node)


_ALONE = {
    request: np.array([stands_alone(command, request=request) for command in range(256)])
    for request in (False, True)
}
"""(256,) whether a frame stands alone by its first byte."""
