"""What waits in memory while the disk refuses, and what found no room there."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from syncline_logger.capture_file import Block
from syncline_logger.clocks_in_force import knots_of
from syncline_logger.content import Content
from syncline_logger.decoding import ChannelSpec
from syncline_logger.gap_notes import gap_block, gaps_of, join_into, joined
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import GAP_TOPIC, MARK_TOPIC

MAX_WAITING_FRAMES = 1 << 18
"""Eight seconds of four full buses."""
MAX_WAITING_CONTENTS = 1000
"""A quarter of an hour of buses on which nothing happens."""
MAX_REASONS = 200
"""Of gaps that are joined because too many came while the disk refused."""


@dataclass(slots=True)
class WaitingRoom:
    """Contents in order; once one found no room none gets in, so that what is lost is one stretch.

    Attributes:
        contents: that wait.
        lost_frames: that were ever lost here, by bus number.
        lost_clocks: samples of adapters' clocks that were lost here.
    """

    contents: deque[Content] = field(default_factory=deque)
    lost_frames: dict[int, int] = field(default_factory=dict)
    lost_clocks: dict[int, tuple[ChannelSpec, bytes]] = field(default_factory=dict)
    max_frames: int = MAX_WAITING_FRAMES
    _missed: dict[int, Gap] = field(default_factory=dict)
    _notes: list[Block] = field(default_factory=list)
    _joined: dict[tuple[int | None, str], Gap] = field(default_factory=dict)
    _joined_ns: int = 0

    @property
    def frames(self) -> int:
        """Frames that wait."""
        return sum(len(each.frames) for each in self.contents)

    def add(self, content: Content, reason: str) -> None:
        """Keep a content, or count its frames as lost for this reason."""
        full = (
            self.frames + len(content.frames) > self.max_frames
            or len(self.contents) >= MAX_WAITING_CONTENTS
        )
        if full or self._missed:
            self.lose(content, reason)
        else:
            self.contents.append(content)

    def give_up(self, reason: str) -> None:
        """Count all that waits as lost."""
        while self.contents:
            self.lose(self.contents.popleft(), reason)

    def take_missed(self) -> tuple[list[Gap], list[Block]]:
        """What was lost since the last call: gaps by bus, and the notes of what was lost."""
        missed, notes = list(self._missed.values()), self._notes
        if self._joined:
            notes.append(gap_block(list(self._joined.values()), self._joined_ns))
        self._missed, self._notes, self._joined = {}, [], {}
        return missed, notes

    def lose(self, content: Content, reason: str) -> None:
        """Count the frames of a content as lost."""
        for bus in np.unique(content.frames.bus).tolist():
            gap = _gap(content.frames, bus, reason)
            self.lost_frames[bus] = self.lost_frames.get(bus, 0) + (gap.lost_frames or 0)
            self._missed[bus] = joined(self._missed[bus], gap) if bus in self._missed else gap
        self.lost_clocks.update(knots_of(content))
        notes = [each for each in content.blocks if each[0].topic in (GAP_TOPIC, MARK_TOPIC)]
        room = MAX_WAITING_CONTENTS - len(self._notes)
        self._notes += notes[:room]
        for gap in gaps_of(notes[room:]):
            join_into(self._joined, gap, MAX_REASONS)
            self._joined_ns = content.last_ns


def _gap(frames: FrameBatch, bus: int, reason: str) -> Gap:
    t_ns = frames.t_ns[frames.bus == bus]
    return Gap(int(t_ns.min()), int(t_ns.max()) + 1, reason, len(t_ns), bus)
