"""Rows of the tables: what the folds return, and what JSON, pandas and the views show.

The field names are those of `--format json` and never change within a major version. Times named
`*_ns` are stamps `t` as analysis.md defines them; `bus` is the interface's name as recorded;
`evidence` holds `seq` numbers.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True, slots=True)
class Quantiles:
    """Minimum, median, 99th percentile and maximum; `std` where the interface asks for it."""

    min: float
    median: float
    p99: float
    max: float
    std: float | None = None


@dataclass(frozen=True, slots=True)
class GapRow:
    """A stretch in which the recorder was blind."""

    start_ns: int
    end_ns: int
    reason: str
    lost_frames: int | None
    bus: str | None = None


@dataclass(frozen=True, slots=True)
class CaptureRow:
    """The capture as a whole."""

    files: list[str]
    frames: int
    data_frames: int
    remote_frames: int
    error_frames: int
    extended_frames: int
    unparsed_lines: int
    start_utc_ns: int | None
    duration_ns: int
    buses: list[str]
    gaps: list[GapRow]
    first_ns: int = 0
    """Origin of capture time: first stamp of the whole capture, also where only a range was read."""
    time_base: str = "utc"
    resolution_ns: int = 1
    notes: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    """What could not be read of damaged files; empty when all are whole."""
    cut_ns: int | None = None
    """First stamp taken in where only a part of the capture was; capture time stays since `first_ns`."""

    @property
    def begin_ns(self) -> int:
        """First stamp that was taken in."""
        if self.cut_ns is not None:
            return self.cut_ns
        return self.first_ns if self.start_utc_ns is None else self.start_utc_ns

    @property
    def end_ns(self) -> int:
        """Last stamp that was taken in."""
        return self.begin_ns + self.duration_ns


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
class NodeRow:
    """A node that something on the bus proves or claims."""

    bus: str
    node: int
    name: str | None
    device: str | None
    boot_ups: int
    heartbeats: int
    heartbeat_period_ms: float | None
    guard_requests: int
    guard_answers: int
    toggle_errors: int
    emcy: int
    sdo_transfers: int
    sdo_aborts: int
    sdo_unanswered: int
    pdo_frames: int
    state_share: dict[str, float]
    final_state: str
    proof: list[str] = field(default_factory=list)
    """What lists the node: "error control", "emcy", "sdo answer", "pdo", "pdo (guess)"."""
    heartbeat_period_us: Quantiles | None = None
    """Without silences, gaps, resets and changes of 1017h."""
    guard_period_us: Quantiles | None = None
    """From one guard request of the master to the next."""
    guard_missed: int = 0
    """Guard requests without an answer, after the node's first answer."""
    confirmed_ms: Quantiles | None = None
    """From an NMT command, not a reset, to the first message that confirms it."""
    boot_ms: Quantiles | None = None
    """From a reset command to the boot-up."""


@dataclass(frozen=True, slots=True)
class NmtCommandRow:
    """An NMT command: a two-byte data frame on 000h; node 0 means all."""

    bus: str
    seq: int
    t_ns: int
    command: str
    node: int
    confirmed_ms: float | None


@dataclass(frozen=True, slots=True)
class NmtStateRow:
    """An interval of a node's NMT state, half-open."""

    bus: str
    node: int
    state: str
    start_ns: int
    end_ns: int
    cause: str
    certainty: Literal["observed", "commanded", "implied", "assumed"]
    evidence: int | None


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
class EmcyRow:
    """One EMCY message and the transition it makes."""

    bus: str
    node: int
    seq: int
    t_ns: int
    code: int | None
    meaning: str
    error_register: int | None
    registers: list[str]
    manufacturer_hex: str
    transition: Literal["raised", "further", "partly cleared", "all cleared", "reset", "malformed"]
    details: dict[str, Any] = field(default_factory=dict)
    """Manufacturer bytes decoded by device, for example {"alarms": 1, "warnings": 0}."""
    active: list[int] = field(default_factory=list)
    """Codes of the node's errors that are there after it, as far as its bits tell; at most 32."""


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """One error of a node from raise to clear."""

    bus: str
    node: int
    code: int
    meaning: str
    raised_ns: int
    cleared_ns: int | None
    status: Literal["cleared", "still active", "lost at reset"]
    count: int
    evidence: list[int] = field(default_factory=list)
    certain: bool = True
    """False where it may have ended before: a clear did not tell which of several errors it ends."""


