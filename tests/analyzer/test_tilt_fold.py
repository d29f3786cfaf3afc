"""Both axes of an inclinometer as one pose, through the whole analysis."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from syncline_analyzer import open_session
from syncline_analyzer.folds.angle import pose
from syncline_analyzer.results import TiltRow, TiltTrace
from syncline_schemas.tilt import TiltFlag
from tests.analyzer.traps.script import Script, Told, little, says
from tests.analyzer.traps.test_jn2100 import running, settings, tilt

POSITION_3 = {0: (200, -200), 1: (300, 450), 2: (207, -222), 3: (222, -207)}
"""The excavator's position 3 (manual 8.5) in 0.1 deg, by 2044h."""
S30, C30, S45 = 0.5, np.sqrt(0.75), np.sqrt(0.5)
GRAVITY_3 = [S30 * S45, -S30 * S45, C30]
"""Its direction of gravity: 30 deg of slope, 45 deg from either axis."""


def shown(definition: int, pair: tuple[int, int] | None = None, **more: object) -> Told:
    """A JN2100 that shows one pose for a second.

    The factory quadrant setting turns all into 0..360, but for the lateral angle of gimbal Y.
    """
    read = {"res": 100, "quad": 2, "teach": 2, "zero": 2} | more.pop("read", {})  # type: ignore[operator]
    script = settings(tilt(**more), definition=definition, **read)
    turned = [angle % 3600 for angle in pair or POSITION_3[definition]]
    if definition == 3:
        turned[1] = POSITION_3[3][1]
    return running(script, 0, 1000, *turned).told()


def row(told: Told) -> TiltRow:
    assert len(told.analysis.tilts) == 1
    return told.analysis.tilts[0]


def trace(told: Told, index: int = 0x6010) -> TiltTrace:
    return next(each for each in told.analysis.tilt_data if each.object >> 8 == index)


def gravity(told: Told) -> NDArray[np.float64]:
    """The one direction of gravity of a pose that is held."""
    found = trace(told).gravity
    assert np.ptp(found, axis=0) == pytest.approx(0)
    first: NDArray[np.float64] = found[0]
    return first


@pytest.mark.parametrize("definition", [1, 2, 3])
def test_every_definition_tells_the_same_pose(definition: int) -> None:
    told = shown(definition)
    assert gravity(told) == pytest.approx(GRAVITY_3, abs=0.002)
    assert row(told).slope_max_deg == pytest.approx(30, abs=0.1)
    assert row(told).samples == row(told).converted == 50
    assert row(told).assumed == row(told).reasons == []


def test_perpendicular_angles_are_no_pose_without_the_users_choice() -> None:
    told = shown(0)
    assert np.isnan(trace(told).gravity).all()
    assert trace(told).longitudinal_deg[0] == pytest.approx(20)
    assert row(told).converted == 0
    assert [says(reason, "perp_formula", "asin", "atan") for reason in row(told).reasons] == [True]


@pytest.mark.parametrize(
    ("formula", "slope"),
    [("asin", np.degrees(np.arcsin(np.hypot(0.342020, 0.342020)))),
     ("atan", np.degrees(np.arctan(np.hypot(0.363970, 0.363970))))],
)  # fmt: skip
def test_perpendicular_angles_by_the_formula_that_the_user_chose(
    formula: str, slope: float
) -> None:
    told = shown(0, overrides=f"perp_formula = '{formula}'")
    assert row(told).angles == f"perpendicular_{formula}"
    assert row(told).slope_max_deg == pytest.approx(slope, abs=0.01)
    assert row(told).upright_assumed == 0


def test_upright_is_assumed_where_the_quadrant_setting_is_not_known() -> None:
    told = running(tilt(overrides="perp_formula = 'asin'\nres = 100"), 0, 1000).told()
    assert row(told).upright_assumed == row(told).samples
    assert row(told).assumed == ["angle_def", "quad", "reference"]


