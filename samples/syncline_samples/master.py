"""The NMT master: boots and watches the nodes; and the SYNC producer."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from syncline_samples.bus import Frame
from syncline_samples.sdo_client import SdoClient, SdoJob, read
from syncline_samples.truth import BootUpTruth, CommandTruth
from syncline_samples.world import MS, World

START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82
IDENTITY = tuple(read(0x1018, sub) for sub in range(1, 5))


@dataclass(slots=True)
class NodePlan:
    """What the master does with a node once it has booted.

    Attributes:
        jobs: SDO transfers before the start.
        guard_ms: period of guard requests from the start on, 0 for none.
        boot_up_byte: 00h, or 7Fh of a device with that quirk.
        start: send NMT start when the transfers are through.
    """

    node_id: int
    jobs: tuple[SdoJob, ...] = ()
    guard_ms: int = 0
    boot_up_byte: int = 0x00
    start: bool = True


class Master:
    """Resets all nodes, then configures and starts each one that boots, each time it boots.

    Where a node boots with 7Fh, the first of them counts and the heartbeats after it do not.

    Attributes:
        guarding: guard requests are sent; False while the guarding task hangs (a scripted fault).
    """

    def __init__(
        self,
        world: World,
        plans: list[NodePlan],
        *,
        heartbeat_ms: int = 500,
        node_id: int = 127,
        dwell_ns: int = 30 * MS,
    ) -> None:
        self._world = world
        self._plans = {plan.node_id: plan for plan in plans}
        self._clients = {plan.node_id: SdoClient(world, plan.node_id) for plan in plans}
        self._heartbeat_ns = heartbeat_ms * MS
        self._node_id = node_id
        self._dwell_ns = dwell_ns
        self._booted: dict[int, int] = {}
        self._last_byte: dict[int, bytes] = {}
        self._guarded: set[int] = set()
        self._watching = False
        self._life = 0
        self.guarding = True
        for node in self._plans:
            world.bus.listen(0x700 + node, partial(self._on_error_control, node))

    def power_on(self) -> None:
        """Boot, send heartbeats, and reset the communication of all nodes."""
        self._world.bus.send(Frame(0x700 + self._node_id, b"\0"), self, self._booted_itself)
        if self._heartbeat_ns:
            self._at(self._heartbeat_ns, self._beat)
        self._at(100 * MS, self.command, RESET_COMMUNICATION, 0)

    def power_off(self) -> None:
        """Fall silent at once and forget everything."""
        self._life += 1
        self._world.bus.withdraw(self)
        self._watching = False
        self._booted.clear()
        self._last_byte.clear()
        self._guarded.clear()
        for client in self._clients.values():
            client.power_off()

    def sdo(self, node: int) -> SdoClient:
        """The client of a node."""
        if node not in self._clients:
            self._clients[node] = SdoClient(self._world, node)
        return self._clients[node]

    def plan(self, node: int) -> NodePlan:
        """What the master does with a node."""
        return self._plans[node]

    def adopt(self, node: int, number: int) -> None:
        """Treat another number as the node it was: the node id was changed."""
        if number not in self._plans:
            self._plans[number] = replace(self._plans[node], node_id=number)
            listener = partial(self._on_error_control, number)
            self._world.bus.listen(0x700 + number, listener)

    def command(self, specifier: int, node: int) -> None:
        """Send an NMT command; node 0 means all."""
        frame = Frame(0x000, bytes([specifier, node]))
        self._world.bus.send(frame, self, partial(self._commanded, specifier, node))

    def _commanded(self, specifier: int, node: int, t_ns: int) -> None:
        self._world.truth.commands.append(CommandTruth(self._world.utc_ns(t_ns), specifier, node))
        concerned = [node] if node else list(self._plans)
        if specifier in (RESET_NODE, RESET_COMMUNICATION):
            self._watching = True
            for each in concerned:
                self._last_byte.pop(each, None)
        elif specifier == PRE_OPERATIONAL:
            self._last_byte.update(dict.fromkeys(concerned, b"\x7f"))

    def send_raw(self, data: bytes) -> None:
        """Send any bytes as NMT command; two of them are one, whatever they say."""
        if len(data) == 2:
            self.command(*data)
        else:
            self._world.bus.send(Frame(0x000, data), self)

    def guard_once(self, node: int) -> None:
        """Send one guard request."""
        self._world.bus.send(Frame(0x700 + node, b"", 1), self, partial(self._asked, node))

    def _asked(self, node: int, t_ns: int) -> None:
        self._world.truth.count("guard_requests", node)

    def _at(self, delay_ns: int, action: Callable[..., None], *args: object) -> None:
        later_ns = self._world.simulation.now_ns + delay_ns
        self._world.simulation.at(later_ns, self._if_powered, self._life, action, args)

    def _if_powered(self, life: int, action: Callable[..., None], args: tuple[object, ...]) -> None:
        if life == self._life:
            action(*args)

    def _booted_itself(self, t_ns: int) -> None:
        boot_up = BootUpTruth(self._world.utc_ns(t_ns), self._node_id, 0x00, False)
        self._world.truth.boot_ups.append(boot_up)

    def _beat(self) -> None:
        self._world.bus.send(Frame(0x700 + self._node_id, b"\x05"), self, self._beaten)
        self._at(self._heartbeat_ns, self._beat)

    def _beaten(self, t_ns: int) -> None:
        self._world.truth.count("heartbeats", self._node_id)

    def _on_error_control(self, node: int, frame: Frame, t_ns: int) -> None:
        if frame.remote_dlc is not None or not self._watching:
            return
        before, self._last_byte[node] = self._last_byte.get(node), frame.data
        boot_up_byte = bytes([self._plans[node].boot_up_byte])
        if frame.data != boot_up_byte or (before == frame.data and boot_up_byte != b"\0"):
            return
        self._booted[node] = self._booted.get(node, 0) + 1
        self._at(self._dwell_ns, self._configure, node, self._booted[node])

    def _configure(self, node: int, boot: int) -> None:
        if boot == self._booted.get(node):
            self.sdo(node).drop()
            self.sdo(node).run(*self._plans[node].jobs, then=partial(self._start, node))

    def _start(self, node: int) -> None:
        plan = self._plans[node]
        if plan.start:
            self.command(START, node)
        if plan.guard_ms and node not in self._guarded:
            self._guarded.add(node)
            self._guard(node, plan.guard_ms * MS)

    def _guard(self, node: int, period_ns: int) -> None:
        if self.guarding:
            self.guard_once(node)
        self._at(period_ns, self._guard, node, period_ns)


class SyncProducer:
    """Sends SYNC on a fixed raster, each up to `jitter_ns` late.

    Attributes:
        counter_overflow: 1019h; 0 for a SYNC without data.
        can_id: identifier of the SYNC.
        skip: how many SYNCs will be left out (a scripted fault).
        running: False while nothing is sent.
    """

    def __init__(
        self, world: World, period_ns: int, *, jitter_ns: int = 5_000, counter_overflow: int = 0
    ) -> None:
        self._world = world
        self.period_ns = period_ns
        self.jitter_ns = jitter_ns
        self.counter_overflow = counter_overflow
        self.can_id = 0x080
        self.skip = 0
        self.running = True
        self._count = 0
        self._next_ns = 0

    def start(self) -> None:
        """Begin now."""
        self._next_ns = self._world.simulation.now_ns
        self._tick()

    def _tick(self) -> None:
        self._next_ns += self.period_ns
        self._world.simulation.at(self._next_ns, self._tick)
        if self.skip:
            self.skip -= 1
        elif self.running:
            late_ns = int(self.jitter_ns * self._world.rng.random())
            self._world.simulation.at(self._next_ns - self.period_ns + late_ns, self._send)

    def _send(self) -> None:
        data = b""
        if self.counter_overflow:
            data = bytes([self._count % self.counter_overflow + 1])
            self._count += 1
        self._world.bus.send(Frame(self.can_id, data), self, self._sent)

    def _sent(self, t_ns: int) -> None:
        self._world.truth.sync_ns.append(self._world.utc_ns(t_ns))
        self._world.truth.count("syncs", 0)
