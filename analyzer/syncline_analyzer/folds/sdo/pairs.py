"""Plain SDO transfers, found columnar: one expedited request, and its answer right after it."""

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.sdo.transfer import Transfer
from syncline_schemas import native
from syncline_schemas.records import dataclass

SERVERS = range(0x1200, 0x1280)
"""SDO server parameters: 1200h is the default server, the others are additional ones."""
_READ = 0x40
_HELD = np.array([0xFFFFFFFF, 0xFF, 0xFFFF, 0xFFFFFF, 0xFFFFFFFF], np.uint32)
"""Bits of the four data bytes that are the value, by the size that is stated; 0: none is."""
_Ints = NDArray[np.int64]
_Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class SdoFrames:
    """SDO frames of a stretch as columns of length n, in arrival order.

    Attributes:
        seq, t_ns: of each frame.
        length: bytes of each frame, at most 8.
        data: (n, 8) uint8.
        channel: number of the client/server pair that each frame belongs to.
        request: whether the client sent it.
        can_id: identifier of each frame.
    """

    seq: _Ints
    t_ns: _Ints
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]
    channel: NDArray[np.uint16]
    request: NDArray[np.bool_]
    can_id: NDArray[np.int16]

    def pairs(self) -> tuple[_Places, _Places]:
        """Places of the requests and the answers of all plain transfers, by the answer's place.

        Plain: two frames of 8 bytes of one channel with none of its frames between, which name
        the same object; 40h and an expedited answer, or an expedited download and 60h. Those that
        tell where a server is are none: they may decide what the frames after them mean.
        """
        if native.available():
            return native.sdo_pairs(self.length, self.data, self.channel, self.request)
        order = np.argsort(self.channel, kind="stable")
        asks, answers = order[:-1], order[1:]
        turns = self.request[asks] & ~self.request[answers]
        turns &= self.channel[asks] == self.channel[answers]
        turns &= (self.length[asks] == 8) & (self.length[answers] == 8)
        asks, answers = asks[turns], answers[turns]
        words = self.data.view("<u4")[:, 0]
        asked, answered = words[asks], words[answers]
        read = (asked & 0xFF == _READ) & (answered & 0xE2 == 0x42)
        write = (asked & 0xF2 == 0x22) & (answered & 0xE0 == 0x60)
        apart = (asked >> 8 & 0xFF80) != SERVERS.start
        plain = (asked >> 8 == answered >> 8) & (read | write) & apart
        asks, answers = asks[plain], answers[plain]
        by_answer = np.argsort(answers, kind="stable")
        return asks[by_answer], answers[by_answer]

    def plain(self) -> "Plain":
        """The plain transfers."""
        asks, answers = self.pairs()
        words = self.data.view("<u8")[:, 0]
        asked = words[asks]
        read = (asked & 0xFF) == _READ
        held = np.where(read, words[answers], asked)
        command = held.astype(np.uint8)
        size = np.where(command & 1, 4 - (command >> 2 & 3), 0).astype(np.uint8)
        return Plain(
            asks,
            answers,
            self.channel[asks],
            (asked >> 8).astype(np.uint32) & np.uint32(0xFFFFFF),
            read,
            size,
            (held >> 32).astype(np.uint32) & _HELD[size],
            self.seq[asks],
            self.t_ns[asks],
            self.seq[answers],
            self.t_ns[answers],
            self.can_id[asks],
        )


@dataclass(frozen=True, slots=True)
class Plain:
    """Plain transfers as columns of length n, in the order of their answers.

    Attributes:
        ask, answer: places of their frames in the stretch.
        channel: as in `SdoFrames`.
        name: index of the object and, from bit 16 on, its sub-index.
        read: whether it is an upload.
        size: bytes that the frame states; 0 where it states none, and holds four.
        word: the value, little endian.
        seq, start_ns, end_seq, end_ns: of their frames.
        client: identifier of the request.
    """

    ask: _Places
    answer: _Places
    channel: NDArray[np.uint16]
    name: NDArray[np.uint32]
    read: NDArray[np.bool_]
    size: NDArray[np.uint8]
    word: NDArray[np.uint32]
    seq: _Ints
    start_ns: _Ints
    end_seq: _Ints
    end_ns: _Ints
    client: NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.ask)

    def part(self, rows: slice | _Places) -> "Plain":
        """Some of them, in their order."""
        return Plain(*(getattr(self, f.name)[rows] for f in fields(Plain)))

    def data(self, at: int) -> bytes:
        """The bytes of one value."""
        return int(self.word[at]).to_bytes(4, "little")[: int(self.size[at]) or 4]

    def transfer(self, at: int) -> Transfer:
        """One of them, complete."""
        name, end_ns = int(self.name[at]), int(self.end_ns[at])
        return Transfer(
            int(self.seq[at]),
            int(self.start_ns[at]),
            name & 0xFFFF,
            name >> 16,
            "upload" if self.read[at] else "download",
            "expedited",
            self.data(at),
            int(self.size[at]) or None,
            int(self.end_seq[at]),
            end_ns,
            end_ns,
            client_id=int(self.client[at]),
        )