def test_a_zero_point_makes_angles_no_pose() -> None:
    """The offsets are subtracted from the angles (manual 9.3), which is no turn of the frame."""
    script = settings(tilt(), res=100, quad=2, definition=2, teach=2, zero=2)
    script.heartbeat(0, 4000).sync(1, 4000).write(2000, 0x2046, 0, 1, size=1)
    script.pdo(2, 2000, 20, lambda _: (300, 250), bits=16)
    told = script.pdo(2002, 4000, 20, lambda _: (0, 0), bits=16).told()
    assert (row(told).samples, row(told).converted) == (200, 100)
    assert [says(reason, "zero") for reason in row(told).reasons] == [True]
    assert np.isfinite(trace(told).gravity).all(axis=1).tolist() == [True] * 100 + [False] * 100


def test_a_taught_frame_is_a_frame() -> None:
    told = shown(2, read={"teach": 1})
    assert row(told).converted == row(told).samples
    assert {trace(told).settings[number].reference for number in trace(told).setting} == {
        "relative"
    }


def test_a_definition_that_changes_is_followed() -> None:
    script = settings(tilt(), res=100, quad=2, definition=2, teach=2, zero=2)
    script.heartbeat(0, 4000).sync(1, 4000).write(2000, 0x2044, 0, 1, size=1)
    script.pdo(2, 2000, 20, lambda _: (207, 3600 - 222), bits=16)
    told = script.pdo(2002, 4000, 20, lambda _: POSITION_3[1], bits=16).told()
    assert row(told).converted >= 198
    assert row(told).definition == "Euler"
    known = trace(told).gravity[np.isfinite(trace(told).gravity[:, 0])]
    assert known == pytest.approx(np.tile(GRAVITY_3, (len(known), 1)), abs=0.002)


def test_an_unknown_definition_is_no_pose() -> None:
    told = shown(7, (200, 100))
    assert row(told).converted == 0
    assert [says(reason, "not known") for reason in row(told).reasons] == [True]


def test_a_pose_at_a_singular_point_is_told() -> None:
    told = shown(2, (900, 1234))
    assert row(told).singular == row(told).converted == row(told).samples
    assert gravity(told) == pytest.approx([1, 0, 0], abs=1e-9)


def test_angles_that_no_pose_has_are_counted() -> None:
    told = shown(0, (600, 600), overrides="perp_formula = 'asin'")
    assert (row(told).impossible, row(told).converted) == (50, 0)
    assert row(told).slope_max_deg is None


def test_16_bits_that_repeat_tell_no_pose() -> None:
    told = shown(2, (20_000, 100), read={"res": 1})
    assert row(told).converted == 0


def test_axes_read_one_after_the_other_are_a_pose() -> None:
    script = settings(tilt(), res=100, quad=2, definition=2, teach=2, zero=2).heartbeat(0, 3000)
    for at in range(0, 3000, 500):
        step = at // 500 % 2
        script.read(at, 0x6010, 0, 207 + step, size=2).read(at + 20, 0x6020, 0, 3378 - step, size=2)
    told = script.told()
    assert row(told).samples == row(told).converted == 6
    assert trace(told).gravity == pytest.approx(np.tile(GRAVITY_3, (6, 1)), abs=0.004)
    assert set(trace(told).flags.tolist()) == {int(TiltFlag.APART)}


def test_axes_of_different_moments_are_no_pose() -> None:
    script = settings(tilt(), res=100, quad=2, definition=2).heartbeat(0, 3000)
    told = script.read(0, 0x6010, 0, 207, size=2).read(1000, 0x6020, 0, 3378, size=2).told()
    assert not told.analysis.tilts
    assert not told.analysis.tilt_data


