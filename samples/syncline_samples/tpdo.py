"""TPDOs of a simulated node: transmission types, timers, inhibit times, repeat counters."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from syncline_samples.bus import Frame
from syncline_samples.truth import MissedTruth, PdoTruth
from syncline_samples.world import MS, Delay

if TYPE_CHECKING:
    from syncline_samples.node import Node

Build = Callable[[int], tuple[bytes, tuple[int, ...]]]
"""Bytes of a PDO at a time, and the true values behind them."""

_PDO_OFF = 1 << 31
_INHIBIT_UNIT_NS = 100_000
_CYCLIC = (0xFE, 0xFF)
_LAST_SYNC_TYPE = 0xF0


class Tpdo:
    """One TPDO; the parameters are those of 18xxh as they run now.

    Attributes:
        skip: how many due frames the device will forget (a scripted fault).
        hasty: the inhibit time is not kept (a scripted fault).
        cut_to: bytes that are sent of each frame; None for all (a scripted fault).
        quiet_until_ns: the device has no value to send before this time.
    """

    def __init__(self, number: int, build: Build) -> None:
        self.number = number
        self.build = build
        self.can_id = 0
        self.enabled = True
        self.kind = 0
        self.timer_ns = 0
        self.inhibit_ns = 0
        self.repeat = 0
        self.sync_count = 0
        self.generation = 0
        self.frames_left = 0
        self.last_data: bytes | None = None
        self.not_before_ns = 0
        self.skip = 0
        self.hasty = False
        self.cut_to: int | None = None
        self.quiet_until_ns = 0

    @property
    def schedule(self) -> tuple[int, bool, int, int, int]:
        """What decides when it is sent."""
        return self.can_id, self.enabled, self.kind, self.timer_ns, self.repeat

    def allows_repeat(self, data: bytes) -> bool:
        """Whether the repeat counter lets this frame out (LIR 2800h: k frames per change)."""
        if not self.repeat:
            return True
        if data != self.last_data:
            self.frames_left = self.repeat
            self.last_data = data
        self.frames_left -= 1
        return self.frames_left >= 0


class TpdoSet:
    """All TPDOs of a node.

    Attributes:
        response: time from the end of a SYNC until an answer is handed to the bus.
        rogue: the node goes on sending PDOs outside OPERATIONAL (a scripted fault).
        type0_sends: transmission type 0 sends once per change at the next SYNC; else it is off.
        answers_remote: a remote frame on a TPDO identifier is answered in any state.
    """

    def __init__(self, node: Node, tpdos: list[Tpdo], response: Delay) -> None:
        self._node = node
        self._all = tpdos
        self.response = response
        self._running = False
        self._synchronous: list[Tpdo] = []
        self.rogue = False
        self.type0_sends = False
        self.answers_remote = False
        node.objects.on_write(0x1005, 0, self.rewritten)
        for tpdo in tpdos:
            for sub in (1, 2, 3, 5):
                node.objects.on_write(0x17FF + tpdo.number, sub, self.rewritten)
            node.objects.on_write(0x19FF + tpdo.number, 0, self.rewritten)
            node.objects.on_write(0x27FF + tpdo.number, 0, self.rewritten)
        self.configure()

    def __getitem__(self, number: int) -> Tpdo:
        return self._all[number - 1]

    def rewritten(self, value: int) -> None:
        """Take over parameters that a client has written; PDOs that did not change go on."""
        before = [tpdo.schedule for tpdo in self._all]
        self.configure()
        for tpdo, schedule in zip(self._all, before, strict=True):
            if self._running and tpdo.schedule != schedule:
                self._start(tpdo)

    def configure(self) -> None:
        """Read the parameters from the object dictionary."""
        objects = self._node.objects
        sync_id = objects.number(0x1005) & 0x7FF or 0x080
        self._node.hear("SYNC", sync_id, self._on_sync)
        for tpdo in self._all:
            index = 0x17FF + tpdo.number
            cob_id = objects.number(index, 1)
            mapped = objects.number(0x19FF + tpdo.number)
            tpdo.can_id, tpdo.enabled = cob_id & 0x7FF, bool(mapped and not cob_id & _PDO_OFF)
            self._node.hear(f"TPDO{tpdo.number}", tpdo.can_id, self._on_remote)
            tpdo.kind = objects.number(index, 2)
            tpdo.inhibit_ns = objects.number(index, 3) * _INHIBIT_UNIT_NS
            tpdo.timer_ns = objects.number(index, 5) * MS
            tpdo.repeat = objects.number(0x27FF + tpdo.number)
        self._synchronous = [tpdo for tpdo in self._all if tpdo.enabled and self._on_syncs(tpdo)]

    def _on_syncs(self, tpdo: Tpdo) -> bool:
        return 1 <= tpdo.kind <= _LAST_SYNC_TYPE or (tpdo.kind == 0 and self.type0_sends)

    def start(self) -> None:
        """Begin to send: OPERATIONAL was entered."""
        self._running = True
        for tpdo in self._all:
            self._start(tpdo)

    def _start(self, tpdo: Tpdo) -> None:
        tpdo.generation += 1
        tpdo.sync_count = 0
        tpdo.last_data = None
        if tpdo.enabled and tpdo.kind in _CYCLIC and tpdo.timer_ns:
            self._node.after(tpdo.timer_ns, self._tick, tpdo, tpdo.generation)

    def stop(self) -> None:
        """OPERATIONAL was left."""
        if not self.rogue:
            self._running = False
            for tpdo in self._all:
                tpdo.generation += 1

    def trigger(self, number: int) -> None:
        """Send an event-driven TPDO now."""
        tpdo = self[number]
        if self._running and tpdo.enabled:
            data, values = tpdo.build(self._node.now_ns)
            self._queue(tpdo, data, values, None)

    def _tick(self, tpdo: Tpdo, generation: int) -> None:
        if generation != tpdo.generation:
            return
        self._node.after(tpdo.timer_ns, self._tick, tpdo, generation)
        data, values = tpdo.build(self._node.now_ns)
        if tpdo.allows_repeat(data):
            if tpdo.skip:
                tpdo.skip -= 1
            else:
                self._queue(tpdo, data, values, None)

    def _on_sync(self, frame: Frame, t_ns: int) -> None:
        node = self._node
        if not self._running or not node.connected:
            return
        for tpdo in self._synchronous:
            tpdo.sync_count += 1
            if tpdo.sync_count < tpdo.kind:
                continue
            tpdo.sync_count = 0
            data, values = tpdo.build(t_ns)
            if not self._due(tpdo, data):
                continue
            if tpdo.skip:
                tpdo.skip -= 1
                self._note_missed(tpdo, t_ns)
                continue
            node.after(self.response.draw(node.world.rng), self._queue, tpdo, data, values, t_ns)

    def _due(self, tpdo: Tpdo, data: bytes) -> bool:
        if tpdo.kind:
            return tpdo.allows_repeat(data)
        changed, tpdo.last_data = data != tpdo.last_data, data
        return changed

    def _note_missed(self, tpdo: Tpdo, t_ns: int) -> None:
        world = self._node.world
        index = len(world.truth.sync_ns) - 1
        missed = MissedTruth(self._node.node_id, tpdo.can_id, index, world.utc_ns(t_ns))
        world.truth.missed.append(missed)

    def _queue(self, tpdo: Tpdo, data: bytes, values: tuple[int, ...], sync_ns: int | None) -> None:
        now_ns = self._node.now_ns
        if not self._running or now_ns < tpdo.quiet_until_ns:
            return
        if tpdo.inhibit_ns and not tpdo.hasty:
            if now_ns < tpdo.not_before_ns:
                wait_ns = tpdo.not_before_ns - now_ns
                self._node.after(wait_ns, self._queue, tpdo, data, values, sync_ns)
                return
            tpdo.not_before_ns = now_ns + tpdo.inhibit_ns
        told = partial(self._sent, tpdo.can_id, sync_ns, now_ns, values)
        self._node.send(Frame(tpdo.can_id, data[: tpdo.cut_to]), told)

    def _sent(
        self,
        can_id: int,
        sync_ns: int | None,
        queued_ns: int,
        values: tuple[int, ...],
        t_ns: int,
    ) -> None:
        world = self._node.world
        world.truth.count("pdos", self._node.node_id)
        epoch_ns = world.epoch_ns
        due_ns = None if sync_ns is None else sync_ns + epoch_ns
        world.truth.pdos.append(
            PdoTruth(
                self._node.node_id, can_id, due_ns, queued_ns + epoch_ns, t_ns + epoch_ns, values
            )
        )

    def _on_remote(self, frame: Frame, t_ns: int) -> None:
        if frame.remote_dlc is None or not self.answers_remote or not self._node.awake:
            return
        tpdo = next(tpdo for tpdo in self._all if tpdo.can_id == frame.can_id)
        data, values = tpdo.build(t_ns)
        told = partial(self._sent, tpdo.can_id, None, t_ns, values)
        self._node.after(self.response.base_ns, self._node.send, Frame(tpdo.can_id, data), told)
