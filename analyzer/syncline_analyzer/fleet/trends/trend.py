"""A trend before it is put into words."""

from typing import Literal

from syncline_analyzer.fleet.trends.tracks import Label, Tracks
from syncline_schemas.records import dataclass

Kind = Literal["step", "drift", "rate", "wear"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trend:
    """What became different in one or several tracks of one quantity.

    Attributes:
        kind: "rate" of what is counted, "wear" of a counter that reaches a rating.
        tracks: those of the quantity.
        members: numbers of the tracks that show it, the clearest first.
        of_fleet: whether it is one of many machines.
        onset: bin in which it begins.
        before, after: values or rates on either side; of a drift at its ends.
        slope: of a drift per bin, else 0.
        size: how many times its least size it has; of several the greatest is told first.
        p: probability that chance makes it.
        q: false discovery rate, 1 until all were judged.
    """

    kind: Kind
    tracks: Tracks
    members: tuple[int, ...]
    of_fleet: bool
    onset: int
    before: float | None
    after: float | None
    change: float
    slope: float
    size: float
    p: float
    q: float = 1.0
    reaches: str = ""
    reaches_ns: int | None = None
    assumed: tuple[str, ...] = ()

    @property
    def lead(self) -> Label:
        """What the clearest track is of."""
        return self.tracks.labels[self.members[0]]

    @property
    def labels(self) -> list[Label]:
        """What all tracks are of."""
        return [self.tracks.labels[each] for each in self.members]

    @property
    def machines(self) -> list[str]:
        """Names of the machines, the clearest first."""
        return list(dict.fromkeys(each.machine for each in self.labels))
