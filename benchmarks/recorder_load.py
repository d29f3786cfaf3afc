"""Four full buses at 1 Mbit/s, decoded: our recorder in real time, against simple recorders.

`python -m benchmarks.recorder_load [--seconds N] [--repeats N]`. Every case runs in a process of its
own, in turn with the others. Ours gets its frames in real time, in batches as the SocketCAN source
gives them; its share of a core is its CPU time over the wall time, threads and idle turns included.
The peers get the same frames one by one from a python-can virtual bus whose queue is full already,
so that theirs is the CPU time per frame and nothing else. python-can's BLF logger decodes nothing.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.full_bus import (
    BUSES,
    DESCRIPTION,
    SECOND_NS,
    FullBus,
    full_second,
    load_percent,
)
from benchmarks.memory import peak_mb

REPOSITORY = Path(__file__).parent.parent
MAX_CORE_SHARE = 0.25
MAX_PEAK_MB = 150
MIN_TIMES_CHEAPER = 4


def measured(work: Callable[[], int]) -> dict[str, Any]:
    """CPU and wall seconds of the work, its frames, peak memory."""
    wall, cpu = time.perf_counter(), time.process_time()
    frames = work()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {"frames": frames, "wall_s": wall, "cpu_s": cpu, "peak_mb": peak_mb()}


def syncline(folder: Path, seconds: int) -> dict[str, Any]:
    """Our recorder, in real time; every frame given must be in the result and in the file."""
    from syncline_logger.record_options import RecordOptions
    from syncline_logger.recorder import record
    from syncline_schemas.description import BusDescription

    description = BusDescription.loads(DESCRIPTION)
    end_ns = seconds * SECOND_NS
    buses = [FullBus(number, end_ns=end_ns) for number in range(BUSES)]
    stop = threading.Event()
    status: list[Any] = []

    def work() -> int:
        result = record(
            buses,
            folder,
            RecordOptions(description=description),
            stop=stop,
            duration_ns=end_ns + SECOND_NS // 2,
            on_status=status.append,
        )
        assert result.frame_count == sum(bus.given for bus in buses), "frames were lost"
        assert result.gap_count == result.lost_frames == 0, result.gaps
        assert result.problems == [], result.problems
        return result.frame_count

    found = measured(work)
    (file,) = folder.glob("*.mcap")
    found["bytes"] = file.stat().st_size
    return found


def naive_mcap(folder: Path, seconds: int) -> dict[str, Any]:
    """recv -> protobuf -> mcap.Writer, one message at a time, PDOs and heartbeats decoded."""
    from mcap.writer import CompressionType, Writer

    from syncline_schemas.proto import syncline_pb2

    bus = preloaded(seconds)
    pdo_type = two_angles()

    def work() -> int:
        count = 0
        with (folder / "naive.mcap").open("wb") as stream:
            writer = Writer(stream, compression=CompressionType.ZSTD)
            writer.start()
            channels: dict[str, int] = {}

            def write(topic: str, payload: Any, t_ns: int) -> None:
                if topic not in channels:
                    schema = writer.register_schema(payload.DESCRIPTOR.full_name, "protobuf", b"")
                    channels[topic] = writer.register_channel(topic, "protobuf", schema)
                writer.add_message(channels[topic], t_ns, payload.SerializeToString(), t_ns)

            while (message := bus.recv(0)) is not None:
                count += 1
                can_id, data = message.arbitration_id, bytes(message.data)
                t_ns = round(message.timestamp * 1e9)
                frame = syncline_pb2.Frame(can_id=can_id, flags=0, dlc=message.dlc, data=data)
                write(f"/can/{message.channel}/frames", frame, t_ns)
                service, node = can_id & 0x780, can_id & 0x7F
                if service in (0x180, 0x280):
                    half = len(data) // 2
                    values = pdo_type(
                        first=int.from_bytes(data[:half], "little", signed=True) * 0.1,
                        second=int.from_bytes(data[half:], "little", signed=True) * 0.1,
                    )
                    write(f"/canopen/{message.channel}/node{node}/{service}", values, t_ns)
                elif service == 0x700:
                    beat = syncline_pb2.Heartbeat(state=data[0], state_name="operational")
                    write(f"/canopen/{message.channel}/node{node}/heartbeat", beat, t_ns)
                elif can_id == 0x80:
                    write(f"/canopen/{message.channel}/sync", syncline_pb2.Sync(), t_ns)
                elif service in (0x580, 0x600):
                    transfer = syncline_pb2.Sdo(command=data[0], data=data[4:])
                    write(f"/canopen/{message.channel}/node{node}/sdo", transfer, t_ns)
            writer.finish()
        return count

    return measured(work)


def python_can_blf(folder: Path, seconds: int) -> dict[str, Any]:
    """python-can's own logger, BLF writer, nothing decoded."""
    import can

    bus = preloaded(seconds)

    def work() -> int:
        count = 0
        with can.Logger(folder / "peer.blf") as logger:
            while (message := bus.recv(0)) is not None:
                count += 1
                logger.on_message_received(message)
        return count

    return measured(work)


