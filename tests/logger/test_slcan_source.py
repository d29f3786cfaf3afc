"""Serial adapters over a pseudo terminal: opened to listen, read in bulk, lost and back."""

import itertools
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from syncline_logger.batcher import Collected, FrameBuffer, Loss
from syncline_logger.bus_options import BusOptions
from syncline_logger.clock import RecorderClock
from syncline_logger.recorder import record
from syncline_logger.sources.choice import source_of
from syncline_logger.sources.python_can import PythonCanSource
from syncline_logger.sources.slcan import SlcanSource
from syncline_schemas.batch import FrameFlag
from syncline_schemas.can_errors import Controller, ErrorClass
from syncline_schemas.errors import SourceError
from tests.logger.capture_contents import doctor_complaints, read_capture
from tests.logger.slcan_adapter import Adapter, unplug_all

pytest.importorskip("serial")
if sys.platform == "win32":
    pytest.skip("no pseudo terminals on Windows", allow_module_level=True)

TRANSMITS = tuple(b"tTrRdDbBx")
"""Letters of commands that send a frame."""


@pytest.fixture(autouse=True)
def _unplug_all() -> Iterator[None]:
    yield
    unplug_all()


def options(adapter: Adapter, **values: Any) -> BusOptions:
    arguments = {"sleep_after_open": 0.05, **values.pop("arguments", {})}
    return BusOptions(
        "a", "slcan", adapter.port, **{"bitrate": 500_000, **values}, arguments=arguments
    )


@pytest.fixture
def opened() -> Iterator[list[SlcanSource]]:
    """Sources that are closed after the test."""
    sources: list[SlcanSource] = []
    yield sources
    for source in sources:
        source.close()


def read(source: SlcanSource, frames: int, buffer: FrameBuffer | None = None) -> Collected:
    buffer = buffer or FrameBuffer(RecorderClock().now_ns, 10_000)
    count = 0
    while count < frames:
        count += source.read(buffer, 2, 5)
    return buffer.take()


def test_it_listens_and_writes_nothing_that_sends(opened: list[SlcanSource]) -> None:
    adapter = Adapter(b"t1852AABB\rT1ABCDE050\rr7054\r")
    source = SlcanSource(options(adapter))
    opened.append(source)
    source.open()
    got = read(source, 3).frames
    assert got.can_id.tolist() == [0x185, 0x1ABCDE05, 0x705]
    assert got.flags.tolist() == [0, FrameFlag.EXTENDED, FrameFlag.REMOTE]
    assert got.bus.tolist() == [2, 2, 2]
    source.close()
    assert [line for line in adapter.told if line != b"F"][:4] == [b"C", b"C", b"S6", b"L"]
    assert not [line for line in adapter.told if line[0] in TRANSMITS]
    assert source.facts.listen_only
    assert source.facts.notes == ()
    assert source.facts.clock == "host"


def test_frames_that_arrive_together_are_apart_by_their_length() -> None:
    machine = Machine()
    source = SlcanSource(BusOptions("a", "slcan", "x", bitrate=500_000), machine.clock())
    buffer = FrameBuffer(machine.clock().now_ns, 1000)
    source.take([b"t18580011223344556677\r" * 50], [machine.elapsed_ns], buffer, 0)
    assert set(np.diff(buffer.take().frames.t_ns).tolist()) == {222_000}, "111 bits of 2 us"


def test_nothing_is_stamped_before_the_adapter_was_opened(opened: list[SlcanSource]) -> None:
    adapter = Adapter(b"t18580011223344556677\r" * 50)
    source = SlcanSource(options(adapter))
    opened.append(source)
    source.open()
    open_ns = source._clock.now_ns()
    assert read(source, 50).frames.t_ns.min() >= open_ns


def test_all_options_become_commands(opened: list[SlcanSource]) -> None:
    adapter = Adapter()
    chosen = options(
        adapter,
        bitrate=1_000_000,
        fd=True,
        data_bitrate=2_000_000,
        acknowledge=True,
        arguments={"timestamps": True},
    )
    source = SlcanSource(chosen)
    opened.append(source)
    source.open()
    assert adapter.opened.wait(5)
    assert adapter.told[:6] == [b"C", b"C", b"S8", b"Y2", b"Z1", b"O"]
    assert not source.facts.listen_only
    assert (source.facts.clock, source.facts.resolution_ns) == ("hardware", 1_000_000)


