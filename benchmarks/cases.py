"""One measured case per call, each in a process of its own: `python -m benchmarks.cases NAME FILE OUT`.

Prints one JSON line: frames, wall and CPU seconds of the work itself (imports left out), peak memory;
both of the processes that it starts as well.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.memory import PeakMemory

Case = Callable[[Path, Path], Callable[[], int]]
"""Takes the input and a place for the output, prepares, and returns the work; that returns frames."""


def record_syncline(source: Path, out: Path, *, decode: bool = True) -> Callable[[], int]:
    """python-can virtual bus -> our MCAP, with decoded channels."""
    import threading

    from benchmarks.virtual_bus import preloaded_bus
    from syncline_logger.bus_options import BusOptions
    from syncline_logger.record_options import RecordOptions
    from syncline_logger.recorder import record
    from syncline_logger.sources.python_can import PythonCanSource

    bus, frames = preloaded_bus(source)
    stop = threading.Event()

    class Counted(PythonCanSource):
        """Ends the recording when the bus has delivered everything."""

        left = frames

        def read(self, buffer: Any, bus: int, timeout_s: float) -> int:
            count = super().read(buffer, bus, timeout_s)
            self.left -= count
            if self.left <= 0:
                stop.set()
            return count

    options = BusOptions(name="can0", interface="virtual", channel="benchmark")
    counted = Counted.of_bus(bus, options)

    def work() -> int:
        result = record(
            [counted], out.with_suffix(".mcap"), RecordOptions(decode=decode), stop=stop
        )
        assert result.frame_count == frames
        return frames

    return work


def record_syncline_raw(source: Path, out: Path) -> Callable[[], int]:
    """The same without decoded channels."""
    return record_syncline(source, out, decode=False)


def record_python_can(source: Path, out: Path) -> Callable[[], int]:
    """python-can virtual bus -> python-can's BLF logger."""
    import can

    from benchmarks.virtual_bus import preloaded_bus

    bus, frames = preloaded_bus(source)

    def work() -> int:
        with can.BLFWriter(out.with_suffix(".blf")) as writer:
            for _ in range(frames):
                message = bus.recv(0)
                assert message is not None
                writer.on_message_received(message)
        return frames

    return work


def record_naive_mcap(source: Path, out: Path) -> Callable[[], int]:
    """python-can virtual bus -> one protobuf message each -> mcap.Writer."""
    from mcap.writer import Writer

    from benchmarks.virtual_bus import preloaded_bus
    from syncline_schemas.proto import syncline_pb2

    bus, frames = preloaded_bus(source)

    def work() -> int:
        with out.with_suffix(".naive.mcap").open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            schema = writer.register_schema("syncline.Frame", "protobuf", b"")
            channel = writer.register_channel("/can/can0/frames", "protobuf", schema)
            for _ in range(frames):
                message = bus.recv(0)
                assert message is not None
                frame = syncline_pb2.Frame(
                    can_id=message.arbitration_id,
                    flags=0,
                    dlc=message.dlc,
                    data=bytes(message.data),
                )
                t_ns = round(message.timestamp * 1e9)
                writer.add_message(channel, t_ns, frame.SerializeToString(), t_ns)
            writer.finish()
        return frames

    return work


def convert_syncline(source: Path, out: Path) -> Callable[[], int]:
    """candump log -> our MCAP."""
    from syncline_analyzer.convert import convert

    return lambda: convert([source], out.with_suffix(".mcap")).frames


def convert_to_candump(source: Path, out: Path) -> Callable[[], int]:
    """Our MCAP -> candump text."""
    from syncline_analyzer.convert import convert

    return lambda: convert([source], out.with_suffix(".log")).frames


