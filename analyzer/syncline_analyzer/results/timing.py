"""SYNC and PDOs."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results.quantiles import Quantiles


@dataclass(frozen=True, slots=True)
class SyncRow:
    """A SYNC producer's identifier and its periods."""

    bus: str
    cob_id: int
    count: int
    period_us: Quantiles | None
    missing: int
    counter_jumps: int
    backlog: int = 0
    """Periods that count nowhere: the recorder had kept these frames and delivered them at once."""
    last_ns: int | None = None
    """Time of the last one, None where a gap came after it or there are no times."""
    last_seq: int | None = None


@dataclass(frozen=True, slots=True)
class PdoRow:
    """A PDO and its timing; response and device time only for synchronous ones."""

    bus: str
    cob_id: int
    node: int | None
    pdo: str | None
    """"TPDO1", "RPDO2" ...; with " (guess)" where only the predefined identifier says so."""
    frames: int
    transmission_type: int | None
    type_source: str
    """"sdo-read", "sdo-write", "bus-description", "eds-default", "inferred: ..." or "unknown"."""
    period_us: Quantiles | None
    response_us: Quantiles | None
    device_us_low: Quantiles | None
    device_us_high: Quantiles | None
    missed: int
    extra: int
    late: int
    missed_seq: list[int] = field(default_factory=list)
    """`seq` of the first SYNCs (at most 100) that got no answer."""
    too_soon: int = 0
    """Frames less than half the inhibit time (180xh:3) after the one before."""
    extra_alone: int = 0
    """Those of `extra` beside which no SYNC went unanswered: none of them is a late answer."""
    extra_seq: list[int] = field(default_factory=list)
    """`seq` of the first `extra_alone` frames (at most 20)."""
    extra_first_ns: int | None = None
    extra_last_ns: int | None = None
    too_soon_seq: list[int] = field(default_factory=list)
    too_soon_first_ns: int | None = None
    too_soon_last_ns: int | None = None
    inhibit_us: int | None = None
    """180xh:3 as seen on the bus or described."""
    event_timer_us: int | None = None
    """180xh:5 as seen on the bus or described, of a PDO of type FEh or FFh."""


@dataclass(frozen=True, slots=True)
class HoleRow:
    """A stretch in which SYNCs or PDOs were due and did not come; at most 1000 per identifier.

    `evidence` holds the SYNCs around missing SYNCs, the SYNCs that a PDO did not answer (the first
    100), or the last frame before the silence of a cyclic PDO.
    """

    bus: str
    cob_id: int
    service: Literal["sync", "pdo"]
    start_ns: int
    end_ns: int
    missing: int
    evidence: list[int]


@dataclass(frozen=True, slots=True)
class SyncJitterRow:
    """A stretch in which SYNC periods lie off their mean by a tenth and more, again and again.

    `off` of `periods` do, the worst by `worst_us`; `evidence` holds the first 100 of them.
    """

    bus: str
    cob_id: int
    start_ns: int
    end_ns: int
    off: int
    periods: int
    period_us: float
    worst_us: float
    evidence: list[int]


@dataclass(frozen=True, slots=True)
class PdoPauseRow:
    """A stretch in which a PDO with a rhythm of its own stayed away, its node being OPERATIONAL.

    `due` frames were due by `basis`; `resumed` tells whether it came again. `evidence` holds the
    last frame before it, and the first one after.
    """

    bus: str
    cob_id: int
    node: int
    pdo: str
    start_ns: int
    end_ns: int
    due: int
    resumed: bool
    basis: str
    evidence: list[int]


@dataclass(frozen=True, slots=True)
class SyncDoubleRow:
    """A stretch in which two rhythms share a SYNC identifier.

    `period_us` is that of the one which is also seen alone; `pairs` SYNCs come beside it, the first
    of them `offset_us` off; `evidence` holds the first SYNCs of the stretch.
    """

    bus: str
    cob_id: int
    start_ns: int
    end_ns: int
    period_us: float
    offset_us: float
    pairs: int
    evidence: list[int]


@dataclass(frozen=True, slots=True, eq=False)
class Responses:
    """Answers of one synchronous PDO to its SYNC.

    Columns, all (n,): seq int64, t_ns int64, response_us, device_low_us, device_high_us float64.
    `histogram` holds the counts of `edges_us` (len + 1 edges) over all responses, also when the
    columns were thinned.
    """

    bus: str
    cob_id: int
    node: int | None
    pdo: str | None
    seq: NDArray[np.int64]
    t_ns: NDArray[np.int64]
    response_us: NDArray[np.float64]
    device_low_us: NDArray[np.float64]
    device_high_us: NDArray[np.float64]
    histogram: NDArray[np.int64]
    edges_us: NDArray[np.float64]
