"""How adapters' stamps become t, repeated at the begin of each file so that it can be read alone."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from syncline_logger.content import Content
from syncline_logger.decoding import UNREGISTERED, ChannelSpec
from syncline_schemas.capture.layout import CLOCK_TOPIC
from syncline_schemas.capture.message import MessageBlock
from syncline_schemas.proto import syncline_pb2

Knots = Mapping[int, tuple[ChannelSpec, bytes]]
"""By bus number, the latest clock sample of its adapter: its channel and its message."""


def knots_of(content: Content) -> Knots:
    """The last clock samples of adapters in a content."""
    found = {}
    for spec, block in content.blocks:
        if spec.topic != CLOCK_TOPIC:
            continue
        ends = np.cumsum(block.length)
        for begin, end in zip((ends - block.length).tolist(), ends.tolist(), strict=True):
            payload = block.payload[begin:end].tobytes()
            sample = syncline_pb2.ClockSample.FromString(payload)
            if sample.HasField("bus"):
                found[sample.bus] = (spec, payload)
    return found


@dataclass(slots=True)
class ClocksInForce:
    """The latest sample of each adapter's clock; fed with what was recorded, in its order."""

    _knots: dict[int, tuple[ChannelSpec, bytes]] = field(default_factory=dict)

    def note(self, knots: Knots) -> None:
        """Take in samples that are later than those before."""
        self._knots.update(knots)

    def before(self, content: Content) -> Content:
        """A content with the samples that are in force when it begins."""
        if not self._knots or not content:
            return content
        spec = next(iter(self._knots.values()))[0]
        payloads = [payload for _, (_, payload) in sorted(self._knots.items())]
        times = [content.first_ns] * len(payloads)
        head = MessageBlock.of_messages(UNREGISTERED, times, times, payloads)
        return replace(content, blocks=[(spec, head), *content.blocks])
