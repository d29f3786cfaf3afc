"""Everything one pass over a capture tells."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results.angle import Trace, TraceEventRow, TraceRow
from syncline_analyzer.results.bus import (
    BusErrorRow,
    BusLoadRow,
    BusSilenceRow,
    BusStateRow,
    ClockStepRow,
    DoubledRow,
    LssRow,
    OverloadRow,
    TimeStampRow,
)
from syncline_analyzer.results.capture import CaptureRow
from syncline_analyzer.results.emcy import EmcyContextRow, EmcyRow, ErrorHistoryRow, ErrorRow
from syncline_analyzer.results.finding import Finding
from syncline_analyzer.results.nodes import NmtCommandRow, NmtStateRow, NodeRow
from syncline_analyzer.results.sdo import ObjectHistoryRow, ObjectRow, SdoRow
from syncline_analyzer.results.timing import (
    HoleRow,
    PdoPauseRow,
    PdoRow,
    Responses,
    SyncDoubleRow,
    SyncJitterRow,
    SyncRow,
)


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A quantity over time for plots: t_ns (n,) int64, value (n,) float64 in `unit`."""

    bus: str
    name: str
    unit: str
    t_ns: NDArray[np.int64]
    value: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
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
    sdo: list[SdoRow]
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
    sync_doubles: list[SyncDoubleRow] = field(default_factory=list)
    bus_states: list[BusStateRow] = field(default_factory=list)
    bus_errors: list[BusErrorRow] = field(default_factory=list)
    lss: list[LssRow] = field(default_factory=list)
    time_stamps: list[TimeStampRow] = field(default_factory=list)
    doubled: list[DoubledRow] = field(default_factory=list)
