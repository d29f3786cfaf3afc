"""Frames from python-can's interfaces, bit-exact, and never anything sent to them."""

from itertools import count
from typing import Any

import can
import pytest
from can.interfaces.virtual import VirtualBus

from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_options import BusOptions
from syncline_logger.clock import RecorderClock
from syncline_logger.sources.python_can import PythonCanSource
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.errors import SourceError

UTC_NS = 1_763_780_000_123_456_789
"""A stamp of today; a float of seconds holds it to 238 ns."""


class Machine:
    """UTC and elapsed time that a test moves."""

    def __init__(self) -> None:
        self.elapsed_ns = 5_000_000_000

    def clock(self) -> RecorderClock:
        return RecorderClock(
            lambda: UTC_NS - 5_000_000_000 + self.elapsed_ns, lambda: self.elapsed_ns
        )


def received(*messages: can.Message, **options: Any) -> FrameBatch:
    """The frames that a source gives for messages sent on its bus."""
    channel = f"test-{next(_channels)}"
    source = PythonCanSource(
        BusOptions("a", "virtual", channel, arguments={"preserve_timestamps": True}, **options)
    )
    source.use_clock(Machine().clock())
    source.open()
    buffer = FrameBuffer(lambda: 42, 100)
    with VirtualBus(channel, preserve_timestamps=True) as sender:
        for message in messages:
            sender.send(message)
        while source.read(buffer, 3, 0.02):
            pass
    source.close()
    return buffer.take().frames


_channels = count()


def row(frames: FrameBatch) -> tuple[int, FrameFlag, int, bytes]:
    assert len(frames) == 1
    return (
        int(frames.can_id[0]),
        FrameFlag(int(frames.flags[0])),
        int(frames.dlc[0]),
        frames.data[0].tobytes(),
    )


def message(**values: Any) -> can.Message:
    defaults = {"timestamp": UTC_NS / 1e9, "arbitration_id": 0x185, "is_extended_id": False}
    return can.Message(**(defaults | values))


def test_a_data_frame() -> None:
    frames = received(message(data=b"\x01\x02\x03"))
    assert row(frames) == (0x185, FrameFlag(0), 3, b"\x01\x02\x03".ljust(8, b"\0"))
    assert frames.bus.tolist() == [3]


def test_an_extended_frame() -> None:
    frames = received(message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=bytes(8)))
    assert row(frames) == (0x1FFFFFFF, FrameFlag.EXTENDED, 8, bytes(8))


def test_a_remote_frame_keeps_the_length_it_asks_for() -> None:
    frames = received(message(is_remote_frame=True, dlc=5))
    assert row(frames) == (0x185, FrameFlag.REMOTE, 5, bytes(8))


def test_an_error_frame_keeps_its_bytes() -> None:
    data = bytes([0, 0x30, 0, 0, 0, 0, 128, 200])
    frames = received(message(arbitration_id=0x204, is_error_frame=True, data=data))
    assert row(frames) == (0x204, FrameFlag.ERROR, 8, data)


def test_an_fd_frame() -> None:
    data = bytes(range(64))
    sent = message(is_fd=True, bitrate_switch=True, error_state_indicator=True, data=data, dlc=64)
    expected = FrameFlag.FD | FrameFlag.BRS | FrameFlag.ESI
    assert row(received(sent)) == (0x185, expected, 64, data)


def test_a_raw_dlc_above_8_is_8_bytes_in_classic_can() -> None:
    assert row(received(message(dlc=15, data=bytes(8)))) == (0x185, FrameFlag(0), 8, bytes(8))


def test_a_length_that_contradicts_the_data_is_marked() -> None:
    got = row(received(message(dlc=5, data=b"\x01")))
    assert got == (0x185, FrameFlag.DLC_INVALID, 1, b"\x01".ljust(8, b"\0"))


def test_the_stamp_is_the_float_that_python_can_gave() -> None:
    stamp_ns = int(received(message()).t_ns[0])
    assert stamp_ns / 10**9 == UTC_NS / 1e9
    assert abs(stamp_ns - UTC_NS) <= 120


def test_no_stamp_becomes_the_recorders_time() -> None:
    assert received(message(timestamp=0.0)).t_ns.tolist() == [42]


def test_stamps_since_the_adapters_start_are_moved_to_utc() -> None:
    frames = received(message(timestamp=12.5), message(timestamp=12.52))
    assert frames.t_ns.tolist() == [UTC_NS, UTC_NS + 20_000_000]


def source_of_stamps(interface: str, machine: Machine) -> PythonCanSource:
    source = PythonCanSource(BusOptions("a", interface, "x"))
    source.use_clock(machine.clock())
    return source


@pytest.mark.parametrize("start_s", [0.25, UTC_NS / 1e9])
def test_the_drift_of_an_adapter_is_followed_for_days(start_s: float) -> None:
    machine = Machine()
    source = source_of_stamps("kvaser", machine)
    offsets = []
    for minute in range(4 * 24 * 60):
        passed_s = minute * 60.0
        machine.elapsed_ns = 5_000_000_000 + round(passed_s * 1e9) + 300_000
        t_ns = source._t_ns(start_s + passed_s * (1 + 50e-6))
        offsets.append(t_ns - UTC_NS - round(passed_s * 1e9))
    assert max(map(abs, offsets[10:])) < 1_000_000, "one offset would be 17 s off by now"
    knots = source.clock_knots()
    assert abs(knots[-1].rate_ppb + 50_000) < 100
    assert source.clock_knots() == []


def test_stamps_of_the_kernel_are_utc_even_where_the_date_was_never_set() -> None:
    source = source_of_stamps("socketcan", Machine())
    source.use_clock(RecorderClock(lambda: 20_000_000_000, lambda: 20_000_000_000))
    assert source._t_ns(19.5) == 19_500_000_000
    assert source.clock_knots() == []


