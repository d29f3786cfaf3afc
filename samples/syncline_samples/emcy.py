"""The EMCY side of a simulated node: active errors, error register, error list."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from syncline_samples.bus import Frame
from syncline_samples.truth import EmcyTruth

if TYPE_CHECKING:
    from syncline_samples.node import Node

_INHIBIT_UNIT_NS = 100_000
_MUTE = ("OFF", "INITIALISING", "STOPPED")


class ActiveError(NamedTuple):
    """Bits that an error sets while it is there."""

    register: int
    alarms: int = 0
    warnings: int = 0


class EmcyMachine:
    """Errors of a node by code (CiA 301 7.2.7): each change sends an EMCY in the device's layout.

    Attributes:
        active: what is wrong now, by EMCY code.
        history: codes for 1003h, newest first.
        latched: register bits since the last read, for devices that clear 1001h by reading.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._not_before_ns = 0
        self.depth = 8
        self.reset()

    def reset(self) -> None:
        """Forget all errors, as at start-up."""
        self.active: dict[int, ActiveError] = {}
        self.history: list[int] = []
        self.latched = 0

    @property
    def register(self) -> int:
        """1001h: bits of the errors that are there now."""
        bits = 0
        for error in self.active.values():
            bits |= error.register
        return bits

    def occur(self, code: int, register: int, alarms: int = 0, warnings: int = 0) -> None:
        """An error appears."""
        self.active[code] = ActiveError(register, alarms, warnings)
        self.latched |= register
        self.history = [code, *self.history][: self.depth]
        self._send(code)

    def vanish(self, code: int) -> None:
        """An error goes away; 0000h tells what is left."""
        if self.active.pop(code, None) is not None:
            self._send(0x0000)

    def _send(self, code: int) -> None:
        node = self._node
        if node.state in _MUTE or not node.connected or node.now_ns < self._not_before_ns:
            return
        self._not_before_ns = node.now_ns + node.objects.number(0x1015) * _INHIBIT_UNIT_NS
        alarms = warnings = 0
        for error in self.active.values():
            alarms |= error.alarms
            warnings |= error.warnings
        data = node.emcy_bytes(code, self.register, alarms, warnings)
        told = (node.node_id, code, self.register, alarms, warnings)
        node.send(Frame(0x080 + node.node_id, data), partial(self._sent, told))

    def _sent(self, told: tuple[int, int, int, int, int], t_ns: int) -> None:
        self._node.world.truth.emcy.append(EmcyTruth(self._node.world.utc_ns(t_ns), *told))
