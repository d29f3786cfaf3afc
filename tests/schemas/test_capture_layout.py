"""The messages and their bytes: schemas, generated code, fixed offsets."""

import importlib.util
import struct

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.capture.frame_record import pack_frames
from syncline_schemas.capture.gap_message import gap_message, gap_of
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata, topic_part
from syncline_schemas.capture.message import schema_of
from syncline_schemas.capture.pdo_message import FieldType, PdoField, PdoMessage, field_names
from syncline_schemas.proto import generate, syncline_pb2
from tests.schemas.capture_builder import T0, Row


def packed(*frames: Row) -> list[bytes]:
    batch = FrameBatch.from_rows(frames)
    sequence = np.arange(len(batch), dtype=np.uint32)
    data, length = pack_frames(batch, np.full(256, 7, np.uint16), sequence, batch.t_ns)
    cuts = np.cumsum(length)[:-1]
    return [part.tobytes() for part in np.split(data, cuts)]


@pytest.mark.skipif(importlib.util.find_spec("grpc_tools") is None, reason="needs grpcio-tools")
def test_committed_code_is_what_the_proto_file_generates() -> None:
    for path, text in generate.generated().items():
        assert path.read_text(encoding="utf-8") == text


def test_no_message_has_an_enum() -> None:
    assert not syncline_pb2.DESCRIPTOR.enum_types_by_name
    for message in syncline_pb2.DESCRIPTOR.message_types_by_name.values():
        assert not message.enum_types


def test_frame_payload_is_the_protobuf_serialization_with_every_field_present() -> None:
    (record,) = packed((T0, 0, 0x18A, 0, 2, b"\x01\x02"))
    assert record[31:] == bytes.fromhex("0d8a010000 1500000000 1802 2202 0102")
    frame = syncline_pb2.Frame(can_id=0x18A, flags=0, dlc=2, data=b"\x01\x02")
    assert record[31:] == frame.SerializeToString()


def test_message_record_head_is_as_the_mcap_specification_says() -> None:
    (record,) = packed((T0, 0, 0x18A, 0, 2, b"\x01\x02"))
    assert struct.unpack_from("<BQHIQQ", record) == (0x05, len(record) - 9, 7, 0, T0, T0)


@pytest.mark.parametrize("length", [*range(9), 12, 16, 20, 24, 32, 48, 64])
def test_equal_length_in_bytes_means_equal_record_length(length: int) -> None:
    smallest = (0, 0, 0, 0, length, bytes(length))
    largest = (2**62, 255, 0x1FFF_FFFF, 0xFFFD, length, b"\xff" * length)
    error = (T0, 1, 0x1FFF_FFFF, FrameFlag.ERROR, length, b"\x80" * length)
    assert {len(record) for record in packed(smallest, largest, error)} == {45 + length}


@pytest.mark.parametrize("dlc", range(9))
def test_remote_frame_keeps_its_length_and_has_no_data(dlc: int) -> None:
    (record,) = packed((T0, 0, 0x701, FrameFlag.REMOTE, dlc, b""))
    frame = syncline_pb2.Frame.FromString(record[31:])
    assert (frame.dlc, frame.data, len(record)) == (dlc, b"", 45)


def test_schema_carries_all_that_is_needed_to_decode() -> None:
    schema = schema_of(syncline_pb2.Emcy.DESCRIPTOR)
    assert (schema.name, schema.encoding) == ("syncline.Emcy", "protobuf")
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    assert pool.FindMessageTypeByName("syncline.Emcy").fields_by_name["meaning"].number == 2


COLUMNS: list[tuple[FieldType, list[float | bool]]] = [
    ("double", [1.5, -2.0, float("inf")]),
    ("float", [0.5, 0.0, -1.0]),
    ("int64", [-(2**63), 0, 2**63 - 1]),
    ("uint64", [0, 1, 2**64 - 1]),
    ("int32", [-(2**31), 0, 2**31 - 1]),
    ("uint32", [0, 1, 2**32 - 1]),
    ("bool", [True, False, True]),
]


