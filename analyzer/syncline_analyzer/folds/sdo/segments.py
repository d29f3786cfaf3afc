"""The segmented protocol after its initiate frames (CiA 301 7.2.4.3.4 and .7)."""

from syncline_analyzer.folds.sdo.transfer import Step, Transfer
from syncline_schemas.canopen.sdo import ClientCommand, ServerCommand

UNNOTICED = 14
"""Bytes that two segments hold: as many may be missing in the capture with all toggles right."""


class Segments:
    """Follows the segments of one transfer; each is asked for, or confirmed, one by one.

    A toggle bit that stands still is counted and, unless the segment repeats the last one, the
    data are taken all the same: the client does so as well when it goes on. Only the announced
    size then proves that no segments are missing in the capture.
    """

    def __init__(self, transfer: Transfer) -> None:
        self._transfer = transfer
        self._upload = transfer.direction == "upload"
        client, server = ClientCommand, ServerCommand
        self._requests = client.UPLOAD_SEGMENT if self._upload else client.DOWNLOAD_SEGMENT
        self._answers = server.UPLOAD_SEGMENT if self._upload else server.DOWNLOAD_SEGMENT
        self._data = bytearray()
        transfer.data = self._data
        self._toggle = 0
        self._asked: int | None = None
        self._sent: bytes | None = None
        self._last = b""

    def request(self, data: bytes, late: bool) -> Step:
        """Take in a frame of the client."""
        if data[0] >> 5 != self._requests:
            return Step.NOT_MINE
        if not self._upload:
            self._send(data)
            return Step.TAKEN
        toggle = data[0] >> 4 & 1
        if self._asked is not None and toggle != self._asked:
            self._transfer.whole = False
            self._toggle = toggle
        self._asked = toggle
        return Step.TAKEN

    def answer(self, data: bytes, late: bool) -> Step:
        """Take in a frame of the server."""
        if data[0] >> 5 != self._answers:
            return Step.NOT_MINE
        return self._uploaded(data) if self._upload else self._confirmed(data[0] >> 4 & 1)

    def _uploaded(self, data: bytes) -> Step:
        toggle, asked = data[0] >> 4 & 1, self._asked
        if asked is None and toggle != self._toggle:
            return Step.NOT_MINE
        self._asked = None
        return self._take(data, toggle, toggle == self._toggle and asked in (None, toggle))

    def _take(self, data: bytes, toggle: int, alternated: bool) -> Step:
        segment = data[1 : 8 - (data[0] >> 1 & 7)]
        if not alternated:
            self._transfer.toggle_errors += 1
            if segment == self._last:
                return Step.TAKEN
        self._data += segment
        self._last = segment
        self._toggle = toggle ^ 1
        return self._over() if data[0] & 1 else Step.TAKEN

    def _send(self, data: bytes) -> None:
        sent = self._sent
        if sent is not None and (sent[0] ^ data[0]) & 0x10:
            was = sent[0] >> 4 & 1
            self._take(sent, was, was == self._toggle)
        elif sent is not None and sent != data:
            self._transfer.whole = False
        self._sent = data

    def _confirmed(self, toggle: int) -> Step:
        sent, self._sent = self._sent, None
        if sent is None:
            if toggle != self._toggle:
                return Step.NOT_MINE
            self._transfer.whole = False
            self._toggle ^= 1
            return Step.TAKEN
        was = sent[0] >> 4 & 1
        return self._take(sent, was, was == self._toggle and toggle == was)

    def _over(self) -> Step:
        transfer = self._transfer
        missing = None if transfer.announced is None else transfer.announced - len(self._data)
        if transfer.toggle_errors:
            transfer.whole = missing == 0
        elif missing is not None and missing > 0 and missing % UNNOTICED == 0:
            transfer.whole = False
        return Step.DONE
