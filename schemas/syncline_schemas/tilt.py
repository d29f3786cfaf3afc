"""Tilt of a two-axis inclinometer: its four angle definitions and the direction of gravity.

Frame (JN2100 sheet 6.2): xy = mounting plane, x = printed arrow, z perpendicular to it, all
right-handed; longitudinal = turn about y, lateral = turn about x. `gravity` is (n, 3), the vertical
as a unit vector in that frame: (0, 0, 1) when level, with the signs with which the manual's
excavator table (8.5) comes out (gx = sin of the longitudinal angle, gy = sin of the lateral one, for
a tilt about one axis). A pose turns that very vector into the z axis of the world, so that a
positive longitudinal angle raises x and a positive lateral angle raises y: a right-handed turn about
x, and a left-handed one about y. In which sense a real sensor counts, the manual does not say (its
drawing is lost): where it counts the other way, both angles change their sign and the pose is turned
by half a turn about z. Angles are degrees, (n,). What cannot be converted is NaN.
"""

from enum import IntFlag, StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass

Degrees = NDArray[np.float64]
Vectors = NDArray[np.float64]
Mask = NDArray[np.bool_]
Geometry = Literal["perpendicular", "euler", "gimbal_x", "gimbal_y"]
PerpFormula = Literal["none", "asin", "atan"]

SINGULAR_DEG = 1.0
"""Nearer to a singular point than this an angle's noise is more than 57 times that of the pose."""
ROUNDING_DEG = 1.0
"""Coarsest step of the angles (6000h = 1000): so far a pose may lie outside what is possible."""
_NEAR = np.sin(np.radians(SINGULAR_DEG))
_NOWHERE = 1e-9


class Angles(StrEnum):
    """What two angles mean; the manual gives two formulas for its perpendicular angles (C21)."""

    PERPENDICULAR_ASIN = "perpendicular_asin"
    PERPENDICULAR_ATAN = "perpendicular_atan"
    EULER = "euler"
    GIMBAL_X = "gimbal_x"
    GIMBAL_Y = "gimbal_y"

    @property
    def names(self) -> tuple[str, str]:
        """What the first (6010h) and the second (6020h) angle show."""
        return ("slope", "direction") if self is Angles.EULER else ("longitudinal", "lateral")


class TiltFlag(IntFlag):
    """What is to be known of a pose."""

    SINGULAR = 1
    """Near the singular point of its definition: one of its angles is meaningless and jumps."""
    IMPOSSIBLE = 2
    """No pose has these two angles."""
    UPRIGHT_ASSUMED = 4
    """The angles are the same upside down; the z axis is taken to point up."""
    APART = 8
    """The two angles came in different frames and are of different moments."""


@dataclass(frozen=True, slots=True, eq=False)
class Tilt:
    """Directions of gravity: `gravity` (n, 3), NaN where there is none; `flags` (n,) uint8."""

    gravity: Vectors
    flags: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class TiltAngles:
    """Two angles by one definition, all (n,); `singular` where one of them is meaningless.

    Ranges without quadrant correction 2040h (JN2100 sheet 6.2), but perpendicular angles by atan,
    which tell upside down: +/-180.
    """

    first_deg: Degrees
    second_deg: Degrees
    singular: Mask


def angles_of_geometry(geometry: str, perp_formula: str = "none") -> Angles | None:
    """What a device's angles mean; None for perpendicular angles while no formula is chosen.

    >>> angles_of_geometry("perpendicular")
    >>> angles_of_geometry("perpendicular", "asin").value
    'perpendicular_asin'
    """
    if geometry == "perpendicular":
        formulas = {"asin": Angles.PERPENDICULAR_ASIN, "atan": Angles.PERPENDICULAR_ATAN}
        return formulas.get(perp_formula)
    return Angles(geometry) if geometry in ("euler", "gimbal_x", "gimbal_y") else None


