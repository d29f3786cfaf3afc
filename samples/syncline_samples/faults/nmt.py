"""NMT life that goes wrong: resets, power, commands, two devices of one number."""

from dataclasses import dataclass
from functools import partial

from syncline_samples.devices import Lir
from syncline_samples.error_control import ErrorControl
from syncline_samples.machine import DeviceSpec, Machine
from syncline_samples.master import PRE_OPERATIONAL, START, STOP
from syncline_samples.node import Node, State
from syncline_samples.world import MS

FEW_PERIODS = 8
"""Fewer long heartbeat intervals than these need not show another period."""


@dataclass(frozen=True, slots=True)
class WatchdogReset:
    """The node restarts by itself at once; a LIR says so by EMCY 6010h, which clears later.

    It is back before its heartbeat is missed, if that has a period of 200 ms or more.
    """

    node: int
    at_s: float
    boot_ms: int = 80

    def arm(self, machine: Machine) -> None:
        """Restart the node."""
        machine.at(self.at_s, self._restart, machine.nodes[self.node])
        machine.expect("nmt.unexpected_reset", self.node, self.at_s, what="watchdog reset")
        machine.expect("emcy.active", self.node, self.at_s, required=False)

    def _restart(self, node: Node) -> None:
        boot_ns = self.boot_ms * 1_000_000
        node.restart(boot_ns, commanded=False)
        if isinstance(node, Lir):
            node.after(boot_ns + 20_000_000, node.emcy.occur, 0x6010, 0x01, 0, 0x0004)
            node.after(boot_ns + 2_000_000_000, node.emcy.vanish, 0x6010)


@dataclass(frozen=True, slots=True)
class PowerLoss:
    """The node loses power for a while and boots when it is back."""

    node: int
    at_s: float
    off_s: float

    def arm(self, machine: Machine) -> None:
        """Switch the node off and on."""
        node = machine.nodes[self.node]
        machine.at(self.at_s, node.power_off)
        machine.at(self.at_s + self.off_s, node.power_on)
        lost, reset = "nmt.node_lost", "nmt.unexpected_reset"
        machine.expect(lost, self.node, self.at_s, self.off_s, what="power loss", or_as=(reset,))
        machine.expect(reset, self.node, self.at_s, self.off_s, required=False)
        machine.expect(lost, self.node, self.at_s, self.off_s, required=False)
        machine.expect("pdo.missed", self.node, self.at_s, self.off_s, required=False)


@dataclass(frozen=True, slots=True)
class CommandIgnored:
    """The master sends an NMT command that the node does not follow."""

    node: int
    at_s: float
    specifier: int = STOP

    def arm(self, machine: Machine) -> None:
        """Send the command to a node that overlooks it."""
        machine.at(self.at_s - 0.001, setattr, machine.nodes[self.node], "ignore_commands", 1)
        machine.at(self.at_s, machine.master.command, self.specifier, self.node)
        machine.expect("nmt.command_ignored", self.node, self.at_s, what="command ignored")
        machine.expect("nmt.pdo_outside_operational", self.node, self.at_s, required=False)


@dataclass(frozen=True, slots=True)
class Command:
    """The master sends an NMT command that is followed: no finding."""

    at_s: float
    specifier: int
    node: int = 0

    def arm(self, machine: Machine) -> None:
        """Send the command."""
        machine.at(self.at_s, machine.master.command, self.specifier, self.node)


@dataclass(frozen=True, slots=True)
class PdoOutsideOperational:
    """The node goes on sending PDOs in PRE-OPERATIONAL for a while."""

    node: int
    at_s: float
    for_s: float = 2.0

    def arm(self, machine: Machine) -> None:
        """Send the node to PRE-OPERATIONAL with faulty firmware, and start it again."""
        node = machine.nodes[self.node]
        machine.at(self.at_s - 0.001, setattr, node.tpdos, "rogue", True)
        machine.at(self.at_s, machine.master.command, PRE_OPERATIONAL, self.node)
        machine.at(self.at_s + self.for_s, setattr, node.tpdos, "rogue", False)
        machine.at(self.at_s + self.for_s, node.tpdos.stop)
        machine.at(self.at_s + self.for_s + 1, machine.master.command, START, self.node)
        machine.expect(
            "nmt.pdo_outside_operational",
            self.node,
            self.at_s,
            self.for_s,
            what="PDOs in PRE-OPERATIONAL",
        )


