"""The bus itself: load, error frames, clock, LSS, TIME."""

from dataclasses import field
from typing import Literal

from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class DoubledRow:
    """Frames that the recorder wrote down twice: the copies count nowhere but in the capture.

    `scope` is "all" (every frame of the bus), "own" (NMT, SYNC, TIME, SDO requests and remote
    frames, which the recording computer sent itself) or "some"; `cob_ids` are those concerned.
    """

    bus: str
    scope: Literal["all", "own", "some"]
    cob_ids: list[int]
    copies: int
    start_ns: int
    end_ns: int
    delay_us: float
    """Median time from a frame to its copy."""
    evidence: list[int]


@dataclass(frozen=True, slots=True)
class BusLoadRow:
    """Load of one bus; percentages are None where the bit rate is not known, or cannot be right.

    Moments `*_ns` are where a window, stretch or burst begins. What the stamps are too coarse for,
    or too irregular (bundles of an adapter), is None.
    """

    bus: str
    bitrate: int | None
    mean_percent: float | None
    peak_percent: float | None
    """Fullest whole second."""
    frames_per_s: float | None
    """None where no time passed."""
    bitrate_source: Literal["bus-description", "recorded", "command-line", "estimated"] | None = (
        None
    )
    bitrate_confidence: Literal["told", "high", "low"] | None = None
    """ "told" by somebody, "high" for an estimate that is used; "low" for a guess that is not."""
    bitrate_estimate: int | None = None
    """What the spacing of the frames says, whether it is used or not."""
    data_bitrate: int | None = None
    peak_ns: int | None = None
    peak_100ms_percent: float | None = None
    peak_100ms_ns: int | None = None
    burst_percent: float | None = None
    """Fullest 10 ms, wherever they begin."""
    burst_ns: int | None = None
    longest_busy_us: float | None = None
    """Longest stretch of frames back to back, from the start of the first to the end of the last."""
    longest_busy_frames: int | None = None
    longest_busy_ns: int | None = None
    silent_ns: int = 0
    """Time in which nothing was heard though heartbeats were due: `mean_percent` counts it as idle."""
    heard_percent: float | None = None
    """Mean without that time."""


@dataclass(frozen=True, slots=True)
class BusShareRow:
    """What one identifier takes of the traffic of a bus, the largest first.

    `node` is the node that sends it, None for what a master sends and for what is nobody's;
    `service` says for which node ("SDO request to node 10"). `cob_id` is None for the 29-bit
    identifiers that are too many to be told apart.
    """

    bus: str
    cob_id: int | None
    extended: bool
    remote: bool
    node: int | None
    service: str
    frames: int
    share_percent: float
    """Share of the time in which the bus was busy."""
    load_percent: float | None
    """Share of all the time that was listened to."""


@dataclass(frozen=True, slots=True)
class NodeShareRow:
    """The same summed over what one node sends; `node` None: masters, and frames of nobody known."""

    bus: str
    node: int | None
    frames: int
    share_percent: float
    load_percent: float | None


@dataclass(frozen=True, slots=True)
class BusStateRow:
    """An interval of the state of the recorder's own controller on a bus, half-open.

    `state` is "active", "warning", "passive", "bus-off", "restarted" (started again, nothing heard
    yet) or "unknown" (before the first error frame that tells one, and after a capture gap). A bus
    of which no error frame tells a state has no rows. `tx_errors`, `rx_errors` are the error
    counters of the frame that proves it.
    """

    bus: str
    state: str
    start_ns: int
    end_ns: int
    cause: str
    evidence: int | None
    tx_errors: int | None = None
    rx_errors: int | None = None


@dataclass(frozen=True, slots=True)
class BusErrorRow:
    """Error frames of one kind on one bus; `evidence` holds the first 20."""

    bus: str
    kind: str
    count: int
    first_ns: int
    last_ns: int
    evidence: list[int]


@dataclass(frozen=True, slots=True)
class ClockStepRow:
    """The recorder's clock was set forward by `step_ns`, seen by `witnesses` identifiers.

    `evidence` holds the first frame after it.
    """

    bus: str
    start_ns: int
    end_ns: int
    step_ns: int
    witnesses: int
    evidence: list[int]


@dataclass(frozen=True, slots=True)
class BusSilenceRow:
    """A stretch in which nobody at all was heard although heartbeats were due, half-open.

    `evidence` holds the frames before and after it.
    """

    bus: str
    start_ns: int
    end_ns: int
    evidence: list[int]


@dataclass(frozen=True, slots=True)
class OverloadRow:
    """Seconds in a row in which a bus was nearly full; `percent` is the mean load."""

    bus: str
    start_ns: int
    end_ns: int
    percent: float


@dataclass(frozen=True, slots=True)
class LssRow:
    """One LSS frame (CiA 305); at most 10,000. `sender` is "master" or "slave"."""

    bus: str
    seq: int
    t_ns: int
    sender: Literal["master", "slave"]
    command: str
    text: str
    values: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TimeStampRow:
    """A TIME message: the first one, then one a minute, and each one that jumps.

    `utc_ns` is what it says, taken as UTC; None where it is malformed. `offset_ns` is that minus
    the recorder's clock, None in captures without dates.
    """

    bus: str
    cob_id: int
    seq: int
    t_ns: int
    utc_ns: int | None
    offset_ns: int | None
    text: str