@dataclass(frozen=True, slots=True)
class EmcyContextRow:
    """What was around one EMCY; for the first 1000 of a capture.

    `write_*` is the last SDO write to the node within the 10 s before, `write_ms` how long before
    the EMCY its answer came; `writes` lists up to five of them, the latest first, in words.
    """

    bus: str
    node: int
    seq: int
    t_ns: int
    code: int | None
    state: str
    """NMT state of the node at that moment."""
    certainty: str
    bus_state: str | None
    """State of the recorder's controller, None where nothing tells it."""
    write_index: int | None
    write_sub: int | None
    write_seq: int | None
    write_ms: float | None
    writes: list[str] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)
    """By measured object ("6004h:00"): its name and unit, the last value `before` and the first
    `after`, `low` and `high` within one second on either side, and the number of `samples`."""


@dataclass(frozen=True, slots=True)
class ErrorHistoryRow:
    """One SDO read of 1003h or 1001h, and what the bus told of it.

    `seen` of an entry of 1003h: "seen" (the EMCY with `emcy_seq`), "older" (from before the
    capture), "missed" (it came during the capture, its EMCY is not in it), "unknown" (older or
    missed) or "empty". The number of entries is a "count". A read of 1001h is a "register", or
    "cleared by read" where bits are gone only because the read before took them.
    """

    bus: str
    node: int
    seq: int
    t_ns: int
    index: int
    sub: int
    raw: int
    code: int | None
    info: int | None
    """The upper 16 bits of an entry: the maker's own."""
    meaning: str
    seen: Literal[
        "seen", "older", "missed", "unknown", "empty", "count", "register", "cleared by read"
    ]
    emcy_seq: int | None
    note: str = ""


@dataclass(frozen=True, slots=True)
class SdoRow:
    """One SDO transfer."""

    bus: str
    node: int
    seq: int
    start_ns: int
    end_ns: int
    index: int | None
    """None when the capture starts in the middle of a transfer."""
    sub: int | None
    direction: Literal["upload", "download"]
    kind: Literal["expedited", "segmented", "block"]
    size: int | None
    value: int | float | str | None
    """Decoded by the object's type where it is known; else the hexadecimal bytes as sent."""
    result: Literal["ok", "abort", "no answer", "interrupted"]
    abort_code: int | None
    answer_us: float | None
    name: str | None = None
    data: bytes = b""
    end_seq: int | None = None
    announced: int | None = None
    """Bytes that the protocol states; None where it does not (22h, 42h, size not indicated)."""
    crc_ok: bool | None = None
    """Whether the CRC of a block transfer fits its data; None where there is none to check."""
    abort_by: Literal["client", "server"] | None = None
    abort_text: str | None = None
    """The abort code in words."""


@dataclass(frozen=True, slots=True)
class ObjectRow:
    """Last known value of an object: seen on the bus, or an assumed parameter of an analysis.

    `seq` and `t_ns` are those of the transfer that told the value, None where it is assumed. It
    holds since `since_seq`, by `cause`: "sdo-read", "sdo-write", "side effect", "reset" (the saved
    value came back) or "factory reset"; "" where it always held.
    """

    bus: str
    node: int
    index: int
    sub: int
    name: str | None
    unit: str | None
    value: int | float | str
    source: str
    seq: int | None
    t_ns: int | None
    meaning: str = ""
    """The value in words, "" where the number says it all."""
    since_seq: int | None = None
    since_ns: int | None = None
    cause: str = ""
    saved: bool | None = None
    """Whether a written value outlives a reset, None where it was not written in the capture."""


