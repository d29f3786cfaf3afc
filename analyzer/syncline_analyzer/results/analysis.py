"""Everything one pass over a capture tells."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results.angle import (
    FollowerRow,
    ShaftRow,
    ShaftTrace,
    Trace,
    TraceEventRow,
    TraceRow,
)
from syncline_analyzer.results.bus import (
    BusErrorRow,
    BusLoadRow,
    BusShareRow,
    BusSilenceRow,
    BusStateRow,
    ClockStepRow,
    DoubledRow,
    LssRow,
    NodeShareRow,
    OverloadRow,
    TimeStampRow,
)
from syncline_analyzer.results.capture import CaptureRow
from syncline_analyzer.results.device import DeviceHealthRow, ObjectChangeRow
from syncline_analyzer.results.emcy import EmcyContextRow, EmcyRow, ErrorHistoryRow, ErrorRow
from syncline_analyzer.results.finding import Finding
from syncline_analyzer.results.nodes import NmtCommandRow, NmtStateRow, NodeRow
from syncline_analyzer.results.sdo import ObjectHistoryRow, ObjectRow
from syncline_analyzer.results.sdo_transfers import SdoTransfers
from syncline_analyzer.results.tilt import TiltRow, TiltTrace
from syncline_analyzer.results.timing import (
    ErrorControlRow,
    HoleRow,
    PdoLengthRow,
    PdoPauseRow,
    PdoRow,
    Responses,
    SyncDoubleRow,
    SyncJitterRow,
    SyncRow,
    WorstRow,
)
from syncline_analyzer.results.waiting import DelayRow, LatenessRow, WaitRow
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A quantity over time for plots: t_ns (n,) int64, value (n,) float64 in `unit`.

    Of SYNC periods `histogram` (k,) int64 holds the counts of `edges` (k + 1,) in `unit` over all of
    them, also where points are thinned away.
    """

    bus: str
    name: str
    unit: str
    t_ns: NDArray[np.int64]
    value: NDArray[np.float64]
    histogram: NDArray[np.int64] | None = None
    edges: NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True, repr=False)
class Analysis:
    """Everything one pass over a capture tells."""

    capture: CaptureRow
    nodes: list[NodeRow]
    nmt_commands: list[NmtCommandRow]
    nmt_states: list[NmtStateRow]
    sync: list[SyncRow]
    pdos: list[PdoRow]
    emcy: list[EmcyRow]
    errors: list[ErrorRow]
    sdo: SdoTransfers
    traces: list[TraceRow]
    bus_load: list[BusLoadRow]
    findings: list[Finding]
    trace_data: list[Trace] = field(default_factory=list)
    responses: list[Responses] = field(default_factory=list)
    holes: list[HoleRow] = field(default_factory=list)
    sync_jitter: list[SyncJitterRow] = field(default_factory=list)
    trace_events: list[TraceEventRow] = field(default_factory=list)
    series: list[Series] = field(default_factory=list)
    """Plots over time: bus load ("bus load", "%"), SYNC period ("SYNC 080h period", "us")."""
    objects: list[ObjectRow] = field(default_factory=list)
    object_history: list[ObjectHistoryRow] = field(default_factory=list)
    emcy_context: list[EmcyContextRow] = field(default_factory=list)
    error_history: list[ErrorHistoryRow] = field(default_factory=list)
    pdo_pauses: list[PdoPauseRow] = field(default_factory=list)
    clock_steps: list[ClockStepRow] = field(default_factory=list)
    bus_silences: list[BusSilenceRow] = field(default_factory=list)
    overloads: list[OverloadRow] = field(default_factory=list)
    bus_shares: list[BusShareRow] = field(default_factory=list)
    node_shares: list[NodeShareRow] = field(default_factory=list)
    sync_doubles: list[SyncDoubleRow] = field(default_factory=list)
    bus_states: list[BusStateRow] = field(default_factory=list)
    bus_errors: list[BusErrorRow] = field(default_factory=list)
    lss: list[LssRow] = field(default_factory=list)
    time_stamps: list[TimeStampRow] = field(default_factory=list)
    doubled: list[DoubledRow] = field(default_factory=list)
    tilts: list[TiltRow] = field(default_factory=list)
    tilt_data: list[TiltTrace] = field(default_factory=list)
    shafts: list[ShaftRow] = field(default_factory=list)
    followers: list[FollowerRow] = field(default_factory=list)
    shaft_data: list[ShaftTrace] = field(default_factory=list)
    error_control_periods: list[ErrorControlRow] = field(default_factory=list)
    worst: list[WorstRow] = field(default_factory=list)
    unsent_pdos: list[PdoRow] = field(default_factory=list)
    """PDOs that were asked for by remote frames, and never came."""
    waits: list[WaitRow] = field(default_factory=list)
    """The worst answers of each synchronous PDO, with the frames that went ahead of them."""
    delays: list[DelayRow] = field(default_factory=list)
    """Whose frames synchronous PDOs waited for."""
    lateness: list[LatenessRow] = field(default_factory=list)
    """Why synchronous PDOs were late or missed."""
    object_changes: list[ObjectChangeRow] = field(default_factory=list)
    """Every change of a parameter: who, when, from what to what, in words."""
    device_health: list[DeviceHealthRow] = field(default_factory=list)
    """Wear counters, hours, temperatures and error lists that were read."""
    pdo_lengths: list[PdoLengthRow] = field(default_factory=list)
    """How long the frames of each PDO identifier are."""

    def __repr__(self) -> str:
        from syncline_analyzer.views.markdown import extent, verdict

        return f"<analysis of {extent(self).rstrip('.')}: {verdict(self).lower()}>"

    def _repr_html_(self) -> str:
        from syncline_analyzer.views.notebook import analysis_html

        return analysis_html(self)
