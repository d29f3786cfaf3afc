"""Angle traces: position-like objects of encoders and inclinometers over time."""

from bisect import insort
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import field

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.angle.agreement import Agreements, Disagreement
from syncline_analyzer.folds.angle.cuts import WRITE_NS, Cuts, explained
from syncline_analyzer.folds.angle.followers import Followers
from syncline_analyzer.folds.angle.frozen import with_frozen
from syncline_analyzer.folds.angle.leaps import Leap
from syncline_analyzer.folds.angle.notes import (
    cut_where_lost,
    follow_fast,
    note_alarms,
    note_ambiguous,
    note_fast,
    note_frozen,
    note_gray,
)
from syncline_analyzer.folds.angle.pose import Poses
from syncline_analyzer.folds.angle.samples import (
    Key,
    SampleReader,
    Samples,
    alarm_objects,
    joined,
)
from syncline_analyzer.folds.angle.scales import Scales
from syncline_analyzer.folds.angle.shafts import Shafts
from syncline_analyzer.folds.angle.silence import held_by_design
from syncline_analyzer.folds.angle.singular import with_singular
from syncline_analyzer.folds.angle.state import MOVES, Cut, TraceState
from syncline_analyzer.folds.angle.trace import Converter, Derived, Encoder, Tilt
from syncline_analyzer.folds.timing.block import BLOCK_FRAMES, Block, Blocks
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_analyzer.results import (
    FollowerRow,
    ShaftRow,
    ShaftTrace,
    TiltRow,
    TiltTrace,
    Trace,
    TraceEventRow,
    TraceRow,
)
from syncline_schemas.batch import Gap
from syncline_schemas.devices import quirks
from syncline_schemas.measurement import (
    measured_by,
    sent_in,
    tilt_axis,
)
from syncline_schemas.records import dataclass

STOOD_COUNTS = 2
"""A value that differs by no more has stood."""
HELD_NS = 3_000_000_000
"""So long samples wait: those after them show whether a wire set the position meanwhile."""
MOST_HELD = 200_000
BY_WIRE = "preset by wire"


@dataclass(frozen=True, slots=True)
class AngleTables:
    """Everything about angles."""

    traces: list[TraceRow] = field(default_factory=list)
    trace_data: list[Trace] = field(default_factory=list)
    events: list[TraceEventRow] = field(default_factory=list)
    tilts: list[TiltRow] = field(default_factory=list)
    tilt_data: list[TiltTrace] = field(default_factory=list)
    shafts: list[ShaftRow] = field(default_factory=list)
    followers: list[FollowerRow] = field(default_factory=list)
    shaft_data: list[ShaftTrace] = field(default_factory=list)


