"""NMT: commands, and the state timeline of every node (analysis.md section 4)."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import partial

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.bus.clock import ClockTable
from syncline_analyzer.folds.nmt.cadence import Doubles, Int64s, Mask
from syncline_analyzer.folds.nmt.calm import FIRST_ID, Beats, measured
from syncline_analyzer.folds.nmt.columns import Columns
from syncline_analyzer.folds.nmt.command_rows import command_rows
from syncline_analyzer.folds.nmt.commands import Commands
from syncline_analyzer.folds.nmt.emptied import never_booted, powered_on, restarted
from syncline_analyzer.folds.nmt.error_control import ErrorControl, reset_mark
from syncline_analyzer.folds.nmt.events import (
    RESETS,
    Beat,
    Command,
    NodeHistory,
    PdoSpan,
    Repeated,
)
from syncline_analyzer.folds.nmt.measures import Measures, quantiles_ms, shares
from syncline_analyzer.folds.nmt.others import (
    booted_with,
    others_anew,
    others_beat,
    witnesses_of,
)
from syncline_analyzer.folds.nmt.senders import Senders, Sent
from syncline_analyzer.folds.nmt.table import BootUp, NmtTable, NodeKey, NodeNmt
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.folds.nmt.timeout import PRODUCER_TIME
from syncline_analyzer.folds.nmt.witness import Witnesses
from syncline_analyzer.folds.sdo.fold import Reset
from syncline_analyzer.folds.timing.pdo_spans import PdoSpans, Quietness
from syncline_analyzer.results import NmtStateRow
from syncline_schemas.batch import FrameFlag, Gap
from syncline_schemas.canopen.nmt import STATE_OF_BYTE, NmtState
from syncline_schemas.canopen.services import Service
from syncline_schemas.devices import quirks

_ON_COMMAND = (0x04, 0x05)
"""State bytes of STOPPED and OPERATIONAL, into which a node does not boot."""
_NOT_PDO = (Service.EMCY, Service.SDO_ANSWER, Service.ERROR_CONTROL)

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
        self._pdos: dict[NodeKey, PdoSpans] = {}
        self._gaps: dict[int | None, list[tuple[int, Gap]]] = {}
        self._cut_beats: dict[NodeKey, int] = {}
        self._cut_commands: dict[NodeKey, int] = {}
        self._found_cuts: dict[NodeKey, list[tuple[int, int]]] = {}
        self._quietness: dict[NodeKey, Quietness] = {}
        self._blank: dict[NodeKey, bool] = {}
        """Whether the last message of a node's error control told no state."""
        self._pdo_doubles: dict[NodeKey, dict[int, Doubles]] = {}
        self._pdo_last: dict[tuple[int, int], int] = {}
        """By bus number and identifier: time of the last of them."""
        self._next_seq = 0
        self._senders = Senders(context.shadow)
        self._last_ns: dict[int, int] = {}
        """By bus number: time of the last frame."""
        self._errors: Mapping[NodeKey, Sequence[int]] = {}
        self._measures: dict[NodeKey, Measures] = {}

    def update(self, batch: IndexedBatch) -> list[Reset]:
        """Take in the next frames; tells the resets among them, in order of `seq`."""
        if not len(batch):
            return []
        if self._first is None or batch.seq0 < self._first[0]:
            self._first = batch.seq0, int(batch.frames.t_ns[0])
        self._next_seq = max(self._next_seq, batch.last_seq + 1)
        resets = self._commands.take(batch)
        sent = self._senders.of(batch)
        calm = self._pass_calm(batch, sent)
        for key in sent.keys() - calm:
            resets += self._take_node(batch, key, sent[key])
        for key in self._control.keys() - sent.keys():
            if key[0] in batch.buses and (marks := self._marks(batch, key)):
                self._control[key].mark(marks)
        self._take_pdos(batch, sent)
        return sorted(resets)

    def gap(self, gap: Gap) -> None:
        """States are not known after a gap until something tells them."""
        self._gaps.setdefault(gap.bus, []).append((self._next_seq, gap))
        for (bus, _), control in self._control.items():
            if gap.bus in (None, bus):
                control.gap(gap.start_ns, self._next_seq)
        for (bus, _), pdos in self._pdos.items():
            if gap.bus in (None, bus):
                pdos.close()
        for (bus, _), quietness in self._quietness.items():
            if gap.bus in (None, bus):
                quietness.cut()

    def finish(
        self,
        end_ns: int,
        clock: ClockTable,
        canopen: AbstractSet[int] = frozenset(),
        errors: Mapping[NodeKey, Sequence[int]] | None = None,
    ) -> NmtTable:
        """Timelines of all nodes, up to the end of the capture.

        A PDO identifier alone tells of a node only on a bus that shows CANopen otherwise: by
        error control, NMT commands, SYNC, or because it is one of `canopen` (bus numbers).
        `errors` are the times of each node's EMCYs that tell of communication errors.
        """
        self._errors = errors or {}
        for control in self._control.values():
            control.finish(end_ns, self._next_seq)
        alive = {key for key, control in self._control.items() if control.alive}
        self._tell_emptied(end_ns, clock)
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
        for (bus, _), pdos in self._pdos.items():
            for span in pdos.spans() if bus in buses else ():
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

    def _pass_calm(self, batch: IndexedBatch, sent: Mapping[NodeKey, Sent]) -> set[NodeKey]:
        """Take in the nodes whose heartbeats only go on; tells which they are."""
        t_ns = batch.frames.t_ns
        last_ns = max((self._last_ns.get(bus, 0) for bus in batch.buses), default=0)
        self._last_ns |= dict.fromkeys(batch.buses, int(t_ns[-1]))
        if not self._context.timed or not batch.ascending or t_ns[0] < last_ns:
            return set()
        return {
            (bus, beats.node)
            for bus in batch.buses
            for beats in measured(batch, bus, partial(self._calm_ns, bus))
            if self._goes_on(batch, (bus, beats.node), sent.get((bus, beats.node), Sent()), beats)
        }

    def _calm_ns(self, bus: int, node: int) -> int | None:
        """The last heartbeat of a node that is calm."""
        control = self._control.get((bus, node))
        return control.calm.last_ns if control is not None and control.calm is not None else None

    def _goes_on(self, batch: IndexedBatch, key: NodeKey, sent: Sent, beats: Beats) -> bool:
        """Take in a node's frames, unless there is more to them than heartbeats that go on."""
        control, quietness = self._control.get(key), self._quietness.get(key)
        if control is None or control.calm is None or quietness is None:
            return False
        limit_ns = control.calm.limit_ns(beats, quietness.shortest_ns)
        alone = sent.control == [FIRST_ID + key[1]] and not len(sent.asked)
        if limit_ns is None or not alone or self._marks(batch, key):
            return False
        after = sent.after(int(batch.rows_by_id[beats.place.stop - 1]))
        life_ns = batch.frames.t_ns[after]
        longest_ns = int((life_ns[1:] - life_ns[:-1]).max(initial=0))
        if longest_ns > limit_ns:
            return False
        seq, t_ns = batch.seqs_by_id[beats.place], batch.t_ns_by_id[beats.place]
        control.go_on(seq, t_ns, (batch.seqs[after], life_ns))
        quietness.go_on(t_ns, longest_ns, int(life_ns[-1]))
        self._blank[key] = False
        return True

    def _take_node(self, batch: IndexedBatch, key: NodeKey, sent: Sent) -> list[Reset]:
        """One node's frames of a batch, with the remote frames to it."""
        frames, rows = batch.frames, sent.rows
        beat = batch.service[rows] == Service.ERROR_CONTROL
        control_rows = rows[beat]
        control = self._control.get(key)
        if control is None:
            control = self._control[key] = ErrorControl(timed=self._context.timed)
        data = frames.data[control_rows, 0]
        remote = (frames.flags[control_rows] & FrameFlag.REMOTE) != 0
        seq = batch.seqs[control_rows]
        columns = Columns(seq, frames.t_ns[control_rows], remote, frames.dlc[control_rows], data)
        # A request that a logger stored as a data frame without data is no sign of life.
        bare = beat & (frames.dlc[rows] == 0)
        told = ((frames.flags[rows] & FrameFlag.REMOTE) == 0) & ~bare
        alive = rows[told]
        life = (batch.seqs[alive], frames.t_ns[alive])
        self._note_cuts(key, columns, life, beat[told])
        seen = len(control.beats)
        control.feed(columns, life, self._marks(batch, key))
        fresh = control.beats[seen:]
        before = [control.beats[seen - 1] if seen else None, *fresh]
        return [
            Reset(beat.seq, beat.t_ns, *key, byte=beat.state)
            for last, beat in zip(before, fresh, strict=False)
            if beat.kind == "boot-up" or (last is not None and self._may_restart(key, last, beat))
        ]

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

    def _may_restart(self, key: NodeKey, last: Beat, beat: Beat) -> bool:
        """Whether a heartbeat may be the boot-up of a device that starts with its state byte.

        It falls to that state without a command; whether the device does so the SDO fold knows.
        """
        if (last.kind, beat.kind) != ("heartbeat", "heartbeat") or last.state not in _ON_COMMAND:
            return False
        told = any(
            last.seq < command.seq < beat.seq and command.node in (0, key[1])
            for command in reversed(self._commands.by_bus.get(key[0], []))
        )
        return not told and STATE_OF_BYTE.get(beat.state) is NmtState.PRE_OPERATIONAL

    def _marks(self, batch: IndexedBatch, key: NodeKey) -> list[int]:
        """Marks of the commands of this batch that concern a node."""
        marks = []
        for command in reversed(self._commands.by_bus.get(key[0], [])):
            if command.seq < batch.seq0:
                break
            if command.node in (0, key[1]):
                reset = command.specifier in RESETS
                marks.append(reset_mark(command.seq) if reset else command.seq)
        return marks[::-1]

    def _take_pdos(self, batch: IndexedBatch, sent: Mapping[NodeKey, Sent]) -> None:
        asked = batch.rows_of(Service.PDO, remote=True)
        asked_id, asked_bus = batch.frames.can_id[asked], batch.frames.bus[asked]
        for key, frames in sent.items():
            if frames.pdos and key not in self._pdos:
                self._pdos[key] = PdoSpans()
        for key, pdos in self._pdos.items():
            pdos.cut(self._cuts(key))
        for key, frames in sent.items():
            control = self._control.get(key)
            twice = control is not None and control.counts.boot_ups > 1
            for can_id in frames.pdos:
                seq, t_ns = batch.seqs_of(key[0], can_id), batch.t_ns_of(key[0], can_id)
                own = asked[(asked_id == can_id) & (asked_bus == key[0])] if len(asked) else asked
                self._pdos[key].take(can_id, seq, t_ns, batch.seqs[own])
                if twice:
                    self._follow_pdo(key, can_id, seq, t_ns)

    def _follow_pdo(self, key: NodeKey, can_id: int, seq: Int64s, t_ns: Int64s) -> None:
        """Look for two cadences of one PDO: a second device may have told the second boot-up."""
        before = self._pdo_last.get((key[0], can_id))
        self._pdo_last[key[0], can_id] = int(t_ns[-1])
        passed = np.diff(t_ns, prepend=t_ns[:1] if before is None else before)
        doubles = self._pdo_doubles.setdefault(key, {}).setdefault(can_id, Doubles())
        doubles.note(seq, t_ns, passed, passed > 0)

    def _cuts(self, key: NodeKey) -> list[tuple[int, int]]:
        """(seq, t_ns) of what may change the node's state and was not told before."""
        cuts: list[tuple[int, int]] = []
        control = self._control.get(key)
        beats = control.beats if control else []
        cuts.extend((beat.seq, beat.t_ns) for beat in beats[self._cut_beats.get(key, 0) :])
        self._cut_beats[key] = len(beats)
        cuts += self._found_cuts.pop(key, [])
        commands = self._commands.by_bus.get(key[0], [])
        fresh = commands[self._cut_commands.get(key, 0) :]
        self._cut_commands[key] = len(commands)
        cuts.extend((c.seq, c.t_ns) for c in fresh if c.node in (0, key[1]))
        return sorted(cuts)

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
            paces=control.paces.paces,
            stretches=control.paces.stretches,
            even=control.paces.even,
            alone=alone,
            others_anew=others_anew(self._control, key),
            others_beat=others_beat(self._control, key),
            witnesses=witnesses,
            communication_errors=self._errors.get(key, ()),
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
            pdo_doubles=self._pdo_doubles.get(key, {}),
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
