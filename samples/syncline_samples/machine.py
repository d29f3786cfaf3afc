"""A simulated machine: devices on one bus, a master, a SYNC producer, a recorder."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from random import Random
from typing import Any, Protocol

from syncline_samples.bus import Bus, Frame
from syncline_samples.devices import Haomiao38, IoModule, Jn2100, Lir
from syncline_samples.master import Master, NodePlan, SyncProducer
from syncline_samples.motion import Shaft, Tilt
from syncline_samples.node import Node
from syncline_samples.recorder import Recorder
from syncline_samples.sdo_client import SdoClient, SdoJob
from syncline_samples.simulation import Simulation
from syncline_samples.truth import ExpectedFinding, Truth
from syncline_samples.world import MS, Delay, World
from syncline_schemas.batch import FrameBatch, Gap

EPOCH_NS = 1_772_431_200_000_000_000
"""2026-03-02 06:00:00 UTC: time 0 of the scenarios."""
SECOND_NS = 1000 * MS
_SLICE_NS = 500 * MS
_BEFORE_S, _AFTER_S = 1.0, 5.0
"""How far a finding may lie from its cause."""
LIR_MODELS = ("lir-da158", "lir-da158a", "lir-ma158k", "lir-918")


@dataclass(frozen=True, slots=True)
class DeviceSpec:
    """One node of the machine.

    Attributes:
        device: name as in `syncline devices`, or `io` for the plain I/O module.
        motion: what the sensor sits on; None for a shaft at rest or a level platform.
        stored_heartbeat_ms: 1017h in the EEPROM before the run.
        jobs: SDO transfers of the master after each boot-up.
        guard_ms, life_factor: node guarding by the master, 0 for none.
        response: from a SYNC to the PDO, None for the device's usual time.
        quiet_after_boot_up: the 4 s of silence that a LIR keeps after an NMT reset come after its
            boot-up frame; the manual does not say.
        empty_heartbeat: state byte of a new LIR once a remote frame has hit its heartbeat: 00h, or
            none at all.
        sizeless: SDO answers do not state the size.
    """

    node_id: int
    device: str
    name: str
    motion: Shaft | Tilt | None = None
    stored_heartbeat_ms: int = 0
    heartbeat_ms: int = 0
    guard_ms: int = 0
    life_factor: int = 3
    jobs: tuple[SdoJob, ...] = ()
    drift_ppm: int = 0
    response: Delay | None = None
    quiet_after_boot_up: bool = False
    empty_heartbeat: bytes = b"\0"
    sizeless: bool = False


class Fault(Protocol):
    """Something that happens on the machine at a time, and what an analyzer must say of it."""

    @property
    def at_s(self) -> float:
        """When it happens, from the start of the run."""
        ...

    def arm(self, machine: "Machine") -> None:
        """Schedule what happens and note the findings to expect."""
        ...


@dataclass(frozen=True, slots=True)
class Scenario:
    """A machine and what happens on it; `run` gives frames and truth.

    Attributes:
        sync_us: SYNC period, 0 for no SYNC producer.
        sync_jitter_us: each SYNC is up to this much late.
        sync_counter: 1019h of the producer, 0 for SYNCs without a counter.
        stamp_jitter_ns, stamp_resolution_ns: of the recorder's stamps.
        remote_as_data: the recorder stores remote frames as empty data frames.
    """

    name: str
    seconds: float
    devices: tuple[DeviceSpec, ...]
    faults: tuple[Fault, ...] = ()
    bitrate: int = 500_000
    bus_name: str = "can0"
    sync_us: int = 20_000
    sync_jitter_us: int = 5
    sync_counter: int = 0
    rpdo_node: int = 0
    seed: int = 1
    epoch_ns: int = EPOCH_NS
    stamp_jitter_ns: int = 0
    stamp_resolution_ns: int = 1
    remote_as_data: bool = False

    def start(self) -> "Run":
        """A run that advances while its stream is read."""
        return Run(self)

    def run(self) -> "Run":
        """A run that has reached its end; its batches are in memory."""
        run = self.start()
        run.batches = list(run.stream())
        return run

    @property
    def description_toml(self) -> str:
        """The bus description that a user of this machine would write."""
        lines = [f"[bus.{self.bus_name}]", f"bitrate = {self.bitrate}"]
        for spec in self.devices:
            lines += ["", f"[bus.{self.bus_name}.node.{spec.node_id}]", f'name = "{spec.name}"']
            if spec.device != "io":
                lines.append(f'device = "{spec.device}"')
        return "\n".join(lines) + "\n"


class Machine:
    """The parts of a running scenario, for faults to act on."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.truth = Truth()
        rng = Random(scenario.seed)
        self.simulation = Simulation()
        self.recorder = Recorder(
            self.truth,
            rng,
            scenario.epoch_ns,
            scenario.stamp_resolution_ns,
            scenario.stamp_jitter_ns,
            scenario.remote_as_data,
        )
        bus = Bus(self.simulation, scenario.bitrate, self.recorder)
        self.world = World(self.simulation, bus, self.truth, rng, scenario.epoch_ns)
        self.nodes = {spec.node_id: self.build(spec) for spec in scenario.devices}
        self.master = Master(self.world, [_plan(spec) for spec in scenario.devices])
        self._tools: dict[int, SdoClient] = {}
        self.sync = SyncProducer(
            self.world,
            scenario.sync_us * 1000,
            jitter_ns=scenario.sync_jitter_us * 1000,
            counter_overflow=scenario.sync_counter,
        )
        self._power_on()
        for fault in scenario.faults:
            if fault.at_s < scenario.seconds:
                fault.arm(self)

    def build(self, spec: DeviceSpec) -> Node:
        """A device of a kind, not yet powered."""
        node = _device(self.world, spec)
        node.quiet_after_boot_up = spec.quiet_after_boot_up
        node.sdo.sizeless = spec.sizeless
        if node.error_control.empty_after_remote is not None:
            node.error_control.empty_after_remote = spec.empty_heartbeat
        if spec.response is not None:
            node.tpdos.response = spec.response
        if spec.stored_heartbeat_ms:
            node.objects.commission(0x1017, 0, spec.stored_heartbeat_ms)
        return node

    def _power_on(self) -> None:
        for number, node in enumerate(self.nodes.values()):
            self.simulation.at((50 + 7 * number) * MS, node.power_on)
        self.simulation.at(900 * MS, self.master.power_on)
        if self.scenario.sync_us:
            self.simulation.at(1500 * MS, self.sync.start)
        self.outputs_on = True
        self.outputs_id = 0x200 + self.scenario.rpdo_node
        if self.scenario.rpdo_node:
            self.simulation.at(2 * SECOND_NS, self._outputs, 0)

    def _outputs(self, step: int) -> None:
        frame = Frame(self.outputs_id, bytes([1 << step % 8]))
        if self.outputs_on:
            self.world.bus.send(frame, self)
        self.simulation.at(self.simulation.now_ns + 200 * MS, self._outputs, step + 1)

    def spec(self, node: int) -> DeviceSpec:
        """How a node was asked for."""
        return next(spec for spec in self.scenario.devices if spec.node_id == node)

    def learn_boot_up(self, node: int) -> None:
        """Let the master know the boot-up byte of a node that has just reloaded its EEPROM."""
        device = self.nodes[node]
        self.master.plan(device.node_id).boot_up_byte = device.boot_up_byte()

    def tool(self, node: int) -> SdoClient:
        """A second SDO client of a node, beside the master's, on the same channel."""
        if node not in self._tools:
            self._tools[node] = SdoClient(self.world, node)
        return self._tools[node]

    def at(self, at_s: float, action: Callable[..., None], *args: Any) -> None:
        """Do something at a time of the run [s]."""
        self.simulation.at(round(at_s * SECOND_NS), action, *args)

    def after(self, delay_s: float, action: Callable[..., None], *args: Any) -> None:
        """Do something a while from now [s]."""
        self.simulation.at(self.simulation.now_ns + round(delay_s * SECOND_NS), action, *args)

    def expect(
        self,
        finding: str,
        node: int | None,
        at_s: float,
        for_s: float = 0.0,
        *,
        required: bool = True,
        what: str = "",
        or_as: tuple[str, ...] = (),
    ) -> None:
        """Note a finding that the analyzer must or may report around a time of the run."""
        start_ns = self.world.utc_ns(round((at_s - _BEFORE_S) * SECOND_NS))
        end_ns = self.world.utc_ns(round((at_s + for_s + _AFTER_S) * SECOND_NS))
        at_ns = self.world.utc_ns(round(at_s * SECOND_NS))
        self.truth.findings.append(
            ExpectedFinding(finding, node, at_ns, start_ns, end_ns, required, what, or_as)
        )

    def finish(self, end_ns: int) -> None:
        """Close what the truth has open."""
        for node in self.nodes.values():
            node.finish()
        self.truth.settle()
        bus = self.world.bus
        self.truth.bus_load = bus.busy_bits * bus.bit_ns / end_ns


