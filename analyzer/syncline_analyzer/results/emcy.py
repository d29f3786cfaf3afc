"""EMCY messages, errors, their context and history."""

from dataclasses import field
from typing import Any, Literal

from syncline_schemas.records import dataclass


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
