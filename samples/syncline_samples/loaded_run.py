"""A loaded bus at work: who asks for what when; arbitration and the recorder do the rest."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from random import Random
from typing import Any

from syncline_samples.bus import Bus, Frame
from syncline_samples.loaded import MASTER, LoadedBus, LoadedNode, LoadedPdo, SdoBurst
from syncline_samples.loaded_truth import LoadedTruth, SentFrame, SentPdo, Unsent
from syncline_samples.objects import Object, ObjectDictionary
from syncline_samples.recorder import Recorder
from syncline_samples.sdo_client import SdoClient, SdoJob, read, write
from syncline_samples.sdo_server import SdoServer
from syncline_samples.simulation import Simulation
from syncline_samples.truth import Truth
from syncline_samples.wire import INTERMISSION_BITS, wire_bits
from syncline_samples.world import MS, World
from syncline_schemas.batch import FrameBatch, Gap

EPOCH_NS = 1_790_000_000_000_000_000
"""2026-09-21 14:13:20 UTC: time 0 of the runs."""
SECOND_NS = 1000 * MS
SYNC_ID = 0x080
BURST_INDEX = 0x2F00
_START, _PRE_OPERATIONAL, _OPERATIONAL = 0x01, 0x7F, 0x05
_FLOOD_NS = 100_000
_BOOT_NS = 10 * MS
_MASTER_HEARTBEAT_MS = 200
_PAYLOADS = (b"\0", b"\xff", b"\x55")
"""Bytes that make many stuff bits, or none."""


class _Port:
    """The CAN controller of a node; `ready` and `asked` are those of `SentPdo`."""

    def __init__(self, bus: Bus, *, in_turn: bool) -> None:
        self._bus = bus
        self._in_turn = in_turn
        self._waiting: deque[tuple[Frame, Callable[[int, int], None] | None]] = deque()

    def send(self, frame: Frame, sent: Callable[[int, int], None] | None = None) -> None:
        """Ask for a frame; `sent` takes when it began to take part, and its end [ns]."""
        self._waiting.append((frame, sent))
        if not self._in_turn or len(self._waiting) == 1:
            self._ask()

    def _ask(self) -> None:
        frame, sent = self._waiting[0] if self._in_turn else self._waiting.popleft()
        self._bus.send(frame, self, partial(self._sent, self._bus.simulation.now_ns, sent))

    def _sent(self, asked_ns: int, sent: Callable[[int, int], None] | None, end_ns: int) -> None:
        if self._in_turn:
            self._waiting.popleft()
        if sent is not None:
            sent(asked_ns, end_ns)
        if self._in_turn and self._waiting:
            self._ask()


class _Witness:
    """Notes what the wire carries, and hands it on to the recorder."""

    def __init__(
        self, recorder: Recorder, recorded: Truth, truth: LoadedTruth, bit_ns: int
    ) -> None:
        self._recorder = recorder
        self._recorded = recorded
        self._truth = truth
        self._bit_ns = bit_ns

    def frame(self, t_ns: int, frame: Frame) -> None:
        """Take the end of a frame."""
        seq = self._recorded.frames if self._recorded.recording else None
        self._recorder.frame(t_ns, frame)
        bits = wire_bits(*frame)
        start_ns = t_ns - (bits - INTERMISSION_BITS) * self._bit_ns
        self._truth.frames.append(
            SentFrame(seq, frame.can_id, start_ns + EPOCH_NS, t_ns + EPOCH_NS, bits)
        )

    def error(self, t_ns: int, data: bytes) -> None:
        """Take an error frame."""
        self._recorder.error(t_ns, data)


class _Sender:
    """Sends one PDO."""

    def __init__(self, run: "LoadedRun", plan: LoadedPdo, port: _Port) -> None:
        self._run = run
        self.plan = plan
        self._port = port
        self._until_due = run.random.randrange(plan.kind) if plan.synchronous else 0
        self._under_way = 0

    def on_sync(self, sync_ns: int, number: int) -> None:
        """A SYNC has passed."""
        plan, random = self.plan, self._run.random
        if self._until_due:
            self._until_due -= 1
            return
        self._until_due = plan.kind - 1
        self._run.truth.due.setdefault(plan.can_id, []).append(number)
        if random.random() < plan.skipped:
            self._unsent(sync_ns, scripted=True)
            return
        delay_ns = plan.delay.draw(random)
        if random.random() < plan.slow:
            delay_ns += random.randrange(plan.slow_ns)
        self._run.after(delay_ns, self._ask, sync_ns, number)

    def start(self) -> None:
        """Begin to send by timer, or at random times."""
        self._run.after(int(self.plan.period_ns * self._run.random.random()), self._tick)

    def _tick(self) -> None:
        period_ns = self.plan.period_ns
        if not self.plan.cyclic:
            period_ns = max(int(self._run.random.expovariate(1.0) * period_ns), 1000)
        self._run.after(period_ns, self._tick)
        self._ask(None, None)

    def event(self) -> None:
        """Something happened that is worth a PDO."""
        self._ask(None, None)

    def _ask(self, sync_ns: int | None, number: int | None) -> None:
        if self._under_way and not self.plan.waits:
            self._unsent(sync_ns, scripted=False)
            return
        self._under_way += 1
        now_ns = self._run.simulation.now_ns
        frame = Frame(self.plan.can_id, self._data())
        self._port.send(frame, partial(self._sent, sync_ns, number, now_ns))

    def _data(self) -> bytes:
        random, length = self._run.random, self.plan.length
        if random.random() < 0.2:
            return random.choice(_PAYLOADS) * length
        return random.randbytes(length)

    def _unsent(self, sync_ns: int | None, *, scripted: bool) -> None:
        due_ns = None if sync_ns is None else sync_ns + EPOCH_NS
        self._run.truth.unsent.append(Unsent(self.plan.can_id, due_ns, scripted))

    def _sent(
        self, sync_ns: int | None, number: int | None, ready_ns: int, asked_ns: int, end_ns: int
    ) -> None:
        self._under_way -= 1
        last = self._run.truth.frames[-1]
        self._run.truth.pdos.append(
            SentPdo(
                last.seq,
                self.plan.node,
                self.plan.can_id,
                None if sync_ns is None else sync_ns + EPOCH_NS,
                number,
                ready_ns + EPOCH_NS,
                asked_ns + EPOCH_NS,
                last.start_ns,
                last.end_ns,
            )
        )


class _Server:
    """The SDO server of a node."""

    def __init__(self, run: "LoadedRun", node: LoadedNode, port: _Port) -> None:
        self._run = run
        self._node = node
        self._port = port
        sizes = {burst.size for burst in run.plan.bursts if burst.node == node.node_id}
        settings = run.plan.set_up(node)
        self._server = SdoServer(
            ObjectDictionary(
                [Object(BURST_INDEX, sub, "str", "ro", bytes(n)) for sub, n in enumerate(sizes)]
                + [
                    Object(index, sub, f"u{8 * width}", "rw", 0)
                    for index, sub, _, width in settings
                ]
            ),
            block=True,
        )
        run.bus.listen(0x600 + node.node_id, self._requested)

    def _requested(self, frame: Frame, t_ns: int) -> None:
        self._run.after(self._node.answer.draw(self._run.random), self._answer, frame.data)

    def _answer(self, request: bytes) -> None:
        for answer in self._server.answer(request):
            self._port.send(Frame(0x580 + self._node.node_id, answer))


@dataclass(slots=True)
class LoadedRun:
    """One run of a plan: what the recorder delivers, and the truth."""

    plan: LoadedBus
    batches: list[FrameBatch | Gap] = field(default_factory=list)
    truth: LoadedTruth = field(default_factory=LoadedTruth)
    simulation: Simulation = field(default_factory=Simulation)
    random: Random = field(init=False)
    bus: Bus = field(init=False)
    _recorder: Recorder = field(init=False)
    _senders: list[_Sender] = field(init=False)
    _ports: dict[int, _Port] = field(init=False)
    _clients: dict[int, SdoClient] = field(default_factory=dict)
    _not_ready: int = 0
    _state: int = _PRE_OPERATIONAL
    _counter: int = 0

    def __post_init__(self) -> None:
        plan, recorded = self.plan, Truth()
        self.random = Random(plan.seed)
        step_ns = plan.stamp_resolution_ns
        self._recorder = Recorder(recorded, self.random, EPOCH_NS, step_ns)
        bit_ns = 1_000_000_000 // plan.bitrate
        witness = _Witness(self._recorder, recorded, self.truth, bit_ns)
        self.bus = Bus(self.simulation, plan.bitrate, witness)
        self._ports = {
            node.node_id: _Port(self.bus, in_turn=node.in_turn) for node in plan.nodes
        } | {MASTER: _Port(self.bus, in_turn=plan.master_in_turn)}
        self._senders = [
            _Sender(self, pdo, self._ports[MASTER if pdo.sent_by_master else pdo.node])
            for pdo in plan.pdos
        ]
        world = World(self.simulation, self.bus, recorded, self.random, EPOCH_NS)
        for node in plan.nodes:
            _Server(self, node, self._ports[node.node_id])
            self._clients[node.node_id] = SdoClient(world, node.node_id, pause_ns=0)
        self._begin()

    def after(self, delay_ns: int, action: Callable[..., None], *args: Any) -> None:
        """Do something later."""
        self.simulation.at(self.simulation.now_ns + delay_ns, action, *args)

    def _begin(self) -> None:
        for node in self.plan.nodes if self.plan.told == "sdo" else ():
            self._not_ready += 1
            booted = partial(self._booted, node)
            self._ports[node.node_id].send(Frame(0x700 + node.node_id, b"\0"), booted)
        beats = {node.node_id: node.heartbeat_ms for node in self.plan.nodes}
        for node_id, period_ms in (*beats.items(), (MASTER, _MASTER_HEARTBEAT_MS)):
            first_ns = int(period_ms * MS * self.random.random()) + _BOOT_NS
            self.after(first_ns, self._beat, node_id, period_ms)
        if self.plan.told != "sdo":
            self._state = _OPERATIONAL
            self._work()

    def _booted(self, node: LoadedNode, asked_ns: int, end_ns: int) -> None:
        settings = self.plan.set_up(node)
        jobs = [write(index, sub, value, width) for index, sub, value, width in settings]
        self._clients[node.node_id].run(*jobs, then=self._set_up)

    def _set_up(self) -> None:
        self._not_ready -= 1
        if not self._not_ready:
            self._ports[MASTER].send(Frame(0x000, bytes([_START, 0])), self._started)

    def _started(self, asked_ns: int, end_ns: int) -> None:
        self._state = _OPERATIONAL
        self.after(20 * MS, self._work)

    def _work(self) -> None:
        self.truth.started_ns = self.simulation.now_ns + EPOCH_NS
        self._sync(self.simulation.now_ns)
        for sender in self._senders:
            if not sender.plan.synchronous:
                sender.start()
        for burst in self.plan.bursts:
            self._burst(burst)
        for at_s in self.plan.floods_s:
            self.simulation.at(self._ns(at_s), self._flood)
        for at_s, node in self.plan.errors_s:
            self.simulation.at(self._ns(at_s), self._destroy, node)
        if self.plan.gap_s is not None:
            start_ns, end_ns = (self._ns(at_s) for at_s in self.plan.gap_s)
            self.simulation.at(start_ns, self._recorder.go_blind, start_ns)
            self.simulation.at(end_ns, self._recorder.see_again, end_ns)
            self.truth.blind.append((start_ns + EPOCH_NS, end_ns + EPOCH_NS))

    def _ns(self, at_s: float) -> int:
        """Virtual time of a moment of the plan, which counts from the start of work."""
        return self.truth.started_ns - EPOCH_NS + round(at_s * SECOND_NS)

    def _beat(self, node: int, period_ms: int) -> None:
        self._ports[node].send(Frame(0x700 + node, bytes([self._state])))
        self.after(period_ms * MS, self._beat, node, period_ms)

    def _sync(self, due_ns: int) -> None:
        plan = self.plan
        self._counter = self._counter % plan.sync_counter + 1 if plan.sync_counter else 0
        data = bytes([self._counter]) if plan.sync_counter else b""
        self._ports[MASTER].send(Frame(SYNC_ID, data), self._synced)
        next_ns = due_ns + 1000 * plan.sync_us
        late_ns = self.random.randrange(1000 * plan.sync_jitter_us + 1)
        self.simulation.at(max(next_ns + late_ns, self.simulation.now_ns), self._sync, next_ns)

    def _synced(self, asked_ns: int, end_ns: int) -> None:
        number = len(self.truth.syncs)
        self.truth.syncs.append(self.truth.frames[-1])
        for sender in self._senders:
            if sender.plan.synchronous:
                sender.on_sync(end_ns, number)

    def _burst(self, burst: SdoBurst) -> None:
        sizes = {each.size for each in self.plan.bursts if each.node == burst.node}
        job: SdoJob = read(BURST_INDEX, list(sizes).index(burst.size), block=burst.block)
        next_ns = self.simulation.now_ns + burst.every_ns
        self._clients[burst.node].run(job, then=partial(self._burst_later, burst, next_ns))

    def _burst_later(self, burst: SdoBurst, next_ns: int) -> None:
        self.simulation.at(max(next_ns, self.simulation.now_ns), self._burst, burst)

    def _flood(self) -> None:
        for sender in self._senders:
            if not sender.plan.synchronous and not sender.plan.cyclic:
                self.after(self.random.randrange(_FLOOD_NS), sender.event)

    def _destroy(self, node: int) -> None:
        self.bus.break_transmitter(self._ports[node], 1, lambda: None)

    def finish(self) -> "LoadedRun":
        """Run to the end; the batches are in memory then."""
        while not self.truth.started_ns:
            self.simulation.run_until(self.simulation.now_ns + 10 * MS)
        end_ns = self._ns(self.plan.seconds)
        self.simulation.run_until(end_ns)
        self._recorder.see_again(end_ns)
        self.batches = self._recorder.take()
        return self


def run_loaded(plan: LoadedBus) -> LoadedRun:
    """The run of a plan from its start to its end."""
    return LoadedRun(plan).finish()
