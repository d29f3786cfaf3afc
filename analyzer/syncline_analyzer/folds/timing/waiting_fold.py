"""What synchronous PDOs wait for on every bus, block by block."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.delay_sums import DelaySums
from syncline_analyzer.folds.timing.delays import Delays
from syncline_analyzer.folds.timing.on_wire import OnWire
from syncline_analyzer.folds.timing.pdo_answers import AnswersTo
from syncline_analyzer.folds.timing.senders import Senders
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_analyzer.folds.timing.waiting import (
    MASTER,
    Arbitration,
    Asked,
    Most,
    Ready,
    order_is_told,
    rank,
)
from syncline_analyzer.folds.timing.waiting_bus import BusBlock, Carried, sender_of
from syncline_analyzer.folds.timing.waiting_pdo import Answers, Waits, named
from syncline_analyzer.pdo_binding import Pdo, PdoBindings
from syncline_analyzer.results import DelayRow, PdoRow

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
        self._sums: dict[int, DelaySums] = {}
        self._delays: dict[str, Delays] = {}

    def begin(self, block: Block, bus: int, bit_ns: float | None) -> None:
        """Take in the frames of one bus of a block, or of a part of it."""
        self._now = None
        if bit_ns is None or not self._context.timed or bus not in block.by_bus:
            return
        # Of stamps too coarse to tell an order only what may reach into the next block is kept.
        slack_ns = self._context.resolution_ns - 1 + self._on_wire.noise_ns(bus)
        told = order_is_told(slack_ns, bit_ns)
        carried = self._carried(block, bus, bit_ns, None if told else _BEFORE)
        carried = carried.after(self._before.get(bus))
        self._before[bus] = carried.last(_BEFORE)
        if not told:
            return
        arbitration = Arbitration(
            carried.t_ns,
            carried.wire_ns,
            carried.rank,
            carried.sender,
            bit_ns=bit_ns,
            resolution_ns=self._context.resolution_ns,
            noise_ns=self._on_wire.noise_ns(bus),
        )
        whole = isinstance(block.by_bus[bus], slice)
        shift = len(carried.seq) - len(block.batch) if whole else None
        told_senders = self._senders.told(bus)
        self._now = BusBlock(bus, carried, arbitration, self._senders, told_senders, shift)

    def gap(self, bus: int | None) -> None:
        """Nothing is known of the frames in a gap."""
        for each in [bus] if bus is not None else list(self._before):
            self._before.pop(each, None)

    def answers(self, answers: AnswersTo, low_ns: Floats, most_ns: Floats) -> tuple[Floats, Floats]:
        """What the answers of PDOs in this block waited for.

        Args:
            answers: r answers in all.
            low_ns, most_ns: (r,) bounds of the device time (analysis.md section 5).

        Returns:
            (r,) least time that the device can have taken and (r,) longest that it can have waited
            for other frames [ns]; NaN where nothing is known.
        """
        now = self._now
        if now is None:
            nothing = np.full(len(low_ns), np.nan)
            return nothing, nothing
        asked = _asked(now, answers, low_ns, most_ns)
        ready, figures = now.arbitration.ready(asked)
        self._add_each(now, answers, ready, figures, asked)
        names = [each.can_id for each in answers.pdos]
        self._sums.setdefault(now.bus, DelaySums()).add(now, names, asked, ready)
        if ready.known.all():
            return ready.least_ns, ready.waiting_ns
        nothing = np.where(ready.known, 0.0, np.nan)
        return ready.least_ns + nothing, ready.waiting_ns + nothing

    def _add_each(
        self,
        now: BusBlock,
        answers: AnswersTo,
        ready: Ready,
        figures: Sequence[Most],
        asked: Asked,
    ) -> None:
        """Take in the answers PDO by PDO."""
        for each, part, most in zip(answers.pdos, answers.parts, figures, strict=True):
            owner, sync, mine = each.state.owner, answers.sync, ready.part(part)
            window_ns, sync_ns = each.state.window_ns, None
            if window_ns is not None or (owner is not None and owner.node in now.sdo_nodes):
                sync_ns = sync.t_ns.take(each.position)
            rows, own_ns, shown = asked.rows[part], None, None
            if sync_ns is not None and window_ns is not None:
                own_ns = now.arbitration.own_ns(rows)
                shown = now.idle_at(sync_ns + window_ns - own_ns)
            found = Answers(
                rows,
                sync.seq,
                each.position,
                each.response,
                asked.most_ns[part],
                mine,
                self._beside_sdo(now, owner, rows, sync_ns),
                window_ns,
                own_ns,
                shown,
                most,
            )
            waits = self._waits_of(now.bus, each.can_id)
            waits.add(now, found)
            if window_ns is not None and found.late.any():
                for blame in now.blame(found.rows, found.ready, found.late):
                    waits.add_blame(now, blame, found, _sender(owner))

    def _waits_of(self, bus: int, can_id: int) -> Waits:
        if (bus, can_id) not in self._waits:
            self._waits[bus, can_id] = Waits(self._context.bus_name(bus), can_id)
        return self._waits[bus, can_id]

    @staticmethod
    def _beside_sdo(
        now: BusBlock, owner: Pdo | None, rows: Ints, sync_ns: Ints | None
    ) -> Bools | None:
        """(r,) whether there was SDO traffic with the node of a PDO shortly before the SYNCs."""
        if owner is None or owner.kind == "rpdo" or sync_ns is None:
            return None
        if owner.node not in now.sdo_nodes:
            return None
        return now.sdo_since(owner.node, rows, sync_ns - BESIDE_NS)

    def unanswered(self, cob_id: int, owner: Pdo | None, position: Ints, sync: SyncIndex) -> None:
        """Note when the bus was free for a PDO that left SYNCs of this block unanswered."""
        now = self._now
        waits = self._waits.get((now.bus, cob_id)) if now is not None else None
        position = position[position < len(sync.seq) - 1]
        if now is None or waits is None or not len(position):
            return
        begun, end = now.rows(sync.seq[position]), now.rows(sync.seq[position + 1])
        ranks = np.full(len(end), cob_id << 21, np.uint32)
        senders = np.full(len(end), _sender(owner), np.int16)
        last = now.arbitration.last_without(end, ranks, senders, begun, itself=True)
        free_ns = now.arbitration.start_ns[last] - now.arbitration.end_ns[begun]
        # What stands in line behind frames of its own node waits for its device.
        kept = (begun >= 0) & ~now.sends_between(_sender(owner), last, end)
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
        delays = (
            self._sums[bus].of(cob_id).told(lambda key: sender_of(self._senders, bus, key), own)
        )
        self._delays.setdefault(pdo.bus, Delays()).join(delays)
        return waits.measured(pdo)

    def delays(self) -> list[DelayRow]:
        """Who delayed the PDOs that were judged, of all buses."""
        return [row for bus, delays in self._delays.items() for row in delays.rows(bus)]

    def _carried(self, block: Block, bus: int, bit_ns: float, most: int | None) -> Carried:
        """The frames of a bus, or only the last `most` of them."""
        places = block.by_bus[bus]
        frames, seq = block.frames[places], block.batch.seqs[places]
        # Every frame tells which nodes there are.
        sender = self._senders.nodes(frames, bus, int(seq[-1]))
        last = slice(None if most is None else -most, None)
        kept = frames[last]
        return Carried(
            seq[last],
            kept.t_ns,
            kept.can_id,
            kept.flags,
            self._on_wire.times_ns(block, bus, bit_ns)[last],
            rank(kept),
            sender[last],
        )


def _asked(now: BusBlock, answers: AnswersTo, low_ns: Floats, most_ns: Floats) -> Asked:
    """What stands in the frames of a bus of some answers, see `WaitingFold.answers`."""
    rows = now.rows(answers.seq) if now.shift is None else answers.rows + now.shift
    return Asked(
        answers.starts,
        np.array([each.can_id << 21 for each in answers.pdos], np.uint32),
        np.array([_sender(each.state.owner) for each in answers.pdos], np.int16),
        rows,
        answers.position,
        now.rows(answers.sync.seq),
        answers.sync.t_ns,
        low_ns,
        most_ns,
    )


def _sender(owner: Pdo | None) -> int:
    return owner.node if owner is not None and owner.kind == "tpdo" else MASTER
