"""The bit rate of a bus from its tightest frame spacings.

Two frames that follow one another without a pause are stamped as far apart as the second one is
long: its bits with intermission over the bit rate. On any bus with traffic some frames wait for
others, so these spacings pile up at the wire's limit, for short and long frames alike, and nothing
lies below it. A recorder that stamps the start of frames spaces them by the length of the frame
before: where that fits as well, there is no confidence. A bit rate that is too low makes spacings impossible; one that is too high has
nothing at its limit, unless a node answers after a constant time: that pile does not grow with the
length of the frame as the wire would have it.
"""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distribution import quantile_of
from syncline_schemas import native
from syncline_schemas.records import dataclass

CANDIDATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""Bit rates of CiA 301 table 1, and the 100 kbit/s that many devices offer besides [bit/s]."""
_RUNS = (1, 2, 4, 8, 16, 32)
"""Frames that are looked at together where the stamps are too coarse for single ones."""
_JITTER_NS = (1_000, 3_000, 10_000, 30_000, 100_000)
"""How far stamps may be off besides their step: hardware, driver, interrupts of a busy host [ns]."""
_SHARP = 0.1
"""The stamps may be off by so much of the spacing, or neighbouring bit rates cannot be told."""
_ENOUGH = 20
"""So many spacings at the limit make a pile."""
_APART = 8
"""So many of them must not share frames."""
_FEW = 8
"""So many make a guess."""
_IMPOSSIBLE = 0.05
"""Share of spacings below the limit, against those at it, that stamps may be wrong."""
_DOUBTFUL = 0.3
"""The same for a guess."""
_STEPS_NS = (10_000_000, 1_000_000, 100_000, 10_000)
"""Steps of stamps that matter here [ns]."""
_ON_STEP = 0.9
"""With this share of the spacings on them, these are the steps of the stamps."""
_TRUSTED = 0.99
"""Share of the spacings whose proven error counts."""
_STEEP = 0.8
"""As many lie at the limit as beside it, or it is the slope of something broader."""
_TURNED = 2.5
"""So far apart, in widths of the pile, a faster bit rate would tear short and long frames."""
_LEANING = 0.5
"""The same for a guess, and for a slope that is to count."""
_CORE = 0.05
"""Shortest and longest frames of the pile that are left out when its span is taken."""
_STARTS = 50
"""So many spacings as long as the frame before show that the starts of frames are stamped."""
_RATHER = 3
"""And so many times as many as are as long as the frame itself."""
_ALONE = 0.05
"""With so few beside it, the slope of the pile itself tells the bit rate."""
_ON_SLOPE = 0.2
"""How far that slope may be off, as a share of the way to the next faster bit rate."""

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A bit rate that the spacings speak for.

    Attributes:
        bitrate: [bit/s], one of `CANDIDATES`.
        confident: whether every other candidate is ruled out; else it is a guess.
        frames: spacings at the limit that it rests on.
        within_ns: how far around the limit they lie.
    """

    bitrate: int
    confident: bool
    frames: int
    within_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class _Runs:
    """Spacings of a number of frames each: time [ns] and bits from the first end to the last."""

    frames: int
    apart_ns: Ints
    bits: Ints

    def part(self, rows: NDArray[np.bool_]) -> "_Runs":
        """Some of them, or itself where that is all."""
        return self if rows.all() else _Runs(self.frames, self.apart_ns[rows], self.bits[rows])


@dataclass(frozen=True, slots=True, eq=False)
class _Close:
    """Those that are not too far apart to matter; number and median length [bit] of all."""

    runs: _Runs
    count: int
    usual: float


