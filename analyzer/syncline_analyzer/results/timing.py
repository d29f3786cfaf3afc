"""SYNC and PDOs."""

from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results.quantiles import Jitter, Quantiles
from syncline_schemas.records import dataclass


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
    jitter_us: Jitter | None = None
    """Of the single periods: those in which SYNCs are missing, or of a slower SYNC, are none."""
    mean_us: float | None = None
    """Mean of the single periods (a period in which SYNCs are missing is none)."""
    expected_us: int | None = None
    """1006h of the producer, or of the nodes that take this SYNC where all say the same."""
    expected_source: str | None = None
    """"1006h of node 5 (sdo-read)", with " that takes it" where that node is not the producer."""
    deviation_us: float | None = None
    """Median period less `expected_us`; None where it is smaller than a step of the stamps."""
    drift_ppm: float | None = None
    """How much longer than `expected_us` the mean period is by the recorder's clock [1e-6].

    None where more than 1 % is missing of it (it keeps another period), or the stamps cannot tell.
    """
    drift_resolution_ppm: float | None = None
    """What the step of the stamps hides of the drift, over the time that was measured."""
    doubled: int = 0
    """SYNCs that came between two which are one period apart, those of a second producer too."""
    doubled_seq: list[int] = field(default_factory=list)
    """`seq` of the first 20 of them that are not a second producer's."""
    producers: int = 1
    """2 where two rhythms shared the identifier."""
    producer_nodes: list[int] = field(default_factory=list)
    """Nodes that are set to send it (1005h bit 30), as far as the bus or the user told."""
    counter_max: int | None = None
    """Highest SYNC counter that was seen; None for SYNCs without one."""
    counter_wraps: int = 0
    """How often the counter began again after the number where it does so most often."""
    counter_overflow: int | None = None
    """1019h, as far as any node of the bus told it."""
    counter_source: str | None = None
    resolution_us: float = 0.0
    """Step of the stamps."""
    quantile_error: float = 0.0
    """Largest relative error of median and 99th percentile; 0 while they are exact."""


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
    """180xh:3 as seen on the bus or described; the last one that frames came too soon for."""
    event_timer_us: int | None = None
    """180xh:5 as seen on the bus or described, of a PDO of type FEh or FFh."""
    jitter_us: Jitter | None = None
    """Of the response of a synchronous PDO."""
    period_jitter_us: Jitter | None = None
    """Of the single periods."""
    every: int | None = None
    """A synchronous PDO answers every n-th SYNC."""
    phase: int | None = None
    """Which ones, for n of 2 and more: their number leaves this remainder when divided by n."""
    phase_basis: str | None = None
    """What numbers them: "SYNC counter" (1019h), or "first SYNC" (the first of the capture is 0)."""
    phase_share: float | None = None
    """Share of the answers that have this phase."""
    phase_changes: int = 0
    """How often it moved: a step from answer to answer that is no multiple of n."""
    answered: int = 0
    """SYNCs that it answered."""
    repeat_counter: int | None = None
    """280xh of a device that has it: so many frames follow a change of the value; 0 means no end."""
    repeat_source: str | None = None
    repeats: int = 0
    """Frames with the data of the one before."""
    longest_repeat: int = 0
    """Most frames in a row with the same data."""
    asked: int = 0
    """Remote frames that asked for it."""
    asked_answered: int = 0
    """Those after which it came before the next request."""
    unanswered: int = 0
    """Requests without an answer while its node was OPERATIONAL."""
    unanswered_seq: list[int] = field(default_factory=list)
    """`seq` of the first 20 of them."""
    unanswered_first_ns: int | None = None
    unanswered_last_ns: int | None = None
    answer_us: Quantiles | None = None
    """Time from the request to the PDO."""
    timer_source: str | None = None
    timer_deviation_us: float | None = None
    """Median period less `event_timer_us`; None where it is smaller than a step of the stamps."""
    inhibit_source: str | None = None
    deadline_us: int | None = None
    """140xh:5 of an RPDO: the node expects it within this time (CiA 301 7.5.2.35)."""
    overdue: int = 0
    """Times that an RPDO took longer than that while its node was OPERATIONAL."""
    overdue_seq: list[int] = field(default_factory=list)
    """`seq` of the frame before each of the first 20."""
    overdue_first_ns: int | None = None
    overdue_last_ns: int | None = None
    resolution_us: float = 0.0
    """Step of the stamps."""
    quantile_error: float = 0.0
    """Largest relative error of median and 99th percentile; 0 while they are exact."""
    device_us_least: Quantiles | None = None
    """Least time that the device took by arbitration: at least `device_us_low`, mostly more.

    It was not ready while the bus was idle, nor when another node started a frame of lower priority.
    """
    device_us_free: Quantiles | None = None
    """The same of the answers that found the bus idle: there it is exact within a bit."""
    waiting_us: Quantiles | None = None
    """Longest that an answer can have waited for frames ahead of it; 0 where the bus was idle."""


@dataclass(frozen=True, slots=True)
class ErrorControlRow:
    """The rhythm of a node's heartbeat, or of the requests with which a master guards it."""

    bus: str
    node: int
    kind: Literal["heartbeat", "guarding"]
    count: int
    """Heartbeats, or guard requests."""
    period_us: Quantiles | None
    """From one to the next; never over a boot-up or a capture gap."""
    jitter_us: Jitter | None
    expected_us: int | None
    """1017h or 100Ch, as it held last."""
    expected_source: str | None
    deviation_us: float | None
    """Median period less `expected_us`; None where it is smaller than a step of the stamps."""
    missing: int
    """Heartbeats that were due and did not come, or requests that were not answered."""
    missing_seq: list[int] = field(default_factory=list)
    """`seq` of the frame before each of the first 20."""
    answer_us: Quantiles | None = None
    """From a guard request to its answer."""
    worst_us: float | None = None
    """The longest period ..."""
    worst_seq: int | None = None
    """... and the frame that ended it."""
    resolution_us: float = 0.0
    """Step of the stamps."""
    quantile_error: float = 0.0
    """Largest relative error of median and 99th percentile; 0 while they are exact."""


@dataclass(frozen=True, slots=True)
class WorstRow:
    """One of the ten longest or shortest of a quantity, exact, with the frame that ended it.

    `quantity` is "sync period", "period" (of a PDO), "response" (of a PDO to its SYNC), "answer"
    (of a PDO to a remote frame), "heartbeat period", "guard period" or "guard answer". Periods come
    with both ends, times of an answer with the longest alone; each from the worst on.
    """

    bus: str
    cob_id: int
    node: int | None
    quantity: str
    extreme: Literal["longest", "shortest"]
    value_us: float
    seq: int
    t_ns: int


@dataclass(frozen=True, slots=True)
class HoleRow:
    """A stretch in which SYNCs or PDOs were due and did not come; at most 1000 per identifier.

    After `held_back` of the SYNCs that a PDO did not answer, error frames may have kept the bus up to
    the next one.
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
    held_back: int = 0


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
class PdoLengthRow:
    """A length that frames of a PDO identifier have, and the first frame that has it."""

    bus: str
    cob_id: int
    length: int
    """Bytes."""
    first_seq: int


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

    Columns, all (n,): seq int64, t_ns int64, response_us, device_low_us, device_high_us,
    device_least_us, waiting_us float64; the last two are NaN where arbitration tells nothing.
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
    device_least_us: NDArray[np.float64]
    waiting_us: NDArray[np.float64]
