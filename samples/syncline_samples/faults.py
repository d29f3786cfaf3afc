"""What can go wrong on a machine, scripted: each fault knows the findings it must lead to.

`at_s` counts from the start of the run. Findings marked as not required are those that a correct
analyzer may add beside the main one.
"""

from dataclasses import dataclass

from syncline_samples.devices import Haomiao38, Lir
from syncline_samples.machine import DeviceSpec, Machine
from syncline_samples.master import PRE_OPERATIONAL, START, STOP
from syncline_samples.node import Node
from syncline_samples.sdo_client import SdoJob, read, write

BAD_VALUE = write(0x1029, 1, 5)
"""1029h:1 takes 0, 1 and 2."""
_ERRORS_TO_BUS_OFF = 32
"""Transmit error counter 256 at eight per error (ISO 11898-1)."""


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
class CableLoose:
    """The node is cut off the bus for a while and goes on living."""

    node: int
    at_s: float
    for_s: float

    def arm(self, machine: Machine) -> None:
        """Cut the node off and connect it again."""
        machine.at(self.at_s, _connect, machine.nodes[self.node], False)
        machine.at(self.at_s + self.for_s, _connect, machine.nodes[self.node], True)
        machine.expect("nmt.node_lost", self.node, self.at_s, self.for_s, what="cable loose")
        machine.expect("pdo.missed", self.node, self.at_s, self.for_s, required=False)


def _connect(node: Node, connected: bool) -> None:
    node.connected = connected
    if not connected:
        node.world.bus.withdraw(node)


@dataclass(frozen=True, slots=True)
class MasterSilent:
    """The master stops guarding; nodes whose life time is shorter say 8130h.

    The master starts such a node again `restart_s` after it guards again.
    """

    at_s: float
    for_s: float
    restart_s: float = 2.0

    def arm(self, machine: Machine) -> None:
        """Stop the guard requests."""
        machine.at(self.at_s, setattr, machine.master, "guarding", False)
        back_s = self.at_s + self.for_s
        machine.at(back_s, setattr, machine.master, "guarding", True)
        for spec in machine.scenario.devices:
            life_s = spec.guard_ms * spec.life_factor / 1000
            if 0 < life_s < self.for_s:
                machine.at(back_s + self.restart_s, machine.master.command, START, spec.node_id)
                machine.expect(
                    "nmt.guarding_lost",
                    spec.node_id,
                    self.at_s,
                    self.for_s,
                    what=f"master did not guard for {self.for_s * 1000:.0f} ms",
                )
                machine.expect("emcy.active", spec.node_id, self.at_s, required=False)


@dataclass(frozen=True, slots=True)
class Emcy:
    """An error of the node appears, and goes away after `for_s` or never."""

    node: int
    at_s: float
    code: int
    register: int
    alarms: int = 0
    warnings: int = 0
    for_s: float | None = None

    def arm(self, machine: Machine) -> None:
        """Raise and clear the error."""
        emcy = machine.nodes[self.node].emcy
        machine.at(self.at_s, emcy.occur, self.code, self.register, self.alarms, self.warnings)
        if self.for_s is not None:
            machine.at(self.at_s + self.for_s, emcy.vanish, self.code)
        stays = self.for_s is None or self.at_s + self.for_s >= machine.scenario.seconds
        machine.expect(
            "emcy.active",
            self.node,
            self.at_s,
            (machine.scenario.seconds if self.for_s is None else self.for_s),
            required=stays,
            what=f"EMCY {self.code:04X}h",
        )


@dataclass(frozen=True, slots=True)
class EmcyStorm:
    """An error comes and goes very often."""

    node: int
    at_s: float
    count: int = 40
    every_ms: int = 20
    code: int = 0x7320
    register: int = 0x01
    alarms: int = 0x0001

    def arm(self, machine: Machine) -> None:
        """Raise and clear the error again and again."""
        emcy = machine.nodes[self.node].emcy
        step_s = self.every_ms / 1000
        for number in range(self.count):
            at_s = self.at_s + 2 * number * step_s
            machine.at(at_s, emcy.occur, self.code, self.register, self.alarms)
            machine.at(at_s + step_s, emcy.vanish, self.code)
        for_s = 2 * self.count * step_s
        machine.expect("emcy.storm", self.node, self.at_s, for_s, what="EMCY storm")
        machine.expect("emcy.active", self.node, self.at_s, for_s, required=False)


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
class MissedPdos:
    """The node forgets its next due frames of one TPDO."""

    node: int
    at_s: float
    pdo: int = 2
    count: int = 5

    def arm(self, machine: Machine) -> None:
        """Let the node forget."""
        tpdo = machine.nodes[self.node].tpdos[self.pdo]
        machine.at(self.at_s, setattr, tpdo, "skip", self.count)
        machine.expect(
            "pdo.missed", self.node, self.at_s, what=f"TPDO{self.pdo} missed {self.count} times"
        )


@dataclass(frozen=True, slots=True)
class MissingSyncs:
    """The SYNC producer leaves out some SYNCs."""

    at_s: float
    count: int = 3

    def arm(self, machine: Machine) -> None:
        """Leave them out."""
        machine.at(self.at_s, setattr, machine.sync, "skip", self.count)
        machine.expect("sync.missing", None, self.at_s, what=f"{self.count} SYNCs missing")