@dataclass(frozen=True, slots=True)
class _Pile:
    """What lies at the limit of one candidate.

    Attributes:
        below, beside: spacings shorter than those of the pile, and those up to twice its width
            longer.
        span_bits: how much longer the long frames of the pile are than its short ones.
        slope: (ns per bit, its standard error) of spacing over length, where nothing beside the
            pile is cut off.
        frames: how many make one spacing.
    """

    bitrate: int
    within_ns: int
    count: int
    below: int
    beside: int
    span_bits: float
    slope: tuple[float, float] | None
    frames: int

    @property
    def is_guess(self) -> bool:
        return (
            self.count >= _FEW
            and self.span_bits * self._more_ns >= _LEANING * self.within_ns
            and self.below <= _DOUBTFUL * self.count
            and self.count >= _STEEP * self.beside
        )

    @property
    def is_limit(self) -> bool:
        """Whether it is the wire's limit beyond doubt."""
        return (
            self.count >= max(_ENOUGH, _APART * self.frames)
            and self.below <= _IMPOSSIBLE * self.count
            and self.count >= _STEEP * self.beside
            and self._excludes_faster()
        )

    def _excludes_faster(self) -> bool:
        """Whether no faster bit rate and a constant delay would give the same pile."""
        if self.span_bits * self._more_ns >= _TURNED * self.within_ns:
            return True
        if self.slope is None or self.span_bits * self._more_ns < _LEANING * self.within_ns:
            return False
        slope, error = self.slope
        return abs(slope - 1e9 / self.bitrate) + 3 * error < _ON_SLOPE * self._more_ns

    @property
    def _more_ns(self) -> float:
        """How much longer a bit lasts than at the next faster bit rate.

        There is none above 1 Mbit/s, but stamps that a host takes at regular times are equally far
        apart whatever the frames are.
        """
        faster = [rate for rate in CANDIDATES if rate > self.bitrate]
        return 1e9 / self.bitrate - (1e9 / faster[0] if faster else 0.0)


def estimate(apart_ns: Ints, bits: Ints, resolution_ns: int) -> Estimate | None:
    """The bit rate of a bus, None where its spacings do not tell one.

    Args:
        apart_ns: (n,) from the stamp of the frame before to that of the frame; negative where the
            two do not count: over gaps, error frames, and before frames of switched bit rate.
        bits: (n,) length of each frame with intermission.
        resolution_ns: step of the stamps.
    """
    guess: _Pile | None = None
    single = _single(apart_ns, bits)
    resolution_ns = max(resolution_ns, _step_ns(single.apart_ns))
    off_ns = _off_ns(single)
    within_ns = resolution_ns + _JITTER_NS[-1]
    impossible = _impossible(single, within_ns, CANDIDATES)
    for close in _close(apart_ns, bits, within_ns, impossible):
        piles = [
            pile
            for pile in _piles(close, resolution_ns, off_ns, impossible)
            if impossible[pile.bitrate] <= _IMPOSSIBLE * pile.count
        ]
        limits = {
            pile.bitrate: pile
            for pile in reversed(piles)
            if pile.is_limit and _holds_singly(pile, single)
        }
        if len(limits) == 1:
            pile = next(iter(limits.values()))
            before = np.concatenate((bits[:1], bits[:-1]))
            shifted = _runs(apart_ns, before, pile.frames)
            confident = _most_alike(shifted, pile.within_ns) < pile.count
            return Estimate(pile.bitrate, confident, pile.count, pile.within_ns)
        guess = max(
            (pile for pile in (guess, *piles) if pile is not None and pile.is_guess),
            key=lambda pile: pile.count / pile.frames,
            default=None,
        )
    if guess is None:
        return None
    return Estimate(guess.bitrate, False, guess.count, guess.within_ns)


def _single(apart_ns: Ints, bits: Ints) -> _Runs:
    """The spacings that count; no copy where only the first one does not."""
    begin = int(len(apart_ns) > 0 and apart_ns[0] < 0)
    apart_ns, bits = apart_ns[begin:], bits[begin:]
    return _Runs(1, apart_ns, bits).part(apart_ns >= 0)


