"""What the NMT fold tells: commands, states, boot-ups, and what else there is of each node."""

from dataclasses import field
from typing import Literal

from syncline_analyzer.folds.nmt.cadence import Doubles, Twins
from syncline_analyzer.folds.nmt.events import (
    Counts,
    OddCommand,
    OddMessage,
    OffPace,
    Repeated,
    Violation,
)
from syncline_analyzer.folds.nmt.guarding import Guarding
from syncline_analyzer.folds.nmt.pace import HeartbeatPeriods, Late
from syncline_analyzer.folds.nmt.pairs import Pairs
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.results import NmtCommandRow, NmtStateRow, Quantiles
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

NodeKey = tuple[int, int]
"""(bus number, node)."""


class BootUp(NamedTuple):
    """A boot-up of a node and the reset that explains it, if any.

    `repeated` marks the second frame of a pair that one start of the device sends; `blind` that
    nothing was heard of the node between a gap or a silence of the whole bus and this.
    """

    bus: str
    node: int
    seq: int
    t_ns: int
    byte: int
    command_seq: int | None
    command_ns: int | None
    repeated: bool
    blind: bool


@dataclass(slots=True)
class NodeNmt:
    """What one node's error control and states come to."""

    counts: Counts = field(default_factory=Counts)
    heartbeat_period_ns: int | None = None
    share: dict[str, float] = field(default_factory=dict)
    final_state: str = NmtState.UNKNOWN.value
    alive: bool = False
    period_us: Quantiles | None = None
    """Of the heartbeat, without what silences, gaps and resets explain."""
    confirmed_ms: Quantiles | None = None
    boot_ms: Quantiles | None = None
    guarding: Guarding = field(default_factory=Guarding)
    paces: HeartbeatPeriods = field(default_factory=HeartbeatPeriods)
    late: list[Late] = field(default_factory=list)
    """Heartbeats that came late while nothing explains it."""
    odd: list[OddMessage] = field(default_factory=list)
    doubles: Doubles = field(default_factory=Doubles)
    twins: Twins = field(default_factory=Twins)
    pairs: Pairs = field(default_factory=Pairs)
    pdo_doubles: dict[int, Doubles] = field(default_factory=dict)
    """By identifier, for a node that booted more than once: PDOs in two interleaved cadences."""
    toggles: list[Repeated] = field(default_factory=list)
    """Repeated toggle bits, the first of them, without those that a write has restarted."""
    violations: list[Violation] = field(default_factory=list)
    heard_ns: int | None = None
    """Time of its last frame."""
    told_ns: int | None = None
    """Time of its last heartbeat or guard answer."""
    off_pace: list[OffPace] = field(default_factory=list)
    """Stretches in which the heartbeat comes more slowly or faster than 1017h says."""
    pdos: Literal["no", "guess", "bound"] = "no"
    """Whether the node sends PDOs, and whether only their predefined identifiers say so."""


@dataclass(frozen=True, slots=True)
class NmtTable:
    """Commands, states, and per (bus number, node) what else there is to say."""

    commands: list[NmtCommandRow] = field(default_factory=list)
    states: list[NmtStateRow] = field(default_factory=list)
    boot_ups: list[BootUp] = field(default_factory=list)
    nodes: dict[NodeKey, NodeNmt] = field(default_factory=dict)
    first_ns: int = 0
    """Time of the first frame."""
    end_ns: int = 0
    """Time of the end."""
    canopen: frozenset[int] = frozenset()
    """Numbers of the buses on which something shows CANopen."""
    foreign: frozenset[int] = frozenset()
    """Numbers of the buses that use CANopen's identifiers for something else."""
    malformed: int = 0
    """Frames on 000h that are no NMT command: length, specifier or node number."""
    odd: list[OddCommand] = field(default_factory=list)
    """The first of them."""
    timelines: dict[NodeKey, Timeline] = field(default_factory=dict)
