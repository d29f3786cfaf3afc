"""What really happened on a simulated bus: the truth that analyses are compared with.

All times are ends of frames or moments of the bus on its true clock, ns since the UNIX epoch,
without the recorder's stamp jitter and clock steps. Frames that the recorder missed are in it.
"""

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import NamedTuple

_RESETS = (0x81, 0x82)
_FORGOTTEN_NS = 60_000_000_000
"""After this nobody takes an answer for one to this request."""


class ExpectedFinding(NamedTuple):
    """A finding that the analyzer must report, or may where `required` is False.

    What is behind it happens at `at_ns`; the finding must overlap [start_ns, end_ns); node is None
    for what concerns the bus. An analyzer may tell the same event under one of `or_as`.
    """

    id: str
    node: int | None
    at_ns: int
    start_ns: int
    end_ns: int
    required: bool
    what: str
    or_as: tuple[str, ...] = ()


class StateTruth(NamedTuple):
    """An interval of a node's NMT state; OFF while it has no power."""

    node: int
    state: str
    start_ns: int
    end_ns: int


class CommandTruth(NamedTuple):
    """An NMT command at the end of its frame."""

    t_ns: int
    specifier: int
    node: int


class BootUpTruth(NamedTuple):
    """A boot-up frame; `byte` is 7Fh where the device has that quirk."""

    t_ns: int
    node: int
    byte: int
    commanded: bool


class EmcyTruth(NamedTuple):
    """An EMCY frame; alarms and warnings only for devices that send them.

    `active` are the codes of the errors that were there when it was sent, its own among them; `dlc`
    is less than 8 for malformed ones, whose `code` is made of the bytes that are there.
    """

    t_ns: int
    node: int
    code: int
    register: int
    alarms: int
    warnings: int
    active: tuple[int, ...] = ()
    dlc: int = 8


@dataclass(frozen=True, slots=True)
class ErrorTruth:
    """An error of a node from its appearance to its end.

    `raised_ns` and `cleared_ns` are the EMCYs that told of it, None where none did (the node was
    mute, or within its inhibit time). `status` is `cleared` where an EMCY told of the end, else
    `lost at reset` or `still active`; `count` are the EMCYs with its code.
    """

    node: int
    code: int
    occurred_ns: int
    raised_ns: int | None
    cleared_ns: int | None
    status: str
    count: int


@dataclass(frozen=True, slots=True)
class SdoTruth:
    """A transfer of a client, from the end of its request to the end of its last frame.

    `result` is what the bus tells: `ok`, `abort`, `no answer` where the initiate request got none,
    `interrupted` where a transfer of several steps stopped or the node was reset. A slow answer that
    the client no longer waits for is `ok`, if nothing else was asked meanwhile. Without an answer
    `end_ns` is when the client gave up, and `last_ns` the last frame.

    Attributes:
        aborted_by: `client` or `server`.
        answer_ns: the server's first answer.
        certain: False where the bus alone does not tell the result from another one: an unanswered
            request before a reset of the node.
    """

    node: int
    start_ns: int
    end_ns: int
    index: int
    sub: int
    direction: str
    kind: str
    data: bytes
    result: str
    abort_code: int | None
    aborted_by: str | None = None
    answer_ns: int | None = None
    last_ns: int = 0
    request_id: int = 0
    certain: bool = True


class PdoTruth(NamedTuple):
    """A TPDO: when it was due, when the device had it ready, when it had left the bus.

    `values` is (position in counts,) of an encoder or the two tilt angles in millidegrees, or the
    numbers that the PDO carries.
    """

    node: int
    cob_id: int
    sync_ns: int | None
    queued_ns: int
    end_ns: int
    values: tuple[int, ...]


class MissedTruth(NamedTuple):
    """A SYNC that a due TPDO did not answer; `sync_index` counts the SYNCs on the bus from 0."""

    node: int
    cob_id: int
    sync_index: int
    sync_ns: int


class LssTruth(NamedTuple):
    """An LSS frame: a request on 7E5h, else an answer on 7E4h."""

    t_ns: int
    request: bool
    data: bytes


class TimeTruth(NamedTuple):
    """A TIME message: the end of its frame, and the UTC that it tells."""

    t_ns: int
    told_ns: int


@dataclass(slots=True)
class Truth:
    """Everything a run knows about itself; complete when the run has ended."""

    findings: list[ExpectedFinding] = field(default_factory=list)
    states: list[StateTruth] = field(default_factory=list)
    commands: list[CommandTruth] = field(default_factory=list)
    boot_ups: list[BootUpTruth] = field(default_factory=list)
    emcy: list[EmcyTruth] = field(default_factory=list)
    errors: list[ErrorTruth] = field(default_factory=list)
    sdo: list[SdoTruth] = field(default_factory=list)
    pdos: list[PdoTruth] = field(default_factory=list)
    missed: list[MissedTruth] = field(default_factory=list)
    sync_ns: list[int] = field(default_factory=list)
    lss: list[LssTruth] = field(default_factory=list)
    time: list[TimeTruth] = field(default_factory=list)
    deaf: list[tuple[int, int]] = field(default_factory=list)
    """Stretches [start, end) in which the recorder heard nothing, told or not."""
    recording: bool = True
    """Whether the recorder hears the bus; what is counted below is what it heard."""
    counts: Counter[tuple[str, int]] = field(default_factory=Counter)
    """`heartbeats`, `empty_heartbeats` and `unknown_states` among them, `guard_requests`,
    `guard_answers`, `toggle_errors`, `unanswered_guards` and `pdos` by node; `syncs`, `lss` and
    `time` under node 0."""
    frames: int = 0
    """Frames that the recorder took, error frames among them."""
    remote_frames: int = 0
    error_frames: int = 0
    lost_frames: int = 0
    """Frames that passed while the recorder was blind."""
    bus_load: float = 0.0
    """Share of the time during which the bus was occupied, 0..1."""

    def count(self, what: str, node: int) -> None:
        """Count a frame, if the recorder hears it."""
        self.counts[what, node] += self.recording

    def settle(self) -> None:
        """Mark the unanswered requests that a reset may have cut off: call it when the run ends."""
        resets: dict[int, list[int]] = {}
        for boot_up in self.boot_ups:
            resets.setdefault(boot_up.node, []).append(boot_up.t_ns)
        for command in self.commands:
            if command.specifier in _RESETS:
                resets.setdefault(command.node, []).append(command.t_ns)
        for row, transfer in enumerate(self.sdo):
            if transfer.result in ("no answer", "interrupted") and transfer.answer_ns is None:
                later = (
                    each.start_ns
                    for each in self.sdo
                    if each.node == transfer.node and each.start_ns > transfer.start_ns
                )
                next_ns = min(later, default=transfer.start_ns + _FORGOTTEN_NS)
                times = resets.get(transfer.node, []) + resets.get(0, [])
                if any(transfer.start_ns < t_ns < next_ns for t_ns in times):
                    self.sdo[row] = replace(transfer, certain=False)

    def required(self) -> list[ExpectedFinding]:
        """The findings without which an analysis is wrong."""
        return [finding for finding in self.findings if finding.required]
