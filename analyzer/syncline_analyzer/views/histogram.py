"""Response times of a PDO as bars whose area is the number of answers."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, Responses
from syncline_analyzer.views.words import hex_code
from syncline_schemas.wording import counted

MAX_HISTOGRAMS = 12
_SHOWN = (0.0005, 0.9995)
_CORE = (0.01, 0.99)
_FAR = 4.0
"""Bars further away than this many widths of the core would squeeze it."""


@dataclass(frozen=True, slots=True, eq=False)
class Bars:
    """Bars of one histogram: middle and width [us], height [answers per us], all (n,) float64.

    Single answers far away are left out, `left_out` of them, so that the others can be seen.
    """

    title: str
    middle_us: NDArray[np.float64]
    width_us: NDArray[np.float64]
    per_us: NDArray[np.float64]
    left_out: int

    @property
    def label(self) -> str:
        """Title that owns up to what is left out."""
        return (
            f"{self.title}, {counted(self.left_out, 'outlier')} left out"
            if self.left_out
            else self.title
        )


def histograms(analysis: Analysis) -> list[tuple[Responses, Bars]]:
    """Histograms of the PDOs that answered, at most twelve."""
    answered = [r for r in analysis.responses if r.histogram.any()]
    return [(r, bars_of(r)) for r in answered[:MAX_HISTOGRAMS]]


def bars_of(responses: Responses) -> Bars:
    """Bars of the bins that hold all answers but one in a thousand, and lie near most of them."""
    edges = responses.edges_us
    share = np.cumsum(responses.histogram) / responses.histogram.sum()
    first, last = _bins(share, _SHOWN)
    core_first, core_last = _bins(share, _CORE)
    low, high = float(edges[core_first]), float(edges[core_last + 1])
    far = _FAR * (high - low)
    first = max(first, int(np.searchsorted(edges, low - far)))
    last = min(last, int(np.searchsorted(edges, high + far, side="right")) - 2)
    widths = np.diff(edges)
    shown = slice(first, last + 1)
    return Bars(
        title=f"{responses.bus} {hex_code(responses.cob_id, 3)} {responses.pdo or 'PDO'}",
        middle_us=(edges[:-1] + widths / 2)[shown],
        width_us=widths[shown],
        per_us=(responses.histogram / widths)[shown],
        left_out=int(responses.histogram.sum() - responses.histogram[shown].sum()),
    )


def period_bars(analysis: Analysis) -> list[tuple[str, Bars]]:
    """SYNC periods by bus, where every period is there and none was thinned away."""
    counts = {(row.bus, row.cob_id): row.count for row in analysis.sync}
    found = []
    for series in analysis.series:
        cob_id = _SYNC_SERIES.fullmatch(series.name)
        value = series.value[np.isfinite(series.value)]
        if cob_id and 2 <= len(value) >= _COMPLETE * counts.get(
            (series.bus, int(cob_id[1], 16)), 0
        ):
            found.append((series.bus, _counted(value, f"{series.bus} {cob_id[1]}h SYNC period")))
    return found


def _counted(value: NDArray[np.float64], title: str) -> Bars:
    """Equally wide bars of most values; single ones far away are left out."""
    low, high = (float(q) for q in np.quantile(value, _CORE))
    far = _FAR * max(high - low, 1.0)
    near = value[(value >= low - far) & (value <= high + far)]
    counts, edges = np.histogram(near, bins=_BARS)
    width = np.diff(edges)
    return Bars(title, edges[:-1] + width / 2, width, counts / width, len(value) - len(near))


_SYNC_SERIES = re.compile(r"SYNC ([0-9A-F]+)h period")
_COMPLETE = 0.9
_BARS = 60


def _bins(share: NDArray[np.float64], shares: tuple[float, float]) -> tuple[int, int]:
    """First and last bin of those between two shares of all answers."""
    first = np.searchsorted(share, shares[0], side="right")
    return int(first), int(np.searchsorted(share, shares[1], side="left"))
