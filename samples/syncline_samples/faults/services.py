"""Services beside the usual ones: LSS of a configuration tool, TIME, a bus that loses power."""

from dataclasses import dataclass

from syncline_samples.bus import Frame
from syncline_samples.devices import IoModule
from syncline_samples.faults.settings import number_changed
from syncline_samples.lss import REQUEST_ID, note, session
from syncline_samples.machine import Machine
from syncline_samples.master import RESET_NODE
from syncline_samples.time_producer import TimeProducer

_STEP_S = 0.02
_SHORT_S = 1.5


@dataclass(frozen=True, slots=True)
class LssSession:
    """A configuration tool talks LSS with an I/O module, the one device here that has it.

    Attributes:
        to: node id to configure and store, None for none.
        bit_rate: index of the standard table to configure, None for none.
        selective: the tool selects the module by its identity, else whoever listens.
        refused: the module refuses what it is asked to configure.
        reset: the master resets the module afterwards: its new number counts from then on.
    """

    node: int
    at_s: float
    to: int | None = None
    bit_rate: int | None = None
    selective: bool = True
    refused: bool = False
    reset: bool = True

    def arm(self, machine: Machine) -> None:
        """Send the requests one after the other."""
        module = machine.nodes[self.node]
        if not isinstance(module, IoModule):
            raise TypeError(f"node {self.node} has no LSS; give an I/O module")
        identity = tuple(module.objects.number(0x1018, sub) for sub in range(1, 5))
        machine.at(self.at_s, setattr, module.lss, "refuses", self.refused)
        selected = (identity[0], identity[1], identity[2], identity[3]) if self.selective else None
        frames = session(selected, self.to, self.bit_rate)
        for number, data in enumerate(frames):
            machine.at(self.at_s + number * _STEP_S, self._send, machine, data)
        end_s = self.at_s + len(frames) * _STEP_S + 0.1
        for_s = machine.scenario.seconds
        if self.refused and (self.to, self.bit_rate) != (None, None):
            machine.expect("lss.refused", None, self.at_s, what="LSS refused")
        elif self.to is not None:
            machine.expect("lss.node_id_changed", None, self.at_s, for_s, what=f"to {self.to}")
            if self.reset:
                machine.at(end_s, machine.master.adopt, self.node, self.to)
                number_changed(machine, self.node, end_s)
        if self.bit_rate is not None:
            machine.expect("lss.bitrate_changed", None, self.at_s, for_s, required=False)
        if self.reset:
            machine.at(end_s, machine.master.command, RESET_NODE, self.node)

    def _send(self, machine: Machine, data: bytes) -> None:
        world = machine.world
        world.bus.send(Frame(REQUEST_ID, data), self, lambda t_ns: note(world, True, data, t_ns))


@dataclass(frozen=True, slots=True)
class TimeService:
    """A TIME producer tells the time, by a clock that is wrong by `offset_ms`.

    Attributes:
        jump_after_s: after so many seconds its clock jumps by `jump_ms`; 0 for never.
    """

    at_s: float
    every_s: float = 1.0
    offset_ms: int = 0
    jump_after_s: float = 0.0
    jump_ms: int = 0

    def arm(self, machine: Machine) -> None:
        """Start the producer."""
        every_ns, offset_ns = round(self.every_s * 1e9), self.offset_ms * 1_000_000
        producer = TimeProducer(machine.world, every_ns, offset_ns)
        machine.at(self.at_s, producer.start)
        for_s = machine.scenario.seconds
        if self.offset_ms:
            machine.expect("clock.time_differs", None, self.at_s, for_s, required=False)
        if self.jump_after_s:
            at_s = self.at_s + self.jump_after_s
            after_ns = offset_ns + self.jump_ms * 1_000_000
            machine.at(at_s, setattr, producer, "offset_ns", after_ns)
            machine.expect("clock.time_jump", None, at_s, what=f"TIME jumps by {self.jump_ms} ms")
            machine.expect("clock.time_differs", None, self.at_s, for_s, required=False)


@dataclass(frozen=True, slots=True)
class BusPowerOff:
    """All nodes, the master among them, lose power and get it back: nobody is accused.

    So short that the bus is hardly silent, it cannot be told from nodes that restart by themselves.
    """

    at_s: float
    off_s: float = 3.0

    def arm(self, machine: Machine) -> None:
        """Switch everything off and on."""
        machine.at(self.at_s, self._off, machine)
        machine.at(self.at_s + self.off_s, self._on, machine)
        allowed = ["bus.silent", "nmt.bus_silent", "sync.missing"]
        if self.off_s < _SHORT_S:
            allowed += ["nmt.unexpected_reset", "nmt.node_lost"]
        for finding in allowed:
            machine.expect(finding, None, self.at_s, self.off_s, required=False)

    def _off(self, machine: Machine) -> None:
        for node in machine.nodes.values():
            node.power_off()
        machine.master.power_off()
        machine.outputs_on = machine.sync.running = False

    def _on(self, machine: Machine) -> None:
        for number, node in enumerate(machine.nodes.values()):
            node.after(7_000_000 * number, node.power_on)
        machine.after(0.85, machine.master.power_on)
        machine.after(1.45, setattr, machine.sync, "running", True)
        machine.after(1.95, setattr, machine, "outputs_on", True)
