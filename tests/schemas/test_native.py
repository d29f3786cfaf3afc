"""The compiled loops against plain loops over what the standards say, and against numpy's."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas import native, wire_length
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.capture import chunk_group
from syncline_schemas.capture.channels import ChannelTable, Kind
from syncline_schemas.capture.chunk_group import PlainGroup
from syncline_schemas.capture.record_file import RawChunk
from syncline_schemas.native import build
from syncline_schemas.proto import syncline_pb2
from syncline_schemas.wire_length import wire_bits
from tests.schemas.wire_model import Shape, send_classic

needs_library = pytest.mark.skipif(not native.available(), reason="the library was not built")

_FRAMES, _OTHER_BUS, _DECODED, _STATUS, _MARK, _GAP = range(1, 7)
_KINDS = {
    _FRAMES: Kind.FRAME,
    _OTHER_BUS: Kind.FRAME,
    _DECODED: Kind.OTHER,
    _STATUS: Kind.STATUS,
    _MARK: Kind.MARK,
    _GAP: Kind.GAP,
}


def channels() -> ChannelTable:
    table = ChannelTable([])
    for channel, kind in _KINDS.items():
        table.kind[channel] = kind
    table.bus[_OTHER_BUS] = 3
    return table


def message(channel: int, stamp: int, payload: bytes) -> bytes:
    """A message record of the MCAP specification."""
    body = channel.to_bytes(2, "little") + bytes(4) + (stamp + 7).to_bytes(8, "little")
    body += stamp.to_bytes(8, "little") + payload
    return b"\x05" + len(body).to_bytes(8, "little") + body


def frame_payload(can_id: int, flags: int, dlc: int, data: bytes) -> bytes:
    """`syncline.Frame` with every field, in order, as our writer puts it."""
    return b"".join(
        (
            b"\x0d" + can_id.to_bytes(4, "little"),
            b"\x15" + flags.to_bytes(4, "little"),
            bytes((0x18, dlc, 0x22, len(data))),
            data,
        )
    )


_DATA = st.binary(max_size=8) | st.binary(max_size=64)
_WHOLE = st.tuples(
    st.sampled_from([_FRAMES, _OTHER_BUS]), st.integers(0, 0x1FFFFFFF), st.just(0), _DATA
).map(lambda f: message(f[0], f[1], frame_payload(f[1], f[2], len(f[3]), f[3])))
_REMOTE = st.integers(0, 8).map(
    lambda dlc: message(_FRAMES, 5, frame_payload(0x701, int(FrameFlag.REMOTE), dlc, b""))
)
_OTHERS = st.tuples(st.sampled_from([_DECODED, _STATUS, _MARK]), st.binary(max_size=50)).map(
    lambda m: message(m[0], 11, m[1])
)
_STRANGE = st.tuples(
    st.sampled_from([*_KINDS, 0, 9, 65535]),
    st.binary(max_size=80)
    | st.builds(
        frame_payload,
        st.integers(0, 0xFFFFFFFF),
        st.integers(0, 0xFFFFFFFF),
        st.integers(0, 255),
        st.binary(max_size=100),
    ),
).map(lambda m: message(m[0], 13, m[1]))
_RECORD = st.one_of(_WHOLE, _WHOLE, _REMOTE, _OTHERS)


@st.composite
def hostile_chunks(draw: st.DrawFn) -> bytes:
    """Records as we write them, of which some bytes were changed, taken away or put in."""
    chunk = bytearray(b"".join(draw(st.lists(_RECORD | _STRANGE, min_size=1, max_size=8))))
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(chunk)))
        how = draw(st.sampled_from(["change", "length", "cut", "insert"]))
        if how == "change" and at < len(chunk):
            chunk[at] = draw(st.integers(0, 255))
        elif how == "length":
            number = draw(st.sampled_from([0, 21, 22, 35, 36, 1 << 31, 1 << 63, (1 << 64) - 1]))
            chunk[at : at + 8] = number.to_bytes(8, "little")
        elif how == "cut":
            del chunk[at:]
        else:
            chunk[at:at] = draw(st.binary(max_size=9))
    return bytes(chunk)


def raw_chunk(plain: bytes) -> RawChunk:
    """A chunk as it stands in a file, with the message index that its records deserve."""
    places: dict[int, list[tuple[int, int]]] = {}
    at = 0
    while at + 31 <= len(plain):
        length = int.from_bytes(plain[at + 1 : at + 9], "little")
        channel = int.from_bytes(plain[at + 9 : at + 11], "little")
        places.setdefault(channel, []).append((0, at))
        at += 9 + length
    index = {channel: np.array(rows, np.uint64) for channel, rows in places.items()}
    return RawChunk(0, 0, 0, len(plain), 0, "", plain, index)


def walked(raws: list[RawChunk], table: ChannelTable) -> PlainGroup | None:
    """What is read record by record, where that is all of the chunks."""
    (_, group), *more = chunk_group._by_walk(raws, table)
    return None if more else group


def told(group: PlainGroup | None) -> list[object] | None:
    """What a group tells, comparable."""
    if group is None:
        return None
    wanted = (Kind.STATUS, Kind.CLOCK, Kind.MARK)
    others = [
        (int(content.log_time_ns[row]), content.publish_time_ns(row), content.payload(row))
        for content, kind in group.others
        for row in np.flatnonzero(np.isin(kind, wanted)).tolist()
    ]
    frames = group.frames
    columns = (frames.t_ns, frames.bus, frames.can_id, frames.flags, frames.dlc, frames.data)
    kinds = [(column.dtype, column.shape[1:], column.tolist()) for column in columns]
    return [kinds, group.log_time_ns.tolist(), others, group.first_ns, group.last_ns]


@needs_library
@settings(max_examples=400, deadline=None)
@given(st.lists(hostile_chunks().filter(len), min_size=1, max_size=3))
def test_chunks_are_read_as_by_their_index_or_not_at_all(plains: list[bytes]) -> None:
    raws, table = [raw_chunk(plain) for plain in plains], channels()
    assert told(walked(raws, table)) == told(chunk_group._plain_by_index(raws, table))


@needs_library
@pytest.mark.parametrize("data", [b"", b"abc", bytes(range(64))])
@pytest.mark.parametrize("flags", [0, int(FrameFlag.REMOTE)])
def test_every_bit_of_a_record(data: bytes, flags: int) -> None:
    """One bit changed, one byte taken away or put in, before and behind whole records."""
    table = channels()
    whole = message(_FRAMES, 1, frame_payload(0x181, 0, 2, b"ok"))
    record = message(_OTHER_BUS, 3, frame_payload(0x1FFFFFFF, flags, len(data), data))
    changed = [
        record[:at] + bytes([record[at] ^ 1 << bit]) + record[at + 1 :]
        for at in range(len(record))
        for bit in range(8)
    ]
    longer = bytearray(record + b"x")
    longer[1] += 1
    shorter = bytearray(record[:-1])
    shorter[1] -= 1
    accepted = 0
    for odd in [record, bytes(longer), bytes(shorter), *changed]:
        raws = [raw_chunk(plain) for plain in (whole + odd + whole, odd)]
        found = walked(raws, table)
        assert told(found) == told(chunk_group._plain_by_index(raws, table))
        accepted += found is not None
    # Bits that may be anything: of sequence, stamps, identifier, most flags. (A remote frame has no data.)
    assert accepted >= 8 * (4 + 16 + 3) or (flags and data)


@needs_library
@settings(max_examples=100, deadline=None)
@given(st.lists(_RECORD, min_size=1, max_size=20))
def test_frames_of_a_chunk_are_what_protobuf_reads(records: list[bytes]) -> None:
    group = walked([raw_chunk(b"".join(records))], channels())
    assert group is not None
    expected = []
    for record in records:
        channel = int.from_bytes(record[9:11], "little")
        if channel in (_FRAMES, _OTHER_BUS):
            frame = syncline_pb2.Frame.FromString(record[31:])
            stamp = int.from_bytes(record[23:31], "little")
            bus = 3 if channel == _OTHER_BUS else 0
            expected.append((stamp, bus, frame.can_id, frame.flags, frame.dlc, frame.data))
    frames = group.frames
    found = [
        (
            *(int(column[row]) for column in (frames.t_ns, frames.bus, frames.can_id)),
            *(int(frames.flags[row]), int(frames.dlc[row]), frames.payload(row)),
        )
        for row in range(len(frames))
    ]
    assert found == expected
    assert group.log_time_ns.tolist() == [stamp + 7 for stamp, *_ in expected]


@needs_library
def test_an_empty_chunk_is_looked_at_by_itself() -> None:
    whole = message(_FRAMES, 1, frame_payload(0x181, 0, 2, b"ok"))
    for plains in ([b""], [b"", whole], [whole, b""]):
        assert walked([raw_chunk(each) for each in plains], channels()) is None
    assert chunk_group._plain_by_index([raw_chunk(b"")], channels()) is None


@needs_library
def test_chunks_beside_one_that_needs_a_second_look_are_still_read_as_one() -> None:
    whole = raw_chunk(message(_FRAMES, 1, frame_payload(0x181, 0, 2, b"ok")))
    odd = raw_chunk(message(_GAP, 1, b""))
    large = replace(whole, uncompressed_size=1 << 62)
    opened = chunk_group.open_group([odd, whole, whole, large, whole], channels())
    assert isinstance(opened, list)
    found = [(each.raws, each.plain and len(each.plain.frames)) for each in opened]
    assert found == [([odd], None), ([whole, whole], 2), ([large], None), ([whole], 1)]


@needs_library
def test_a_group_has_one_set_of_columns_however_often_it_is_broken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = []

    class Counted(native.ChunkFrames):
        def __init__(self, capacity: int, *tables: Any) -> None:
            made.append(capacity)
            super().__init__(capacity, *tables)

    monkeypatch.setattr(native, "ChunkFrames", Counted)
    whole = raw_chunk(message(_FRAMES, 1, frame_payload(0x181, 0, 2, b"ok")))
    wide = raw_chunk(message(_FRAMES, 1, frame_payload(0x181, 8, 64, bytes(64))))
    odd = raw_chunk(message(_GAP, 1, b""))
    opened = chunk_group.open_group([whole, odd] * 9 + [wide, odd, whole], channels())
    assert isinstance(opened, list)
    payloads = [each.plain.frames.payload(0) for each in opened if each.plain]
    assert payloads == [b"ok"] * 9 + [bytes(64), b"ok"]
    assert len(made) == 1


def test_small_chunks_do_not_gather_without_end() -> None:
    empty = raw_chunk(b"")
    groups = [each for each in chunk_group.grouped([empty] * 20_000) if isinstance(each, list)]
    assert sum(map(len, groups)) == 20_000
    assert max(map(len, groups)) <= 4096


@needs_library
def test_a_chunk_of_more_status_messages_than_are_kept_is_left_to_numpy() -> None:
    raws = [raw_chunk(message(_STATUS, 5, b"") * (native.MOST_OTHERS + 1))]
    assert walked(raws, channels()) is None
    assert chunk_group._plain_by_index(raws, channels()) is not None


_ANY_FRAME = st.tuples(
    st.just(0),
    st.just(0),
    st.integers(0, 0x1FFFFFFF),
    st.integers(0, 0xFFFF),
    st.integers(0, 255),
    st.binary(max_size=8) | st.binary(max_size=64),
)


@needs_library
@settings(max_examples=200, deadline=None)
@given(st.lists(_ANY_FRAME, max_size=30), st.booleans(), st.sampled_from([1, 2, -1]))
def test_any_frames_are_as_long_as_numpy_says(
    rows: list[tuple[int, int, int, int, int, bytes]], intermission: bool, step: int
) -> None:
    standard = [
        (*row[:2], row[2] & (0x1FFFFFFF if row[3] & FrameFlag.EXTENDED else 0x7FF), *row[3:])
        for row in rows
    ]
    batch = FrameBatch.from_rows(standard)[::step]
    found = wire_bits(batch, intermission=intermission)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "available", lambda: False)
        expected = wire_bits(batch, intermission=intermission)
    assert found.dtype == expected.dtype
    assert found.tolist() == expected.tolist()


@needs_library
def test_mixed_shapes_are_as_long_as_the_bits_that_are_sent() -> None:
    rng = np.random.default_rng(11)
    batches, lengths = [], []
    for length in range(9):
        for extended, remote in ((False, False), (True, False), (False, True), (True, True)):
            shape = Shape(length, extended, remote)
            can_id = rng.integers(0, 1 << (29 if extended else 11), 300).astype(np.uint32)
            runs = rng.choice(np.array([0, 0xFF, 0x1F, 0x83, 0x55], np.uint8), (300, 8))
            runs[:, 0 if remote else length :] = 0
            flags = extended * FrameFlag.EXTENDED | remote * FrameFlag.REMOTE
            zeros = np.zeros(300, np.uint8)
            batches.append(
                FrameBatch(
                    np.zeros(300, np.int64),
                    zeros,
                    can_id,
                    np.full(300, flags, np.uint16),
                    zeros + np.uint8(length),
                    runs,
                )
            )
            lengths.append(send_classic(can_id, runs, shape).length)
    mixed = rng.permutation(300 * len(batches))
    bits, fd = wire_length._native_bits(FrameBatch.concat(batches)[mixed], 3)
    assert bits.tolist() == np.concatenate(lengths)[mixed].tolist()
    assert len(fd) == 0


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The package in another place, where its library can be damaged."""
    package = Path(native.__file__).parent.parent
    shutil.copytree(package, tmp_path / "syncline_schemas")
    return tmp_path / "syncline_schemas" / "native"


