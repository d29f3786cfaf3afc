"""The bus of `syncline probe`: SDO reads through python-can, everything recorded as raw frames.

The one place of Syncline that sends. It sends SDO requests alone, never remote frames.
"""

import logging
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from syncline_logger.batcher import FrameBuffer
from syncline_logger.sources.python_can import PythonCanSource
from syncline_schemas.batch import FrameFlag
from syncline_schemas.devices.model import Key
from syncline_schemas.errors import SourceError

if TYPE_CHECKING:
    from syncline_logger.bus_options import BusOptions

SDO_REQUESTS = range(0x601, 0x680)
SDO_ANSWER = 0x580


class ProbeSource(PythonCanSource):
    """A bus that is recorded, and on which SDO requests are sent meanwhile."""

    def __init__(self, options: "BusOptions") -> None:
        super().__init__(options)
        self._tee: _Tee | None = None
        self._reads = threading.Event()
        self.network = _Network(self)

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        """Put what has come into the buffer, and give SDO answers to who waits for them."""
        if self._tee is None:
            self._tee = _Tee(buffer, bus, self.network)
            self._reads.set()
        return super().read(self._tee, bus, timeout_s)  # type: ignore[arg-type]

    def send_sdo(self, can_id: int, data: bytes) -> None:
        """Send a request, and record it. Raises SourceError when the bus does not take it."""
        from syncline_logger.lean_can import can

        if can_id not in SDO_REQUESTS:
            raise ValueError(f"{can_id:03X}h is no SDO request; nothing else is ever sent")
        self._reads.wait()
        if self._tee is None or self.bus is None:
            raise SourceError(f"bus '{self.facts.name}' is not open")
        message = can.Message(arbitration_id=can_id, is_extended_id=False, data=data)
        bus = self.bus
        try:
            self._tee.sent(
                self._clock.now_ns(), can_id, data, lambda: bus.send(message, timeout=1.0)
            )
        except can.CanError as error:
            raise SourceError(
                f"bus '{self.facts.name}': cannot send: {error}; is the interface in listen-only"
                " mode, or nobody else on the bus?"
            ) from error


class _Tee:
    """A frame buffer whose frames the SDO client sees too."""

    def __init__(self, buffer: FrameBuffer, bus: int, network: canopen.Network) -> None:
        self._buffer = buffer
        self._bus = bus
        self._network = network
        self._order = threading.Lock()

    def append(
        self, t_ns: int, bus: int, can_id: int, flags: int, dlc: int, data: bytes | bytearray
    ) -> None:
        with self._order:
            self._buffer.append(t_ns, bus, can_id, flags, dlc, data)
        if flags == 0 and dlc == 8:
            self._network.notify(can_id, bytearray(data), 0.0)

    def sent(self, t_ns: int, can_id: int, data: bytes, send: Callable[[], None]) -> None:
        """Send at `t_ns`, and record what could be sent: before its answer, which waits for it."""
        with self._order:
            send()
            self._buffer.append(t_ns, self._bus, can_id, int(FrameFlag.TX), len(data), data)


class _Network(canopen.Network):
    """canopen's network on our source instead of a bus of its own."""

    def __init__(self, source: ProbeSource) -> None:
        super().__init__()
        self._source = source

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send an SDO request."""
        if remote:
            raise ValueError("remote frames are never sent")
        self._source.send_sdo(can_id, bytes(data))


class SdoReader:
    """Reads objects of one node, paced."""

    def __init__(
        self, network: canopen.Network, node: int, *, timeout_s: float, pace_s: float
    ) -> None:
        # What it would log is told better by what it raises.
        logging.getLogger("canopen").setLevel(logging.CRITICAL)
        self._network = network
        self._client = SdoClient(
            SDO_REQUESTS.start - 1 + node, SDO_ANSWER + node, canopen.ObjectDictionary()
        )
        self._client.network = network
        self._client.RESPONSE_TIMEOUT = timeout_s
        self._client.PAUSE_BEFORE_SEND = pace_s
        network.subscribe(SDO_ANSWER + node, self._client.on_response)

    def read(self, key: Key) -> bytes | int | None:
        """As `syncline_logger.probe.Read`."""
        try:
            return bytes(self._client.upload(*key))
        except SdoAbortedError as error:
            return int(error.code)
        except SdoCommunicationError:
            return None

    def close(self) -> None:
        """Listen no more."""
        self._network.unsubscribe(self._client.tx_cobid, self._client.on_response)