@dataclass(frozen=True, slots=True)
class DuplicateNode:
    """A second device with the node id of another is plugged in; NMT commands reach both."""

    node: int
    at_s: float
    device: str = "haomiao-38"
    heartbeat_ms: int = 700

    def arm(self, machine: Machine) -> None:
        """Power the second device."""
        twin = machine.build(
            DeviceSpec(self.node, self.device, "twin", stored_heartbeat_ms=self.heartbeat_ms)
        )
        twin.told = False
        machine.at(self.at_s, twin.power_on)
        for_s = machine.scenario.seconds
        machine.expect("nmt.duplicate_node_id", self.node, self.at_s, for_s, what="second device")
        for finding in (
            "nmt.unexpected_reset",
            "nmt.pdo_outside_operational",
            "nmt.command_ignored",
            "pdo.missed",
            "sdo.doubled_answer",
            "sdo.abort",
            "pdo.extra",
            "angle.jump",
            "angle.preset_by_wire",
        ):
            machine.expect(finding, self.node, self.at_s, for_s, required=False)


@dataclass(frozen=True, slots=True)
class LeavesOperational:
    """The node leaves OPERATIONAL by itself, and the master starts it again after `for_s`.

    Of a device that boots with 7Fh nobody can tell PRE-OPERATIONAL from a restart (new LIR, trap 1).
    """

    node: int
    at_s: float
    to: State = State.PRE_OPERATIONAL
    for_s: float = 2.0

    def arm(self, machine: Machine) -> None:
        """Change the state without a command."""
        machine.at(self.at_s, self._leave, machine)
        machine.at(self.at_s + self.for_s, machine.master.command, START, self.node)

    def _leave(self, machine: Machine) -> None:
        """What was stored meanwhile tells what the fall looks like."""
        node = machine.nodes[self.node]
        node.enter(self.to)
        looks_like_boot_up = self.to is State.PRE_OPERATIONAL and node.boot_up_byte() == 0x7F
        machine.expect(
            "nmt.left_operational",
            self.node,
            self.at_s,
            self.for_s,
            what=f"to {self.to}",
            or_as=("nmt.unexpected_reset",) if looks_like_boot_up else (),
        )
        machine.expect("pdo.missed", self.node, self.at_s, self.for_s, required=False)


@dataclass(frozen=True, slots=True)
class BootLoop:
    """The node restarts by itself again and again."""

    node: int
    at_s: float
    count: int = 4
    every_ms: int = 900
    boot_ms: int = 100

    def arm(self, machine: Machine) -> None:
        """Restart the node again and again."""
        node = machine.nodes[self.node]
        for number in range(self.count):
            at_s = self.at_s + number * self.every_ms / 1000
            machine.at(at_s, partial(node.restart, self.boot_ms * MS, commanded=False))
        for_s = self.count * self.every_ms / 1000
        reset = "nmt.unexpected_reset"
        machine.expect(
            "nmt.boot_loop", self.node, self.at_s, for_s, what="boot loop", or_as=(reset,)
        )
        for finding in (reset, "nmt.node_lost", "pdo.missed", "nmt.command_ignored"):
            machine.expect(finding, self.node, self.at_s, for_s, required=False)


