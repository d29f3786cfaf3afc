"""`syncline probe` against python-canopen's own nodes: what it asks, sends and records."""

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import can
import canopen
import pytest
from click.testing import CliRunner

from syncline_analyzer import open_session
from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_options import BusOptions
from syncline_logger.cli import cli
from syncline_logger.clock import RecorderClock
from syncline_logger.probe import NOT_THERE, NodeProbe, probe_node
from syncline_logger.probe_bus import ProbeSource
from syncline_logger.probe_command import parse_nodes
from syncline_schemas.batch import FrameFlag
from syncline_schemas.devices import identity_objects, load_device
from syncline_schemas.errors import SourceError
from tests.logger.capture_contents import doctor_complaints, read_capture, syncline

DEVICES = files("syncline_schemas.devices") / "data"
CHANNEL = "probe"


@contextlib.contextmanager
def machine(**devices: int) -> Iterator[list[can.Message]]:
    """Nodes by the name of their EDS; every frame on the bus goes into the list."""
    heard: list[can.Message] = []
    network = canopen.Network()
    with can.Bus(interface="virtual", channel=CHANNEL) as ear:
        network.connect(interface="virtual", channel=CHANNEL)
        listener = can.Notifier(ear, [heard.append])
        for name, node in devices.items():
            network.add_node(
                canopen.LocalNode(node, str(DEVICES / f"{name.replace('_', '-')}.eds"))
            )
        try:
            yield heard
        finally:
            network.disconnect()
            listener.stop()


def probe(folder: Path, *words: str, code: int = 0) -> Any:
    done = CliRunner().invoke(
        cli,
        ["probe", "-i", "virtual", "-c", CHANNEL, "-o", str(folder / "x.mcap"), *words],
    )
    assert done.exit_code == code, (done.output, done.exception)
    return done


def test_a_node_is_asked_and_everything_is_recorded(tmp_path: Path) -> None:
    with machine(jn2100=10) as heard:
        done = probe(tmp_path, "--nodes", "10")
    assert "node 10: " in done.stdout
    assert "this sends SDO read requests on probe to node 10" in done.stderr
    path = tmp_path / "x.mcap"
    assert doctor_complaints(path) == []
    contents = read_capture(path)
    frames = contents.frames("probe")
    ours = [frame for frame in frames if frame[1] & FrameFlag.TX]
    answers = [frame for frame in frames if not frame[1] & FrameFlag.TX]
    assert {can_id for can_id, *_ in ours} == {0x60A}
    assert {can_id for can_id, *_ in answers} == {0x58A}
    assert len(ours) == len(answers)
    # What is in the capture is what was on the bus, in that order, and nothing else was.
    assert [(m.arbitration_id, bytes(m.data)) for m in heard] == [
        (can_id, data) for can_id, _, _, data in frames
    ]
    assert not any(message.is_remote_frame for message in heard)
    # Every request is an upload (or an abort of one); nothing is ever written.
    assert {data[0] & 0xE0 for *_, data in ours} <= {0x40, 0x60, 0x80}


def test_the_capture_teaches_what_the_node_is(tmp_path: Path) -> None:
    with machine(jn2100=10):
        probe(tmp_path, "--nodes", "10")
    contents = read_capture(tmp_path / "x.mcap")
    asked = {
        (message.index, message.sub)
        for message in contents.values("/canopen/probe/node10/sdo")
        if message.request
    }
    assert {(0x1000, 0), (0x1008, 0), (0x1018, 1), (0x1800, 1), (0x1A00, 0), (0x6000, 0)} <= asked
    assert (0x1001, 0) not in asked, "some devices clear it when it is read"
    assert contents.metadata["syncline.device.probe.node10"]["device"] == "jn2100"


def test_only_the_given_nodes_are_asked_and_an_absent_one_soon_left_alone(tmp_path: Path) -> None:
    with machine(jn2100=10) as heard:
        done = probe(tmp_path, "--nodes", "3,10", "--timeout", "50ms")
    assert "node 3: no answer" in done.stdout
    assert {message.arbitration_id for message in heard} == {0x603, 0x60A, 0x58A}
    to_nobody = [bytes(m.data) for m in heard if m.arbitration_id == 0x603]
    # The question, and canopen's abort of it.
    assert [data[0] for data in to_nobody] == [0x40, 0x80]


def test_that_nobody_answers_is_told_and_no_success(tmp_path: Path) -> None:
    with machine():
        done = probe(tmp_path, "--nodes", "1-12", "--timeout", "5ms", "--pace", "1ms", code=1)
    assert done.stdout == ""
    assert "no answer from any of the 12 nodes; check the bit rate" in done.stderr
    assert "x.mcap: 24 frames" in done.stderr