@dataclass(frozen=True, slots=True)
class ObjectHistoryRow:
    """One value of an object and the stretch in which it held; at most 2000 per object.

    It holds from `start_seq` on and before `until_seq` (None: to the end). `source` is where the
    value comes from, "unknown" where a reset left nothing that is known; `seq` is the transfer that
    told it; `cause` is as in `ObjectRow`.
    """

    bus: str
    node: int
    index: int
    sub: int
    name: str | None
    unit: str | None
    value: int | float | str | None
    meaning: str
    source: str
    cause: str
    seq: int | None
    start_seq: int
    start_ns: int
    until_seq: int | None
    until_ns: int | None


@dataclass(frozen=True, slots=True)
class TraceRow:
    """Summary of one trace of a position-like object."""

    bus: str
    node: int
    object: int
    """index << 8 | sub"""
    name: str
    unit: str
    samples: int
    min: float | None
    max: float | None
    cuts: int
    flags: dict[str, int]
    shows: str = ""
    """What the value is by the settings at the end: axis, definition, range, reference."""
    assumed: list[str] = field(default_factory=list)
    """Settings of the scale that were only assumed: "cpr", "range", "res", "quad" ..."""
    unwrapped_min_deg: float | None = None
    """Least, greatest and mean angle with the way over the wrap joined; None without a scale."""
    unwrapped_max_deg: float | None = None
    unwrapped_mean_deg: float | None = None


@dataclass(frozen=True, slots=True)
class TraceEventRow:
    """A moment of a trace that a reader must know of; at most 1000 per trace and kind.

    `kind` is "jump" (faster than the device can turn), "out of range" (the first
    one of a stretch), "frozen" (the first of a stretch in which a sibling moves), "alarm" (bits of
    6503h or 6505h came up), "ambiguous" (the first sample whose value or direction cannot be told),
    "gray code" (at the end: counts in the wrong code) or "cut"; `text` says why. `before` and
    `after` are values in the trace's unit.
    """

    bus: str
    node: int
    object: int
    kind: Literal["jump", "out of range", "frozen", "alarm", "ambiguous", "gray code", "cut"]
    seq: int
    t_ns: int
    before: float | None
    after: float | None
    text: str


@dataclass(frozen=True, slots=True)
class BusLoadRow:
    """Load of one bus; percentages are None where the bit rate is not known."""

    bus: str
    bitrate: int | None
    mean_percent: float | None
    peak_percent: float | None
    frames_per_s: float


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


@dataclass(frozen=True, slots=True)
class Link:
    """One piece of a story: what followed from the finding that tells it, in order of time."""

    id: str
    bus: str | None
    node: int | None
    start_ns: int
    end_ns: int
    text: str
    evidence: list[int]


@dataclass(frozen=True, slots=True)
class Finding:
    """What a service engineer would write in a report: the root of a story and what followed."""

    id: str
    severity: Severity
    bus: str | None
    node: int | None
    start_ns: int
    end_ns: int
    text: str
    cause: str
    check_next: str
    evidence: list[int]
    chain: list[Link] = field(default_factory=list)
    """What followed from it, in order of time; these are no findings of their own."""
    assumed: list[str] = field(default_factory=list)
    """What it rests on that was only assumed, for example "100Ch = 0 (eds-default)"."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Samples of one trace, for plots and for `Session.traces()`.

    Columns, all (n,): t_ns int64; seq int64; raw int64; value float64 in `unit` (NaN where
    invalid); extra columns by name, for encoders `position` [counts], `turn`, `angle_deg`,
    `unwrapped_deg`, `speed_rpm` (float64, NaN where unknown); flags uint16 of `TraceFlag`; segment int32, one number
    per stretch between cuts. `assumed` names the scales that were only assumed.
    """

    bus: str
    node: int
    object: int
    name: str
    unit: str
    t_ns: NDArray[np.int64]
    seq: NDArray[np.int64]
    raw: NDArray[np.int64]
    value: NDArray[np.float64]
    flags: NDArray[np.uint16]
    segment: NDArray[np.int32]
    columns: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    assumed: list[str] = field(default_factory=list)


TRACE_FLAGS = ("wrap", "jump", "ambiguous", "frozen", "out_of_range", "scale_assumed")
"""Names of the bits of `Trace.flags`, bit 0 first."""


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
