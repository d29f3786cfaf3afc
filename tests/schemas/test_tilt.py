"""Tilt geometry against the manual's excavator, and against rotation matrices."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from syncline_schemas.tilt import (
    Angles,
    TiltFlag,
    angles_of,
    angles_of_geometry,
    gravity_of,
    pose_of,
    signed_deg,
    slope_deg,
)

Floats = NDArray[np.float64]
PLAIN = (Angles.EULER, Angles.GIMBAL_X, Angles.GIMBAL_Y)
"""Definitions that tell every pose."""

EXCAVATOR: dict[int, dict[str, tuple[int, int | None]]] = {
    1: {"perpendicular": (0, 0), "euler": (0, None), "gimbal_x": (0, 0), "gimbal_y": (0, 0)},
    2: {"perpendicular": (0, -30), "euler": (30, 0), "gimbal_x": (0, -30), "gimbal_y": (0, -30)},
    3: {
        "perpendicular": (20, -20),
        "euler": (30, 45),
        "gimbal_x": (20, -22),
        "gimbal_y": (22, -20),
    },
    4: {"perpendicular": (30, 0), "euler": (30, 90), "gimbal_x": (30, 0), "gimbal_y": (30, 0)},
    5: {"perpendicular": (30, 0), "euler": (30, 90), "gimbal_x": (30, 0), "gimbal_y": (30, 0)},
    6: {"perpendicular": (0, 30), "euler": (30, 180), "gimbal_x": (0, 30), "gimbal_y": (0, 30)},
}
"""The table of positions, JN2100 manual 8.5: (longitudinal, lateral), None where undefined."""


def one(angles: Angles, first: float, second: float, **more: Any) -> Floats:
    gravity: Floats = gravity_of(angles, np.array([first]), np.array([second]), **more).gravity[0]
    return gravity


def flags(angles: Angles, first: float, second: float, **more: Any) -> TiltFlag:
    found = gravity_of(angles, np.array([first]), np.array([second]), **more).flags[0]
    return TiltFlag(int(found))


def shown(gravity: Floats, angles: Angles) -> tuple[float, float]:
    found = angles_of(gravity[None], angles)
    return float(found.first_deg[0]), float(found.second_deg[0])


def turn(axis: str, degrees: float) -> Floats:
    """Right-handed rotation matrix about an axis."""
    s, c = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    rows = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return np.array(rows[axis], np.float64)


def matrix(quaternion: Floats) -> Floats:
    """Rotation matrix of a quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def upward(pose: Floats) -> Floats:
    """Which way is up for a sensor in a pose, in its own frame."""
    up: Floats = pose.T @ np.array([0.0, 0.0, 1.0])
    return up


MODELS = {
    Angles.GIMBAL_X: lambda first, second: turn("y", -first) @ turn("x", second),
    Angles.GIMBAL_Y: lambda first, second: turn("x", second) @ turn("y", -first),
    Angles.EULER: lambda first, second: turn("x", -first) @ turn("z", -second),
}
"""The manual's successive turns, each about the axis as turned before (8.2, 8.3, 8.4).

A positive longitudinal angle raises x and a positive lateral one y, with which the manual's table
comes out; turns about y and z are then left-handed."""


# -- the excavator of the manual


@pytest.mark.parametrize("position", EXCAVATOR)
@pytest.mark.parametrize("source", PLAIN)
@pytest.mark.parametrize("target", [*PLAIN, Angles.PERPENDICULAR_ASIN])
def test_excavator(position: int, source: Angles, target: Angles) -> None:
    """Every cell gives every other one; the manual prints whole degrees, and cuts 20.7 to 20."""
    row = EXCAVATOR[position]
    first, second = row[source]
    wanted = row["perpendicular" if target is Angles.PERPENDICULAR_ASIN else target.value]
    got = shown(one(source, first or 0, second or 0), target)
    for value, printed in zip(got, wanted, strict=True):
        if printed is None:
            assert np.isnan(value)
        else:
            assert signed_deg(np.array([value - printed]))[0] == pytest.approx(0, abs=1.5)


