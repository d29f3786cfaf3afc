"""Write the sample captures with their expected results: `python -m syncline_samples.generate`.

Without an argument they go into `samples`, from the root of a checkout.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from syncline_samples.buses import Buses
from syncline_samples.machine import Run, Scenario
from syncline_samples.scenarios import bad_day, healthy_line, jittery_sync
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.capture.gap_message import gap_message
from syncline_schemas.capture.layout import (
    GAP_TOPIC,
    BusInfo,
    CaptureMetadata,
    description_attachment,
)
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.proto import syncline_pb2

FORMAT_VERSION = "syncline.expected/1"
_MCAP, _CANDUMP = "mcap", "log"


def samples() -> dict[str, tuple[Scenario, str]]:
    """The scenarios of the samples, slow enough to be small, with the format of each."""
    return {
        "healthy_line": (_in_us(healthy_line(sync_us=100_000)), _MCAP),
        "bad_day": (_in_us(bad_day(sync_us=250_000)), _MCAP),
        "jittery_sync": (jittery_sync(), _CANDUMP),
    }


def _in_us(scenario: Scenario) -> Scenario:
    """The scenario with stamps in microseconds, as most adapters give them."""
    return replace(scenario, stamp_resolution_ns=1000)


def generate(folder: Path) -> list[Path]:
    """Write captures, bus descriptions and expected results; the paths written."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, (scenario, ending) in samples().items():
        run = scenario.run()
        capture = folder / f"{name}.{ending}"
        capture.write_bytes(mcap_capture(run) if ending == _MCAP else candump_log(run))
        described = folder / f"{name}.toml"
        described.write_text(run.description_toml, encoding="utf-8", newline="\n")
        expected = folder / f"{name}.expected.json"
        text = json.dumps(expected_results(run), indent=1) + "\n"
        expected.write_text(text, encoding="utf-8", newline="\n")
        written += [capture, described, expected]
    return written


def mcap_capture(run: Run | Buses) -> bytes:
    """The frames and gaps of a run as a capture, with its bus description in it."""
    from io import BytesIO

    scenarios = run.scenarios if isinstance(run, Buses) else (run.scenario,)
    first = scenarios[0]
    stream = BytesIO()
    metadata = CaptureMetadata(
        version="sample",
        recording_id=first.name,
        created_ns=first.epoch_ns,
        clock="simulated",
        resolution_ns=first.stamp_resolution_ns,
        source=f"simulated bus, scenario {first.name}",
    )
    buses = [
        BusInfo(each.bus_name, number, each.bitrate, interface="simulated", clock="simulated")
        for number, each in enumerate(scenarios)
    ]
    attachments = [description_attachment(run.description_toml)]
    writer = CaptureWriter(stream, metadata, buses, attachments=attachments)
    channel = writer.add_channel(GAP_TOPIC, schema_of(syncline_pb2.Gap.DESCRIPTOR))
    gaps: list[MessageBlock] = []
    for item in _whole_stretches(run.batches):
        if isinstance(item, Gap):
            gaps.append(
                MessageBlock.of_messages(channel, [item.end_ns], [item.end_ns], [gap_message(item)])
            )
        else:
            writer.write_chunk(item, messages=gaps)
            gaps = []
    writer.finish()
    return stream.getvalue()


def _whole_stretches(items: Iterable[FrameBatch | Gap]) -> Iterator[FrameBatch | Gap]:
    """All frames between two gaps as one batch: large chunks are small files."""
    frames: list[FrameBatch] = []
    for item in items:
        if isinstance(item, FrameBatch):
            frames.append(item)
        else:
            yield FrameBatch.concat(frames)
            yield item
            frames = []
    yield FrameBatch.concat(frames)


def candump_log(run: Run | Buses) -> bytes:
    """The frames of a run as `candump -L` writes them; stamps in microseconds, gaps not told."""
    lines = []
    for item in run.batches:
        if isinstance(item, FrameBatch):
            lines += [_line(item, row, run.bus_names[item.bus[row]]) for row in range(len(item))]
    return "".join(lines).encode("ascii")


