"""What synchronous PDOs wait for on every bus, block by block."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.delays import Delays
from syncline_analyzer.folds.timing.on_wire import OnWire
from syncline_analyzer.folds.timing.senders import Senders
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_analyzer.folds.timing.waiting import MASTER, Arbitration, rank
from syncline_analyzer.folds.timing.waiting_bus import BusBlock, Carried, sender_of
from syncline_analyzer.folds.timing.waiting_pdo import Answers, Waits, named
from syncline_analyzer.pdo_binding import Pdo, PdoBindings
from syncline_analyzer.results import DelayRow, PdoRow
from syncline_schemas.wire_length import INTERMISSION_BITS

BESIDE_NS = 10_000_000
"""An SDO frame so long before a SYNC may keep its node busy still [ns]."""
_BEFORE = 2048
"""Frames before a block that may reach into it."""

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class WaitingFold:
    """Follows what went ahead of the synchronous PDOs on the wire (analysis.md section 5).

    `begin` comes first for each bus, and then the answers of its PDOs. Without a bit rate, without
    times, and where stamps are too coarse, nothing is told.
    """

    def __init__(self, context: Context, bindings: PdoBindings, on_wire: OnWire) -> None:
        self._context = context
        self._on_wire = on_wire
        self._senders = Senders(context, bindings)
        self._now: BusBlock | None = None
        self._before: dict[int, Carried] = {}
        self._waits: dict[tuple[int, int], Waits] = {}
        self._delays: dict[str, Delays] = {}

    def begin(self, block: Block, bus: int, bit_ns: float | None) -> None:
        """Take in the frames of one bus of a block, or of a part of it."""
        self._now = None
        if bit_ns is None or not self._context.timed or bus not in block.by_bus:
            return
        carried = self._carried(block, bus, bit_ns).after(self._before.get(bus))
        self._before[bus] = carried.last(_BEFORE)
        arbitration = Arbitration(
            carried.t_ns,
            carried.wire_ns,
            carried.rank,
            carried.sender,
            bit_ns=bit_ns,
            resolution_ns=self._context.resolution_ns,
            noise_ns=self._on_wire.noise_ns(bus),
        )
        if arbitration.usable:
            self._now = BusBlock(bus, carried, arbitration, self._senders)

    def gap(self, bus: int | None) -> None:
        """Nothing is known of the frames in a gap."""
        for each in [bus] if bus is not None else list(self._before):
            self._before.pop(each, None)

    def answers(
        self,
        cob_id: int,
        owner: Pdo | None,
        seq: Ints,
        position: Ints,
        sync: SyncIndex,
        low_ns: Floats,
        most_ns: Floats,
    ) -> tuple[Floats, Floats]:
        """What the answers of a PDO in this block waited for.

        Args:
            seq: (r,) of the answers.
            position: (r,) position of the SYNC that each answers.
            low_ns, most_ns: (r,) bounds of the device time (analysis.md section 5).

        Returns:
            (r,) least time that the device can have taken and (r,) longest that it can have waited
            for other frames [ns]; NaN where nothing is known.
        """
        now = self._now
        if now is None:
            nothing = np.full(len(seq), np.nan)
            return nothing, nothing
        found = self._found(now, cob_id, owner, seq, position, sync, low_ns, most_ns)
        waits = self._waits.setdefault(
            (now.bus, cob_id), Waits(self._context.bus_name(now.bus), cob_id)
        )
        waits.add(now, found)
        for blame in now.blame(found.rows, found.ready):
            waits.delays.add(now, blame, cob_id, _sender(owner))
            waits.add_blame(now, blame, found, _sender(owner))
        ready, unknown = found.ready, ~found.ready.known
        return (
            np.where(unknown, np.nan, ready.least_ns),
            np.where(unknown, np.nan, ready.waiting_ns),
        )

    def unanswered(self, cob_id: int, owner: Pdo | None, position: Ints, sync: SyncIndex) -> None:
        """Note when the bus was free for a PDO that left SYNCs of this block unanswered."""
        now = self._now
        waits = self._waits.get((now.bus, cob_id)) if now is not None else None
        position = position[position < len(sync.seq) - 1]
        if now is None or waits is None or not len(position):
            return
        begun, end = now.rows(sync.seq[position]), now.rows(sync.seq[position + 1])
        last = now.arbitration.last_without(end, cob_id << 21, _sender(owner), itself=True)
        free_ns = now.arbitration.start_ns[last] - now.arbitration.end_ns[begun]
        # What stands in line behind frames of its own node waits for its device.
        kept = (begun >= 0) & ~now.sends_between(_sender(owner), np.maximum(last, begun), end)
        waits.add_unanswered(sync.seq[position][kept], np.where(last > begun, free_ns, 0.0)[kept])

    def judge(
        self, tables: TimingTables, bus: int, cob_id: int, pdo: PdoRow, missed_seq: Ints
    ) -> PdoRow:
        """Append the rows of a PDO that is synchronous, and complete its own."""
        waits = self._waits.get((bus, cob_id))
        if waits is None or not waits.least.count:
            return pdo
        tables.waits.extend(named(waits.worst(), pdo))
        tables.lateness.append(waits.row(pdo, missed_seq))
        self._context.late_behind[pdo.bus, cob_id] = waits.late_behind
        own = self._senders.of(bus, cob_id).node
        delays = waits.delays.told(lambda key: sender_of(self._senders, bus, key), own)
        self._delays.setdefault(pdo.bus, Delays()).join(delays)
        return waits.measured(pdo)

    def delays(self) -> list[DelayRow]:
        """Who delayed the PDOs that were judged, of all buses."""
        return [row for bus, delays in self._delays.items() for row in delays.rows(bus)]

    def _carried(self, block: Block, bus: int, bit_ns: float) -> Carried:
        places = block.by_bus[bus]
        frames = block.frames[places]
        seq = block.batch.seqs[places]
        return Carried(
            seq,
            frames.t_ns,
            frames.can_id,
            frames.flags,
            self._on_wire.times_ns(block, bus, bit_ns),
            rank(frames),
            self._senders.nodes(frames, bus, int(seq[-1])),
        )

    def _found(
        self,
        now: BusBlock,
        cob_id: int,
        owner: Pdo | None,
        seq: Ints,
        position: Ints,
        sync: SyncIndex,
        low_ns: Floats,
        most_ns: Floats,
    ) -> Answers:
        mine, begun = now.rows(seq), now.rows(sync.seq[position])
        sync_ns = sync.t_ns[position]
        ready = now.arbitration.ready(mine, begun, sync_ns, cob_id << 21, _sender(owner))
        ready = ready.within(low_ns, most_ns)
        beside = np.zeros(len(seq), np.bool_)
        if owner is not None and owner.kind == "tpdo":
            beside = now.last_sdo_ns(owner.node, mine) >= sync_ns - BESIDE_NS
        own_ns = now.wire_ns[mine] - INTERMISSION_BITS * now.arbitration.bit_ns
        window_ns = self._window_ns(now, owner)
        shown = np.zeros(len(seq), np.bool_)
        if window_ns is not None:
            shown = now.idle_at(sync_ns + window_ns - own_ns)
        return Answers(
            mine,
            sync.seq[position],
            now.t_ns[mine] - sync_ns,
            own_ns,
            most_ns,
            ready,
            beside,
            window_ns,
            shown,
        )

    def _window_ns(self, now: BusBlock, owner: Pdo | None) -> int | None:
        """Synchronous window length (1007h) of a TPDO's node."""
        if owner is None or owner.kind == "rpdo":
            return None
        window_us = self._context.shadow.number(now.bus, owner.node, 0x1007, 0, int(now.seq[-1]))
        return window_us * 1000 if window_us else None


def _sender(owner: Pdo | None) -> int:
    return owner.node if owner is not None and owner.kind == "tpdo" else MASTER
