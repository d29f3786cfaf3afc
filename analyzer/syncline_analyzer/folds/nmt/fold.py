"""NMT: commands, and the state timeline of every node (analysis.md section 4)."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.distinct import distinct
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.bus.clock import ClockTable
from syncline_analyzer.folds.nmt.cadence import Int64s, Mask
from syncline_analyzer.folds.nmt.calm import FIRST_ID, CalmNodes
from syncline_analyzer.folds.nmt.columns import Columns, no_columns
from syncline_analyzer.folds.nmt.command_rows import command_rows
from syncline_analyzer.folds.nmt.commands import Commands
from syncline_analyzer.folds.nmt.emptied import never_booted, powered_on, restarted
from syncline_analyzer.folds.nmt.error_control import ErrorControl, reset_mark
from syncline_analyzer.folds.nmt.events import (
    Command,
    MissedMaster,
    NodeHistory,
    PdoSpan,
    Repeated,
)
from syncline_analyzer.folds.nmt.measures import Measures, quantiles_ms, shares
from syncline_analyzer.folds.nmt.node_pdos import NodePdos
from syncline_analyzer.folds.nmt.others import (
    booted_with,
    others_anew,
    others_beat,
    starts_of,
    witnesses_of,
)
from syncline_analyzer.folds.nmt.senders import Senders, Sent
from syncline_analyzer.folds.nmt.table import BootUp, NmtTable, NodeKey, NodeNmt
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.folds.nmt.timeout import PRODUCER_TIME
from syncline_analyzer.folds.nmt.witness import Witnesses
from syncline_analyzer.folds.sdo.fold import Reset
from syncline_analyzer.folds.timing.pdo_spans import Quietness
from syncline_analyzer.results import NmtStateRow
from syncline_schemas.batch import FrameFlag, Gap
from syncline_schemas.canopen.nmt import RESETS
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.devices import quirks

Rows = NDArray[np.intp]

_ERROR_CONTROL: NDArray[np.bool_] = SERVICE_OF_ID == Service.ERROR_CONTROL
"""By identifier."""

FOREIGN = 10
"""So many frames that CANopen does not know on its identifiers mean another protocol."""


class NmtFold:
    """Follows NMT commands, error control and the PDOs that prove a state.

    What a batch brings is reduced to commands, changes and silences; the timelines are told at the
    end, when everything is known that the shadow can know.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._first: tuple[int, int] | None = None
        """`seq` and time of the first frame of all buses so far."""
        self._commands = Commands()
        self._control: dict[NodeKey, ErrorControl] = {}
        self._pdos = NodePdos(self._control, self._cuts)
        self._gaps: dict[int | None, list[tuple[int, Gap]]] = {}
        self._cut_beats: dict[NodeKey, int] = {}
        self._cut_commands: dict[NodeKey, int] = {}
        self._found_cuts: dict[NodeKey, list[tuple[int, int]]] = {}
        self._quietness: dict[NodeKey, Quietness] = {}
        self._blank: dict[NodeKey, bool] = {}
        """Whether the last message of a node's error control told no state."""
        self._next_seq = 0
        self._senders = Senders(context.shadow)
        self._calm: dict[int, CalmNodes] = {}
        """By bus number."""
        self._passed: dict[int, set[int]] = {}
        """By bus number: the nodes of the last batch whose heartbeats only go on."""
        self._heard: dict[NodeKey, Columns] = {}
        """Error control of the last batch of the other nodes."""
        self._errors: Mapping[NodeKey, Sequence[int]] = {}
        self._missed: Mapping[NodeKey, Sequence[MissedMaster]] = {}
        self._no_errors: Mapping[NodeKey, Sequence[tuple[int, int]]] = {}
        self._measures: dict[NodeKey, Measures] = {}
        self._starts: dict[NodeKey, list[int]] = {}
        """When each node may have started, once everything is seen."""

    def update(self, batch: IndexedBatch) -> list[Reset]:
        """Take in the commands and the error control of the next frames.

        `follow` takes in the rest, once the shadow knows what the frames tell it.

        Returns: the resets among them, in order of `seq`.
        """
        if not len(batch):
            return []
        if self._first is None or batch.seq0 < self._first[0]:
            self._first = batch.seq0, int(batch.frames.t_ns[0])
        self._next_seq = max(self._next_seq, batch.last_seq + 1)
        resets = self._commands.take(batch)
        for bus in batch.buses:
            resets += self._hear_bus(batch, bus)
        return sorted(resets)

    def follow(self, batch: IndexedBatch) -> None:
        """Take in when each node was heard in the frames that came last, and their PDOs."""
        if not len(batch):
            return
        sent = self._senders.of(batch)
        for key in sent.keys() | self._heard.keys():
            if key[1] not in self._passed[key[0]]:
                self._live(batch, key, sent.get(key, Sent()))
        for bus in batch.buses:
            calm = self._calm[bus]
            calm.keep_tail(batch, sent)
            full = calm.full()
            for node in full:
                self._wake((bus, node))
            for node in full:
                calm.settle(node, self._control[bus, node].steady)
        self._pdos.take(batch, sent)

    def gap(self, gap: Gap) -> None:
        """States are not known after a gap until something tells them."""
        self._gaps.setdefault(gap.bus, []).append((self._next_seq, gap))
        self._wake_all(gap.bus)
        for (bus, _), control in self._control.items():
            if gap.bus in (None, bus):
                control.gap(gap.start_ns, self._next_seq)
        self._pdos.close(gap.bus)
        for (bus, _), quietness in self._quietness.items():
            if gap.bus in (None, bus):
                quietness.cut()

    def finish(
        self,
        end_ns: int,
        clock: ClockTable,
        canopen: AbstractSet[int] = frozenset(),
        errors: Mapping[NodeKey, Sequence[int]] | None = None,
        missed: Mapping[NodeKey, Sequence[MissedMaster]] | None = None,
        no_errors: Mapping[NodeKey, Sequence[tuple[int, int]]] | None = None,
    ) -> NmtTable:
        """Timelines of all nodes, up to the end of the capture.

        A PDO identifier alone tells of a node only on a bus that shows CANopen otherwise: by
        error control, NMT commands, SYNC, or because it is one of `canopen` (bus numbers).
        `errors` are the times of each node's EMCYs that tell of communication errors, `missed`
        those of them by which it misses its master; `no_errors` are (seq, t_ns) of those that tell
        of none.
        """
        self._errors, self._missed, self._no_errors = errors or {}, missed or {}, no_errors or {}
        self._wake_all()
        for control in self._control.values():
            control.finish(end_ns, self._next_seq)
        alive = {key for key, control in self._control.items() if control.alive}
        self._tell_emptied(end_ns, clock)
        self._starts = starts_of(self._control)
        own = {bus for bus, _ in alive} | self._commands.buses() | self._commands.synced
        foreign = self._foreign_buses() - own
        shown = (set(canopen) - foreign) | own
        table = NmtTable(
            first_ns=self._first[1] if self._first else 0,
            end_ns=end_ns,
            malformed=self._commands.malformed,
            odd=sorted(self._commands.odd, key=lambda each: each.seq),
            canopen=frozenset(shown),
            foreign=frozenset(foreign),
        )
        spans = self._spans(shown)
        told = sorted(alive | set(spans))
        heartbeats = {bus: witnesses_of(self._control, bus) for bus, _ in told}
        for key in told:
            alone = sum(bus == key[0] for bus, _ in told) == 1
            more = key[0] in self._commands.synced or any(
                k[0] == key[0] and k != key for k in spans
            )
            witnesses = Witnesses() if more else heartbeats[key[0]]
            self._tell(table, key, spans.get(key, []), end_ns, clock, alone, witnesses)
        table.commands.extend(command_rows(self._context, self._commands, self._measures))
        return table

    def _spans(self, buses: AbstractSet[int]) -> dict[NodeKey, list[PdoSpan]]:
        """Stretches of PDOs by node, as the bindings stand now that everything was seen."""
        spans: dict[NodeKey, list[PdoSpan]] = {}
        for (bus, _), stretches in self._pdos.spans():
            for span in stretches if bus in buses else ():
                pdo = self._senders.tpdo(bus, span.can_id, span.first_seq)
                if pdo is not None:
                    span.guess = pdo.guess
                    spans.setdefault((bus, pdo.node), []).append(span)
        return {key: sorted(found, key=lambda s: s.first_seq) for key, found in spans.items()}

    def _foreign_buses(self) -> set[int]:
        """Buses with many frames on 000h, 080h and 701h to 77Fh that no CANopen device sends.

        What looks like an answered SDO request there is chance.
        """
        found = Counter(self._commands.foreign)
        for (bus, _), control in self._control.items():
            found[bus] += control.counts.odd
        return {bus for bus, number in found.items() if number >= FOREIGN}

    def _hear_bus(self, batch: IndexedBatch, bus: int) -> Iterator[Reset]:
        """Take in the error control of a bus; tells what may be resets.

        Of the nodes whose heartbeats only go on it waits.
        """
        commands = self._commands.since(bus, batch.seq0)
        asked = _asked(batch, bus)
        calm = self._calm.setdefault(bus, CalmNodes(bus))
        told = range(128) if any(c.node == 0 for c in commands) else {c.node for c in commands}
        passed = self._passed[bus] = calm.going_on(batch, {*asked, *told})
        for node in calm.awake(passed):
            self._wake((bus, node))
        calm.add(batch)
        concerned = {node for on, node in self._control if on == bus and node in told}
        heard = {
            can_id & 0x7F
            for on, can_id in batch.ids()
            if on == bus and FIRST_ID < can_id <= FIRST_ID + 0x7F
        }
        for node in (heard | asked.keys() | concerned) - passed:
            marks = [_mark(c) for c in commands if c.node in (0, node)]
            yield from self._hear(batch, (bus, node), asked.get(node), marks)

    def _hear(
        self, batch: IndexedBatch, key: NodeKey, asked: Rows | None, marks: list[int]
    ) -> Iterator[Reset]:
        """Take in the error control of one node, and the remote frames that ask for it."""
        frames, rows = batch.frames, batch.rows(key[0], FIRST_ID + key[1])
        if asked is not None:
            rows = np.sort(np.concatenate((rows, asked)))
        control = self._control.get(key)
        if control is None:
            control = self._control[key] = ErrorControl(timed=self._context.timed)
        remote = (frames.flags[rows] & FrameFlag.REMOTE) != 0
        columns = (batch.seqs_at(rows), frames.t_ns[rows], remote, frames.dlc[rows])
        heard = self._heard[key] = Columns(*columns, frames.data[rows, 0])
        for found in control.hear(heard, marks):
            if found.since_seq is None or not self._commanded(key, found.since_seq, found.seq):
                yield Reset(found.seq, found.t_ns, *key, byte=found.byte)

    def _commanded(self, key: NodeKey, first: int, last: int) -> bool:
        """Whether a node was told anything between two frames."""
        return any(
            command.seq < last and command.node in (0, key[1])
            for command in self._commands.since(key[0], first + 1)
        )

    def _wake(self, key: NodeKey) -> None:
        """Take in what waits of a node."""
        waited = self._calm[key[0]].wake(key[1])
        if waited is None:
            return
        self._control[key].go_on(waited)
        life_ns = waited.life[1]
        longest_ns = int((life_ns[1:] - life_ns[:-1]).max(initial=0))
        self._quietness[key].go_on(waited.t_ns, longest_ns, int(life_ns[-1]))
        self._blank[key] = False

    def _wake_all(self, bus: int | None = None) -> None:
        for number, calm in self._calm.items():
            for node in calm.awake(()) if bus in (None, number) else ():
                self._wake((number, node))

    def _live(self, batch: IndexedBatch, key: NodeKey, sent: Sent) -> None:
        """Take in when a node was heard."""
        control = self._control.get(key)
        if control is None:
            control = self._control[key] = ErrorControl(timed=self._context.timed)
        heard = self._heard.pop(key, None)
        if heard is None and control.unheard:
            control.live_otherwise(int(batch.frames.t_ns[sent.last]))
            return
        frames, rows = batch.frames, sent.rows
        beat = _ERROR_CONTROL[frames.can_id[rows]]
        # A request that a logger stored as a data frame without data is no sign of life.
        told = ~(beat & (frames.dlc[rows] == 0))
        alive = rows[told]
        life = (batch.seqs_at(alive), frames.t_ns[alive])
        self._note_cuts(key, heard or no_columns(), life, beat[told])
        control.live(life)
        if heard is not None:
            self._calm[key[0]].settle(key[1], control.steady)

    def _note_cuts(
        self,
        key: NodeKey,
        columns: Columns,
        life: tuple[Int64s, Int64s],
        beat: Mask,
    ) -> None:
        """Note where a silence of the node may have ended, and 00h that is understood only later."""
        cuts = self._found_cuts.setdefault(key, [])
        if key not in self._pdos:
            cuts[:] = sorted(cuts)[-1:]
        if self._context.timed:
            cuts += self._quietness.setdefault(key, Quietness()).follow(*life, beat)
        told = np.flatnonzero(~columns.remote)
        blank = (columns.dlc[told] == 0) | ((columns.dlc[told] == 1) & (columns.byte[told] == 0))
        if len(told):
            before = np.concatenate(([self._blank.get(key, False)], blank[:-1]))
            first = told[blank & ~before]
            cuts += zip(columns.seq[first].tolist(), columns.t_ns[first].tolist(), strict=True)
            self._blank[key] = bool(blank[-1])

    def _cuts(self, key: NodeKey) -> list[tuple[int, int]]:
        """(seq, t_ns) of what may change the node's state and was not told before."""
        cuts = self._found_cuts.pop(key, [])
        control = self._control.get(key)
        beats = control.beats if control else []
        if (told := self._cut_beats.get(key, 0)) < len(beats):
            cuts += [(beat.seq, beat.t_ns) for beat in beats[told:]]
            self._cut_beats[key] = len(beats)
        commands = self._commands.by_bus.get(key[0], [])
        if (told := self._cut_commands.get(key, 0)) < len(commands):
            cuts += [(c.seq, c.t_ns) for c in commands[told:] if c.node in (0, key[1])]
            self._cut_commands[key] = len(commands)
        return cuts

    def _tell(
        self,
        table: NmtTable,
        key: NodeKey,
        spans: list[PdoSpan],
        end_ns: int,
        clock: ClockTable,
        alone: bool,
        witnesses: Witnesses,
    ) -> None:
        control = self._control.get(key) or ErrorControl(timed=self._context.timed)
        commands = [c for c in self._commands.by_bus.get(key[0], []) if c.node in (0, key[1])]
        commands = sorted([*commands, *self._sdo_resets(key)], key=lambda c: c.seq)
        history = NodeHistory(
            bus=key[0],
            node=key[1],
            beats=control.beats,
            silences=control.silences,
            commands=commands,
            spans=spans,
            gaps=sorted(
                self._gaps.get(key[0], []) + self._gaps.get(None, []), key=lambda entry: entry[0]
            ),
            first_ns=self._first[1] if self._first else 0,
            end_ns=end_ns,
            period_ns=control.slowest_ns(),
            period_since_ns=control.slowest_since_ns(),
            guard_period_ns=control.guarding.periods.median_ns(),
            unseen=control.counts.unseen,
            paces=control.paces.paces,
            stretches=control.paces.stretches,
            even=control.paces.even,
            alone=alone,
            others_anew=others_anew(self._starts, key),
            others_beat=others_beat(self._control, key),
            witnesses=witnesses,
            communication_errors=self._errors.get(key, ()),
            missed_masters=self._missed.get(key, ()),
            no_errors=self._no_errors.get(key, ()),
            heard_ns=control.heard_last_ns,
            told_ns=control.last_beat_ns,
        )
        timeline = Timeline(self._context, history, clock)
        table.timelines[key] = timeline
        measures = self._measures[key] = Measures(self._context, timeline)
        bus = self._context.bus_name(key[0])
        table.states.extend(
            NmtStateRow(
                bus, key[1], i.state.value, i.start_ns, i.end_ns, i.cause, i.certainty, i.evidence
            )
            for i in timeline.intervals
        )
        boot_ups = [BootUp(bus, key[1], *boot) for boot in timeline.boot_ups]
        table.boot_ups.extend(boot_ups)
        extra = len(boot_ups) - control.counts.boot_ups
        control.counts.boot_ups += extra
        control.counts.heartbeats -= extra
        late = [entry for entry in control.paces.late if not measures.explains(entry)]
        toggles = [entry for entry in control.toggles if not self._restarted(key, entry)]
        control.counts.toggle_errors -= len(control.toggles) - len(toggles)
        table.nodes[key] = NodeNmt(
            counts=control.counts,
            heartbeat_period_ns=control.median_ns() if self._context.timed else None,
            share=shares(timeline.intervals),
            final_state=timeline.intervals[-1].state.value if timeline.intervals else "UNKNOWN",
            alive=control.alive,
            period_us=control.paces.quantiles(late),
            confirmed_ms=quantiles_ms(measures.confirmations()),
            boot_ms=quantiles_ms(measures.boot_times()),
            guarding=control.guarding,
            paces=control.paces,
            late=late,
            odd=control.odd,
            doubles=control.doubles,
            twins=control.twins,
            pairs=control.pairs,
            pdo_doubles=self._pdos.doubles.get(key, {}),
            toggles=toggles,
            violations=timeline.violations,
            heard_ns=control.heard_last_ns,
            told_ns=control.last_beat_ns,
            off_pace=timeline.off_pace,
            pdos="no" if not spans else "guess" if all(s.guess for s in spans) else "bound",
        )

    def _tell_emptied(self, end_ns: int, clock: ClockTable) -> None:
        """Tell boot-ups from heartbeats that a remote frame has emptied, now that all is known."""
        for (bus, node), control in self._control.items():
            gaps = sorted(
                (seq, gap.start_ns)
                for seq, gap in self._gaps.get(bus, []) + self._gaps.get(None, [])
            )
            resets = [
                (c.seq, c.t_ns)
                for c in self._commands.by_bus.get(bus, [])
                if c.specifier in RESETS and c.node in (0, node)
            ]
            period_ns = control.slowest_ns() if self._context.timed else None
            if self._context.timed:
                heard = [0, *(seq for seq, _ in gaps)]
                asked = [seq for seq, _ in resets]
                writes = self._written((bus, node))
                control.tell_anew(never_booted(control.beats, heard, asked, period_ns, writes))
            if control.counts.empty and period_ns is not None:
                boots = restarted(
                    self._context,
                    (bus, node),
                    control.beats,
                    sorted([*gaps, *resets]),
                    period_ns,
                    end_ns,
                    zeros=control.zeros,
                )
                control.tell_anew(boots)
                if control.zeros:
                    self._tell_powered_on((bus, node), control, clock)

    def _tell_powered_on(self, key: NodeKey, control: ErrorControl, clock: ClockTable) -> None:
        """Tell the boot-ups among empty heartbeats after the machine was off, and what they reset."""
        anew = booted_with(self._control, key)
        boots = powered_on(self._context, key, control.beats, anew, clock)
        control.tell_anew(boots)
        for boot in boots:
            self._context.shadow.reset(*key, boot.seq, boot.t_ns)

    def _written(self, key: NodeKey) -> list[int]:
        """When 1017h of a node was written [ns]."""
        shadow, place = self._context.shadow, (*key, PRODUCER_TIME)
        known = (shadow.get(*place, 0, seq) for seq in shadow.changes(*place))
        return sorted(k.t_ns for k in known if k and k.source == "sdo-write" and k.t_ns is not None)

    def _restarted(self, key: NodeKey, toggle: Repeated) -> bool:
        """Whether a write began the toggle bit anew between two answers (a device's habit)."""
        shadow = self._context.shadow
        return any(
            toggle.before_seq < seq < toggle.seq
            for place in quirks(shadow.device(*key)).guard_toggle_restarts_on
            for seq in shadow.changes(*key, *place)
        )

    def _sdo_resets(self, key: NodeKey) -> Iterator[Command]:
        """Writes by which a device resets, as its maker says (2002h of the JN2100)."""
        shadow = self._context.shadow
        writes = quirks(shadow.device(*key)).reset_writes
        for place, history in shadow.history(*key) if writes else ():
            for change in history.changes if place in writes else ():
                known = change.known
                if known and change.cause == "sdo-write" and known.value == writes[place]:
                    how = f"reset by SDO ({place[0]:04X}h)"
                    yield Command(change.seq, change.t_ns, RESETS[0], key[1], how)


def _mark(command: Command) -> int:
    return reset_mark(command.seq) if command.specifier in RESETS else command.seq


def _asked(batch: IndexedBatch, bus: int) -> dict[int, Rows]:
    """By node, the remote frames to its error control."""
    asked = batch.rows_of(Service.ERROR_CONTROL, remote=True)
    asked = asked[batch.frames.bus[asked] == bus]
    nodes = batch.frames.can_id[asked] & 0x7F
    return {node: asked[nodes == node] for node in distinct(nodes)}