def test_both_pdos_are_told_apart() -> None:
    """TPDO1 and TPDO2 show the same in different steps."""
    script = settings(tilt(), res=100, quad=2, definition=2).heartbeat(0, 1000).sync(1, 1000)
    script.pdo(2, 1000, 20, lambda _: (207, 3378), bits=16)
    told = script.pdo(3, 1000, 20, lambda _: (207, 3378), base=0x280).told()
    assert [each.object >> 8 for each in told.analysis.tilts] == [0x6010, 0x6110]
    assert trace(told, 0x6110).gravity == pytest.approx(trace(told, 0x6010).gravity)
    assert not trace(told).flags.any()


@pytest.mark.parametrize("batch", [1, 7, 1000])
def test_batches_do_not_change_the_result(batch: int) -> None:
    script = settings(tilt(), res=100, quad=2, definition=2).heartbeat(0, 1000).sync(1, 1000)
    script.pdo(2, 1000, 20, lambda k: (10 * k, 5 * k), bits=16)
    whole, cut = script.told(), script.told(batch)
    assert row(cut) == row(whole)
    assert np.array_equal(trace(cut).gravity, trace(whole).gravity)


def test_a_long_tilt_is_thinned_and_keeps_its_steepest_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pose, "MAX_POSES", 20)
    script = settings(tilt(), res=100, quad=2, definition=2).heartbeat(0, 9000).sync(1, 9000)
    told = script.pdo(2, 9000, 20, lambda k: (450 if k == 203 else 10, 0), bits=16).told()
    assert row(told).samples == 450
    assert len(trace(told).t_ns) <= 20
    assert row(told).slope_max_deg == pytest.approx(45)
    assert row(told).slope_max_seq in trace(told).seq


def test_an_unknown_inclinometer_of_cia_410_needs_the_formula() -> None:
    """Its profile says nothing of how both slopes belong together."""
    script = Script(None, 10).heartbeat(0, 1000).sync(1, 1000)
    script.read(-9, 0x1000, 0, 0x0002019A).read(-7, 0x6000, 0, 100, size=2)
    script.read(-5, 0x1A00, 1, 0x60100010).read(-3, 0x1A00, 2, 0x60200010)
    script.read(-2, 0x1A00, 0, 2, size=1)
    told = script.pdo(2, 1000, 20, lambda _: (200, 0), bits=16).told()
    assert (row(told).samples, row(told).converted) == (50, 0)


def test_a_session_gives_the_pose_by_every_definition(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    frames = [
        f"60A#40{little(index, bits=16)}0000000000"[:20].ljust(20, "0")
        + f"|58A#4F{little(index, bits=16)}00{value:02X}000000"
        for index, value in ((0x2044, 2), (0x2040, 2), (0x2046, 2), (0x2042, 2))
    ]
    lines = [part for pair in frames for part in pair.split("|")]
    lines += ["60A#4000600000000000", "58A#4B00600064000000"]
    lines += [f"18A#{little(207, 3378, bits=16)}"] * 3
    stamped = [f"({1_700_000_000 + k / 100:.6f}) can0 {line}" for k, line in enumerate(lines)]
    log = tmp_path / "tilt.log"
    log.write_text("\n".join(stamped) + "\n", encoding="utf-8")
    session = open_session(log, devices={10: "jn2100"})
    found = session.tilt(10)
    assert len(found) == 3
    last = found.iloc[-1]
    assert last[["gravity_x", "gravity_y", "gravity_z"]].tolist() == pytest.approx(
        GRAVITY_3, abs=0.002
    )
    for name, value in {
        "slope_deg": 30.0,
        "euler_slope_deg": 30.0,
        "euler_direction_deg": 45.0,
        "gimbal_x_lateral_deg": -22.2,
        "gimbal_y_longitudinal_deg": 22.2,
        "perpendicular_asin_lateral_deg": -20.7,
        "perpendicular_atan_lateral_deg": -22.2,
    }.items():
        assert last[name] == pytest.approx(value, abs=0.1), name
    assert not last["singular"]
    assert last["reason"] == ""
    assert session.tilts()["converted"].tolist() == [3]
    assert len(session.tilt(11)) == 0
    assert list(session.tilt(11).columns) == list(found.columns)
