"""SDO transfers as the `canopen` library makes them: its client against its server, and blocks.

The library's server knows no block transfers; there the server of the samples answers.
"""

import logging
from collections.abc import Callable, Sequence
from typing import Any

import canopen
import pytest
from canopen.objectdictionary import ODVariable, datatypes
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

from syncline_analyzer.results import SdoRow
from syncline_samples.objects import Object, ObjectDictionary
from syncline_samples.sdo_server import SdoServer as SampleServer
from tests.analyzer.sdo_builder import Row, fold_table, sdo_frame

TEXT = b"a text that is longer than one segment, and than two of them"


class Wire:
    """Hands frames from one side to the other at once, and keeps them."""

    def __init__(self, node: int) -> None:
        self.node = node
        self.rows: list[Row] = []
        self.server: Callable[[bytes], None] = lambda data: None
        self.client: Callable[[bytes], None] = lambda data: None

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        data = bytes(data)
        request = can_id == 0x600 + self.node
        side = ">" if request else "<"
        self.rows.append(sdo_frame(len(self.rows) * 400, side, self.node, data))
        (self.server if request else self.client)(data)

    def found(self) -> Sequence[SdoRow]:
        return fold_table(self.rows).rows


def library_node(node: int = 5) -> tuple[Wire, SdoClient]:
    wire = Wire(node)
    od = canopen.ObjectDictionary()
    for index, kind in ((0x2000, datatypes.VISIBLE_STRING), (0x2001, datatypes.UNSIGNED16)):
        variable = ODVariable("object", index, 0)
        variable.data_type, variable.access_type = kind, "rw"
        od.add_object(variable)
    local = canopen.LocalNode(node, od)
    server = SdoServer(0x600 + node, 0x580 + node, local)
    client = SdoClient(0x600 + node, 0x580 + node, canopen.ObjectDictionary())
    server.network = client.network = wire  # type: ignore[assignment]
    wire.server = lambda data: server.on_request(0x600 + node, bytearray(data), 0.0)
    wire.client = lambda data: client.on_response(0x580 + node, bytearray(data), 0.0)
    return wire, client


def sample_node(**server: Any) -> tuple[Wire, SdoClient]:
    wire = Wire(5)
    objects = ObjectDictionary([Object(0x2000, 0, "str", "rw", TEXT)])
    answers = SampleServer(objects, block=True)
    for name, value in server.items():
        setattr(answers, name, value)
    client = SdoClient(0x605, 0x585, canopen.ObjectDictionary())
    client.RESPONSE_TIMEOUT = 0.01
    client.network = wire  # type: ignore[assignment]
    wire.client = lambda data: client.on_response(0x585, bytearray(data), 0.0)

    def served(data: bytes) -> None:
        for frame in answers.answer(data):
            wire.send_message(0x585, frame)

    wire.server = served
    return wire, client


def told(row: SdoRow) -> tuple[object, ...]:
    return row.direction, row.kind, row.result, row.data


@pytest.mark.parametrize("data", [b"\x01\x02", b"abcd", b"abcde", TEXT, TEXT[:56]])
def test_the_library_reads_back_what_it_wrote(data: bytes) -> None:
    wire, client = library_node()
    client.download(0x2000, 0, data)
    assert client.upload(0x2000, 0) == data
    kind = "expedited" if len(data) <= 4 else "segmented"
    assert [told(row) for row in wire.found()] == [
        ("download", kind, "ok", data),
        ("upload", kind, "ok", data),
    ]
    assert {row.size for row in wire.found()} == {len(data)}


def test_a_short_write_that_is_forced_into_segments() -> None:
    wire, client = library_node()
    client.download(0x2001, 0, b"\x34\x12", force_segment=True)
    assert [told(row) for row in wire.found()] == [("download", "segmented", "ok", b"\x34\x12")]


def test_what_the_library_s_server_refuses() -> None:
    wire, client = library_node()
    with pytest.raises(SdoAbortedError):
        client.upload(0x2002, 0)
    (row,) = wire.found()
    assert (row.result, row.abort_code, row.abort_by) == ("abort", 0x06020000, "server")


def test_a_block_read_that_the_server_answers_with_segments() -> None:
    """The library's server takes a request for a block upload as a normal one (protocol switch)."""
    wire, client = library_node()
    client.download(0x2000, 0, TEXT)
    with pytest.raises(canopen.SdoCommunicationError):
        client.open(0x2000, 0, "rb", block_transfer=True)
    switched = wire.found()[1]
    assert (switched.kind, switched.result) == ("segmented", "abort")
    assert (switched.abort_by, switched.abort_code) == ("client", 0x05040001)


@pytest.mark.parametrize("crc", [True, False])
@pytest.mark.parametrize("length", [5, 7, 14, 60])
def test_block_transfers_of_the_library_s_client(length: int, crc: bool) -> None:
    wire, client = sample_node(block_size=3, crc=crc)
    data = TEXT[:length]
    with client.open(
        0x2000, 0, "wb", size=length, block_transfer=True, request_crc_support=crc
    ) as stream:
        stream.write(data)
    with client.open(0x2000, 0, "rb", block_transfer=True, request_crc_support=crc) as stream:
        assert stream.read() == data
    write, read = wire.found()
    assert told(write) == ("download", "block", "ok", data)
    assert told(read) == ("upload", "block", "ok", data)
    assert {write.crc_ok, read.crc_ok} == ({True} if crc else {None})


def test_a_block_write_whose_segments_the_server_loses() -> None:
    wire, client = sample_node(block_size=4, lose=(1,))
    with client.open(0x2000, 0, "wb", size=len(TEXT), block_transfer=True) as stream:
        stream.write(TEXT)
    (row,) = wire.found()
    assert told(row) == ("download", "block", "ok", TEXT)
    assert row.crc_ok


def test_a_block_read_that_ends_with_a_wrong_crc(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)
    wire, client = sample_node(spoil_crc=True)
    with (
        pytest.raises(canopen.SdoCommunicationError),
        client.open(0x2000, 0, "rb", block_transfer=True) as stream,
    ):
        stream.read()
    (row,) = wire.found()
    assert row.crc_ok is False
    assert (row.result, row.abort_by, row.abort_code) == ("abort", "client", 0x05040004)
