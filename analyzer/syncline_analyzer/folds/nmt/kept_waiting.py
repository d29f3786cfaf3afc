"""Heartbeats that waited for other frames: when the bus was free for each of them last.

A heartbeat has one of the highest identifiers of all. While the bus is never idle it stands in the
arbitration, and no frame of a higher identifier gets through either (ISO 11898-1). So a node whose
heartbeat comes late was late itself only if the bus was free for it before.
"""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.distinct import distinct
from syncline_analyzer.folds.nmt.events import KeptWaiting, Lost
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.on_wire import OnWire
from syncline_analyzer.results import NmtStateRow
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.records import dataclass
from syncline_schemas.wire_length import INTERMISSION_BITS

FIRST_ID = 0x700
MAX_NODE = 127
BOOT_UP_NS = 1_000_000_000
"""A boot-up this soon after a silence belongs to it [ns]."""
_WORTH = 0.05
"""Waiting that makes up less of a heartbeat's period is let be."""
_LONGER = 1.3
"""Nor is one looked at that is not so many times as long as the shortest of the last three."""
_FULL = 0.9
"""So much of the time that frames took on the wire must be seen to call the bus full."""
_ERROR_BITS = 160
"""An error frame and what it destroyed take no longer."""
_IDLE_BITS = 2.0
"""The bus is idle when nobody starts within so many bits after the intermission."""
_CLOCKS = 0.003
"""Part by which frames may take longer than the bit rate and the recorder's clock say."""
_HELD = 1 << 16
"""Frames of a bus before a block in which the last idle moment is looked for."""
_MAX_KEPT = 10_000
"""Kept for each node."""
_SHORT = 0x7FF
"""Identifiers up to here are counted without being sorted."""
_AHEAD = 3
"""Identifiers that are named."""
_CUT_NS = 10_000_000
"""A bus ends its traffic so soon before the capture, or another bus, does [ns]."""
_NO_HEARTBEAT = np.uint16(FrameFlag.EXTENDED | FrameFlag.ERROR | FrameFlag.FD)

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """Frames of one bus in order; all (n,).

    `most_ns` is what each took on the wire with intermission at most, `least_ns` at least. `node`
    is that of a heartbeat, negative where it is asked for one, 0 for other frames.
    """

    t_ns: Ints
    can_id: Ints
    most_ns: Floats
    least_ns: Floats
    node: NDArray[np.int16]

    def after(self, before: "_Frames | None") -> "_Frames":
        """These frames behind others."""
        if before is None:
            return self
        return _Frames(
            np.concatenate((before.t_ns, self.t_ns)),
            np.concatenate((before.can_id, self.can_id)),
            np.concatenate((before.most_ns, self.most_ns)),
            np.concatenate((before.least_ns, self.least_ns)),
            np.concatenate((before.node, self.node)),
        )

    def last(self, count: int) -> "_Frames":
        """The last ones."""
        if len(self.t_ns) == count:
            return self
        columns = (self.t_ns, self.can_id, self.most_ns, self.least_ns, self.node)
        return _Frames(*(column[-count:].copy() for column in columns))  # type: ignore[arg-type]


@dataclass(slots=True)
class _Bus:
    """One bus from block to block."""

    before: _Frames | None = None
    beat_ns: dict[int, int] = field(default_factory=dict)
    """Time of each node's last heartbeat."""
    recent_ns: dict[int, Ints] = field(default_factory=dict)
    """Its last three periods."""


