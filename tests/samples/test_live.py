"""python-canopen, an independent client, against the simulated devices over a virtual bus."""

from collections.abc import Iterator
from typing import Any

import can
import canopen
import pytest

from syncline_samples.live import LiveMachine
from syncline_samples.machine import DeviceSpec, Machine, Scenario
from syncline_samples.play import play

CHANNEL = "samples-test-live"


@pytest.fixture(scope="module")
def network() -> Iterator[canopen.Network]:
    devices = (
        DeviceSpec(10, "jn2100", "tilt"),
        DeviceSpec(20, "haomiao-38", "lift"),
        DeviceSpec(5, "lir-da158", "drum"),
        DeviceSpec(6, "lir-918", "winder"),
        DeviceSpec(30, "io", "cabinet"),
    )
    machine = Machine(Scenario("live", 60.0, devices, sync_us=0))
    machine.simulation.run_until(6_000_000_000)
    machine.recorder.take()
    with can.Bus(interface="virtual", channel=CHANNEL) as bus, LiveMachine(machine, bus):
        network = canopen.Network()
        network.connect(interface="virtual", channel=CHANNEL)
        for spec in devices:
            network.add_node(spec.node_id, canopen.ObjectDictionary())
        yield network
        network.disconnect()


@pytest.mark.parametrize(
    ("node", "name"),
    [(10, b"JN2100"), (20, b"MAGA"), (5, b"L158"), (6, b"L918"), (30, b"simulated I/O 8/8")],
)
def test_device_name(network: canopen.Network, node: int, name: bytes) -> None:
    assert network[node].sdo.upload(0x1008, 0) == name


def test_numbers_come_in_their_width(network: canopen.Network) -> None:
    assert network[10].sdo.upload(0x6000, 0) == (100).to_bytes(2, "little")
    assert network[20].sdo.upload(0x6001, 0) == (8192).to_bytes(4, "little")
    assert network[6].sdo.upload(0x6502, 0) == (4096).to_bytes(2, "little")
    assert network[5].sdo.upload(0x1017, 0) == bytes(4), "the old LIR answers with 43h"


def test_write_and_read_back(network: canopen.Network) -> None:
    network[10].sdo.download(0x6000, 0, (10).to_bytes(2, "little"))
    assert network[10].sdo.upload(0x6000, 0) == (10).to_bytes(2, "little")


def test_aborts_have_their_codes(network: canopen.Network) -> None:
    for node, index, sub, code in (
        (6, 0x6200, 0, 0x06020000),
        (5, 0x1800, 3, 0x06090011),
        (6, 0x6003, 0, 0x06010001),
    ):
        with pytest.raises(canopen.SdoAbortedError) as refusal:
            network[node].sdo.upload(index, sub)
        assert refusal.value.code == code
    with pytest.raises(canopen.SdoAbortedError) as refusal:
        network[5].sdo.download(0x1010, 1, b"evas")
    assert refusal.value.code == 0x08000020


def test_segmented_write(network: canopen.Network) -> None:
    network[30].sdo.download(0x2F01, 0, b"a text of more than seven bytes")
    assert network[30].sdo.upload(0x2F01, 0) == b"a text of more than seven bytes"


def test_block_upload(network: canopen.Network) -> None:
    client: Any = network[30].sdo
    with client.open(0x2F00, 0, "rb", block_transfer=True) as stream:
        assert stream.read() == bytes(range(256)) * 4


def test_play_sends_every_frame_in_order() -> None:
    """A short run, four times as fast as it is."""
    run = Scenario("short", 2.0, (DeviceSpec(10, "jn2100", "tilt"),), sync_us=50_000).start()
    with (
        can.Bus(interface="virtual", channel="samples-test-play") as player,
        can.Bus(interface="virtual", channel="samples-test-play") as listener,
    ):
        sent = play(run, player, speed=4.0)
        heard = [listener.recv(1.0) for _ in range(sent)]
    assert sent == run.truth.frames
    assert all(message is not None for message in heard)
    again = run.scenario.run()
    ids = [int(can_id) for batch in again.batches for can_id in getattr(batch, "can_id", [])]
    assert [message.arbitration_id for message in heard if message] == ids
