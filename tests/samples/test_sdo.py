"""The simulated SDO server and client against python-canopen's, frame by frame, and on a bus."""

import gc
from itertools import pairwise
from typing import Any, cast

import canopen
import pytest
from canopen.sdo.client import SdoClient as OtherClient
from canopen.sdo.server import SdoServer as OtherServer

from syncline_samples import abort
from syncline_samples.bus import Frame
from syncline_samples.devices import IoModule
from syncline_samples.faults import (
    BlockCrcWrong,
    BlockSegmentsLost,
    NodeSearch,
    SdoAccess,
    SdoClientAborts,
    SdoClientStops,
    SdoLate,
    SdoReset,
    SdoServerAborts,
    SdoServerStops,
    SdoTwoClients,
)
from syncline_samples.machine import DeviceSpec, Fault, Run, Scenario
from syncline_samples.objects import Object, ObjectDictionary
from syncline_samples.sdo_client import SdoClient, SdoJob, read, write, write_block, write_text
from syncline_samples.sdo_server import SdoServer
from syncline_samples.truth import SdoTruth
from syncline_schemas.batch import FrameBatch
from tests.samples.bench import Bench

LONG = bytes(number * 13 & 0xFF for number in range(1000))
OBJECTS = [
    Object(0x2000, 0, "u32", "rw", 0x11223344),
    Object(0x2001, 0, "str", "rw", LONG),
    Object(0x2002, 0, "str", "ro", b"name"),
]


class Wire:
    """python-canopen's client talks to our server without a bus; keeps what the client sends."""

    def __init__(self, **options: bool) -> None:
        self.objects = ObjectDictionary(OBJECTS)
        self.server = SdoServer(self.objects, block=True, **options)
        self.client = OtherClient(0x605, 0x585, canopen.ObjectDictionary())
        self.client.network = cast(canopen.Network, self)
        self.sent: list[bytes] = []

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.sent.append(bytes(data))
        for answer in self.server.answer(bytes(data)):
            self.client.on_response(0x585, bytearray(answer), 0.0)

    def read_block(self, **options: bool) -> bytes:
        stream: Any = self.client.open(0x2001, 0, "rb", block_transfer=True, **options)
        with stream:
            return bytes(stream.read())

    def write_block(self, data: bytes) -> None:
        stream: Any = self.client.open(0x2001, 0, "wb", size=len(data), block_transfer=True)
        with stream:
            stream.write(data)


@pytest.mark.parametrize("size", [1, 4, 5, 7, 8, 14, 139, 140, 141, 999])
def test_other_client_writes_a_block(size: int) -> None:
    wire = Wire()
    wire.write_block(LONG[:size])
    assert wire.objects.read(0x2001, 0) == LONG[:size]


def test_other_client_reads_a_block_with_and_without_crc() -> None:
    assert Wire().read_block() == LONG
    without = Wire()
    without.server.crc = False
    assert without.read_block() == LONG


def test_other_client_sees_a_wrong_crc() -> None:
    wire = Wire()
    wire.server.spoil_crc = True
    with pytest.raises(canopen.SdoCommunicationError, match="CRC"):
        wire.read_block()


def test_other_client_sends_lost_segments_again() -> None:
    wire = Wire()
    wire.server.lose = (3, 30)
    wire.write_block(LONG)
    assert wire.objects.read(0x2001, 0) == LONG


def test_other_client_segments_both_ways() -> None:
    wire = Wire()
    wire.client.download(0x2001, 0, b"a text of more than seven bytes")
    assert wire.client.upload(0x2001, 0) == b"a text of more than seven bytes"
    sizeless = Wire(sizeless=True)
    assert sizeless.client.upload(0x2001, 0) == LONG


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_other_client_is_told_of_a_refusal_before_the_data() -> None:
    wire = Wire()
    with pytest.raises(canopen.SdoAbortedError) as refusal:
        wire.client.download(0x2002, 0, LONG)
    assert refusal.value.code == abort.READ_ONLY
    assert len(wire.sent) == 1
    # Its stream is closed when it is collected, which is refused as well; Python 3.13 tells that,
    # and shall do so here rather than in a later test.
    del refusal
    gc.collect()