class AngleFold:
    """Traces of all position-like objects (analysis.md section 7), from TPDOs and SDO reads.

    Comes after the fold that fills the shadow. A trace is cut at a gap, a reset, a change of scale,
    and at the writes that its device names (preset, teach, zero ...).
    """

    def __init__(self, context: Context, block_frames: int = BLOCK_FRAMES) -> None:
        self._context = context
        self._blocks = Blocks(block_frames)
        self._bindings = PdoBindings(context.shadow)
        self._reader = SampleReader(context.shadow, self._bindings)
        self._states: dict[Key, TraceState] = {}
        self._seen: dict[int, int] = {}
        self._scales = Scales(context)
        self._cuts = Cuts(context, self._scales)
        self._poses = Poses(context)
        self._shafts = Shafts(context)
        self._followers = Followers(context)
        self._agreements = Agreements()
        self._ends: deque[tuple[int, int]] = deque()
        """(t_ns, seq) of the ends of the last blocks."""

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        for block in self._blocks.add(batch):
            self._take(block)

    def gap(self, gap: Gap) -> None:
        """Nothing is joined over a gap."""
        self._flush()
        for key, state in sorted(self._states.items()):
            if gap.bus in (None, key[0]):
                self._release(key, state)
                state.cut(self._seen.get(key[0], 0), gap.start_ns, f"capture gap: {gap.reason}")
                state.pauses.cut()
        self._join()

    def finish(
        self,
        end_ns: int,
        starts: Sequence[tuple[str, int, int]] = (),
        lost: Sequence[tuple[str, int, int, int]] = (),
    ) -> AngleTables:
        """All traces; a jump that a write explains is told as a cut.

        Args:
            end_ns: end of the capture.
            starts: (bus, node, t_ns) of every restart; a jump over one is none.
            lost: (bus, node, start_ns, end_ns) of every stretch in which a node was LOST.
        """
        self._flush()
        for key, state in sorted(self._states.items()):
            self._release(key, state)
        self._join()
        tables = AngleTables(
            tilts=self._poses.rows(),
            tilt_data=self._poses.traces(),
            shafts=self._shafts.rows(),
            shaft_data=self._shafts.traces(),
        )
        for key, state in sorted(self._states.items()):
            bus, node, _ = key
            note_fast(state)
            note_ambiguous(state)
            note_gray(state)
            trace = state.trace()
            for name, number, start_ns, stop_ns in lost if self._context.timed else ():
                if (name, number) == (state.bus, node):
                    cut_where_lost(state, trace, start_ns, stop_ns)
            tables.traces.append(state.row())
            tables.trace_data.append(trace)
            writes = self._cuts.writes(bus, node)
            own = [t for name, n, t in starts if (name, n) == (state.bus, node)]
            for event in sorted(state.events, key=lambda event: event.seq):
                since_ns = state.moved_from_ns.get(event.seq, event.t_ns)
                if not explained(event, writes) and not _restarted(event, since_ns, own):
                    tables.events.append(event)
        tables.events.extend(self._shafts.events())
        tables.followers.extend(self._followers.rows())
        return tables

    def _flush(self) -> None:
        for block in self._blocks.flush():
            self._take(block)

    def _take(self, block: Block) -> None:
        until = self._until(block)
        for bus in block.by_bus:
            found = with_frozen(self._reader.read(block, bus), self._quantity)
            nodes = {node for _, node, _ in found} | {n for b, n, _ in self._states if b == bus}
            last_seq = block.batch.last_seq
            first = self._seen.get(bus, -1)
            cuts = {node: self._cuts.within(block, bus, node, first) for node in nodes}
            edges = {node: [cut.seq for cut in cuts[node]] for node in nodes}
            found = with_singular(found, edges, self._scales.converter)
            for key in sorted(set(found) | {k for k in self._states if k[0] == bus}):
                self._extend(key, found.get(key), cuts[key[1]], until)
            for key, disagreements in self._agreements.compare(found).items():
                self._note_disagreements(key, disagreements if self._context.timed else [])
            self._seen[bus] = last_seq
        self._join()

    def _join(self) -> None:
        """Compare what came in of axes and of shafts."""
        self._poses.join()
        self._shafts.join()

    def _until(self, block: Block) -> int:
        """The last `seq` after which enough was heard to judge it."""
        t_ns, last_seq = block.frames.t_ns, block.batch.last_seq
        if not self._context.timed or not len(t_ns):
            return last_seq
        limit_ns = int(t_ns[-1]) - HELD_NS
        if block.batch.ascending:
            done = int(np.searchsorted(t_ns, limit_ns, side="right")) - 1
        else:
            done = int(np.flatnonzero(t_ns <= limit_ns).max(initial=-1))
        until = -1
        while self._ends and self._ends[0][0] <= limit_ns:
            until = self._ends.popleft()[1]
        self._ends.append((int(t_ns[-1]), last_seq))
        return block.batch.seq(done) if done >= 0 else until

    def _quantity(self, key: Key) -> tuple[int, int, str, int]:
        """What an object measures: two objects of the same axis measure the same."""
        bus, node, number = key
        device = self._context.shadow.device(bus, node)
        device_type = self._context.shadow.number(bus, node, 0x1000)
        by, _ = measured_by(device, device_type, number >> 8, number & 0xFF)
        axis = tilt_axis(by, number >> 8)
        return (bus, node, "object", number) if axis is None else (bus, node, "axis", axis)

    def _extend(self, key: Key, samples: Samples | None, cuts: list[Cut], until: int) -> None:
        """Add the samples of a block to a trace, cut where it must be."""
        if samples is None and key not in self._states:
            return
        if key not in self._states:
            bus, node, number = key
            self._states[key] = TraceState(self._context.bus_name(bus), node, number)
        state = self._states[key]
        if samples is not None:
            cuts = sorted([*cuts, *self._silences(key, state, samples)])
            held = [] if state.held is None else [state.held]
            state.held = joined([*held, samples])
            cuts = self._placed(key, state.held, cuts)
            self._look_ahead(state, key, samples, cuts)
        state.held_cuts = sorted([*state.held_cuts, *cuts])
        if state.held is not None and len(state.held.seq) > MOST_HELD:
            until = int(state.held.seq[-1])
        self._advance(key, state, until)

    def _release(self, key: Key, state: TraceState) -> None:
        """Add all samples that wait: what comes next does not go on from them."""
        self._foresee(state, key, state.leaps.end())
        last = -1 if state.held is None else int(state.held.seq[-1])
        self._advance(key, state, max([last, *(cut.seq for cut in state.held_cuts)]))

    def _advance(self, key: Key, state: TraceState, until: int) -> None:
        """Add the samples up to `until`."""
        due = [cut for cut in state.held_cuts if cut.seq <= until]
        state.held_cuts = state.held_cuts[len(due) :]
        samples = state.held
        if samples is None:
            for cut in due:
                _cut(state, cut)
            return
        begin = 0
        for cut in due:
            stop = max(int(np.searchsorted(samples.seq, cut.seq)), begin)
            self._add(state, key, samples.part(begin, stop))
            state.leapt(cut.seq if cut.text == BY_WIRE else cut.seq - 1)
            _cut(state, cut)
            begin = stop
        stop = int(np.searchsorted(samples.seq, until, side="right"))
        self._add(state, key, samples.part(begin, stop))
        rest = samples.part(max(stop, begin), len(samples.seq))
        state.held = rest if len(rest.seq) else None
        state.leapt(until)

    def _look_ahead(
        self, state: TraceState, key: Key, samples: Samples, cuts: Sequence[Cut]
    ) -> None:
        """Find the steps and spikes of samples that are not taken in yet."""
        begin = 0
        told = [cut for cut in cuts if cut.text]
        for cut in told if self._context.timed else ():
            stop = int(np.searchsorted(samples.seq, cut.seq))
            self._look_at(state, key, samples.part(begin, max(stop, begin)))
            self._foresee(state, key, state.leaps.end())
            begin = max(stop, begin)
        self._look_at(state, key, samples.part(begin, len(samples.seq)))

    def _look_at(self, state: TraceState, key: Key, piece: Samples) -> None:
        """Steps and spikes that the speed limit lets pass, source by source."""
        if not len(piece.seq) or not self._context.timed:
            return
        converter = self._scales.converter(key, piece, int(piece.seq[0]))
        if not isinstance(converter, Encoder):
            return
        bus, node, _ = key
        shadow, last = self._context.shadow, int(piece.seq[-1])
        wired = quirks(shadow.device(bus, node)).hardware_preset
        preset = (shadow.number(bus, node, 0x6003, 0, last) or 0) if wired else None
        for source in (np.flatnonzero(np.bincount(piece.source + 1)) - 1).tolist():
            rows = np.flatnonzero((piece.source == source) & piece.told)
            if len(rows):
                scale = sent_in(converter.scale, int(piece.widths[rows].min()))
                columns = (piece.seq[rows], piece.t_ns[rows], piece.raw[rows])
                self._foresee(state, key, state.leaps.add(source, columns, scale, preset))

    def _foresee(self, state: TraceState, key: Key, leaps: Sequence[Leap]) -> None:
        """Remember leaps until their samples are taken in; a preset by wire cuts the trace."""
        writes = self._cuts.writes(*key[:2])
        for leap in leaps:
            state.ahead.append(leap)
            waits = state.held is not None and leap.seq >= state.held.seq[0]
            near = any(abs(cut.t_ns - leap.t_ns) <= WRITE_NS for cut in writes)
            if leap.kind == "preset" and waits and not near:
                self._cut_by_wire(state, leap)

    @staticmethod
    def _cut_by_wire(state: TraceState, leap: Leap) -> None:
        """One cut for all sources that show a preset, where the one that tells the motion does."""
        assert state.held is not None
        cut = Cut(leap.seq, leap.t_ns, BY_WIRE, False)
        for told in state.held_cuts:
            if told.text == BY_WIRE and abs(told.t_ns - leap.t_ns) <= WRITE_NS:
                row = int(np.searchsorted(state.held.seq, leap.seq))
                if int(state.held.source[row]) != state.link.counted:
                    return
                state.held_cuts.remove(told)
                break
        insort(state.held_cuts, cut)

    def _silences(self, key: Key, state: TraceState, samples: Samples) -> Iterator[Cut]:
        """Cuts at the samples after a long silence, unless the value is told to have stood."""
        if not self._context.timed:
            return
        state.narrowest = min(state.narrowest, int(samples.widths.min()))
        low = (1 << min(state.narrowest, 62)) - 1
        mixed = samples.entry.kind == "unsigned"
        raw = samples.raw & low if mixed else samples.raw
        before = (
            int(raw[0])
            if state.last_raw is None
            else state.last_raw & low
            if mixed
            else state.last_raw
        )
        state.last_raw = int(raw[-1])
        state.pauses.compare(raw)
        for row, span_ns in state.pauses.silent(samples.t_ns):
            seq, source = int(samples.seq[row]), int(samples.source[row])
            shadow = self._context.shadow
            by_design = held_by_design(shadow, self._bindings, key[0], source, seq)
            if by_design:
                continue
            state.silent.append(seq)
            moved = abs(int(raw[row]) - int(raw[row - 1] if row else before))
            if by_design is None and not state.pauses.repeats and moved <= STOOD_COUNTS:
                continue
            text = f"no samples for {span_ns / 1e9:.4g} s"
            yield Cut(seq, int(samples.t_ns[row]), text, False)

    def _placed(self, key: Key, samples: Samples, cuts: list[Cut]) -> list[Cut]:
        """The cuts; a write's cut is put where the value jumps, which may be before its answer."""
        placed: list[Cut] = []
        for cut in cuts:
            if cut.write and self._context.timed:
                near = np.flatnonzero(np.abs(samples.t_ns - cut.t_ns) <= WRITE_NS)
                jumps = self._jumps_of(key, samples, near, cut.seq)
                if jumps:
                    row = min(jumps, key=lambda row: abs(int(samples.t_ns[row]) - cut.t_ns))
                    cut = cut._replace(seq=int(samples.seq[row]))
            insort(placed, cut)
        return placed

    def _jumps_of(self, key: Key, samples: Samples, rows: np.ndarray, seq: int) -> list[int]:
        if not len(rows):
            return []
        piece = samples.part(int(rows[0]), int(rows[-1]) + 1)
        converter = self._scales.converter(key, piece, seq)
        trial = TraceState("", 0, 0)
        derived = converter.derive(trial.link, piece, timed=True)
        jumps = derived.speeds.jumps if derived.speeds else []
        return [int(rows[0]) + jump.row for jump in jumps]

    def _add(self, state: TraceState, key: Key, piece: Samples) -> None:
        if not len(piece.seq):
            return
        converter = self._scales.converter(key, piece, int(piece.seq[0]))
        if state.begun and not converter.same_scale(state.converter):
            state.cut(int(piece.seq[0]), int(piece.t_ns[0]), "another scale")
        derived = state.add(piece, converter, timed=self._context.timed)
        if isinstance(converter, Tilt):
            self._poses.take(key, piece, derived, converter)
        elif isinstance(converter, Encoder):
            rows = np.flatnonzero(derived.counted)
            line, own = derived.columns["unwrapped_deg"][rows], piece.at(rows)
            self._shafts.take(key, own, line, state.segment, converter)
            self._followers.take(key, own, line, state.segment, converter)
        self._note_jumps(state, key, piece, derived, converter)
        state.leapt(int(piece.seq[-1]))
        self._note_outside(state, piece, derived, converter)
        note_frozen(state, piece)
        device = self._context.shadow.device(key[0], key[1])
        if (key[2] >> 8, key[2] & 0xFF) in alarm_objects(device):
            note_alarms(state, piece, device)
        elif isinstance(converter, Encoder) and device and "gray" in device.measurement:
            state.gray.add(piece.raw[piece.valid], converter.scale.range_counts)

    def _note_jumps(
        self,
        state: TraceState,
        key: Key,
        piece: Samples,
        derived: Derived,
        converter: Converter,
    ) -> None:
        jumps = derived.speeds.jumps if derived.speeds else []
        room = state.room("jump")
        for jump in jumps if state.preset and room else jumps[:room]:
            limit = converter.scale.max_rpm if isinstance(converter, Encoder) else None
            seq, t_ns = int(piece.seq[jump.row]), int(piece.t_ns[jump.row])
            if state.preset_within(t_ns - jump.span_ns, t_ns):
                continue
            text = self._jump_text(key, jump.after, converter, seq) if state.room("jump") else ""
            state.moved("jump", seq, t_ns - jump.span_ns)
            state.note(
                "jump",
                seq,
                t_ns,
                jump.before,
                jump.after,
                f"{jump.span_ns / 1e6:.4g} ms apart, which would take {jump.speed_rpm:.0f} rpm;"
                f" the device turns at most {limit:.0f} rpm{text}",
            )

        fast = derived.speeds is not None and len(derived.speeds.fast) > 0
        if fast and isinstance(converter, Encoder) and converter.scale.max_rpm:
            follow_fast(state, piece, derived, converter.scale.max_rpm)

    def _note_disagreements(self, key: Key, found: Sequence[Disagreement]) -> None:
        """Stretches in which 16 bits of an angle are not the lower half of its 32 bits."""
        for each in found:
            converter = self._states[key].converter
            if not isinstance(converter, Tilt):
                continue
            away_deg = each.counts * converter.step_deg
            one, two = (raw * converter.step_deg for raw in each.raw)
            text = f"{abs(away_deg):.4g} deg off the same axis in 32 bits"
            self._states[key].note("disagrees", each.seq, each.t_ns, two, one, text)

    def _jump_text(self, key: Key, after: float, converter: Converter, seq: int) -> str:
        """Hint at the wire that sets the position of some devices without a bus message."""
        bus, node, _ = key
        device = self._context.shadow.device(bus, node)
        if not quirks(device).hardware_preset or not isinstance(converter, Encoder):
            return ""
        preset = self._context.shadow.number(bus, node, 0x6003, 0, seq) or 0
        per_turn = converter.scale.counts_per_turn or 1
        total = converter.scale.range_counts or 1
        distance = min((after - preset) % total, (preset - after) % total)
        return f"; it landed at the preset value {preset}" if distance < per_turn else ""

    @staticmethod
    def _note_outside(
        state: TraceState, piece: Samples, derived: Derived, converter: Converter
    ) -> None:
        """The first sample of each stretch of impossible values."""
        outside = derived.flags >> 4 & 1
        starts = np.flatnonzero(np.diff(outside.astype(np.int8), prepend=int(state.outside)) > 0)
        state.outside = bool(outside[-1])
        doubtful = sorted(state.assumed - {"direction"})
        if isinstance(converter, Tilt) and converter.may_be_zeroed:
            doubtful.append("reference")
        assumed = f"assumed: {', '.join(doubtful)}" if doubtful else "scale as read"
        for row in starts[: state.room("out of range")].tolist():
            state.note(
                "out of range",
                int(piece.seq[row]),
                int(piece.t_ns[row]),
                None,
                float(derived.value[row]),
                assumed,
            )


def _restarted(event: TraceEventRow, since_ns: int, starts: Sequence[int]) -> bool:
    """Whether the device started anew between the two samples of a jump."""
    return event.kind in MOVES and any(since_ns <= start <= event.t_ns for start in starts)


def _cut(state: TraceState, cut: Cut) -> None:
    if cut.write:
        state.gray.rescaled()
    if cut.text:
        state.cut(cut.seq, cut.t_ns, cut.text)
