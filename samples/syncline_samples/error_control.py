"""Heartbeat and node guarding of a simulated node (CiA 301 7.2.8)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from syncline_samples.bus import Frame
from syncline_samples.world import MS

if TYPE_CHECKING:
    from syncline_samples.node import Node

GUARD_LOST = 0x8130
_GUARD_ANSWER_NS = 120_000


class ErrorControl:
    """Sends heartbeats and answers guard requests on 700h + node; heartbeat wins over guarding.

    Attributes:
        empty_after_remote: None, or the state byte ("" or 00h) that heartbeats carry once a remote
            frame has hit a node with heartbeat on (LIR protocol manual 4.8.2), until a reset.
        guard_register: bits of 1001h that go with EMCY 8130h.
        always_answers: guard requests are answered without 100Ch and 100Dh.
        toggle_stuck: how many guard answers will not change their toggle bit (a scripted fault).
        unanswered: how many guard requests the node will overlook (a scripted fault).
        percent: actual heartbeat period in percent of 1017h (a scripted fault).
        jitter_ns: heartbeats are late by up to this much (a scripted fault).
        says: the state byte whatever the state is; None for the true one (a scripted fault).
        silent_beats: how many heartbeats the node will leave out (a scripted fault).
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.empty_after_remote: bytes | None = None
        self.guard_register = 0x11
        self.always_answers = False
        self.toggle_stuck = 0
        self.unanswered = 0
        self.percent = 100
        self.jitter_ns = 0
        self.silent_beats = 0
        self.says: int | None = None
        self._generation = 0
        self._spoiled = False
        self._toggle = 0
        self._requests = 0
        self.attach()
        for index in (0x1017, 0x100C, 0x100D):
            node.objects.on_write(index, 0, self._reconfigured)

    def attach(self) -> None:
        """Listen for guard requests to the node's number."""
        self._node.hear("guarding", 0x700 + self._node.node_id, self._on_error_control)

    @property
    def _period_ns(self) -> int:
        return self._node.objects.number(0x1017) * MS * self.percent // 100

    @property
    def _life_ns(self) -> int:
        objects = self._node.objects
        return objects.number(0x100C) * objects.number(0x100D) * MS

    def start(self) -> None:
        """Begin after a boot-up or with new parameters."""
        self._generation += 1
        self._spoiled = False
        self._toggle = 0
        if self._period_ns:
            self._node.after(self._period_ns, self._beat, self._generation)

    def restart_beat(self) -> None:
        """Count the heartbeat period from now on, as firmware with another timer does."""
        self._generation += 1
        if self._period_ns and self._node.awake:
            self._node.after(self._period_ns, self._beat, self._generation)

    def _reconfigured(self, value: int) -> None:
        """Begin anew with other times; what a remote frame has spoiled stays so until a reset."""
        spoiled = self._spoiled
        self.start()
        self._spoiled = spoiled

    def _beat(self, generation: int) -> None:
        if generation != self._generation:
            return
        node = self._node
        if self.silent_beats:
            self.silent_beats -= 1
        elif self.jitter_ns:
            late_ns = int(self.jitter_ns * node.world.rng.random())
            node.after(late_ns, self._send_beat, generation)
        else:
            self._send_beat(generation)
        node.after(self._period_ns, self._beat, generation)

    def _send_beat(self, generation: int) -> None:
        node = self._node
        if generation == self._generation:
            beaten = partial(self._beaten, self.says is not None)
            node.send(Frame(0x700 + node.node_id, self._state_byte()), beaten)

    def _beaten(self, wrong: bool, t_ns: int) -> None:
        self._node.world.truth.count("heartbeats", self._node.node_id)
        if self._spoiled and self.empty_after_remote is not None:
            self._node.world.truth.count("empty_heartbeats", self._node.node_id)
        elif wrong:
            self._node.world.truth.count("unknown_states", self._node.node_id)

    def _answered(self, stuck: bool, t_ns: int) -> None:
        truth, node_id = self._node.world.truth, self._node.node_id
        truth.count("guard_answers", node_id)
        if stuck:
            truth.count("toggle_errors", node_id)

    def _state_byte(self) -> bytes:
        from syncline_samples.node import STATE_BYTE

        if self._spoiled and self.empty_after_remote is not None:
            return self.empty_after_remote
        return bytes([STATE_BYTE[self._node.state] if self.says is None else self.says])

    def _on_error_control(self, frame: Frame, t_ns: int) -> None:
        if frame.remote_dlc is None or not self._node.awake:
            return
        if self._period_ns:
            self._spoiled = True
        elif self.unanswered:
            self.unanswered -= 1
            self._node.world.truth.count("unanswered_guards", self._node.node_id)
        elif self._life_ns or self.always_answers:
            self._node.after(_GUARD_ANSWER_NS, self._guarded)

    def _guarded(self) -> None:
        node = self._node
        stuck = self.toggle_stuck > 0 and self._requests > 0
        if stuck:
            self.toggle_stuck -= 1
            self._toggle ^= 1
        state = self._state_byte()[0] | self._toggle << 7
        answered = partial(self._answered, stuck)
        node.send(Frame(0x700 + node.node_id, bytes([state])), answered)
        self._toggle ^= 1
        self._requests += 1
        node.emcy.vanish(GUARD_LOST)
        if self._life_ns:
            node.after(self._life_ns, self._check_life, self._requests)

    def _check_life(self, requests: int) -> None:
        node = self._node
        still_guarding = self._life_ns and not self._period_ns
        if requests == self._requests and node.awake and still_guarding:
            node.emcy.occur(GUARD_LOST, self.guard_register)
            node.guard_lost()
