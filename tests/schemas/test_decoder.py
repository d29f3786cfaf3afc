"""Columnar decoders against struct, the canopen library and the standards' own examples."""

import datetime
import struct
from typing import Any

import canopen
import numpy as np
import pytest
from canopen.objectdictionary import ODVariable
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas.batch import FrameBatch
from syncline_schemas.canopen.datatypes import DATA_TYPES, decode_value
from syncline_schemas.canopen.emcy import code_meaning
from syncline_schemas.decoder import (
    PdoMapping,
    SdoColumns,
    SdoKind,
    decode_emcy,
    decode_error_control,
    decode_lss,
    decode_nmt,
    decode_pdo,
    decode_sdo,
    decode_sync,
    decode_time,
)
from syncline_schemas.devices import Device, load_device


def batch(*payloads: bytes) -> FrameBatch:
    return FrameBatch.from_rows([(0, 0, 0x181, 0, len(data), data) for data in payloads])


def sdo(*payloads: str, request: bool = False) -> SdoColumns:
    frames = batch(*(bytes.fromhex(text) for text in payloads))
    return decode_sdo(np.full(len(frames), request), frames.data, frames.dlc)


PDO_TYPES = [
    code for code, known in DATA_TYPES.items() if known.kind in ("signed", "unsigned", "bool")
]


@st.composite
def aligned_mappings(draw: st.DrawFn) -> list[tuple[int, int]]:
    """(data type, bits) of entries that fill at most eight bytes: whole bytes, then booleans.

    The library reads entries that are not aligned wrong (it cannot look past the type's size);
    those are compared with one long number instead.
    """
    entries: list[tuple[int, int]] = []
    for code in draw(st.lists(st.sampled_from(PDO_TYPES), max_size=8)):
        bits = DATA_TYPES[code].bits or 0
        if bits > 1 and sum(b for _, b in entries) + bits <= 56:
            entries.append((code, bits))
    return entries + [(0x01, 1)] * draw(st.integers(1, 8))


class _Typed:
    """A device that knows nothing but the data types of its objects."""

    def __init__(self, entries: list[tuple[int, int]]) -> None:
        from syncline_schemas.devices import ObjectFacts

        self._facts = {
            (0x2000, sub): ObjectFacts(0x2000, sub, f"v{sub}", data_type=code)
            for sub, (code, _) in enumerate(entries, 1)
        }

    def object(self, index: int, sub: int) -> Any:
        return self._facts.get((index, sub))


def canopen_map(entries: list[tuple[int, int]], data: bytes) -> list[int]:
    """What the canopen library reads from a PDO with this mapping."""
    node = canopen.LocalNode(1, canopen.ObjectDictionary())
    pdo_map = canopen.pdo.base.PdoMap(node.tpdo, None, None)
    offset = 0
    for sub, (code, bits) in enumerate(entries, 1):
        thing = ODVariable(f"v{sub}", 0x2000, sub)
        thing.data_type = code
        variable: Any = canopen.pdo.base.PdoVariable(thing)
        variable.pdo_parent = pdo_map
        variable.offset, variable.length = offset, bits
        pdo_map.map.append(variable)
        offset += bits
    pdo_map.data = bytearray(data)
    return [int(variable.raw) for variable in pdo_map.map]


@settings(max_examples=200, deadline=None)
@given(aligned_mappings(), st.binary(min_size=8, max_size=8))
def test_a_pdo_reads_as_the_canopen_library_reads_it(
    entries: list[tuple[int, int]], data: bytes
) -> None:
    values = [0x20000000 | sub << 8 | bits for sub, (_, bits) in enumerate(entries, 1)]
    device: Any = _Typed(entries)
    frames = batch(data)
    columns = decode_pdo(PdoMapping.from_objects(values, device), frames.data, frames.dlc)
    assert [int(column.raw[0]) for column in columns] == canopen_map(entries, data)
    assert all(column.valid[0] for column in columns)


WIDTHS = st.lists(st.tuples(st.integers(1, 64), st.booleans()), min_size=1, max_size=20)


