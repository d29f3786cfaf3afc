"""The ring: what comes out is what went in, and what goes when there is no room."""

import numpy as np

from syncline_logger.content import Content
from syncline_logger.decoding import UNREGISTERED, ChannelSpec
from syncline_logger.triggers.ring import Ring
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import GAP_TOPIC
from syncline_schemas.capture.message import MessageBlock, MessageSchema

S = 1_000_000_000
SCHEMA = MessageSchema("x", "", b"")


def content(at_s: int, frames: int = 20, width: int = 8, seed: int = 0) -> Content:
    """Random frames of one second, a gap message and a decoded channel."""
    random = np.random.default_rng(seed + at_s)
    log_ns = at_s * S + np.arange(frames, dtype=np.int64) * 1000
    batch = FrameBatch(
        log_ns - random.integers(0, 500, frames),
        random.integers(0, 4, frames, np.uint8),
        random.integers(0, 0x800, frames).astype(np.uint32),
        np.zeros(frames, np.uint16),
        np.full(frames, width, np.uint8),
        random.integers(0, 256, (frames, width)).astype(np.uint8),
    )
    gap = MessageBlock.of_messages(UNREGISTERED, [at_s * S], [at_s * S], [b"gap"])
    pdo = MessageBlock.of_rows(UNREGISTERED, log_ns, log_ns, batch.data)
    return Content(
        batch,
        log_ns,
        [
            (ChannelSpec(GAP_TOPIC, SCHEMA), gap),
            (ChannelSpec("/canopen/a/node1/tpdo1", SCHEMA), pdo),
        ],
    )


def same(found: Content, wanted: Content) -> bool:
    frames = ("t_ns", "bus", "can_id", "flags", "dlc", "data")
    blocks = ("log_time_ns", "publish_time_ns", "length", "payload")
    return (
        all(np.array_equal(getattr(found.frames, n), getattr(wanted.frames, n)) for n in frames)
        and np.array_equal(found.log_ns, wanted.log_ns)
        and [spec for spec, _ in found.blocks] == [spec for spec, _ in wanted.blocks]
        and all(
            np.array_equal(getattr(a, n), getattr(b, n))
            for (_, a), (_, b) in zip(found.blocks, wanted.blocks, strict=True)
            for n in blocks
        )
    )


def test_what_comes_out_is_what_went_in() -> None:
    ring = Ring(10 * S, 1 << 20)
    given = [content(0), content(1, width=64), content(2, frames=0)]
    given[2] = Content(given[2].frames, given[2].log_ns, given[2].blocks[:1])
    for n, each in enumerate(given):
        ring.add(each, n * S)
    assert len(ring) == 3
    assert all(same(ring.pop(), each) for each in given)
    assert (len(ring), ring.bytes) == (0, 0)


def test_what_is_older_than_wanted_goes() -> None:
    ring = Ring(3 * S, 1 << 20)
    for n in range(10):
        ring.add(content(n), n * S + S // 2)
    assert ring.first_ns == 7 * S
    assert not ring.short
    ring.add(Content(FrameBatch.empty(), np.zeros(0, np.int64)), 100 * S)
    assert len(ring) == 0


def test_decoded_channels_go_first_then_the_oldest() -> None:
    whole = Ring(100 * S, 1 << 30)
    for n in range(10):
        whole.add(content(n), n * S)
    ring = Ring(100 * S, int(whole.bytes * 0.8))
    for n in range(10):
        ring.add(content(n), n * S)
    assert len(ring) == 10
    assert 0 < ring.thinned < 10
    assert not ring.short
    first = ring.pop()
    assert [spec.topic for spec, _ in first.blocks] == [GAP_TOPIC]
    assert np.array_equal(first.frames.data, content(0).frames.data)

    small = Ring(100 * S, whole.bytes // 4)
    for n in range(10):
        small.add(content(n), n * S)
    assert small.bytes <= whole.bytes // 4
    assert small.short
    assert small.first_ns is not None
    assert small.first_ns > 0
