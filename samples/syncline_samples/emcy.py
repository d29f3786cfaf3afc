"""The EMCY side of a simulated node: active errors, error register, error list."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from syncline_samples.bus import Frame
from syncline_samples.truth import EmcyTruth, ErrorTruth

if TYPE_CHECKING:
    from syncline_samples.node import Node

_INHIBIT_UNIT_NS = 100_000
_MUTE = ("OFF", "INITIALISING", "STOPPED")


class ActiveError(NamedTuple):
    """Bits that an error sets while it is there."""

    register: int
    alarms: int = 0
    warnings: int = 0


@dataclass(slots=True)
class _Episode:
    """An error from the EMCY that told of it to the one that told of its end."""

    code: int
    occurred_ns: int
    raised_ns: int | None = None
    cleared_ns: int | None = None
    count: int = 0


class _Message(NamedTuple):
    code: int
    register: int
    alarms: int
    warnings: int
    active: tuple[int, ...]
    ended: _Episode | None


class EmcyMachine:
    """Errors of a node by code (CiA 301 7.2.7): each change sends an EMCY in the device's layout.

    Attributes:
        active: what is wrong now, by EMCY code.
        history: codes for 1003h, newest first.
        latched: register bits since the last read, for devices that clear 1001h by reading.
        inhibit_drops: what happens within the inhibit time 1015h is never sent (it shows in 1003h
            only), else it is sent when the time is over.
        hasty: the device ignores its inhibit time (a scripted fault).
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._not_before_ns = 0
        self.depth = 8
        self.inhibit_drops = False
        self.hasty = False
        self._open: dict[int, _Episode] = {}
        self._ended: list[_Episode] = []
        self._empty()

    def _empty(self) -> None:
        self.active: dict[int, ActiveError] = {}
        self.history: list[int] = []
        self.latched = 0
        self._delayed: list[_Message] = []

    def reset(self) -> None:
        """Forget all errors, as at start-up."""
        self._note("lost at reset")
        self._not_before_ns = 0
        self._empty()

    def finish(self) -> None:
        """Note the errors that are left at the end of the run."""
        self._note("still active")

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
        if code not in self._open:
            self._open[code] = _Episode(code, self._node.now_ns)
        self.latched |= register
        self.history = [code, *self.history][: self.depth]
        self._tell(code)

    def vanish(self, code: int) -> None:
        """An error goes away; 0000h tells what is left."""
        if self.active.pop(code, None) is not None:
            episode = self._open.pop(code)
            self._ended.append(episode)
            self._tell(0x0000, episode)

    def send_raw(self, data: bytes) -> None:
        """Send any bytes on the EMCY identifier, as faulty firmware does."""
        node = self._node
        cob_id = self._cob_id
        if cob_id is not None:
            node.send(Frame(cob_id, data), partial(self._raw_sent, data))

    def _raw_sent(self, data: bytes, t_ns: int) -> None:
        world = self._node.world
        code = int.from_bytes(data[:2], "little")
        register = data[2] if len(data) > 2 else 0
        row = EmcyTruth(world.utc_ns(t_ns), self._node.node_id, code, register, 0, 0, dlc=len(data))
        world.truth.emcy.append(row)

    @property
    def _cob_id(self) -> int | None:
        """1014h; None while the EMCY is switched off by bit 31."""
        node = self._node
        cob_id = node.objects.number(0x1014) or 0x080 + node.node_id
        return None if cob_id >> 31 else cob_id & 0x7FF

    def _tell(self, code: int, ended: _Episode | None = None) -> None:
        alarms = warnings = 0
        for error in self.active.values():
            alarms |= error.alarms
            warnings |= error.warnings
        self._send(
            _Message(code, self.register, alarms, warnings, tuple(self.active), ended), late=False
        )

    def _send(self, message: _Message, *, late: bool) -> None:
        node, cob_id = self._node, self._cob_id
        if node.state in _MUTE or not node.connected or cob_id is None:
            return
        waits = node.now_ns < self._not_before_ns or bool(self._delayed)
        if waits and not late and not self.hasty:
            if not self.inhibit_drops:
                if not self._delayed:
                    node.after(self._not_before_ns - node.now_ns, self._send_delayed)
                self._delayed.append(message)
            return
        self._not_before_ns = node.now_ns + self._inhibit_ns
        data = node.emcy_bytes(message.code, message.register, message.alarms, message.warnings)
        node.send(Frame(cob_id, data), partial(self._sent, message))

    @property
    def _inhibit_ns(self) -> int:
        return self._node.objects.number(0x1015) * _INHIBIT_UNIT_NS

    def _send_delayed(self) -> None:
        if self._delayed:
            self._send(self._delayed.pop(0), late=True)
        if self._delayed:
            self._node.after(max(1, self._inhibit_ns), self._send_delayed)

    def _sent(self, message: _Message, t_ns: int) -> None:
        world, node = self._node.world, self._node.node_id
        now_ns = world.utc_ns(t_ns)
        world.truth.emcy.append(EmcyTruth(now_ns, node, *message[:5]))
        if message.ended is not None:
            message.ended.cleared_ns = now_ns
        elif (episode := self._open.get(message.code)) is not None:
            episode.raised_ns = episode.raised_ns or now_ns
            episode.count += 1

    def _note(self, left: str) -> None:
        """Hand the episodes to the truth; `left` says what became of those that are there."""
        world = self._node.world
        for episode in (*self._ended, *self._open.values()):
            cleared = episode.cleared_ns is not None
            world.truth.errors.append(
                ErrorTruth(
                    self._node.node_id,
                    episode.code,
                    world.utc_ns(episode.occurred_ns),
                    episode.raised_ns,
                    episode.cleared_ns,
                    "cleared" if cleared else left,
                    episode.count,
                )
            )
        self._ended.clear()
        self._open.clear()
