"""What all machines of a fleet have in common."""

import numpy as np

from syncline_analyzer.fleet.trends.limits import MIN_MACHINES
from syncline_analyzer.fleet.trends.statistics import Floats, medians

_ROUNDS = 4


def common(value: Floats) -> Floats:
    """How the level of all machines moves alike; NaN in bins with too few of them; (bins,).

    Machines differ by a constant, and this is the rest that they have in common: rows and columns
    are brought to a median of zero in turn (J. W. Tukey's median polish).

    Args:
        value: of the machines of one fleet, (machines, bins).
    """
    told = np.isfinite(value).sum(axis=0) >= MIN_MACHINES
    moved = np.where(told, value, np.nan)
    found = np.zeros(value.shape[1])
    for _ in range(_ROUNDS):
        own = medians(moved - found)
        found = np.nan_to_num(medians((moved - own[:, None]).T))
    return np.where(told, found, np.nan)


def less_common(value: Floats, of_all: Floats) -> Floats:
    """Levels without what all have in common, where that is known."""
    return value - np.nan_to_num(of_all)