def preloaded(seconds: int) -> Any:
    """A virtual bus that delivers `seconds` of all four buses without waiting."""
    import can

    bus = can.Bus(interface="virtual", channel="load")
    begin_s = time.time()
    for second in range(seconds):
        for message in messages_of_a_second(begin_s + second):
            bus.queue.put(message)  # type: ignore[attr-defined]
    return bus


def messages_of_a_second(begin_s: float) -> Iterator[Any]:
    """The frames of all buses in time order, as python-can gives them."""
    import can
    import numpy as np

    from syncline_schemas.batch import FrameBatch

    batch = FrameBatch.concat([full_second(number) for number in range(BUSES)])
    batch = batch[np.argsort(batch.t_ns, kind="stable")]
    for row in range(len(batch)):
        yield can.Message(
            timestamp=begin_s + int(batch.t_ns[row]) / 1e9,
            arbitration_id=int(batch.can_id[row]),
            is_extended_id=False,
            dlc=int(batch.dlc[row]),
            data=batch.data[row, : batch.dlc[row]].tobytes(),
            channel=f"can{batch.bus[row]}",
        )


def two_angles() -> Any:
    """A protobuf message class with two doubles, as somebody would write for an inclinometer."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="two_angles.proto", syntax="proto3")
    message = file.message_type.add(name="TwoAngles")
    for number, name in enumerate(("first", "second"), 1):
        message.field.add(name=name, number=number, type=1, label=1)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("TwoAngles"))


CASES: dict[str, Callable[[Path, int], dict[str, Any]]] = {
    "syncline": syncline,
    "naive_mcap": naive_mcap,
    "python_can_blf": python_can_blf,
}


def run_case(name: str, seconds: int) -> dict[str, Any]:
    """One measured run in a fresh process."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["--case", name, "--out", folder, "--seconds", str(seconds)]
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.recorder_load", *words],
            cwd=REPOSITORY,
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode != 0:
        sys.exit(f"{name}: {done.stderr.strip()}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    """Run all cases in turn, print the table, exit with 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=20, help="of traffic for our recorder")
    parser.add_argument("--peer-seconds", type=int, default=3, help="of traffic for the peers")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--case", choices=list(CASES))
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    if args.case:
        print(json.dumps(CASES[args.case](args.out, args.seconds)))
        return
    second = full_second(0)
    rate = BUSES * len(second)
    print(f"{BUSES} buses at {load_percent(second):.0f} % load, {rate:,} frames/s; medians")
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in CASES}
    for _ in range(args.repeats):
        for name in CASES:
            seconds = args.seconds if name == "syncline" else args.peer_seconds
            runs[name].append(run_case(name, seconds))
    sys.exit(report(runs, rate))


def report(runs: dict[str, list[dict[str, Any]]], rate: int) -> int:
    """Print the table; 1 when a target is missed."""
    print(f"  {'':16}{'CPU us/frame':>14}{'share of a core':>17}{'peak MB':>9}{'bytes/frame':>13}")
    cost = {}
    for name, found in runs.items():
        cost[name] = statistics.median(run["cpu_s"] / run["frames"] * 1e6 for run in found)
        peak = max(run["peak_mb"] or 0 for run in found)
        size = found[0].get("bytes", 0) / found[0]["frames"]
        print(
            f"  {name:16}{cost[name]:>14.2f}{cost[name] * rate / 1e6:>16.1%}{peak:>9.0f}{size:>13.1f}"
        )
    ours = runs["syncline"]
    share = statistics.median(run["cpu_s"] / run["wall_s"] for run in ours)
    peak = max(run["peak_mb"] or 0 for run in ours)
    cheaper = cost["naive_mcap"] / cost["syncline"]
    print(f"ours: {share:.1%} of a core, {peak:.0f} MB, {cheaper:.1f} times cheaper than naive")
    good = share < MAX_CORE_SHARE and peak < MAX_PEAK_MB and cheaper >= MIN_TIMES_CHEAPER
    return 0 if good else 1


if __name__ == "__main__":
    main()