def gravity_of(
    angles: Angles, first_deg: Degrees, second_deg: Degrees, *, full_circle: bool = False
) -> Tilt:
    """Direction of gravity from two angles of any quadrant setting (2040h).

    Args:
        angles: what they mean.
        first_deg, second_deg: (n,); longitudinal and lateral, for Euler slope and direction.
        full_circle: perpendicular angles have the quadrant correction, so that those beyond 90
            degrees tell upside down; without it upright is assumed.
    """
    first, second = signed_deg(first_deg), signed_deg(second_deg)
    x, y, z, possible, singular = _POSES[angles](first, second)
    gravity = np.stack([x, y, z], axis=1)
    known = ~(np.isnan(first) | np.isnan(second))
    gravity[~(possible & known)] = np.nan
    flags = (known & ~possible) * np.uint8(TiltFlag.IMPOSSIBLE)
    flags |= (known & possible & singular) * np.uint8(TiltFlag.SINGULAR)
    if angles in _PERPENDICULAR and not full_circle:
        flags |= (gravity[:, 2] >= 0.0) * np.uint8(TiltFlag.UPRIGHT_ASSUMED)
    return Tilt(gravity, flags)


def angles_of(gravity: Vectors, angles: Angles) -> TiltAngles:
    """Two angles by one definition; NaN where an angle does not exist at all."""
    x, y, z = np.asarray(gravity, np.float64).T
    yz, xz, xy = np.hypot(y, z), np.hypot(x, z), np.hypot(x, y)
    match angles:
        case Angles.PERPENDICULAR_ASIN:
            never = np.zeros(len(x), np.bool_)
            return TiltAngles(_deg(np.arctan2(x, yz)), _deg(np.arctan2(y, xz)), never)
        case Angles.PERPENDICULAR_ATAN:
            return TiltAngles(_circle(x, z, xz), _circle(y, z, yz), (xz < _NEAR) | (yz < _NEAR))
        case Angles.EULER:
            return TiltAngles(_deg(np.arctan2(xy, z)), _circle(x, -y, xy) % 360.0, xy < _NEAR)
        case Angles.GIMBAL_X:
            return TiltAngles(_deg(np.arctan2(x, yz)), _circle(y, z, yz), yz < _NEAR)
        case Angles.GIMBAL_Y:
            return TiltAngles(_circle(x, z, xz), _deg(np.arctan2(y, xz)), xz < _NEAR)


def slope_deg(gravity: Vectors) -> Degrees:
    """Angle between the z axis and the vertical: (n,) degrees, 0 level, 180 upside down."""
    x, y, z = np.asarray(gravity, np.float64).T
    return _deg(np.arctan2(np.hypot(x, y), z))


def pose_of(gravity: Vectors) -> NDArray[np.float64]:
    """The pose of the sensor without a turn about the vertical, which no inclinometer knows.

    Quaternions (n, 4) as x, y, z, w, that turn vectors of the sensor's frame into a world with z up:
    `gravity` itself becomes (0, 0, 1). A positive longitudinal angle raises x, a positive lateral one
    y; in which sense the sensor counts is not in the manual.
    """
    x, y, z = np.asarray(gravity, np.float64).T
    quaternion = np.stack([y, -x, np.zeros(len(x)), 1.0 + z], axis=1)
    # Upside down there are many shortest ways: take the turn about x.
    quaternion[np.hypot(x, y) + 1.0 + z < _NOWHERE] = [1.0, 0.0, 0.0, 0.0]
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return quaternion


def signed_deg(angle_deg: Degrees) -> Degrees:
    """The same angles in -180 <= a < 180, whatever the quadrant correction.

    >>> signed_deg(np.array([330.0, -30.0, 180.0])).tolist()
    [-30.0, -30.0, -180.0]
    """
    wrapped: Degrees = (np.asarray(angle_deg, np.float64) + 180.0) % 360.0 - 180.0
    return wrapped


