"""ASAM MDF 4 bus logs made with asammdf from frames, as the standard's bus logging lays them out."""

import struct
import tempfile
import zlib
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tests.analyzer.log_builder import FD_LENGTHS, T0_NS, Row
from tests.analyzer.log_frames import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, flags_of

_COMMON = [("BusChannel", "u1"), ("ID", "<u4"), ("IDE", "u1"), ("DLC", "u1"), ("DataLength", "u1")]
_FIELDS = {
    "CAN_DataFrame": [
        *_COMMON,
        ("DataBytes", "(64,)u1"),
        ("Dir", "u1"),
        ("EDL", "u1"),
        ("BRS", "u1"),
        ("ESI", "u1"),
    ],
    "CAN_RemoteFrame": [*_COMMON, ("Dir", "u1")],
    "CAN_ErrorFrame": [*_COMMON, ("DataBytes", "(8,)u1"), ("Dir", "u1")],
}


def kind_of(frame: Row) -> str:
    """The group of the standard that a frame belongs to."""
    if frame[3] & ERROR:
        return "CAN_ErrorFrame"
    return "CAN_RemoteFrame" if frame[3] & REMOTE else "CAN_DataFrame"


def _samples(kind: str, frames: Sequence[Row]) -> np.ndarray:
    samples = np.zeros(len(frames), [(f"{kind}.{n}", t) for n, t in _FIELDS[kind]])
    names = samples.dtype.names or ()
    for number, frame in enumerate(frames):
        flags = flags_of(frame)
        fields = {
            "BusChannel": frame[1] + 1,
            "ID": frame[2],
            "IDE": EXTENDED in flags,
            "DLC": FD_LENGTHS.index(frame[4]) if FD in flags else frame[4],
            "DataLength": len(frame[5]),
            "DataBytes": np.frombuffer(frame[5].ljust(64, b"\0"), np.uint8),
            "Dir": TX in flags,
            "EDL": FD in flags,
            "BRS": BRS in flags,
            "ESI": ESI in flags,
        }
        for name, value in fields.items():
            if f"{kind}.{name}" in names:
                field = samples[f"{kind}.{name}"]
                field[number] = value[: field.shape[1]] if field.ndim == 2 else value  # type: ignore[index]
    return samples


