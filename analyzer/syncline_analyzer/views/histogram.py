"""Response times of PDOs and periods of SYNCs as bars whose area is their number."""

import re
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, Responses
from syncline_analyzer.views.troubled import troubled
from syncline_analyzer.views.words import hex_code
from syncline_schemas.records import dataclass
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
    """Histograms of the PDOs that answered, at most twelve: those of nodes in trouble stay."""
    answered = [r for r in analysis.responses if r.histogram.any()]
    ranks = troubled(analysis)
    order = sorted(
        range(len(answered)),
        key=lambda i: ranks.get((answered[i].bus, answered[i].node or 0), len(ranks) + 9),
    )
    return [(r, bars_of(r)) for r in (answered[i] for i in sorted(order[:MAX_HISTOGRAMS]))]


def bars_of(responses: Responses) -> Bars:
    """Bars of the answers of a PDO."""
    title = f"{responses.bus} {hex_code(responses.cob_id, 3)} {responses.pdo or 'PDO'}"
    return _binned(responses.histogram, responses.edges_us, title)


def _binned(counts: NDArray[np.int64], edges: NDArray[np.float64], title: str) -> Bars:
    """Bars of the bins that hold all but one in a thousand, and lie near most of them."""
    share = np.cumsum(counts) / counts.sum()
    first, last = _bins(share, _SHOWN)
    core_first, core_last = _bins(share, _CORE)
    low, high = float(edges[core_first]), float(edges[core_last + 1])
    far = _FAR * (high - low)
    first = max(first, int(np.searchsorted(edges, low - far)))
    last = min(last, int(np.searchsorted(edges, high + far, side="right")) - 2)
    widths = np.diff(edges)
    shown = slice(first, last + 1)
    return Bars(
        title=title,
        middle_us=(edges[:-1] + widths / 2)[shown],
        width_us=widths[shown],
        per_us=(counts / widths)[shown],
        left_out=int(counts.sum() - counts[shown].sum()),
    )


def period_bars(analysis: Analysis) -> list[tuple[str, Bars]]:
    """SYNC periods by bus, over every period, also where points of the plot were thinned away."""
    rows = {(row.bus, row.cob_id): row for row in analysis.sync}
    found = []
    for series in analysis.series:
        cob_id = _SYNC_SERIES.fullmatch(series.name)
        value = series.value[np.isfinite(series.value)]
        if cob_id is None or len(value) < 2:
            continue
        title = f"{series.bus} {cob_id[1]}h SYNC period"
        row = rows.get((series.bus, int(cob_id[1], 16)))
        if row is None or len(value) >= _COMPLETE * row.count:
            found.append((series.bus, _counted(value, title)))
        elif series.histogram is not None and series.edges is not None:
            # Beyond the middle the bins are an eighth of an octave wide: too coarse for a period.
            bars = _binned(series.histogram, series.edges, f"{title}, middle 99 %")
            wide = _coarser(bars, row.resolution_us)
            found.append((series.bus, replace(wide, left_out=0)))
    return found


def _counted(value: NDArray[np.float64], title: str) -> Bars:
    """Equally wide bars of most values; single ones far away are left out."""
    low, high = (float(q) for q in np.quantile(value, _CORE))
    far = _FAR * max(high - low, 1.0)
    near = value[(value >= low - far) & (value <= high + far)]
    counts, edges = np.histogram(near, bins=_BARS)
    width = np.diff(edges)
    return Bars(title, edges[:-1] + width / 2, width, counts / width, len(value) - len(near))


def _coarser(bars: Bars, step_us: float) -> Bars:
    """Bars so wide that the steps of the stamps make no pattern in them."""
    together = ceil(_STEPS_A_BAR * step_us / float(bars.width_us.min()))
    if not 1 < together < len(bars.per_us):
        return bars
    starts = np.arange(0, len(bars.per_us), together)
    width = np.add.reduceat(bars.width_us, starts)
    counts = np.add.reduceat(bars.per_us * bars.width_us, starts)
    left = (bars.middle_us - bars.width_us / 2)[starts]
    return replace(bars, middle_us=left + width / 2, width_us=width, per_us=counts / width)


_SYNC_SERIES = re.compile(r"SYNC ([0-9A-F]+)h period")
_COMPLETE = 0.9
_BARS = 60
_STEPS_A_BAR = 5


def _bins(share: NDArray[np.float64], shares: tuple[float, float]) -> tuple[int, int]:
    """First and last bin of those between two shares of all answers."""
    first = np.searchsorted(share, shares[0], side="right")
    return int(first), int(np.searchsorted(share, shares[1], side="left"))
