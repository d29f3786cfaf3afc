"""Counts to angles by the rules of the device sheets' section 6."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas.devices import load_device, standard_device
from syncline_schemas.measurement import (
    EncoderScale,
    Lookup,
    TiltScale,
    ambiguous_rpm,
    count_steps,
    encoder_angles,
    encoder_scale,
    position_objects,
    tilt_axis,
    tilt_deg,
    tilt_scale,
    tilt_steps,
    unwrapped,
)


def lookup(known: dict[int, int] | None = None, assumed: dict[int, int] | None = None) -> Lookup:
    def look(index: int, sub: int) -> tuple[int, bool] | None:
        if sub == 0 and index in (known or {}):
            return (known or {})[index], False
        return ((assumed or {})[index], True) if sub == 0 and index in (assumed or {}) else None

    return look


def scale(name: str, known: dict[int, int] | None = None, **overrides: object) -> EncoderScale:
    device = load_device(name)
    defaults = {
        index: value
        for index in (0x6000, 0x6001, 0x6002, 0x6501, 0x6502)
        if isinstance(value := device.default(index, 0, 1), int)
    }
    return encoder_scale(device, lookup(known, defaults), overrides)


def test_a_lir_without_evidence_has_no_scale() -> None:
    unknown = scale("lir-da158")
    assert (unknown.counts_per_turn, unknown.range_counts) == (None, None)
    angles = encoder_angles(np.array([5]), unknown)
    assert angles.position.tolist() == [5]
    assert np.isnan(angles.angle_deg).all()


def test_a_lir_that_was_read() -> None:
    read = scale("lir-da158", {0x6000: 1, 0x6001: 131072, 0x6002: 131072})
    assert (read.counts_per_turn, read.range_counts, read.clockwise) == (131072, 131072, False)
    assert read.assumed == ()
    assert read.max_rpm == 3000


def test_the_range_follows_from_the_turns_where_it_was_not_read() -> None:
    read = scale("lir-da158", {0x6000: 0, 0x6001: 8192, 0x6502: 4096})
    assert (read.range_counts, read.assumed) == (8192 * 4096, ())
    guessed = scale("lir-da158", {0x6000: 0, 0x6001: 8192})
    assert (guessed.range_counts, guessed.assumed) == (8192, ("range",))


def test_the_user_has_the_word_where_the_bus_told_nothing() -> None:
    told = scale("lir-da158", cpr=1024, turns=16, direction="ccw", max_rpm=100)
    assert (told.counts_per_turn, told.range_counts, told.clockwise) == (1024, 16384, False)
    assert (told.assumed, told.max_rpm) == ((), 100)
    assert scale("lir-da158", {0x6001: 131072}, cpr="auto").counts_per_turn == 131072


def test_numbers_that_the_bus_told_count_more_than_those_of_the_user() -> None:
    told = scale("lir-da158", {0x6001: 8192, 0x6502: 4096}, cpr=4096, turns=16, range=77)
    assert (told.counts_per_turn, told.range_counts) == (8192, 8192 * 4096)
    assert scale("haomiao-38", {0x6000: 0}, cpr=4096).counts_per_turn == 8192
    assert scale("haomiao-38", {0x6001: 4096}, cpr=4096).counts_per_turn == 4096, "assumed only"
    assert tilt({0x6000: 10, 0x2040: 1}, res=100, quad=2).deg_per_count == pytest.approx(0.01)
    assert tilt({0x6000: 10, 0x2040: 1}, res=100, quad=2).axes[0].high_deg == 180


HARDWARE = {0x6001: 4096, 0x6002: 4096 * 4096, 0x6501: 8192, 0x6502: 4096}
"""Programmed to half the counts per turn that the hardware has."""


@pytest.mark.parametrize(
    ("known", "cpr", "total", "assumed"),
    [
        (HARDWARE | {0x6000: 0}, 8192, 8192 * 4096, ()),
        (HARDWARE | {0x6000: 4}, 4096, 4096 * 4096, ()),
        (HARDWARE | {0x6000: 5}, 4096, 4096 * 4096, ()),
        ({0x6000: 0, 0x6001: 4096, 0x6002: 4096 * 16, 0x6501: 8192}, 8192, 8192 * 16, ("range",)),
        ({0x6000: 0, 0x6001: 4096, 0x6002: 4096 * 16}, 4096, 4096 * 16, ("cpr", "range")),
        ({0x6001: 4096, 0x6002: 4096 * 16}, 4096, 4096 * 16, ("scaling", "direction")),
        (HARDWARE, 4096, 4096 * 4096, ("cpr", "range", "scaling", "direction")),
        (HARDWARE | {0x6501: 4096}, 4096, 4096 * 4096, ("direction",)),
    ],
)
def test_scaling_of_any_encoder_of_cia_406(
    known: dict[int, int], cpr: int, total: int, assumed: tuple[str, ...]
) -> None:
    """While 6000h bit 2 is 0 the hardware counts (6501h, 6502h), not 6001h and 6002h."""
    read = encoder_scale(standard_device(406), lookup(known))
    assert (read.counts_per_turn, read.range_counts, read.assumed) == (cpr, total, assumed)


def test_the_user_says_whether_the_scaling_is_on() -> None:
    for choice, cpr in (("on", 4096), ("off", 8192)):
        read = encoder_scale(standard_device(406), lookup(HARDWARE), {"scaling": choice})
        assert (read.counts_per_turn, read.range_counts) == (cpr, cpr * 4096)
        assert read.assumed == ("direction",)


@pytest.mark.parametrize(
    ("known", "cpr", "assumed"),
    [
        ({}, 8192, ("cpr", "range", "scaling", "direction")),
        ({0x6001: 4096}, 8192, ("cpr", "range", "scaling", "direction")),
        ({0x6001: 8192, 0x6502: 4096}, 8192, ("direction",)),
        ({0x6501: 8192, 0x6502: 4096}, 8192, ("scaling", "direction")),
        ({0x6000: 0, 0x6502: 4096}, 8192, ()),
        ({0x6000: 0, 0x6001: 4096}, 8192, ("range",)),
        ({0x6000: 4, 0x6001: 4096, 0x6502: 4096}, 4096, ()),
        ({0x6000: 5, 0x6502: 4096}, 8192, ("cpr", "range")),
    ],
)
def test_scaling_of_the_haomiao_38(
    known: dict[int, int], cpr: int, assumed: tuple[str, ...]
) -> None:
    read = scale("haomiao-38", known)
    assert (read.counts_per_turn, read.range_counts) == (cpr, cpr * 4096)
    assert read.assumed == assumed


def test_a_scale_of_zero_is_no_scale() -> None:
    zero = scale("lir-da158", {0x6001: 0, 0x6002: 0})
    assert (zero.counts_per_turn, zero.range_counts) == (None, None)


@settings(max_examples=100)
@given(
    st.integers(1, 1 << 25),
    st.lists(st.integers(-1000, 1000), max_size=50),
    st.integers(1001, 1 << 20),
)
def test_unwrapping_finds_every_motion_of_less_than_half_the_range(
    start: int, steps: list[int], half: int
) -> None:
    truth = start + np.concatenate(([0], np.cumsum(np.array(steps, np.int64))))
    measured = unwrapped(truth % (2 * half), 2 * half)
    assert (np.diff(measured) == np.diff(truth)).all()
    assert measured[0] == start % (2 * half)


def test_the_step_of_half_a_range_is_positive() -> None:
    assert count_steps(np.array([0, 8, 0]), 16).tolist() == [8, 8]
    assert count_steps(np.array([], np.int64), 16).tolist() == []
    assert unwrapped(np.array([], np.int64), 16).tolist() == []


def test_limits_of_the_sheet() -> None:
    assert ambiguous_rpm(131072, 131072, 0.515) == pytest.approx(58.25, abs=0.01)
    assert ambiguous_rpm(1 << 25, 8192, 0.1) == pytest.approx(300 * 4096)


def tilt(known: dict[int, int], **overrides: object) -> TiltScale:
    defaults = {0x6000: 100, 0x2040: 2, 0x2044: 0}
    return tilt_scale(load_device("jn2100"), lookup(known, defaults), overrides)


@pytest.mark.parametrize(
    ("known", "axis", "unsigned", "ambiguous", "low_high"),
    [
        ({0x6000: 100, 0x2040: 2}, 0, False, False, (0, 360)),
        ({0x6000: 10, 0x2040: 2}, 0, True, False, (0, 360)),
        ({0x6000: 10, 0x2040: 1}, 0, False, False, (-180, 180)),
        ({0x6000: 1, 0x2040: 2}, 0, False, True, (0, 360)),
        ({0x6000: 10, 0x2040: 2, 0x2044: 1}, 0, False, False, (-90, 180)),
        ({0x6000: 10, 0x2040: 2, 0x2044: 1}, 1, True, False, (0, 360)),
        ({0x6000: 10, 0x2040: 0, 0x2044: 1}, 1, True, False, (0, 360)),
        ({0x6000: 10, 0x2040: 2, 0x2044: 2}, 0, False, False, (-90, 90)),
        ({0x6000: 10, 0x2040: 2, 0x2044: 2}, 1, True, False, (0, 360)),
        ({0x6000: 10, 0x2040: 2, 0x2044: 3}, 1, False, False, (-90, 90)),
        ({0x6000: 10, 0x2040: 0, 0x2044: 0}, 0, False, False, (-90, 90)),
        ({0x6000: 10, 0x2040: 0, 0x2044: 0}, 1, False, False, (-90, 90)),
        ({0x6000: 10, 0x2040: 0, 0x2044: 2}, 1, False, False, (-180, 180)),
        ({0x6000: 10, 0x2040: 0, 0x2044: 3}, 0, False, False, (-180, 180)),
        ({0x6000: 10, 0x2040: 1, 0x2044: 1}, 1, False, False, (-180, 180)),
    ],
)
def test_how_sixteen_bits_are_read(
    known: dict[int, int], axis: int, unsigned: bool, ambiguous: bool, low_high: tuple[int, int]
) -> None:
    found = tilt(known).axes[axis]
    assert (found.unsigned_16, found.ambiguous_16) == (unsigned, ambiguous)
    assert (found.low_deg, found.high_deg) == low_high


def test_which_angles_an_axis_can_show() -> None:
    full, half, quarter = (tilt({0x2040: quad}).axes[0] for quad in (2, 1, 0))
    assert full.outside(np.array([-0.1, 0, 359.9, 360])).tolist() == [True, False, False, True]
    assert half.outside(np.array([-180.1, -180, 180, 180.1])).tolist() == [True, False, False, True]
    assert quarter.outside(np.array([-90.1, -90, 90, 120])).tolist() == [True, False, False, True]


def test_sixteen_bits_that_the_user_calls_unsigned_are() -> None:
    axis = tilt({0x6000: 10, 0x2040: 1}, i16_unsigned="yes").axes[0]
    raw = np.array([35000 - 65536, -1, 1000])
    assert tilt_deg(raw, 16, 0.01, axis).tolist() == pytest.approx([350.0, 655.35, 10.0])
    assert tilt_deg(raw, 32, 0.01, axis).tolist() == pytest.approx([-305.36, -0.01, 10.0])
    assert axis.of_bits(16).outside(np.array([350.0, 655.35])).tolist() == [False, True]
    assert axis.of_bits(32).outside(np.array([-10.0, 350.0])).tolist() == [False, True]


def test_an_inclinometer_of_no_known_device_may_show_half_a_circle() -> None:
    axis = tilt_scale(standard_device(410), lookup({0x6000: 10})).axes[0]
    assert (axis.low_deg, axis.high_deg) == (-180, 180)


def test_what_was_assumed_of_an_inclinometer() -> None:
    assert tilt({}).assumed == ("res", "quad", "angle_def")
    assert tilt({}).deg_per_count == pytest.approx(0.1)
    assert tilt({0x6000: 10}, quad=1, angle_def=1).assumed == ()
    assert tilt({0x2044: 1}).definition == "Euler"
    assert tilt({0x2044: 1}).axes[1].name == "direction of the slope"


def test_thirty_two_bits_are_never_read_unsigned() -> None:
    axis = tilt({0x6000: 10, 0x2040: 2}).axes[0]
    assert tilt_deg(np.array([-1]), 32, 0.01, axis).tolist() == pytest.approx([-0.01])
    assert tilt_deg(np.array([-1]), 16, 0.01, axis).tolist() == pytest.approx([-0.01]), "655.35"


def test_motion_through_level_is_small() -> None:
    assert tilt_steps(np.array([359.9, 0.1, 359.8])) == pytest.approx([0.2, -0.3])


def test_which_objects_are_angles() -> None:
    jn2100 = load_device("jn2100")
    assert [tilt_axis(jn2100, index) for index in (0x6010, 0x6120, 0x5C10)] == [0, 1, None]
    assert tilt_axis(None, 0x6010) is None
    assert position_objects(load_device("lir-918")) == ((0x6004, 0),)
    assert position_objects(None) == ()
