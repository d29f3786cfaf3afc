"""ROS 2 recordings in MCAP as a log: each topic with CAN frames is a bus."""

from collections.abc import Iterator
from pathlib import Path

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.resolution import Resolution
from syncline_analyzer.readers.times import FIRST_UTC_NS
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.ros2_bag import BagScan


class Ros2Reader:
    """The CAN frames of a ROS 2 bag; each topic is a bus of its own."""

    def __init__(self, path: Path, start_ns: int | None = None, end_ns: int | None = None) -> None:
        self.facts = CaptureFacts(path, "ros2")
        self._scan = BagScan(path)
        self._range = (start_ns, end_ns)

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order."""
        resolution = Resolution()
        for batch in self._scan.batches():
            self.facts.buses[:] = self._scan.facts.topics
            frames = self._wanted(batch)
            if len(frames):
                resolution.sample(frames.t_ns, frames.bus, frames.can_id)
                if int(frames.t_ns[0]) < FIRST_UTC_NS:
                    self.facts.time_base = "relative"
                yield frames
        self.facts.resolution_ns = resolution.step_ns
        self._finish()

    def _finish(self) -> None:
        bag = self._scan.facts
        self.facts.buses[:] = bag.topics
        self.facts.damage = "; ".join(bag.damage[:20]) or None
        for _ in range(min(bag.unreadable, 100)):
            self.facts.add_unparsed(0, "a message that is no CAN frame")
        self.facts.unparsed_count += max(0, bag.unreadable - 100)
        if bag.unstamped:
            self.facts.notes.append(
                f"{bag.unstamped} message(s) have no stamp; the time of recording is used"
            )
        if len(self.facts.buses) > 1:
            self.facts.notes.append(
                "each topic is taken for a bus; ros2_socketcan's to_can_bus and from_can_bus are one"
            )

    def _wanted(self, frames: FrameBatch) -> FrameBatch:
        start_ns, end_ns = self._range
        if start_ns is not None:
            frames = frames[frames.t_ns >= start_ns]
        return frames if end_ns is None else frames[frames.t_ns < end_ns]