class OtherNode:
    """python-canopen's server on our bus."""

    def __init__(self, bench: Bench) -> None:
        dictionary = canopen.ObjectDictionary()
        for index, kind in ((0x2000, 0x7), (0x2001, 0xF)):
            variable = canopen.objectdictionary.ODVariable(f"object {index:X}", index)
            variable.data_type = kind
            dictionary.add_object(variable)
        self.node = canopen.LocalNode(5, dictionary)
        self.node.sdo = OtherServer(0x605, 0x585, self.node)
        self.node.sdo.network = cast(canopen.Network, self)
        self._bench = bench
        bench.bus.listen(0x605, lambda frame, t_ns: self.node.sdo.on_request(0, frame.data, 0.0))

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        frame = Frame(can_id, bytes(data))
        later_ns = self._bench.simulation.now_ns + 200_000
        self._bench.simulation.at(later_ns, self._bench.bus.send, frame, self)


def with_other_server(*jobs: SdoJob) -> list[SdoTruth]:
    bench = Bench()
    OtherNode(bench)
    SdoClient(bench.world, 5).run(*jobs)
    bench.wait(2000)
    return bench.world.truth.sdo


def test_our_client_with_the_other_server() -> None:
    text = b"moved to cabinet C"
    rows = with_other_server(
        write(0x2000, 0, 77, 4),
        read(0x2000),
        write_text(0x2001, 0, text),
        read(0x2001),
        SdoJob(0x2001, block=True),
        read(0x2FFF),
    )
    assert [(row.result, row.kind, row.data) for row in rows[:4]] == [
        ("ok", "expedited", (77).to_bytes(4, "little")),
        ("ok", "expedited", (77).to_bytes(4, "little")),
        ("ok", "segmented", text),
        ("ok", "segmented", text),
    ]
    assert (rows[4].kind, rows[4].data) == ("segmented", text), "it has no block upload"
    assert (rows[5].result, rows[5].abort_code) == ("abort", abort.NO_OBJECT)


@pytest.mark.parametrize("size", [5, 7, 141, 999])
def test_our_block_write_is_the_other_ones(size: int) -> None:
    """Both write the same bytes to our server, frame for frame, but for unused bytes."""
    wire = Wire()
    wire.write_block(LONG[:size])
    bench = Bench()
    bench.boot(IoModule(bench.world, 5))
    seen: list[bytes] = []
    bench.bus.listen(0x605, lambda frame, t_ns: seen.append(frame.data))
    SdoClient(bench.world, 5).run(write_block(0x2001, 0, LONG[:size]))
    bench.wait(1000)
    assert bench.world.truth.sdo[0].result == "abort", "no such object on the I/O module"
    SdoClient(bench.world, 5).run(write_block(0x2F02, 0, LONG[:size]))
    bench.wait(1000)
    ours = [seen[1][:1] + b"\x01\x20\x00" + seen[1][4:], *seen[2:]]
    assert ours == wire.sent


def io_run(*faults: Fault, seconds: float = 5.0) -> Run:
    devices = (DeviceSpec(30, "io", "cabinet"), DeviceSpec(31, "io", "cabinet 2"))
    return Scenario("io", seconds, devices, faults, sync_us=0).run()


def rows_of(run: Run, node: int = 30) -> list[SdoTruth]:
    return [row for row in run.truth.sdo if row.node == node]