@pytest.mark.parametrize("copies", [1, 5])
def test_pdo_messages_are_read_by_protobuf_from_their_own_schema(copies: int) -> None:
    fields = [PdoField(f"{kind} {i}", "", kind) for i in range(copies) for kind, _ in COLUMNS]
    values = [column for _ in range(copies) for _, column in COLUMNS]
    kinds = [kind for _ in range(copies) for kind, _ in COLUMNS]
    made = PdoMessage("can0_node10_tpdo1", fields)
    numpy_type = {"double": "f8", "float": "f4", "bool": "?"}
    rows = made.pack(
        [np.array(v, numpy_type.get(k, k)) for k, v in zip(kinds, values, strict=True)]
    )
    pool = DescriptorPool()
    pool.Add(FileDescriptorSet.FromString(made.schema.data).file[0])
    decoder = GetMessageClass(pool.FindMessageTypeByName(made.schema.name))
    for row in range(3):
        message = decoder.FromString(rows[row].tobytes())
        got = [getattr(message, name) for name in made.field_names]
        assert got == [column[row] for column in values]
        assert all(message.HasField(name) for name in made.field_names)


def test_pdo_field_names_are_unique_and_tell_the_unit() -> None:
    fields = [
        PdoField("Position value", "deg"),
        PdoField("Position value", "deg"),
        PdoField("Slope long16 (°)", "°"),
        PdoField("2nd speed", "rpm"),
        PdoField("", ""),
        PdoField("speed_rpm", "rpm"),
    ]
    assert field_names(fields) == [
        "position_value_deg",
        "position_value_deg_2",
        "slope_long16_deg",
        "n2nd_speed_rpm",
        "value",
        "speed_rpm",
    ]
    made = PdoMessage("a-b/c", fields)
    assert made.schema.name == "syncline.pdo.a_b_c"
    assert made.channel_metadata["unit.position_value_deg_2"] == "deg"
    assert made.channel_metadata["object.slope_long16_deg"] == "Slope long16 (°)"


def test_pdo_of_nothing_packs_nothing() -> None:
    assert PdoMessage("empty", []).pack([]).shape == (0, 0)


def test_metadata_survives_its_record() -> None:
    metadata = CaptureMetadata(
        "1.2", "id", 3, "host", 5, "kernel", 1000, "relative", "candump", {"own": "key"}
    )
    assert CaptureMetadata.from_record(metadata.to_record()) == metadata
    assert CaptureMetadata.from_record({"segment": "x"}) == CaptureMetadata("", "")


def test_bus_survives_its_channel() -> None:
    bus = BusInfo("can0", 4, 500_000, 2_000_000, "socketcan", "can0", "no SYNC", "kernel", 1)
    assert BusInfo.from_channel(bus.to_channel(), 0) == bus
    assert BusInfo.from_channel({"number": "999"}, 2) == BusInfo("bus2", 2)


@pytest.mark.parametrize(
    ("name", "part"), [("can0", "can0"), ("can 0/../ü", "can_0_.."), ("///", "_"), ("COM3", "COM3")]
)
def test_a_bus_name_is_one_part_of_a_topic(name: str, part: str) -> None:
    assert topic_part(name) == part


@pytest.mark.parametrize("gap", [Gap(-5, 7, "why"), Gap(0, 2**62, "", 0, 0), Gap(1, 2, "x", 9, 3)])
def test_gap_survives_its_message(gap: Gap) -> None:
    message = syncline_pb2.Gap.FromString(gap_message(gap).SerializeToString())
    assert gap_of(message) == gap


@pytest.mark.parametrize("number", ["0", "-5", "1" + "0" * 30, "9" * 400, "x", ""])
def test_rates_and_steps_that_there_are_not_are_unknown(number: str) -> None:
    """A damaged capture: with them nothing could be computed, or less than nothing."""
    rates = {"bitrate": number, "data_bitrate": number, "resolution_ns": number}
    bus = BusInfo.from_channel({"bus": "line", **rates}, 0)
    assert bus == BusInfo("line", 0)
    assert CaptureMetadata.from_record({"resolution_ns": number}).resolution_ns == 1
