"""What is kept of one SYNC identifier from block to block."""

from dataclasses import field

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.timing.double_sync import DoubleSync
from syncline_analyzer.folds.timing.doubled_sync import Doubled
from syncline_analyzer.folds.timing.periods import Periods
from syncline_analyzer.folds.timing.sync_counter import SyncCounter
from syncline_analyzer.folds.timing.sync_pace import SyncPace
from syncline_analyzer.folds.timing.sync_settings import told_overflow, told_period
from syncline_analyzer.folds.timing.unsteady import Unsteady
from syncline_analyzer.results import ClockStepRow
from syncline_analyzer.series import Thinner
from syncline_analyzer.shadow import Shadow
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MAX_POINTS = 20_000
"""Points of the SYNC period over time."""


@dataclass(frozen=True, slots=True)
class SyncHole:
    """A stretch between two SYNCs in which `missing` are missing; `seq` are those of the two."""

    start_ns: int
    end_ns: int
    missing: int
    seq: tuple[int, int]


class Told(NamedTuple):
    """Settings of a SYNC as of a block: 1006h [us], and 1019h by then and in the end."""

    version: int | None
    period_us: int | None
    overflow_by_now: int | None
    overflow: int | None


UNTOLD = Told(None, None, None, None)


def told_of(shadow: Shadow, bus: int, cob_id: int, seq: int, version: int | None) -> Told:
    period = told_period(shadow, bus, cob_id, seq)
    by_now, end = told_overflow(shadow, bus, cob_id, seq), told_overflow(shadow, bus, cob_id)
    return Told(version, *(found[0] if found else None for found in (period, by_now, end)))


@dataclass(slots=True)
class SyncState:
    """A SYNC identifier from block to block."""

    count: int = 0
    last_ns: int | None = None
    last_seq: int = 0
    last_bits: int = 0
    last_counter: int = 0
    missing: int = 0
    bundled: int = 0
    periods: Periods = field(default_factory=Periods)
    told: Told = UNTOLD
    pace: SyncPace = field(default_factory=SyncPace)
    counter: SyncCounter = field(default_factory=SyncCounter)
    doubled: Doubled = field(default_factory=Doubled)
    holes: list[SyncHole] = field(default_factory=list)
    unsteady: Unsteady = field(default_factory=Unsteady)
    double: DoubleSync = field(default_factory=DoubleSync)
    filled: list[int] = field(default_factory=list)
    """`seq` of the SYNCs after which error frames may have kept the bus up to the next one."""
    over_time: Thinner = field(default_factory=lambda: Thinner("value", MAX_POINTS))
    steps: list[ClockStepRow] = field(default_factory=list)

    @property
    def period(self) -> Distribution:
        """Of all its periods."""
        return self.periods.spread
