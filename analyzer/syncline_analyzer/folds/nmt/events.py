"""What a node's error control, commands and PDOs are reduced to, and what is told from it."""

from collections.abc import Sequence
from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.nmt.pace import Even, Pace
from syncline_analyzer.folds.nmt.witness import Witnesses
from syncline_schemas.batch import Gap
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

IN_FLIGHT_NS = 10_000_000
"""What a node sends this soon after a command or change may have been on its way [ns]."""

KEPT_AFTER_MARK = 3
"""State messages kept after an NMT command or a gap, also when they change nothing."""

UNASKED = "nobody asked it for"
"""How the cause of a state begins that is not known as a guarded node is not asked any more, ..."""
UNSEEN = "no guard answer of it for"
"""... and the same where the log holds no requests."""

BeatKind = Literal["heartbeat", "guard answer", "boot-up", "empty"]
Certainty = Literal["observed", "commanded", "implied", "assumed"]


class Beat(NamedTuple):
    """A message of the node's error control that says something new.

    `state` is bits 6..0 of the byte, `previous_ns` the node's last sign of life before it (its own
    time when there was none), `after_ns` the message of its error control before it, None at the
    beginning and after a gap.
    """

    seq: int
    t_ns: int
    kind: BeatKind
    state: int
    previous_ns: int
    after_ns: int | None


class Silence(NamedTuple):
    """The longest stretch without any frame of the node between two of its error-control messages.

    `period_ns` is the median of the last periods, None when fewer than three were seen;
    `requests` counts guard requests that got no answer within it; `end_seq` is None where the
    capture or a gap ended it. `kind` is what the node's error control consisted of; `order` is the
    `seq` from which on the silence is known.
    """

    start_seq: int
    start_ns: int
    end_seq: int | None
    end_ns: int
    period_ns: int | None
    requests: int
    kind: BeatKind
    order: int


class Unasked(NamedTuple):
    """From `t_ns` on nothing tells the state of a guarded node: nobody asks, and it says nothing."""

    t_ns: int
    since_ns: int


class MissedMaster(NamedTuple):
    """An EMCY 8130h: neither requests nor a heartbeat of its master came to a node in time."""

    seq: int
    t_ns: int


class Pause(NamedTuple):
    """A longer stretch between two guard requests; `end_ns` is None at the end of the capture."""

    start_seq: int
    start_ns: int
    end_ns: int | None


class Unanswered(NamedTuple):
    """Guard requests in a row without an answer; the next message came at `end_ns`."""

    seq: int
    start_ns: int
    end_ns: int
    number: int


class Repeated(NamedTuple):
    """A guard answer, at `seq`, with the toggle bit of the one before it."""

    before_seq: int
    seq: int
    t_ns: int


class OddMessage(NamedTuple):
    """A data frame on a node's error-control identifier that is none, and what is wrong with it."""

    seq: int
    t_ns: int
    what: str


@dataclass(slots=True)
class Counts:
    """Counts over the whole capture."""

    boot_ups: int = 0
    heartbeats: int = 0
    guard_requests: int = 0
    guard_answers: int = 0
    toggle_errors: int = 0
    empty: int = 0
    odd: int = 0

    @property
    def unseen(self) -> bool:
        """Whether guard answers came, but none of the requests."""
        return self.guard_answers > 0 and not self.guard_requests


class Command(NamedTuple):
    """An NMT command, or a write that the node takes as one (`by` says which); node 0 means all."""

    seq: int
    t_ns: int
    specifier: int
    node: int
    by: str = ""


class OddCommand(NamedTuple):
    """A frame on 000h that is no NMT command, and what is wrong with it."""

    bus: int
    seq: int
    t_ns: int
    what: str


@dataclass(slots=True)
class PdoSpan:
    """PDOs of one identifier between two events that may change the node's state.

    `since` is (seq, t_ns) of the first event; `late_*` is the first PDO later than the in-flight
    time after it; `asked` when remote frames asked for the PDO.
    """

    can_id: int
    since: tuple[int, int] | None
    asked: bool = False
    guess: bool = False
    """Only the predefined identifier says whose PDO it is."""
    count: int = 0
    first_seq: int = 0
    first_ns: int = 0
    last_ns: int = 0
    late_seq: int | None = None
    late_ns: int = 0
    late_count: int = 0

    def extend(self, seq: NDArray[np.intp], t_ns: NDArray[np.int64]) -> None:
        """Take in further frames."""
        if not self.count:
            self.first_seq, self.first_ns = int(seq[0]), int(t_ns[0])
        self.count += len(seq)
        self.last_ns = int(t_ns[-1])
        since_ns = self.since[1] if self.since else 0
        if self.late_seq is not None and int(t_ns.min()) > since_ns + IN_FLIGHT_NS:
            self.late_count += len(seq)
            return
        late = np.flatnonzero(t_ns > since_ns + IN_FLIGHT_NS)
        if len(late):
            self.late_count += len(late)
            if self.late_seq is None:
                self.late_seq, self.late_ns = int(seq[late[0]]), int(t_ns[late[0]])


