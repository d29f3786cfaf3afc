"""What the recorder asks of anything that frames come from."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from syncline_logger.adapter_clock import Knot
from syncline_logger.batcher import FrameBuffer
from syncline_logger.clock import RecorderClock
from syncline_schemas.errors import SourceError


@dataclass(frozen=True, slots=True)
class SourceFacts:
    """What is known of a source before the first frame; it goes into the capture's metadata.

    `clock` is where its stamps come from: "hardware", "kernel", "host" (read by the recorder's
    machine when the frame reached it), "simulated" or "unknown". `resolution_ns` is the smallest
    step that the stamps can express on their way here. `state` is the controller's state when the
    source was opened ("active", "off"), empty where it is not told. `loss_counters` are the places
    whose losses the source counts: "kernel", "controller", "adapter". `receive_buffer_bytes` is
    the size of the kernel's buffer for frames that wait to be read, as the kernel counts it.
    `restart_ms`: after so long the controller leaves bus-off by itself, 0 for never. `notes` are
    sentences that the user should read.
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
    state: str = ""
    loss_counters: tuple[str, ...] = ()
    receive_buffer_bytes: int | None = None
    restart_ms: int | None = None
    notes: tuple[str, ...] = ()


class SourceAsleep(SourceError):
    """Nothing can be heard for now, and asking again costs nothing: the interface is down.

    Raised by `read` the source stays open, raised by `open` it is not.
    """


class Source(Protocol):
    """A bus that can be listened to; it never sends.

    `facts` are complete when it is open, and may change with each opening.
    """

    facts: SourceFacts

    def open(self) -> None:
        """Start to listen; nothing if it does already.

        Raises SourceError when the bus cannot be opened.
        """
        ...

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        """Put what has come into the buffer as bus number `bus`; wait at most `timeout_s`.

        What was lost before these frames goes into the buffer too (`FrameBuffer.lose`).

        Returns: the number of frames. Raises SourceAsleep while nothing can be heard, any other
        SourceError when the adapter is gone: the source is then closed and opened again.
        """
        ...

    def fileno(self) -> int | None:
        """File number that is readable when frames wait, -1 while the source is not open.

        None: there is none, and `read` must wait in a thread of its own. All sources with a file
        number are read by one thread, which gives them a `timeout_s` of 0.
        """
        ...

    def close(self) -> None:
        """Stop listening; never raises."""
        ...


@runtime_checkable
class StampedSource(Protocol):
    """A source whose adapter may have a clock of its own."""

    def use_clock(self, clock: RecorderClock) -> None:
        """Map stamps onto this clock; before the source is opened."""
        ...

    def clock_knots(self) -> list[Knot]:
        """How the adapter's stamps became t since the last call, from any thread."""
        ...
