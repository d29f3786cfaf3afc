"""Block transfers (CiA 301 7.2.4.3.9 to 16), the server's side, and their CRC."""

from collections.abc import Callable

from syncline_samples import abort
from syncline_samples.objects import SdoAbort

_CRC16_POLYNOMIAL = 0x1021
SEGMENT_BYTES = 7


def _crc_step(crc: int) -> int:
    for _ in range(8):
        crc = (crc << 1 ^ _CRC16_POLYNOMIAL if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


_CRC_OF_BYTE = [_crc_step(byte << 8) for byte in range(256)]


def crc16(data: bytes) -> int:
    """CRC of a block transfer: x^16 + x^12 + x^5 + 1, initial value 0 (CiA 301 7.2.4.3.16).

    >>> hex(crc16(b"123456789"))
    '0x31c3'
    """
    crc = 0
    for byte in data:
        crc = (crc << 8 ^ _CRC_OF_BYTE[crc >> 8 ^ byte]) & 0xFFFF
    return crc


def segments_from(data: bytes, position: int, count: int) -> list[bytes]:
    """Numbered segments of one sub-block, from a byte position on."""
    segments = []
    for number in range(1, count + 1):
        at = position + SEGMENT_BYTES * (number - 1)
        last = at + SEGMENT_BYTES >= len(data)
        part = data[at : at + SEGMENT_BYTES].ljust(SEGMENT_BYTES, b"\0")
        segments.append(bytes([last << 7 | number]) + part)
        if last:
            break
    return segments


class SubBlock:
    """The receiver's side of a sub-block: what came in order, and what is to be told of it.

    Args:
        lose: segments, counted over the whole transfer from 0, that do not arrive the first time.
    """

    def __init__(self, lose: tuple[int, ...] = ()) -> None:
        self._lose = set(lose)
        self.data = bytearray()
        self.expected = 1
        self.whole = False

    def take(self, segment: bytes, size: int) -> int | None:
        """Take in a segment; at the end of the sub-block the number to acknowledge, else None."""
        number, last = segment[0] & 0x7F, bool(segment[0] & 0x80)
        ordinal = len(self.data) // SEGMENT_BYTES
        if number == self.expected and ordinal in self._lose:
            self._lose.discard(ordinal)
        elif number == self.expected:
            self.data += segment[1:].ljust(SEGMENT_BYTES, b"\0")
            self.expected += 1
            self.whole = last
        if not last and number < size:
            return None
        acknowledged, self.expected = self.expected - 1, 1
        return acknowledged


class BlockUpload:
    """The server sends numbered segments and the client acknowledges each sub-block."""

    takes_all = False

    def __init__(
        self, head: bytes, data: bytes, request: bytes, *, crc: bool, spoil_crc: bool
    ) -> None:
        self._data = data
        self._block_size = request[4] & 0x7F
        self._crc = crc16(data) if crc and request[0] & 4 else 0
        self._crc ^= 0x0101 if spoil_crc else 0
        self._position = 0
        self.over = False
        self.first = [bytes([0xC2 | crc << 2]) + head + len(data).to_bytes(4, "little")]

    def take(self, request: bytes) -> list[bytes]:
        """Frames that answer a request."""
        what = request[0] & 3
        if request[0] >> 5 != 5:
            raise SdoAbort(abort.COMMAND)
        if what == 1:
            self.over = True
            return []
        if what == 2:
            self._position += SEGMENT_BYTES * request[1]
            self._block_size = request[2] & 0x7F
        if self._position >= len(self._data):
            unused = -len(self._data) % SEGMENT_BYTES
            return [(bytes([0xC1 | unused << 2]) + self._crc.to_bytes(2, "little")).ljust(8, b"\0")]
        return segments_from(self._data, self._position, self._block_size)


class BlockDownload:
    """The client sends numbered segments, the server acknowledges each sub-block."""

    def __init__(
        self,
        head: bytes,
        request: bytes,
        store: Callable[[bytes], None],
        *,
        block_size: int,
        crc: bool,
        lose: tuple[int, ...],
    ) -> None:
        self._store = store
        self._block_size = block_size
        self._crc_used = crc and bool(request[0] & 4)
        self._received = SubBlock(lose)
        self._ending = False
        self.over = False
        self.first = [bytes([0xA4 if crc else 0xA0]) + head + bytes([block_size, 0, 0, 0])]

    @property
    def takes_all(self) -> bool:
        """Whether segments are expected."""
        return not self._ending

    def take(self, request: bytes) -> list[bytes]:
        """Frames that answer a segment or the end; nothing to segments within a sub-block."""
        if self._ending:
            return self._end(request)
        acknowledged = self._received.take(request, self._block_size)
        if acknowledged is None:
            return []
        self._ending = self._received.whole
        return [bytes([0xA2, acknowledged, self._block_size]).ljust(8, b"\0")]

    def _end(self, request: bytes) -> list[bytes]:
        if request[0] & 0xE3 != 0xC1:
            raise SdoAbort(abort.COMMAND)
        unused = request[0] >> 2 & 7
        data = bytes(self._received.data)
        data = data[: len(data) - unused]
        if self._crc_used and int.from_bytes(request[1:3], "little") != crc16(data):
            raise SdoAbort(abort.CRC)
        self._store(data)
        self.over = True
        return [b"\xa1".ljust(8, b"\0")]