def convert_to_candump_mcap(source: Path, out: Path) -> Callable[[], int]:
    """The same by the official MCAP reader and protobuf, line by line."""
    from mcap.reader import make_reader

    from syncline_schemas.proto import syncline_pb2

    def work() -> int:
        count = 0
        lines = out.with_suffix(".txt").open("w", encoding="ascii")
        with source.open("rb") as stream, lines:
            reader = make_reader(stream)
            for _, _, message in reader.iter_messages(topics=["/can/can0/frames"]):
                frame = syncline_pb2.Frame.FromString(message.data)
                seconds, rest = divmod(message.publish_time, 10**9)
                line = f"({seconds}.{rest // 1000:06}) can0 {frame.can_id:03X}#{frame.data.hex().upper()}"
                lines.write(line + "\n")
                count += 1
        return count

    return work


def convert_python_can(source: Path, out: Path) -> Callable[[], int]:
    """candump log -> BLF with python-can's reader and writer."""
    import can

    def work() -> int:
        count = 0
        with can.LogReader(source) as reader, can.BLFWriter(out.with_suffix(".blf")) as writer:
            for message in reader:
                writer.on_message_received(message)
                count += 1
        return count

    return work


def analyze_syncline(source: Path, out: Path) -> Callable[[], int]:
    """Every fold, table and finding, from whatever `source` is."""
    import_module("syncline_analyzer.engine")
    import_module("syncline_analyzer.reading")
    from syncline_analyzer import open_session

    return lambda: open_session(source).analysis.capture.frames


def analyze_canopen_lens(source: Path, out: Path) -> Callable[[], int]:
    """canopen-lens 0.5.1: open and analyze (C++ core), its incidents and overview."""
    import canopen_lens

    def work() -> int:
        log: Any = canopen_lens.open_log(source)
        log.incidents()
        return len(log)

    return work


def read_syncline(source: Path, out: Path) -> Callable[[], int]:
    """Our reader alone: every frame as columns, no analysis."""
    from syncline_analyzer.readers import open_capture
    from syncline_schemas.batch import FrameBatch

    items = open_capture(source).batches()

    def work() -> int:
        return sum(len(item) for item in items if isinstance(item, FrameBatch))

    return work


def read_syncline_one_thread(source: Path, out: Path) -> Callable[[], int]:
    """The same without threads that read ahead."""
    from syncline_schemas.capture import read_ahead

    read_ahead.default_workers = lambda: 1
    return read_syncline(source, out)


def unpack_mcap(source: Path, out: Path) -> Callable[[], int]:
    """The limit of reading: each chunk read and unpacked by one thread, nothing else."""
    from syncline_schemas.capture.chunk import decompress
    from syncline_schemas.capture.record_file import Lost, RecordFile

    def work() -> int:
        with source.open("rb") as stream:
            file = RecordFile(stream)
            summary = file.summary()
            assert summary is not None
            assert summary.statistics is not None
            for place in summary.chunks:
                raw = file.chunk_at(place)
                assert not isinstance(raw, Lost)
                decompress(raw.data, raw.compression, raw.uncompressed_size)
            return summary.statistics.message_count

    return work


def read_python_can(source: Path, out: Path) -> Callable[[], int]:
    """python-can's reader alone, no analysis."""
    import can

    def work() -> int:
        with can.LogReader(source) as reader:
            return sum(1 for _ in reader)

    return work


def read_mcap(source: Path, out: Path) -> Callable[[], int]:
    """The official MCAP reader alone, no protobuf, no analysis."""
    from mcap.reader import make_reader

    def work() -> int:
        with source.open("rb") as stream:
            reader = make_reader(stream)
            return sum(1 for _ in reader.iter_messages(topics=["/can/can0/frames"]))

    return work


def stretch_syncline(source: Path, out: Path) -> Callable[[], int]:
    """Ten seconds out of the middle of our capture: `Session.frames`."""
    from syncline_analyzer import open_session

    begin, end = _middle(source)

    def work() -> int:
        return sum(len(batch) for batch in open_session(source).frames(begin, end))

    return work


def stretch_mcap(source: Path, out: Path) -> Callable[[], int]:
    """The same by the official MCAP reader and its index."""
    from mcap.reader import make_reader

    begin, end = _middle(source)

    def work() -> int:
        with source.open("rb") as stream:
            reader = make_reader(stream)
            topics = ["/can/can0/frames"]
            return sum(1 for _ in reader.iter_messages(topics, begin, end))

    return work