@dataclass(frozen=True, slots=True)
class SyncJitter:
    """The SYNC producer is late by up to `jitter_us` for a while."""

    at_s: float
    for_s: float
    jitter_us: int

    def arm(self, machine: Machine) -> None:
        """Disturb the producer."""
        usual_ns = machine.scenario.sync_jitter_us * 1000
        machine.at(self.at_s, setattr, machine.sync, "jitter_ns", self.jitter_us * 1000)
        machine.at(self.at_s + self.for_s, setattr, machine.sync, "jitter_ns", usual_ns)
        machine.expect("sync.jitter", None, self.at_s, self.for_s, what="SYNC jitter")


@dataclass(frozen=True, slots=True)
class NodeBusOff:
    """The node's transmitter breaks its frames until it is bus-off; it recovers and tells."""

    node: int
    at_s: float
    for_s: float = 1.0

    def arm(self, machine: Machine) -> None:
        """Break the next transmissions of the node."""
        node = machine.nodes[self.node]
        machine.at(self.at_s, self._break, node)
        machine.expect("error.bus_off", self.node, self.at_s, self.for_s, what="bus-off")
        for finding in ("nmt.node_lost", "pdo.missed", "emcy.active"):
            machine.expect(finding, self.node, self.at_s, self.for_s, required=False)

    def _break(self, node: Node) -> None:
        node.world.bus.break_transmitter(node, _ERRORS_TO_BUS_OFF, lambda: self._off(node))

    def _off(self, node: Node) -> None:
        _connect(node, False)
        node.after(round(self.for_s * 1e9), self._recover, node)

    def _recover(self, node: Node) -> None:
        _connect(node, True)
        code, register = (0x7510, 0x10) if isinstance(node, Lir) else (0x8140, 0x11)
        node.emcy.occur(code, register)
        node.after(100_000_000, node.emcy.vanish, code)


@dataclass(frozen=True, slots=True)
class RecorderBusOff:
    """The recorder's own controller goes bus-off and hears nothing until it has restarted."""

    at_s: float
    for_s: float = 1.0

    def arm(self, machine: Machine) -> None:
        """Switch the controller off and on."""
        machine.at(self.at_s, self._off, machine)
        machine.at(self.at_s + self.for_s, self._restart, machine)
        machine.expect("error.bus_off", None, self.at_s, self.for_s, what="recorder bus-off")
        machine.expect("capture.gap", None, self.at_s, self.for_s, required=False)

    def _off(self, machine: Machine) -> None:
        machine.recorder.controller_off(machine.simulation.now_ns)

    def _restart(self, machine: Machine) -> None:
        machine.recorder.controller_restarted(machine.simulation.now_ns)


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
            "angle.jump",
        ):
            machine.expect(finding, self.node, self.at_s, for_s, required=False)


@dataclass(frozen=True, slots=True)
class RemoteOnHeartbeat:
    """Somebody guards a node that sends heartbeats."""

    node: int
    at_s: float
    count: int = 3
    every_s: float = 0.3

    def arm(self, machine: Machine) -> None:
        """Send the guard requests."""
        for number in range(self.count):
            at_s = self.at_s + number * self.every_s
            machine.at(at_s, machine.master.guard_once, self.node)
        machine.expect(
            "config.rtr_on_heartbeat_node", self.node, self.at_s, what="guarded despite heartbeat"
        )


@dataclass(frozen=True, slots=True)
class ClockStep:
    """The recorder's clock is set; a step forward looks like silence of the whole bus."""

    at_s: float
    step_ms: int

    def arm(self, machine: Machine) -> None:
        """Set the clock."""
        machine.at(self.at_s, machine.recorder.step_clock, self.step_ms * 1_000_000)
        if self.step_ms < 0:
            machine.expect("clock.step_back", None, self.at_s, what=f"{self.step_ms} ms")
        else:
            for finding in ("sync.missing", "nmt.node_lost"):
                machine.expect(finding, None, self.at_s, required=False)


@dataclass(frozen=True, slots=True)
class RecorderGap:
    """The recorder hears nothing for a while and knows it."""

    at_s: float
    for_s: float

    def arm(self, machine: Machine) -> None:
        """Blind the recorder."""
        machine.at(self.at_s, self._blind, machine)
        machine.at(self.at_s + self.for_s, self._see, machine)
        machine.expect("capture.gap", None, self.at_s, self.for_s, what="adapter lost")

    def _blind(self, machine: Machine) -> None:
        machine.recorder.go_blind(machine.simulation.now_ns)

    def _see(self, machine: Machine) -> None:
        machine.recorder.see_again(machine.simulation.now_ns)


@dataclass(frozen=True, slots=True)
class AngleJump:
    """The position jumps without a bus command: the set input of a Haomiao, a fault of a LIR."""

    node: int
    at_s: float
    turns: float = 100.0

    def arm(self, machine: Machine) -> None:
        """Let the position jump."""
        machine.at(self.at_s, self._jump, machine.nodes[self.node])
        machine.expect("angle.jump", self.node, self.at_s, what="impossible jump")

    def _jump(self, node: Node) -> None:
        if isinstance(node, Haomiao38):
            node.press_set_input()
        elif isinstance(node, Lir):
            node.jumped_counts += round(self.turns * node.model.counts_per_turn)


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
    """The master makes transfers that go well: no finding."""

    node: int
    at_s: float
    jobs: tuple[SdoJob, ...]

    def arm(self, machine: Machine) -> None:
        """Queue the transfers."""
        machine.at(self.at_s, machine.master.sdo(self.node).run, *self.jobs)


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
