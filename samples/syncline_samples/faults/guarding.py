"""Node guarding that goes wrong."""

from dataclasses import dataclass

from syncline_samples.machine import Machine
from syncline_samples.master import START


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
class GuardToggleStuck:
    """The node does not change the toggle bit of its next guard answers."""

    node: int
    at_s: float
    count: int = 5

    def arm(self, machine: Machine) -> None:
        """Let the bit stick."""
        control = machine.nodes[self.node].error_control
        machine.at(self.at_s, setattr, control, "toggle_stuck", self.count)
        for_s = self.count * machine.spec(self.node).guard_ms / 1000
        machine.expect("nmt.guard_toggle", self.node, self.at_s, for_s, what="toggle bit stuck")


@dataclass(frozen=True, slots=True)
class GuardUnanswered:
    """The node does not answer some guard requests, and goes on living."""

    node: int
    at_s: float
    count: int = 2

    def arm(self, machine: Machine) -> None:
        """Let the node overlook them."""
        control = machine.nodes[self.node].error_control
        machine.at(self.at_s, setattr, control, "unanswered", self.count)
        for_s = self.count * machine.spec(self.node).guard_ms / 1000
        for finding in (
            "nmt.guard_unanswered",
            "nmt.node_lost",
            "nmt.guarding_lost",
            "emcy.active",
        ):
            machine.expect(finding, self.node, self.at_s, for_s, required=False)
