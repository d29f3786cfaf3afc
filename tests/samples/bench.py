"""One simulated device alone on a bus, spoken to frame by frame."""

from random import Random

from syncline_samples.bus import Bus, Frame
from syncline_samples.machine import EPOCH_NS
from syncline_samples.node import Node
from syncline_samples.simulation import Simulation
from syncline_samples.truth import Truth
from syncline_samples.world import MS, World


class FrameLog:
    """A tap that keeps frames as (end, candump text)."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, str]] = []

    def frame(self, t_ns: int, frame: Frame) -> None:
        """Keep a frame."""
        self.rows.append((t_ns, candump(frame)))

    def error(self, t_ns: int, data: bytes) -> None:
        """Keep an error frame."""
        self.rows.append((t_ns, f"error#{data.hex().upper()}"))


class Bench:
    """A bus with a world, a log, and a client that sends what the test wants."""

    def __init__(self, bitrate: int = 500_000, seed: int = 1) -> None:
        self.log = FrameLog()
        self.simulation = Simulation()
        self.bus = Bus(self.simulation, bitrate, self.log)
        self.world = World(self.simulation, self.bus, Truth(), Random(seed), EPOCH_NS)

    def boot(self, node: Node) -> None:
        """Power a node and let it reach PRE-OPERATIONAL."""
        node.power_on()
        self.wait(400)

    def wait(self, ms: float) -> list[str]:
        """Let time pass; the frames that were seen meanwhile."""
        before = len(self.log.rows)
        self.simulation.run_until(self.simulation.now_ns + round(ms * MS))
        return [text for _, text in self.log.rows[before:]]

    def ask(self, text: str, ms: float = 5) -> list[str]:
        """Send a frame in candump notation; the frames that follow it."""
        self.bus.send(parse(text), self)
        return self.wait(ms)[1:]


def parse(text: str) -> Frame:
    """A frame from candump notation."""
    can_id, _, data = text.partition("#")
    if data.startswith("R"):
        return Frame(int(can_id, 16), b"", int(data[1:] or "0"))
    return Frame(int(can_id, 16), bytes.fromhex(data))


def candump(frame: Frame) -> str:
    """A frame in candump notation."""
    tail = frame.data.hex().upper() if frame.remote_dlc is None else f"R{frame.remote_dlc or ''}"
    return f"{frame.can_id:03X}#{tail}"