@dataclass(frozen=True, slots=True)
class NodeHistory:
    """Everything that was kept of a node, all in order of `seq`."""

    bus: int
    node: int
    beats: list[Beat]
    silences: list[Silence]
    commands: list[Command]
    spans: list[PdoSpan]
    gaps: list[tuple[int, Gap]]
    """With the `seq` of the first frame after each."""
    first_ns: int
    end_ns: int
    period_ns: int | None
    period_since_ns: int = 0
    """Before that the period was another one, as the last ones of each silence tell it."""
    guard_period_ns: int | None = None
    unseen: bool = False
    """Whether it answers guard requests of which the log holds none."""
    paces: Sequence[Pace] = ()
    stretches: Sequence[Pace] = ()
    even: Sequence[Even] = ()
    """Heartbeats in a row of about one period."""
    alone: bool = False
    """Whether no other node is known on its bus."""
    others_anew: Sequence[int] = ()
    """Times, ascending, at which other nodes of its bus booted or told PRE-OPERATIONAL."""
    others_beat: Sequence[tuple[int, int]] = ()
    """When each other node of its bus that sends heartbeats told a state first and last."""
    witnesses: Witnesses = field(default_factory=Witnesses)
    """The heartbeats of its bus."""
    communication_errors: Sequence[int] = ()
    """Times of its EMCYs that tell of a communication error (75xxh, 81xxh)."""
    missed_masters: Sequence[MissedMaster] = ()
    no_errors: Sequence[tuple[int, int]] = ()
    """(seq, t_ns) of its EMCYs that are empty or tell no error."""
    told_ns: int | None = None
    """When it told a state last."""
    heard_ns: int | None = None
    """When any frame of it came last."""


@dataclass(slots=True)
class Interval:
    """A state from `start_ns` until `end_ns`."""

    state: NmtState
    start_ns: int
    end_ns: int
    cause: str
    certainty: Certainty
    evidence: int | None


class Violation(NamedTuple):
    """PDOs while the node was known not to be OPERATIONAL."""

    can_id: int
    state: str
    seq: int
    start_ns: int
    end_ns: int
    number: int
    guess: bool
    certainty: str


class OffPace(NamedTuple):
    """Heartbeats that come more slowly or faster than 1017h says."""

    producer_ms: int
    median_ns: int
    source: str
    first_seq: int
    last_seq: int
    start_ns: int
    end_ns: int


class Lost(NamedTuple):
    """A stretch in which the node was silent for too long, LOST or while it restarted."""

    start_ns: int
    end_ns: int
    last_seq: int
    last_ns: int
    end_seq: int | None
    timeout_ns: int
    reason: str
    state_before: str
    whole_bus: bool


class KeptWaiting(NamedTuple):
    """A heartbeat that waited for other frames while the bus was full.

    The one before it came at `before_ns`; the bus was not free for it from `free_ns` on, until it
    came at `end_ns`, or until its bus was not heard any more (not `over`).
    `busy` is the part of that time (0..1) that frames took, most of it those of `ahead`.
    """

    before_ns: int
    end_ns: int
    free_ns: int
    busy: float
    ahead: tuple[int, ...]
    over: bool

    @property
    def waited_ns(self) -> int:
        """How long it waited at most [ns]."""
        return self.end_ns - self.free_ns


class Ignored(NamedTuple):
    """A command that the node demonstrably did not follow.

    `can_id` is the PDO that shows it, for a node whose heartbeats tell no state; `starting`: it had
    been reset, and had not booted yet.
    """

    command: Command
    seq: int
    t_ns: int
    state: str
    can_id: int | None = None
    starting: bool = False


class BootUpEvent(NamedTuple):
    """A boot-up: (seq, t_ns, byte, seq and time of the reset command before it, repeated, blind).

    `blind`: nothing was heard of the node between a gap or a silence of the whole bus and this.
    """

    seq: int
    t_ns: int
    byte: int
    command_seq: int | None
    command_ns: int | None
    repeated: bool
    blind: bool
