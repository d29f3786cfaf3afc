"""The control side of a bus in one pass: SDO transfers, NMT states, EMCY and the clock."""

from dataclasses import field, replace

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.bus.clock import ClockFold, ClockTable
from syncline_analyzer.folds.bus.errors import BusErrorFold, BusErrorTable
from syncline_analyzer.folds.bus.lss import LssFold, LssTable
from syncline_analyzer.folds.bus.time_stamp import TimeFold, TimeTable
from syncline_analyzer.folds.emcy.fold import EmcyFold, EmcyTable
from syncline_analyzer.folds.emcy.reads import no_error_reads
from syncline_analyzer.folds.nmt.fold import NmtFold
from syncline_analyzer.folds.nmt.table import NmtTable
from syncline_analyzer.folds.renumbered import Renumbered, renumbered, told_renumbered
from syncline_analyzer.folds.sdo.fold import SdoFold, SdoTable
from syncline_analyzer.folds.timing.mixed_length import MixedLengths
from syncline_analyzer.folds.timing.pdo_length import PdoLengthFold, WrongLength
from syncline_schemas.batch import Gap
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class ControlTables:
    """What the control fold found; the rules of `findings` read more of it than the rows."""

    nmt: NmtTable
    sdo: SdoTable
    emcy: EmcyTable
    clock: ClockTable
    bus_errors: BusErrorTable
    lss: LssTable = field(default_factory=LssTable)
    time: TimeTable = field(default_factory=TimeTable)
    lengths: list[WrongLength] = field(default_factory=list)
    renumbered: list[Renumbered] = field(default_factory=list)
    mixed_lengths: list[MixedLengths] = field(default_factory=list)


class ControlFold:
    """Feeds the folds that depend on one another in the right order.

    Resets that the NMT fold sees go into the SDO fold, so that the shadow learns and forgets in
    order of `seq`; the boot-ups go into the EMCY fold. Comes before every fold that asks the
    shadow.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._clock = ClockFold(context)
        self._bus_errors = BusErrorFold(context)
        self._nmt = NmtFold(context)
        self._sdo = SdoFold(context)
        self._emcy = EmcyFold(context)
        self._lss = LssFold(context)
        self._time = TimeFold(context)
        self._lengths = PdoLengthFold(context)

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        self._clock.update(batch)
        self._bus_errors.update(batch)
        self._sdo.update(batch, self._nmt.update(batch))
        self._nmt.follow(batch)
        self._emcy.update(batch)
        self._lss.update(batch)
        self._time.update(batch)
        self._lengths.update(batch)

    def gap(self, gap: Gap) -> None:
        """Take in that nothing was heard for a while."""
        self._clock.gap(gap)
        self._bus_errors.gap(gap)
        self._time.gap(gap)
        self._nmt.gap(gap)
        self._sdo.gap(gap)

    def finish(self, end_ns: int) -> ControlTables:
        """All tables; `end_ns` is the end of the capture.

        On a bus without any sign of CANopen its identifiers mean something else: no rows.
        """
        clock = self._clock.finish(end_ns)
        sdo = self._sdo.finish(end_ns)
        answering = {bus for (bus, _), count in sdo.counts.items() if count.confirmed}
        errors, missed = self._emcy.communication_errors(), self._emcy.missed_masters()
        no_errors = self._emcy.no_errors()
        nmt = self._nmt.finish(end_ns, clock, answering, errors, missed, no_errors)
        buses = {self._context.bus_name(bus) for bus in nmt.canopen}
        sdo = replace(
            sdo,
            rows=sdo.rows.of_objects(lambda each: each.bus in buses),
            counts={key: count for key, count in sdo.counts.items() if key[0] not in nmt.foreign},
        )
        alive = {key for key, count in sdo.counts.items() if count.confirmed}
        alive |= {key for key, node in nmt.nodes.items() if node.alive or node.pdos == "bound"}
        reads = no_error_reads(sdo.rows, self._context)
        emcy = self._emcy.finish(nmt.boot_ups, nmt.canopen, alive, reads)
        lss = self._lss.finish(buses)
        moved = renumbered(self._context, lss, nmt, sdo.rows)
        return ControlTables(
            told_renumbered(self._context, nmt, moved),
            sdo,
            emcy,
            clock,
            self._bus_errors.finish(end_ns),
            lss,
            self._time.finish(buses),
            self._lengths.finish(),
            moved,
            self._lengths.mixed(),
        )
