"""Values that go wrong."""

from dataclasses import dataclass

from syncline_samples.devices import Haomiao38, Lir
from syncline_samples.machine import Machine
from syncline_samples.node import Node


@dataclass(frozen=True, slots=True)
class AngleJump:
    """The position jumps without a bus command: the set input of a Haomiao, a fault of a LIR."""

    node: int
    at_s: float
    turns: float = 100.0

    def arm(self, machine: Machine) -> None:
        """Let the position jump."""
        machine.at(self.at_s, self._jump, machine.nodes[self.node])
        machine.expect(
            "angle.jump",
            self.node,
            self.at_s,
            what="impossible jump",
            or_as=("angle.preset_by_wire",),
        )

    def _jump(self, node: Node) -> None:
        if isinstance(node, Haomiao38):
            node.press_set_input()
        elif isinstance(node, Lir):
            node.jumped_counts += round(self.turns * node.model.counts_per_turn)
