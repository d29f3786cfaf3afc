"""What happens to the wire: cables, transmitters."""

from dataclasses import dataclass

from syncline_samples.devices import Lir
from syncline_samples.machine import Machine
from syncline_samples.node import Node

_ERRORS_TO_BUS_OFF = 32
"""Transmit error counter 256 at eight per error (ISO 11898-1)."""


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
        machine.expect("error.frames", None, self.at_s, self.for_s, required=False)
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
        if isinstance(node, Lir):
            node.communication_error()
        node.after(100_000_000, node.emcy.vanish, code)
