"""Angles that mean nothing in the pose of that moment, by the other axis of the inclinometer."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.samples import Key, Samples
from syncline_analyzer.folds.angle.trace import Converter, Tilt
from syncline_schemas.measurement import tilt_deg
from syncline_schemas.tilt import Angles, TiltFlag, gravity_of

LATERAL = 0x10 << 8
"""From the longitudinal to the lateral object (CiA 410: 6010h and 6020h, 6110h and 6120h)."""
_MEANINGLESS = {Angles.EULER: 1, Angles.GIMBAL_X: 1, Angles.GIMBAL_Y: 0}
"""Which axis means nothing at the singular point: an Euler direction at slope 0, a gimbal's second
rotation where the first one turned it into the direction of gravity."""


def with_singular(
    found: Mapping[Key, Samples],
    edges: Mapping[int, Sequence[int]],
    converter: Callable[[Key, Samples, int], Converter],
) -> dict[Key, Samples]:
    """The samples of a block with `singular` set where an angle means nothing (JN2100 trap 8).

    Args:
        found: the samples.
        edges: by node the `seq` at which the scale may change.
        converter: the scale of a piece.
    """
    marked = dict(found)
    for key, first in found.items():
        second = found.get((key[0], key[1], key[2] + LATERAL))
        if second is None:
            continue
        axes = (first, second)
        masks = [np.zeros(len(axis.seq), np.bool_) for axis in axes]
        for parts, scale in _pieces(key, axes, edges.get(key[1], ()), converter):
            chosen = _MEANINGLESS.get(scale.scale.angles) if scale.scale.angles else None
            if chosen is not None:
                own, other = axes[chosen], axes[1 - chosen]
                masks[chosen][parts[chosen]] = _meaningless(
                    own.part(parts[chosen].start, parts[chosen].stop), other, scale, chosen
                )
        for at, (axis, mask) in enumerate(zip(axes, masks, strict=True)):
            if mask.any():
                marked[(key[0], key[1], key[2] + at * LATERAL)] = replace(axis, singular=mask)
    return marked


def _pieces(
    key: Key,
    axes: tuple[Samples, Samples],
    edges: Sequence[int],
    converter: Callable[[Key, Samples, int], Converter],
) -> Iterator[tuple[tuple[slice, slice], Tilt]]:
    """The rows of both axes between changes of the scale, and the scale."""
    begin = min(int(axis.seq[0]) for axis in axes)
    stop = max(int(axis.seq[-1]) for axis in axes) + 1
    inner = sorted({seq for seq in edges if begin < seq < stop})
    for low, high in pairwise([begin, *inner, stop]):
        rows = [np.searchsorted(axis.seq, [low, high]).tolist() for axis in axes]
        scale = converter(key, axes[0], low)
        if isinstance(scale, Tilt):
            yield (slice(*rows[0]), slice(*rows[1])), scale


def _meaningless(own: Samples, other: Samples, scale: Tilt, chosen: int) -> NDArray[np.bool_]:
    """Which samples (n,) of one axis mean nothing, by the last sample of the other one."""
    at = np.searchsorted(other.seq, own.seq, side="right") - 1
    angles = [
        tilt_deg(samples.raw, samples.entry.bits, scale.scale.deg_per_count, axis)
        for samples, axis in (
            (own, scale.scale.axes[chosen]),
            (other, scale.scale.axes[1 - chosen]),
        )
    ]
    beside = np.where(at >= 0, angles[1][np.maximum(at, 0)], np.nan)
    first, second = (beside, angles[0]) if chosen else (angles[0], beside)
    assert scale.scale.angles is not None
    pose = gravity_of(scale.scale.angles, first, second, full_circle=scale.scale.full_circle)
    singular: NDArray[np.bool_] = (pose.flags & np.uint8(TiltFlag.SINGULAR)) != 0
    return singular
