"""SDO transfers that the master makes beside those after a boot-up."""

from dataclasses import dataclass, replace
from typing import Literal

from syncline_samples import abort
from syncline_samples.machine import Machine
from syncline_samples.master import IDENTITY, RESET_NODE, START, Master
from syncline_samples.sdo_client import OnTimeout, SdoJob, read, write

BAD_VALUE = write(0x1029, 1, 5)
"""1029h:1 takes 0, 1 and 2."""
DEVICE_TYPE = read(0x1000)
NAME = read(0x1008)
"""Segmented on the devices whose name has more than four characters."""
LOG = read(0x2F00, block=True)
"""A kilobyte of the I/O module."""


@dataclass(frozen=True, slots=True)
class Preset:
    """The master presets the position by SDO: the jump is no finding."""

    node: int
    at_s: float
    value: int

    def arm(self, machine: Machine) -> None:
        """Write 6003h."""
        client = machine.master.sdo(self.node)
        machine.at(self.at_s, client.run, write(0x6003, 0, self.value))


@dataclass(frozen=True, slots=True)
class SdoAccess:
    """The master makes transfers that go well: no finding.

    Attributes:
        by_tool: a second client on the same channel makes them, while the master may be at its own.
            It must not ask for the object that the master is at.
    """

    node: int
    at_s: float
    jobs: tuple[SdoJob, ...]
    by_tool: bool = False

    def arm(self, machine: Machine) -> None:
        """Queue the transfers."""
        client = machine.tool(self.node) if self.by_tool else machine.master.sdo(self.node)
        machine.at(self.at_s, client.run, *self.jobs)


@dataclass(frozen=True, slots=True)
class SdoRefused:
    """The master asks for something that the node refuses with an abort."""

    node: int
    at_s: float
    job: SdoJob = BAD_VALUE

    def arm(self, machine: Machine) -> None:
        """Queue the transfer."""
        machine.at(self.at_s, machine.master.sdo(self.node).run, self.job)
        machine.expect("sdo.abort", self.node, self.at_s, what=f"{self.job.index:04X}h refused")


@dataclass(frozen=True, slots=True)
class SdoSilent:
    """The SDO server of the node does not answer a read."""

    node: int
    at_s: float
    for_s: float = 2.0

    def arm(self, machine: Machine) -> None:
        """Mute the server and ask it."""
        node = machine.nodes[self.node]
        machine.at(self.at_s - 0.01, setattr, node, "mute_sdo", True)
        machine.at(self.at_s, machine.master.sdo(self.node).run, read(0x1000))
        machine.at(self.at_s + self.for_s, setattr, node, "mute_sdo", False)
        machine.expect("sdo.no_answer", self.node, self.at_s, self.for_s, what="SDO server mute")


@dataclass(frozen=True, slots=True)
class SdoTwoClients:
    """Master and a tool ask one node at the same time, each for other objects: no finding.

    The tool's requests come while the master waits for an answer: each of its first transfers is
    expedited, since a second initiate request ends a transfer of several steps.
    """

    node: int
    at_s: float
    jobs: tuple[SdoJob, ...] = (DEVICE_TYPE, *IDENTITY[:2])
    tool_jobs: tuple[SdoJob, ...] = (*IDENTITY[2:], *IDENTITY[2:])
    apart_us: int = 250

    def arm(self, machine: Machine) -> None:
        """Queue both."""
        machine.at(self.at_s, machine.master.sdo(self.node).run, *self.jobs)
        later_s = self.at_s + self.apart_us / 1e6
        machine.at(later_s, machine.tool(self.node).run, *self.tool_jobs)


@dataclass(frozen=True, slots=True)
class SdoServerAborts:
    """The server aborts a transfer in the middle, after `after` answers."""

    node: int
    at_s: float
    job: SdoJob = NAME
    after: int = 1
    code: int = abort.HARDWARE

    def arm(self, machine: Machine) -> None:
        """Script the abort and queue the transfer."""
        server = machine.nodes[self.node].sdo
        machine.at(self.at_s, setattr, server, "refuse_after", (self.after, self.code))
        machine.at(self.at_s, machine.master.sdo(self.node).run, self.job)
        machine.expect("sdo.abort", self.node, self.at_s, what=f"abort {self.code:08X}h")


@dataclass(frozen=True, slots=True)
class SdoClientAborts:
    """The master aborts its own transfer after `after` answers of several steps."""

    node: int
    at_s: float
    job: SdoJob = NAME
    after: int = 1
    code: int = abort.MEMORY

    def arm(self, machine: Machine) -> None:
        """Queue the transfer."""
        job = replace(self.job, abort_after=self.after, abort_code=self.code)
        machine.at(self.at_s, machine.master.sdo(self.node).run, job)
        machine.expect("sdo.abort", self.node, self.at_s, required=False)


@dataclass(frozen=True, slots=True)
class SdoClientStops:
    """The master says nothing more in the middle of a transfer.

    The server aborts by 0504 0000h after `server_timeout_ms`, or never with 0.
    """

    node: int
    at_s: float
    job: SdoJob = NAME
    after: int = 1
    server_timeout_ms: int = 200

    def arm(self, machine: Machine) -> None:
        """Queue the transfer."""
        node = machine.nodes[self.node]
        timeout_ns = self.server_timeout_ms * 1_000_000
        machine.at(self.at_s, setattr, node, "sdo_timeout_ns", timeout_ns)
        job = replace(self.job, stop_after=self.after)
        machine.at(self.at_s, machine.master.sdo(self.node).run, job)
        machine.at(self.at_s + 1, setattr, node, "sdo_timeout_ns", 0)
        for finding in ("sdo.abort", "sdo.no_answer"):
            machine.expect(finding, self.node, self.at_s, required=False)


