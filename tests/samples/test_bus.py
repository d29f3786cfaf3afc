from syncline_samples.bus import Bus, Frame
from syncline_samples.wire import wire_bits
from tests.samples.bench import Bench


def test_lowest_identifier_wins_when_the_bus_becomes_free() -> None:
    bench = Bench()
    for can_id in (0x300, 0x701, 0x080, 0x181):
        bench.bus.send(Frame(can_id), bench)
    assert bench.wait(5) == ["080#", "181#", "300#", "701#"]


def test_a_running_frame_is_not_interrupted() -> None:
    bench = Bench()
    bench.bus.send(Frame(0x700, bytes(8)), bench)
    bench.simulation.at(10_000, bench.bus.send, Frame(0x001), bench)
    assert bench.wait(5) == ["700#0000000000000000", "001#"]


def test_a_data_frame_wins_over_a_remote_frame_of_the_same_identifier() -> None:
    bench = Bench()
    bench.bus.send(Frame(0x181, b"", 4), bench)
    bench.bus.send(Frame(0x181, bytes(4)), bench)
    assert bench.wait(5) == ["181#00000000", "181#R4"]


def test_frames_back_to_back_are_one_wire_length_apart() -> None:
    bench = Bench(bitrate=125_000)
    first, second = Frame(0x181, b"\x12\x34"), Frame(0x281, b"\xff" * 8)
    bench.bus.send(first, bench)
    bench.bus.send(second, bench)
    bench.wait(10)
    (end1, _), (end2, _) = bench.log.rows
    assert end1 == (wire_bits(*first) - 3) * 8000
    assert end2 - end1 == wire_bits(*second) * 8000


def test_a_withdrawn_sender_is_silent() -> None:
    bench = Bench()
    other = object()
    bench.bus.send(Frame(0x300), bench)
    bench.bus.send(Frame(0x301), other)
    bench.bus.withdraw(other)
    assert bench.wait(5) == ["300#"]


def test_a_broken_transmitter_makes_error_frames_and_ends_bus_off() -> None:
    bench = Bench()
    done: list[int] = []

    def off() -> None:
        done.append(1)
        bench.bus.withdraw(bench)

    bench.bus.break_transmitter(bench, 32, off)
    bench.bus.send(Frame(0x181), bench)
    frames = bench.wait(20)
    assert done == [1]
    assert len(frames) == 32
    assert all(frame.startswith("error#") for frame in frames)


def test_busy_time_is_the_sum_of_the_frames() -> None:
    bench = Bench()
    frames = [Frame(0x100 + n, bytes([n])) for n in range(20)]
    for frame in frames:
        bench.bus.send(frame, bench)
    bench.wait(20)
    assert bench.bus.busy_bits == sum(wire_bits(*frame) for frame in frames)
    assert isinstance(bench.bus, Bus)
