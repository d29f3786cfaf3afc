"""What happens to the recorder itself."""

from dataclasses import dataclass

from syncline_samples.machine import Machine

_BURST = 10
"""Fewer error frames may be a plug that was moved."""
_CONTROLLER, _COUNTERS = 0x004, 0x200
_RX_WARNING, _RX_PASSIVE, _ACTIVE = 0x04, 0x10, 0x40
_BUS_ERRORS = {
    "stuff": (0x88, bytes([0, 0, 0x04, 0x0A, 0, 0, 0, 0])),
    "form": (0x88, bytes([0, 0, 0x02, 0x18, 0, 0, 0, 0])),
    "crc": (0x88, bytes([0, 0, 0x01, 0x08, 0, 0, 0, 0])),
    "ack": (0xA8, bytes([0, 0, 0x00, 0x19, 0, 0, 0, 0])),
}
"""SocketCAN error classes and data (linux/can/error.h): type in byte 2, location in byte 3."""


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
            for finding in ("clock.step_forward", "bus.silent", "sync.missing", "nmt.bus_silent"):
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
        machine.expect("bus.silent", None, self.at_s, self.for_s, required=False)

    def _blind(self, machine: Machine) -> None:
        machine.recorder.go_blind(machine.simulation.now_ns)

    def _see(self, machine: Machine) -> None:
        machine.recorder.see_again(machine.simulation.now_ns)


@dataclass(frozen=True, slots=True)
class RecordingBegins:
    """Somebody begins to record a machine that is already at work: no finding by itself."""

    at_s: float

    def arm(self, machine: Machine) -> None:
        """Hear nothing until then."""
        machine.recorder.not_yet()
        machine.at(self.at_s, self._begin, machine)

    def _begin(self, machine: Machine) -> None:
        machine.recorder.begin(machine.simulation.now_ns)


@dataclass(frozen=True, slots=True)
class Overrun:
    """The recorder's controller loses frames and says so afterwards."""

    at_s: float
    for_ms: int = 20

    def arm(self, machine: Machine) -> None:
        """Lose the frames, then tell of it."""
        machine.at(self.at_s, self._blind, machine)
        machine.at(self.at_s + self.for_ms / 1000, self._tell, machine)
        machine.expect("error.overrun", None, self.at_s, what="recorder overrun")
        for finding in ("sync.missing", "pdo.missed", "capture.gap"):
            machine.expect(finding, None, self.at_s, required=False)

    def _blind(self, machine: Machine) -> None:
        machine.recorder.go_blind(machine.simulation.now_ns)

    def _tell(self, machine: Machine) -> None:
        machine.recorder.overflowed(machine.simulation.now_ns)


@dataclass(frozen=True, slots=True)
class ControllerState:
    """The recorder's own controller reaches the warning level, becomes passive, and is active again.

    Attributes:
        passive: it goes beyond the warning level.
    """

    at_s: float
    for_s: float = 1.0
    passive: bool = True

    def arm(self, machine: Machine) -> None:
        """Tell of the states, with the error counters as Linux 6 does."""
        self._tell(machine, self.at_s, _RX_WARNING, 96)
        if self.passive:
            self._tell(machine, self.at_s + 0.05, _RX_PASSIVE, 128)
        self._tell(machine, self.at_s + self.for_s, _ACTIVE, 40)
        level = "error.passive" if self.passive else "error.warning_level"
        machine.expect(level, None, self.at_s, self.for_s, what="the recorder's controller")
        for finding in ("error.warning_level", "error.frames"):
            machine.expect(finding, None, self.at_s, self.for_s, required=False)

    def _tell(self, machine: Machine, at_s: float, what: int, count: int) -> None:
        data = bytes([0, what, 0, 0, 0, 0, 0, count])
        t_ns = round(at_s * 1e9)
        machine.at(at_s, machine.recorder.controller, t_ns, _CONTROLLER | _COUNTERS, data)


@dataclass(frozen=True, slots=True)
class ErrorFrames:
    """Error frames on the bus that destroy nothing that is missed.

    Attributes:
        kind: what the recorder's controller says was wrong; `ack` is the recorder's own frame that
            nobody acknowledged.
    """

    at_s: float
    count: int = 20
    every_ms: int = 30
    kind: str = "stuff"

    def arm(self, machine: Machine) -> None:
        """Tell of each."""
        classes, data = _BUS_ERRORS[self.kind]
        for number in range(self.count):
            at_s = self.at_s + number * self.every_ms / 1000
            machine.at(at_s, machine.recorder.controller, round(at_s * 1e9), classes, data)
        for_s = self.count * self.every_ms / 1000
        finding = "error.no_ack" if self.kind == "ack" else "error.frames"
        many = self.count >= _BURST
        told = f"{self.count} error frames"
        machine.expect(finding, None, self.at_s, for_s, required=many, what=told)
        machine.expect("error.frames", None, self.at_s, for_s, required=False)
