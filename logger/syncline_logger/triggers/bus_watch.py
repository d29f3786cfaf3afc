"""One bus: its frames, batch after batch, as events of its nodes."""

from collections.abc import Callable, Iterator
from functools import partial
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from syncline_logger.node_objects import PDO_PARAMETERS
from syncline_logger.sdo_listener import LearnedValue, SdoListener
from syncline_logger.triggers.event import Event
from syncline_logger.triggers.knowledge import (
    EMCY_ID,
    PRODUCER_TIME,
    Knowledge,
    reset_by_write,
)
from syncline_logger.triggers.node_watch import NodeWatch
from syncline_logger.triggers.quiet import BusQuiet
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.canopen.nmt import STATE_AFTER_COMMAND
from syncline_schemas.canopen.sdo import abort_meaning
from syncline_schemas.canopen.services import Service, predefined_pdo, service_of
from syncline_schemas.decoder import SdoKind
from syncline_schemas.description import NodeEntry
from syncline_schemas.devices import identity_objects

Act = Callable[[], Iterator[Event]]
Rows = NDArray[np.intp]
SYNC_BYTES = 1
"""A SYNC is empty or carries its counter; on an EMCY's identifier it is no EMCY."""
RESET_NODE = 0x81
MIN_SILENCE_NS = 1_000_000
"""Shorter silences are no node's loss [ns]."""
_LIVES = (Service.EMCY, Service.SDO_ANSWER, Service.ERROR_CONTROL)


