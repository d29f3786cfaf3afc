"""What synchronous PDOs waited for, and whether bus or device made them late."""

from dataclasses import field

from syncline_analyzer.results.quantiles import Quantiles
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Ahead:
    """Frames of one identifier that went ahead of a PDO while it may have been ready.

    `node` is their sender, None for a master's frames and unknown ones; `us` is their time on the
    wire with intermissions, `seq` are the first 20 of them.
    """

    cob_id: int
    node: int | None
    service: str
    frames: int
    us: float
    seq: list[int]


@dataclass(frozen=True, slots=True)
class WaitRow:
    """One of the ten slowest answers of a synchronous PDO, or of the ten that waited the longest.

    `device_us_least` to `device_us_most` is what the device took from the end of the SYNC to the
    request to send, by arbitration; it waited `waiting_us` at most until its frame started, behind
    the frames `ahead`. Frames of its own node among them are the device's own queue.
    """

    bus: str
    cob_id: int
    node: int | None
    pdo: str | None
    seq: int
    t_ns: int
    sync_seq: int
    response_us: float
    device_us_least: float
    device_us_most: float
    waiting_us: float
    ahead: list[Ahead]


@dataclass(frozen=True, slots=True)
class DelayRow:
    """How long synchronous PDOs waited, at most, for the frames of an identifier, or of a sender.

    `cob_id` is None in the row that sums up all frames of a sender; `node` is None for a master
    whose node is not told. `delayed` answers waited for `frames` of its frames, `us` in all; the
    worst of them `worst_us`: the frame `worst_seq` of the PDO `worst_cob_id`.
    """

    bus: str
    cob_id: int | None
    node: int | None
    service: str
    frames: int
    delayed: int
    us: float
    worst_us: float
    worst_cob_id: int
    worst_seq: int


@dataclass(frozen=True, slots=True)
class LatenessRow:
    """Why a synchronous PDO was late or missed: because of the bus, or because of its device.

    Of `answers` that arbitration tells something of, `waited` found the bus taken, `free` found it
    idle. Late are those after the synchronous window (1007h): by the device where even on an idle
    bus it would have been late; by the bus where they are in time without the frames of others,
    as long as none is late by the device and it answered in time on an idle bus so often that it is
    no chance; both are at least so many.
    Missed by the device: the bus was free for it later than it was ever ready when it answered; by
    the bus: it was not free from the soonest that the device gets ready on to the next SYNC. What is
    neither stays open. `blockers` are the frames ahead of late answers; `late_seq` the first 20 of
    these.
    """

    bus: str
    cob_id: int
    node: int | None
    pdo: str | None
    answers: int
    waited: int
    free: int
    window_us: int | None
    late: int
    late_by_device: int
    late_by_bus: int
    missed: int
    missed_by_device: int
    missed_by_bus: int
    beside_sdo: int
    """Answers within a SYNC period in which there was SDO traffic with the node."""
    late_beside_sdo: int
    device_us_beside_sdo: Quantiles | None
    """`device_us_least` of these."""
    device_us_without_sdo: Quantiles | None
    """`device_us_least` of all others."""
    blockers: list[Ahead] = field(default_factory=list)
    late_seq: list[int] = field(default_factory=list)
    late_first_ns: int | None = None
    late_last_ns: int | None = None
    missed_seq: list[int] = field(default_factory=list)
    """`seq` of the first 20 SYNCs that went unanswered because of the device or the bus."""
    late_by_device_beside_sdo: int = 0
    """Those of `late_by_device` that are `late_beside_sdo`."""
