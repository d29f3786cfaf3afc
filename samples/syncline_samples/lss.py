"""LSS (CiA 305): a slave in a node, and what a configuration tool sends."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from syncline_samples.bus import Frame
from syncline_samples.truth import LssTruth

if TYPE_CHECKING:
    from syncline_samples.node import Node
    from syncline_samples.world import World

REQUEST_ID, ANSWER_ID = 0x7E5, 0x7E4
_ANSWER_NS = 1_000_000
_SELECTIVE = (0x40, 0x41, 0x42, 0x43)
"""Vendor, product, revision, serial: sub-indices 1 to 4 of 1018h."""
_INQUIRE = {0x5A: 1, 0x5B: 2, 0x5C: 3, 0x5D: 4}
_REFUSED = 0x01


class LssSlave:
    """Answers LSS requests while it is in configuration state.

    Attributes:
        refuses: the device refuses what it is asked to configure or to store.
    """

    def __init__(self, node: Node, number_object: tuple[int, int]) -> None:
        self._node = node
        self._number_object = number_object
        self._configuring = False
        self._matched = 0
        self.refuses = False
        self.pending = node.node_id
        node.world.bus.listen(REQUEST_ID, self._on_request)

    def _on_request(self, frame: Frame, t_ns: int) -> None:
        if not self._node.awake or len(frame.data) < 8:
            return
        answer = self._answer(frame.data)
        if answer:
            self._node.after(_ANSWER_NS, self._send, answer.ljust(8, b"\0"))

    def _send(self, data: bytes) -> None:
        told = partial(note, self._node.world, False, data)
        self._node.send(Frame(ANSWER_ID, data), told)

    def _answer(self, data: bytes) -> bytes:
        command = data[0]
        if command == 0x04:
            self._configuring = data[1] == 1
            return b""
        if command in _SELECTIVE:
            return self._select(command, int.from_bytes(data[1:5], "little"))
        if not self._configuring:
            return b""
        if command == 0x11:
            self.pending = self.pending if self.refuses else data[1]
            return bytes([command, _REFUSED * self.refuses])
        if command in (0x13, 0x17):
            if command == 0x17 and not self.refuses:
                self._node.objects.commission(*self._number_object, self.pending)
            return bytes([command, _REFUSED * self.refuses])
        if command == 0x5E:
            return bytes([command, self._node.node_id])
        if command in _INQUIRE:
            value = self._node.objects.number(0x1018, _INQUIRE[command])
            return bytes([command]) + value.to_bytes(4, "little")
        return b""

    def _select(self, command: int, value: int) -> bytes:
        sub = command - _SELECTIVE[0] + 1
        fits = self._node.objects.number(0x1018, sub) == value and self._matched == sub - 1
        self._matched = sub if fits else 0
        if self._matched < len(_SELECTIVE):
            return b""
        self._matched, self._configuring = 0, True
        return b"\x44"


def note(world: World, request: bool, data: bytes, t_ns: int) -> None:
    """Keep an LSS frame in the truth."""
    world.truth.lss.append(LssTruth(world.utc_ns(t_ns), request, data))
    world.truth.count("lss", 0)


def session(
    identity: tuple[int, int, int, int] | None, node_id: int | None, bit_rate: int | None
) -> list[bytes]:
    """Requests of a tool: select, inquire, configure, store, and back to waiting.

    Args:
        identity: 1018h:1..4 of the slave, None to select whoever is there.
        bit_rate: index of the standard table of CiA 305.
    """
    if identity is None:
        frames = [b"\x04\x01"]
    else:
        pairs = zip(_SELECTIVE, identity, strict=True)
        frames = [bytes([command]) + value.to_bytes(4, "little") for command, value in pairs]
    frames += [b"\x5a", b"\x5e"]
    if node_id is not None:
        frames.append(bytes([0x11, node_id]))
    if bit_rate is not None:
        frames.append(bytes([0x13, 0, bit_rate]))
    if node_id is not None or bit_rate is not None:
        frames.append(b"\x17")
    return [frame.ljust(8, b"\0") for frame in (*frames, b"\x04\x00")]