@pytest.mark.parametrize(
    ("refuses", "told", "listens", "word"),
    [
        (b"L", [b"L", b"M1", b"O"], True, "silent with M1"),
        (b"LM", [b"L", b"M1", b"O"], False, "cannot only listen"),
        (b"S", [b"S6", b"L"], True, "refused the command S6"),
    ],
)
def test_what_the_adapter_refuses_is_told(
    opened: list[SlcanSource], refuses: bytes, told: list[bytes], listens: bool, word: str
) -> None:
    adapter = Adapter(refuses=refuses)
    source = SlcanSource(options(adapter))
    opened.append(source)
    source.open()
    assert adapter.opened.wait(5)
    assert [line for line in adapter.told if line in told] == told
    assert source.facts.listen_only == listens
    (note,) = source.facts.notes
    assert word in note


def test_an_adapter_that_answers_nothing_is_read_all_the_same(opened: list[SlcanSource]) -> None:
    adapter = Adapter(b"t0800\r", mute=True)
    source = SlcanSource(options(adapter))
    opened.append(source)
    source.open()
    assert read(source, 1).frames.can_id.tolist() == [0x080]
    assert "answers no command" in source.facts.notes[0]


def test_damaged_lines_are_a_loss_of_the_adapter(opened: list[SlcanSource]) -> None:
    adapter = Adapter(b"t0800\rt18580011\rt0800\r")
    source = SlcanSource(options(adapter))
    opened.append(source)
    source.open()
    buffer = FrameBuffer(RecorderClock().now_ns, 10_000)
    count = 0
    while count < 2:
        count += source.read(buffer, 2, 5)
    source.read(buffer, 2, 0)
    collected = buffer.take()
    assert len(collected.frames) == 2
    (loss,) = collected.losses
    assert (loss.bus, loss.where, loss.frames) == (2, "line", 1)


def test_the_controllers_state_and_overruns_become_error_frames(
    opened: list[SlcanSource],
) -> None:
    adapter = Adapter(b"sp130000\re1a\rt0800\r", status=b"F29")
    source = SlcanSource(options(adapter))
    opened.append(source)
    source.open()
    frames = read(source, 4).frames
    errors = frames[(frames.flags & FrameFlag.ERROR) != 0]
    bits = Controller.RX_OVERFLOW | Controller.RX_PASSIVE
    assert sorted(errors.can_id.tolist()) == [
        ErrorClass.CONTROLLER,
        ErrorClass.PROTOCOL | ErrorClass.NO_ACK | ErrorClass.BUS_ERROR,
        ErrorClass.CONTROLLER | ErrorClass.COUNTERS,
    ]
    assert bits in errors.data[:, 1].tolist()


class Machine:
    """Elapsed time that a test moves; UTC is a year after it."""

    def __init__(self) -> None:
        self.elapsed_ns = 100_000_000_000

    def clock(self) -> RecorderClock:
        return RecorderClock(
            lambda: self.elapsed_ns + 365 * 86_400_000_000_000, lambda: self.elapsed_ns
        )


@pytest.mark.parametrize("digits", [4, 8])
def test_stamps_of_the_adapter_are_used_when_they_are_proven(digits: int) -> None:
    machine = Machine()
    clock = machine.clock()
    source = SlcanSource(BusOptions("a", "slcan", "x", arguments={"timestamps": True}), clock)
    buffer = FrameBuffer(clock.now_ns, 100_000)
    true_ns = machine.elapsed_ns + np.arange(0, 150_000_000_000, 150_000_000)
    unit_ns, wrap = (1_000_000, 60_000) if digits == 4 else (1_000, 1 << 32)
    for row, at_ns in enumerate(true_ns.tolist()):
        machine.elapsed_ns = at_ns + (300_000, 4_000_000)[row % 2]
        count = round((at_ns - int(true_ns[0])) * (1 + 60e-6) + 59e9) // unit_ns % wrap
        line = f"t0800{count:0{digits}X}\r".encode()
        source.take([line], [machine.elapsed_ns], buffer, 0)
    error = buffer.take().frames.t_ns - (true_ns + clock.offset_ns + 300_000)
    assert np.abs(error[-500:]).max() <= 2 * unit_ns + 100_000
    assert max(abs(knot.rate_ppb + 60_000) for knot in source.clock_knots()[-3:]) < 15_000


