"""The live line of a running recorder: what it says of nodes while frames come in."""

import threading
import time
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path

from can import Message
from can.interfaces.virtual import VirtualBus
from mcap.reader import make_reader

from syncline_logger.bus_options import BusOptions
from syncline_logger.live_status import StatusSnapshot
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record
from syncline_logger.sources.python_can import PythonCanSource

MS = 1_000_000
PERIOD_NS = {1: 20 * MS, 2: 50 * MS, 3: 100 * MS, 4: 200 * MS, 5: 500 * MS, 9: 50 * MS}
"""Heartbeat period by node; node 9 is the first to fall silent."""
SHORTEST_SILENCE_NS = 500 * MS
LONGEST_NS = 30_000 * MS


def _heartbeat(node: int) -> Message:
    return Message(arbitration_id=0x700 + node, is_extended_id=False, data=b"\x05")


class Bus(threading.Thread):
    """Nodes that send heartbeats until they are told to be silent, and when they sent them."""

    def __init__(self, channel: str) -> None:
        super().__init__(daemon=True)
        self._channel = channel
        self.sent_ns: dict[int, list[int]] = {node: [] for node in PERIOD_NS}
        self.talking = set(PERIOD_NS)

    def run(self) -> None:
        due_ns = dict.fromkeys(PERIOD_NS, time.time_ns())
        with VirtualBus(self._channel) as bus:
            while self.talking:
                for node in sorted(self.talking):
                    if time.time_ns() >= due_ns[node]:
                        self.sent_ns[node].append(time.time_ns())
                        bus.send(_heartbeat(node))
                        due_ns[node] = time.time_ns() + PERIOD_NS[node]
                time.sleep(0.002)

    def silence_ns(self, node: int, t_ns: int) -> int:
        """How long a node had been silent at a moment."""
        sent = self.sent_ns[node]
        return t_ns - sent[bisect_left(sent, t_ns) - 1]


def states(snapshot: StatusSnapshot) -> dict[int, str]:
    return {node: str(state) for node, state in snapshot.buses[0].nodes.items()}


def said_lost(snapshots: list[StatusSnapshot]) -> Iterator[tuple[int, int]]:
    """Node and moment of each LOST."""
    for snapshot in snapshots:
        for node, state in states(snapshot).items():
            if state == "LOST":
                yield node, snapshot.t_ns


def test_only_a_silent_node_is_lost(tmp_path: Path) -> None:
    """One node stops, then the whole bus; what is said is held to what was sent."""
    bus, stop = Bus("live-line"), threading.Event()
    snapshots: list[StatusSnapshot] = []

    def watch(snapshot: StatusSnapshot) -> None:
        snapshots.append(snapshot)
        lost = {node for node, state in states(snapshot).items() if state == "LOST"}
        if len(snapshots) == 25:
            bus.talking.discard(9)
        elif len(snapshots) >= 30 and 9 in lost:
            bus.talking.clear()
        if lost == set(PERIOD_NS):
            stop.set()

    record(
        [PythonCanSource(BusOptions("a", "virtual", "live-line"))],
        tmp_path,
        stop=stop,
        duration_ns=LONGEST_NS,
        on_start=lambda _: bus.start(),
        on_status=watch,
        status_period_ns=100 * MS,
    )
    assert stop.is_set(), states(snapshots[-1])
    wrong = [
        (node, bus.silence_ns(node, t_ns) // MS)
        for node, t_ns in said_lost(snapshots)
        if bus.silence_ns(node, t_ns) < SHORTEST_SILENCE_NS
    ]
    assert wrong == []
    healthy = dict.fromkeys(PERIOD_NS, "OPERATIONAL")
    seen = [states(snapshot) for snapshot in snapshots]
    assert healthy in seen
    assert {**healthy, 9: "LOST"} in seen


def test_rates_are_of_every_period(tmp_path: Path) -> None:
    """A period shorter than the chunk's has the frames of that period."""
    bus, stop = Bus("live-rate"), threading.Event()
    rates: list[float] = []

    def watch(snapshot: StatusSnapshot) -> None:
        rates.append(snapshot.buses[0].frames_per_s)
        if len(rates) == 12:
            stop.set()

    record(
        [PythonCanSource(BusOptions("a", "virtual", "live-rate"))],
        tmp_path,
        stop=stop,
        duration_ns=LONGEST_NS,
        on_start=lambda _: bus.start(),
        on_status=watch,
        status_period_ns=200 * MS,
    )
    bus.talking.clear()
    assert rates[1:11].count(0) == 0


def test_looking_often_does_not_make_chunks_larger(tmp_path: Path) -> None:
    """Frames taken for the live line count for the chunk that they wait for."""
    stop, sent = threading.Event(), 0

    def watch(snapshot: StatusSnapshot) -> None:
        nonlocal sent
        if snapshot.frames < sent:
            return
        if sent == 200:
            stop.set()
            return
        for _ in range(40):
            sender.send(_heartbeat(1))
        sent += 40

    with VirtualBus("live-chunks") as sender:
        result = record(
            [PythonCanSource(BusOptions("a", "virtual", "live-chunks"))],
            tmp_path,
            RecordOptions(chunk_frames=100, flush_ns=LONGEST_NS),
            stop=stop,
            duration_ns=LONGEST_NS,
            on_status=watch,
            status_period_ns=MS,
        )
    assert result.frame_count == 200
    with result.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    # At the start, at 120 frames, and at the end.
    assert len(summary.chunk_indexes) == 3
