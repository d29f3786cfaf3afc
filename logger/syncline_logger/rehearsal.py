"""What the first chunk needs, done once before the first frame is taken."""

from dataclasses import replace
from io import BytesIO

from syncline_logger.decoding import Decoded, LiveDecoder
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata, Compression
from syncline_schemas.capture.writer import CaptureWriter

_FRAMES = (
    (0x000, b"\x01\x00"),
    (0x080, b""),
    (0x085, bytes(8)),
    (0x185, bytes(8)),
    (0x605, bytes.fromhex("4000100000000000")),
    (0x585, bytes.fromhex("4300100000000000")),
    (0x705, b"\x05"),
)
"""NMT, SYNC, EMCY, TPDO, SDO request and answer, heartbeat."""


def rehearse(compression: Compression, *, decode: bool = True) -> str:
    """Decode and write a few frames to nowhere; what failed, in words, never raised.

    Loading the libraries takes seconds on a slow gateway; done at the first chunk, these would be
    seconds that a power cut costs.
    """
    try:
        _rehearse(compression, decode=decode)
    except Exception as error:  # noqa: BLE001 - what is broken here must not cost the recording
        return f"the rehearsal before the first frame failed: {type(error).__name__}: {error}"
    return ""


def _rehearse(compression: Compression, *, decode: bool) -> None:
    frames = FrameBatch.from_rows((0, 0, i, 0, len(data), data) for i, data in _FRAMES)
    decoded = LiveDecoder({0: "a"}).decode(frames, frames.t_ns) if decode else Decoded()
    writer = CaptureWriter(
        BytesIO(), CaptureMetadata("", ""), [BusInfo("a", 0)], compression=compression
    )
    blocks = [
        replace(block, channel=writer.add_channel(spec.topic, spec.schema))
        for spec, block in decoded.blocks
    ]
    writer.write_chunk(frames, frames.t_ns, blocks)
    writer.finish()
