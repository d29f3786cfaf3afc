"""Words for SDO frames; those of segments and blocks need what went before (CiA 301 7.2.4.3)."""

from syncline_analyzer.decode.part import Tone, Words
from syncline_analyzer.decode.values import object_words, value_words
from syncline_analyzer.views.words import hex_code
from syncline_schemas.canopen.sdo import (
    LOAD_SIGNATURE,
    SAVE_SIGNATURE,
    ClientCommand,
    ServerCommand,
    abort_meaning,
)
from syncline_schemas.devices import Device

MAX_COLLECTED = 1 << 16
"""Bytes of a transfer that are kept to tell its value."""
_ABORT = 0x80
_SIGNATURES = {
    (0x1010, SAVE_SIGNATURE): '"save"',
    (0x1011, LOAD_SIGNATURE): '"load"',
}


def stands_alone(command: int, *, request: bool) -> bool:
    """Whether a frame says all by itself: an expedited transfer, its answer, an abort.

    >>> stands_alone(0x2B, request=True), stands_alone(0x21, request=True)
    (True, False)
    """
    kind = command >> 5
    if request:
        expedited = kind == ClientCommand.INITIATE_DOWNLOAD and bool(command & 2)
        return expedited or kind in (ClientCommand.INITIATE_UPLOAD, ClientCommand.ABORT)
    expedited = kind == ServerCommand.INITIATE_UPLOAD and bool(command & 2)
    return expedited or kind in (ServerCommand.INITIATE_DOWNLOAD, ServerCommand.ABORT)


def plain_words(device: Device | None, data: bytes, *, request: bool) -> Words:
    """A frame that stands alone, or begins a transfer.

    >>> plain_words(None, bytes.fromhex("4018100100000000"), request=True).text
    'read 1018h:01 identity: vendor-ID'
    >>> plain_words(None, bytes.fromhex("8017100000000206"), request=False).text
    'abort 1017h:00 producer heartbeat time: 06020000h object does not exist'
    """
    if len(data) < 4:
        return Words(f"SDO frame with {len(data)} bytes", Tone.BAD, opaque=True)
    command, index, sub = data[0], data[1] | data[2] << 8, data[3]
    named = object_words(device, index, sub)
    kind = command >> 5
    if kind == ClientCommand.ABORT:
        code = int.from_bytes(data[4:8], "little")
        return Words(f"abort {named}: {hex_code(code, 8)} {abort_meaning(code)}", Tone.BAD)
    if request and kind == ClientCommand.INITIATE_UPLOAD:
        return Words(f"read {named}")
    if not request and kind == ServerCommand.INITIATE_DOWNLOAD:
        return Words(f"{named} written")
    verb = "write " if request else ""
    if command & 2:
        return Words(f"{verb}{named} = {_value(device, index, sub, _expedited(data))}")
    size = f"{int.from_bytes(data[4:8], 'little')} bytes " if command & 1 else ""
    return Words(f"{verb}{named}: {size}in segments")


def _expedited(data: bytes) -> bytes:
    unused = data[0] >> 2 & 3 if data[0] & 1 else 0
    return data[4 : 8 - unused]


def _value(device: Device | None, index: int, sub: int, data: bytes) -> str:
    signature = _SIGNATURES.get((index, int.from_bytes(data[:4], "little")))
    return signature or value_words(device, index, sub, data)