@pytest.mark.parametrize(
    ("heading", "target", "wanted"),
    [
        (0, Angles.GIMBAL_X, (0.0, -30.0)),
        (45, Angles.PERPENDICULAR_ASIN, (20.70, -20.70)),
        (45, Angles.PERPENDICULAR_ATAN, (22.21, -22.21)),
        (45, Angles.GIMBAL_X, (20.70, -22.21)),
        (45, Angles.GIMBAL_Y, (22.21, -20.70)),
        (135, Angles.GIMBAL_X, (20.70, 22.21)),
        (180, Angles.GIMBAL_Y, (0.0, 30.0)),
    ],
)
def test_excavator_to_the_hundredth(
    heading: float, target: Angles, wanted: tuple[float, float]
) -> None:
    """As recomputed in the device sheet, 6.2."""
    assert shown(one(Angles.EULER, 30, heading), target) == pytest.approx(wanted, abs=0.006)


def test_teach_example_comes_out_with_atan_only() -> None:
    """Manual 9.4: -13.2/-29.3 is taught as level, then -45.5/-29.5 must read -30/0 (sheet 6.4)."""

    def after_teach(angles: Angles) -> tuple[float, float]:
        level, turned = one(angles, -13.2, -29.3), one(angles, -45.5, -29.5)
        along = np.array([1.0, 0.0, 0.0]) - level[0] * level
        along /= np.linalg.norm(along)
        frame = np.stack([along, np.cross(level, along), level])
        return shown(frame @ turned, angles)

    assert after_teach(Angles.PERPENDICULAR_ATAN) == pytest.approx((-29.97, -0.15), abs=0.03)
    assert after_teach(Angles.PERPENDICULAR_ASIN) == pytest.approx((-32.6, -10.1), abs=0.1)


# -- an independent model

slopes = st.floats(-89, 89)
circle = st.floats(-180, 180)


@pytest.mark.parametrize("angles", PLAIN)
@given(inner=slopes, outer=circle)
def test_rotation_matrices_agree(angles: Angles, inner: float, outer: float) -> None:
    """The manual's successive turns: gravity as exported is the vertical seen from the sensor."""
    pair = (outer, inner) if angles is Angles.GIMBAL_Y else (inner, outer)
    up = upward(MODELS[angles](*pair))
    assert one(angles, *pair) == pytest.approx(up, abs=1e-9)


@pytest.mark.parametrize("angles", PLAIN)
@given(inner=slopes, outer=circle)
def test_pose_is_that_of_the_turns_but_for_the_heading(
    angles: Angles, inner: float, outer: float
) -> None:
    pair = (outer, inner) if angles is Angles.GIMBAL_Y else (inner, outer)
    model = MODELS[angles](*pair)
    pose = matrix(pose_of(one(angles, *pair)[None])[0])
    assert upward(pose) == pytest.approx(upward(model), abs=1e-6)
    heading = pose @ model.T
    assert heading[2] == pytest.approx([0, 0, 1], abs=1e-6)
    assert heading[:, 2] == pytest.approx([0, 0, 1], abs=1e-6)


@given(st.floats(-1, 1), circle)
def test_a_pose_turns_its_own_gravity_into_the_vertical(height: float, around: float) -> None:
    """The exported vector and the pose of the 3D view are not mirrored against one another."""
    across = np.sqrt(1 - height * height)
    angle = np.radians(around)
    gravity = np.array([across * np.cos(angle), across * np.sin(angle), height])
    pose = matrix(pose_of(gravity[None])[0])
    assert pose @ gravity == pytest.approx([0, 0, 1], abs=1e-4)
    assert np.linalg.det(pose) == pytest.approx(1)


@pytest.mark.parametrize(("pair", "raised"), [((20, 0), 0), ((0, 20), 1)])
def test_a_positive_angle_raises_its_axis(pair: tuple[float, float], raised: int) -> None:
    pose = matrix(pose_of(one(Angles.GIMBAL_X, *pair)[None])[0])
    tips = pose[2, :2]
    assert tips[raised] == pytest.approx(np.sin(np.radians(20)))
    assert tips[1 - raised] == pytest.approx(0)


def test_pose_upside_down_is_a_pose() -> None:
    assert pose_of(np.array([[0.0, 0.0, -1.0]])).tolist() == [[1.0, 0.0, 0.0, 0.0]]