def test_stamps_that_are_no_clock_are_not_used() -> None:
    machine = Machine()
    clock = machine.clock()
    source = SlcanSource(BusOptions("a", "slcan", "x"), clock)
    buffer = FrameBuffer(clock.now_ns, 1_000)
    for count in range(300):
        machine.elapsed_ns += 10_000_000
        line = f"t0800{count:04X}\r".encode()
        source.take([line], [machine.elapsed_ns], buffer, 0)
    assert np.diff(buffer.take().frames.t_ns).tolist() == [10_000_000] * 299
    assert source.clock_knots() == []


def test_filters(opened: list[SlcanSource]) -> None:
    adapter = Adapter(b"t0800\rt1850\rt2850\rt1851AA\r")
    chosen = options(adapter, filters=({"can_id": 0x185, "can_mask": 0x7FF},))
    source = SlcanSource(chosen)
    opened.append(source)
    source.open()
    assert read(source, 2).frames.can_id.tolist() == [0x185, 0x185]


def test_an_adapter_that_is_unplugged_is_told() -> None:
    adapter = Adapter(b"t0800\r")
    source = SlcanSource(options(adapter))
    source.open()
    read(source, 1)
    adapter.unplug()
    with pytest.raises(SourceError, match=r"bus 'a' \(slcan /dev/.*\): lost: "):
        read(source, 1)
    source.close()
    with pytest.raises(SourceError, match=r"bus 'a' \(slcan /dev/.*\): cannot open: "):
        source.open()


def test_a_bit_rate_that_no_adapter_knows() -> None:
    with pytest.raises(SourceError, match="no bit rate of 333333 bit/s; they know 10000, "):
        SlcanSource(BusOptions("a", "slcan", "/dev/none", bitrate=333_333)).open()


def test_what_only_python_can_knows_goes_to_python_can() -> None:
    native = source_of(BusOptions("a", "slcan", "x", arguments={"rtscts": True}))
    assert isinstance(native, SlcanSource)
    other = source_of(BusOptions("a", "slcan", "x", arguments={"poll_interval": 1}))
    assert isinstance(other, PythonCanSource)
    assert "poll_interval" in other.facts.notes[0]


def test_it_is_recorded(tmp_path: Path) -> None:
    numbered = [b"t1858" + n.to_bytes(8, "big").hex().upper().encode() for n in range(500)]
    adapter = Adapter(b"".join(line + b"\r" for line in [*numbered, b"T1ABCDE0521122"]))
    stop = threading.Event()
    source = SlcanSource(options(adapter))
    seen = 0

    def count(*_: object) -> None:
        nonlocal seen
        seen += 1
        if seen > 2 and adapter.opened.is_set():
            stop.set()

    result = record([source], tmp_path, stop=stop, on_status=count, status_period_ns=500_000_000)
    assert doctor_complaints(result.path) == []
    frames = read_capture(result.path).frames("a")
    assert frames[:500] == [(0x185, 0, 8, n.to_bytes(8, "big")) for n in range(500)]
    assert frames[500:] == [(0x1ABCDE05, 1, 2, b"\x11\x22")]
    assert set(adapter.told) <= {b"C", b"S6", b"L", b"F"}


class Answers:
    """A port that only notes what is written to it."""

    def __init__(self) -> None:
        self.written: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.written.append(data)


def asked_every_second(*answers: bytes) -> tuple[list[bytes], FrameBuffer, str]:
    """What is written when these bytes come after each second, the losses, and the error."""
    machine, port = Machine(), Answers()
    source = SlcanSource(BusOptions("a", "slcan", "x", bitrate=500_000), machine.clock())
    buffer = FrameBuffer(machine.clock().now_ns, 1000)
    for answer in answers:
        try:
            source._check_channel(buffer, 0)
            source._ask_status(port)
        except SourceError as error:
            return port.written, buffer, str(error)
        if answer:
            source.take([answer], [machine.elapsed_ns], buffer, 0)
        machine.elapsed_ns += 1_000_000_000
    return port.written, buffer, ""