OUTCOMES: list[tuple[Fault, list[tuple[str, str, int | None, str | None]]]] = [
    (SdoServerAborts(30, 3.0), [("abort", "segmented", abort.HARDWARE, "server")]),
    (SdoClientAborts(30, 3.0), [("abort", "segmented", abort.MEMORY, "client")]),
    (SdoClientStops(30, 3.0), [("abort", "segmented", abort.TIMEOUT, "server")]),
    (SdoClientStops(30, 3.0, server_timeout_ms=0), [("interrupted", "segmented", None, None)]),
    (SdoServerStops(30, 3.0), [("interrupted", "segmented", None, None)]),
    (SdoReset(30, 3.0), [("interrupted", "segmented", None, None)]),
    (SdoReset(30, 3.0, read(0x1000), 300), [("interrupted", "expedited", None, None)]),
    (SdoLate(30, 3.0), [("ok", "expedited", None, None)]),
    (SdoLate(30, 3.0, on_timeout="abort"), [("abort", "expedited", abort.TIMEOUT, "client")]),
    (
        SdoLate(30, 3.0, then=(read(0x1018, 1),)),
        [("no answer", "expedited", None, None), ("ok", "expedited", None, None)],
    ),
    (BlockSegmentsLost(30, 3.0), [("ok", "block", None, None)]),
    (BlockCrcWrong(30, 3.0), [("abort", "block", abort.CRC, "client")]),
    (
        BlockCrcWrong(30, 3.0, write_block(0x1F50, 1, LONG)),
        [("abort", "block", abort.CRC, "server")],
    ),
]


@pytest.mark.parametrize(("fault", "outcome"), OUTCOMES)
def test_scripted_transfers_end_as_scripted(
    fault: Fault, outcome: list[tuple[str, str, int | None, str | None]]
) -> None:
    rows = rows_of(io_run(fault))
    assert [(row.result, row.kind, row.abort_code, row.aborted_by) for row in rows] == outcome


def test_two_clients_both_get_their_answers() -> None:
    rows = rows_of(io_run(SdoTwoClients(30, 3.0)))
    assert len(rows) == 7
    assert {row.result for row in rows} == {"ok"}
    overlaps = [a for a, b in pairwise(rows) if b.start_ns < a.end_ns]
    assert overlaps


def test_second_client_on_another_node_runs_in_between() -> None:
    long_read = SdoAccess(30, 3.0, (read(0x2F02),))
    run = io_run(long_read, SdoAccess(31, 3.0, (read(0x2F02), read(0x2F00))))
    first, second = rows_of(run, 30)[0], rows_of(run, 31)[0]
    assert first.start_ns < second.end_ns < first.end_ns + 1_000_000_000
    assert first.data == second.data
    assert len(first.data) == 2999


def test_searched_nodes_do_not_answer() -> None:
    run = io_run(NodeSearch(2.0))
    absent = [row for row in run.truth.sdo if row.node in (61, 62, 63)]
    assert {row.result for row in absent} == {"no answer"}
    assert len(absent) == 6
    assert run.truth.counts["guard_requests", 61] == 2
    assert sum(row.node in (61, 62, 63) for row in run.truth.commands) == 6


def answers(run: Run) -> int:
    batches = [batch for batch in run.batches if isinstance(batch, FrameBatch)]
    return sum(int((batch.can_id == 0x59E).sum()) for batch in batches)


def test_lost_segments_are_sent_again() -> None:
    plain = io_run(SdoAccess(30, 3.0, (SdoJob(0x2F00, block=True),)))
    lossy = io_run(BlockSegmentsLost(30, 3.0))
    again = answers(lossy) - answers(plain)
    assert again == 18 + 17, "the rest of both sub-blocks"
    assert rows_of(lossy)[0].data == rows_of(plain)[0].data


def test_an_unanswered_request_before_a_reset_is_marked_as_uncertain() -> None:
    run = io_run(SdoReset(30, 3.0, read(0x1000), 300), SdoAccess(30, 4.0, (read(0x1000),)))
    assert [row.certain for row in rows_of(run)] == [False, True]


def test_a_request_before_a_long_reset_is_interrupted_and_not_unanswered() -> None:
    """A LIR is silent for 4 s after a reset: the client gives up long before."""
    fault = SdoReset(5, 6.0, read(0x1000), 300)
    run = Scenario("lir", 8.0, (DeviceSpec(5, "lir-da158", "drum"),), (fault,), sync_us=0).run()
    row = run.truth.sdo[-1]
    assert (row.result, row.certain) == ("interrupted", False)
