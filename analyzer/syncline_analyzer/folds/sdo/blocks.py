"""The block protocol after its initiate frames (CiA 301 7.2.4.3.9 to .15)."""

from binascii import crc_hqx
from enum import Enum, auto

from syncline_analyzer.folds.sdo.transfer import Step, Transfer

LONGEST_BLOCK = 127
_END, _END_MASK = 0xC1, 0xE3
"""End of a block transfer: C1h with the number of unused bytes in bits 4..2."""


class Stage(Enum):
    """What is expected next."""

    START = auto()
    """The client's word that a block upload may begin."""
    SEGMENTS = auto()
    """Numbered segments without answers between."""
    ACKNOWLEDGE = auto()
    """The receiver's word on the numbered segments."""
    END = auto()
    """The sender's end frame, which holds the CRC."""
    CLOSE = auto()
    """The receiver's answer to it."""


class Block:
    """Follows the numbered segments of one transfer; the sender is the server of an upload.

    The first byte of a segment may look like any command, even an abort: only its number counts.
    """

    def __init__(self, transfer: Transfer, crc_used: bool, size: int = LONGEST_BLOCK) -> None:
        self._transfer = transfer
        self._upload = transfer.direction == "upload"
        self._data = bytearray()
        transfer.data = self._data
        self._crc_used = crc_used
        self._size = size & 0x7F or LONGEST_BLOCK
        self._stage = Stage.START if self._upload else Stage.SEGMENTS
        self._segments: dict[int, bytes] = {}
        self._highest = 0
        self._last_sent = False

    def request(self, data: bytes, late: bool) -> Step:
        """Take in a frame of the client; `late`: long after the one before."""
        return self._from_receiver(data) if self._upload else self._from_sender(data, late)

    def answer(self, data: bytes, late: bool) -> Step:
        """Take in a frame of the server; `late`: long after the one before."""
        return self._from_sender(data, late) if self._upload else self._from_receiver(data)

    def _from_sender(self, data: bytes, late: bool) -> Step:
        ends = data[0] & _END_MASK == _END and (
            self._stage is Stage.END
            or (self._stage is Stage.SEGMENTS and not self._highest and not any(data[3:]))
        )
        if not ends and self._segment(data, late):
            return Step.TAKEN
        if data[0] & _END_MASK == _END and (ends or self._stage is Stage.ACKNOWLEDGE):
            self._end(data)
            return Step.TAKEN
        return Step.NOT_MINE

    def _segment(self, data: bytes, late: bool) -> bool:
        number = data[0] & 0x7F
        if not number or self._stage in (Stage.END, Stage.CLOSE):
            return False
        if self._stage is Stage.ACKNOWLEDGE or number <= self._highest:
            if number != 1:
                return self._segments.get(number) == data[1:8]
            self._unheard()
        if number > self._size or (late and number != self._highest + 1):
            return False
        self._segments[number] = data[1:8]
        self._highest = number
        self._last_sent = data[0] >= 0x80
        full = self._last_sent or number == self._size
        self._stage = Stage.ACKNOWLEDGE if full else Stage.SEGMENTS
        return True

    def _from_receiver(self, data: bytes) -> Step:
        if data[0] >> 5 != 5:
            return Step.NOT_MINE
        match data[0] & 3, self._stage:
            case 3, Stage.START:
                self._stage = Stage.SEGMENTS
            case 2, Stage.SEGMENTS | Stage.ACKNOWLEDGE if len(data) >= 3:
                self._acknowledge(data[1], data[2])
            case 2, Stage.END:
                pass
            case 1, Stage.CLOSE:
                return Step.DONE
            case 1, Stage.ACKNOWLEDGE | Stage.END:
                self._unheard()
                return Step.DONE
            case _:
                return Step.NOT_MINE
        return Step.TAKEN

    def _acknowledge(self, last_good: int, size: int) -> None:
        """Keep the segments that the receiver has; the sender repeats the others."""
        complete = self._last_sent and 0 < self._highest <= last_good
        self._keep(last_good)
        self._size = size & 0x7F or LONGEST_BLOCK
        self._stage = Stage.END if complete else Stage.SEGMENTS

    def _keep(self, last_good: int) -> None:
        transfer, segments = self._transfer, self._segments
        for number in range(1, last_good + 1):
            segment = segments.pop(number, None)
            if segment is None:
                transfer.whole = False
            else:
                self._data += segment
        transfer.repeated += bool(segments)
        segments.clear()
        self._highest = 0

    def _unheard(self) -> None:
        """A frame between is not in the capture: most likely all segments were acknowledged."""
        self._keep(self._highest)
        self._transfer.whole = False

    def _end(self, data: bytes) -> None:
        """Drop the bytes that the last segment does not use, and check the CRC (CRC-16/XMODEM)."""
        if self._segments:
            self._unheard()
        if unused := data[0] >> 2 & 7:
            del self._data[-unused:]
        transfer = self._transfer
        transfer.whole = transfer.whole and transfer.announced in (None, len(self._data))
        if self._crc_used and len(data) >= 3:
            self._check(data[1] | data[2] << 8)
        self._stage = Stage.CLOSE

    def _check(self, crc: int) -> None:
        """A matching CRC proves that nothing is missing; where pieces are, another proves nothing."""
        transfer = self._transfer
        good = crc_hqx(self._data, 0) == crc
        transfer.crc_good = good if good or transfer.whole else None
        transfer.whole = transfer.whole or good
