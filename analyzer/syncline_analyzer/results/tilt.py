"""Tilts: both axes of an inclinometer taken together."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class TiltRow:
    """Summary of the tilt of one inclinometer, by one pair of objects (6010h and 6020h, or 32 bit).

    `definition` is the angle definition at the end, `angles` what both angles mean together ("" where
    that is not known, see `syncline_schemas.tilt.Angles`). `converted` counts samples that have a
    direction of gravity, `reasons` say why others have none. `slope_max_deg` is the greatest angle
    between the sensor's z axis and the vertical, met at `slope_max_ns`.
    """

    bus: str
    node: int
    object: int
    """index << 8 | sub of the longitudinal axis"""
    definition: str
    angles: str
    samples: int
    converted: int
    singular: int
    impossible: int
    upright_assumed: int
    slope_max_deg: float | None
    slope_max_ns: int | None
    slope_max_seq: int | None
    reasons: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
    """Settings that were only assumed: "res", "quad", "angle_def", "reference"."""


@dataclass(frozen=True, slots=True)
class TiltSetting:
    """How a device shows its tilt for a while; `reason` says why there is no gravity, "" if none."""

    definition: str
    angles: str
    reference: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class TiltTrace:
    """Tilt over time, for the 3D view and `Session.tilt()`; thinned like a trace.

    All (n,): t_ns int64; seq int64 of the longitudinal sample; longitudinal_deg and lateral_deg
    float64 as sent, NaN where such an angle cannot be; flags uint8 of `syncline_schemas.tilt.TiltFlag`; setting int64, the place in
    `settings`. gravity (n, 3) float64 as in `syncline_schemas.tilt`, NaN where there is none.
    """

    bus: str
    node: int
    object: int
    t_ns: NDArray[np.int64]
    seq: NDArray[np.int64]
    longitudinal_deg: NDArray[np.float64]
    lateral_deg: NDArray[np.float64]
    gravity: NDArray[np.float64]
    flags: NDArray[np.uint8]
    setting: NDArray[np.int64]
    settings: list[TiltSetting] = field(default_factory=list)
