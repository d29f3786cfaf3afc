"""One SDO client/server pair as a state machine (CiA 301 7.2.4.3): frames in, transfers out."""

from binascii import crc_hqx
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Literal

NO_ANSWER_NS = 30_000_000_000
"""A request that waits longer than this is unanswered; clients give up long before."""
READ_REQUESTS = (0x40, 0x42)
"""Initiate upload; the second as some makers print it. Other reserved bits are no SDO."""
RESET_NS = 1_000_000_000
"""A reset (or the end) this soon after a request explains why no answer came [ns]."""

Direction = Literal["upload", "download"]
Kind = Literal["expedited", "segmented", "block"]
Result = Literal["ok", "abort", "no answer", "interrupted"]


class Stage(Enum):
    """What is expected next."""

    INITIATE = auto()
    """The server's answer to the initiate request."""
    SEGMENTS = auto()
    """Segments, one answer each."""
    BLOCK_START = auto()
    """The client's start of a block upload."""
    BLOCK = auto()
    """Numbered segments without answers between."""
    BLOCK_ACKNOWLEDGE = auto()
    """The receiver's word on the numbered segments."""
    BLOCK_END = auto()
    """The sender's end frame, which holds the CRC."""
    BLOCK_END_ANSWER = auto()


@dataclass(slots=True)
class Transfer:
    """One transfer, while it runs and when it is over."""

    seq: int
    start_ns: int
    index: int
    sub: int
    direction: Direction
    kind: Kind = "expedited"
    stage: Stage = Stage.INITIATE
    data: bytearray = field(default_factory=bytearray)
    announced: int | None = None
    """Size in bytes that the protocol states; None for 22h and 42h frames."""
    end_seq: int = 0
    end_ns: int = 0
    answered_ns: int | None = None
    """Time of the server's first answer."""
    toggle: int = 0
    last_sent: bool = False
    """The sender said that nothing follows."""
    whole: bool = True
    """No segment of it is missing in the capture."""
    block: dict[int, bytes] = field(default_factory=dict)
    block_size: int = 127
    crc_used: bool = False
    crc_good: bool | None = None
    toggle_errors: int = 0
    result: Result = "ok"
    abort_code: int | None = None
    abort_by: Literal["client", "server"] | None = None

    def ended(self, result: Result) -> "Transfer":
        """The same transfer with its result."""
        self.result = result
        return self


@dataclass(slots=True)
class Strays:
    """Frames that belong to no transfer that the capture shows, by kind; never made into rows."""

    requests: int = 0
    answers: int = 0
    malformed: int = 0
    numbered: int = 0
    """Frames among them that count up like the segments of a block."""


