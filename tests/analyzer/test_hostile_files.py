"""Files made to do harm: bombs, endless chains, names that are paths or formulas, damage by seed."""

import gzip
import struct
import sys
import zipfile
import zlib
from io import BytesIO
from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from syncline_analyzer.convert import convert
from syncline_analyzer.readers import open_capture
from syncline_schemas.errors import CaptureError, UsageError
from tests.analyzer.binary_files import pcapng
from tests.analyzer.log_builder import T0_NS, read, rows
from tests.analyzer.log_frames import FRAMES
from tests.analyzer.mf4_files import mf4
from tests.analyzer.text_files import candump

LINE = b"(1700000000.000000) can0 123#1122\n"
MOST_MB = 150


def _peak_mb() -> int:
    """Memory that this process has held at most; where that cannot be had, nothing."""
    if sys.platform == "win32":
        return 0
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit >> 20


def _written(tmp_path: Path, raw: bytes, name: str = "x") -> Path:
    path = tmp_path / name
    path.write_bytes(raw)
    return path


@pytest.mark.parametrize(
    ("packing", "filling"),
    [("gz", b"\n"), ("gz", b"\0"), ("zst", b"A"), ("zst", b"#")],
    ids=["lines", "zeros", "A", "#"],
)
def test_a_packed_bomb_is_refused(tmp_path: Path, packing: str, filling: bytes) -> None:
    before = _peak_mb()
    pack = gzip.compress if packing == "gz" else zstandard.compress
    # Members behind each other read as one; none of it ever stands in memory here.
    raw = pack(LINE * 100) + pack(filling * (16 << 20)) * 5
    with pytest.raises(CaptureError, match="unpacks to more than"):
        read(_written(tmp_path, raw))
    assert _peak_mb() - before < MOST_MB


def test_a_log_of_equal_frames_is_no_bomb(tmp_path: Path) -> None:
    batch, facts, _ = read(_written(tmp_path, gzip.compress(LINE * 200_000)))
    assert len(batch) == 200_000
    assert facts.damage is None


def _mcap_bomb(compression: CompressionType, plain: bytes) -> bytes:
    stream = BytesIO()
    writer = Writer(stream, compression=compression, chunk_size=1 << 40)
    writer.start("syncline", "x")
    schema = writer.register_schema("syncline.CanFrame", "protobuf", b"")
    channel = writer.register_channel("/can0/frames", "protobuf", schema)
    writer.add_message(channel, T0_NS, plain, T0_NS)
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_that_grows_beyond_measure_is_left_out(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = _written(tmp_path, _mcap_bomb(compression, bytes(100 << 20)))
    before = _peak_mb()
    batch, _, _ = read(path)
    assert not len(batch)
    assert _peak_mb() - before < MOST_MB


def test_a_blf_container_that_grows_beyond_measure_is_cut(tmp_path: Path) -> None:
    body = zlib.compress(bytes(100 << 20), 9)
    header = b"LOGG" + struct.pack("<I", 144) + bytes(136)
    size = 32 + len(body)
    container = b"LOBJ" + struct.pack("<HHII", 16, 1, size, 10)
    container += struct.pack("<HHIII", 2, 0, 0, 100 << 20, 0) + body + bytes(size % 4)
    before = _peak_mb()
    batch, facts, _ = read(_written(tmp_path, header + container))
    assert not len(batch)
    assert facts.damage
    assert _peak_mb() - before < MOST_MB


def test_a_bundle_that_grows_beyond_measure_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("manifest.json", b" " * (64 << 20))
    before = _peak_mb()
    with pytest.raises(CaptureError):
        open_capture(path)
    assert _peak_mb() - before < MOST_MB


@pytest.mark.parametrize("link", [0, 8, 24])
def test_blocks_of_an_mdf_file_in_a_ring_are_refused(tmp_path: Path, link: int) -> None:
    pytest.importorskip("asammdf")
    raw = bytearray(mf4(FRAMES))
    group = int.from_bytes(raw[88:96], "little")
    raw[group + 24 : group + 32] = group.to_bytes(8, "little")
    with pytest.raises(CaptureError, match="ring"):
        open_capture(_written(tmp_path, bytes(raw)))


NAMES = ("=cmd|' /C calc'!A0", "@SUM(1)", "can0,x\ny", "-1+2", "../../etc/passwd", "a\0b", "can 0")


@pytest.mark.parametrize("ending", [".csv", ".log"])
@pytest.mark.parametrize("name", NAMES)
def test_names_of_buses_are_no_formulas_lines_or_cells(
    tmp_path: Path, name: str, ending: str
) -> None:
    raw = pcapng(FRAMES[:3])
    old = struct.pack("<HH", 2, 4) + b"can0"
    new = struct.pack("<HH", 2, len(name)) + name.encode() + bytes(-len(name) % 4)
    at = raw.index(old)
    start = raw.rindex(struct.pack("<I", 1), 0, at - 8)
    size = int.from_bytes(raw[start + 4 : start + 8], "little")
    block = raw[start : start + size].replace(old, new)
    length = struct.pack("<I", len(block))
    block = block[:4] + length + block[8:-4] + length
    source = _written(tmp_path, raw[:start] + block + raw[start + size :], "x.pcapng")
    shown = read(source)[1].buses[0]
    target = tmp_path / f"out{ending}"
    result = convert([source], target)
    text = target.read_text(encoding="utf-8")
    assert len(text.splitlines()) == len(FRAMES[:3]) + (ending == ".csv")
    if ending == ".csv":
        cells = [line.split(",")[1] for line in text.splitlines()[1:]]
        assert not any(cell.startswith(("=", "+", "-", "@", "'")) for cell in cells)
    found, facts, _ = read(target)
    assert [row[:1] + row[2:] for row in rows(found)] == [f[:1] + f[2:] for f in FRAMES[:3]]
    assert ("bus names" in result.lost) == (facts.buses[0] != shown)


def test_times_before_zero_are_not_written(tmp_path: Path) -> None:
    source = _written(tmp_path, b" 1.0 1 123 Rx d 0\nbase hex timestamps absolute\n")
    with pytest.raises(UsageError, match="before its time 0"):
        convert([source], tmp_path / "x.csv", offsets={"x": "-2"})


def test_a_short_endless_line_costs_no_time(tmp_path: Path) -> None:
    lines = (
        b"\n" * 66_000,
        b" " * 200_000,
        b"*" * 200_000,
        b"0" * 200_000,
        b"date " + b"a" * 99_000,
    )
    for line in lines:
        for whole in (
            candump(FRAMES),
            b"date x\nbase hex\n",
            b";$FILEVERSION=1.1\n;   Start time: ",
        ):
            try:
                read(_written(tmp_path, whole + line + b"\n" + whole))
            except CaptureError:
                continue
