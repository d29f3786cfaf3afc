"""The client's side of SDO transfers (CiA 301 7.2.4.3): what to send after each answer."""

from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from syncline_samples import abort
from syncline_samples.sdo_block import SEGMENT_BYTES, SubBlock, crc16, segments_from

_SIZED_WRITE = {1: 0x2F, 2: 0x2B, 3: 0x27, 4: 0x23}
_BLOCK_SIZE = 20

Result = Literal["ok", "abort"]
By = Literal["client", "server"]


@dataclass(frozen=True, slots=True)
class SdoJob:
    """One transfer: a read, or a write of `data`.

    Attributes:
        width: 0 writes with 22h and four bytes, size not stated, as the LIR and Haomiao manuals
            print.
        block: by the block protocol, with numbered segments.
        crc: the client supports the CRC of block transfers.
        sized: the initiate request of a segmented or block write states the size.
        short: requests are only as long as what they say.
        command: first byte of the initiate request where it is not the usual one.
        block_size: segments per sub-block that the client asks for in a block read.
        switch_below: the server may answer a block read of so few bytes without blocks.
        lose: segments of a block read, counted from 0, that do not arrive the first time.
        spoil_crc: a block write ends with a wrong CRC.
        abort_after: the client aborts with `abort_code` after so many answers.
        stop_after: the client says nothing more after so many answers.
    """

    index: int
    sub: int = 0
    data: bytes | None = None
    width: int = 4
    block: bool = False
    crc: bool = True
    sized: bool = True
    short: bool = False
    command: int | None = None
    block_size: int = _BLOCK_SIZE
    switch_below: int = 0
    lose: tuple[int, ...] = ()
    spoil_crc: bool = False
    abort_after: int | None = None
    abort_code: int = abort.GENERAL
    stop_after: int | None = None

    @property
    def head(self) -> bytes:
        """Index and sub-index as they stand in a frame."""
        return self.index.to_bytes(2, "little") + bytes([self.sub])


class Step(NamedTuple):
    """What an answer leads to: frames to send, and the result where the transfer is over."""

    frames: tuple[bytes, ...] = ()
    result: Result | None = None
    data: bytes = b""
    abort_code: int | None = None
    by: By | None = None
    mine: bool = True
    """False for a frame that does not belong to the transfer."""


NOT_MINE = Step(mine=False)


class Transfer(Protocol):
    """A transfer under way; `kind` is that of the protocol that runs."""

    kind: str

    @property
    def first(self) -> bytes:
        """The initiate request."""
        ...

    def take(self, answer: bytes) -> Step:
        """What an answer of the server leads to."""
        ...


def begin(job: SdoJob) -> Transfer:
    """The transfer of a job."""
    if job.data is None:
        return BlockRead(job) if job.block else Read(job)
    return BlockWrite(job, job.data) if job.block else Write(job, job.data)


def server_abort(job: SdoJob, answer: bytes) -> Step:
    """The server's abort of this transfer, or somebody else's."""
    if answer[1:4] != job.head:
        return NOT_MINE
    code = int.from_bytes(answer[4:8].ljust(4, b"\0"), "little")
    return Step(result="abort", abort_code=code, by="server")


def _client_abort(job: SdoJob, code: int) -> Step:
    frame = b"\x80" + job.head + code.to_bytes(4, "little")
    return Step((frame,), "abort", abort_code=code, by="client")


class Read:
    """An expedited or segmented upload."""

    kind = "expedited"

    def __init__(self, job: SdoJob) -> None:
        self._job = job
        self._received: bytearray | None = None
        self._toggle = 0

    @property
    def first(self) -> bytes:
        """40h, or what the job says."""
        return bytes([self._job.command or 0x40]) + self._job.head

    def take(self, answer: bytes) -> Step:
        """Ask for segments until the last one."""
        if self._received is None:
            if answer[0] >> 5 != 2 or answer[1:4] != self._job.head:
                return NOT_MINE
            if answer[0] & 2:
                size = 4 - (answer[0] >> 2 & 3) if answer[0] & 1 else 4
                return Step(result="ok", data=answer[4 : 4 + size])
            self.kind, self._received = "segmented", bytearray()
            return Step((b"\x60",))
        if answer[0] >> 5 or answer[0] >> 4 & 1 != self._toggle:
            return NOT_MINE
        self._received += answer[1 : 8 - (answer[0] >> 1 & 7)]
        self._toggle ^= 1
        if answer[0] & 1:
            return Step(result="ok", data=bytes(self._received))
        return Step((bytes([0x60 | self._toggle << 4]),))