def _middle(source: Path) -> tuple[int, int]:
    """Ten seconds in the middle of a capture, as `t_ns`."""
    from syncline_schemas.capture.record_file import RecordFile

    with source.open("rb") as stream:
        summary = RecordFile(stream).summary()
    assert summary is not None
    begin = summary.chunks[len(summary.chunks) // 2].start_ns
    return begin, begin + 10 * 10**9


def write_rrd(source: Path, out: Path) -> Callable[[], int]:
    """Forty traces of 250,000 samples each as a Rerun recording; frames are samples here."""
    from dataclasses import replace

    import numpy as np

    from syncline_analyzer import open_session
    from syncline_analyzer.results import Trace
    from syncline_analyzer.views.rerun_view import write_rrd as write

    analysis = open_session(source).analysis
    rng, count = np.random.default_rng(6), 250_000

    def trace(number: int) -> Trace:
        steps = rng.integers(900_000, 1_100_000, count)
        value = 180 + 90 * np.sin(np.arange(count) / 5_000 + number) + rng.normal(0, 0.05, count)
        return Trace(
            bus="can0",
            node=1 + number % 4,
            object=0x600400 + number,
            name=f"trace {number}",
            unit="deg",
            t_ns=analysis.capture.first_ns + np.cumsum(steps),
            seq=np.arange(count),
            raw=np.arange(count),
            value=value,
            flags=np.zeros(count, np.uint16),
            segment=np.zeros(count, np.int32),
        )

    traces = [trace(number) for number in range(40)]

    def work() -> int:
        write(replace(analysis, trace_data=traces), out.with_suffix(".rrd"))
        return 40 * count

    return work


def process_help(source: Path, out: Path) -> Callable[[], int]:
    """`syncline --help`, the whole process."""
    return _process(1, "syncline", "--help")


def process_analyze(source: Path, out: Path) -> Callable[[], int]:
    """`syncline analyze`, the whole process: every fold, table and finding, the summary printed."""
    return _process(_count(source), "syncline", "analyze", source)


def process_analyze_one_processor(source: Path, out: Path) -> Callable[[], int]:
    """The same on one processor, as far as the system lets a process choose."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    return process_analyze(source, out)


def process_canopen_lens(source: Path, out: Path) -> Callable[[], int]:
    """canopen-lens 0.5.1, the whole process, by its Python interface: its command line is slower."""
    import importlib.util

    assert importlib.util.find_spec("canopen_lens"), "canopen-lens is not installed"
    code = (
        "import sys, canopen_lens; "
        "log = canopen_lens.open_log(sys.argv[1]); log.incidents(); print(len(log))"
    )
    return _process(_count(source), sys.executable, "-c", code, source)


def process_tshark(source: Path, out: Path) -> Callable[[], int]:
    """`tshark -T fields` with seven fields of CANopen, the whole process."""
    fields = (
        "frame.time_epoch", "can.id", "canopen.function_code", "canopen.node_id",
        "canopen.nmt_guard.state", "canopen.sdo.main_idx", "canopen.em.err_code",
    )  # fmt: skip
    named = [part for name in fields for part in ("-e", name)]
    heuristic = ("-d", "can.subdissector,canopen", "-Y", "canopen")
    return _process(
        _count(source), "tshark", "-n", "-r", source, *heuristic, "-T", "fields", *named
    )


def _process(frames: int, program: str, *arguments: str | Path) -> Callable[[], int]:
    """Run a program, of this Python's environment if it is there; its output is thrown away."""
    beside = Path(sys.executable).parent / program
    command = [str(beside if beside.exists() else program), *map(str, arguments)]

    def work() -> int:
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
        return frames

    return work


def _count(source: Path) -> int:
    """Frames of a capture or log: what its summary says, or its lines.

    Without numpy: its threads, when they start, take a processor for 50 ms of what is measured.
    """
    from mcap.reader import make_reader

    if source.suffix != ".mcap":
        return source.read_bytes().count(b"\n")
    with source.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    return summary.statistics.message_count


def slcan_syncline(source: Path, out: Path) -> Callable[[], int]:
    """Serial adapter on a pseudo terminal -> our queue of frames."""
    from benchmarks.serial_adapter import SerialAdapter
    from syncline_logger.batcher import FrameBuffer
    from syncline_logger.bus_options import BusOptions
    from syncline_logger.clock import RecorderClock
    from syncline_logger.sources.slcan import SlcanSource

    adapter = SerialAdapter(source)
    serial = SlcanSource(BusOptions("a", "slcan", adapter.port))
    buffer = FrameBuffer(RecorderClock().now_ns)

    def work() -> int:
        serial.open()
        count = 0
        while count < adapter.frames:
            count += serial.read(buffer, 0, 0.1)
            buffer.take()
        return count

    return work


def slcan_python_can(source: Path, out: Path) -> Callable[[], int]:
    """The same adapter -> python-can's slcan, its messages thrown away; 10,000 frames will do."""
    import can

    from benchmarks.serial_adapter import SerialAdapter

    adapter = SerialAdapter(source, 10_000)

    def work() -> int:
        bus = can.Bus(interface="slcan", channel=adapter.port, listen_only=True, sleep_after_open=0)
        count = 0
        while count < adapter.frames:
            count += bus.recv(0.1) is not None
        bus.shutdown()
        return count

    return work


def wire_lengths_syncline(source: Path, out: Path) -> Callable[[], int]:
    """Exact length of every frame on the wire, columnar."""
    from syncline_analyzer.readers import open_capture
    from syncline_schemas.batch import FrameBatch
    from syncline_schemas.wire_length import wire_bits

    batches = [item for item in open_capture(source).batches() if isinstance(item, FrameBatch)]
    return lambda: sum(len(wire_bits(batch)) for batch in batches)


def wire_lengths_bit_by_bit(source: Path, out: Path) -> Callable[[], int]:
    """The same for python-can's messages as one writes it down: bits, CRC and stuff bits in turn."""
    import can

    def length(message: can.Message) -> int:
        can_id, remote = message.arbitration_id, f"{message.is_remote_frame:b}"
        if message.is_extended_id:
            head = f"0{can_id >> 18:011b}11{can_id & 0x3FFFF:018b}{remote}00{message.dlc:04b}"
        else:
            head = f"0{can_id:011b}{remote}00{message.dlc:04b}"
        bits = [int(bit) for bit in head + "".join(f"{byte:08b}" for byte in message.data)]
        crc = 0
        for bit in bits:
            crc = (crc << 1) ^ (0x4599 if bit ^ crc >> 14 else 0)
            crc &= 0x7FFF
        run, last, sent = 0, -1, 0
        for bit in bits + [int(bit) for bit in f"{crc:015b}"]:
            run = run + 1 if bit == last else 1
            last, sent = bit, sent + 1
            if run == 5:
                run, last, sent = 1, 1 - bit, sent + 1
        return sent + 13

    with can.LogReader(source) as reader:
        messages = list(reader)

    def work() -> int:
        assert all(length(message) for message in messages)
        return len(messages)

    return work


def main() -> None:
    """Run the case named on the command line."""
    name, source, out = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    case: Case = globals()[name]
    work = case(source, out)
    with PeakMemory().sampled() as memory:
        wall, cpu = time.perf_counter(), cpu_s()
        frames = work()
        wall, cpu = time.perf_counter() - wall, cpu_s() - cpu
    # This process only waits for a whole one; of any other work it is a part.
    peak = memory.started_mb if name.startswith("process_") else memory.whole_mb
    print(json.dumps({"frames": frames, "wall_s": wall, "cpu_s": cpu, "peak_mb": peak}))


def cpu_s() -> float:
    """CPU time of this process and of those that it has run."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


if __name__ == "__main__":
    main()