def mf4(
    frames: Sequence[Row],
    *,
    compression: Literal[0, 1, 2] = 0,
    group_of: Callable[[Row], object] = kind_of,
    version: str = "4.10",
    start: datetime | None = None,
) -> bytes:
    """One group for each of `group_of`, each of frames of one kind in order of time."""
    from asammdf import MDF, Signal, Source

    source = Source("CAN", "CAN", "", 2, 2)
    with MDF(version=version) as mdf:
        mdf.header.start_time = start or datetime.fromtimestamp(T0_NS // 10**9, UTC)
        for key in dict.fromkeys(group_of(frame) for frame in frames):
            kept = [frame for frame in frames if group_of(frame) == key]
            times = np.array([(frame[0] - T0_NS) / 1e9 for frame in kept])
            kind = kind_of(kept[0])
            mdf.append(
                Signal(_samples(kind, kept), times, name=kind, source=source), common_timebase=True
            )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "x.mf4"
            mdf.save(path, compression=compression)
            return path.read_bytes()


def mf4_keeps(frame: Row) -> Row | None:
    """Everything, stamps as fractions of a second; an extended flag of error frames has no meaning."""
    return frame


def canedge(frames: Sequence[Row]) -> bytes:
    """Data frames as a CANedge stores them: fields of single bits, data of variable length.

    IDE is the highest bit of the identifier's word, direction, flags and channel share a byte, and the
    data bytes stand apart from the records.
    """
    from asammdf import MDF, Signal, Source

    name, source = "CAN_DataFrame", Source("CAN", "CAN", "", 2, 2)
    whole = _samples(name, frames)
    kept = [each for each in whole.dtype.names or () if not each.endswith("DataBytes")]
    samples = np.zeros(len(whole), [(each, whole.dtype[each]) for each in kept])
    for each in kept:
        samples[each] = whole[each]
    shared = ("EDL", "BRS", "ESI", "Dir", "BusChannel")
    bits = sum(samples[f"{name}.{field}"] << bit for bit, field in enumerate(shared))
    samples[f"{name}.ID"] |= samples[f"{name}.IDE"].astype(np.uint32) << 31
    samples[f"{name}.EDL"] = bits
    for field in ("IDE", *shared[1:]):
        samples[f"{name}.{field}"] = 0xFF
    times = np.array([(frame[0] - T0_NS) / 1e9 for frame in frames])
    data = np.array([frame[5] for frame in frames], "S64")
    with MDF(version="4.10") as mdf:
        mdf.header.start_time = datetime.fromtimestamp(T0_NS // 10**9, UTC)
        parts = [
            Signal(samples, times, name=name, source=source),
            Signal(data, times, name=f"{name}.DataBytes", source=source, encoding="latin-1"),
        ]
        mdf.append(parts, common_timebase=True)
        group: Any = mdf.groups[0]
        places = {channel.name: number for number, channel in enumerate(group.channels)}
        channels = {channel.name.partition(".")[2]: channel for channel in group.channels}
        group.channel_dependencies[places[name]].append((0, places[f"{name}.DataBytes"]))
        channels["DataBytes"].data_type = 10
        channels["ID"].bit_count = 29
        first, ide = channels["ID"].byte_offset, channels["IDE"]
        ide.byte_offset, ide.bit_offset, ide.bit_count = first + 3, 7, 1
        for bit, field in enumerate(shared):
            channel = channels[field]
            channel.byte_offset = channels["EDL"].byte_offset
            channel.bit_offset, channel.bit_count = bit, 2 if field == "BusChannel" else 1
        with tempfile.TemporaryDirectory() as folder:
            return Path(mdf.save(Path(folder) / "x.mf4")).read_bytes()


class _Blocks:
    """Blocks of a file one after another, as ASAM MDF 4.1 describes them; the first is at 64."""

    def __init__(self) -> None:
        self.raw = bytearray(64)

    def add(self, mark: bytes, links: Sequence[int], data: bytes) -> int:
        at = len(self.raw)
        size = 24 + 8 * len(links) + len(data)
        head = struct.pack(f"<4sIQQ{len(links)}Q", mark, 0, size, len(links), *links)
        self.raw += head + data
        self.raw += bytes(-len(self.raw) % 8)
        return at

    def text(self, words: str) -> int:
        return self.add(b"##TX", (), words.encode() + b"\0")

    def channel(
        self,
        name: str,
        kind: int,
        at: int,
        bits: int,
        *,
        following: int = 0,
        parts: int = 0,
        values: int = 0,
    ) -> int:
        """`values`: where a channel has them that has only their places in the records."""
        master = name == "Timestamp"
        form = 1 if values else 2 * master
        data = struct.pack("<BBBBIIIIBBH6d", form, master, kind, 0, at, bits, *[0] * 11)
        links = (following, parts, self.text(name), 0, 0, values, 0, 0)
        return self.add(b"##CN", links, data)

    def data(self, records: bytes, packing: int | None) -> int:
        """A block of records, plain or packed."""
        if packing is None:
            return self.add(b"##DT", (), records)
        rows = len(records) // RECORD_BYTES
        flat = np.frombuffer(records, np.uint8).reshape(rows, RECORD_BYTES)
        packed = zlib.compress(flat.T.tobytes() if packing else records)
        width = RECORD_BYTES if packing else 0
        head = struct.pack("<2sBxIQQ", b"DT", packing, width, len(records), len(packed))
        return self.add(b"##DZ", (), head + packed)

    def file(self, unfinished: int) -> bytes:
        """All of it behind the block that tells what it is, with the flags of what is not finished."""
        mark = b"UnFinMF " if unfinished else b"MDF     "
        self.raw[:64] = struct.pack(
            "<8s8s8s4xH30xHH", mark, b"4.11    ", b"CE      ", 411, unfinished, 0
        )
        return bytes(self.raw)


RECORD_BYTES = 26
"""Of a logger's record, its number before it."""
_LOGGED = (
    ("BusChannel", 0, 0, 8),
    ("ID", 0, 1, 32),
    ("IDE", 0, 5, 8),
    ("DLC", 0, 6, 8),
    ("DataLength", 0, 7, 8),
    ("Dir", 0, 8, 8),
    ("DataBytes", 10, 9, 64),
)
"""Of a record behind its stamp: name, type (unsigned, bytes), first byte, bits of each field."""


def logger_mf4(frames: Sequence[Row], *, finished: bool = True, start_ns: int = T0_NS) -> bytes:
    """Made by hand as a logger writes it: what describes the records, then those of two groups, mixed.

    Where it is not finished, counts and the length of the data are 0 and the file says so.
    """
    out, group = _described(frames, start_ns, counted=finished)
    out.raw[group + 40 : group + 48] = struct.pack("<Q", len(out.raw))
    records = b"".join(_record(frame, start_ns) for frame in frames)
    out.raw += struct.pack("<4sIQQ", b"##DT", 0, 24 + len(records) * finished, 0) + records
    return out.file(0 if finished else 0x5)


def canedge_unsorted(frames: Sequence[Row], *, finished: bool = True) -> bytes:
    """Data frames as a CANedge writes them: the bytes of each are a record of their own before it."""
    out, head = _Blocks(), struct.pack("<QhhBBBBdd", T0_NS, 0, 0, 0, 0, 0, 0, 0.0, 0.0)
    out.add(b"##HD", [0] * 6, head)
    size, count = sum(4 + len(frame[5]) for frame in frames), len(frames)
    told = (count, 0x1, 0, 0, size, 0) if finished else (0, 0x1, 0, 0, 0, 0)
    apart = out.add(b"##CG", [0] * 6, struct.pack("<QQHHIII", 2, *told))
    parts = 0
    for name, form, at, bits in reversed(_LOGGED):
        values = apart if name == "DataBytes" else 0
        name = f"CAN_DataFrame.{name}"
        parts = out.channel(name, form, 8 + at, bits, following=parts, values=values)
    whole = out.channel("CAN_DataFrame", 10, 8, 17 * 8, parts=parts)
    stamp = out.channel("Timestamp", 4, 0, 64, following=whole)
    told = (count * finished, 0x2, 46, 0, RECORD_BYTES - 1, 0)
    group = out.add(b"##CG", (apart, stamp, 0, 0, 0, 0), struct.pack("<QQHHIII", 1, *told))
    group = out.add(b"##DG", (0, group, 0, 0), struct.pack("<B7x", 1))
    out.raw[64 + 24 : 64 + 32] = struct.pack("<Q", group)
    out.raw[group + 40 : group + 48] = struct.pack("<Q", len(out.raw))
    records, place = bytearray(), 0
    for frame in frames:
        records += struct.pack("<BI", 2, len(frame[5])) + frame[5]
        records += _record(frame, T0_NS)[:-8] + struct.pack("<Q", place)
        place += 4 + len(frame[5])
    out.raw += struct.pack("<4sIQQ", b"##DT", 0, 24 + len(records) * finished, 0) + records
    return out.file(0 if finished else 0x25)


def listed_mf4(
    frames: Sequence[Row], *, per_block: int, packing: int | None = None, list_first: bool = False
) -> bytes:
    """The same with its records in a list of blocks, each packed by itself.

    Args:
        per_block: records in a block.
        packing: None, 0 deflated, 1 turned about and deflated.
        list_first: whether the list stands before the blocks it names, or behind them.
    """
    out, group = _described(frames, T0_NS, counted=True)
    parts = [
        b"".join(_record(frame, T0_NS) for frame in frames[at : at + per_block])
        for at in range(0, len(frames), per_block)
    ]
    offsets = np.cumsum([0, *map(len, parts[:-1])]).astype("<u8").tobytes()
    head = struct.pack("<B3xI", 0, len(parts)) + offsets
    listed = out.add(b"##DL", [0] * (1 + len(parts)), head) if list_first else 0
    places = [out.data(part, packing) for part in parts]
    if listed:
        out.raw[listed + 32 : listed + 32 + 8 * len(parts)] = struct.pack(
            f"<{len(parts)}Q", *places
        )
    else:
        listed = out.add(b"##DL", (0, *places), head)
    out.raw[group + 40 : group + 48] = struct.pack("<Q", listed)
    return out.file(0)


def _described(frames: Sequence[Row], start_ns: int, *, counted: bool) -> tuple[_Blocks, int]:
    """What describes the records of data and remote frames; where the block of the data group is."""
    out, groups = _Blocks(), 0
    kinds = ("CAN_DataFrame", "CAN_RemoteFrame")
    out.add(b"##HD", [0] * 6, struct.pack("<QhhBBBBdd", start_ns, 0, 0, 0, 0, 0, 0, 0.0, 0.0))
    for number, kind in reversed(list(enumerate(kinds, 1))):
        parts = 0
        for name, form, at, bits in reversed(_LOGGED):
            parts = out.channel(f"{kind}.{name}", form, 8 + at, bits, following=parts)
        whole = out.channel(kind, 10, 8, 17 * 8, parts=parts)
        stamp = out.channel("Timestamp", 4, 0, 64, following=whole)
        count = sum(kinds.index(kind_of(frame)) + 1 == number for frame in frames)
        data = struct.pack("<QQHHIII", number, count * counted, 0x2, 46, 0, 25, 0)
        groups = out.add(b"##CG", (groups, stamp, 0, 0, 0, 0), data)
    group = out.add(b"##DG", (0, groups, 0, 0), struct.pack("<B7x", 1))
    out.raw[64 + 24 : 64 + 32] = struct.pack("<Q", group)
    return out, group


def _record(frame: Row, start_ns: int) -> bytes:
    return struct.pack(
        "<BdBIBBBB8s",
        ("CAN_DataFrame", "CAN_RemoteFrame").index(kind_of(frame)) + 1,
        (frame[0] - start_ns) / 1e9,
        frame[1] + 1,
        frame[2],
        bool(frame[3] & EXTENDED),
        frame[4],
        len(frame[5]),
        bool(frame[3] & TX),
        frame[5],
    )