def test_of_many_nodes_the_silent_ones_are_counted(tmp_path: Path) -> None:
    with machine(jn2100=10):
        done = probe(tmp_path, "--nodes", "1-12", "--timeout", "50ms", "--pace", "1ms")
    assert "no answer" not in done.stdout
    assert done.stdout.startswith("node 10: ")
    assert "11 nodes gave no answer" in done.stderr


class Deaf:
    """A bus that takes no frame: its controller is bus-off, or listens only."""

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("Transmit buffer full")


def requests(source: ProbeSource, buffer: FrameBuffer) -> None:
    source.read(buffer, 0, 0)
    source.send_sdo(0x605, bytes.fromhex("4000100000000000"))


def test_a_request_that_could_not_be_sent_is_not_in_the_capture() -> None:
    source = ProbeSource(BusOptions("a", "virtual", "x"))
    source.open()
    buffer = FrameBuffer(RecorderClock().now_ns, 10)
    try:
        requests(source, buffer)
        bus, source._bus = source._bus, Deaf()  # type: ignore[assignment]
        with pytest.raises(SourceError, match="cannot send: Transmit buffer full"):
            source.send_sdo(0x605, bytes.fromhex("4000100000000000"))
        source._bus = bus
    finally:
        source.close()
    assert buffer.take().frames.can_id.tolist() == [0x605]


def test_an_answer_that_is_there_at_once_stands_behind_its_request() -> None:
    """The thread that reads may be faster than the one that sends."""
    source = ProbeSource(BusOptions("a", "virtual", "x"))
    source.open()
    buffer = FrameBuffer(RecorderClock().now_ns, 10)
    source.read(buffer, 0, 0)
    answers: list[threading.Thread] = []

    class Quick:
        def send(self, message: can.Message, timeout: float | None = None) -> None:
            now_ns = RecorderClock().now_ns()
            answer = (now_ns, 0, 0x585, 0, 8, bytes(8))
            answers.append(threading.Thread(target=source._tee.append, args=answer))  # type: ignore[union-attr]
            answers[0].start()
            answers[0].join(0.2)

    bus, source._bus = source._bus, Quick()  # type: ignore[assignment]
    source.send_sdo(0x605, bytes.fromhex("4000100000000000"))
    answers[0].join()
    source._bus = bus
    source.close()
    frames = buffer.take().frames
    assert frames.can_id.tolist() == [0x605, 0x585]
    assert frames.t_ns[0] <= frames.t_ns[1]


def kinds(messages: Iterable[can.Message], can_id: int) -> Counter[int]:
    """How many frames of each command specifier."""
    return Counter(m.data[0] >> 5 for m in messages if m.arbitration_id == can_id)


UPLOAD, SEGMENT, ABORT = 2, 3, 4
"""Client command specifiers (CiA 301 7.2.4.3): those that write are 0, 1 and 6."""


def test_every_frame_of_ours_reads_and_every_one_waits_its_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses: list[float] = []
    monkeypatch.setattr("canopen.sdo.client.time.sleep", pauses.append)
    with machine(jn2100=10) as heard:
        done = probe(tmp_path, "--nodes", "10", "--pace", "35ms")
    ours, answers = kinds(heard, 0x60A), kinds(heard, 0x58A)
    assert ours.keys() <= {UPLOAD, SEGMENT}
    assert ours[UPLOAD] > 30
    assert pauses == [0.035] * ours.total()
    assert answers.total() == ours.total(), "nothing is asked before the answer is there"
    assert answers[ABORT] > 0
    assert f"{ours[UPLOAD] - answers[ABORT]} objects read, {answers[ABORT]} refused" in done.stdout
    assert "no other tool or master may use their SDO channels meanwhile" in done.stderr


def test_ctrl_c_ends_it_after_the_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = canopen.LocalNode.get_data

    def interrupted(node: Any, index: int, *words: Any, **more: Any) -> Any:
        if index == 0x1017:
            signal.raise_signal(signal.SIGINT)
            time.sleep(1)  # time enough for a recording that does not wait for the answer to end
        return answer(node, index, *words, **more)

    monkeypatch.setattr(canopen.LocalNode, "get_data", interrupted)
    with machine(jn2100=10) as heard:
        done = probe(tmp_path, "--nodes", "10,11", "--timeout", "20s")
    assert "interrupted: not every node was asked for everything" in done.stderr
    assert {message.arbitration_id for message in heard} == {0x60A, 0x58A}
    assert heard[-1].arbitration_id == 0x58A
    assert kinds(heard, 0x60A).total() == kinds(heard, 0x58A).total()
    contents = read_capture(tmp_path / "x.mcap")
    assert len(contents.frames("probe")) == len(heard)
    assert "syncline.stop" in contents.metadata


