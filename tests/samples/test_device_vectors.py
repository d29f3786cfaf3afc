"""The simulated devices against the frames that the makers' manuals print or imply.

Each vector is set up on the simulated device, its requests are sent, and the device's own frames
must be the vector's, byte for byte. Answers without a request in the vector are asked for by a read
of the index that they name.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from syncline_samples.bus import Frame
from syncline_samples.devices import Haomiao38, Jn2100, Lir
from syncline_samples.motion import Shaft, Tilt
from syncline_samples.node import Node
from tests.samples.bench import Bench

VECTORS = Path(__file__).parents[3] / "shared" / "devices" / "vectors"

Setup = Callable[[Node], None]
_REST = Shaft((0, 0), (1, 0))


def put(index: int, sub: int, value: int | bytes) -> Setup:
    return lambda node: node.objects.put(index, sub, value)


def write(index: int, sub: int, value: int) -> Setup:
    return lambda node: node.objects.write(index, sub, value.to_bytes(4, "little"))


def occur(code: int, register: int, alarms: int = 0, warnings: int = 0) -> Setup:
    return lambda node: node.emcy.occur(code, register, alarms, warnings)


def come_and_go(*codes: tuple[int, int]) -> Setup:
    """Errors appear and the last of them goes away."""

    def act(node: Node) -> None:
        for code, register in codes:
            node.emcy.occur(code, register)
        node.emcy.vanish(codes[-1][0])

    return act


def guarding(state: int = 0x80) -> Setup:
    def act(node: Node) -> None:
        node.objects.put(0x100C, 0, 100)
        node.objects.put(0x100D, 0, 3)
        node.world.bus.send(Frame(0x000, bytes([state, 0])), node)

    return act


def guarded_and_left(node: Node) -> None:
    """Two guard requests come, then none for longer than the life time, then one again."""
    guarding(0x01)(node)
    for ms in (1, 50, 400):
        request = Frame(0x700 + node.node_id, b"", 0)
        node.after(ms * 1_000_000, node.world.bus.send, request, node)


def heartbeat(state: int) -> Setup:
    """Heartbeat every 40 ms, and the NMT command of a state."""

    def act(node: Node) -> None:
        node.objects.write(0x1017, 0, (40).to_bytes(2, "little"))
        node.world.bus.send(Frame(0x000, bytes([state, 0])), node)

    return act


def stored_heartbeat(node: Node) -> None:
    node.objects.commission(0x1017, 0, 500)


def positions(pdo: int, *counts: int) -> Setup:
    """The shaft stands at these counts, one after the other, at each SYNC."""

    def act(node: Node) -> None:
        node.objects.put(0x17FF + pdo, 2, 1)
        node.tpdos.configure()
        node.tpdos[pdo].build = lambda t_ns: (left.pop(0).to_bytes(4, "little"), ())
        left = list(counts)
        node.world.bus.send(Frame(0x000, b"\x01\x00"), node)
        for number in range(len(counts)):
            node.after((5 + 5 * number) * 1_000_000, node.world.bus.send, Frame(0x080), node)

    return act


def encoder_at(counts: int) -> Setup:
    """The encoder really stands there: its own arithmetic makes the PDO."""

    def act(node: Node) -> None:
        assert isinstance(node, Lir | Haomiao38)
        node.objects.write(0x6003, 0, counts.to_bytes(4, "little"))
        node.objects.put(0x1800, 2, 1)
        node.tpdos.configure()
        node.world.bus.send(Frame(0x000, b"\x01\x00"), node)
        node.after(5_000_000, node.world.bus.send, Frame(0x080), node)

    return act


def scaled_to_4096(node: Node) -> None:
    node.objects.put(0x6000, 0, 0x0004)
    node.objects.put(0x6001, 0, 4096)
    encoder_at(4096)(node)


def tilted(long: int, lat: int, step: int = 100, quadrant: int = 2) -> Setup:
    """The platform stands at these millidegrees."""

    def act(node: Node) -> None:
        assert isinstance(node, Jn2100)
        node.tilt = Tilt((0, long, lat), (1, long, lat))
        node.objects.put(0x6000, 0, step)
        node.objects.put(0x2040, 0, quadrant)
        node.world.bus.send(Frame(0x000, b"\x01\x00"), node)
        node.after(5_000_000, node.world.bus.send, Frame(0x080), node)

    return act


def vibrating(velocity: int, peak: int) -> Setup:
    def act(node: Node) -> None:
        data = velocity.to_bytes(4, "little") + peak.to_bytes(4, "little")
        node.tpdos[3].build = lambda t_ns: (data, ())
        tilted(0, 0)(node)

    return act


SETUP: dict[str, Setup] = {
    "LA07": put(0x6507, 0, 0x01050201),
    "LA08": encoder_at(65536),
    "LA09": positions(2, 131071),
    "LA10": positions(1, 131070, 3),
    "LA11": positions(1, 3, 131070),
    "LA16": occur(0x7320, 0x01, alarms=1),
    "LA17": occur(0x6010, 0x01, warnings=4),
    "LA18": occur(0x5530, 0x80),
    "LA19": guarded_and_left,
    "LA20": come_and_go((0x5530, 0x80), (0x7320, 0x01)),
    "LA21": come_and_go((0x7320, 0x01)),
    "LA22": occur(0x7510, 0x10),
    "LA24": guarding(0x80),
    "LB01": stored_heartbeat,
    "LB03": heartbeat(0x01),
    "LB04": heartbeat(0x01),
    "LB06": put(0x1802, 2, 0),
    "LB12": put(0x1018, 2, 0x009E000D),
    "LB22": encoder_at(17970176),
    "LB23": guarded_and_left,
    "LB24": occur(0x7510, 0x10),
    "LB25": guarding(0x01),
    "JN02": tilted(330_000, 30_000),
    "JN03": tilted(20_000, -20_000, quadrant=0),
    "JN04": tilted(20_000, -20_000),
    "JN05": tilted(-23_700, 0, step=10, quadrant=0),
    "JN06": tilted(-237_000, 0, quadrant=0),
    "JN07": tilted(30_000, -30_000, step=1, quadrant=1),
    "JN08": tilted(350_000, 0, step=10),
    "JN09": tilted(200_000, 0, step=1),
    "JN10": vibrating(125, 981),
    "JN11": guarding(0x01),
    "JN12": guarded_and_left,
    "JN13": occur(0x4200, 0x09),
    "JN14": occur(0x3100, 0x05),
    "JN15": come_and_go((0x3100, 0x05)),
    "JN23": put(0x4080, 0, -55),
    "JN25": put(0x4004, 2, 7),
    "JN26": put(0x4004, 2, 5),
    "JN28": put(0x207F, 0, 1),
    "JN31": lambda node: None,
    "JN32": tilted(0, 30_000, quadrant=0),
    "JN33": tilted(30_000, 45_000, quadrant=0),
    "HM12": encoder_at(4096),
    "HM13": scaled_to_4096,
    "HM14": positions(1, 33554431, 1),
    "HM18": occur(0x1000, 0x01),
    "HM21": heartbeat(0x01),
}
"""How to bring the device into the situation of a vector; no entry where a request suffices."""

_DEVICE = {"LB08": "lir-da158a", "LB10": "lir-918", "LB11": "lir-918", "LB22": "lir-918"}
"""Vectors that need another model than the file says."""
_REQUEST = {"LA26": "601#2210100100000000"}
"""The request where the vector has only the abort: a store with a wrong signature."""
_SERIAL = {"LA05": 0x0701DCA5, "LB13": 0x1401DCA5, "LB14": 0x1001DCA5}
_NOT_OF_A_DEVICE = {"LA28", "LB27"}
"""A master's frame alone; LB27 is LA03 again and answered the same way."""
_WAIT_MS = {"JN24": 2100, "LB01": 6000, "JN29": 500}
"""The self-test takes two seconds, the reset of a LIR four."""