class SdoChannel:
    """Follows the transfers between one client and one server.

    `done` is called with every transfer that ended, in the order in which they ended. Frames of
    transfers that began before the capture are counted in `strays`.
    """

    def __init__(self, bus: int, node: int, done: Callable[["SdoChannel", Transfer], None]) -> None:
        self.bus = bus
        self.node = node
        self.strays = Strays()
        self._done = done
        self._now: Transfer | None = None
        self._held: list[Transfer] = []
        self._run_command = -1
        self._run = 0
        self._answer_command = -1

    def request(self, seq: int, t_ns: int, data: bytes) -> None:
        """Take in a frame of the client."""
        if not data:
            self.strays.malformed += 1
            return
        now = self._expired(t_ns)
        command = data[0]
        if now is not None and now.direction == "download" and self._block_segment(now, data):
            now.end_seq, now.end_ns = seq, t_ns
            return
        self._count_run(command)
        match command >> 5:
            case 1 | 2:
                self._initiate(seq, t_ns, data)
            case 0 if now is not None and now.stage is Stage.SEGMENTS:
                self._download_segment(now, seq, t_ns, data)
            case 3 if now is not None and now.stage is Stage.SEGMENTS:
                self._upload_segment_request(now, seq, t_ns, command)
            case 4:
                self._abort(seq, t_ns, data, "client")
            case 5:
                self._block_upload_request(seq, t_ns, data)
            case 6:
                self._block_download_request(seq, t_ns, data)
            case _:
                self.strays.requests += 1

    def answer(self, seq: int, t_ns: int, data: bytes) -> None:
        """Take in a frame of the server."""
        if not data:
            self.strays.malformed += 1
            return
        now = self._expired(t_ns)
        command = data[0]
        if now is None:
            self.strays.answers += 1
            self.strays.numbered += command == self._answer_command + 1
            self._answer_command = command
            return
        if now.direction == "upload" and self._block_segment(now, data):
            now.end_seq, now.end_ns = seq, t_ns
            return
        if command >> 5 == 4:
            self._abort(seq, t_ns, data, "server")
        elif self._answered(now, seq, t_ns, data):
            self._release()
            now.end_seq, now.end_ns = seq, t_ns
            if now.answered_ns is None:
                now.answered_ns = t_ns
            if self._now is None:
                self._done(self, now.ended("ok"))
        else:
            self.strays.answers += 1

    def interrupt(self, t_ns: int) -> None:
        """End what runs because the node was reset."""
        if (now := self._now) is None:
            return
        waited = t_ns - now.end_ns
        waiting = now.stage is Stage.INITIATE and waited > RESET_NS
        self._close(now, "no answer" if waiting else "interrupted")

    def cut(self) -> None:
        """End what runs because nothing was heard for a while."""
        if self._now is not None:
            self._close(self._now, "interrupted")
        self._run = 0

    def finish(self, end_ns: int, timed: bool) -> None:
        """End what runs because the capture ends."""
        if timed:
            self.interrupt(end_ns)
        self.cut()
        self._release()

    def _expired(self, t_ns: int) -> Transfer | None:
        now = self._now
        if now is not None and t_ns - now.end_ns > NO_ANSWER_NS:
            self._close(now, "no answer" if now.stage is Stage.INITIATE else "interrupted")
            return None
        return now

    def _close(self, transfer: Transfer, result: Result) -> None:
        self._now = None
        transfer.result = result
        if result == "no answer" and self._run:
            self._held.append(transfer)
        else:
            self._done(self, transfer)

    def _release(self) -> None:
        """What was held back as a possible piece of a block transfer was none."""
        for transfer in self._held:
            self._done(self, transfer)
        self._held.clear()
        self._run = 0
        self._run_command = -1

    def _count_run(self, command: int) -> None:
        """Requests that count up without answers are a block download that began unseen."""
        if command == self._run_command + 1:
            self._run += 1
            self.strays.numbered += self._now is None
        else:
            self._release()
        self._run_command = command
        if self._run >= 2:
            begun = len(self._held) + (self._now is not None and self._now.answered_ns is None)
            self.strays.requests += begun
            self._held.clear()
            if begun:
                self._now = None

    def _begin(self, transfer: Transfer) -> Transfer:
        if (now := self._now) is not None:
            self._close(now, "no answer" if now.stage is Stage.INITIATE else "interrupted")
        transfer.end_seq, transfer.end_ns = transfer.seq, transfer.start_ns
        self._now = transfer
        return transfer

    def _initiate(self, seq: int, t_ns: int, data: bytes) -> None:
        if len(data) < 4 or self._run >= 2:
            self.strays.malformed += len(data) < 4
            self.strays.requests += len(data) >= 4
            return
        command, index, sub = data[0], data[1] | data[2] << 8, data[3]
        read = command >> 5 == 2
        if (read and command not in READ_REQUESTS) or command & 0xF0 == 0x30:
            self.strays.requests += 1
            return
        if read:
            self._begin(Transfer(seq, t_ns, index, sub, "upload"))
            return
        transfer = self._begin(Transfer(seq, t_ns, index, sub, "download"))
        _take_initiate(transfer, data)

    def _answered(self, now: Transfer, seq: int, t_ns: int, data: bytes) -> bool:
        """Whether an answer fits what is expected; moves the transfer on, or ends it."""
        command = data[0]
        match command >> 5, now.stage:
            case 0, Stage.SEGMENTS if now.direction == "upload":
                return self._upload_segment(now, data)
            case 1, Stage.SEGMENTS if now.direction == "download":
                return self._download_segment_answer(now, command)
            case 2, Stage.INITIATE if now.direction == "upload" and _same_object(now, data):
                return self._upload_answer(now, data)
            case 3, Stage.INITIATE if now.direction == "download" and _same_object(now, data):
                if now.kind == "segmented":
                    now.stage = Stage.SEGMENTS
                elif now.kind == "expedited":
                    self._now = None
                return now.kind != "block"
            case 5, _ if now.direction == "download":
                return self._block_download_answer(now, data)
            case 6, _ if now.direction == "upload":
                return self._block_upload_answer(now, data)
        return False

    def _upload_answer(self, now: Transfer, data: bytes) -> bool:
        """An answer of the expedited or segmented protocol, also to a block request."""
        if _take_initiate(now, data) == "segmented":
            now.stage = Stage.SEGMENTS
        else:
            self._now = None
        return True

    def _download_segment(self, now: Transfer, seq: int, t_ns: int, data: bytes) -> None:
        if now.direction != "download":
            self.strays.requests += 1
            return
        toggle = data[0] >> 4 & 1
        now.end_seq, now.end_ns = seq, t_ns
        if toggle != now.toggle:
            now.toggle_errors += 1
            return
        now.block[0] = data[1 : 8 - (data[0] >> 1 & 7)]
        now.last_sent = bool(data[0] & 1)

    def _download_segment_answer(self, now: Transfer, command: int) -> bool:
        if command >> 4 & 1 != now.toggle:
            now.toggle_errors += 1
            return True
        now.data += now.block.pop(0, b"")
        now.toggle ^= 1
        if now.last_sent:
            self._now = None
        return True

    def _upload_segment_request(self, now: Transfer, seq: int, t_ns: int, command: int) -> None:
        if now.direction != "upload":
            self.strays.requests += 1
            return
        now.end_seq, now.end_ns = seq, t_ns
        now.toggle_errors += command >> 4 & 1 != now.toggle

    def _upload_segment(self, now: Transfer, data: bytes) -> bool:
        if data[0] >> 4 & 1 != now.toggle:
            now.toggle_errors += 1
            return True
        now.data += data[1 : 8 - (data[0] >> 1 & 7)]
        now.toggle ^= 1
        if data[0] & 1:
            self._now = None
        return True

    def _block_upload_request(self, seq: int, t_ns: int, data: bytes) -> None:
        now, what = self._now, data[0] & 3
        if what == 0 and len(data) >= 5:
            index, sub = data[1] | data[2] << 8, data[3]
            transfer = self._begin(Transfer(seq, t_ns, index, sub, "upload", "block"))
            transfer.crc_used, transfer.block_size = bool(data[0] & 4), data[4] & 0x7F
            return
        if now is None or now.kind != "block" or now.direction != "upload":
            self.strays.requests += 1
            return
        now.end_seq, now.end_ns = seq, t_ns
        if what == 3 and now.stage is Stage.BLOCK_START:
            now.stage = Stage.BLOCK
        elif what == 2 and len(data) >= 3:
            _acknowledge(now, data[1], data[2])
        elif what == 1 and now.stage is Stage.BLOCK_END_ANSWER:
            self._now = None
            self._done(self, now.ended("ok"))

    def _block_upload_answer(self, now: Transfer, data: bytes) -> bool:
        if data[0] & 1 == 0 and now.stage is Stage.INITIATE and _same_object(now, data):
            now.crc_used = now.crc_used and bool(data[0] & 4)
            if data[0] & 2:
                now.announced = int.from_bytes(data[4:8], "little")
            now.stage = Stage.BLOCK_START
            return True
        if data[0] & 1 and now.stage in (Stage.BLOCK_END, Stage.BLOCK_ACKNOWLEDGE):
            _end_of_block_transfer(now, data)
            return True
        return False

    def _block_download_request(self, seq: int, t_ns: int, data: bytes) -> None:
        now = self._now
        if data[0] & 1 == 0 and len(data) >= 4:
            index, sub = data[1] | data[2] << 8, data[3]
            transfer = self._begin(Transfer(seq, t_ns, index, sub, "download", "block"))
            transfer.crc_used = bool(data[0] & 4)
            if data[0] & 2:
                transfer.announced = int.from_bytes(data[4:8], "little")
        elif now is not None and now.kind == "block" and now.stage is Stage.BLOCK_END:
            now.end_seq, now.end_ns = seq, t_ns
            _end_of_block_transfer(now, data)
        else:
            self.strays.requests += 1

    def _block_download_answer(self, now: Transfer, data: bytes) -> bool:
        what = data[0] & 3
        if what == 0 and now.stage is Stage.INITIATE and _same_object(now, data):
            now.crc_used = now.crc_used and bool(data[0] & 4)
            now.block_size = data[4] & 0x7F if len(data) > 4 else 127
            now.stage = Stage.BLOCK
            return True
        if what == 2 and now.stage in (Stage.BLOCK, Stage.BLOCK_ACKNOWLEDGE) and len(data) >= 3:
            _acknowledge(now, data[1], data[2])
            return True
        if what == 1 and now.stage is Stage.BLOCK_END_ANSWER:
            self._now = None
            return True
        return False

    def _block_segment(self, now: Transfer, data: bytes) -> bool:
        """Take in a numbered segment; its first byte may look like any command, even an abort."""
        number = data[0] & 0x7F
        expected = len(now.block) + 1
        if now.stage is not Stage.BLOCK or not expected <= number <= now.block_size:
            return False
        now.whole = now.whole and number == expected
        now.block[number] = data[1:8]
        now.last_sent = bool(data[0] & 0x80)
        if now.last_sent or number == now.block_size:
            now.stage = Stage.BLOCK_ACKNOWLEDGE
        return True

    def _abort(self, seq: int, t_ns: int, data: bytes, by: Literal["client", "server"]) -> None:
        now = self._now
        named = data[1:4] if len(data) >= 4 else b""
        fits = now is not None and (
            now.stage is not Stage.INITIATE or _same_object(now, data) or named in (b"", bytes(3))
        )
        if now is None or not fits:
            self.strays.requests += by == "client"
            self.strays.answers += by == "server"
            return
        self._release()
        now.end_seq, now.end_ns = seq, t_ns
        if by == "server" and now.answered_ns is None:
            now.answered_ns = t_ns
        now.abort_code, now.abort_by = int.from_bytes(data[4:8], "little"), by
        self._close(now, "abort")


