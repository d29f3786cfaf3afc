"""Small valid files of everything that is read, from which fuzzing starts."""

import gzip
import tempfile
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from random import Random

import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from benchmarks.mutation import mutated
from syncline_analyzer.bundle.make import Case, make_bundle
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.capture.gap_message import gap_message
from syncline_schemas.capture.layout import (
    GAP_TOPIC,
    BusInfo,
    CaptureMetadata,
    description_attachment,
)
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.devices.catalog import load_device
from syncline_schemas.proto import syncline_pb2
from tests.analyzer import binary_files, text_files
from tests.analyzer.log_frames import FRAMES
from tests.analyzer.mf4_files import canedge, kind_of, listed_mf4, logger_mf4, mf4
from tests.schemas.test_xdd import XDC

_LOBJ_BYTES = 16
_CONTAINER_BYTES = 16
_LOGG_BYTES = 144
_SCREEN_DELTA = (
    b" (000.000000)  can0  080   [0]\n (000.010512)  can0  181   [4]  01 02 03 04\n"
    b"DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)\n"
    b" (000.000101)  can0  701   [1]  remote request\n"
)
_TRC_10 = (
    b";   Start time: 14.11.2023 22:13:20.000.0\n     1)  1059 0300 2 00 04\n"
    b"     2)  1060 FFFFFFFF 4 00 00 00 04 BUSLIGHT\n     3)  1070 00000300 2 RTR\n"
)
_ASC_RELATIVE = (
    b"date Die Nov 14 22:13:20.000 2023\nbase dec  timestamps relative\n"
    b" 0.5 1  385 Rx d 2 16 255\n 0.25 1  Statistic: D 0\n 0.25 2  ErrorFrame\n"
    b" 0.1 1  419361537x Tx r 3\n"
)
_LOGGED = [frame for frame in FRAMES if not frame[3] & (FrameFlag.FD | FrameFlag.ERROR)]
"""What the logger that is imitated by hand can hold."""


def capture(compression: str = "zstd") -> bytes:
    """A Syncline capture with everything in it."""
    stream = BytesIO()
    writer = CaptureWriter(
        stream,
        CaptureMetadata("1", "abc", created_ns=FRAMES[0][0]),
        [BusInfo("can0", 0, 500_000), BusInfo("can1", 1, 250_000)],
        compression=compression,  # type: ignore[arg-type]
        attachments=[description_attachment("[bus.can0]\nbitrate = 500000\n")],
    )
    half = len(FRAMES) // 2
    writer.write_frames(FrameBatch.from_rows(FRAMES[:half]))
    gap = Gap(FRAMES[half - 1][0], FRAMES[half][0], "the adapter lost frames", 3, 0)
    payload = gap_message(gap).SerializeToString()
    channel = writer.add_channel(GAP_TOPIC, schema_of(syncline_pb2.Gap.DESCRIPTOR))
    at_ns = np.array([gap.end_ns], np.int64)
    length = np.array([len(payload)], np.int64)
    block = MessageBlock(channel, at_ns, at_ns, length, np.frombuffer(payload, np.uint8))
    writer.write_chunk(FrameBatch.empty(), messages=[block])
    writer.write_frames(FrameBatch.from_rows(FRAMES[half:]))
    writer.finish()
    return stream.getvalue()


def _bare(raw: bytes) -> bytes:
    """The messages of an MCAP file without packing and check sums, so that damage gets through."""
    out = BytesIO()
    writer = Writer(
        out, compression=CompressionType.NONE, enable_crcs=False, enable_data_crcs=False
    )
    reader = make_reader(BytesIO(raw))
    writer.start(reader.get_header().profile, "x")
    channels: dict[int, int] = {}
    for schema, channel, message in reader.iter_messages():
        if channel.id not in channels:
            number = 0
            if schema is not None:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, number, channel.metadata
            )
        writer.add_message(
            channels[channel.id], message.log_time, message.data, message.publish_time
        )
    for metadata in reader.iter_metadata():
        writer.add_metadata(metadata.name, metadata.metadata)
    for file in reader.iter_attachments():
        writer.add_attachment(
            file.create_time, file.log_time, file.name, file.media_type, file.data
        )
    writer.finish()
    return out.getvalue()


def _bare_blf(raw: bytes) -> bytes:
    """A BLF whose containers are not packed."""
    import zlib

    out, at = raw[:_LOGG_BYTES], _LOGG_BYTES
    while at + _LOBJ_BYTES + _CONTAINER_BYTES <= len(raw):
        size = int.from_bytes(raw[at + 8 : at + 12], "little")
        body = raw[at + _LOBJ_BYTES + _CONTAINER_BYTES : at + size]
        if raw[at + _LOBJ_BYTES] == 2:
            body = zlib.decompress(body)
        whole = _LOBJ_BYTES + _CONTAINER_BYTES + len(body)
        head = raw[at : at + 8] + whole.to_bytes(4, "little") + raw[at + 12 : at + 16]
        out += head + bytes(8) + len(body).to_bytes(4, "little") + bytes(4) + body
        out += bytes(whole % 4)
        at += size + size % 4
    return out