def vectors() -> list[dict[str, Any]]:
    if not VECTORS.is_dir():
        return []
    files = sorted(VECTORS.glob("*.json"))
    return [vector for file in files for vector in json.loads(file.read_text(encoding="utf-8"))]


def device(bench: Bench, vector: dict[str, Any]) -> Node:
    name = _DEVICE.get(vector["id"], vector["device"])
    if name == "jn2100":
        return Jn2100(bench.world, 10, Tilt((0, 0, 0), (1, 0, 0)))
    if name == "haomiao-38":
        return Haomiao38(bench.world, 1, _REST)
    serial = _SERIAL.get(vector["id"], 1)
    empty = b"" if vector["id"] == "LB04" else b"\0"
    return Lir(bench.world, 1, name, _REST, serial=serial, empty_heartbeat=empty)


def is_request(frame: str) -> bool:
    can_id = int(frame.partition("#")[0], 16)
    return can_id < 0x081 or 0x600 <= can_id < 0x680 or frame.endswith("R")


def read_for(answer: str) -> str:
    """The read request whose answer has this index and sub-index."""
    can_id, _, data = answer.partition("#")
    return f"{int(can_id, 16) + 0x80:03X}#40{data[2:8]}00000000"


def conversation(frames: list[str]) -> list[tuple[str | None, list[str]]]:
    """Requests with the answers that follow each; answers of an SDO server get their read."""
    steps: list[tuple[str | None, list[str]]] = []
    for frame in frames:
        if is_request(frame):
            steps.append((frame, []))
        elif (
            0x580 <= int(frame[:3], 16) < 0x600
            and frame[4] in "48"
            and (not steps or steps[-1][1] or steps[-1][0] is None)
        ):
            steps.append((read_for(frame), [frame]))
        elif steps:
            steps[-1][1].append(frame)
        else:
            steps.append((None, [frame]))
    return steps


def in_order(wanted: list[str], seen: list[str]) -> bool:
    left = iter(seen)
    return all(frame in left for frame in wanted)


@pytest.mark.skipif(not VECTORS.is_dir(), reason="the vectors are not here")
@pytest.mark.parametrize("vector", vectors(), ids=lambda vector: str(vector["id"]))
def test_device_sends_what_the_manual_says(vector: dict[str, Any]) -> None:
    if vector["id"] in _NOT_OF_A_DEVICE:
        pytest.skip("nothing that a device sends")
    bench = Bench()
    node = device(bench, vector)
    bench.boot(node)
    setup = SETUP.get(vector["id"])
    if setup:
        setup(node)
    frames = [frame["frame"] for frame in vector["frames"]]
    if vector["id"] in _REQUEST:
        frames.insert(0, _REQUEST[vector["id"]])
    for request, wanted in conversation(frames):
        if request:
            bench.wait(50)
            seen = bench.ask(request, _WAIT_MS.get(vector["id"], 50))
        else:
            bench.wait(900)
            seen = [text for _, text in bench.log.rows]
        assert in_order(wanted, seen), (request, wanted, seen[:20])