@settings(max_examples=200)
@given(WIDTHS, st.binary(min_size=64, max_size=64))
def test_bits_are_cut_as_one_long_little_endian_number(
    entries: list[tuple[int, bool]], data: bytes
) -> None:
    device: Any = _Typed([(0x15 if signed else 0x1B, 64) for _, signed in entries])
    values = [0x2000_0000 | sub << 8 | width for sub, (width, _) in enumerate(entries, 1)]
    frames = batch(data)
    columns = decode_pdo(PdoMapping.from_objects(values, device), frames.data, frames.dlc)
    whole, offset = int.from_bytes(data, "little"), 0
    for (width, signed), column in zip(entries, columns, strict=True):
        fits = offset + width <= 512
        assert bool(column.valid[0]) == fits
        if fits:
            bits = whole >> offset & ((1 << width) - 1)
            negative = signed and bits >> (width - 1)
            assert int(column.raw[0]) == bits - (1 << width) * bool(negative)
        offset += width


def test_floats_and_dummies() -> None:
    device: Any = _Typed([(0x08, 32), (0x11, 64)])
    single, double = struct.pack("<f", 1.5), struct.pack("<d", -2.25)
    mapping = PdoMapping.from_objects([0x0005_0008, 0x2000_0120], device)
    frames = batch(b"\xff" + single)
    (column,) = decode_pdo(mapping, frames.data, frames.dlc)
    assert (column.entry.offset, column.raw[0]) == (8, 1.5)
    frames = batch(double)
    (column,) = decode_pdo(PdoMapping.from_objects([0x2000_0240], device), frames.data, frames.dlc)
    assert column.raw[0] == -2.25


def test_a_short_frame_is_not_valid_for_what_it_does_not_hold() -> None:
    mapping = PdoMapping.from_objects([0x6010_0010, 0x6020_0010], load_device("jn2100"))
    frames = batch(bytes.fromhex("E40C2C01"), bytes.fromhex("E40C2C"), b"")
    longitudinal, lateral = decode_pdo(mapping, frames.data, frames.dlc)
    assert longitudinal.valid.tolist() == [True, True, False]
    assert lateral.valid.tolist() == [True, False, False]
    assert longitudinal.value[:2].tolist() == pytest.approx([330.0, 330.0])
    assert np.isnan(longitudinal.value[2])


def scale_of(device: Device, known: int | None) -> Any:
    mapping = PdoMapping.from_objects([0x6010_0010], device, lambda *_: known)
    return mapping.entries[0].scale, mapping.entries[0].scale_assumed


def test_a_scale_that_nobody_read_is_marked_as_assumed() -> None:
    device = load_device("jn2100")
    assert scale_of(device, 10) == (pytest.approx(0.01), False)
    assert scale_of(device, None) == (pytest.approx(0.1), True)


def test_names_come_from_the_device_else_from_the_index() -> None:
    plain = PdoMapping.from_objects([0x6004_0020]).entries[0]
    named = PdoMapping.from_objects([0x6004_0020], load_device("lir-da158")).entries[0]
    assert (plain.name, named.name, named.unit) == ("6004h:00", "Position value", "counts")


@pytest.mark.parametrize("value", [0, 0x6004_0000, 0x6004_00FF, 0xFFFF_FFFF, 1 << 40])
def test_a_mapping_that_makes_no_sense_has_no_valid_row(value: int) -> None:
    frames = batch(b"\x01" * 8)
    columns = decode_pdo(PdoMapping.from_objects([value]), frames.data, frames.dlc)
    assert not any(column.valid.any() for column in columns)


