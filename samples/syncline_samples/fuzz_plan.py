"""A random script in the making: the machine, the clock, and the faults so far."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from random import Random

from syncline_samples.machine import LIR_MODELS, DeviceSpec, Fault
from syncline_samples.sdo_client import SdoJob, read, write_text


@dataclass(slots=True)
class Plan:
    """A script in the making.

    Attributes:
        now_s: when the next fault may happen.
        late: the recording begins on a machine at work: what was set up before is not in it.
    """

    random: Random
    devices: tuple[DeviceSpec, ...]
    sync_us: int
    now_s: float
    faults: list[Fault] = field(default_factory=list)
    late: bool = False

    def node(self, fits: Callable[[DeviceSpec], object] = lambda spec: True) -> DeviceSpec | None:
        """One of the devices to which a fault can happen."""
        fitting = [spec for spec in self.devices if fits(spec)]
        return self.random.choice(fitting) if fitting else None

    def had(self, kind: type[Fault], spec: DeviceSpec) -> bool:
        """Whether a fault of a kind has happened to a node before."""
        return any(
            isinstance(fault, kind) and getattr(fault, "node", None) == spec.node_id
            for fault in self.faults
        )

    def between(self, low: float, high: float) -> float:
        """A number of seconds, in steps of a millisecond."""
        return self.random.randint(round(low * 1000), round(high * 1000)) / 1000

    def wait(self, seconds: float) -> None:
        """Let nothing happen for a while."""
        self.now_s = round(self.now_s + seconds, 4)

    def add(self, fault: Fault, busy_s: float) -> None:
        """Let a fault happen now; the next one comes after it is over."""
        self.faults.append(fault)
        self.wait(busy_s)


def is_lir(spec: DeviceSpec) -> bool:
    """Whether a device is an encoder of SKB IS."""
    return spec.device in LIR_MODELS


def period_ms(spec: DeviceSpec) -> int:
    """Period of the error control of a node, by heartbeat or by guarding."""
    return spec.heartbeat_ms or spec.guard_ms


def beats(spec: DeviceSpec) -> bool:
    """Whether a node sends heartbeats."""
    return spec.heartbeat_ms > 0


def guarded(spec: DeviceSpec) -> bool:
    """Whether the master guards a node."""
    return spec.guard_ms > 0


def restart_s(spec: DeviceSpec) -> float:
    """From a reset to the start by the master."""
    return 5.0 if is_lir(spec) else 1.0


def some(random: Random, jobs: Sequence[SdoJob]) -> tuple[SdoJob, ...]:
    """Up to six of these transfers."""
    return tuple(random.sample(list(jobs), random.randint(0, min(6, len(jobs)))))


def readable(spec: DeviceSpec) -> tuple[SdoJob, ...]:
    """Transfers that the device takes."""
    jobs = [read(0x1000), read(0x1001), read(0x1008), read(0x1018, 1), read(0x1018, 4)]
    jobs += [read(0x1003), read(0x1800, 1), read(0x1800, 2), read(0x1800, 5), read(0x1A00, 1)]
    if spec.device != "io":
        jobs += [read(0x6000), read(0x1801, 2), read(0x1801, 5)]
    if spec.device in (*LIR_MODELS, "haomiao-38"):
        jobs += [read(0x6001), read(0x6502), read(0x6004)]
    if spec.device == "jn2100":
        jobs += [read(0x2040), read(0x2044), read(0x6010), read(0x1802, 2), read(0x1200, 1)]
    if spec.device == "io":
        jobs += [read(0x2F01), read(0x2F01, block=True), write_text(0x2F01, 0, b"moved to C")]
    return tuple(jobs)
