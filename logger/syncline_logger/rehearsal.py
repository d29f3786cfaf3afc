"""What the first chunk needs, done once before the first frame is taken."""

from dataclasses import replace
from io import BytesIO

from syncline_logger.decoding import LiveDecoder
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata, Compression
from syncline_schemas.capture.writer import CaptureWriter

_FRAMES = (
    (0x000, b"\x01\x00"),
    (0x080, b""),
    (0x085, bytes(8)),
    (0x605, bytes.fromhex("4000100000000000")),
    (0x585, bytes.fromhex("4300100000000000")),
    (0x705, b"\x05"),
)
"""NMT, SYNC, EMCY, SDO request and answer, heartbeat."""


def rehearse(compression: Compression) -> None:
    """Decode and write a few frames to nowhere.

    Loading the libraries takes seconds on a slow gateway; done at the first chunk, these would be
    seconds that a power cut costs.
    """
    frames = FrameBatch.from_rows((0, 0, i, 0, len(data), data) for i, data in _FRAMES)
    decoded = LiveDecoder({0: "a"}).decode(frames, frames.t_ns)
    writer = CaptureWriter(
        BytesIO(), CaptureMetadata("", ""), [BusInfo("a", 0)], compression=compression
    )
    blocks = [
        replace(block, channel=writer.add_channel(spec.topic, spec.schema))
        for spec, block in decoded.blocks
    ]
    writer.write_chunk(frames, frames.t_ns, blocks)
    writer.finish()
