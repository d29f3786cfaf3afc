"""The SDO server of a simulated node (CiA 301 7.2.4): expedited, segmented and block transfers."""

from functools import partial
from typing import Protocol

from syncline_samples import abort
from syncline_samples.objects import ObjectDictionary, SdoAbort
from syncline_samples.sdo_block import BlockDownload, BlockUpload

_EXPEDITED_BY_SIZE = {1: 0x4F, 2: 0x4B, 3: 0x47, 4: 0x43}


class _Transfer(Protocol):
    """A transfer of several steps.

    Attributes:
        over: nothing more belongs to it.
        takes_all: every frame of the client but an abort is a segment of it.
    """

    over: bool

    @property
    def takes_all(self) -> bool: ...

    def take(self, request: bytes) -> list[bytes]: ...


class _SegmentedUpload:
    takes_all = False

    def __init__(self, data: bytes) -> None:
        self._rest = data
        self._toggle = 0
        self.over = False

    def take(self, request: bytes) -> list[bytes]:
        if request[0] >> 5 != 3:
            raise SdoAbort(abort.COMMAND)
        if request[0] >> 4 & 1 != self._toggle:
            raise SdoAbort(abort.TOGGLE)
        part, self._rest = self._rest[:7], self._rest[7:]
        self.over = not self._rest
        answer = bytes([self._toggle << 4 | (7 - len(part)) << 1 | self.over]) + part
        self._toggle ^= 1
        return [answer.ljust(8, b"\0")]


class _SegmentedDownload:
    takes_all = False

    def __init__(self, server: "SdoServer", key: tuple[int, int]) -> None:
        self._server = server
        self._key = key
        self._data = bytearray()
        self._toggle = 0
        self.over = False

    def take(self, request: bytes) -> list[bytes]:
        if request[0] >> 5 != 0:
            raise SdoAbort(abort.COMMAND)
        if request[0] >> 4 & 1 != self._toggle:
            raise SdoAbort(abort.TOGGLE)
        self._data += request[1 : 8 - (request[0] >> 1 & 7)]
        answer = bytes([0x20 | self._toggle << 4]).ljust(8, b"\0")
        self._toggle ^= 1
        if request[0] & 1:
            self._server.objects.write(*self._key, bytes(self._data))
            self.over = True
        return [answer]


