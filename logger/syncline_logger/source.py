"""What the recorder asks of anything that frames come from."""

from dataclasses import dataclass
from typing import Protocol

from syncline_logger.batcher import FrameBuffer


@dataclass(frozen=True, slots=True)
class SourceFacts:
    """What is known of a source before the first frame; it goes into the capture's metadata.

    `clock` is where its stamps come from: "hardware", "kernel", "host" (read by the recorder's
    machine when the frame reached it), "simulated" or "unknown". `resolution_ns` is the smallest
    step that the stamps can express on their way here.
    """

    name: str
    interface: str
    channel: str
    bitrate: int | None = None
    data_bitrate: int | None = None
    fd: bool = False
    clock: str = "unknown"
    resolution_ns: int = 1
    listen_only: bool = False
    filters: str = ""


class Source(Protocol):
    """A bus that can be listened to; opened and read by one thread of its own."""

    facts: SourceFacts

    def open(self) -> None:
        """Start to listen. Raises SourceError when the bus cannot be opened."""
        ...

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        """Put what has come into the buffer as bus number `bus`; wait at most `timeout_s`.

        Returns: the number of frames. Raises SourceError when the adapter is gone.
        """
        ...

    def close(self) -> None:
        """Stop listening; never raises."""
        ...
