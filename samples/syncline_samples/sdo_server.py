"""The SDO server of a simulated node (CiA 301 7.2.4): expedited, segmented, block upload."""

from syncline_samples import abort
from syncline_samples.objects import ObjectDictionary, SdoAbort

_EXPEDITED_BY_SIZE = {1: 0x4F, 2: 0x4B, 3: 0x47, 4: 0x43}
_CRC16_POLYNOMIAL = 0x1021


def crc16(data: bytes) -> int:
    """CRC of a block transfer: x^16 + x^12 + x^5 + 1, initial value 0 (CiA 301 7.2.4.3.16).

    >>> hex(crc16(b"123456789"))
    '0x31c3'
    """
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ _CRC16_POLYNOMIAL if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


class SdoServer:
    """Answers one client; `answer` takes a request and returns the frames to send, in order.

    Args:
        answers_43h: every expedited read answer says four bytes, as the old LIR-DA158 prints it.
        sizeless: expedited read answers state no size (42h).
        block: block upload is offered.
    """

    def __init__(
        self,
        objects: ObjectDictionary,
        *,
        answers_43h: bool = False,
        sizeless: bool = False,
        block: bool = False,
    ) -> None:
        self._objects = objects
        self._answers_43h = answers_43h
        self._sizeless = sizeless
        self._block = block
        self.reset()

    def reset(self) -> None:
        """Forget a transfer under way."""
        self._key = (0, 0)
        self._upload: bytes | None = None
        self._download: bytearray | None = None
        self._toggle = 0
        self._blocks: bytes | None = None
        self._block_size = 0
        self._position = 0

    def answer(self, request: bytes) -> list[bytes]:
        """Frames that answer a request; none to an abort of the client."""
        request = request.ljust(8, b"\0")
        if request[0] == 0x80:
            self.reset()
            return []
        try:
            return self._dispatch(request)
        except SdoAbort as refusal:
            index, sub = self._key
            self.reset()
            return [_multiplexed(0x80, index, sub, refusal.code.to_bytes(4, "little"))]

    def _dispatch(self, request: bytes) -> list[bytes]:
        command = request[0] >> 5
        if command == 1:
            self._key = _key(request)
            return [self._start_download(request)]
        if command == 2:
            self._key = _key(request)
            return [self._start_upload()]
        if command == 3 and self._upload is not None:
            return [self._next_segment(request[0])]
        if command == 0 and self._download is not None:
            return [self._take_segment(request)]
        if command == 5 and self._block:
            return self._block_upload(request)
        raise SdoAbort(abort.COMMAND)

    def _start_upload(self) -> bytes:
        data = self._objects.read(*self._key)
        if len(data) <= 4:
            command = 0x43 if self._answers_43h else _EXPEDITED_BY_SIZE[len(data)]
            return _multiplexed(0x42 if self._sizeless else command, *self._key, data)
        self._upload, self._toggle = data, 0
        return _multiplexed(0x41, *self._key, len(data).to_bytes(4, "little"))

    def _next_segment(self, command: int) -> bytes:
        self._check_toggle(command)
        assert self._upload is not None
        part, rest = self._upload[:7], self._upload[7:]
        answer = bytes([self._toggle << 4 | (7 - len(part)) << 1 | (not rest)]) + part
        self._upload = rest or None
        self._toggle ^= 1
        return answer.ljust(8, b"\0")

    def _check_toggle(self, command: int) -> None:
        if command >> 4 & 1 != self._toggle:
            raise SdoAbort(abort.TOGGLE)

    def _start_download(self, request: bytes) -> bytes:
        command = request[0]
        if command & 2:
            size = 4 - (command >> 2 & 3) if command & 1 else 4
            self._objects.write(*self._key, request[4 : 4 + size])
        else:
            self._download, self._toggle = bytearray(), 0
        return _multiplexed(0x60, *self._key)

    def _take_segment(self, request: bytes) -> bytes:
        self._check_toggle(request[0])
        assert self._download is not None
        self._download += request[1 : 8 - (request[0] >> 1 & 7)]
        answer = bytes([0x20 | self._toggle << 4]).ljust(8, b"\0")
        self._toggle ^= 1
        if request[0] & 1:
            self._objects.write(*self._key, bytes(self._download))
            self._download = None
        return answer

    def _block_upload(self, request: bytes) -> list[bytes]:
        subcommand = request[0] & 3
        if subcommand == 0:
            return self._start_block(request)
        if self._blocks is None:
            raise SdoAbort(abort.COMMAND)
        if subcommand == 3:
            self._position = 0
            return self._send_block()
        if subcommand == 2:
            self._position += 7 * request[1]
            self._block_size = request[2]
            return self._send_block() if self._position < len(self._blocks) else [self._end_block()]
        self._blocks = None
        return []

    def _start_block(self, request: bytes) -> list[bytes]:
        self._key = _key(request)
        self._blocks = self._objects.read(*self._key)
        self._block_size = request[4]
        return [_multiplexed(0xC6, *self._key, len(self._blocks).to_bytes(4, "little"))]

    def _send_block(self) -> list[bytes]:
        assert self._blocks is not None
        segments = []
        for number in range(1, self._block_size + 1):
            at = self._position + 7 * (number - 1)
            last = at + 7 >= len(self._blocks)
            part = self._blocks[at : at + 7].ljust(7, b"\0")
            segments.append(bytes([last << 7 | number]) + part)
            if last:
                break
        return segments

    def _end_block(self) -> bytes:
        assert self._blocks is not None
        unused = -len(self._blocks) % 7
        crc = crc16(self._blocks).to_bytes(2, "little")
        return (bytes([0xC1 | unused << 2]) + crc).ljust(8, b"\0")


def _key(request: bytes) -> tuple[int, int]:
    return int.from_bytes(request[1:3], "little"), request[3]


def _multiplexed(command: int, index: int, sub: int, data: bytes = b"") -> bytes:
    return (bytes([command]) + index.to_bytes(2, "little") + bytes([sub]) + data).ljust(8, b"\0")