def _step_ns(apart_ns: Ints) -> int:
    """Step of the stamps by themselves: a converter or a host may know of finer ones only [ns]."""
    for step_ns in _STEPS_NS:
        # Where too many of the first ones are beside the step, the others need no look.
        first = apart_ns[: len(apart_ns) // 4]
        if np.count_nonzero(~_on_step(first, step_ns)) > (1 - _ON_STEP) * len(apart_ns) + 1:
            continue
        if len(apart_ns) and _on_step(apart_ns, step_ns).mean() >= _ON_STEP:
            return step_ns
    return 1


def _on_step(apart_ns: Ints, step_ns: int) -> NDArray[np.bool_]:
    """Which spacings are multiples of a step, a fiftieth of it more or less."""
    return (apart_ns + step_ns // 50) % step_ns <= step_ns // 25


def stamps_starts(apart_ns: Ints, bits: Ints, bitrate: int, resolution_ns: int) -> bool:
    """Whether the stamps of a bus are beyond doubt those of the start of its frames.

    Then the spacings are as long as the frame before, and some are too short for the frame itself.
    """
    within_ns = resolution_ns + _JITTER_NS[0]
    before = np.concatenate((bits[:1], bits[:-1]))
    counting = apart_ns >= 0
    if within_ns > _SHARP * 1e9 / bitrate * float(np.median(bits)):
        return False
    beyond, beyond_before = (
        (apart_ns - length * (1e9 / bitrate))[counting] for length in (bits, before)
    )
    own = int(np.count_nonzero(np.abs(beyond) <= within_ns))
    starts = int(np.count_nonzero(np.abs(beyond_before) <= within_ns))
    too_soon = int(np.count_nonzero(beyond < -within_ns))
    too_soon_before = int(np.count_nonzero(beyond_before < -within_ns))
    return (
        starts >= max(_STARTS, _RATHER * own)
        and too_soon > _IMPOSSIBLE * starts
        and too_soon_before <= _IMPOSSIBLE * too_soon
    )


def _most_alike(runs: _Runs, within_ns: int) -> int:
    """How many spacings lie at the limit of whatever bit rate has the most there.

    Few may lie below it; `within_ns` is how far the stamps may be off.
    """
    if not len(runs.bits):
        return 0
    bit_ns = np.sort(runs.apart_ns / runs.bits)
    below = np.arange(len(bit_ns))
    stop = np.searchsorted(bit_ns, bit_ns + 2 * within_ns / float(np.median(runs.bits)), "right")
    count = stop - below
    return int(count[below <= _IMPOSSIBLE * count].max(initial=0))


def _off_ns(single: _Runs) -> float:
    """How far stamps are off beyond doubt: frames come closer than any bit rate allows [ns]."""
    if not len(single.bits):
        return 0.0
    short = single.bits * (1e9 / CANDIDATES[-1]) - single.apart_ns
    return max(0.0, quantile_of(np.asarray(short, np.float64), _TRUSTED))


def _holds_singly(pile: _Pile, single: _Runs) -> bool:
    """Whether single frames do not come sooner than a pile of several in a row allows.

    Two stamps are as far off as two others, however many frames lie between them.
    """
    (too_soon,) = _impossible(single, pile.within_ns, (pile.bitrate,)).values()
    return too_soon <= _IMPOSSIBLE * pile.count


def _impossible(single: _Runs, off_ns: int, bitrates: Iterable[int]) -> dict[int, int]:
    """How many frames come sooner than each bit rate allows, stamps that are off so far granted."""
    bit_ns = (single.apart_ns + off_ns) / single.bits
    return {bitrate: int(np.count_nonzero(bit_ns < 1e9 / bitrate)) for bitrate in bitrates}


def _close(
    apart_ns: Ints, bits: Ints, within_ns: int, impossible: Mapping[int, int]
) -> Iterator[_Close]:
    """Spacings of several frames in a row that lie at the limit of any candidate, or beside it.

    The slowest one that is not ruled out tells: what is too far apart for it is so for every
    faster one.
    """
    left = [rate for rate in CANDIDATES if impossible[rate] <= _IMPOSSIBLE * len(bits)]
    for frames in _RUNS if left else ():
        if frames > len(bits):
            return
        bit_ns = 1e9 / left[0]
        sharp_ns = min(within_ns, _SHARP * frames * int(bits.max()) * bit_ns)
        runs, lengths = _close_runs(apart_ns, bits, frames, bit_ns, 3 * sharp_ns)
        if len(runs.bits) >= _FEW:
            yield _Close(runs, int(lengths.sum()), _median(lengths))


def _close_runs(
    apart_ns: Ints, bits: Ints, frames: int, bit_ns: float, within_ns: float
) -> tuple[_Runs, Ints]:
    """Those at most so much longer than their bits; how many of all have 0, 1, 2... bits."""
    if native.available():
        close_ns, close_bits, lengths = native.close_runs(apart_ns, bits, frames, bit_ns, within_ns)
        return _Runs(frames, close_ns, close_bits), lengths
    runs = _runs(apart_ns, bits, frames)
    return runs.part(runs.apart_ns - runs.bits * bit_ns <= within_ns), np.bincount(runs.bits)


def _runs(apart_ns: Ints, bits: Ints, frames: int) -> _Runs:
    """Spacings of so many frames in a row."""
    ends = (
        np.concatenate(([0], np.cumsum(each)))
        for each in (np.maximum(apart_ns, 0), bits, apart_ns < 0)
    )
    apart_ns, bits, breaks = (each[frames:] - each[:-frames] for each in ends)
    return _Runs(frames, apart_ns, bits).part(breaks == 0)


def _piles(
    found: _Close, resolution_ns: int, off_ns: float, impossible: Mapping[int, int]
) -> Iterator[_Pile]:
    """What lies at the limit of each candidate, by how far the stamps may be off.

    Candidates that more spacings contradict than could lie at their limit are left out.
    """
    close = found.runs
    for bitrate in CANDIDATES:
        bit_ns = 1e9 / bitrate
        withins = [resolution_ns + jitter_ns for jitter_ns in _JITTER_NS]
        withins = [each for each in withins if off_ns <= each <= _SHARP * found.usual * bit_ns]
        if not withins or impossible[bitrate] > _IMPOSSIBLE * found.count:
            continue
        beyond = close.apart_ns - close.bits * bit_ns
        near = beyond <= 3 * withins[-1]
        # What is too far apart for one bit rate is so for every faster one.
        close = close.part(near)
        beyond = beyond[near]
        for within_ns in withins:
            at = np.abs(beyond) <= within_ns
            if np.count_nonzero(at) >= _FEW:
                yield _pile(close, bitrate, within_ns, beyond, at)


def _median(counts: Ints) -> float:
    """The median of at least one number, by how many are 0, 1, 2..."""
    below = np.cumsum(counts)
    middle = (below[-1] - 1) // 2, below[-1] // 2
    return float(np.searchsorted(below, middle, "right").sum()) / 2


def _pile(
    runs: _Runs, bitrate: int, within_ns: int, beyond: NDArray[np.float64], at: NDArray[np.bool_]
) -> _Pile:
    """What lies at the limit, of all spacings that are not longer than those beside it."""
    count = int(np.count_nonzero(at))
    below = int(np.count_nonzero(beyond < -within_ns))
    beside = int(np.count_nonzero((beyond > within_ns) & (beyond <= 3 * within_ns)))
    bits = runs.bits[at]
    low, high = quantile_of(bits, _CORE), quantile_of(bits, 1 - _CORE)
    alone = below + beside <= _ALONE * count
    slope = _slope(bits, runs.apart_ns[at]) if alone else None
    return _Pile(bitrate, within_ns, count, below, beside, high - low, slope, runs.frames)


def _slope(bits: Ints, apart_ns: Ints) -> tuple[float, float] | None:
    """Slope of spacing over length [ns/bit] with its standard error, None for equal lengths."""
    x = bits - bits.mean()
    square = float((x * x).sum())
    if not square:
        return None
    slope = float((x * apart_ns).sum()) / square
    rest = apart_ns - apart_ns.mean() - slope * x
    return slope, float(np.sqrt((rest * rest).sum() / max(1, len(x) - 2) / square))