def test_an_adapter_that_was_reset_is_lost() -> None:
    written, buffer, error = asked_every_second(b"F00\r", b"t0800\rF00\r", b"\a", b"\a", b"\a")
    assert "the adapter was reset" in error
    assert len(written) == 4
    [loss] = buffer.take().losses
    assert (loss.where, loss.last_ns - loss.first_ns) == ("closed", 3_000_000_000)


def test_an_adapter_that_falls_silent_is_lost() -> None:
    _, _, error = asked_every_second(b"F00\r", *[b""] * 20)
    assert "answers no more" in error


def test_a_lost_answer_does_not_end_asking() -> None:
    written, _, error = asked_every_second(b"F00\r", b"t0800\r", b"F0\r", b"\a", *[b"F00\r"] * 3)
    assert (len(written), error) == (7, "")


def test_an_adapter_that_never_knew_the_status_is_not_lost() -> None:
    written, _, error = asked_every_second(*[b"\a"] * 10, *[b""] * 80)
    assert (len(written), error) == (3, "")


def damaged(sent: list[tuple[int, bytes]]) -> tuple[int, list[Loss], RecorderClock]:
    """Frames that came of these bytes [after ms], the losses told, and the clock at the end."""
    machine = Machine()
    clock = machine.clock()
    source = SlcanSource(BusOptions("a", "slcan", "x", bitrate=500_000), clock)
    source._port, source._ask_at_ns = Answers(), 1 << 62
    buffer = FrameBuffer(clock.now_ns, 100_000)
    losses: list[Loss] = []
    count = 0

    def read(data: bytes, timeout_s: float) -> None:
        nonlocal count
        source._early = data
        count += source.read(buffer, 0, timeout_s)
        losses.extend(buffer.take().losses)

    source._received = lambda port, timeout_s: b""  # type: ignore[method-assign]
    for after_ms, data in sent:
        machine.elapsed_ns += after_ms * 1_000_000
        read(data, 0.1)
    read(b"", 0)
    return count, losses, clock


LINE = b"t18580011223344556677"


def test_damage_is_no_longer_than_what_came_with_it() -> None:
    _, [loss], clock = damaged([(1000, b"t0800\r"), (1000, b"t08\rt0800\r")])
    assert loss.where == "line"
    assert (loss.last_ns, loss.last_ns - loss.first_ns) == (clock.now_ns(), 20_000_000)


def test_damage_without_end_is_told_once_a_second_with_all_its_lines() -> None:
    rng = Random(4)
    sent, data = 0, []
    for _ in range(2_000):
        lines = [bytearray(LINE + b"\r") for _ in range(5)]
        sent += len(lines)
        for line in lines:
            if rng.random() < 0.3:
                line[rng.randrange(len(line) - 1)] = rng.choice(b"~?#z")
        data.append((10, b"".join(lines)))
    received, losses, _ = damaged(data)
    assert received + sum(loss.frames or 0 for loss in losses) == sent
    assert 19 <= len(losses) <= 21, "20 s"
    assert all(a.last_ns <= b.first_ns for a, b in itertools.pairwise(losses))
    assert all(loss.last_ns - loss.first_ns <= 1_020_000_000 for loss in losses)


def test_damage_that_is_over_is_told_within_a_second() -> None:
    _, [first, second], _ = damaged(
        [(100, b"t08\r"), (100, b"t0800\rt08\r"), (5000, b""), (100, b"t08\r"), (100, b"")]
    )
    assert (first.frames, second.frames) == (2, 1)
    assert first.log_ns < second.first_ns
    assert first.last_ns - first.first_ns == 120_000_000


def test_damage_before_the_adapter_is_lost_is_told() -> None:
    machine = Machine()
    source = SlcanSource(BusOptions("a", "slcan", "x"), machine.clock())
    source._port, source._early = Answers(), b"t08\r"
    buffer = FrameBuffer(machine.clock().now_ns, 1000)
    source._received = lambda port, timeout_s: b""  # type: ignore[method-assign]
    source.read(buffer, 0, 0.1)
    assert buffer.take().losses == []
    source._refusals = 9
    words = r"^bus 'a' \(slcan x\): lost: the adapter was reset$"
    with pytest.raises(SourceError, match=words):
        source.read(buffer, 0, 0.1)
    assert sorted(loss.where for loss in buffer.take().losses) == ["closed", "line"]
