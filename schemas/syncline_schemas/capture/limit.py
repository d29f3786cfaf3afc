"""Chunks that need not be read where only a stretch of a capture is wanted."""

from collections.abc import Callable, Iterable

from syncline_schemas.capture.channels import ChannelTable, Kind
from syncline_schemas.capture.lag import LagBounds
from syncline_schemas.capture.record_file import ChunkPlace
from syncline_schemas.records import dataclass

_LEFT_OUT = (Kind.FRAME, Kind.STATUS, Kind.CLOCK, Kind.OTHER)
"""What a chunk that is not read may hold. A gap stands where it ends, which may be long after."""


@dataclass(frozen=True, slots=True)
class Unread:
    """A chunk that was left out; `frames` of it come before the wanted stretch."""

    start_ns: int
    end_ns: int
    frames: int
    told: Callable[[int], object]

    def tell(self) -> None:
        """Say how many frames were left out."""
        if self.frames:
            self.told(self.frames)


@dataclass(frozen=True, slots=True)
class Limit:
    """A wanted stretch [start_ns, end_ns), and whom to tell what was left out before it."""

    start_ns: int
    end_ns: int
    told: Callable[[int], object]

    def unread(self, place: ChunkPlace, lag: LagBounds, channels: ChannelTable) -> Unread | None:
        """The chunk as one to be left out; None when it may hold something that is wanted.

        lag: how far log times, by which chunks are found, are behind the stamps.
        """
        before = place.end_ns - lag.min_ns < self.start_ns
        if not before and place.start_ns - lag.max_ns < self.end_ns:
            return None
        messages = place.messages()
        if messages is None or any(channels.kind[each] not in _LEFT_OUT for each in messages):
            return None
        frames = _frames(messages, channels) if before else 0
        return Unread(place.start_ns, place.end_ns, frames, self.told)


def last_frames(places: Iterable[ChunkPlace], channels: ChannelTable) -> set[ChunkPlace]:
    """The chunks that hold the last frames of a bus: what comes behind them is silence."""
    last: dict[int, ChunkPlace] = {}
    for place in places:
        for channel in place.messages() or ():
            if channels.kind[channel] == Kind.FRAME:
                last[channel] = place
    return set(last.values())


def _frames(messages: dict[int, int], channels: ChannelTable) -> int:
    return sum(n for channel, n in messages.items() if channels.kind[channel] == Kind.FRAME)
