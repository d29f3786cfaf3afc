"""The bit rate of every bus, settled before the analyses see its first frame."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.context import BitrateSource, Context
from syncline_analyzer.folds.timing.bit_rate import Estimate, estimate, stamps_starts
from syncline_analyzer.preparing import Step
from syncline_analyzer.spacings import SPACINGS, SPAN_FRAMES, Spacings
from syncline_schemas.records import dataclass
from syncline_schemas.wording import counted

HOLD_FRAMES = 1 << 18
"""Frames that are held back at most until the bit rates of their buses are settled."""
HOLD_GAPS = 500
"""Gaps with which no more is held back."""
_FIRST_TRY = 1 << 12
"""Spacings from which on an estimate is tried before the end of what is held back."""
_ALL = 1 << 62
"""More spans than any stream has."""
_WHOSE = {"bus-description": "the bus description", "recorded": "the capture"}


Ints = NDArray[np.int64]


@dataclass(slots=True)
class _Seen:
    """What was measured of one bus."""

    measured: list[Spacings] = field(default_factory=list)
    tried: int = 0
    """Number of spacings of the last estimate, ..."""
    _told: tuple[int, Estimate | None] | None = None
    """... resolution and result."""

    def count(self, spans: int = _ALL) -> int:
        """Number of the spacings in the first spans."""
        return sum(len(each.bits) for each in self.measured if each.span < spans)

    def estimate(self, resolution_ns: int, spans: int = _ALL) -> Estimate | None:
        """What those in the first spans say of the bit rate."""
        count = self.count(spans)
        if not count:
            return None
        if self._told is None or (self.tried, self._told[0]) != (count, resolution_ns):
            self._told = resolution_ns, estimate(*self._columns(spans), resolution_ns)
        self.tried = count
        return self._told[1]

    def of_starts(self, bitrate: int, resolution_ns: int) -> bool:
        """Whether the stamps are those of the start of the frames."""
        return stamps_starts(*self._columns(), bitrate, resolution_ns)

    def _columns(self, spans: int = _ALL) -> tuple[Ints, Ints]:
        chosen = [each for each in self.measured if each.span < spans]
        apart_ns = np.concatenate([each.apart_ns for each in chosen])
        return apart_ns, np.concatenate([each.bits for each in chosen])


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
        self._seen: dict[int, _Seen] = {}
        self._spans = 0
        """Complete ones that were looked at."""
        self._gaps = 0

    def settled(self, steps: Iterable[Step]) -> Iterator[Step]:
        """The steps, held back at first until the bit rate of every bus in them is settled.

        Before the last one `Context.estimates` is complete.
        """
        held: list[Step] = []
        open_ = True
        for step in steps:
            self.refresh()
            for spacings in step.spacings:
                self._seen.setdefault(spacings.bus, _Seen()).measured.append(spacings)
            if open_:
                held.append(step)
                if not step.last and not self._ready(step):
                    continue
                open_ = False
                every = step.last or self._gaps >= HOLD_GAPS
                self._settle(_ALL if every else self._spans)
                yield from held[:-1]
                held = []
            if step.last:
                self._compare()
            yield step

    def _ready(self, step: Step) -> bool:
        """Whether nothing need be held back any longer, by the spans that are complete."""
        while (self._spans + 1) * SPAN_FRAMES <= step.frames:
            self._spans += 1
            if self._all_settled(self._spans) or self._spans * SPAN_FRAMES >= HOLD_FRAMES:
                return True
        self._gaps += step.gap is not None
        return self._gaps >= HOLD_GAPS

    def notes(self) -> list[str]:
        """What is to be said of bit rates that nobody told."""
        notes = [self._overruled(name) for name in self._context.buses]
        notes += [self._starts(self._context.bus_name(bus), each) for bus, each in self._measured()]
        notes += [
            self._note(name, found) for name, found in sorted(self._context.estimates.items())
        ]
        return [note for note in notes if note]

    def _measured(self) -> list[tuple[int, _Seen]]:
        """Buses with spacings, and with a bit rate that they do not contradict."""
        names = ((bus, self._context.bus_name(bus)) for bus in sorted(self._seen))
        return [
            (bus, self._seen[bus])
            for bus, name in names
            if self._seen[bus].count()
            and name in self._context.bitrates
            and not self._context.contradicted(name)
        ]

    def _starts(self, name: str, spacings: _Seen) -> str:
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

    def _unknown(self, spans: int) -> list[tuple[str, _Seen]]:
        """Buses in the first spans whose bit rate is not known."""
        named = [
            (self._context.bus_name(bus), seen)
            for bus, seen in self._seen.items()
            if seen.measured[0].span < spans
        ]
        return [(name, seen) for name, seen in named if name not in self._context.bitrates]

    def _all_settled(self, spans: int) -> bool:
        """Whether nothing is left to wait for; estimates are tried as the frames double."""
        for name, seen in self._unknown(spans):
            if seen.count(spans) >= max(_FIRST_TRY, 2 * seen.tried):
                self._estimate(name, seen, spans)
        return all(seen.count(spans) >= SPACINGS for _, seen in self._unknown(spans))

    def _settle(self, spans: int) -> None:
        for name, seen in self._unknown(spans):
            if seen.tried != seen.count(spans):
                self._estimate(name, seen, spans)

    def _estimate(self, name: str, seen: _Seen, spans: int) -> None:
        found = seen.estimate(self._context.resolution_ns, spans)
        if found is not None:
            self._context.estimates[name] = found
            if found.confident:
                self._tell(name, found.bitrate, "estimated")

    def _compare(self) -> None:
        """What the spacings say where the bit rate is told, or where they came too late."""
        for bus, spacings in self._seen.items():
            name = self._context.bus_name(bus)
            if name not in self._context.estimates:
                found = spacings.estimate(self._context.resolution_ns)
                if found is not None:
                    self._context.estimates[name] = found
