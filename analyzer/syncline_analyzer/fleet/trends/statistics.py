"""Robust statistics of many short series at a time; gaps are NaN.

Matrices are (tracks, bins) float64. Sources: H. Theil 1950 and P. K. Sen 1968 (slopes), M. G.
Kendall 1938 (rank correlation), D. L. Wallace 1959 (Student's t as a normal value),
Y. Benjamini and Y. Hochberg 1995 (false discovery rate).
"""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SIGMA = 1.4826
"""Median absolute deviation to standard deviation, of normal values."""
_SIGMA_80 = 1 / 1.2816
"""80 % quantile of absolute deviations to standard deviation, of normal values."""
_FIRM_MEDIAN = 1.2533
"""Standard error of a median to that of a mean, of normal values."""
_FIRM_SLOPE = 1.05
"""The same of a median slope to that of least squares."""


def quantiles(values: Floats, share: float) -> Floats:
    """A quantile of each row without its gaps, the middle between neighbours for the median; (tracks,).

    >>> quantiles(np.array([[3.0, np.nan, 1.0], [np.nan] * 3]), 0.5).tolist()
    [2.0, nan]
    """
    if not values.shape[1]:
        return np.full(len(values), np.nan)
    ordered = np.sort(values, axis=1)
    count = np.isfinite(values).sum(axis=1)
    place = share * np.maximum(count - 1, 0)
    low, high = np.floor(place).astype(np.int64), np.ceil(place).astype(np.int64)
    rows = np.arange(len(values))
    found = ordered[rows, low] + (ordered[rows, high] - ordered[rows, low]) * (place - low)
    told: Floats = np.where(count > 0, found, np.nan)
    return told


def medians(values: Floats) -> Floats:
    """Median of each row without its gaps; (tracks,)."""
    return quantiles(values, 0.5)


def spreads(residuals: Floats) -> Floats:
    """Standard deviation by quantiles: up to a fifth of the values may be anything; (tracks,)."""
    off = np.abs(residuals)
    spread = np.maximum(SIGMA * quantiles(off, 0.5), _SIGMA_80 * quantiles(off, 0.8))
    return np.nan_to_num(spread)


def totals(values: Floats) -> Floats:
    """Sum of each row, gaps as nothing; (tracks,)."""
    total: Floats = np.nan_to_num(values).sum(axis=1)
    return total


def persistence(residuals: Floats, spread: Floats, quantum: float) -> Floats:
    """How much more a row's values vary together than single ones: factor of a variance, >= 1.

    That of an autoregression whose coefficient is the correlation of neighbouring bins, the bias
    of short series taken off it (1/n). What lies below `quantum` is no resemblance.
    """
    bound = 3 * np.maximum(spread, 1e-300)[:, None]
    kept = np.clip(residuals, -bound, bound)
    both = np.isfinite(kept[:, 1:]) & np.isfinite(kept[:, :-1])
    product = np.where(both, kept[:, 1:] * kept[:, :-1], 0.0).sum(axis=1)
    square = totals(kept**2)
    count = np.maximum(np.isfinite(kept).sum(axis=1), 1)
    pairs = np.maximum(both.sum(axis=1), 1)
    variance = np.maximum(square / count, max(quantum, 1e-300) ** 2)
    share = product / pairs / variance
    rho = np.clip(share + 1 / count, 0.0, 0.9)
    factor: Floats = (1 + rho) / (1 - rho)
    return factor


def normal_p(z: Floats) -> Floats:
    """Probability that chance goes so far off either way.

    >>> normal_p(np.array([1.959964])).round(6).tolist()
    [0.05]
    """
    return np.array([math.erfc(abs(each) / math.sqrt(2)) for each in z.tolist()])