class HeartbeatWaits:
    """Fills `Context.kept_waiting` on every bus whose bit rate is known."""

    def __init__(self, context: Context, on_wire: OnWire) -> None:
        self._context = context
        self._on_wire = on_wire
        self._buses: dict[int, _Bus] = {}

    def update(self, block: Block, bus: int) -> None:
        """Take in the frames of one bus of a block, which `OnWire` has taken in before."""
        bit_ns = self._on_wire.bit_ns(bus)
        if bit_ns is None:
            return
        state = self._buses.setdefault(bus, _Bus())
        fresh = self._frames(block, bus, bit_ns)
        begin = len(state.before.t_ns) if state.before is not None else 0
        beats = np.flatnonzero(fresh.node > 0)
        late = []
        for node in distinct(fresh.node[beats]):
            rows = beats[fresh.node[beats] == node]
            before, off = _overdue(state, node, fresh.t_ns[rows])
            if off.any():
                late.append(((bus, node), begin + rows[off], before[off]))
        if late:
            traffic = _Traffic(fresh.after(state.before), bit_ns, self._slack_ns(bus))
            for key, rows, before in late:
                self._judge(key, traffic, rows, before)
        whole = fresh if len(fresh.t_ns) >= _HELD else fresh.after(state.before)
        state.before = whole.last(_HELD)

    def gap(self, bus: int | None) -> None:
        """Nothing is known of the frames in a gap."""
        for each in [bus] if bus is not None else list(self._buses):
            self._close(each)

    def finish(self) -> None:
        """Look at the heartbeats that did not come any more."""
        self.gap(None)

    def _close(self, bus: int) -> None:
        state = self._buses.pop(bus, None)
        bit_ns = self._on_wire.bit_ns(bus)
        if state is None or state.before is None or bit_ns is None:
            return
        traffic = _Traffic(state.before, bit_ns, self._slack_ns(bus))
        for node, beat_ns in state.beat_ns.items():
            found = traffic.waited(node, len(state.before.t_ns), beat_ns)
            if found is not None:
                self._keep((bus, node), found)

    def _slack_ns(self, bus: int) -> float:
        """What stamps may be off."""
        return self._context.resolution_ns - 1 + self._on_wire.noise_ns(bus)

    def _judge(self, key: NodeKey, traffic: "_Traffic", rows: Ints, before_ns: Ints) -> None:
        """Look at the late heartbeats of a node before which the bus was full for long."""
        room = _MAX_KEPT - len(self._context.kept_waiting.get(key, ()))
        for at in np.flatnonzero(traffic.worth(rows, before_ns)).tolist() if room > 0 else ():
            found = traffic.waited(key[1], int(rows[at]), int(before_ns[at]))
            if found is not None:
                self._keep(key, found)

    def _keep(self, key: NodeKey, found: KeptWaiting) -> None:
        kept = self._context.kept_waiting.setdefault(key, [])
        if len(kept) < _MAX_KEPT:
            kept.append(found)

    def _frames(self, block: Block, bus: int, bit_ns: float) -> _Frames:
        places = block.by_bus[bus]
        frames = block.frames[places]
        least = most = self._on_wire.times_ns(block, bus, bit_ns)
        unknown = np.isnan(least)
        if unknown.any():
            bits, fast = block.wire_bits[places], block.data_phase_bits[places]
            least = np.where(unknown, (bits - fast) * bit_ns, least)
            at_most = np.where(block.error[places], _ERROR_BITS, bits) * bit_ns
            most = np.where(unknown, at_most, most)
        return _Frames(
            frames.t_ns.astype(np.int64, copy=False),
            frames.can_id.astype(np.int64),
            most,
            least,
            _beating(frames),
        )