_Pose = tuple[Degrees, Degrees, Degrees, Mask, Mask]
"""x, y, z of gravity, whether a pose has such angles, and whether it is near a singular point."""


def _perpendicular_asin(first: Degrees, second: Degrees) -> _Pose:
    """Angles between gravity and the yz and xz planes: together they are at most 90 degrees."""
    x, y = _sin(first), _sin(second)
    square = x * x + y * y
    possible = (_from_plane(first) + _from_plane(second) <= 90.0 + ROUNDING_DEG) & _agree(
        first, second
    )
    beyond = np.sqrt(np.maximum(square, 1.0))
    z = np.copysign(np.sqrt(np.maximum(1.0 - square, 0.0)), 90.0 - np.abs(first))
    return x / beyond, y / beyond, z, possible, np.zeros(len(x), np.bool_)


def _perpendicular_atan(first: Degrees, second: Degrees) -> _Pose:
    """Angles of gravity seen along y and along x: atan2(gx, gz) and atan2(gy, gz)."""
    along, across = np.abs(_cos(first)), np.abs(_cos(second))
    x, y, z = _sin(first) * across, _sin(second) * along, along * across
    length = np.sqrt(x * x + y * y + z * z)
    length = np.where(length > _NOWHERE, length, np.nan)
    z = np.copysign(z, 90.0 - np.abs(first))
    singular = (along < _NEAR) | (across < _NEAR)
    return x / length, y / length, z / length, _agree(first, second), singular


def _euler(first: Degrees, second: Degrees) -> _Pose:
    tilted = _sin(first)
    x, y, z = tilted * _sin(second), -tilted * _cos(second), _cos(first)
    return x, y, z, np.ones(len(x), np.bool_), np.abs(tilted) < _NEAR


def _gimbal_x(first: Degrees, second: Degrees) -> _Pose:
    level = _cos(first)
    x, y, z = _sin(first), level * _sin(second), level * _cos(second)
    return x, y, z, np.abs(first) <= 90.0, level < _NEAR


def _gimbal_y(first: Degrees, second: Degrees) -> _Pose:
    y, x, z, possible, singular = _gimbal_x(second, first)
    return x, y, z, possible, singular


_POSES = {
    Angles.PERPENDICULAR_ASIN: _perpendicular_asin,
    Angles.PERPENDICULAR_ATAN: _perpendicular_atan,
    Angles.EULER: _euler,
    Angles.GIMBAL_X: _gimbal_x,
    Angles.GIMBAL_Y: _gimbal_y,
}
_PERPENDICULAR = (Angles.PERPENDICULAR_ASIN, Angles.PERPENDICULAR_ATAN)


def _agree(first: Degrees, second: Degrees) -> Mask:
    """Whether both perpendicular angles say the same of upright and upside down.

    Where one of them is at 90 the z axis is level, and the other one may say either.
    """
    alike = (np.abs(first) > 90.0) == (np.abs(second) > 90.0)
    level = 90.0 - np.maximum(_from_plane(first), _from_plane(second)) <= ROUNDING_DEG
    agree: Mask = alike | level
    return agree


def _from_plane(angle: Degrees) -> Degrees:
    """The angle without its direction and side: 0 to 90."""
    size = np.abs(angle)
    return np.minimum(size, 180.0 - size)


def _circle(sine: Degrees, cosine: Degrees, length: Degrees) -> Degrees:
    return np.where(length > _NOWHERE, _deg(np.arctan2(sine, cosine)), np.nan)


def _sin(angle: Degrees) -> Degrees:
    sine: Degrees = np.sin(np.radians(angle))
    return sine


def _cos(angle: Degrees) -> Degrees:
    cosine: Degrees = np.cos(np.radians(angle))
    return cosine


def _deg(radians: Degrees) -> Degrees:
    degrees: Degrees = np.degrees(radians)
    return degrees
