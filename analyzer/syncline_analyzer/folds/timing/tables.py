"""What the fold over SYNC, PDOs and bus load tells in the end."""

from dataclasses import dataclass, field

from syncline_analyzer.results import (
    BusLoadRow,
    BusSilenceRow,
    ClockStepRow,
    HoleRow,
    OverloadRow,
    PdoPauseRow,
    PdoRow,
    Responses,
    Series,
    SyncDoubleRow,
    SyncJitterRow,
    SyncRow,
)


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
    sync_doubles: list[SyncDoubleRow] = field(default_factory=list)
