"""Nodes, their NMT states and the commands."""

from dataclasses import field
from typing import Literal

from syncline_analyzer.results.quantiles import Quantiles
from syncline_schemas.records import dataclass


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
    device_source: Literal["--device", "bus description", "objects"] | None = None
    """Who says what device it is; None where nobody does."""
    device_reason: str = ""
    """Why it is that device, or what is known of one that is not: objects that were seen on the bus
    and what they say, or the pattern of its PDOs."""
    device_guess: list[str] = field(default_factory=list)
    """Devices whose factory settings its PDOs look like, where nothing says what it is."""


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
