"""Steps and spikes of an encoder that no speed limit shows, but that no shaft can follow."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from syncline_schemas.measurement import EncoderScale, count_steps

STEADY = 3
"""Steps before and after that must be alike."""
LEAST_DEG = 2.0
TIMES = 10.0
"""So many times the steps around it."""
LEAST_COUNTS = 8
SLACK_COUNTS = 2
HARD_REV_S2 = 1000.0
"""From standstill to standstill in one sample: no machine speeds up and brakes so hard [rev/s^2]."""
SOFT_REV_S2 = 100.0
"""The same where it ends on the preset value to the count, which motion hardly ever does."""
_WIDTH = 2 * STEADY + 2
"""Steps that are looked at together: those before, one or two that stand out, those after."""
_S = 1e9

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Leap:
    """A position that leaves its line between two samples."""

    kind: Literal["step", "spike", "preset"]
    seq: int
    t_ns: int
    span_ns: int
    before: float
    after: float
    rev_s2: float
    """What the shaft would have to do, from standstill to standstill."""


@dataclass(slots=True)
class Leaps:
    """Finds them source by source; what stands at the end of a block waits for the next one."""

    _tails: dict[int, tuple[Integers, Integers, Integers]] = field(default_factory=dict)
    """(seq, t_ns, position) of the last samples by source."""

    def cut(self) -> None:
        """What comes next does not go on from here."""
        self._tails.clear()

    def add(
        self,
        source: int,
        samples: tuple[Integers, Integers, Integers],
        scale: EncoderScale,
        preset: int | None,
    ) -> list[Leap]:
        """Leaps among (seq, t_ns, position) of one source, each (n,)."""
        if scale.range_counts is None or scale.counts_per_turn is None:
            return []
        tail = self._tails.get(source)
        if tail is not None:
            samples = (
                np.concatenate((tail[0], samples[0])),
                np.concatenate((tail[1], samples[1])),
                np.concatenate((tail[2], samples[2])),
            )
        seq, t_ns, position = samples
        self._tails[source] = (seq[-_WIDTH:], t_ns[-_WIDTH:], position[-_WIDTH:])
        if len(seq) <= _WIDTH:
            return []
        steps = count_steps(position, scale.range_counts)
        rows = _standing_out(steps, scale.counts_per_turn)
        found = (_leap(samples, steps, int(row), scale, preset) for row in rows)
        return [leap for leap in found if leap is not None]


def _standing_out(steps: Integers, per_turn: int) -> NDArray[np.intp]:
    """Starts of windows of steps whose middle one is far bigger than those around it."""
    size = np.abs(steps)
    least = max(LEAST_COUNTS, LEAST_DEG / 360.0 * per_turn)
    big = np.flatnonzero(size[STEADY : len(size) - STEADY - 1] >= least)
    if not len(big):
        return big
    windows = sliding_window_view(size, _WIDTH)[big]
    around = np.concatenate((windows[:, :STEADY], windows[:, STEADY + 2 :]), axis=1).max(axis=1)
    chosen: NDArray[np.intp] = big[windows[:, STEADY] > TIMES * around]
    return chosen


def _leap(
    samples: tuple[Integers, Integers, Integers],
    steps: Integers,
    start: int,
    scale: EncoderScale,
    preset: int | None,
) -> Leap | None:
    """The leap in a window of steps, None where a shaft can do it."""
    seq, t_ns, position = samples
    at = start + STEADY
    before, after = steps[start:at], steps[at + 2 : at + 2 + STEADY]
    way = int(steps[at])
    back = int(steps[at + 1])
    usual = int(max(np.abs(before).max(), np.abs(after).max()))
    loose = 2 * usual + SLACK_COUNTS
    if abs(float(before.mean()) - float(after.mean())) > usual / 2 + SLACK_COUNTS:
        return None
    spans = np.diff(t_ns[start : start + _WIDTH + 1])
    if (spans < 0).any():
        return None
    span_ns = max(int(spans[STEADY]), int(np.median(spans)), 1)
    assert scale.counts_per_turn is not None
    rev_s2 = 4 * abs(way) / scale.counts_per_turn / (span_ns / _S) ** 2
    landed = int(position[at + 1])
    kind = _kind(way, back, loose, landed, scale, preset)
    hard = SOFT_REV_S2 if kind == "preset" else HARD_REV_S2
    if kind is None or rev_s2 < hard:
        return None
    return Leap(
        kind,
        int(seq[at + 1]),
        int(t_ns[at + 1]),
        span_ns,
        float(position[at]),
        float(landed),
        rev_s2,
    )


def _kind(
    way: int, back: int, loose: int, landed: int, scale: EncoderScale, preset: int | None
) -> Literal["step", "spike", "preset"] | None:
    if abs(way + back) <= loose:
        return "spike"
    if abs(back) > loose:
        return None
    assert scale.range_counts is not None
    if preset is not None:
        away = (landed - preset) % scale.range_counts
        if min(away, scale.range_counts - away) <= loose:
            return "preset"
    return "step"