@given(st.floats(-1, 1), circle)
def test_perpendicular_angles_are_those_to_the_planes(height: float, around: float) -> None:
    """Angle between a vector and a plane, by its projection into the plane."""
    across = np.sqrt(1 - height * height)
    gravity = np.array([across * np.cos(around), across * np.sin(around), height])
    for axis, value in enumerate(shown(gravity, Angles.PERPENDICULAR_ASIN)):
        inside = gravity * (np.arange(3) != axis)
        length = np.linalg.norm(inside)
        wanted = np.degrees(np.arccos(np.clip(gravity @ inside / length, -1, 1))) if length else 90
        assert abs(value) == pytest.approx(wanted, abs=1e-5)
        assert value == 0 or np.sign(value) == np.sign(gravity[axis])


# -- properties


@pytest.mark.parametrize("angles", PLAIN)
@given(inner=st.floats(0.01, 89), outer=circle)
def test_angles_come_back(angles: Angles, inner: float, outer: float) -> None:
    pair = (outer, inner) if angles is Angles.GIMBAL_Y else (inner, outer)
    back = np.array(shown(one(angles, *pair), angles))
    assert signed_deg(back - pair) == pytest.approx([0, 0], abs=1e-6)


@given(st.floats(-44, 44), st.floats(-44, 44))
def test_perpendicular_angles_come_back(first: float, second: float) -> None:
    for angles in (Angles.PERPENDICULAR_ASIN, Angles.PERPENDICULAR_ATAN):
        assert shown(one(angles, first, second), angles) == pytest.approx((first, second), abs=1e-6)


@given(st.floats(-89, 89))
def test_a_turn_about_one_axis_reads_the_same_in_all_but_euler(tilt: float) -> None:
    for pair in ((tilt, 0.0), (0.0, tilt)):
        seen = [shown(one(Angles.GIMBAL_X, *pair), angles) for angles in Angles]
        for angles, got in zip(Angles, seen, strict=True):
            if angles is not Angles.EULER:
                assert got == pytest.approx(pair, abs=1e-6)


@given(circle, circle)
def test_quadrant_correction_makes_no_difference(first: float, second: float) -> None:
    for angles in Angles:
        plain = one(angles, first, second)
        assert one(angles, first % 360, second % 360) == pytest.approx(plain, nan_ok=True, abs=1e-6)


@given(circle, circle)
def test_gravity_is_a_unit_vector_or_nothing(first: float, second: float) -> None:
    for angles in Angles:
        length = np.linalg.norm(one(angles, first, second))
        assert np.isnan(length) or length == pytest.approx(1)


@given(slopes, circle)
def test_ranges_are_those_of_the_sheet(inner: float, outer: float) -> None:
    gravity = one(Angles.GIMBAL_X, inner, outer)[None]
    limits = {
        Angles.PERPENDICULAR_ASIN: ((-90, 90), (-90, 90)),
        Angles.PERPENDICULAR_ATAN: ((-180, 180), (-180, 180)),
        Angles.EULER: ((0, 180), (0, 360)),
        Angles.GIMBAL_X: ((-90, 90), (-180, 180)),
        Angles.GIMBAL_Y: ((-180, 180), (-90, 90)),
    }
    for angles, (first, second) in limits.items():
        found = angles_of(gravity, angles)
        for value, (low, high) in ((found.first_deg[0], first), (found.second_deg[0], second)):
            assert np.isnan(value) or low <= value <= high


def test_slope_is_the_angle_to_the_vertical() -> None:
    gravity = np.array([[0, 0, 1], [0.5, 0, np.sqrt(0.75)], [0, -1, 0], [0, 0, -1]])
    assert slope_deg(gravity).tolist() == pytest.approx([0, 30, 90, 180])


# -- where there is no conversion


def test_perpendicular_angles_mean_nothing_until_the_user_chose_a_formula() -> None:
    assert angles_of_geometry("perpendicular") is None
    assert angles_of_geometry("perpendicular", "none") is None
    assert angles_of_geometry("perpendicular", "atan") is Angles.PERPENDICULAR_ATAN
    assert angles_of_geometry("gimbal_y", "asin") is Angles.GIMBAL_Y
    assert angles_of_geometry("") is None