def _device(world: World, spec: DeviceSpec) -> Node:
    motion = spec.motion
    if spec.device in LIR_MODELS:
        shaft = motion if isinstance(motion, Shaft) else Shaft((0, 0), (1, 0))
        serial = 0x14000000 | spec.node_id
        return Lir(world, spec.node_id, spec.device, shaft, serial=serial, drift_ppm=spec.drift_ppm)
    if spec.device == "haomiao-38":
        shaft = motion if isinstance(motion, Shaft) else Shaft((0, 0), (1, 0))
        return Haomiao38(world, spec.node_id, shaft, drift_ppm=spec.drift_ppm)
    if spec.device == "jn2100":
        tilt = motion if isinstance(motion, Tilt) else Tilt((0, 0, 0), (1, 0, 0))
        return Jn2100(world, spec.node_id, tilt, drift_ppm=spec.drift_ppm)
    return IoModule(world, spec.node_id)


def _plan(spec: DeviceSpec) -> NodePlan:
    boots_with_7f = spec.stored_heartbeat_ms and spec.device in LIR_MODELS[1:]
    return NodePlan(spec.node_id, spec.jobs, spec.guard_ms, 0x7F if boots_with_7f else 0x00)


@dataclass(slots=True)
class Run:
    """One run of a scenario: what the recorder delivers, and the truth.

    Attributes:
        batches: what the recorder delivered, when the run was made by `Scenario.run`.
    """

    scenario: Scenario
    batches: list[FrameBatch | Gap] = field(default_factory=list)
    machine: Machine = field(init=False)

    def __post_init__(self) -> None:
        self.machine = Machine(self.scenario)

    @property
    def truth(self) -> Truth:
        """What really happened; complete at the end of the stream."""
        return self.machine.truth

    @property
    def bus_names(self) -> list[str]:
        """Interface names by bus number."""
        return [self.scenario.bus_name]

    @property
    def bitrate(self) -> int:
        """Bit rate of the bus [bit/s]."""
        return self.scenario.bitrate

    @property
    def description_toml(self) -> str:
        """The bus description of this machine."""
        return self.scenario.description_toml

    def stream(self) -> Iterator[FrameBatch | Gap]:
        """Advance to the end and give batches and gaps as they come; works once."""
        end_ns = round(self.scenario.seconds * SECOND_NS)
        simulation, recorder = self.machine.simulation, self.machine.recorder
        while simulation.now_ns < end_ns:
            simulation.run_until(min(end_ns, simulation.now_ns + _SLICE_NS))
            if simulation.now_ns == end_ns:
                recorder.see_again(end_ns)
                self.machine.finish(end_ns)
            yield from recorder.take()