class BusWatch:
    """State machine of one bus, fed with all its frames in order."""

    def __init__(self, bus: int, described: dict[int, NodeEntry]) -> None:
        self._bus = bus
        self._knowledge = Knowledge(described)
        self._quiet = BusQuiet()
        self._nodes: dict[int, NodeWatch] = {}
        self._sdo = SdoListener()
        self._sender = np.zeros(0x800, np.uint8)
        self._stale = True
        self._cuts: list[int] = []

    def update(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> list[Event]:
        """Events of a batch of this bus, in order of the frames."""
        standard = (frames.flags & (FrameFlag.EXTENDED | FrameFlag.ERROR)) == 0
        rows = np.flatnonzero(standard)
        if not len(rows):
            return []
        frames, log_ns = frames[rows], log_ns[rows]
        remote = (frames.flags & FrameFlag.REMOTE) != 0
        service = service_of(frames)
        self._quiet.hear(frames.t_ns)
        acts = [
            *self._sdo_acts(frames, log_ns, service, remote),
            *self._command_acts(frames, log_ns, service, remote),
        ]
        events: list[Event] = []
        begin = 0
        for end in [*self._cuts, len(frames)]:
            part = slice(begin, end)
            own = [(row - begin, order, act) for row, order, act in acts if begin <= row < end]
            events += self._part(frames[part], log_ns[part], service[part], remote[part], own)
            begin = end
        now_ns, now_log_ns = int(frames.t_ns[-1]), int(log_ns[-1])
        for watch in self._nodes.values():
            events += watch.silent_until(now_ns, now_log_ns)
        return events

    def _part(
        self,
        frames: FrameBatch,
        log_ns: NDArray[np.int64],
        service: NDArray[np.uint8],
        remote: NDArray[np.bool_],
        acts: list[tuple[int, int, Act]],
    ) -> list[Event]:
        """Events of frames within which no identifier changes its sender."""
        if not len(frames):
            return []
        if self._stale:
            self._name_senders()
        sender = np.where(remote, 0, self._sender[frames.can_id & 0x7FF])
        sender[(service == Service.EMCY) & (frames.dlc <= SYNC_BYTES)] = 0
        sender[(service == Service.ERROR_CONTROL) & (frames.dlc == 0)] = 0
        for node in np.unique(sender[sender > 0]).tolist():
            acts += self._node_acts(node, np.flatnonzero(sender == node), frames, log_ns, service)
        asked = np.flatnonzero(remote & (service == Service.ERROR_CONTROL))
        for row in asked.tolist():
            node, t_ns = int(frames.can_id[row]) & 0x7F, int(frames.t_ns[row])
            acts.append((row, 2, partial(_request, self._watch(node), t_ns)))
        acts.sort(key=itemgetter(0, 1))
        return [event for _, _, act in acts for event in act()]

    def gap(self) -> None:
        """The recorder was blind."""
        self._quiet.gap()
        for watch in self._nodes.values():
            watch.gap()

    def finish(self, log_ns: int) -> list[Event]:
        """Events that only the end makes sure: nodes that are silent up to it."""
        now_ns = self._quiet.last_ns
        if now_ns is None:
            return []
        nodes = self._nodes.values()
        return [event for watch in nodes for event in watch.silent_until(now_ns, log_ns, over=True)]

    def _watch(self, node: int) -> NodeWatch:
        if node not in self._nodes:
            self._nodes[node] = NodeWatch(self._bus, node, self._knowledge, self._quiet)
        return self._nodes[node]

    def _name_senders(self) -> None:
        """Which node sends on which identifier: by what is known of its objects, else predefined."""
        self._stale = False
        self._sender[:] = 0
        for can_id in range(0x181, 0x580):
            pdo = predefined_pdo(can_id)
            if pdo is not None and pdo[0] == "tpdo":
                self._sender[can_id] = pdo[2]
        for base in (0x080, 0x580, 0x700):
            self._sender[base + 1 : base + 0x80] = np.arange(1, 0x80)
        for node, objects in self._knowledge.nodes.items():
            for binding in objects.bindings():
                self._sender[binding.can_id] = node if binding.direction == "tpdo" else 0
            moved = objects.told(EMCY_ID, 0)
            if moved is not None and 0 < moved < 0x800:
                self._sender[moved] = node

    def _sdo_acts(
        self,
        frames: FrameBatch,
        log_ns: NDArray[np.int64],
        service: NDArray[np.uint8],
        remote: NDArray[np.bool_],
    ) -> Iterator[tuple[int, int, Act]]:
        self._cuts.clear()
        sdo = (service == Service.SDO_REQUEST) | (service == Service.SDO_ANSWER)
        rows = np.flatnonzero(sdo & ~remote)
        if not len(rows):
            return
        done = self._sdo.update(frames, rows)
        for value in done.learned:
            if self._moves(value):
                self._cuts.append(value.row + 1)
            yield value.row, 1, partial(self._learn, value, int(frames.t_ns[value.row]))
        aborts = np.flatnonzero((done.columns.kind == SdoKind.ABORT) & ~done.segment)
        for at in aborts.tolist():
            row, node = int(rows[at]), int(done.node[at])
            code = int.from_bytes(frames.data[row, 4:8].tobytes(), "little")
            index = int.from_bytes(frames.data[row, 1:3].tobytes(), "little")
            place = f"{index:04X}h:{int(frames.data[row, 3]):02X}"
            text = f"node {node}: SDO abort {code:08X}h at {place}: {abort_meaning(code)}"
            t_ns, at_ns = int(frames.t_ns[row]), int(log_ns[row])
            event = Event("sdo-abort", t_ns, at_ns, text, self._bus, node, code)
            yield row, 3, partial(_one, event)

    def _moves(self, value: LearnedValue) -> bool:
        """Whether a value may change who sends on which identifier."""
        known = self._knowledge.nodes.get(value.node)
        before = known.value((value.index, value.sub)) if known else None
        return (value.index == EMCY_ID or value.index in PDO_PARAMETERS) and before != value.data

    def _learn(self, value: LearnedValue, t_ns: int) -> Iterator[Event]:
        self._stale |= self._moves(value) or value.index in identity_objects()
        self._knowledge.learn(value, t_ns)
        if reset_by_write(self._knowledge, value):
            yield from self._watch(value.node).command(t_ns, RESET_NODE, t_ns)
        if value.index == PRODUCER_TIME and value.written:
            self._watch(value.node).forget_periods()

    def _command_acts(
        self,
        frames: FrameBatch,
        log_ns: NDArray[np.int64],
        service: NDArray[np.uint8],
        remote: NDArray[np.bool_],
    ) -> Iterator[tuple[int, int, Act]]:
        rows = np.flatnonzero((service == Service.NMT) & ~remote & (frames.dlc == 2))
        for row in rows.tolist():
            specifier, node = int(frames.data[row, 0]), int(frames.data[row, 1])
            if specifier in STATE_AFTER_COMMAND:
                t_ns, at_ns = int(frames.t_ns[row]), int(log_ns[row])
                yield row, 1, partial(self._command, node, t_ns, specifier, at_ns)

    def _command(self, node: int, t_ns: int, specifier: int, log_ns: int) -> Iterator[Event]:
        nodes = list(self._nodes.values()) if node == 0 else [self._watch(node)]
        for watch in nodes:
            yield from watch.command(t_ns, specifier, log_ns)

    def _node_acts(
        self,
        node: int,
        rows: Rows,
        frames: FrameBatch,
        log_ns: NDArray[np.int64],
        service: NDArray[np.uint8],
    ) -> Iterator[tuple[int, int, Act]]:
        """What the frames of one node may bring, with their rows."""
        watch = self._watch(node)
        t_ns = frames.t_ns[rows]
        control = service[rows] == Service.ERROR_CONTROL
        one_byte = control & (frames.dlc[rows] == 1)
        byte = frames.data[rows, 0]
        boots = one_byte & (byte == 0)
        before = np.concatenate(
            ([t_ns[0] if watch.heard_ns is None else watch.heard_ns], t_ns[:-1])
        )
        first = watch.heard_ns is None
        for at in np.flatnonzero(t_ns - before > self._least_silence(watch)).tolist():
            row = int(rows[at])
            yield (
                row,
                0,
                partial(
                    watch.heard,
                    int(before[at]),
                    int(t_ns[at]),
                    int(log_ns[row]),
                    boots=bool(boots[at]),
                ),
            )
        for at in np.flatnonzero(one_byte).tolist():
            row, told = int(rows[at]), int(byte[at])
            at_ns, taken_ns = int(t_ns[at]), int(log_ns[row])
            last_ns = None if first and at == 0 else int(before[at])
            yield row, 2, partial(_told, watch, told, at_ns, taken_ns, last_ns)
        emcys = (service[rows] == Service.EMCY) | (
            ~control & (service[rows] == Service.PDO) & self._moved_emcy(node, frames.can_id[rows])
        )
        for at in np.flatnonzero(emcys).tolist():
            row = int(rows[at])
            yield row, 2, partial(watch.emcy, frames.payload(row), int(t_ns[at]), int(log_ns[row]))
        yield int(rows[-1]), 9, partial(watch.back, int(t_ns[-1]))

    def _least_silence(self, watch: NodeWatch) -> int:
        """A silence that may matter: any that is longer than half the usual period."""
        limit = watch.limit_ns()
        return MIN_SILENCE_NS if limit is None else max(limit // 3, MIN_SILENCE_NS)

    def _moved_emcy(self, node: int, can_id: NDArray[np.uint32]) -> NDArray[np.bool_]:
        known = self._knowledge.nodes.get(node)
        moved = known.told(EMCY_ID, 0) if known else None
        found: NDArray[np.bool_] = can_id == (moved or 0)
        return found


def _one(event: Event) -> Iterator[Event]:
    yield event


def _request(watch: NodeWatch, t_ns: int) -> Iterator[Event]:
    watch.request(t_ns)
    return iter(())


def _told(
    watch: NodeWatch, byte: int, t_ns: int, log_ns: int, before_ns: int | None
) -> Iterator[Event]:
    if byte:
        watch.beat(t_ns)
        yield from watch.told(byte, t_ns, log_ns)
    else:
        yield from watch.zero(t_ns, log_ns, before_ns)
        watch.restarted()