def says_available(folder: Path, **environment: str) -> bool:
    """Whether another process finds the library usable; it must compute lengths in any case."""
    program = (
        "from syncline_schemas import native; from syncline_schemas.batch import FrameBatch;"
        " from syncline_schemas.wire_length import wire_bits;"
        " assert wire_bits(FrameBatch.from_rows([(0, 0, 0x222, 0, 5, bytes(range(5)))]))[0] > 80;"
        " print(native.__file__, native.available())"
    )
    ran = subprocess.run(
        [sys.executable, "-P", "-c", f"import sys; sys.path.insert(0, {str(folder.parents[1])!r}); {program}"],
        capture_output=True,
        check=True,
        encoding="utf-8",
        env={**_environment(), **environment},
    )  # fmt: skip
    assert str(folder) in ran.stdout
    return ran.stdout.split()[-1] == "True"


def _environment() -> dict[str, str]:
    return {key: value for key, value in os.environ.items() if key != native.SWITCH}


@needs_library
def test_the_library_is_used_and_can_be_switched_off(copy: Path) -> None:
    assert says_available(copy)
    assert not says_available(copy, **{native.SWITCH: "0"})


def test_without_a_library_numpy_computes(copy: Path) -> None:
    (copy / build.LIBRARY.name).unlink(missing_ok=True)
    assert not says_available(copy)


def test_what_is_no_library_is_not_used(copy: Path) -> None:
    (copy / build.LIBRARY.name).write_bytes(b"\x7fELF of another machine")
    assert not says_available(copy)


@needs_library
def test_a_library_of_other_sources_is_not_used(copy: Path) -> None:
    with (copy / "library.c").open("a", encoding="utf-8") as source:
        source.write("/* newer */\n")
    assert not says_available(copy)


@needs_library
def test_line_ends_do_not_make_other_sources(copy: Path) -> None:
    source = copy / "library.c"
    source.write_bytes(source.read_bytes().replace(b"\n", b"\r\n"))
    assert says_available(copy)
