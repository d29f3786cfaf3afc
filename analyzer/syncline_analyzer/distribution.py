"""Statistics of a quantity in bounded memory: exact while few, a histogram with a stated error then."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from syncline_schemas import native

# The process that reads has distributions too, and no need of the rows.
if TYPE_CHECKING:
    from syncline_analyzer.results import Jitter, Quantiles

EXACT_LIMIT = 8192
"""Values kept one by one; quantiles of no more than these are exact."""
RELATIVE_ERROR = 1 / 256
"""Largest error of a quantile beyond that: half a coarse bin, 128 of which make an octave."""
FINE_BINS = 4096
"""Bins of equal width over the range of most of the first values, so the error there is far less."""
PLOT_BINS = 64
TAIL_BINS = 8
"""Bins that make an octave in the tails of a plot."""
_MANTISSA_BITS = 7
_SHIFT = 52 - _MANTISSA_BITS
_FIRST_KEY = 1023 << _MANTISSA_BITS
_COARSE_BINS = 50 << _MANTISSA_BITS

Floats = NDArray[np.float64]
Values = Floats | NDArray[np.int64]
_NO_VALUES = np.zeros(0)
_NONE_FAR = np.zeros(1, np.int64)
"""Coarse bins of values that are all in the fine ones."""
_NO_LIMITS = float("inf"), float("-inf")
_CANCELLED = 1e-6
"""Squares that make up a smaller share of those around another value are summed up anew."""


class Distribution:
    """Values [ns, not negative] of which count, mean, deviation and extremes are always exact.

    Args:
        moments: whether mean and deviation will be asked for.
    """

    def __init__(self, *, moments: bool = True) -> None:
        self.count = 0
        self._moments = moments
        self.minimum = float("inf")
        self.maximum = float("-inf")
        self._fresh = _NO_LIMITS
        """Least and largest of the values that wait."""
        self._counted = 0
        self._mean = 0.0
        self._squares = 0.0
        """Sum of the squares of the distances from the mean."""
        self._waiting: list[Values] = []
        """All values while there are few of them, then those that are not in the bins yet."""
        self._held = 0
        self._bins: _Bins | None = None
        self._known: dict[float, float] = {}
        """Quantiles that were asked for since the last values."""

    def add(self, values: Values, limits: tuple[float, float] | None = None) -> None:
        """Take in values; negative ones must have been left out.

        `limits` are the least and the largest of them, where they are known.
        """
        if not len(values):
            return
        if limits is None:
            limits = np.minimum.reduce(values), np.maximum.reduce(values)
        low, high = float(limits[0]), float(limits[1])
        self.minimum, self.maximum = min(self.minimum, low), max(self.maximum, high)
        self._fresh = min(self._fresh[0], low), max(self._fresh[1], high)
        self.count += len(values)
        if self._known:
            self._known.clear()
        self._held += len(values)
        if self._held > EXACT_LIMIT:
            self._waiting.append(values)
            self._settle()
        else:
            # A copy: what waits must not hold on to the columns of the whole block.
            self._waiting.append(values.astype(np.float64))

    def quantile(self, share: float) -> float:
        """Value below which a share (0..1) of all values lies; NaN without values."""
        if not self.count:
            return float("nan")
        if share not in self._known:
            self._known[share] = self._quantile(share)
        return self._known[share]

    def _quantile(self, share: float) -> float:
        bins = self._settled()
        if bins is None:
            return quantile_of(self._exact(), share)
        value = bins.value(share * (self.count - 1))
        return min(max(value, self.minimum), self.maximum)

    @property
    def mean(self) -> float:
        """Mean of all values; NaN without values."""
        if not self.count:
            return float("nan")
        return float(self._exact().mean()) if self._settled() is None else self._mean

    @property
    def std(self) -> float:
        """Standard deviation of all values."""
        if not self.count:
            return float("nan")
        if self._settled() is None:
            return float(self._exact().std())
        return float(np.sqrt(self._squares / self.count))

    @property
    def relative_error(self) -> float:
        """Largest relative error of a quantile: none while all values are kept."""
        return 0.0 if self._bins is None else RELATIVE_ERROR

    def quantiles(self, unit_ns: float, *, std: bool = False) -> "Quantiles | None":
        """Row of the tables in units of `unit_ns` [ns]; None without values."""
        from syncline_analyzer.results import Quantiles

        if not self.count:
            return None
        return Quantiles(
            self.minimum / unit_ns,
            self.quantile(0.5) / unit_ns,
            self.quantile(0.99) / unit_ns,
            self.maximum / unit_ns,
            self.std / unit_ns if std else None,
        )

    def jitter(
        self, unit_ns: float, resolution_ns: int, below_ns: float = float("inf")
    ) -> "Jitter | None":
        """Row of the tables, without what is smaller than a step of the stamps; None without values.

        Only values less than `below_ns` count; where some do not, what is left may be off by the
        `relative_error`.
        """
        from syncline_analyzer.results import Jitter

        if not self.count or self.minimum >= below_ns:
            return None
        std, width = self.std, self.quantile(0.99) - self.quantile(0.01)
        highest = self.maximum
        if highest >= below_ns:
            std, width, highest = self._spread_below(below_ns)
        return Jitter(
            _told(std, resolution_ns, unit_ns),
            _told(width, resolution_ns, unit_ns),
            _told(highest - self.minimum, resolution_ns, unit_ns),
        )

    def _spread_below(self, below_ns: float) -> tuple[float, float, float]:
        """(deviation, 99th less 1st percentile, maximum) of the values less than `below_ns`."""
        bins = self._settled()
        if bins is None:
            value = self._exact()
            value = value[value < below_ns]
            width = quantile_of(value, 0.99) - quantile_of(value, 0.01)
            return float(value.std()), width, float(value.max())
        value, weight = bins.weighted()
        value = np.clip(value, self.minimum, self.maximum)
        value, weight = value[value < below_ns], weight[value < below_ns]
        if not len(value):
            return 0.0, 0.0, self.minimum
        mean = np.average(value, weights=weight)
        std = float(np.sqrt(np.average(np.square(value - mean), weights=weight)))
        total = np.cumsum(weight)
        low, high = np.searchsorted(
            total, [0.01 * (total[-1] - 1), 0.99 * (total[-1] - 1)], "right"
        )
        return std, float(value[high] - value[low]), float(value[-1])

    def off(self, expected_ns: float, unit_ns: float, resolution_ns: int) -> float | None:
        """Median less what is expected; None without values or where the stamps cannot show it."""
        apart = self.quantile(0.5) - expected_ns
        return apart / unit_ns if abs(apart) >= resolution_ns else None

    def histogram(self) -> tuple[NDArray[np.int64], Floats]:
        """(counts, edges) of all values: 64 bins over the middle 99 %, tails in growing bins.

        A bin of a tail is as wide as a middle one or an eighth of an octave, whichever is more, so
        that a lone value far away is drawn where it is.
        """
        if not self.count:
            return np.zeros(0, np.int64), np.zeros(1, np.float64)
        low, high = self.quantile(0.005), self.quantile(0.995)
        middle = np.linspace(low, high if high > low else low + 1.0, PLOT_BINS + 1)
        width = float(middle[1] - middle[0])
        head = _tail(low, min(self.minimum, low), width)
        tail = _tail(float(middle[-1]), max(self.maximum, float(middle[-1])), width)
        edges = np.concatenate([head[::-1], middle, tail])
        bins = self._settled()
        if bins is None:
            return np.histogram(self._exact(), edges)[0].astype(np.int64), edges
        value, weight = bins.weighted()
        inside = np.clip(value, self.minimum, self.maximum)
        return np.histogram(inside, edges, weights=weight)[0].astype(np.int64), edges

    def _exact(self) -> Values:
        """All values that wait, in one array."""
        if len(self._waiting) > 1:
            self._waiting = [np.concatenate(self._waiting, dtype=np.float64)]
        return self._waiting[0]

    def _settled(self) -> "_Bins | None":
        """The bins with all values in them, None while all values are kept."""
        if self._bins is not None and self._waiting:
            self._settle()
        return self._bins

    def _settle(self) -> None:
        """Put what waits into the bins, many values at a time."""
        new, (low, high) = self._exact(), self._fresh
        self._waiting, self._held, self._fresh = [], 0, _NO_LIMITS
        if self._bins is None:
            self._bins = _Bins(new)
        above = self._bins.add(new, low, high)
        if self._moments:
            self._add_moments(self._bins.low, above)

    def _add_moments(self, low: float, above: Floats) -> None:
        """Mean and squares of values by how far they lie above a low one.

        Those of two parts are joined as Chan et al. do (1979).
        """
        more, total = len(above), float(np.add.reduce(above))
        whole = float(np.add.reduce(np.square(above)))
        squares = whole - total * total / more
        if squares < _CANCELLED * whole:
            apart = above - total / more
            squares = float(np.square(apart).sum())
        before, self._counted = self._counted, self._counted + more
        off = low + total / more - self._mean
        self._mean += off * more / self._counted
        self._squares += squares + off * off * before * more / self._counted


def _told(value: float, resolution_ns: int, unit_ns: float) -> float | None:
    """A spread in its unit; None where the stamps are too coarse to show it."""
    return value / unit_ns if value >= resolution_ns else None


def quantile_of(values: Values, share: float) -> float:
    """What `np.quantile` tells by linear interpolation, without the checks that take it long."""
    at = (len(values) - 1) * share
    low = int(at)
    below, above = _neighbours(values, low)
    part = at - low
    if part >= 0.5:
        return above - (above - below) * (1 - part)
    return below + (above - below) * part


def median_of(values: Values) -> float:
    """What `np.median` tells of at least one number, in a quarter of its time."""
    half, odd = divmod(len(values), 2)
    below, above = _neighbours(values, half - 1 + odd)
    return below if odd else (below + above) / 2


def _neighbours(values: Values, low: int) -> tuple[float, float]:
    """The value of this number in their order, counted from 0, and the next one if there is one."""
    # By far faster than to have numpy look for both.
    ordered = np.partition(values, low)
    below, more = float(ordered[low]), ordered[low + 1 :]
    return below, float(np.minimum.reduce(more)) if len(more) else below


def _tail(edge: float, end: float, width: float) -> list[float]:
    """Edges beyond `edge` until `end` lies within them.

    >>> [round(edge) for edge in _tail(100.0, 150.0, 4.0)]
    [109, 119, 130, 141, 154]
    >>> _tail(10.0, 2.5, 4.0)
    [6.0, 2.0]
    """
    edges: list[float] = []
    upwards = end > edge
    while edge < end if upwards else edge > end:
        step = max(width, edge * (2 ** (1 / TAIL_BINS) - 1))
        edge = edge + step if upwards else max(edge - step, 0.0)
        edges.append(edge)
    return edges


_LEAST_MARGIN = 2.0**-48
"""Of the values: less than 1 ns of three days, and many steps of a float of any."""


class _Bins:
    """Counts in fine bins where most of the first values lie, in coarse ones elsewhere."""

    def __init__(self, first: Values) -> None:
        low, high = quantile_of(first, 0.01), quantile_of(first, 0.99)
        # Beside what it is added to it must not vanish: then the bins would have no width.
        margin = max(high - low, 1.0, high * _LEAST_MARGIN)
        top = high + margin
        # Below this a fine bin would be wider than a coarse one.
        self.low = max(low - margin, top / FINE_BINS / RELATIVE_ERROR)
        self._width = (top - self.low) / FINE_BINS
        self._fine = np.zeros(FINE_BINS, np.int64)
        self._coarse: NDArray[np.int64] | None = None
        """None while all values are in the fine bins."""
        self._cumulated: tuple[Floats, NDArray[np.int64]] | None = None
        """Middles of the bins, and how many values lie up to each, while nothing is added."""

    def add(self, values: Values, low: float, high: float) -> Floats:
        """Take in (n,) values, of which `low` and `high` are the least and the largest.

        Returns: (n,) by how much each lies above the lowest fine bin.
        """
        self._cumulated = None
        if low == high:
            self._add_equal(low, len(values))
            return np.full(len(values), low - self.low)
        far = low < self.low or (high - self.low) / self._width >= FINE_BINS
        if far and self._coarse is None:
            self._coarse = np.zeros(_COARSE_BINS, np.int64)
        if native.available():
            coarse = _NONE_FAR if self._coarse is None else self._coarse
            bins = self._fine, _SHIFT, _FIRST_KEY, coarse
            return native.histogram(values, self.low, self._width, *bins)
        above = np.subtract(values, self.low, dtype=np.float64)
        place = above / self._width
        if far:
            off = place >= FINE_BINS
            if low < self.low:
                off |= place < 0
            outside = np.flatnonzero(off)
            place[outside] = 0
            self._fine[0] -= len(outside)
            self._add_coarse(values[outside])
        self._fine += np.bincount(place.astype(np.int32), minlength=FINE_BINS)
        return above

    def _add_equal(self, value: float, count: int) -> None:
        """Take in one value so many times: nothing has to be looked at, and zeros are frequent."""
        place = (value - self.low) / self._width
        if 0 <= place < FINE_BINS:
            self._fine[int(place)] += count
            return
        if self._coarse is None:
            self._coarse = np.zeros(_COARSE_BINS, np.int64)
        self._coarse[_coarse_keys(np.array([value]))] += count

    def _add_coarse(self, values: Values) -> None:
        if self._coarse is None:
            self._coarse = np.zeros(_COARSE_BINS, np.int64)
        self._coarse += np.bincount(_coarse_keys(values), minlength=_COARSE_BINS)

    def value(self, number: float) -> float:
        """Middle of the bin in which the value of this number, counted from 0, lies."""
        if self._cumulated is None:
            if self._coarse is None:
                self._cumulated = _NO_VALUES, np.cumsum(self._fine)
            else:
                value, weight = self.weighted()
                self._cumulated = value, np.cumsum(weight)
        value, counts = self._cumulated
        at = int(np.searchsorted(counts, number, side="right"))
        return self.low + (at + 0.5) * self._width if self._coarse is None else float(value[at])

    def weighted(self) -> tuple[Floats, NDArray[np.int64]]:
        """Middles of the bins that are not empty, ascending, and their counts."""
        fine = np.flatnonzero(self._fine)
        if self._coarse is None:
            return self._middles(fine), self._fine[fine]
        coarse = np.flatnonzero(self._coarse)
        value = np.concatenate([self._middles(fine), _coarse_middles(coarse)])
        weight = np.concatenate([self._fine[fine], self._coarse[coarse]])
        order = np.argsort(value, kind="stable")
        return value[order], weight[order]

    def _middles(self, fine: NDArray[np.intp]) -> Floats:
        middles: Floats = np.asarray(self.low + (fine + 0.5) * self._width, np.float64)
        return middles


def _coarse_keys(values: Values) -> NDArray[np.int64]:
    """Bin of each value: exponent and leading mantissa bits of value + 1."""
    keys: NDArray[np.int64] = ((values + 1.0).view(np.int64) >> _SHIFT) - _FIRST_KEY
    # One value at a time too, for which `np.clip` takes long.
    return np.minimum(np.maximum(keys, 0), _COARSE_BINS - 1)


def _coarse_middles(keys: NDArray[np.int64]) -> Floats:
    edges = ((np.stack([keys, keys + 1]) + _FIRST_KEY) << _SHIFT).view(np.float64)
    middles: Floats = edges.mean(axis=0) - 1.0
    return middles
