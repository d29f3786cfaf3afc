"""Random buses with traffic from almost nothing to almost more than the wire carries.

What is sent comes from a plan that a `random.Random` draws, so that a seed is a bus. Nothing goes
wrong on these buses unless the plan says so: devices take their time, frames wait for one another.
"""

from dataclasses import dataclass
from random import Random
from typing import Literal

from syncline_samples.world import MS, Delay

BITRATES = (125_000, 250_000, 500_000, 1_000_000)
LOADS = (0.2, 0.95)
SYNCS_US = (
    *(1000, 2000, 2500, 4000, 5000, 8000, 10_000, 12_500),
    *(20_000, 25_000, 40_000, 50_000, 80_000, 100_000, 200_000),
)
RESOLUTIONS_NS = (1, 1, 1000, 1000, 10_000, 1_000_000)
HEARTBEATS_MS = (50, 100, 200, 500, 1000)
PDO_BASES = (0x180, 0x280, 0x380, 0x480)
RPDO_BASES = (0x200, 0x300, 0x400, 0x500)
MASTER = 127
_FRAME_BITS = 49
"""Bits of a frame without data, with a usual number of stuff bits."""
_BYTE_BITS = 8.3
_FRAMES = (2500, 6000)
_LONGEST_S = 40.0

Told = Literal["sdo", "description", "nothing"]


@dataclass(frozen=True, slots=True)
class LoadedPdo:
    """A PDO, and when its sender asks for it.

    Attributes:
        number: n of TPDOn or RPDOn.
        kind: transmission type: 1..240, or FEh/FFh.
        delay: from the end of the SYNC to the request to send.
        slow: share of the answers that take up to `slow_ns` longer.
        skipped: share of the due answers that the sender forgets.
        period_ns: of other types: the event timer, or the mean time between two events.
        cyclic: sent by the event timer, else by events at random times.
        waits: a frame that is asked for while the one before is still waiting waits behind it,
            else it is not sent at all.
    """

    node: int
    can_id: int
    number: int
    length: int
    kind: int
    delay: Delay
    slow: float = 0.0
    slow_ns: int = 0
    skipped: float = 0.0
    period_ns: int = 0
    cyclic: bool = False
    waits: bool = False

    @property
    def synchronous(self) -> bool:
        """Whether it answers SYNCs."""
        return self.kind <= 0xF0

    @property
    def sent_by_master(self) -> bool:
        """Whether it is an RPDO of its node."""
        return self.can_id >> 7 & 1 == 0


@dataclass(frozen=True, slots=True)
class LoadedNode:
    """A node.

    Attributes:
        in_turn: its controller takes part in arbitration with one frame after the other, in the
            order in which they were asked for; else with all of them at once.
        answer: from an SDO request to the answer.
        window_us: 1007h, 0 for none.
    """

    node_id: int
    heartbeat_ms: int
    answer: Delay
    in_turn: bool = False
    window_us: int = 0


@dataclass(frozen=True, slots=True)
class SdoBurst:
    """Reads of an object of `size` bytes again and again."""

    node: int
    size: int
    block: bool
    every_ns: int