def _same_object(now: Transfer, data: bytes) -> bool:
    return len(data) >= 4 and data[1] | data[2] << 8 == now.index and data[3] == now.sub


def _take_initiate(transfer: Transfer, data: bytes) -> Kind:
    """Read e, s, n and the bytes of a frame that initiates a download or answers an upload."""
    command = data[0]
    transfer.kind = "expedited" if command & 2 else "segmented"
    if transfer.kind == "segmented":
        transfer.announced = int.from_bytes(data[4:8], "little") if command & 1 else None
        return transfer.kind
    if command & 1:
        transfer.announced = 4 - (command >> 2 & 3)
    transfer.data = bytearray(data[4 : 4 + (transfer.announced or 4)])
    return transfer.kind


def _acknowledge(now: Transfer, last_good: int, block_size: int) -> None:
    """Keep the segments of a block that the receiver has; the sender repeats the others."""
    if now.stage not in (Stage.BLOCK, Stage.BLOCK_ACKNOWLEDGE):
        return
    for number in sorted(now.block):
        if number <= last_good:
            now.data += now.block[number]
    everything = not now.block or last_good >= max(now.block)
    now.whole = now.whole and last_good <= len(now.block)
    now.block.clear()
    now.block_size = block_size & 0x7F
    now.stage = Stage.BLOCK_END if now.last_sent and everything else Stage.BLOCK


def _end_of_block_transfer(now: Transfer, data: bytes) -> None:
    """Drop the bytes that the last segment does not use, and check the CRC (CRC-16/XMODEM)."""
    if now.block:
        _acknowledge(now, max(now.block), now.block_size)
    unused = data[0] >> 2 & 7
    if unused:
        del now.data[-unused:]
    if now.crc_used and now.whole and len(data) >= 3:
        now.crc_good = crc_hqx(bytes(now.data), 0) == data[1] | data[2] << 8
    now.stage = Stage.BLOCK_END_ANSWER