def _mf4_by_bus() -> bytes:
    return mf4(FRAMES, group_of=lambda frame: (kind_of(frame), frame[1]), compression=2)


def bundle() -> bytes:
    """An evidence bundle of a small capture."""
    with tempfile.TemporaryDirectory() as folder:
        source, output = Path(folder) / "x.mcap", Path(folder) / "x.zip"
        source.write_bytes(capture())
        make_bundle(Case([source]), output)
        return output.read_bytes()


def eds() -> bytes:
    """The EDS of a known device."""
    return load_device("lir-da158").files["lir-da158.eds"]


SEEDS: dict[str, tuple[Callable[[], bytes], ...]] = {
    "candump": (
        lambda: text_files.candump(FRAMES),
        lambda: text_files.screen(FRAMES),
        lambda: _SCREEN_DELTA,
    ),
    "asc": (lambda: text_files.asc(FRAMES), lambda: _ASC_RELATIVE),
    "trc": (lambda: text_files.trc(FRAMES), lambda: _TRC_10),
    "ixxat": (lambda: text_files.ixxat(FRAMES),),
    "kvaser": (lambda: text_files.kvaser(FRAMES),),
    "busmaster": (lambda: text_files.busmaster(FRAMES),),
    "csv": (
        lambda: text_files.german_csv(FRAMES),
        lambda: text_files.gvret(FRAMES),
        lambda: text_files.cantest(FRAMES),
        lambda: text_files.bare(FRAMES),
    ),
    "canhacker": (lambda: text_files.canhacker(FRAMES),),
    "clx": (lambda: text_files.clx(FRAMES),),
    "pcap": (
        lambda: binary_files.pcap(FRAMES),
        lambda: binary_files.pcap_big(FRAMES),
        lambda: binary_files.sll(FRAMES),
        lambda: binary_files.sll2(FRAMES),
    ),
    "pcapng": (lambda: binary_files.pcapng(FRAMES), lambda: binary_files.pcapng_big(FRAMES)),
    "blf": (
        lambda: binary_files.python_can_blf(FRAMES),
        lambda: _bare_blf(binary_files.python_can_blf(FRAMES)),
    ),
    "mcap": (capture, lambda: capture("none"), lambda: capture("lz4"), lambda: _bare(capture())),
    "ros2": (
        lambda: binary_files.ros2(FRAMES),
        lambda: _bare(binary_files.ros2(FRAMES, "<>")),
        lambda: _bare(binary_files.ros2(FRAMES)),
        lambda: binary_files.ros2_fd(FRAMES),
        lambda: _bare(binary_files.ros2_fd(FRAMES)),
    ),
    "mf4": (
        lambda: mf4(FRAMES),
        _mf4_by_bus,
        lambda: canedge([frame for frame in FRAMES if kind_of(frame) == "CAN_DataFrame"]),
        lambda: logger_mf4(_LOGGED),
        lambda: logger_mf4(_LOGGED, finished=False),
        lambda: listed_mf4(_LOGGED, per_block=2, packing=0, list_first=True),
        lambda: listed_mf4(_LOGGED, per_block=2, packing=1),
    ),
    "packed": (
        lambda: gzip.compress(text_files.candump(FRAMES), mtime=0),
        lambda: zstandard.compress(text_files.asc(FRAMES)),
        lambda: gzip.compress(_bare(capture()), mtime=0),
    ),
    "bundle": (bundle,),
    "eds": (eds, XDC.encode),
}
"""By the name of a format: how its files are made."""


def _repacked(chance: Random, raw: bytes, others: list[bytes]) -> bytes:
    """A packed log whose content is damaged, not its packing."""
    if raw.startswith(b"\x1f\x8b"):
        return gzip.compress(mutated(chance, gzip.decompress(raw), others), 1, mtime=0)
    return zstandard.compress(mutated(chance, zstandard.decompress(raw), others))


def _rezipped(chance: Random, raw: bytes, others: list[bytes]) -> bytes:
    """A bundle one of whose members is damaged, or has another name."""
    out = BytesIO()
    with zipfile.ZipFile(BytesIO(raw)) as old, zipfile.ZipFile(out, "w") as new:
        members = [(name, old.read(name)) for name in old.namelist()]
        chosen = chance.randrange(len(members))
        for number, (name, data) in enumerate(members):
            if number == chosen and chance.random() < 0.2:
                name = mutated(chance, name.encode(), others).decode("latin-1")[:1000]
            elif number == chosen:
                data = mutated(chance, data, others)
            new.writestr(name.strip("\0").split("\0")[0] or "x", data)
    return out.getvalue()


REBUILT: dict[str, Callable[[Random, bytes, list[bytes]], bytes]] = {
    "packed": _repacked,
    "bundle": _rezipped,
}
"""Formats whose damage mostly goes beneath their packing."""
