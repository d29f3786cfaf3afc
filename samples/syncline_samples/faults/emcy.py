"""Errors that devices report by EMCY."""

from dataclasses import dataclass

from syncline_samples.devices.errors import ERRORS
from syncline_samples.machine import Machine
from syncline_samples.master import START, STOP
from syncline_samples.sdo_client import read, write

MAY_TELL = (
    "emcy.partly_cleared",
    "emcy.intermittent",
    "emcy.returns_after_reset",
    "emcy.after_write",
)
"""What an analyzer may say besides of errors that come and go."""


def _may_tell(machine: Machine, node: int) -> None:
    for finding in MAY_TELL:
        machine.expect(finding, node, 0.0, machine.scenario.seconds, required=False)


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
        _may_tell(machine, self.node)
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
        _may_tell(machine, self.node)
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
class Errors:
    """Several errors of a device come and go, each with the bits of the device's sheet.

    Attributes:
        steps: (seconds after `at_s`, `+` for appears or `-` for goes away, EMCY code).
    """

    node: int
    at_s: float
    steps: tuple[tuple[float, str, int], ...]

    def arm(self, machine: Machine) -> None:
        """Raise and clear the errors."""
        _may_tell(machine, self.node)
        emcy, known = machine.nodes[self.node].emcy, ERRORS[machine.spec(self.node).device]
        left: set[int] = set()
        for after_s, what, code in sorted(self.steps):
            at_s = self.at_s + after_s
            if what == "+":
                machine.at(at_s, emcy.occur, code, *known[code])
                left.add(code)
            else:
                machine.at(at_s, emcy.vanish, code)
                left.discard(code)
        told = " ".join(f"{code:04X}h" for code in sorted(left))
        seconds = machine.scenario.seconds
        for_s = seconds if left else max(after_s for after_s, _, _ in self.steps)
        machine.expect(
            "emcy.active", self.node, self.at_s, for_s, required=bool(left), what=f"EMCY {told}"
        )


@dataclass(frozen=True, slots=True)
class EmcyMalformed:
    """The node sends EMCYs that are too short."""

    node: int
    at_s: float
    dlc: int = 4
    count: int = 3
    every_ms: int = 200

    def arm(self, machine: Machine) -> None:
        """Send them."""
        emcy = machine.nodes[self.node].emcy
        data = b"\x00\x10\x01\x00\x00\x00\x00"[: self.dlc]
        for number in range(self.count):
            machine.at(self.at_s + number * self.every_ms / 1000, emcy.send_raw, data)
        machine.expect("emcy.malformed", self.node, self.at_s, what=f"EMCY of {self.dlc} bytes")
        machine.expect("emcy.active", self.node, self.at_s, required=False)


@dataclass(frozen=True, slots=True)
class EmcyInhibitTime:
    """The master writes 1015h, then an error comes and goes quickly.

    A device that keeps its inhibit time sends late or not at all: no finding; one that does not
    (`hasty`) violates it.
    """

    node: int
    at_s: float
    inhibit_ms: int = 100
    count: int = 3
    every_ms: int = 30
    hasty: bool = False

    def arm(self, machine: Machine) -> None:
        """Write the inhibit time, then raise and clear an error."""
        _may_tell(machine, self.node)
        client = machine.master.sdo(self.node)
        machine.at(self.at_s, client.run, write(0x1015, 0, self.inhibit_ms * 10, 2))
        emcy = machine.nodes[self.node].emcy
        machine.at(self.at_s, setattr, emcy, "hasty", self.hasty)
        code, error = next(iter(ERRORS[machine.spec(self.node).device].items()))
        begin_s, step_s = self.at_s + 0.1, self.every_ms / 1000
        for number in range(self.count):
            machine.at(begin_s + 2 * number * step_s, emcy.occur, code, *error)
            machine.at(begin_s + (2 * number + 1) * step_s, emcy.vanish, code)
        for_s = 2 * self.count * step_s
        if self.hasty:
            machine.expect("emcy.inhibit_time", self.node, self.at_s, for_s, what="too quick")
        machine.expect(
            "emcy.active", self.node, self.at_s, machine.scenario.seconds, required=False
        )


@dataclass(frozen=True, slots=True)
class ErrorHistory:
    """The master reads 1001h and the error list 1003h: no finding."""

    node: int
    at_s: float
    entries: int = 2

    def arm(self, machine: Machine) -> None:
        """Queue the reads."""
        jobs = [read(0x1001), *(read(0x1003, sub) for sub in range(self.entries + 1))]
        machine.at(self.at_s, machine.master.sdo(self.node).run, *jobs)


@dataclass(frozen=True, slots=True)
class EmcyWhileStopped:
    """The master stops the node, which reports an error all the same, and starts it again."""

    node: int
    at_s: float
    for_s: float = 2.0

    def arm(self, machine: Machine) -> None:
        """Stop the node, send an EMCY and its clear, start the node."""
        emcy, master = machine.nodes[self.node].emcy, machine.master
        machine.at(self.at_s, master.command, STOP, self.node)
        machine.at(self.at_s + 0.5, emcy.send_raw, b"\x00\x10\x01\0\0\0\0\0")
        machine.at(self.at_s + 0.8, emcy.send_raw, bytes(8))
        machine.at(self.at_s + self.for_s, master.command, START, self.node)
        for finding in ("emcy.while_stopped", "emcy.active"):
            machine.expect(finding, self.node, self.at_s, self.for_s, required=False)
        _may_tell(machine, self.node)