@dataclass(frozen=True, slots=True)
class SdoServerStops:
    """The server falls silent in the middle of a transfer, after `after` answers."""

    node: int
    at_s: float
    job: SdoJob = NAME
    after: int = 1
    for_s: float = 1.0

    def arm(self, machine: Machine) -> None:
        """Silence the server and queue the transfer."""
        server = machine.nodes[self.node].sdo
        machine.at(self.at_s, setattr, server, "silent_after", self.after)
        machine.at(self.at_s, machine.master.sdo(self.node).run, self.job)
        machine.at(self.at_s + self.for_s, setattr, server, "silent_after", None)
        machine.at(self.at_s + self.for_s, server.reset)
        machine.expect("sdo.no_answer", self.node, self.at_s, self.for_s, required=False)


@dataclass(frozen=True, slots=True)
class SdoLate:
    """The answer comes after the client's time-out.

    Attributes:
        late_ms: how long the answer takes; the client waits for 500 ms.
        on_timeout: the client gives up silently, or says so by abort 0504 0000h.
        then: what it asks for next, at once after giving up: the late answer belongs to none of it.
    """

    node: int
    at_s: float
    job: SdoJob = DEVICE_TYPE
    late_ms: int = 700
    on_timeout: OnTimeout = "silent"
    then: tuple[SdoJob, ...] = ()

    def arm(self, machine: Machine) -> None:
        """Slow the server down and queue the transfer."""
        node, client = machine.nodes[self.node], machine.master.sdo(self.node)
        machine.at(self.at_s, node.sdo_delays_ns.append, self.late_ms * 1_000_000)
        machine.at(self.at_s, setattr, client, "on_timeout", self.on_timeout)
        machine.at(self.at_s, client.run, self.job, *self.then)
        machine.at(self.at_s + 0.6, setattr, client, "on_timeout", "silent")
        for finding in ("sdo.abort", "sdo.no_answer", "sdo.late_answer"):
            machine.expect(finding, self.node, self.at_s, self.late_ms / 1000, required=False)


@dataclass(frozen=True, slots=True)
class SdoReset:
    """The master resets the node in the middle of a transfer: the transfer is interrupted.

    Attributes:
        after_us: from the request to the reset command.
    """

    node: int
    at_s: float
    job: SdoJob = NAME
    after_us: int = 1500

    def arm(self, machine: Machine) -> None:
        """Queue the transfer and the reset."""
        machine.at(self.at_s, machine.master.sdo(self.node).run, self.job)
        later_s = self.at_s + self.after_us / 1e6
        machine.at(later_s, machine.master.command, RESET_NODE, self.node)


@dataclass(frozen=True, slots=True)
class BlockSegmentsLost:
    """Segments of a block transfer do not arrive at first and are sent again.

    Attributes:
        lose: which segments, counted from 0; never the last one of the transfer.
    """

    node: int
    at_s: float
    job: SdoJob = LOG
    lose: tuple[int, ...] = (2, 25)

    def arm(self, machine: Machine) -> None:
        """Let the receiver lose them."""
        machine.at(self.at_s, setattr, machine.nodes[self.node].sdo, "lose", self.lose)
        job = replace(self.job, lose=self.lose)
        machine.at(self.at_s, machine.master.sdo(self.node).run, job)
        machine.expect("sdo.block_repeated", self.node, self.at_s, required=False)


@dataclass(frozen=True, slots=True)
class BlockCrcWrong:
    """The CRC of a block transfer is wrong: the receiver aborts by 0504 0004h."""

    node: int
    at_s: float
    job: SdoJob = LOG

    def arm(self, machine: Machine) -> None:
        """Spoil the CRC of whoever sends the data."""
        if self.job.data is None:
            machine.at(self.at_s, setattr, machine.nodes[self.node].sdo, "spoil_crc", True)
        job = replace(self.job, spoil_crc=True)
        machine.at(self.at_s, machine.master.sdo(self.node).run, job)
        also = ("sdo.abort",)
        machine.expect("sdo.block_crc", self.node, self.at_s, what="wrong CRC", or_as=also)
        machine.expect("sdo.abort", self.node, self.at_s, required=False)


@dataclass(frozen=True, slots=True)
class NodeSearch:
    """The master looks for nodes that are not there, by NMT, SDO and guard requests: no finding."""

    at_s: float
    nodes: tuple[int, ...] = (61, 62, 63)
    by: tuple[Literal["nmt", "sdo", "guard"], ...] = ("nmt", "sdo", "guard")
    rounds: int = 2
    every_s: float = 0.6

    def arm(self, machine: Machine) -> None:
        """Queue the questions, one round after the other."""
        for number in range(self.rounds):
            machine.at(self.at_s + number * self.every_s, self._ask, machine.master)
        if "nmt" in self.by:
            for_s = self.rounds * self.every_s
            machine.expect("nmt.command_to_absent_node", None, self.at_s, for_s, required=False)

    def _ask(self, master: Master) -> None:
        for node in self.nodes:
            if "nmt" in self.by:
                master.command(START, node)
            if "sdo" in self.by:
                master.sdo(node).run(read(0x1000))
            if "guard" in self.by:
                master.guard_once(node)