@dataclass(frozen=True, slots=True)
class LoadedBus:
    """A bus at work; `loaded_run` lets it run.

    Attributes:
        load: what the plan aims at; the true one is in the frames.
        master_in_turn: the same as a node's `in_turn`, for SYNC and RPDOs.
        told: how an analyzer knows the settings: written by SDO before the start, from the bus
            description, or not at all. Unless they are written, the bus is at work from the start.
        floods_s: when all events happen at once.
        gap_s: from when to when the recorder is blind.
        errors_s: when a frame of the node with this number is destroyed on the wire.
    """

    name: str
    seed: int
    seconds: float
    bitrate: int
    load: float
    sync_us: int
    sync_jitter_us: int
    sync_counter: int
    nodes: tuple[LoadedNode, ...]
    pdos: tuple[LoadedPdo, ...]
    bursts: tuple[SdoBurst, ...]
    master_in_turn: bool = False
    told: Told = "nothing"
    floods_s: tuple[float, ...] = ()
    gap_s: tuple[float, float] | None = None
    errors_s: tuple[tuple[float, int], ...] = ()
    stamp_resolution_ns: int = 1

    @property
    def description_toml(self) -> str:
        """The bus description of a user, with what it tells of the PDOs."""
        lines = [f"[bus.{self.name}]"]
        for node in self.nodes if self.told == "description" else ():
            lines += [f"[bus.{self.name}.node.{node.node_id}.objects]"]
            lines += [
                f'"{index:04X}:{sub}" = {value}' for index, sub, value, _ in self.set_up(node)
            ]
        return "\n".join(lines) + "\n"

    def set_up(self, node: LoadedNode) -> list[tuple[int, int, int, int]]:
        """(index, sub, value, width) of the settings of a node."""
        found = [(0x1007, 0, node.window_us, 4)] if node.window_us else []
        for pdo in self.pdos:
            if pdo.node != node.node_id:
                continue
            index = (0x13FF if pdo.sent_by_master else 0x17FF) + pdo.number
            found += [(index, 1, pdo.can_id, 4), (index, 2, pdo.kind, 1)]
            if pdo.cyclic and not pdo.sent_by_master:
                found.append((index, 5, pdo.period_ns // MS, 2))
        return found


def frame_bits(length: int) -> float:
    """Bits of a usual frame with so many bytes."""
    return _FRAME_BITS + _BYTE_BITS * length


def random_loaded_bus(random: Random, seed: int, *, load: float | None = None) -> LoadedBus:
    """A bus with 2 to 20 nodes and a load between 20 and 95 %."""
    bitrate = random.choice(BITRATES)
    load = random.uniform(*LOADS) if load is None else load
    nodes = _nodes(random)
    identifiers = [(base + node.node_id, node) for base in PDO_BASES for node in nodes]
    answers = _synchronous(random, identifiers, RPDO_BASES, nodes)
    per_sync = frame_bits(0) + sum(frame_bits(pdo.length) / pdo.kind for pdo in answers)
    share = random.uniform(0.15, 0.85) * load
    wanted_us = 1e6 * per_sync / (share * bitrate)
    sync_us = next((us for us in SYNCS_US if us >= wanted_us), SYNCS_US[-1])
    answers = [_delayed(random, pdo, sync_us) for pdo in answers]
    left = load - 1e6 * per_sync / sync_us / bitrate
    left -= sum(1000 / node.heartbeat_ms * frame_bits(1) for node in nodes) / bitrate
    taken = {pdo.can_id for pdo in answers}
    free = [(can_id, node) for can_id, node in identifiers if can_id not in taken]
    others, bursts = _others(random, max(left, 0.0) * bitrate, free, nodes, taken)
    pdos = tuple(answers + others)
    rate = load * bitrate / 110
    seconds = min(max(random.uniform(*_FRAMES) / rate, 60e-6 * sync_us), _LONGEST_S)
    rounded_s = round(seconds, 3)
    return LoadedBus(
        "can0",
        seed,
        rounded_s,
        bitrate,
        load,
        sync_us,
        random.choice((0, 5, 50)),
        random.choice((0, 0, 0, 10, 240)),
        tuple(nodes),
        pdos,
        bursts,
        master_in_turn=random.random() < 0.2,
        told=random.choice(("sdo", "description", "nothing")),
        floods_s=_moments(random, rounded_s, random.choice((0, 0, 2, 5))),
        gap_s=_gap(random, rounded_s) if random.random() < 0.15 else None,
        errors_s=_errors(random, rounded_s, nodes) if random.random() < 0.2 else (),
        stamp_resolution_ns=random.choice(RESOLUTIONS_NS),
    )


def _nodes(random: Random) -> list[LoadedNode]:
    in_turn = random.choice((0.0, 0.0, 0.3))
    return [
        LoadedNode(
            node_id,
            random.choice(HEARTBEATS_MS),
            Delay(random.randint(50_000, 500_000), random.randint(0, 2_000_000)),
            random.random() < in_turn,
            random.choice((0, 0, 500, 1000, 3000)),
        )
        for node_id in sorted(random.sample(range(1, MASTER), random.randint(2, 20)))
    ]


def _synchronous(
    random: Random,
    tpdos: list[tuple[int, LoadedNode]],
    rpdo_bases: tuple[int, ...],
    nodes: list[LoadedNode],
) -> list[LoadedPdo]:
    """TPDOs and RPDOs that answer every n-th SYNC."""
    rpdos = [(base + node.node_id, node) for base in rpdo_bases[:2] for node in nodes]
    chosen = random.sample(tpdos, random.randint(1, min(len(tpdos), 24)))
    if random.random() < 0.5:
        chosen += random.sample(rpdos, random.randint(1, min(len(rpdos), 6)))
    common = random.choice((1, 1, 1, 2, 5))
    waits, slow, skipped = (random.random() < share for share in (0.5, 0.25, 0.3))
    return [
        LoadedPdo(
            node.node_id,
            can_id,
            _number(can_id),
            random.choice((1, 2, 4, 6, 8, 8)),
            common if random.random() < 0.7 else random.choice((1, 2, 3, 4, 10, 20, 60, 240)),
            Delay(0),
            slow=0.01 if slow else 0.0,
            skipped=0.005 if skipped else 0.0,
            waits=waits,
        )
        for can_id, node in chosen
    ]


def _number(can_id: int) -> int:
    """n of TPDOn (180h, 280h, ...) or RPDOn (200h, 300h, ...)."""
    return (can_id - 0x180 >> 8) + 1


def _delayed(random: Random, pdo: LoadedPdo, sync_us: int) -> LoadedPdo:
    """With a device's usual time, from no time at all to more than half of the SYNC period."""
    period_ns = 1000 * sync_us
    longest_ns = random.choice((0.02, 0.1, 0.5)) * period_ns
    base_ns = int(longest_ns * random.random())
    jitter_ns = int(random.choice((0.0, 0.05, 0.5, 1.0)) * base_ns)
    slow_ns = int(1.5 * period_ns)
    delay = Delay(base_ns, jitter_ns)
    return LoadedPdo(
        *(pdo.node, pdo.can_id, pdo.number, pdo.length, pdo.kind, delay),
        *(pdo.slow, slow_ns, pdo.skipped, pdo.period_ns, pdo.cyclic, pdo.waits),
    )


def _others(
    random: Random,
    bits_per_s: float,
    tpdos: list[tuple[int, LoadedNode]],
    nodes: list[LoadedNode],
    taken: set[int],
) -> tuple[list[LoadedPdo], tuple[SdoBurst, ...]]:
    """What fills the rest: events, timers, the master's outputs, and SDO transfers."""
    rpdos = [(base + node.node_id, node) for base in RPDO_BASES for node in nodes]
    rpdos = [each for each in rpdos if each[0] not in taken]
    chosen = random.sample(tpdos, min(len(tpdos), random.randint(1, 8)))
    chosen += random.sample(rpdos, min(len(rpdos), random.randint(0, 4)))
    bursting = random.sample(nodes, min(len(nodes), random.randint(0, 3)))
    weights = [random.uniform(0.1, 1.0) for _ in (*chosen, *bursting)]
    total = sum(weights)
    parts = [bits_per_s * weight / total for weight in weights]
    pdos = [
        _other(random, can_id, node, part)
        for (can_id, node), part in zip(chosen, parts, strict=False)
        if part > 0
    ]
    bursts = [
        _burst(random, node, part)
        for node, part in zip(bursting, parts[len(chosen) :], strict=True)
        if part > 0
    ]
    return pdos, tuple(bursts)


def _other(random: Random, can_id: int, node: LoadedNode, bits_per_s: float) -> LoadedPdo:
    length = random.choice((1, 2, 4, 8, 8))
    period_ns = max(int(1e9 * frame_bits(length) / bits_per_s), MS // 2)
    cyclic = random.random() < 0.4
    if cyclic:
        period_ns = max(round(period_ns / MS), 1) * MS
    return LoadedPdo(
        node.node_id,
        can_id,
        _number(can_id),
        length,
        random.choice((0xFE, 0xFF)),
        Delay(0),
        period_ns=period_ns,
        cyclic=cyclic,
        waits=random.random() < 0.5,
    )


def _burst(random: Random, node: LoadedNode, bits_per_s: float) -> SdoBurst:
    """In blocks or segments; a segment has a frame in either direction."""
    block = random.random() < 0.6
    size = random.choice((30, 200, 889, 2000)) if block else random.choice((4, 20, 100))
    frames = size / 7 * (1 if block else 2) + 4
    return SdoBurst(node.node_id, size, block, max(int(1e9 * 118 * frames / bits_per_s), MS))


def _moments(random: Random, seconds: float, count: int) -> tuple[float, ...]:
    return tuple(sorted(round(random.uniform(0.1, 0.9) * seconds, 6) for _ in range(count)))


def _gap(random: Random, seconds: float) -> tuple[float, float]:
    start_s = random.uniform(0.3, 0.6) * seconds
    return start_s, start_s + random.uniform(0.01, 0.1) * seconds


def _errors(
    random: Random, seconds: float, nodes: list[LoadedNode]
) -> tuple[tuple[float, int], ...]:
    moments = _moments(random, seconds, random.randint(1, 10))
    return tuple((at_s, random.choice(nodes).node_id) for at_s in moments)
