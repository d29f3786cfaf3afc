"""SYNC, PDO timing and bus load in one pass over the frames."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from syncline_analyzer.capture import Unread
from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.nmt.kept_waiting import HeartbeatWaits
from syncline_analyzer.folds.nmt.table import NodeNmt
from syncline_analyzer.folds.timing.block import BLOCK_FRAMES, Block, Blocks
from syncline_analyzer.folds.timing.error_control_periods import ErrorControlPeriods
from syncline_analyzer.folds.timing.load import LoadFold
from syncline_analyzer.folds.timing.on_wire import OnWire
from syncline_analyzer.folds.timing.pdo import PdoFold
from syncline_analyzer.folds.timing.pdo_judge import PdoJudge
from syncline_analyzer.folds.timing.silence import Silence, SilenceFold
from syncline_analyzer.folds.timing.sync import SyncFold
from syncline_analyzer.folds.timing.sync_holes import judged, sync_holes
from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_analyzer.folds.timing.waiting_fold import WaitingFold
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_analyzer.results import BusSilenceRow, ClockStepRow, NmtCommandRow, NmtStateRow
from syncline_schemas.batch import Gap

MAX_TURNS = 256
"""Changes of PDO or SYNC parameters that are followed within one block; a master does less."""


class TimingFold:
    """SYNC periods, PDO responses, missed PDOs and bus load.

    Comes after the fold that fills the shadow. Batches are joined to blocks first, so the state of
    the shadow counts by `seq`, not by when it is asked.
    """

    def __init__(self, context: Context, block_frames: int = BLOCK_FRAMES) -> None:
        self._context = context
        self._blocks = Blocks(block_frames)
        self._bindings = PdoBindings(context.shadow)
        self._sync = SyncFold(context)
        self._on_wire = OnWire(context)
        self._waiting = WaitingFold(context, self._bindings, self._on_wire)
        self._pdo = PdoFold(context, self._bindings, self._sync, self._waiting, self._on_wire)
        self._load = LoadFold(context)
        self._error_control = ErrorControlPeriods(context)
        self._heartbeat_waits = HeartbeatWaits(context, self._on_wire)
        self._gap_starts: set[int] = set()

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        for block in self._blocks.add(batch):
            self._take(block)

    def gap(self, gap: Gap) -> None:
        """Periods, counts and windows start again after a gap."""
        self._flush()
        self._gap_starts.add(gap.start_ns)
        self._sync.gap(gap.bus)
        self._pdo.gap(gap.bus)
        self._waiting.gap(gap.bus)
        self._load.gap(gap.bus)
        self._error_control.gap(gap.bus)
        self._heartbeat_waits.gap(gap.bus)

    def finish(
        self,
        end_ns: int,
        nmt_states: Sequence[NmtStateRow] | None = None,
        commands: Sequence[NmtCommandRow] = (),
        unread: Sequence[Unread] = (),
        nodes: Mapping[tuple[int, int], NodeNmt] | None = None,
        silence: SilenceFold | None = None,
    ) -> TimingTables:
        """All tables; a PDO is missed only while `nmt_states` say OPERATIONAL (None: always).

        `commands` are those of the master, which may switch SYNC off while it holds all nodes. Where
        lines are `unread`, what is missing may be in them. `nodes` tell which is guarded, and which
        sends heartbeats (None: the frames of 700h + node alone do). `silence` went through the same
        frames (None: nothing is known of silences).
        """
        self._flush()
        silence = silence or SilenceFold()
        self._heartbeat_waits.finish()
        syncs = self._sync.finish()
        tables = TimingTables()
        self._add_silences(tables, silence)
        known = {row.evidence[0] for row in tables.clock_steps}
        tables.clock_steps.extend(
            row for table in syncs for row in table.steps if row.evidence[0] not in known
        )
        load = self._load.finish(
            self._bindings,
            [(t.row.bus, t.row.cob_id) for t in syncs],
            _summed((step.bus, step.step_ns) for step in tables.clock_steps),
            _summed((row.bus, row.end_ns - row.start_ns) for row in tables.bus_silences),
        )
        tables = replace(
            tables,
            bus_load=load.load,
            bus_shares=load.shares,
            node_shares=load.node_shares,
            sync_jitter=[row for table in syncs for row in table.jitter],
            series=[t.series for t in syncs if t.series is not None] + load.series,
            overloads=load.overloads,
            sync_doubles=[row for table in syncs for row in table.doubles],
        )
        for table in syncs:
            silences = self._silences(silence, table.row.bus)
            told = judged(self._context, table, nmt_states or (), silences, commands, unread)
            tables.sync.append(told.row)
            tables.holes.extend(sync_holes(told))
            tables.worst.extend(table.worst)
        judge = PdoJudge(
            self._context,
            self._bindings,
            self._sync,
            silence,
            self._waiting,
            self._gap_starts,
            nmt_states,
            [Silence(each.start_ns, each.end_ns, 0, 0, {}) for each in unread],
            end_ns,
        )
        for (bus, can_id), state in sorted(self._pdo.states.items()):
            if state.frames or state.asked:
                judge.add(tables, bus, can_id, state)
        rows, worst = self._error_control.finish(
            nodes, nmt_states or (), self._silences_and(silence, unread)
        )
        tables.error_control_periods.extend(rows)
        tables.worst.extend(worst)
        tables.delays.extend(self._waiting.delays())
        return tables

    def _add_silences(self, tables: TimingTables, silence: SilenceFold) -> None:
        for bus, name in enumerate(self._context.buses):
            steps = silence.steps(bus)
            stepped = {step.end_seq for step in steps}
            tables.clock_steps.extend(
                ClockStepRow(name, s.start_ns, s.end_ns, s.by_ns, s.witnesses, [s.end_seq])
                for s in steps
            )
            tables.bus_silences.extend(
                BusSilenceRow(name, s.start_ns, s.end_ns, [s.start_seq, s.end_seq])
                for s in silence.of(bus)
                if s.end_seq not in stepped and not s.stalled
            )

    def _silences(self, silence: SilenceFold, bus_name: str) -> list[Silence]:
        buses = [k for k, name in enumerate(self._context.buses) if name == bus_name]
        return [each for bus in buses for each in silence.of(bus)]

    def _silences_and(
        self, silence: SilenceFold, unread: Sequence[Unread]
    ) -> dict[int, list[Silence]]:
        """Where nothing can be missing on each bus: silences, and lines that could not be read."""
        lost = [Silence(each.start_ns, each.end_ns, 0, 0, {}) for each in unread]
        return {
            bus: [*silence.of(bus), *silence.backs(bus), *lost]
            for bus in range(len(self._context.buses))
        }

    def _flush(self) -> None:
        for block in self._blocks.flush():
            self._take(block)

    def _take(self, block: Block) -> None:
        self._on_wire.listen(block)
        for bus in block.by_bus:
            for part in block.parts(self._turns(block, bus)):
                if bus in part.by_bus:
                    self._pdo.update(part, bus)
            self._load.update(block, bus)
            if self._context.timed:
                self._error_control.update(block, bus)
                self._heartbeat_waits.update(block, bus)

    def _turns(self, block: Block, bus: int) -> list[int]:
        """Where PDOs or SYNC of a bus moved or got another timing: nothing is told over such a frame."""
        first, last = block.batch.seq0, block.batch.last_seq
        return self._bindings.turns(bus, first, last)[:MAX_TURNS]


def _summed(parts: Iterable[tuple[str, int]]) -> dict[str, int]:
    """Sums by name."""
    sums: dict[str, int] = {}
    for name, part in parts:
        sums[name] = sums.get(name, 0) + part
    return sums