def test_a_reader_of_stdout_that_is_gone_ends_nothing(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    words = ("probe", "-i", "virtual", "-c", "x", "-o", str(tmp_path / "x.mcap"))
    done = subprocess.run(
        syncline(*words, "--nodes", "1-3", "--timeout", "20ms"),
        stdout=writer,
        stderr=subprocess.PIPE,
        check=False,
        encoding="utf-8",
    )
    os.close(writer)
    assert done.returncode == 1, done.stderr
    assert "no answer from any of the 3 nodes" in done.stderr
    asked = [frame[0] for frame in read_capture(tmp_path / "x.mcap").frames("x")]
    assert sorted(set(asked)) == [0x601, 0x602, 0x603]


@pytest.mark.parametrize("can_id", [0x000, 0x080, 0x585, 0x705, 0x680, 0x600])
def test_nothing_but_sdo_requests_can_be_sent(can_id: int) -> None:
    source = ProbeSource(BusOptions("a", "virtual", "x"))
    with pytest.raises(ValueError, match="is no SDO request"):
        source.network.send_message(can_id, b"\x01\x00")
    with pytest.raises(ValueError, match="remote frames are never sent"):
        source.network.send_message(0x705, b"", remote=True)


class Node:
    """Answers as a device of the catalogue does by its EDS."""

    def __init__(self, name: str, node: int, *, dies_after: int = 10**6) -> None:
        self._device = load_device(name)
        self._node = node
        self._left = dies_after
        self.asked: list[tuple[int, int]] = []

    def read(self, key: tuple[int, int]) -> bytes | int | None:
        self.asked.append(key)
        self._left -= 1
        if self._left < 0:
            return None
        if key == (0x1008, 0) and "name" in self._device.identity:
            return str(self._device.identity["name"]).encode()
        facts = self._device.object(*key)
        if facts is None:
            return NOT_THERE
        value = self._device.default(*key, self._node)
        if isinstance(value, int):
            return (value & 0xFFFFFFFF).to_bytes(4, "little")
        return value if value is not None else bytes(4)


@pytest.mark.parametrize(
    "name", ["lir-da158", "lir-da158a", "lir-ma158k", "lir-918", "jn2100", "haomiao-38"]
)
def test_every_known_device_is_asked_without_harm(name: str) -> None:
    node = Node(name, 5)
    found = probe_node(5, node.read)
    device = load_device(name)
    assert len(node.asked) == len(set(node.asked)), "nothing is asked twice"
    assert not set(node.asked) & set(device.quirks.clear_on_read)
    for key in node.asked:
        facts = device.object(*key)
        assert facts is None or facts.access.lower() != "wo"
    scales = {facts.scale_object for facts in device.facts.values() if facts.scale_object}
    assert found.device is None or scales <= found.values.keys() | found.refused.keys()


def test_a_node_that_goes_away_is_left_alone() -> None:
    node = Node("jn2100", 5, dies_after=10)
    found = probe_node(5, node.read)
    assert len(node.asked) == 12
    assert found.answered


def test_a_node_without_a_known_profile_is_asked_for_its_pdos_alone() -> None:
    values = {(0x1000, 0): (0x192).to_bytes(4, "little"), (0x1A00, 0): b"\x01"}
    asked = []

    def read(key: tuple[int, int]) -> bytes | int:
        asked.append(key)
        return values.get(key, NOT_THERE)

    found = probe_node(1, read)
    assert (0x1A00, 1) in asked
    profile = {index for index, _ in asked if index >= 0x6000}
    assert profile <= identity_objects(), "those tell devices apart"
    assert found.device is None


def test_a_node_that_is_not_there() -> None:
    found = probe_node(9, lambda key: None)
    assert found == NodeProbe(9)
    assert not found.answered


@pytest.mark.parametrize("text", ["", "0", "128", "5-3", "x", "1,,2"])
def test_nodes_that_are_none(text: str) -> None:
    done = CliRunner().invoke(cli, ["probe", "-i", "virtual", "-c", "x", "--nodes", text])
    assert done.exit_code == 2
    assert "is no node or range of 1..127" in done.output


def test_nodes() -> None:
    assert parse_nodes("5, 6,10-12,6") == [5, 6, 10, 11, 12]


def test_the_analyzer_learns_from_it(tmp_path: Path) -> None:
    pytest.importorskip("pandas", reason="needs the analyzer")
    with machine(jn2100=10):
        probe(tmp_path, "--nodes", "10")
    session = open_session(tmp_path / "x.mcap")
    (node,) = session.nodes().to_dict("records")
    assert (node["node"], node["device"]) == (10, "jn2100")
    known = session.objects(10)
    assert {0x1018, 0x1800, 0x6000} <= set(known["index"])
    assert "error" not in set(session.findings()["severity"])