def _line(batch: FrameBatch, row: int, bus_name: str) -> str:
    seconds, ns = divmod(int(batch.t_ns[row]), 1_000_000_000)
    flags, can_id = int(batch.flags[row]), int(batch.can_id[row])
    name = f"{can_id | 0x2000_0000:08X}" if flags & FrameFlag.ERROR else f"{can_id:03X}"
    tail = f"R{batch.dlc[row]}" if flags & FrameFlag.REMOTE else batch.payload(row).hex().upper()
    return f"({seconds}.{ns // 1000:06d}) {bus_name} {name}#{tail}\n"


def expected_results(run: Run) -> dict[str, Any]:
    """What an analyzer must find in the capture of a run, from the script's truth alone.

    Times are UTC ns. A 7Fh that is a node's first frame counts as a heartbeat: nothing tells that it
    is a boot-up. `heartbeats` include those that carry no state. `findings` with `required` false may be reported or not; no other finding may.
    """
    truth, scenario = run.truth, run.scenario
    return {
        "schema": FORMAT_VERSION,
        "scenario": scenario.name,
        "bitrate": scenario.bitrate,
        "capture": {
            "frames": truth.frames,
            "remote_frames": truth.remote_frames,
            "error_frames": truth.error_frames,
            "lost_frames": truth.lost_frames,
            "gaps": _gaps(run.batches),
        },
        "bus_load_percent": round(100 * truth.bus_load, 4),
        "sync": {"count": truth.counts["syncs", 0], "period_us": _sync_periods(truth.sync_ns)},
        "nodes": [_node(run, node) for node in _node_ids(run)],
        "nmt_commands": [
            {"t_ns": command.t_ns, "specifier": command.specifier, "node": command.node}
            for command in truth.commands
        ],
        "nmt_states": [_as_dict(state) for state in truth.states],
        "boot_ups": [_as_dict(boot_up) for boot_up in truth.boot_ups],
        "emcy": [_as_dict(emcy) for emcy in truth.emcy],
        "sdo": dict(sorted(Counter(f"{row.kind} {row.result}" for row in truth.sdo).items())),
        "missed": [_as_dict(missed) for missed in truth.missed],
        "findings": [_as_dict(finding) for finding in truth.findings],
    }


def _as_dict(row: Any) -> dict[str, Any]:
    return dict(row._asdict())


def _gaps(items: Iterable[FrameBatch | Gap]) -> list[dict[str, int | str | None]]:
    return [
        {
            "start_ns": item.start_ns,
            "end_ns": item.end_ns,
            "reason": item.reason,
            "lost_frames": item.lost_frames,
        }
        for item in items
        if isinstance(item, Gap)
    ]


def _sync_periods(sync_ns: list[int]) -> dict[str, float]:
    """Periods on the bus, those across a recorder gap included."""
    period_us = np.diff(np.array(sync_ns, np.int64)) / 1000
    return {
        "min": float(period_us.min()),
        "median": float(np.median(period_us)),
        "max": float(period_us.max()),
    }


def _node_ids(run: Run) -> list[int]:
    return sorted({spec.node_id for spec in run.scenario.devices} | {127})


def _node(run: Run, node: int) -> dict[str, Any]:
    truth = run.truth
    transfers = Counter(row.result for row in truth.sdo if row.node == node)
    states = [state for state in truth.states if state.node == node]
    boot_ups = [row for row in truth.boot_ups if row.node == node]
    unseen = boot_ups[0].byte == 0x7F and not boot_ups[0].commanded
    return {
        "node": node,
        "boot_ups": len(boot_ups) - unseen,
        "heartbeats": truth.counts["heartbeats", node] + unseen,
        "empty_heartbeats": truth.counts["empty_heartbeats", node],
        "guard_requests": truth.counts["guard_requests", node],
        "guard_answers": truth.counts["guard_answers", node],
        "emcy": sum(row.node == node for row in truth.emcy),
        "sdo_transfers": sum(transfers.values()),
        "sdo_aborts": transfers["abort"],
        "sdo_unanswered": transfers["no answer"],
        "pdo_frames": truth.counts["pdos", node],
        "final_state": states[-1].state if states else "OPERATIONAL",
    }


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else "samples")
    for path in generate(target):
        sys.stdout.write(f"{path}\n")
