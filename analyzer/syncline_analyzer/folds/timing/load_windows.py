"""Bits and frames of a bus in windows of equal length."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.series import Columns, Thinner
from syncline_schemas.records import dataclass

MAX_POINTS = 20_000
"""Windows that are kept for a plot."""

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Whole:
    """Windows that are complete: start (n,) int64 [ns], frames and bits (n,)."""

    start_ns: Ints
    frames: Floats
    bits: Floats

    def __len__(self) -> int:
        return len(self.start_ns)


@dataclass(slots=True)
class Windows:
    """Windows from the start of a stretch on; only whole ones count for the peak.

    A frame counts in the window of its stamp, its bits in the windows in which they were on the
    wire.

    Attributes:
        width_ns: length of a window.
        most: a fuller window is no load, but what the recorder stamped late after it had kept it
            (share of the time).
        peak: (bits, start [ns]) of the fullest whole window.
    """

    width_ns: int
    most: float = np.inf
    peak: tuple[float, int] | None = None
    over_time: Thinner = field(default_factory=lambda: Thinner("bits", MAX_POINTS))
    _origin_ns: int | None = None
    _number: int = 0
    _frames: float = 0.0
    _bits: float = 0.0

    def begin(self, origin_ns: int) -> None:
        """Start a stretch, unless one goes on."""
        if self._origin_ns is None:
            self._origin_ns = origin_ns

    def add(self, t_ns: Ints, bits: Ints | Floats, wire_ns: Floats | None, bit_ns: float) -> Whole:
        """Take in frames whose stamps run forward from the origin on; windows that are whole now.

        `wire_ns` is how long they took. Where the bit rate is not known it is None, `bit_ns` is 0,
        and a frame takes no time.
        """
        assert self._origin_ns is not None
        begins, number = self._begins(t_ns)
        if wire_ns is not None:
            split, its_number, early = self._early(t_ns, wire_ns, begins, number)
            before = np.minimum(early / bit_ns, bits[split])
        else:
            split, its_number, before = begins[:0], number[:0], bits[:0]
        # What lies before the stretch is not listened to.
        earlier = before * (its_number > 0)
        numbers = np.concatenate(
            ([self._number], number, its_number, np.maximum(its_number - 1, 0))
        )
        counts = np.diff(np.append(begins, len(t_ns)))
        frames = np.concatenate(([self._frames], counts, np.zeros(2 * len(split))))
        all_bits = np.concatenate(([self._bits], np.add.reduceat(bits, begins), -before, earlier))
        each, place = np.unique(numbers, return_inverse=True)
        frame_sums: Floats = np.bincount(place, frames).astype(np.float64)
        bit_sums: Floats = np.bincount(place, all_bits).astype(np.float64)
        self._number = int(each[-1])
        self._frames, self._bits = float(frame_sums[-1]), float(bit_sums[-1])
        whole = Whole(self._origin_ns + each[:-1] * self.width_ns, frame_sums[:-1], bit_sums[:-1])
        self._keep(whole, self.most * self.width_ns / bit_ns if bit_ns else np.inf)
        return whole

    def _begins(self, t_ns: Ints) -> tuple[Ints, Ints]:
        """(rows, number) of the first frame in each window that has any."""
        assert self._origin_ns is not None
        first, last = ((int(t_ns[at]) - self._origin_ns) // self.width_ns for at in (0, -1))
        if last - first > len(t_ns) // 4:
            each = (t_ns - self._origin_ns) // self.width_ns
            begins = np.flatnonzero(np.diff(each, prepend=-1))
            return begins, each[begins]
        number = np.arange(first, last + 1)
        edges = np.searchsorted(t_ns, self._origin_ns + number[1:] * self.width_ns)
        begins = np.concatenate(([0], edges))
        held = np.concatenate((edges, [len(t_ns)])) > begins
        return begins[held], number[held]

    def _early(
        self, t_ns: Ints, wire_ns: Floats, begins: Ints, number: Ints
    ) -> tuple[Ints, Ints, Floats]:
        """Frames that were on the wire before their window began: (rows, its number, how long [ns])."""
        assert self._origin_ns is not None
        start_ns = self._origin_ns + number * self.width_ns
        longest_ns = int(np.ceil(wire_ns.max()))
        # No frame behind the first that is further from the start than the longest takes.
        stop = np.searchsorted(t_ns, start_ns + longest_ns, "right")
        count = np.minimum(stop, np.append(begins[1:], len(t_ns))) - begins
        count = np.maximum(count, 0)
        window = np.repeat(np.arange(len(begins)), count)
        rows = np.arange(len(window)) - np.repeat(np.cumsum(count) - count - begins, count)
        early = wire_ns[rows] - (t_ns[rows] - start_ns[window])
        kept = np.flatnonzero(early > 0)
        return rows[kept], number[window[kept]], early[kept]

    def close(self) -> None:
        """End a stretch; its last window is not whole and only drawn when it is the only one."""
        if self._origin_ns is not None and self._frames and self.over_time.empty:
            start_ns = np.array([self._origin_ns + self._number * self.width_ns])
            self._draw(Whole(start_ns, np.array([self._frames]), np.array([self._bits])))
        self._origin_ns = None
        self._number, self._frames, self._bits = 0, 0.0, 0.0

    def _keep(self, whole: Whole, most_bits: float) -> None:
        if not len(whole):
            return
        fullest = int(np.argmax(np.where(whole.bits <= most_bits, whole.bits, -1.0)))
        possible = whole.bits[fullest] <= most_bits
        if possible and (self.peak is None or whole.bits[fullest] > self.peak[0]):
            self.peak = float(whole.bits[fullest]), int(whole.start_ns[fullest])
        self._draw(_with_silence(whole, self.width_ns))

    def _draw(self, windows: Whole) -> None:
        columns: Columns = {
            "t_ns": windows.start_ns,
            "frames": windows.frames,
            "bits": windows.bits,
        }
        self.over_time.add(columns)


def _with_silence(whole: Whole, width_ns: int) -> Whole:
    """The windows, and where nothing was sent for long the first and last empty one."""
    silent = np.flatnonzero(np.diff(whole.start_ns) > width_ns)
    if not len(silent):
        return whole
    edges = np.concatenate(
        [whole.start_ns[silent] + width_ns, whole.start_ns[silent + 1] - width_ns]
    )
    start_ns = np.concatenate([whole.start_ns, edges])
    order = np.argsort(start_ns, kind="stable")
    none = np.zeros(len(edges))
    return Whole(
        start_ns[order],
        np.concatenate([whole.frames, none])[order],
        np.concatenate([whole.bits, none])[order],
    )