class _Traffic:
    """Frames of a bus, and when it was idle between them."""

    def __init__(self, frames: _Frames, bit_ns: float, slack_ns: float) -> None:
        self.frames = frames
        self._allowed_ns = slack_ns + _IDLE_BITS * bit_ns
        self._slack_ns = slack_ns
        self._bit_ns = bit_ns
        self._proofs: dict[int, Ints] = {}
        """By node: rows at whose start its heartbeat was not ready, see `_weaker`."""

    @cached_property
    def _beats(self) -> Ints:
        """Rows of error control and of the requests for it, but the first row."""
        return np.flatnonzero(self.frames.node[1:]) + 1

    @cached_property
    def _since_ns(self) -> Floats:
        """(n,) stamps after the first one."""
        return (self.frames.t_ns - self.frames.t_ns[:1]).astype(np.float64)

    @cached_property
    def _last_idle(self) -> Ints:
        """(n,) the last row up to each one before which the bus was idle, else the first."""
        apart = np.diff(self._since_ns, prepend=np.inf)
        idle = (apart - self.frames.most_ns > self._allowed_ns) | (apart < -self._slack_ns)
        idle[:1] = True
        return np.maximum.accumulate(np.where(idle, np.arange(len(idle)), 0))

    @cached_property
    def _idle_ns(self) -> Floats:
        """(n,) time without frames so far, less what the clocks may be apart."""
        return self._since_ns - np.cumsum((1 + _CLOCKS) * self.frames.most_ns)

    @cached_property
    def _busy_ns(self) -> Floats:
        """(n,) time of the frames so far."""
        return np.cumsum(self.frames.least_ns)

    def worth(self, rows: Ints, before_ns: Ints) -> Bools:
        """(r,) whether the bus was not idle for a good part of the time since another moment."""
        t_ns = self.frames.t_ns
        waited = t_ns[rows] - t_ns[self._last_idle[rows]]
        found: Bools = waited > _WORTH * (t_ns[rows] - before_ns)
        return found

    def waited(self, node: int, row: int, before_ns: int) -> KeptWaiting | None:
        """What a heartbeat, the frame of a row or the one that never came, waited for.

        Args:
            node: whose heartbeat.
            row: the heartbeat; the number of frames for one that never came.
            before_ns: time of the one before.
        """
        frames, last = self.frames, min(row, len(self.frames.t_ns) - 1)
        first = max(self._free(last), self._weaker(node, last))
        free_ns, end_ns = self._begin(first), int(frames.t_ns[last])
        waited = end_ns - free_ns
        if waited <= _WORTH * (end_ns - before_ns):
            return None
        busy = min(1.0, float(self._busy_ns[last] - self._busy_ns[first]) / waited)
        if busy < _FULL:
            return None
        ahead = _longest(frames.can_id[first:row], frames.least_ns[first:row])
        since_ns = max(free_ns, before_ns)
        return KeptWaiting(before_ns, end_ns, since_ns, busy, ahead, over=row == last)

    def _begin(self, row: int) -> int:
        most_ns = self.frames.most_ns[row]
        start_ns = self._since_ns[row] - most_ns + INTERMISSION_BITS * self._bit_ns
        return int(self.frames.t_ns[0]) + round(float(start_ns))

    def _free(self, row: int) -> int:
        """The first frame after the bus was idle last, by the sum of what passed between frames."""
        since = int(self._last_idle[row])
        idle = self._idle_ns[since : row + 1]
        proof = np.flatnonzero(idle < idle[-1] - self._allowed_ns)
        return since if not len(proof) else since + int(proof[-1]) + 1

    def _weaker(self, node: int, row: int) -> int:
        """The last frame before a row at whose start the heartbeat of a node was not ready.

        That is another one's of a higher identifier, or a request to the node, which loses against
        the answer. Right behind a frame that may be the node's own this proves nothing: it may have
        to load the next one.
        """
        if node not in self._proofs:
            sender = self.frames.node[self._beats]
            found = self._beats[(sender > node) | (sender == -node)]
            self._proofs[node] = found[self.frames.can_id[found - 1] & MAX_NODE != node]
        proofs = self._proofs[node]
        before = int(proofs.searchsorted(row))
        last = int(proofs[before - 1]) if before else 0
        return last if last >= self._last_idle[row] else 0