def test_stamps_near_zero_of_an_unknown_adapter_are_no_utc() -> None:
    source = source_of_stamps("ixxat", Machine())
    source.use_clock(RecorderClock(lambda: 20_000_000_000, lambda: 20_000_000_000))
    assert source._t_ns(3.5) == 20_000_000_000


def test_it_never_sends() -> None:
    source = PythonCanSource(BusOptions("a", "virtual", "silence"))
    with VirtualBus("silence") as other:
        source.open()
        other.send(message(data=b"\x05"))
        source.read(FrameBuffer(lambda: 1, 10), 0, 0)
        source.close()
        assert other.recv(0) is None


def opened_with(monkeypatch: pytest.MonkeyPatch, options: BusOptions) -> dict[str, Any]:
    given: dict[str, Any] = {}

    def bus(**arguments: Any) -> VirtualBus:
        given.update(arguments)
        return VirtualBus("opened-with")

    monkeypatch.setattr(can, "Bus", bus)
    source = PythonCanSource(options)
    source.open()
    source.close()
    return given


@pytest.mark.parametrize(
    ("interface", "key", "value"),
    [
        ("slcan", "listen_only", True),
        ("vector", "listen_only", True),
        ("pcan", "state", can.BusState.PASSIVE),
        ("kvaser", "driver_mode", False),
        ("cantact", "monitor", True),
    ],
)
def test_listen_only_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, interface: str, key: str, value: object
) -> None:
    options = BusOptions("a", interface, "x")
    assert opened_with(monkeypatch, options)[key] == value
    assert PythonCanSource(options).facts.listen_only
    acknowledging = BusOptions("a", interface, "x", acknowledge=True)
    assert key not in opened_with(monkeypatch, acknowledging)


def test_the_options_reach_python_can(monkeypatch: pytest.MonkeyPatch) -> None:
    options = BusOptions(
        "a",
        "vector",
        1,
        bitrate=500_000,
        fd=True,
        data_bitrate=2_000_000,
        filters=({"can_id": 0x100, "can_mask": 0x7F0},),
        arguments={"app_name": "x", "listen_only": False},
    )
    assert opened_with(monkeypatch, options) == {
        "interface": "vector",
        "channel": 1,
        "bitrate": 500_000,
        "fd": True,
        "data_bitrate": 2_000_000,
        "can_filters": [{"can_id": 0x100, "can_mask": 0x7F0}],
        "app_name": "x",
        "listen_only": False,
        "single_handle": True,
        "receive_own_messages": False,
    }


def test_bit_timing_becomes_python_cans_own(monkeypatch: pytest.MonkeyPatch) -> None:
    timing = {"f_clock": 8_000_000, "brp": 1, "tseg1": 13, "tseg2": 2, "sjw": 1}
    given = opened_with(monkeypatch, BusOptions("a", "slcan", "x", timing=timing))
    assert given["timing"].bitrate == 500_000


def test_the_bit_rates_of_a_bit_timing_are_recorded() -> None:
    classic = {"f_clock": 8_000_000, "brp": 1, "tseg1": 13, "tseg2": 2, "sjw": 1}
    assert PythonCanSource(BusOptions("a", "slcan", "x", timing=classic)).facts.bitrate == 500_000
    fd = {
        "f_clock": 80_000_000,
        "nom_brp": 1, "nom_tseg1": 119, "nom_tseg2": 40, "nom_sjw": 40,
        "data_brp": 1, "data_tseg1": 29, "data_tseg2": 10, "data_sjw": 10,
    }  # fmt: skip
    facts = PythonCanSource(BusOptions("a", "pcan", "x", timing=fd, fd=True)).facts
    assert (facts.bitrate, facts.data_bitrate) == (500_000, 2_000_000)
    wrong = BusOptions("a", "pcan", "x", bitrate=125_000, timing={"brp": 0})
    assert PythonCanSource(wrong).facts.bitrate == 125_000


def test_filters_are_applied() -> None:
    frames = received(
        message(arbitration_id=0x185),
        message(arbitration_id=0x285),
        filters=({"can_id": 0x280, "can_mask": 0x780},),
    )
    assert frames.can_id.tolist() == [0x285]


def test_without_an_interface_python_cans_configuration_decides(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("CAN_INTERFACE", "slcan")
    monkeypatch.setenv("CAN_CHANNEL", "/dev/none")
    source = PythonCanSource(BusOptions("can"))
    facts = source.facts
    assert (facts.interface, facts.channel, facts.listen_only) == ("slcan", "/dev/none", True)


def test_an_unknown_interface_is_told_with_those_that_exist() -> None:
    with pytest.raises(SourceError, match=r"no interface 'nonsense'.* slcan, socketcan"):
        PythonCanSource(BusOptions("press", "nonsense", "x")).open()


def test_a_bus_that_cannot_be_opened_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: object, *args: object, **kwargs: object) -> None:
        raise can.CanInitializationError("no such device")

    monkeypatch.setattr(VirtualBus, "__init__", fail)
    with pytest.raises(SourceError, match=r"bus 'press' \(\w+ x\): cannot open: "):
        PythonCanSource(BusOptions("press", "virtual", "x")).open()


def test_a_bus_that_fails_while_reading_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    source = PythonCanSource(BusOptions("press", "virtual", "x"))
    source.open()

    def fail(self: object, timeout: float | None) -> None:
        raise can.CanOperationError("Network is down")

    monkeypatch.setattr(VirtualBus, "_recv_internal", fail)
    with pytest.raises(SourceError, match=r"bus 'press' .*: lost: Network is down"):
        source.read(FrameBuffer(lambda: 1, 10), 0, 0)
    source.close()
