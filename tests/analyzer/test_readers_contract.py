"""What holds for every format: columns, windows, damage, garbage, and any block size."""

import contextlib
import gzip
import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from syncline_analyzer.convert import convert
from syncline_analyzer.readers import open_capture
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.errors import CaptureError
from tests.analyzer.log_builder import CAPTURES, T0_NS, Row, read, rows

ENDINGS = [".log", ".asc", ".blf", ".trc", ".csv", ".pcapng", ".mcap"]
SCREEN = (
    " (1700000000.{i:06d})  can0  {id:03X}   [{n}]  {data}\n"
    " (1700000000.{i:06d})  can0  18FF0000   [1]  05   '.'\n"
)


def _log(frames: int = 60, seed: int = 1) -> str:
    chance = random.Random(seed)
    lines = []
    for i in range(frames):
        name = chance.choice(["080", "181", "70A", "18FF0011", "20000004"])
        text = chance.choice([chance.randbytes(chance.randrange(9)).hex().upper(), "R1"])
        text = "0004000000000000" if name == "20000004" else text
        lines.append(f"(17000000{i // 10:02d}.{i:06d}) can{i % 2} {name}#{text}\n")
    return "".join(lines)


def _screen(frames: int = 60, seed: int = 1) -> str:
    chance = random.Random(seed)
    return "".join(
        SCREEN.format(
            i=i, id=chance.randrange(0x800), n=n, data=chance.randbytes(n).hex(" ").upper()
        )
        for i in range(frames)
        for n in [chance.randrange(9)]
    )


