"""What really happened on a simulated bus: the truth that analyses are compared with.

All times are ends of frames or moments of the bus on its true clock, ns since the UNIX epoch,
without the recorder's stamp jitter and clock steps. Frames that the recorder missed are in it.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple


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
    """An EMCY frame; alarms and warnings only for devices that send them."""

    t_ns: int
    node: int
    code: int
    register: int
    alarms: int
    warnings: int


@dataclass(frozen=True, slots=True)
class SdoTruth:
    """A transfer of the master, from the end of its request to the end of the last answer."""

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


@dataclass(slots=True)
class Truth:
    """Everything a run knows about itself; complete when the run has ended."""

    findings: list[ExpectedFinding] = field(default_factory=list)
    states: list[StateTruth] = field(default_factory=list)
    commands: list[CommandTruth] = field(default_factory=list)
    boot_ups: list[BootUpTruth] = field(default_factory=list)
    emcy: list[EmcyTruth] = field(default_factory=list)
    sdo: list[SdoTruth] = field(default_factory=list)
    pdos: list[PdoTruth] = field(default_factory=list)
    missed: list[MissedTruth] = field(default_factory=list)
    sync_ns: list[int] = field(default_factory=list)
    recording: bool = True
    """Whether the recorder hears the bus; what is counted below is what it heard."""
    counts: Counter[tuple[str, int]] = field(default_factory=Counter)
    """`heartbeats`, `empty_heartbeats` among them, `guard_requests`, `guard_answers` and `pdos` by node; `syncs` under node 0."""
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

    def required(self) -> list[ExpectedFinding]:
        """The findings without which an analysis is wrong."""
        return [finding for finding in self.findings if finding.required]