def losses_by_waiting(context: Context, timeline: Timeline) -> Iterator[tuple[Lost, KeptWaiting]]:
    """Silences in which a node's heartbeat only had to wait, and what for.

    The bus was never free for the heartbeat once the node was silent for too long. A node that
    boots after its silence was lost, however full the bus was. How full it was is not known where
    the frames contradict the bit rate, which may show only in the end.
    """
    key = (timeline.history.bus, timeline.history.node)
    every = context.kept_waiting.get(key)
    if not every or context.contradicted(context.bus_name(key[0])):
        return
    boots = [boot.t_ns for boot in timeline.boot_ups]
    for lost in timeline.lost:
        kept = _kept_waiting(every, lost)
        booted = any(0 <= t_ns - lost.end_ns <= BOOT_UP_NS for t_ns in boots)
        if kept is not None and not booted and not lost.whole_bus:
            yield lost, kept


def _kept_waiting(every: Sequence[KeptWaiting], lost: Lost) -> KeptWaiting | None:
    at = bisect_left(every, lost.end_ns, key=lambda kept: kept.end_ns)
    for kept in every[max(0, at - 1) : at + 1]:
        later = 0 if kept.over else _CUT_NS
        within = kept.before_ns <= lost.last_ns and lost.end_ns <= kept.end_ns + later
        if within and kept.free_ns <= lost.start_ns:
            return kept
    return None


def told_waiting(
    context: Context, states: Sequence[NmtStateRow], timelines: dict[NodeKey, Timeline]
) -> list[NmtStateRow]:
    """The states of all nodes; that a LOST node only had to wait is said in its cause."""
    waited = {
        (context.bus_name(key[0]), key[1], lost.start_ns): kept
        for key, timeline in timelines.items()
        for lost, kept in losses_by_waiting(context, timeline)
    }
    if not waited:
        return list(states)
    return [
        replace(row, cause=f"{row.cause}; {_told(kept)}")
        if row.state == NmtState.LOST
        and (kept := waited.get((row.bus, row.node, row.start_ns))) is not None
        else row
        for row in states
    ]


def _told(kept: KeptWaiting) -> str:
    return (
        "frames of higher priority kept the bus busy"
        f" ({kept.busy:.0%} of {kept.waited_ns / 1e6:.0f} ms): its heartbeat had to wait"
    )


def _beating(frames: FrameBatch) -> NDArray[np.int16]:
    """(n,) node of each message of error control, negative for a request, 0 for other frames."""
    node = np.zeros(len(frames), np.int16)
    rows = np.flatnonzero((frames.can_id > FIRST_ID) & (frames.can_id <= FIRST_ID + MAX_NODE))
    rows = rows[(frames.flags[rows] & _NO_HEARTBEAT) == 0]
    sender = frames.can_id[rows].astype(np.int16) - FIRST_ID
    remote = (frames.flags[rows] & FrameFlag.REMOTE) != 0
    node[rows] = np.where(remote, -sender, np.where(frames.dlc[rows] == 1, sender, 0))
    return node


def _overdue(state: _Bus, node: int, t_ns: Ints) -> tuple[Ints, Bools]:
    """(n,) time of the heartbeat before each of a node's, and whether it is longer ago than usual."""
    last_ns = state.beat_ns.get(node)
    state.beat_ns[node] = int(t_ns[-1])
    before = np.concatenate((t_ns[:1] if last_ns is None else [last_ns], t_ns[:-1]))
    recent = np.concatenate((state.recent_ns.get(node, np.zeros(3, np.int64)), t_ns - before))
    state.recent_ns[node] = recent[-3:]
    usual = np.minimum(np.minimum(recent[:-3], recent[1:-2]), recent[2:-1])
    return before, t_ns - before > _LONGER * usual


def _longest(can_id: Ints, wire_ns: Floats) -> tuple[int, ...]:
    """The identifiers that took most of the time."""
    if int(can_id.max(initial=0)) <= _SHORT:
        keys = np.flatnonzero(np.bincount(can_id))
        took = np.bincount(can_id, wire_ns).take(keys)
    else:
        keys, place = np.unique(can_id, return_inverse=True)
        took = np.bincount(place, wire_ns, minlength=len(keys))
    return tuple(keys[np.argsort(-took, kind="stable")[:_AHEAD]].tolist())
