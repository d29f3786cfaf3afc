"""Steps and spikes of an encoder that no speed limit shows, but that no shaft can follow."""

from dataclasses import field, replace
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from syncline_schemas.measurement import EncoderScale, count_steps
from syncline_schemas.records import dataclass

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
ALONE_NS = 500_000_000
"""So long before and after there is no other such step: some devices measure less often than they
send, so that a turning shaft stands for a few samples and then steps."""
ALONE_SAMPLES = 128
"""At most so many samples."""
ALONE_TIMES = 3
"""A step of a third counts as another one."""
OFTEN = 0.9
"""Share of the steps before that are none of zero, from which on it measures as often as it sends."""
LeapKind = Literal["step", "spike", "preset", "unsure step"]

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Leap:
    """A position that leaves its line between two samples.

    "unsure step": too little follows to tell whether the shaft began to turn.
    """

    kind: LeapKind
    seq: int
    t_ns: int
    span_ns: int
    before: float
    after: float
    rev_s2: float
    """What the shaft would have to do, from standstill to standstill."""
    preset: int | None = None
    """Value of 6003h on devices that a wire can set."""


@dataclass(slots=True)
class Leaps:
    """Finds them source by source; what stands at the end of a block waits for the next one."""

    _tails: dict[int, tuple[Integers, Integers, Integers]] = field(default_factory=dict)
    """(seq, t_ns, position) of the last samples by source."""
    _judged: dict[int, int] = field(default_factory=dict)
    """`seq` of the last sample by source that is done with."""
    _scales: dict[int, EncoderScale] = field(default_factory=dict)
    _preset: int | None = None

    def end(self) -> list[Leap]:
        """Leaps near the end of what was added; what comes next does not go on from here."""
        found: list[Leap] = []
        for source, samples in self._tails.items():
            if len(samples[0]) > STEADY + 1:
                judged = self._judged.get(source, -1)
                found += _near_the_end(samples, judged, self._scales[source], self._preset)
                self._judged[source] = int(samples[0][-1])
        self._tails.clear()
        return sorted(found, key=lambda leap: leap.seq)

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
        self._scales[source], self._preset = scale, preset
        tail = self._tails.get(source)
        if tail is not None:
            samples = (
                np.concatenate((tail[0], samples[0])),
                np.concatenate((tail[1], samples[1])),
                np.concatenate((tail[2], samples[2])),
            )
        seq, t_ns, position = samples
        kept = 2 * ALONE_SAMPLES + _WIDTH
        self._tails[source] = (seq[-kept:], t_ns[-kept:], position[-kept:])
        if len(seq) <= _WIDTH:
            return []
        steps = count_steps(position, scale.range_counts)
        around = _around(t_ns)
        rows = _standing_out(steps, scale.counts_per_turn)
        landed = rows + STEADY + 1
        last = len(seq) - 1 - around
        rows = rows[(landed <= last) & (seq[landed] > self._judged.get(source, -1))]
        if last >= 0:
            self._judged[source] = max(int(seq[last]), self._judged.get(source, -1))
        rows = rows[_alone(steps, rows + STEADY, around)]
        found = (_leap(samples, steps, int(row), scale, preset) for row in rows)
        return [leap for leap in found if leap is not None]


def _around(t_ns: Integers) -> int:
    """Number of samples before and after that are looked at."""
    usual_ns = max(float(np.median(np.diff(t_ns))), 1.0)
    return int(np.clip(ALONE_NS / usual_ns, STEADY + 1, ALONE_SAMPLES))


def _near_the_end(
    samples: tuple[Integers, Integers, Integers],
    judged: int,
    scale: EncoderScale,
    preset: int | None,
) -> list[Leap]:
    """Leaps that are followed by less than is looked at else.

    Only a spike, a step of a shaft that turned before, and one onto the preset value are sure.
    """
    seq, t_ns, position = samples
    assert scale.range_counts is not None
    assert scale.counts_per_turn is not None
    steps = count_steps(position, scale.range_counts)
    around = _around(t_ns)
    least = _least(scale.counts_per_turn)
    size = np.abs(steps)
    for at in (np.flatnonzero(size[STEADY:] >= least) + STEADY).tolist():
        whole = at + STEADY + 1 < len(steps)
        alone = (
            size[at] > TIMES * size[at - STEADY : at].max()
            and (_alone(np.append(steps, 0), np.array([at]), around)[0])
        )
        if seq[at + 1] <= judged or not alone:
            continue
        if whole and not _stands_out(size, at):
            continue
        found = (
            _leap(samples, steps, at - STEADY, scale, preset)
            if whole
            else _cut_short(samples, steps, at, scale)
        )
        if found is None:
            continue
        often = np.count_nonzero(steps[max(at - around, 0) : at]) >= OFTEN * min(at, around)
        if found.kind == "step" and not often:
            found = replace(found, kind="unsure step")
        return [found]
    return []


def _cut_short(
    samples: tuple[Integers, Integers, Integers],
    steps: Integers,
    at: int,
    scale: EncoderScale,
) -> Leap | None:
    """A leap so near to the end that it is only seen to begin."""
    seq, t_ns, position = samples
    spans = np.diff(t_ns[at - STEADY : at + 2])
    if (spans < 0).any():
        return None
    assert scale.counts_per_turn is not None
    span_ns = max(int(spans[-1]), int(np.median(spans)), 1)
    # It may have to speed up only, which takes half of what a stop in the same time takes.
    rev_s2 = 2 * abs(int(steps[at])) / scale.counts_per_turn / (span_ns / _S) ** 2
    if rev_s2 < HARD_REV_S2:
        return None
    before, after = float(position[at]), float(position[at + 1])
    return Leap("unsure step", int(seq[at + 1]), int(t_ns[at + 1]), span_ns, before, after, rev_s2)


def _least(per_turn: int) -> float:
    """The least step [counts] that is looked at."""
    return max(LEAST_COUNTS, LEAST_DEG / 360.0 * per_turn)


def _stands_out(size: Integers, at: int) -> bool:
    """Whether a step is far bigger than those before, and than those after the next one."""
    near = np.concatenate((size[at - STEADY : at], size[at + 2 : at + 2 + STEADY]))
    return bool(size[at] > TIMES * near.max())


def _alone(steps: Integers, at: NDArray[np.intp], around: int) -> NDArray[np.bool_]:
    """Whether no step near is nearly as big as the ones at `at`; spikes may come in numbers."""
    offsets = np.concatenate((np.arange(-around, 0), np.arange(2, around)))
    near = np.clip(at[:, None] + offsets, 0, len(steps) - 1)
    inside = near == at[:, None] + offsets
    size = np.where(inside, np.abs(steps)[near], 0).max(axis=1, initial=0)
    way, back = steps[at], steps[at + 1]
    spike = ALONE_TIMES * np.abs(way + back) < np.abs(way)
    alone: NDArray[np.bool_] = spike | (ALONE_TIMES * size < np.abs(way))
    return alone


def _standing_out(steps: Integers, per_turn: int) -> NDArray[np.intp]:
    """Starts of windows of steps whose middle one is far bigger than those around it."""
    size = np.abs(steps)
    least = _least(per_turn)
    middle = size[STEADY : len(size) - STEADY - 1]
    big = np.flatnonzero(middle >= least)
    # Most steps of a shaft that turns are as big as the one before.
    big = big[middle[big] > TIMES * size[big + STEADY - 1]]
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
        preset,
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
