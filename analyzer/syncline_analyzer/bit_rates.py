"""The bit rate of every bus, settled before the analyses see its first frame."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.context import BitrateSource, Context
from syncline_analyzer.echo import COPY
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.timing.bit_rate import Estimate, estimate, stamps_starts
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.wire_length import data_phase_bits, wire_bits
from syncline_schemas.wording import counted

HOLD_FRAMES = 1 << 18
"""Frames that are held back at most until the bit rates of their buses are settled."""
HOLD_ITEMS = 1000
"""Batches and gaps that are held back at most."""
SPACINGS = 1 << 17
"""Spacings per bus that an estimate is made of at most."""
_FIRST_TRY = 1 << 12
"""Spacings from which on an estimate is tried before the end of what is held back."""
_NO_SPACING = -1
_WHOSE = {"bus-description": "the bus description", "recorded": "the capture"}


@dataclass(slots=True)
class _Spacings:
    """Spacings of the frames of one bus; -1 where two frames do not count."""

    apart_ns: list[NDArray[np.int64]] = field(default_factory=list)
    bits: list[NDArray[np.int64]] = field(default_factory=list)
    count: int = 0
    last_ns: int | None = None
    """Stamp of the last frame; None where the next one has none to be measured from."""
    tried: int = 0
    _told: tuple[int, Estimate | None] | None = None
    """Resolution and result of the last estimate."""

    def add(self, frames: FrameBatch) -> None:
        """Take in the frames of the bus that were really sent."""
        if not len(frames) or self.count >= SPACINGS:
            return
        # A frame of the recording computer itself may be stamped when it was asked for.
        strange = (frames.flags & (FrameFlag.ERROR | FrameFlag.TX)) != 0
        bits = wire_bits(frames)
        alone = strange | (data_phase_bits(frames) > 0)
        alone[1:] |= strange[:-1]
        alone[0] |= self.last_ns is None
        before = frames.t_ns[0] if self.last_ns is None else self.last_ns
        apart = np.diff(frames.t_ns, prepend=before)
        self.apart_ns.append(np.where(alone | (apart < 0), _NO_SPACING, apart))
        self.bits.append(bits)
        self.count += len(frames)
        self.last_ns = None if strange[-1] else int(frames.t_ns[-1])

    def estimate(self, resolution_ns: int) -> Estimate | None:
        """What they say of the bit rate."""
        if not self.count:
            return None
        if self._told is None or (self.tried, self._told[0]) != (self.count, resolution_ns):
            apart_ns, bits = np.concatenate(self.apart_ns), np.concatenate(self.bits)
            self._told = resolution_ns, estimate(apart_ns, bits, resolution_ns)
        self.tried = self.count
        return self._told[1]

    def of_starts(self, bitrate: int, resolution_ns: int) -> bool:
        """Whether the stamps are those of the start of the frames."""
        apart_ns, bits = np.concatenate(self.apart_ns), np.concatenate(self.bits)
        return stamps_starts(apart_ns, bits, bitrate, resolution_ns)


class BitRates:
    """Fills the bit rates of a context: as they are told, else as the frames are spaced.

    The bus description is believed first, then the capture, then the command line. Where nobody
    tells it, a bit rate that the spacings leave no doubt about is used; a guess only stands in
    `Context.estimates`.

    Args:
        bitrate, data_bitrate: [bit/s] of every bus of which neither description nor capture tells.
    """

    def __init__(
        self,
        context: Context,
        facts: Sequence[CaptureFacts],
        bitrate: int | None,
        data_bitrate: int | None,
    ) -> None:
        self._context = context
        self._facts = facts
        self._bitrate = bitrate
        self._data_bitrate = data_bitrate
        self._spacings: dict[int, _Spacings] = {}

    def settled(self, stream: Iterable[IndexedBatch | Gap]) -> Iterator[IndexedBatch | Gap]:
        """The stream, held back at its start until the bit rate of every bus in it is settled.

        When the stream has been read, `Context.estimates` is complete.
        """
        held: list[IndexedBatch | Gap] = []
        frames = 0
        open_ = True
        for item in stream:
            self.refresh()
            self._add(item)
            if not open_:
                yield item
                continue
            held.append(item)
            frames += 0 if isinstance(item, Gap) else len(item)
            if self._all_settled() or frames >= HOLD_FRAMES or len(held) >= HOLD_ITEMS:
                open_ = False
                self._settle()
                yield from held
                held = []
        self.refresh()
        if open_:
            self._settle()
        yield from held
        self._compare()

    def notes(self) -> list[str]:
        """What is to be said of bit rates that nobody told."""
        notes = [self._overruled(name) for name in self._context.buses]
        notes += [self._starts(self._context.bus_name(bus), each) for bus, each in self._measured()]
        notes += [
            self._note(name, found) for name, found in sorted(self._context.estimates.items())
        ]
        return [note for note in notes if note]

    def _measured(self) -> list[tuple[int, _Spacings]]:
        """Buses with spacings, and with a bit rate that they do not contradict."""
        names = ((bus, self._context.bus_name(bus)) for bus in sorted(self._spacings))
        return [
            (bus, self._spacings[bus])
            for bus, name in names
            if self._spacings[bus].count
            and name in self._context.bitrates
            and not self._context.contradicted(name)
        ]

    def _starts(self, name: str, spacings: _Spacings) -> str:
        """What is to be said of stamps that are taken at the start of frames."""
        if not spacings.of_starts(self._context.bitrates[name], self._context.resolution_ns):
            return ""
        return (
            f"the stamps of bus {name} seem to be those of the start of its frames: each comes as"
            " long after the one before as that one lasted; response, device and waiting times are"
            " made for stamps at the end, and may be off by the length of a frame"
        )

    def _overruled(self, name: str) -> str:
        """What is to be said where the bit rate on the command line is another one than counts."""
        used, source = self._context.bitrates.get(name), self._context.bitrate_sources.get(name)
        if self._bitrate in (None, used) or used is None or source not in _WHOSE:
            return ""
        return (
            f"the bit rate of bus {name} is taken as {used / 1000:g} kbit/s from {_WHOSE[source]},"
            f" which goes before the {self._bitrate / 1000:g} kbit/s of the command line"
        )

    def _note(self, name: str, found: Estimate) -> str:
        rate = f"{found.bitrate / 1000:g} kbit/s"
        if self._context.bitrate_sources.get(name) == "estimated":
            return (
                f"nobody tells the bit rate of bus {name}; it is estimated as {rate}:"
                f" {counted(found.frames, 'spacing')} of its frames, short and long ones, are what"
                " that rate allows at least, and no other bit rate fits"
            )
        if name in self._context.bitrates:
            return ""
        why = "its frames came too late" if found.confident else "that is a guess"
        return (
            f"nobody tells the bit rate of bus {name}; its frames hint at {rate}, but {why},"
            " so nothing is measured with it: state it with --bitrate"
        )

    def refresh(self) -> None:
        """Take over what reading has told meanwhile: step of the stamps, bit rates of new buses."""
        resolutions = [each.resolution_ns for each in self._facts]
        self._context.resolution_ns = max(resolutions, default=1)
        context, told = self._context, self._context.description
        for name in context.buses:
            recorded = [each.bitrates[name] for each in self._facts if name in each.bitrates]
            self._tell(name, told.bitrate(name), "bus-description")
            self._tell(name, recorded[0] if recorded else None, "recorded")
            self._tell(name, self._bitrate, "command-line")
            data = [each.data_bitrates[name] for each in self._facts if name in each.data_bitrates]
            data_bitrate = told.data_bitrate(name) or (data[0] if data else self._data_bitrate)
            if data_bitrate:
                context.data_bitrates.setdefault(name, data_bitrate)

    def _tell(self, name: str, bitrate: int | None, source: BitrateSource) -> None:
        if bitrate and name not in self._context.bitrates:
            self._context.bitrates[name] = bitrate
            self._context.bitrate_sources[name] = source

    def _add(self, item: IndexedBatch | Gap) -> None:
        if not self._context.timed:
            return
        if isinstance(item, Gap):
            for bus, spacings in self._spacings.items():
                if item.bus in (None, bus):
                    spacings.last_ns = None
            return
        for bus in item.buses:
            spacings = self._spacings.setdefault(bus, _Spacings())
            if spacings.count < SPACINGS:
                frames = item.of_bus(bus).frames
                copied = (frames.flags & COPY) != 0
                spacings.add(frames[~copied] if copied.any() else frames)

    def _unknown(self) -> list[tuple[str, _Spacings]]:
        named = [(self._context.bus_name(bus), each) for bus, each in self._spacings.items()]
        return [(name, each) for name, each in named if name not in self._context.bitrates]

    def _all_settled(self) -> bool:
        """Whether nothing is left to wait for; estimates are tried as the frames double."""
        for name, spacings in self._unknown():
            if spacings.count >= max(_FIRST_TRY, 2 * spacings.tried):
                self._estimate(name, spacings)
        return all(spacings.count >= SPACINGS for _, spacings in self._unknown())

    def _settle(self) -> None:
        for name, spacings in self._unknown():
            if spacings.tried != spacings.count:
                self._estimate(name, spacings)

    def _estimate(self, name: str, spacings: _Spacings) -> None:
        found = spacings.estimate(self._context.resolution_ns)
        if found is not None:
            self._context.estimates[name] = found
            if found.confident:
                self._tell(name, found.bitrate, "estimated")

    def _compare(self) -> None:
        """What the spacings say where the bit rate is told, or where they came too late."""
        for bus, spacings in self._spacings.items():
            name = self._context.bus_name(bus)
            if name not in self._context.estimates:
                found = spacings.estimate(self._context.resolution_ns)
                if found is not None:
                    self._context.estimates[name] = found