def normal_of_student(t: Floats, dof: Floats) -> Floats:
    """The normal value that is as rare as Student's t (Wallace's approximation), sign kept.

    >>> z = normal_of_student(np.array([2.2281]), np.array([10.0]))   # t table: 5 % at 10
    >>> normal_p(z).round(3).tolist()
    [0.05]
    """
    dof = np.maximum(dof, 1.0)
    size = np.sqrt(dof * np.log1p(np.minimum(t**2 / dof, 1e300)))
    return np.sign(t) * size * (8 * dof + 1) / (8 * dof + 3)


def false_discovery(p: Floats) -> Floats:
    """Of each p value the rate of false discoveries among those no larger (Benjamini-Hochberg).

    >>> false_discovery(np.array([0.01, 0.04, 0.03, 0.5])).round(4).tolist()
    [0.04, 0.0533, 0.0533, 0.5]
    """
    if not len(p):
        return p
    order = np.argsort(p)
    rate = p[order] * len(p) / np.arange(1, len(p) + 1)
    found = np.empty_like(p)
    found[order] = np.minimum.accumulate(rate[::-1])[::-1]
    return np.minimum(found, 1.0)


def step_z(difference: Floats, spread: Floats, counts: tuple[Ints, Ints], factor: Floats) -> Floats:
    """Normal value of a difference of two medians of `counts` values each; (tracks,).

    Args:
        spread: of the values on either side.
        factor: of the variance, for values that vary together.
    """
    before, after = (np.maximum(each, 1).astype(np.float64) for each in counts)
    error = _FIRM_MEDIAN * spread * np.sqrt((1 / before + 1 / after) * factor)
    t = np.divide(difference, error, out=np.zeros_like(difference), where=error > 0)
    return normal_of_student(t, before + after - 2)


def drift_z(change: Floats, spread: Floats, count: Ints, factor: Floats) -> Floats:
    """Normal value of what a line through `count` bins amounts to; (tracks,).

    Args:
        spread: of the values about the line.
        factor: of the variance, for values that vary together.
    """
    bins = np.maximum(count, 1).astype(np.float64)
    error = _FIRM_SLOPE * spread * np.sqrt(12 / bins * factor)
    t = np.divide(change, error, out=np.zeros_like(change), where=error > 0)
    return normal_of_student(t, bins - 2)


def rising_share(values: Floats, epoch: Ints) -> Floats:
    """Share of rising less falling pairs of bins of one epoch (Kendall's tau, ties as none)."""
    signs, pairs = pair_signs(values, epoch)
    share: Floats = signs.sum(axis=(1, 2)) / np.maximum(pairs.sum(axis=(1, 2)), 1)
    return share


def pair_signs(values: Floats, epoch: Ints) -> tuple[Floats, Bools]:
    """Sign of later less earlier bins, and which pairs can be compared; (tracks, bins, bins)."""
    difference = values[:, None, :] - values[:, :, None]
    later = np.triu(np.ones(difference.shape[1:], np.bool_), 1)
    pairs = np.isfinite(difference) & later & (epoch[:, None, :] == epoch[:, :, None])
    return np.where(pairs, np.sign(difference), 0.0), pairs


def slopes(values: Floats, epoch: Ints) -> Floats:
    """Median slope of all pairs of bins of one epoch (Theil-Sen), per bin; NaN without any; (tracks,)."""
    bins = values.shape[1]
    early, late = np.triu_indices(bins, 1)
    slope = (values[:, late] - values[:, early]) / (late - early)
    slope[epoch[:, late] != epoch[:, early]] = np.nan
    return medians(slope)


def weighted_medians(values: Floats, weights: Floats) -> Floats:
    """Weighted median of each row without its gaps; NaN without any; (tracks,)."""
    order = np.argsort(values, axis=1)
    weight = np.where(np.isfinite(values), weights, 0.0)
    ordered = np.take_along_axis(weight, order, axis=1).cumsum(axis=1)
    half = ordered[:, -1:] / 2
    place = (ordered < half).sum(axis=1)
    rows = np.arange(len(values))
    found = values[rows, order[rows, np.minimum(place, values.shape[1] - 1)]]
    return np.where(ordered[:, -1] > 0, found, np.nan)