@dataclass(frozen=True, slots=True)
class HeartbeatPeriod:
    """The heartbeat runs slower or faster than 1017h says.

    Attributes:
        percent: actual period in percent of 1017h. From 150 on the heartbeat is slow; what is
            faster than 70 is told as well.
    """

    node: int
    at_s: float
    percent: int = 200
    for_s: float = 4.0

    def arm(self, machine: Machine) -> None:
        """Change the period, and change it back."""
        control = machine.nodes[self.node].error_control
        machine.at(self.at_s, self._set, control, self.percent)
        machine.at(self.at_s + self.for_s, self._set, control, 100)
        if self.percent > 100:
            machine.expect(
                "nmt.heartbeat_slow",
                self.node,
                self.at_s,
                self.for_s,
                required=self.percent >= 150,
                what=f"{self.percent} % of 1017h",
                or_as=self._otherwise(machine),
            )
        elif self.percent < 70:
            fast = "nmt.heartbeat_fast"
            machine.expect(fast, self.node, self.at_s, self.for_s, required=False)
        # The timer begins anew at both ends, so that one interval is longer than 1.5 periods.
        machine.expect("nmt.node_lost", self.node, self.at_s, self.for_s, required=False)

    def _otherwise(self, machine: Machine) -> tuple[str, ...]:
        """A few long intervals are no period: the bus tells late heartbeats of a node that is there."""
        slow_s = machine.spec(self.node).heartbeat_ms * self.percent / 100_000
        few = self.for_s < FEW_PERIODS * slow_s
        return ("nmt.node_lost", "nmt.heartbeat_irregular") if few else ("nmt.node_lost",)

    def _set(self, control: ErrorControl, percent: int) -> None:
        control.percent = percent
        control.restart_beat()


@dataclass(frozen=True, slots=True)
class HeartbeatIrregular:
    """Heartbeats are late by up to a share of their period: below half of it no finding."""

    node: int
    at_s: float
    percent: int = 30
    for_s: float = 3.0

    def arm(self, machine: Machine) -> None:
        """Disturb the heartbeats."""
        node = machine.nodes[self.node]
        machine.at(self.at_s, self._disturb, node)
        machine.at(self.at_s + self.for_s, setattr, node.error_control, "jitter_ns", 0)
        for finding in ("nmt.heartbeat_slow", "nmt.heartbeat_irregular", "nmt.node_lost"):
            if self.percent >= 45:
                machine.expect(finding, self.node, self.at_s, self.for_s, required=False)

    def _disturb(self, node: Node) -> None:
        period_ns = node.objects.number(0x1017) * MS
        node.error_control.jitter_ns = period_ns * self.percent // 100


@dataclass(frozen=True, slots=True)
class HeartbeatsMissing:
    """The node leaves out some heartbeats and goes on with everything else."""

    node: int
    at_s: float
    count: int = 3

    def arm(self, machine: Machine) -> None:
        """Let the node leave them out."""
        control = machine.nodes[self.node].error_control
        machine.at(self.at_s, setattr, control, "silent_beats", self.count)
        for_s = self.count * machine.spec(self.node).heartbeat_ms / 1000
        for finding in ("nmt.heartbeat_slow", "nmt.heartbeat_irregular", "nmt.node_lost"):
            machine.expect(finding, self.node, self.at_s, for_s, required=False)


@dataclass(frozen=True, slots=True)
class MalformedCommand:
    """Somebody sends an NMT frame that is no command: a wrong length, or an unknown specifier."""

    at_s: float
    data: bytes = b"\x01"

    def arm(self, machine: Machine) -> None:
        """Send it."""
        machine.at(self.at_s, machine.master.send_raw, self.data)
        machine.expect("nmt.malformed_command", None, self.at_s, what=self.data.hex(" "))


@dataclass(frozen=True, slots=True)
class UnknownState:
    """The heartbeat carries a state that CiA 301 does not know."""

    node: int
    at_s: float
    byte: int = 0x33
    for_s: float = 3.0

    def arm(self, machine: Machine) -> None:
        """Let the node say it for a while."""
        control = machine.nodes[self.node].error_control
        machine.at(self.at_s, setattr, control, "says", self.byte)
        machine.at(self.at_s + self.for_s, setattr, control, "says", None)
        machine.expect(
            "nmt.unknown_state", self.node, self.at_s, self.for_s, what=f"state {self.byte:02X}h"
        )
