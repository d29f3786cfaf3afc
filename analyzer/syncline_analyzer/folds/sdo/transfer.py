"""One SDO transfer and what its frames say (CiA 301 7.2.4.3)."""

from enum import Enum, auto
from typing import Literal

from syncline_schemas.records import dataclass

Direction = Literal["upload", "download"]
Kind = Literal["expedited", "segmented", "block"]
Result = Literal["ok", "abort", "no answer", "interrupted"]
Side = Literal["client", "server"]
Ender = Literal["request", "reset", "gap", "end"]
OddKind = Literal["late", "doubled", "wrong"]


class Step(Enum):
    """What a running transfer makes of a frame."""

    NOT_MINE = auto()
    TAKEN = auto()
    DONE = auto()


@dataclass(slots=True)
class Refusal:
    """An abort frame: who sent it, when, and its code (None where the frame is cut short)."""

    by: Side
    code: int | None
    seq: int
    t_ns: int


@dataclass(slots=True)
class Transfer:
    """One transfer, while it runs and when it is over.

    Attributes:
        announced: bytes that the protocol states; None for 22h and 42h frames.
        answered_ns: time of the server's first answer.
        whole: no piece of it is missing in the capture.
        crc_good: whether a block transfer's CRC fits its data; None where there is none to check.
        toggle_errors: segments whose toggle bit did not alternate.
        repeated: how often the receiver asked for segments of a block again.
        ended_by: what broke it off, or what made the client give up waiting.
        given_up_ns: when the client gave up waiting for the first answer.
        stray_abort: an abort that names another object, while this one waited for its answer.
        client_id: identifier of the client's frames, None where none of them was seen.
        crc_offered, block_size: what the client's request for a block transfer says.
    """

    seq: int
    start_ns: int
    index: int
    sub: int
    direction: Direction
    kind: Kind = "expedited"
    data: bytes | bytearray = b""
    announced: int | None = None
    end_seq: int = 0
    end_ns: int = 0
    answered_ns: int | None = None
    whole: bool = True
    crc_good: bool | None = None
    toggle_errors: int = 0
    repeated: int = 0
    result: Result = "ok"
    abort_code: int | None = None
    abort_by: Side | None = None
    ended_by: Ender | None = None
    given_up_ns: int | None = None
    stray_abort: Refusal | None = None
    crc_offered: bool = False
    block_size: int = 0
    client_id: int | None = None

    def names(self, data: bytes) -> bool:
        """Whether a frame carries this object's index and subindex."""
        return len(data) >= 4 and data[3] == self.sub and data[1] | data[2] << 8 == self.index

    def heard(self, seq: int, t_ns: int) -> None:
        """Take in when its last frame came."""
        self.end_seq, self.end_ns = seq, t_ns

    def answered(self, seq: int, t_ns: int) -> None:
        """Take in when the server answered."""
        self.end_seq, self.end_ns = seq, t_ns
        if self.answered_ns is None:
            self.answered_ns = t_ns

    def refuse(self, refusal: Refusal) -> None:
        """End with an abort."""
        self.result, self.abort_code, self.abort_by = "abort", refusal.code, refusal.by
        if refusal.by == "server":
            self.answered(refusal.seq, refusal.t_ns)
        else:
            self.heard(refusal.seq, refusal.t_ns)

    def take_initiate(self, data: bytes) -> None:
        """Read e, s, n and the bytes of a frame that initiates a download or answers an upload."""
        command = data[0]
        if not command & 2:
            self.kind = "segmented"
            self.data = bytearray()
            self.announced = int.from_bytes(data[4:8], "little") if command & 1 else None
            return
        self.kind = "expedited"
        size = 4 - (command >> 2 & 3) if command & 1 else None
        self.announced = size
        self.data = data[4 : 4 + (size or 4)]
        self.whole = len(self.data) >= (size or 1)

    def exchange_answers(self, other: "Transfer") -> None:
        """Give this transfer the answer that another one, of the same object, was credited with."""
        for name in _ANSWER:
            mine, others = getattr(self, name), getattr(other, name)
            setattr(self, name, others)
            setattr(other, name, mine)


_ANSWER = (
    "kind", "data", "announced", "end_seq", "end_ns", "answered_ns", "whole", "result",
    "abort_code", "abort_by", "ended_by",
)  # fmt: skip


@dataclass(slots=True)
class Strays:
    """Frames that belong to no transfer that the capture shows, by kind; never made into rows."""

    requests: int = 0
    answers: int = 0
    malformed: int = 0
    numbered: int = 0
    """Frames among them that count up like the segments of a block."""

    def add(self, other: "Strays") -> None:
        """Count those of another channel too."""
        self.requests += other.requests
        self.answers += other.answers
        self.malformed += other.malformed
        self.numbered += other.numbered


@dataclass(frozen=True, slots=True)
class Oddity:
    """An answer that should not be.

    Attributes:
        kind: "late" (the client had given up or asked again), "doubled" (the request was already
            answered) or "wrong" (of another object than the one that is asked for).
        asked: the transfer that it belongs to or was taken for.
        seq, t_ns: of the answer.
        since_ns: when it was asked for; when the first answer came for a doubled one.
        named: object that the answer names.
        differs: a doubled answer says something else than the first one.
    """

    kind: OddKind
    asked: Transfer
    seq: int
    t_ns: int
    since_ns: int
    named: tuple[int, int]
    differs: bool = False