class SdoTalk:
    """What a client and a server say to each other, frame by frame."""

    def __init__(self) -> None:
        self._object: tuple[int, int] | None = None
        self._write = False
        self._blocks = False
        """Segments of a block come next, which look like anything."""
        self._last = False
        self._data = bytearray()

    @property
    def idle(self) -> bool:
        """Whether no transfer in segments or blocks is under way."""
        return self._object is None

    def request(self, device: Device | None, data: bytes) -> Words:
        """A frame of the client."""
        if not data:
            return Words("SDO request without data", Tone.BAD)
        if self._blocks and self._write and data[0] != _ABORT:
            return self._block_segment(device, data)
        kind = data[0] >> 5
        if kind == ClientCommand.DOWNLOAD_SEGMENT:
            return self._segment(device, data)
        if kind == ClientCommand.UPLOAD_SEGMENT:
            return Words(f"next segment{self._of(device)}", Tone.QUIET)
        if kind == ClientCommand.BLOCK_UPLOAD:
            return self._block_read(device, data)
        if kind == ClientCommand.BLOCK_DOWNLOAD:
            return self._block_write(device, data)
        if kind == ClientCommand.UNKNOWN:
            return Words(f"unknown SDO command {hex_code(data[0], 2)}", Tone.BAD, opaque=True)
        return self._plain(device, data, request=True)

    def answer(self, device: Device | None, data: bytes) -> Words:
        """A frame of the server."""
        if not data:
            return Words("SDO answer without data", Tone.BAD)
        if self._blocks and not self._write and data[0] != _ABORT:
            return self._block_segment(device, data)
        kind = data[0] >> 5
        if kind == ServerCommand.UPLOAD_SEGMENT:
            return self._segment(device, data)
        if kind == ServerCommand.DOWNLOAD_SEGMENT:
            return Words(f"segment taken{self._of(device)}", Tone.QUIET)
        if kind == ServerCommand.BLOCK_DOWNLOAD:
            return self._block_write_answer(device, data)
        if kind == ServerCommand.BLOCK_UPLOAD:
            return self._block_read_answer(device, data)
        if kind == ServerCommand.UNKNOWN:
            return Words(f"unknown SDO answer {hex_code(data[0], 2)}", Tone.BAD, opaque=True)
        return self._plain(device, data, request=False)

    def _plain(self, device: Device | None, data: bytes, *, request: bool) -> Words:
        segmented = len(data) >= 4 and not stands_alone(data[0], request=request)
        if segmented:
            self._begin(data, write=request)
        elif request or data[0] >> 5 == ServerCommand.ABORT or not self._awaits_segments(data):
            self._end()
        return plain_words(device, data, request=request)

    def _awaits_segments(self, data: bytes) -> bool:
        """Whether the server acknowledges a write whose segments follow."""
        mine = self._object == (data[1] | data[2] << 8, data[3]) if len(data) >= 4 else False
        return self._write and mine

    def _begin(self, data: bytes, *, write: bool) -> None:
        self._object, self._write = (data[1] | data[2] << 8, data[3]), write
        self._blocks = self._last = False
        self._data.clear()

    def _end(self) -> None:
        self._object = None
        self._blocks = self._last = False
        self._data.clear()

    def _of(self, device: Device | None) -> str:
        return f" of {object_words(device, *self._object)}" if self._object else ""

    def _told(self, device: Device | None) -> str:
        """The value of the whole transfer, which ends with this."""
        if self._object is None:
            return ""
        return f" = {value_words(device, *self._object, bytes(self._data))}"

    def _segment(self, device: Device | None, data: bytes) -> Words:
        content = data[1 : 8 - (data[0] >> 1 & 7)]
        if len(self._data) < MAX_COLLECTED:
            self._data += content
        if not data[0] & 1:
            return Words(f"segment{self._of(device)}, {len(content)} bytes")
        words = Words(f"last segment{self._of(device)}{self._told(device)}")
        self._end()
        return words

    def _block_segment(self, device: Device | None, data: bytes) -> Words:
        if len(self._data) < MAX_COLLECTED:
            self._data += data[1:8]
        self._last = bool(data[0] & 0x80)
        self._blocks = not self._last
        last = "last " if self._last else ""
        return Words(f"{last}block segment {data[0] & 0x7F}{self._of(device)}", Tone.QUIET)

    def _block_write(self, device: Device | None, data: bytes) -> Words:
        if data[0] & 1:
            return self._block_end(device, data)
        if len(data) >= 4:
            self._begin(data, write=True)
        size = f", {int.from_bytes(data[4:8], 'little')} bytes" if data[0] & 2 else ""
        return Words(f"write{self._of(device).removeprefix(' of')} in blocks{size}")

    def _block_write_answer(self, device: Device | None, data: bytes) -> Words:
        what = data[0] & 3
        if what == 0:
            self._blocks = self._write and self._object is not None
            size = f", {data[4]} segments a block" if len(data) > 4 else ""
            return Words(f"blocks accepted{self._of(device)}{size}")
        if what == 2:
            self._blocks = not self._last and self._object is not None
            return _taken(data, self._of(device))
        words = Words(f"block transfer{self._of(device)} done")
        self._end()
        return words

    def _block_read(self, device: Device | None, data: bytes) -> Words:
        what = data[0] & 3
        if what == 0 and len(data) >= 4:
            self._begin(data, write=False)
            return Words(f"read{self._of(device).removeprefix(' of')} in blocks")
        if what == 3:
            self._blocks = self._object is not None
            return Words(f"begin blocks{self._of(device)}", Tone.QUIET)
        if what == 2:
            self._blocks = not self._last and self._object is not None
            return _taken(data, self._of(device))
        words = Words(f"block transfer{self._of(device)} done")
        self._end()
        return words

    def _block_read_answer(self, device: Device | None, data: bytes) -> Words:
        if data[0] & 1:
            return self._block_end(device, data)
        size = f", {int.from_bytes(data[4:8], 'little')} bytes" if data[0] & 2 else ""
        return Words(f"blocks follow{self._of(device)}{size}")

    def _block_end(self, device: Device | None, data: bytes) -> Words:
        """The sender's last frame: how many bytes of the last segment count, and the CRC."""
        unused = data[0] >> 2 & 7
        if unused and len(self._data) < MAX_COLLECTED:
            del self._data[-unused:]
        crc = f", CRC {int.from_bytes(data[1:3], 'little'):04X}h" if len(data) >= 3 else ""
        return Words(f"end of blocks{self._of(device)}{self._told(device)}{crc}")


def _taken(data: bytes, of: str) -> Words:
    """An acknowledged block: the last segment that arrived, and how many the next one may have."""
    if len(data) < 3:
        return Words(f"block taken{of}", Tone.QUIET)
    return Words(f"block taken{of} up to segment {data[1]}, next {data[2]}", Tone.QUIET)
