"""What the fold over SYNC, PDOs and bus load tells in the end."""

from dataclasses import field

from syncline_analyzer.results import (
    BusLoadRow,
    BusShareRow,
    BusSilenceRow,
    ClockStepRow,
    DelayRow,
    ErrorControlRow,
    HoleRow,
    LatenessRow,
    NodeShareRow,
    OverloadRow,
    PdoPauseRow,
    PdoRow,
    Responses,
    Series,
    SyncDoubleRow,
    SyncJitterRow,
    SyncRow,
    WaitRow,
    WorstRow,
)
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class TimingTables:
    """Everything about SYNC, PDOs and bus load."""

    sync: list[SyncRow] = field(default_factory=list)
    pdos: list[PdoRow] = field(default_factory=list)
    bus_load: list[BusLoadRow] = field(default_factory=list)
    holes: list[HoleRow] = field(default_factory=list)
    sync_jitter: list[SyncJitterRow] = field(default_factory=list)
    responses: list[Responses] = field(default_factory=list)
    series: list[Series] = field(default_factory=list)
    pdo_pauses: list[PdoPauseRow] = field(default_factory=list)
    clock_steps: list[ClockStepRow] = field(default_factory=list)
    bus_silences: list[BusSilenceRow] = field(default_factory=list)
    overloads: list[OverloadRow] = field(default_factory=list)
    bus_shares: list[BusShareRow] = field(default_factory=list)
    node_shares: list[NodeShareRow] = field(default_factory=list)
    sync_doubles: list[SyncDoubleRow] = field(default_factory=list)
    error_control_periods: list[ErrorControlRow] = field(default_factory=list)
    worst: list[WorstRow] = field(default_factory=list)
    unsent_pdos: list[PdoRow] = field(default_factory=list)
    waits: list[WaitRow] = field(default_factory=list)
    delays: list[DelayRow] = field(default_factory=list)
    lateness: list[LatenessRow] = field(default_factory=list)