@pytest.mark.parametrize(
    ("angles", "pair"),
    [
        (Angles.EULER, (0, 123)),
        (Angles.EULER, (180, 7)),
        (Angles.EULER, (0.4, 300)),
        (Angles.GIMBAL_X, (90, 12)),
        (Angles.GIMBAL_X, (-89.5, 12)),
        (Angles.GIMBAL_Y, (12, 90)),
        (Angles.PERPENDICULAR_ATAN, (90, 0)),
    ],
)
def test_singular_poses_are_told_and_have_a_gravity(
    angles: Angles, pair: tuple[float, float]
) -> None:
    """One of the angles is meaningless there, the pose is not."""
    assert flags(angles, *pair) & TiltFlag.SINGULAR
    assert np.isfinite(one(angles, *pair)).all()


@pytest.mark.parametrize(
    ("angles", "pair"),
    [
        (Angles.EULER, (90, 0)),
        (Angles.EULER, (3, 0)),
        (Angles.GIMBAL_X, (0, 90)),
        (Angles.GIMBAL_X, (80, 170)),
        (Angles.GIMBAL_Y, (90, 0)),
        (Angles.PERPENDICULAR_ASIN, (90, 0)),
    ],
)
def test_other_poses_are_not_singular(angles: Angles, pair: tuple[float, float]) -> None:
    assert not flags(angles, *pair) & (TiltFlag.SINGULAR | TiltFlag.IMPOSSIBLE)


def test_meaningless_angle_is_flagged_in_the_definition_that_has_it() -> None:
    level, nose_up, side = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    singular = {a: [bool(angles_of(g[None], a).singular[0]) for g in (level, nose_up, side)]
                for a in Angles}  # fmt: skip
    assert singular == {
        Angles.PERPENDICULAR_ASIN: [False, False, False],
        Angles.PERPENDICULAR_ATAN: [False, True, True],
        Angles.EULER: [True, False, False],
        Angles.GIMBAL_X: [False, True, False],
        Angles.GIMBAL_Y: [False, False, True],
    }
    assert np.isnan(shown(level, Angles.EULER)[1])
    assert np.isnan(shown(nose_up, Angles.GIMBAL_X)[1])
    assert np.isnan(shown(side, Angles.GIMBAL_Y)[0])


@pytest.mark.parametrize(
    ("angles", "pair"),
    [
        (Angles.GIMBAL_X, (120, 0)),
        (Angles.GIMBAL_Y, (0, -135)),
        (Angles.PERPENDICULAR_ASIN, (60, 60)),
        (Angles.PERPENDICULAR_ASIN, (120, 10)),
        (Angles.PERPENDICULAR_ATAN, (120, 10)),
    ],
)
def test_angles_that_no_pose_has(angles: Angles, pair: tuple[float, float]) -> None:
    assert flags(angles, *pair, full_circle=True) == TiltFlag.IMPOSSIBLE
    assert np.isnan(one(angles, *pair)).all()


def test_rounded_angles_at_the_edge_are_possible() -> None:
    """Together they are a little above 90 degrees, because of the rounding or of noise."""
    edge = one(Angles.PERPENDICULAR_ASIN, 45.4, 45.1)
    assert edge == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0], abs=0.01)
    assert np.linalg.norm(edge) == pytest.approx(1, abs=1e-12)


def test_level_z_axis_hides_the_direction_from_atan() -> None:
    """Both angles are 90 whatever the direction: nothing can be told, and nothing is wrong."""
    assert np.isnan(one(Angles.PERPENDICULAR_ATAN, 90, 90)).all()
    assert flags(Angles.PERPENDICULAR_ATAN, 90, 90, full_circle=True) == TiltFlag.SINGULAR


def test_perpendicular_angles_tell_upside_down_by_the_quadrant_correction_only() -> None:
    for angles in (Angles.PERPENDICULAR_ASIN, Angles.PERPENDICULAR_ATAN):
        assert flags(angles, 10, -20) == TiltFlag.UPRIGHT_ASSUMED
        assert flags(angles, 10, -20, full_circle=True) == TiltFlag(0)
        assert one(angles, 10, -20)[2] > 0
        assert one(angles, 170, -160, full_circle=True)[2] < 0
    assert shown(one(Angles.GIMBAL_X, 10, 200), Angles.PERPENDICULAR_ATAN)[1] < -90


def test_what_is_not_known_stays_unknown() -> None:
    for angles in Angles:
        assert np.isnan(one(angles, np.nan, 10)).all()
        assert flags(angles, 10, np.nan) == TiltFlag(0)
        assert gravity_of(angles, np.zeros(0), np.zeros(0)).gravity.shape == (0, 3)