@pytest.fixture(params=[*ENDINGS, "screen", "gz"])
def capture(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A small capture of every format."""
    source, target = tmp_path / "source", tmp_path / f"capture{request.param}"
    source.write_text(_screen(30) if request.param == "screen" else _log(30), encoding="ascii")
    if request.param == "gz":
        target.write_bytes(gzip.compress(source.read_bytes()))
    elif request.param == "screen":
        target.write_bytes(source.read_bytes())
    else:
        convert([source], target)
    return target


def test_columns_are_what_a_frame_batch_promises(capture: Path) -> None:
    batch, facts, _ = read(capture)
    n = len(batch)
    assert n >= 30
    assert [column.dtype for column in (batch.t_ns, batch.bus, batch.can_id)] == [
        np.int64,
        np.uint8,
        np.uint32,
    ]
    assert [column.dtype for column in (batch.flags, batch.dlc, batch.data)] == [
        np.uint16,
        np.uint8,
        np.uint8,
    ]
    assert batch.data.shape == (n, 8)
    remote = (batch.flags & FrameFlag.REMOTE) != 0
    length = np.where(remote, 0, batch.dlc)
    assert not batch.data[np.arange(8) >= length[:, None]].any()
    assert batch.bus.max() < len(facts.buses)
    assert facts.time_base == "utc"
    assert facts.damage is None
    assert facts.unparsed_count == 0


def test_a_window_holds_what_lies_in_it(capture: Path) -> None:
    everything = rows(read(capture)[0])
    start_ns, end_ns = everything[10][0], everything[20][0]
    reader = open_capture(capture, start_ns=start_ns, end_ns=end_ns)
    items = [item for item in reader.batches() if not isinstance(item, Gap)]
    assert rows(FrameBatch.concat(items)) == [
        frame for frame in everything if start_ns <= frame[0] < end_ns
    ]


def test_a_cut_capture_gives_what_is_there(capture: Path, tmp_path: Path) -> None:
    whole = rows(read(capture)[0])
    raw = capture.read_bytes()
    cut = tmp_path / "cut"
    for size in range(max(0, len(raw) - 1024), len(raw)):
        cut.write_bytes(raw[:size])
        try:
            batch, facts, _ = read(cut)
        except CaptureError:
            assert len(raw) < 2048
            continue
        found = rows(batch)
        # The last line of a text may be cut in a way that cannot be seen; that is noted.
        trusted = len(found) - any("line end" in note for note in facts.notes)
        assert found[:trusted] == whole[:trusted]
        if capture.suffix in (".blf", ".mcap", ".gz"):
            assert len(found) == len(whole) or facts.damage or facts.unparsed_count


def test_an_empty_file_is_no_capture(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_bytes(b"")
    with pytest.raises(CaptureError, match=r"x\.log: is empty.*candump"):
        open_capture(path)


@pytest.mark.parametrize(
    ("raw", "what"),
    [
        (b"hello world\n", "no known format"),
        (bytes(5000), "no known format"),
        (b"\xff\xfe\x00", "no"),
        (b"\x1f\x8b\x08\x00garbage", "nothing can be read"),
        (b"\x28\xb5\x2f\xfdgarbage", "nothing can be read"),
        (b"LOGG", "cut off"),
        (b"MDF     4.10", "ASAM MDF"),
        (b"\xd4\xc3\xb2\xa1", "cut off"),
        (b"PAR1", "Parquet"),
        (b"a,b,c\n1,2,3\n", "no known format"),
        (b"id,name,data\n1,Anna,hello\n2,Bert,world\n", "no known format"),
    ],
)
def test_what_is_no_capture_is_said_to_be_none(tmp_path: Path, raw: bytes, what: str) -> None:
    path = tmp_path / "x"
    path.write_bytes(raw)
    with pytest.raises(CaptureError, match=what):
        open_capture(path)


def test_what_is_not_there_is_said_not_to_be_there(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="cannot be opened"):
        open_capture(tmp_path / "nowhere")
    with pytest.raises(CaptureError, match="directory"):
        open_capture(tmp_path)


BROKEN = settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def _same(path: Path, sizes: tuple[int, ...]) -> list[tuple[object, ...]]:
    results: list[tuple[object, ...]] = []
    for size in sizes:
        batch, facts, gaps = read(path, size)
        kept: list[Row] = rows(batch)
        results.append((kept, gaps, facts.buses, facts.unparsed_lines, facts.notes, facts.damage))
    return results


@BROKEN
@given(data=st.data())
def test_broken_text_reads_the_same_in_blocks_of_any_size(
    tmp_path: Path, data: st.DataObject
) -> None:
    starts = [_log(30).encode(), _screen(15).encode(), *_real_starts()]
    raw = bytearray(data.draw(st.sampled_from(starts)))
    for _ in range(data.draw(st.integers(0, 12))):
        place = data.draw(st.integers(0, len(raw) - 1))
        end = place + data.draw(st.integers(0, 3))
        raw[place:end] = data.draw(
            st.binary(max_size=3) | st.sampled_from([b"\n", b" ", b"9", b"#"])
        )
    path = tmp_path / "x"
    path.write_bytes(bytes(raw) or b"x")
    try:
        small, middle, large = _same(path, (64, 1000, 1 << 20))
    except CaptureError:
        return
    assert small == large
    assert middle == large


def _real_starts() -> list[bytes]:
    files = sorted(path for path in CAPTURES.glob("*.*") if path.suffix != ".gz")
    return [path.read_bytes()[:2500] for path in files]


@BROKEN
@given(junk=st.binary(max_size=600), magic=st.sampled_from([b"", b"LOGG", b"date ", b";$"]))
def test_junk_never_raises_anything_else(tmp_path: Path, junk: bytes, magic: bytes) -> None:
    path = tmp_path / "x"
    path.write_bytes(magic + junk)
    with contextlib.suppress(CaptureError):
        read(path)


@BROKEN
@given(data=st.data())
def test_a_broken_blf_never_raises(tmp_path: Path, data: st.DataObject) -> None:
    source, target = tmp_path / "source.log", tmp_path / "x.blf"
    source.write_text(_log(30), encoding="ascii")
    convert([source], target)
    raw = bytearray(target.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        raw[data.draw(st.integers(4, len(raw) - 1))] = data.draw(st.integers(0, 255))
    target.write_bytes(bytes(raw))
    batch, _, _ = read(target)
    assert len(batch) <= 30


def test_a_line_without_end_is_bounded_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(_log(5).encode() + b"#" * 3_000_000 + b"\n" + _log(5).encode())
    batch, facts, _ = read(path)
    assert len(batch) == 10
    assert facts.unparsed_count >= 1
    assert all(len(text) <= 200 for _, text in facts.unparsed_lines)


def test_a_packed_log_that_is_damaged_says_so_and_drops_its_last_line(tmp_path: Path) -> None:
    packed = gzip.compress(_log(2000).encode(), compresslevel=1)
    path = tmp_path / "x.gz"
    path.write_bytes(packed[: len(packed) // 2])
    batch, facts, _ = read(path)
    assert 100 < len(batch) < 2000
    assert facts.damage == "the packed file ends early"
    path.write_bytes(packed)
    assert rows(batch) == rows(read(path)[0])[: len(batch)]
    assert int(batch.t_ns[0]) == T0_NS


LINES = {
    "log": ("", "(1700000000.123456) can0 18FF0011#1122A4\n"),
    "screen": ("", " (1700000000.123456)  can0  123   [2]  11 A4   '..'\n"),
    "asc": (
        "date Tue Nov 14 22:13:20 2023\nbase hex  timestamps absolute\n",
        " 12.123456 1  123   Rx   d 2 11 A4  Length = 2 ID = 291\n",
    ),
    "trc": (";$FILEVERSION=1.1\n;$STARTTIME=45244.9\n", "  17)  1234.5  Rx   0123  2  11 A4\n"),
    "csv": ("timestamp,bus,id,extended,dlc,data\n", "1700000000.123456,can0,0x123,0,2,11a4\n"),
    "kvaser": (
        "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n",
        " 0    00000123 X       2  11  A4                            154.266550 R\n",
    ),
    "busmaster": (
        "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***HEX***\n***SYSTEM MODE***\n",
        "11:49:12:9420 Rx 1 0x123 s 2 11 A4\n",
    ),
    "home-made": (
        "Zeit [ms];ID;Kanal;Typ;B0;B1\n",
        "12345,678;00000A23;1;Data;0x11;0xA4\n",
    ),
    "clock": ("Time,Id,Data\n", "2023-11-14 22:13:20.123,7A1,11 A4\n"),
    "ixxat": (
        "ASCII Trace IXXAT MiniMon V3\nDate: 28.01.2025\nStart time: 10:47:15\n",
        '"00:02:20.66";"83";"Std";"";"11 A4 "\n',
    ),
}


@pytest.mark.parametrize("name", LINES)
def test_a_line_among_like_ones_reads_as_it_does_alone(tmp_path: Path, name: str) -> None:
    head, line = LINES[name]
    changed = [
        line[:place] + char + line[place + 1 :]
        for place in range(len(line) - 1)
        for char in "09AFafG:#;,R -"
    ]
    path = tmp_path / "x"
    path.write_text(head + line * 60 + "".join(changed), encoding="ascii")
    # In blocks shorter than two lines no line is read by the layout of another.
    alone, together = _same(path, (len(line), 1 << 20))
    assert together == alone
    assert len(read(path)[0]) > 110
