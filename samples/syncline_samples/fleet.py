"""A simulated fleet: captures of many machines over many days, made from one run of one machine.

A machine is simulated once; the capture of each machine and day is that run at another time, with
what is planted in it: resets, EMCYs, answers that come later, SYNCs that jitter, heartbeats that
slow down, noise of an encoder, a counter of EEPROM writes. No frame is where the bus would not have
had room for it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from syncline_samples.machine import EPOCH_NS
from syncline_samples.scenarios import ENTRY, GUIDE, PRESS, healthy_line
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata, description_attachment
from syncline_schemas.capture.writer import CaptureWriter

SECOND_NS, DAY_NS = 10**9, 86_400 * 10**9
RESET_NODE, EMCY_NODE, HEARTBEAT_NODE = GUIDE, ENTRY, ENTRY
LATE_NODE, NOISY_NODE, WORN_NODE = PRESS, PRESS, PRESS
"""On which node of each machine what is planted shows."""
_START_S = 5.0
"""Before this the machine starts up; nothing is planted there."""
_DOWN_NS, _BOOTED_NS = 1_200_000_000, 900_000_000
_EMCY_NS = 2 * SECOND_NS
_BIT_NS = 2000
_SYNCHRONOUS = (0x080, *(0x280 + node for node in (*range(1, 5), 10, 20)), 0x18A, 0x38A)
_SERVICES = (0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700)


@dataclass(frozen=True, slots=True)
class Planted:
    """What is planted in a capture; nothing by default.

    Attributes:
        resets: of `RESET_NODE`, unasked, spread over the capture.
        emcys: of `EMCY_NODE`, each cleared after two seconds, or before the next one.
        late_us: how much later TPDO2 of `LATE_NODE` answers each SYNC [us].
        sync_jitter_us: standard deviation that is added to the SYNCs' times, and to their answers' [us].
        slower_heartbeat: share by which the heartbeat period of `HEARTBEAT_NODE` is longer.
        noise_counts: standard deviation that is added to the position of `NOISY_NODE`.
        eeprom_writes: what `WORN_NODE` answers when it is asked; None where nobody asks.
        share: of the run that was recorded.
    """

    resets: int = 0
    emcys: int = 0
    late_us: float = 0.0
    sync_jitter_us: float = 0.0
    slower_heartbeat: float = 0.0
    noise_counts: float = 0.0
    eeprom_writes: int | None = None
    share: float = 1.0


HEALTHY = Planted()
Plan = Callable[[int, int], Planted | None]
"""What is planted on a machine on a day, by their numbers; None where nothing was recorded."""


@dataclass(frozen=True)
class Template:
    """One run of one machine, as often as it is needed at another time.

    Attributes:
        seconds: of virtual time; a SYNC period of 20 ms gives about 460 frames a second.
    """

    seconds: float = 60.0
    sync_us: int = 20_000

    @cached_property
    def frames(self) -> FrameBatch:
        """The run, nothing planted in it."""
        batches = healthy_line(self.seconds, self.sync_us).run().batches
        return FrameBatch.concat([each for each in batches if isinstance(each, FrameBatch)])

    @cached_property
    def description_toml(self) -> str:
        """The bus description of the machine."""
        return healthy_line(self.seconds, self.sync_us).description_toml

    def capture(self, start_ns: int, planted: Planted = HEALTHY, seed: int = 0) -> FrameBatch:
        """The run at a time, with what is planted in it."""
        rng = np.random.default_rng(seed)
        frames = self.frames
        frames = frames[: max(1, round(len(frames) * planted.share))]
        frames = replace(frames, data=frames.data.copy(), t_ns=frames.t_ns.copy())
        frames = _move(frames, planted, rng)
        _blur(frames, planted, rng)
        for t_ns in _moments(frames, planted.resets):
            frames = _with_reset(frames, t_ns)
        more = _emcys(_moments(frames, planted.emcys))
        if planted.eeprom_writes is not None:
            more.append(_wear(int(frames.t_ns[len(frames) // 2]), planted.eeprom_writes))
        whole = FrameBatch.concat([frames, *more])
        whole = _on_the_wire(whole[np.argsort(whole.t_ns, kind="stable")])
        return replace(whole, t_ns=whole.t_ns + (start_ns - EPOCH_NS))


def fleet_captures(
    folder: Path,
    machines: int,
    days: int,
    plan: Plan = lambda _machine, _day: HEALTHY,
    template: Template | None = None,
) -> Iterator[Path]:
    """Write the captures of a fleet one after the other, `machine-007/20260302T060700Z_....mcap`.

    Args:
        folder: gets a folder for each machine.
        plan: what is planted on a machine on a day.
        template: the run that all are made from.
    """
    run = template or Template()
    for machine in range(machines):
        for day in range(days):
            planted = plan(machine, day)
            if planted is not None:
                yield write_capture(folder, run, machine, day, planted)


def machine_name(machine: int) -> str:
    """Name of a machine by its number: that of its folder and of its gateway.

    >>> machine_name(7)
    'machine-007'
    """
    return f"machine-{machine:03}"


def write_capture(
    folder: Path, template: Template, machine: int, day: int, planted: Planted = HEALTHY
) -> Path:
    """Write the capture of one machine and day, as its recorder would; the file."""
    start_ns = EPOCH_NS + day * DAY_NS + machine % 720 * 60 * SECOND_NS
    seed = machine * 10_000 + day
    frames = template.capture(start_ns, planted, seed)
    recording_id = f"{seed:08x}"
    begun = datetime.fromtimestamp(start_ns // SECOND_NS, UTC)
    path = folder / machine_name(machine) / f"{begun:%Y%m%dT%H%M%SZ}_{recording_id}.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata = CaptureMetadata(
        version="sample",
        recording_id=recording_id,
        host=machine_name(machine),
        created_ns=start_ns,
        clock="simulated",
        source="simulated fleet",
    )
    bus = BusInfo("can0", 0, 500_000, interface="simulated", clock="simulated")
    attachments = [description_attachment(template.description_toml)]
    with path.open("wb") as stream:
        writer = CaptureWriter(stream, metadata, [bus], attachments=attachments)
        writer.write_frames(frames)
        writer.finish()
    return path


def _move(frames: FrameBatch, planted: Planted, rng: np.random.Generator) -> FrameBatch:
    """What comes at another time is moved; what would come after the end is left out."""
    late = frames.can_id == 0x280 + LATE_NODE
    frames.t_ns[late] += round(planted.late_us * 1000)
    if planted.sync_jitter_us:
        sync = np.flatnonzero(frames.can_id == 0x080)
        jitter_us = rng.normal(0, planted.sync_jitter_us, len(sync) + 1)
        jitter_ns = np.rint(jitter_us * 1000).astype(np.int64)
        jitter_ns[0] = 0
        moved = np.isin(frames.can_id, _SYNCHRONOUS)
        after = np.searchsorted(sync, np.flatnonzero(moved), side="right")
        frames.t_ns[moved] += jitter_ns[after]
    if planted.slower_heartbeat:
        end_ns = frames.t_ns[-1]
        beats = np.flatnonzero(frames.can_id == 0x700 + HEARTBEAT_NODE)
        boots = np.where(frames.data[beats, 0] == 0, np.arange(len(beats)), 0)
        since_ns = frames.t_ns[beats] - frames.t_ns[beats[np.maximum.accumulate(boots)]]
        frames.t_ns[beats] += np.rint(since_ns * planted.slower_heartbeat).astype(np.int64)
        frames = frames[np.flatnonzero(frames.t_ns <= end_ns)]
    return frames


def _blur(frames: FrameBatch, planted: Planted, rng: np.random.Generator) -> None:
    """Add noise to the position of the noisy encoder, within what it can tell."""
    if not planted.noise_counts:
        return
    rows = np.flatnonzero(np.isin(frames.can_id, (0x180 + NOISY_NODE, 0x280 + NOISY_NODE)))
    position = frames.data[rows, :4].copy().view("<u4")[:, 0].astype(np.int64)
    noise = np.rint(rng.normal(0, planted.noise_counts, len(rows))).astype(np.int64)
    noisy = np.abs(position + noise).astype("<u4")
    frames.data[rows, :4] = noisy.view(np.uint8).reshape(-1, 4)


def _moments(frames: FrameBatch, count: int) -> NDArray[np.int64]:
    """So many moments, spread over a capture after its start."""
    begin_ns = int(frames.t_ns[0] + _START_S * SECOND_NS)
    end_ns = int(frames.t_ns[-1]) - 3 * SECOND_NS
    return np.linspace(begin_ns, max(begin_ns, end_ns), count + 2).astype(np.int64)[1:-1]


def _with_reset(frames: FrameBatch, t_ns: int) -> FrameBatch:
    """The node falls silent, boots up by itself, and the master starts it again."""
    own = np.isin(frames.can_id, [service + RESET_NODE for service in _SERVICES])
    own |= frames.can_id == 0x600 + RESET_NODE
    down = own & (frames.t_ns >= t_ns) & (frames.t_ns < t_ns + _DOWN_NS)
    boot_up = _frame(t_ns + _BOOTED_NS, 0x700 + RESET_NODE, b"\0")
    start = _frame(t_ns + _BOOTED_NS + 50_000_000, 0, bytes((1, RESET_NODE)))
    return FrameBatch.concat([frames[np.flatnonzero(~down)], boot_up, start])


def _emcys(moments: NDArray[np.int64]) -> list[FrameBatch]:
    """EMCYs, each over before the next one comes."""
    raised = bytes.fromhex("2073 01 0100000000")
    apart_ns = int(np.diff(moments).min()) if len(moments) > 1 else _EMCY_NS * 2
    for_ns = min(_EMCY_NS, apart_ns // 2)
    can_id = 0x080 + EMCY_NODE
    begun = [_frame(t_ns, can_id, raised) for t_ns in moments.tolist()]
    return begun + [_frame(t_ns + for_ns, can_id, bytes(8)) for t_ns in moments.tolist()]


def _wear(t_ns: int, writes: int) -> FrameBatch:
    """The master asks for the writes of the EEPROM, 1011h:04."""
    ask = bytes.fromhex("40 1110 04 00000000")
    answer = bytes.fromhex("43 1110 04") + writes.to_bytes(4, "little")
    return FrameBatch.concat(
        [
            _frame(t_ns, 0x600 + WORN_NODE, ask),
            _frame(t_ns + 1_500_000, 0x580 + WORN_NODE, answer),
        ]
    )


def _frame(t_ns: int, can_id: int, data: bytes) -> FrameBatch:
    return FrameBatch(
        np.array([t_ns], np.int64),
        np.zeros(1, np.uint8),
        np.array([can_id], np.uint32),
        np.zeros(1, np.uint16),
        np.array([len(data)], np.uint8),
        np.frombuffer(data.ljust(8, b"\0"), np.uint8).reshape(1, 8).copy(),
    )


def _on_the_wire(frames: FrameBatch) -> FrameBatch:
    """Frames in order, none ending sooner after the one before than it can be sent."""
    least_ns = np.cumsum((47 + 8 * frames.dlc.astype(np.int64)) * _BIT_NS)
    t_ns = np.maximum.accumulate(frames.t_ns - least_ns) + least_ns
    return replace(frames, t_ns=t_ns)
