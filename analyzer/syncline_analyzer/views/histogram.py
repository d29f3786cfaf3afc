"""Response times of a PDO as bars whose area is the number of answers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, Responses
from syncline_analyzer.views.words import hex_code

MAX_HISTOGRAMS = 12
_ONLY_MORE = 3.0
_SHOWN = (0.0005, 0.9995)


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
        return f"{self.title}, {self.left_out} outliers left out" if self.left_out else self.title


def histograms(analysis: Analysis) -> list[tuple[Responses, Bars]]:
    """Histograms of the PDOs that answered, at most twelve."""
    answered = [r for r in analysis.responses if r.histogram.any()]
    return [(r, bars_of(r)) for r in answered[:MAX_HISTOGRAMS]]


def bars_of(responses: Responses) -> Bars:
    """Bars of the bins that hold all answers but one in a thousand.

    A last bin that is far wider than all others together, which only says "more", is left out too.
    """
    share = np.cumsum(responses.histogram) / responses.histogram.sum()
    first = int(np.searchsorted(share, _SHOWN[0], side="right"))
    last = int(np.searchsorted(share, _SHOWN[1], side="left"))
    widths = np.diff(responses.edges_us)
    if last > first and widths[last] > _ONLY_MORE * widths[first:last].sum():
        last -= 1
    shown = slice(first, last + 1)
    return Bars(
        title=f"{responses.bus} {hex_code(responses.cob_id, 3)} {responses.pdo or 'PDO'}",
        middle_us=(responses.edges_us[:-1] + widths / 2)[shown],
        width_us=widths[shown],
        per_us=(responses.histogram / widths)[shown],
        left_out=int(responses.histogram.sum() - responses.histogram[shown].sum()),
    )
