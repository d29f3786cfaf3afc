"""A stretch of SDO frames on its way through the channels: plain transfers in runs, the rest singly."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.sdo.channel import SdoChannel
from syncline_analyzer.folds.sdo.pairs import Plain, SdoFrames
from syncline_schemas.named_tuples import NamedTuple


class Side(NamedTuple):
    """Whose frames an identifier carries: the client's or the server's of a channel."""

    channel: SdoChannel
    request: bool
    can_id: int

    def feed(self, seq: int, t_ns: int, data: bytes) -> None:
        """Hand one frame to the channel."""
        if self.request:
            self.channel.client_id = self.can_id
        take = self.channel.request if self.request else self.channel.answer
        take(seq, t_ns, data)


class Stretch:
    """Frames between which no server moves.

    A channel takes its plain transfers in a run as soon as another frame of its own follows, if it
    waits for nothing then; else they go through it frame by frame. What one channel does says
    nothing of another, so only each channel's own order counts.

    Args:
        batch, rows: the SDO frames, in their order.
        side: whose frames an identifier of a bus carries (bus << 11 | identifier).

    Attributes:
        channels: by the number in the columns.
        place: of the frame that a channel is taking in.
    """

    def __init__(
        self, batch: IndexedBatch, rows: NDArray[np.intp], side: Callable[[int], Side]
    ) -> None:
        frames = batch.frames
        keys = frames.bus[rows].astype(np.uint32) << 11 | frames.can_id[rows]
        distinct, self._of = _numbered(keys)
        self._sides = [side(key) for key in distinct.tolist()]
        numbers: dict[int, int] = {}
        channel = [numbers.setdefault(id(each.channel), len(numbers)) for each in self._sides]
        self.channels = list({id(each.channel): each.channel for each in self._sides}.values())
        self._frames = SdoFrames(
            batch.seqs_at(rows),
            frames.t_ns[rows],
            np.minimum(frames.dlc[rows], 8).astype(np.uint8),
            _first_eight(frames.data, rows),
            np.array(channel, np.uint16)[self._of],
            np.array([each.request for each in self._sides])[self._of],
            np.array([each.can_id for each in self._sides], np.int16)[self._of],
        )
        self.place = 0
        self._plain = plain = self._frames.plain()
        self._by_channel = np.argsort(plain.channel, kind="stable")
        self._keys = self._key(plain.channel, plain.answer)[self._by_channel]
        self._reached = self._up_to(0)
        self._whole = np.zeros(len(plain), np.bool_)
        self._handed = 0

    def singles(self) -> Iterator[int]:
        """Places of the frames that are no part of plain transfers, each when it is its turn."""
        alone = np.ones(len(self._of), np.bool_)
        alone[self._plain.ask] = alone[self._plain.answer] = False
        places = np.flatnonzero(alone)
        channel = self._frames.channel[places]
        before = np.searchsorted(self._keys, self._key(channel, places))
        for at, number, upto in zip(
            places.tolist(), channel.tolist(), before.tolist(), strict=True
        ):
            self._run(number, upto)
            yield at

    def feed(self, at: int) -> None:
        """Hand one frame to its channel."""
        self.place = at
        frames = self._frames
        data = frames.data[at, : frames.length[at]].tobytes()
        self._sides[self._of[at]].feed(int(frames.seq[at]), int(frames.t_ns[at]), data)

    def catch_up(self, at: int | None = None) -> Plain:
        """Let all channels take in their plain transfers that end before a place, or all of them.

        Returns: those that were taken in as a whole since the last call.
        """
        stop = len(self._of) if at is None else at
        for number, upto in enumerate(self._up_to(stop)):
            self._run(number, upto)
        first, self._handed = self._handed, int(np.searchsorted(self._plain.answer, stop))
        whole = self._whole[first : self._handed]
        if whole.all():
            return self._plain.part(slice(first, self._handed))
        return self._plain.part(first + np.flatnonzero(whole))

    def open_asks(self, at: int) -> None:
        """Hand over the requests before a place whose answers come after it."""
        plain = self._plain
        for ask in plain.ask[(plain.ask < at) & (plain.answer > at)].tolist():
            self.feed(ask)

    def _run(self, number: int, upto: int) -> None:
        """Let a channel take in its plain transfers up to one of them."""
        first, self._reached[number] = self._reached[number], upto
        channel = self.channels[number]
        for each in range(first, upto):
            at = int(self._by_channel[each])
            ask, answer = int(self._plain.ask[at]), int(self._plain.answer[at])
            if channel.expects(int(self._frames.data[ask, 0])):
                run = self._by_channel[each:upto]
                last = int(run[-1])
                channel.client_id = int(self._plain.client[last])
                data = self._frames.data[self._plain.answer[last]].tobytes()
                channel.take(len(run), self._plain.transfer(last), data)
                self._whole[run] = True
                return
            self.feed(ask)
            self.feed(answer)

    def _up_to(self, stop: int) -> list[int]:
        """By channel, the place in `_by_channel` up to which its answers come before another place."""
        numbers = np.arange(len(self.channels))
        upto: list[int] = np.searchsorted(self._keys, self._key(numbers, stop)).tolist()
        return upto

    def _key(
        self, channel: NDArray[np.integer], place: NDArray[np.intp] | int
    ) -> NDArray[np.int64]:
        """Channel and place as one number that sorts by both."""
        return channel.astype(np.int64) * (len(self._of) + 1) + place


def _numbered(keys: NDArray[np.integer]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The distinct keys, ascending, and the number of each key among them.

    >>> _numbered(np.array([7, 3, 7], np.uint32))
    (array([3, 7]), array([1, 0, 1]))
    """
    held = np.bincount(keys) > 0
    return np.flatnonzero(held), (np.cumsum(held) - 1).take(keys)


def _first_eight(data: NDArray[np.uint8], rows: NDArray[np.intp]) -> NDArray[np.uint8]:
    """(n, 8) the first bytes of some rows; words are gathered several times as fast as bytes."""
    words = np.ascontiguousarray(data[:, :8]).view(np.uint64)[:, 0]
    return words.take(rows).view(np.uint8).reshape(-1, 8)
