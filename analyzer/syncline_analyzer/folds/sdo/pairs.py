"""Plain SDO transfers, found columnar: one expedited request, and its answer right after it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.sdo.transfer import Direction, Transfer

_READ = 0x40
_Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class SdoFrames:
    """SDO frames of a stretch as columns of length n, in arrival order.

    Attributes:
        seq, t_ns: of each frame.
        length: bytes of each frame, at most 8.
        data: (n, 8) uint8.
        channel: number of the client/server pair that each frame belongs to.
        request: whether the client sent it.
    """

    seq: _Ints
    t_ns: _Ints
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]
    channel: NDArray[np.uint16]
    request: NDArray[np.bool_]

    def pairs(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Places of the requests and the answers of all plain transfers, by the answer's place.

        Plain: two frames of 8 bytes of one channel with none of its frames between, which name
        the same object; 40h and an expedited answer, or an expedited download and 60h.
        """
        order = np.argsort(self.channel, kind="stable")
        asks, answers = order[:-1], order[1:]
        words = self.data.view("<u4")[:, 0]
        command, first = words & 0xFF, self.data[:, 0]
        same = self.channel[asks] == self.channel[answers]
        turns = self.request[asks] & ~self.request[answers]
        whole = (self.length[asks] == 8) & (self.length[answers] == 8)
        names = words[asks] >> 8 == words[answers] >> 8
        read = (command[asks] == _READ) & (first[answers] & 0xE2 == 0x42)
        write = (first[asks] & 0xF2 == 0x22) & (first[answers] & 0xE0 == 0x60)
        plain = np.flatnonzero(same & turns & whole & names & (read | write))
        plain = plain[np.argsort(answers[plain], kind="stable")]
        return asks[plain], answers[plain]

    def transfers(self, asks: NDArray[np.intp], answers: NDArray[np.intp]) -> list[Transfer]:
        """The transfers of these pairs, complete."""
        read = self.data[asks, 0] == _READ
        held = np.where(read, answers, asks)
        command = self.data[held, 0]
        size = np.where(command & 1, 4 - (command >> 2 & 3), 0)
        names = self.data[asks].view("<u4")[:, 0] >> 8
        payload = self.data[held, 4:].tobytes()
        columns = (
            self.seq[asks], self.t_ns[asks], names & 0xFFFF, names >> 16, read, size,
            self.seq[answers], self.t_ns[answers], np.arange(len(asks)) * 4,
        )  # fmt: skip
        directions: tuple[Direction, Direction] = ("download", "upload")
        return [
            Transfer(
                seq,
                start_ns,
                index,
                sub,
                directions[upload],
                "expedited",
                payload[at : at + (bytes_ or 4)],
                bytes_ or None,
                end_seq,
                end_ns,
                end_ns,
            )
            for seq, start_ns, index, sub, upload, bytes_, end_seq, end_ns, at in zip(
                *(column.tolist() for column in columns), strict=True
            )
        ]