@pytest.mark.parametrize(
    ("request_", "text", "kind", "size", "payload"),
    [
        (True, "2F00180201000000", SdoKind.DOWNLOAD_REQUEST, 1, "01"),
        (True, "2B17100001F40000", SdoKind.DOWNLOAD_REQUEST, 2, "01f4"),
        (True, "2700180201020300", SdoKind.DOWNLOAD_REQUEST, 3, "010203"),
        (True, "2310100173617665", SdoKind.DOWNLOAD_REQUEST, 4, "73617665"),
        (True, "2210100173617665", SdoKind.DOWNLOAD_REQUEST, -1, "73617665"),
        (True, "221010017361", SdoKind.DOWNLOAD_REQUEST, -1, "7361"),
        (True, "2108100006000000", SdoKind.DOWNLOAD_REQUEST, 6, ""),
        (True, "4008100000000000", SdoKind.UPLOAD_REQUEST, -1, ""),
        (False, "4208100001020304", SdoKind.UPLOAD_ANSWER, -1, "01020304"),
        (False, "4108100006000000", SdoKind.UPLOAD_ANSWER, 6, ""),
        (False, "6008100000000000", SdoKind.DOWNLOAD_ANSWER, -1, ""),
        (True, "6000000000000000", SdoKind.UPLOAD_SEGMENT_REQUEST, -1, ""),
        (False, "034A4E3231303000", SdoKind.UPLOAD_SEGMENT, 6, "4a4e32313030"),
        (True, "1D41000000000000", SdoKind.DOWNLOAD_SEGMENT, 1, "41"),
        (False, "3000000000000000", SdoKind.DOWNLOAD_SEGMENT_ANSWER, -1, ""),
        (True, "A408100020000000", SdoKind.BLOCK_UPLOAD, -1, ""),
        (False, "C608100006000000", SdoKind.BLOCK_UPLOAD, -1, ""),
        (True, "C608100006000000", SdoKind.BLOCK_DOWNLOAD, -1, ""),
        (False, "A408100020000000", SdoKind.BLOCK_DOWNLOAD, -1, ""),
        (False, "8000180311000906", SdoKind.ABORT, -1, ""),
        (True, "E000000000000000", SdoKind.UNKNOWN, -1, ""),
        (True, "", SdoKind.UNKNOWN, -1, ""),
    ],
)
def test_sdo_command_specifiers(
    request_: bool, text: str, kind: SdoKind, size: int, payload: str
) -> None:
    columns = sdo(text, request=request_)
    assert SdoKind(int(columns.kind[0])) == kind
    assert int(columns.size[0]) == size
    assert columns.payload[0, : columns.length[0]].tobytes().hex() == payload


def test_sdo_addresses_aborts_toggles_and_ends() -> None:
    columns = sdo("4F00180205000000", "8000180311000906", "034A4E3231303000", "10", "4F0018")
    assert columns.index[:2].tolist() == [0x1800, 0x1800]
    assert columns.sub[:2].tolist() == [2, 3]
    assert columns.abort_code.tolist() == [0, 0x06090011, 0, 0, 0]
    assert columns.addressed.tolist() == [True, True, False, False, False]
    assert columns.toggle.tolist() == [0, 0, 0, 1, 0]
    assert columns.last.tolist() == [False, False, True, False, False]


def test_block_transfers_are_addressed_only_where_they_start() -> None:
    up = sdo("A408100020000000", "A300000000000000", "A200000000000000", request=True)
    down = sdo("C608100006000000", "C100000000000000", request=True)
    answers = sdo("A408100020000000", "A200000000000000", "C608100006000000", "C100000000000000")
    assert up.addressed.tolist() == [True, False, False]
    assert down.addressed.tolist() == [True, False]
    assert answers.addressed.tolist() == [True, False, True, False]


@settings(max_examples=100)
@given(st.lists(st.tuples(st.booleans(), st.binary(max_size=8)), max_size=20))
def test_no_frame_raises(rows: list[tuple[bool, bytes]]) -> None:
    frames = batch(*(data for _, data in rows))
    request = np.array([is_request for is_request, _ in rows], np.bool_)
    columns = decode_sdo(request, frames.data, frames.dlc)
    assert len(columns.kind) == len(rows)
    for decode in (decode_nmt, decode_emcy, decode_time):
        decode(frames.data, frames.dlc)
    decode_error_control(frames.data, frames.dlc, request)
    decode_lss(frames.can_id, frames.data, frames.dlc)


