"""The master's SDO client: one transfer at a time per node."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from syncline_samples.bus import Frame
from syncline_samples.truth import SdoTruth
from syncline_samples.world import MS, World

_SIZED_WRITE = {1: 0x2F, 2: 0x2B, 3: 0x27, 4: 0x23}
_BLOCK_SIZE = 20


@dataclass(frozen=True, slots=True)
class SdoJob:
    """One transfer: a read, or a write of `data`.

    `width` 0 writes with 22h and four bytes, size not stated, as the LIR and Haomiao manuals print.
    """

    index: int
    sub: int = 0
    data: bytes | None = None
    width: int = 4
    block: bool = False


def read(index: int, sub: int = 0, *, block: bool = False) -> SdoJob:
    """A read."""
    return SdoJob(index, sub, block=block)


def write(index: int, sub: int, value: int, width: int = 0) -> SdoJob:
    """A write of a number of `width` bytes; 0 leaves the size open."""
    return SdoJob(index, sub, value.to_bytes(width or 4, "little"), width)


def write_text(index: int, sub: int, text: bytes) -> SdoJob:
    """A segmented write."""
    return SdoJob(index, sub, text, len(text))


class SdoClient:
    """Transfers with one node, in the order they were asked for.

    Args:
        timeout_ns: after this silence the client gives up, without an abort frame.
        pause_ns: between the end of a transfer and the next request.
    """

    def __init__(
        self, world: World, node_id: int, *, timeout_ns: int = 500 * MS, pause_ns: int = 2 * MS
    ) -> None:
        self._world = world
        self._node_id = node_id
        self._timeout_ns = timeout_ns
        self._pause_ns = pause_ns
        self._waiting: deque[SdoJob | Callable[[], None]] = deque()
        self._job: SdoJob | None = None
        self._request = 0
        self._start_ns = 0
        self._received = bytearray()
        self._toggle = 0
        self._kind = "expedited"
        self._rest = b""
        self._size = 0
        self._next_block: int | None = None
        world.bus.listen(0x580 + node_id, self._on_answer)

    def run(self, *jobs: SdoJob, then: Callable[[], None] | None = None) -> None:
        """Queue transfers, and what to do when they are through."""
        self._waiting.extend(jobs)
        if then is not None:
            self._waiting.append(then)
        if self._job is None:
            self._next()

    def drop(self) -> None:
        """Forget everything, as a master does when the node has restarted."""
        self._waiting.clear()
        if self._job is not None:
            self._finish("interrupted", None, b"", self._world.simulation.now_ns)

    def _next(self) -> None:
        while self._waiting:
            item = self._waiting.popleft()
            if isinstance(item, SdoJob):
                self._begin(item)
                return
            item()

    def _begin(self, job: SdoJob) -> None:
        self._job = job
        self._kind = "expedited"
        self._received = bytearray()
        self._toggle = 0
        self._start_ns = 0
        self._next_block = None
        head = job.index.to_bytes(2, "little") + bytes([job.sub])
        if job.data is None:
            command, tail = (0xA4, bytes([_BLOCK_SIZE])) if job.block else (0x40, b"")
        elif len(job.data) > 4:
            self._kind, self._rest = "segmented", job.data
            command, tail = 0x21, len(job.data).to_bytes(4, "little")
        else:
            command, tail = _SIZED_WRITE[job.width] if job.width else 0x22, job.data
        self._send(bytes([command]) + head + tail)

    def _send(self, data: bytes) -> None:
        self._request += 1
        self._world.bus.send(
            Frame(0x600 + self._node_id, data.ljust(8, b"\0")), self, self._requested
        )

    def _requested(self, t_ns: int) -> None:
        self._start_ns = self._start_ns or t_ns
        self._world.simulation.at(t_ns + self._timeout_ns, self._give_up, self._request)

    def _give_up(self, request: int) -> None:
        if request == self._request and self._job is not None:
            self._finish("no answer", None, b"", self._world.simulation.now_ns)

    def _finish(self, result: str, code: int | None, data: bytes, t_ns: int) -> None:
        job = self._job
        assert job is not None
        self._job = None
        self._request += 1
        direction = "upload" if job.data is None else "download"
        start_ns, end_ns = self._world.utc_ns(self._start_ns), self._world.utc_ns(t_ns)
        self._world.truth.sdo.append(
            SdoTruth(
                self._node_id,
                start_ns,
                end_ns,
                job.index,
                job.sub,
                direction,
                self._kind,
                data if job.data is None else job.data,
                result,
                code,
            )
        )
        self._world.simulation.at(t_ns + self._pause_ns, self._next_if_idle)

    def _next_if_idle(self) -> None:
        if self._job is None:
            self._next()

    def _on_answer(self, frame: Frame, t_ns: int) -> None:
        if self._job is None or not self._start_ns:
            return
        data = frame.data
        if self._next_block is not None:
            self._take_block_segment(data, t_ns)
        elif data[0] == 0x80:
            self._finish("abort", int.from_bytes(data[4:8], "little"), b"", t_ns)
        elif data[0] >> 5 == 2:
            self._take_upload(data, t_ns)
        elif data[0] >> 5 == 0:
            self._take_upload_segment(data, t_ns)
        elif data[0] >> 5 in (1, 3):
            self._take_download(t_ns)
        elif data[0] >> 5 == 6:
            self._take_block(data, t_ns)

    def _take_upload(self, data: bytes, t_ns: int) -> None:
        if data[0] & 2:
            size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
            self._finish("ok", None, data[4 : 4 + size], t_ns)
        else:
            self._kind = "segmented"
            self._send(b"\x60")

    def _take_upload_segment(self, data: bytes, t_ns: int) -> None:
        self._received += data[1 : 8 - (data[0] >> 1 & 7)]
        self._toggle ^= 1
        if data[0] & 1:
            self._finish("ok", None, bytes(self._received), t_ns)
        else:
            self._send(bytes([0x60 | self._toggle << 4]))

    def _take_download(self, t_ns: int) -> None:
        if self._kind != "segmented" or not self._rest:
            self._finish("ok", None, b"", t_ns)
            return
        part, self._rest = self._rest[:7], self._rest[7:]
        command = self._toggle << 4 | (7 - len(part)) << 1 | (not self._rest)
        self._toggle ^= 1
        self._send(bytes([command]) + part)

    def _take_block(self, data: bytes, t_ns: int) -> None:
        self._kind = "block"
        if not data[0] & 1:
            self._size = int.from_bytes(data[4:8], "little")
            self._next_block = 1
            self._send(b"\xa3")
        else:
            self._send(b"\xa1")
            self._finish("ok", None, bytes(self._received[: self._size]), t_ns)

    def _take_block_segment(self, data: bytes, t_ns: int) -> None:
        self._received += data[1:]
        number, last = data[0] & 0x7F, data[0] & 0x80
        if last:
            self._next_block = None
        if last or number == _BLOCK_SIZE:
            self._send(bytes([0xA2, number, _BLOCK_SIZE]))