class SdoServer:
    """Answers one client; `answer` takes a request and returns the frames to send, in order.

    A new initiate request ends the transfer under way without a word, as most servers do.

    Args:
        answers_43h: every expedited read answer says four bytes, as the old LIR-DA158 prints it.
        sizeless: read answers state no size (42h, 40h).
        block: block transfers are offered.

    Attributes:
        block_size: segments per sub-block that the server asks for in a block download.
        crc: the server checks and computes CRCs.
        short_answers: answers are only as long as what they say.
        lose: segments of the next block download that do not arrive the first time.
        spoil_crc: the next block upload ends with a wrong CRC.
        refuse_after: (answers, abort code): the server aborts instead of this answer, once.
        silent_after: the server answers nothing after so many more answers; None for never.
        stated_size: the size that the next segmented upload announces; None for the true one.
    """

    def __init__(
        self,
        objects: ObjectDictionary,
        *,
        answers_43h: bool = False,
        sizeless: bool = False,
        block: bool = False,
    ) -> None:
        self.objects = objects
        self._answers_43h = answers_43h
        self.sizeless = sizeless
        self._block = block
        self.block_size = 20
        self.crc = True
        self.short_answers = False
        self.lose: tuple[int, ...] = ()
        self.spoil_crc = False
        self.refuse_after: tuple[int, int] | None = None
        self.silent_after: int | None = None
        self.stated_size: int | None = None
        self.reset()

    def reset(self) -> None:
        """Forget a transfer under way."""
        self._key = (0, 0)
        self._transfer: _Transfer | None = None

    @property
    def busy(self) -> bool:
        """Whether a transfer of several steps is under way."""
        return self._transfer is not None

    def give_up(self) -> bytes:
        """The abort frame for a client that does not go on."""
        frame = _multiplexed(0x80, *self._key, abort.TIMEOUT.to_bytes(4, "little"))
        self.reset()
        return frame

    def answer(self, request: bytes) -> list[bytes]:
        """Frames that answer a request; none to an abort of the client."""
        request = request.ljust(8, b"\0")
        if request[0] == 0x80:
            self.reset()
            return []
        try:
            answers = self._scripted(self._dispatch(request))
        except SdoAbort as refusal:
            index, sub = self._key
            self.reset()
            answers = [_multiplexed(0x80, index, sub, refusal.code.to_bytes(4, "little"))]
        return [_shortened(each) for each in answers] if self.short_answers else answers

    def _scripted(self, answers: list[bytes]) -> list[bytes]:
        """What becomes of answers when a fault is scripted."""
        if not answers:
            return answers
        if self.silent_after is not None:
            if self.silent_after == 0:
                return []
            self.silent_after -= 1
        if self.refuse_after is not None:
            left, code = self.refuse_after
            self.refuse_after = (left - 1, code) if left else None
            if not left:
                raise SdoAbort(code)
        return answers

    def _dispatch(self, request: bytes) -> list[bytes]:
        transfer = self._transfer
        if _starts(request[0]) and not (transfer and transfer.takes_all):
            self.reset()
            self._key = int.from_bytes(request[1:3], "little"), request[3]
            return self._start(request)
        if transfer is None:
            raise SdoAbort(abort.COMMAND)
        answers = transfer.take(request)
        if transfer.over:
            self._transfer = None
        return answers

    def _start(self, request: bytes) -> list[bytes]:
        command = request[0] >> 5
        if command == 1:
            return [self._start_download(request)]
        if command >= 5 and not self._block:
            raise SdoAbort(abort.COMMAND)
        if command == 6:
            return self._start_block_download(request)
        data = self.objects.read(*self._key)
        if command == 2 or len(data) <= request[5]:
            return [self._start_upload(data)]
        upload = BlockUpload(request[1:4], data, request, crc=self.crc, spoil_crc=self.spoil_crc)
        self.spoil_crc = False
        self._transfer = upload
        return upload.first

    def _start_upload(self, data: bytes) -> bytes:
        if 0 < len(data) <= 4:
            command = 0x43 if self._answers_43h else _EXPEDITED_BY_SIZE[len(data)]
            return _multiplexed(0x42 if self.sizeless else command, *self._key, data)
        self._transfer = _SegmentedUpload(data)
        if self.sizeless:
            return _multiplexed(0x40, *self._key)
        size, self.stated_size = self.stated_size or len(data), None
        return _multiplexed(0x41, *self._key, size.to_bytes(4, "little"))

    def _start_download(self, request: bytes) -> bytes:
        command = request[0]
        if command & 2:
            size = 4 - (command >> 2 & 3) if command & 1 else 4
            self.objects.write(*self._key, request[4 : 4 + size])
        else:
            self.objects.check_writable(*self._key)
            self._transfer = _SegmentedDownload(self, self._key)
        return _multiplexed(0x60, *self._key)

    def _start_block_download(self, request: bytes) -> list[bytes]:
        self.objects.check_writable(*self._key)
        download = BlockDownload(
            request[1:4],
            request,
            partial(self.objects.write, *self._key),
            block_size=self.block_size,
            crc=self.crc,
            lose=self.lose,
        )
        self.lose = ()
        self._transfer = download
        return download.first


def _starts(command: int) -> bool:
    """Whether a request begins a transfer."""
    kind = command >> 5
    return kind in (1, 2) or (kind == 5 and not command & 3) or (kind == 6 and not command & 1)


def _multiplexed(command: int, index: int, sub: int, data: bytes = b"") -> bytes:
    return (bytes([command]) + index.to_bytes(2, "little") + bytes([sub]) + data).ljust(8, b"\0")


def _shortened(answer: bytes) -> bytes:
    """An answer without the bytes that say nothing."""
    command = answer[0]
    if command == 0x60:
        return answer[:4]
    if command >> 5 == 2 and command & 3 == 3:
        return answer[: 8 - (command >> 2 & 3)]
    return answer