class Write:
    """An expedited or segmented download."""

    def __init__(self, job: SdoJob, data: bytes) -> None:
        self._job = job
        self._rest = data
        self.kind = "segmented" if len(data) > 4 or not data else "expedited"
        self._toggle = -1

    @property
    def first(self) -> bytes:
        """The data themselves, or their size."""
        job, data = self._job, self._rest
        if self.kind == "segmented":
            size = len(data).to_bytes(4, "little") if job.sized else b""
            return bytes([job.command or 0x20 | job.sized]) + job.head + size
        command = _SIZED_WRITE[job.width] if job.width else 0x22
        return bytes([job.command or command]) + job.head + data

    def take(self, answer: bytes) -> Step:
        """Send segments until all are acknowledged."""
        if self._toggle < 0:
            if answer[0] >> 5 != 3 or answer[1:4] != self._job.head:
                return NOT_MINE
            if self.kind == "expedited":
                return Step(result="ok")
            self._toggle = 0
            return self._segment()
        if answer[0] >> 5 != 1 or answer[0] >> 4 & 1 != self._toggle:
            return NOT_MINE
        self._toggle ^= 1
        return self._segment() if self._rest else Step(result="ok")

    def _segment(self) -> Step:
        part, self._rest = self._rest[:7], self._rest[7:]
        command = self._toggle << 4 | (7 - len(part)) << 1 | (not self._rest)
        return Step((bytes([command]) + part,))


class BlockRead:
    """A block upload; falls back to the other protocols when the server does."""

    kind = "block"

    def __init__(self, job: SdoJob) -> None:
        self._job = job
        self._received: SubBlock | None = None
        self._other: Read | None = None
        self._crc = False

    @property
    def first(self) -> bytes:
        """A0h or A4h with the block size and the protocol switch threshold."""
        job = self._job
        return bytes([0xA0 | job.crc << 2]) + job.head + bytes([job.block_size, job.switch_below])

    def take(self, answer: bytes) -> Step:
        """Acknowledge sub-blocks until the server ends the transfer."""
        if self._other is not None:
            return self._switched(self._other, answer)
        if self._received is None:
            if answer[0] >> 5 == 2:
                self._other = Read(self._job)
                return self._switched(self._other, answer)
            if answer[0] >> 5 != 6 or answer[1:4] != self._job.head:
                return NOT_MINE
            self._received = SubBlock(self._job.lose)
            self._crc = self._job.crc and bool(answer[0] & 4)
            return Step((b"\xa3",))
        if self._received.whole:
            return self._end(answer, bytes(self._received.data))
        acknowledged = self._received.take(answer, self._job.block_size)
        if acknowledged is None:
            return Step()
        return Step((bytes([0xA2, acknowledged, self._job.block_size]),))

    def _switched(self, other: Read, answer: bytes) -> Step:
        step = other.take(answer)
        self.kind = other.kind
        return step

    def _end(self, answer: bytes, data: bytes) -> Step:
        if answer[0] & 0xE3 != 0xC1:
            return NOT_MINE
        data = data[: len(data) - (answer[0] >> 2 & 7)]
        if self._crc and int.from_bytes(answer[1:3], "little") != crc16(data):
            return _client_abort(self._job, abort.CRC)
        return Step((b"\xa1",), "ok", data)

    @property
    def in_segments(self) -> bool:
        """Whether a frame of the server is a numbered segment, whatever its first byte."""
        return self._received is not None and not self._received.whole


class BlockWrite:
    """A block download."""

    kind = "block"

    def __init__(self, job: SdoJob, data: bytes) -> None:
        self._job = job
        self._data = data
        self._position = 0
        self._block_size = 0
        self._server_crc = False
        self._ended = False

    @property
    def first(self) -> bytes:
        """C0h with CRC and size bits."""
        job = self._job
        command = 0xC0 | job.crc << 2 | job.sized << 1
        size = len(self._data) if job.sized else 0
        return bytes([command]) + job.head + size.to_bytes(4, "little")

    def take(self, answer: bytes) -> Step:
        """Send sub-blocks until all is acknowledged, then the end with the CRC."""
        what = answer[0] & 3
        if answer[0] >> 5 != 5:
            return NOT_MINE
        if not self._block_size:
            if what != 0 or answer[1:4] != self._job.head:
                return NOT_MINE
            self._block_size = answer[4]
            self._server_crc = bool(answer[0] & 4)
            return self._sub_block()
        if self._ended:
            return Step(result="ok") if what == 1 else NOT_MINE
        if what != 2:
            return NOT_MINE
        self._position += SEGMENT_BYTES * answer[1]
        self._block_size = answer[2]
        return self._sub_block() if self._position < len(self._data) else self._end()

    def _sub_block(self) -> Step:
        return Step(tuple(segments_from(self._data, self._position, self._block_size)))

    def _end(self) -> Step:
        self._ended = True
        unused = -len(self._data) % SEGMENT_BYTES
        crc = crc16(self._data) if self._job.crc and self._server_crc else 0
        crc ^= 0x0101 if self._job.spoil_crc else 0
        return Step((bytes([0xC1 | unused << 2]) + crc.to_bytes(2, "little"),))


def aborted_by_client(job: SdoJob) -> Step:
    """The abort that the job asks for."""
    return _client_abort(job, job.abort_code)