def test_sync_counters() -> None:
    frames = batch(b"", b"\x05", b"\x00\x00")
    assert decode_sync(frames.data, frames.dlc).tolist() == [-1, 5, -1]


def test_time_of_day() -> None:
    moment = datetime.datetime(2026, 11, 22, 3, 15, tzinfo=datetime.UTC)
    since = moment - datetime.datetime(1984, 1, 1, tzinfo=datetime.UTC)
    data = struct.pack("<LH", since.seconds * 1000, since.days)
    frames = batch(data, data[:5])
    columns = decode_time(frames.data, frames.dlc)
    assert int(columns.t_ns[0]) == int(moment.timestamp()) * 10**9
    assert columns.valid.tolist() == [True, False]


def test_nmt_and_emcy_lengths() -> None:
    frames = batch(b"\x01\x05", b"\x01", b"\x01\x05\x00")
    assert decode_nmt(frames.data, frames.dlc).valid.tolist() == [True, False, False]
    frames = batch(b"\x30\x81\x11\0\0\0\0\0", b"\x30\x81")
    emcy = decode_emcy(frames.data, frames.dlc)
    assert emcy.code.tolist() == [0x8130, 0x8130]
    assert emcy.valid.tolist() == [True, False]


def test_error_control_of_every_kind() -> None:
    frames = batch(b"\x00", b"\x85", b"", b"", b"\x80")
    remote = np.array([False, False, False, True, False])
    columns = decode_error_control(frames.data, frames.dlc, remote)
    assert columns.boot_up.tolist() == [True, False, False, False, False]
    assert columns.empty.tolist() == [False, False, True, False, False]
    assert columns.request.tolist() == remote.tolist()
    assert columns.state.tolist() == [0, 5, 0, 0, 0]
    assert columns.toggle.tolist() == [0, 1, 0, 0, 1]


def test_lss_directions() -> None:
    frames = FrameBatch.from_rows(
        [(0, 0, can_id, 0, 8, b"\x5a" + bytes(7)) for can_id in (0x7E5, 0x7E4)]
    )
    columns = decode_lss(frames.can_id, frames.data, frames.dlc)
    assert columns.request.tolist() == [True, False]
    assert columns.command.tolist() == [0x5A, 0x5A]


@settings(max_examples=200)
@given(
    st.sampled_from(sorted(canopen.objectdictionary.ODVariable.STRUCT_TYPES)),
    st.binary(min_size=8, max_size=8),
)
def test_values_read_as_the_canopen_library_reads_them(code: int, data: bytes) -> None:
    variable = ODVariable("x", 0x2000)
    variable.data_type = code
    exact = data[: len(variable) // 8]
    if code == 0x01:
        exact = bytes([exact[0] & 1])
    expected = variable.decode_raw(exact)
    if isinstance(expected, bool):
        expected = int(expected)
    assert decode_value(code, exact) == pytest.approx(expected, nan_ok=True)


@given(st.integers(0, 0xFFFF), st.integers(0, 86_399_999))
def test_times_are_days_and_milliseconds(days: int, ms: int) -> None:
    data = ms.to_bytes(4, "little") + days.to_bytes(2, "little")
    since = datetime.timedelta(days=days, milliseconds=ms)
    moment = datetime.datetime(1984, 1, 1) + since  # noqa: DTZ001
    said = f"{moment:%H:%M:%S}.{ms % 1000:03d}"
    assert decode_value(0x0C, data) == f"{moment:%Y-%m-%d} {said}"
    assert decode_value(0x0D, data) == f"{days} d {said}"


def test_values_that_are_too_short_stay_bytes() -> None:
    assert decode_value(0x07, b"\x01\x02") == b"\x01\x02"
    assert decode_value(None, b"\x01") == b"\x01"
    assert decode_value(0x09, b"L158\0\0") == "L158"


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (0x0000, "no error"),
        (0x2310, "output side"),
        (0x4210, "device temperature"),
        (0xFF01, "specific"),
    ],
)
def test_emcy_groups_of_cia_301(code: int, said: str) -> None:
    assert said in code_meaning(code)
