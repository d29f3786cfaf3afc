"""From raw counts to angles: encoders (CiA 406) and inclinometers (CiA 410), as columns.

The rules are the device sheets' section 6; which objects hold the scale is data of the device
(`[measurement]` of its TOML file).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.devices import Device, standard_device, standard_of
from syncline_schemas.tilt import Angles, angles_of_geometry

Lookup = Callable[[int, int], tuple[int, bool] | None]
"""(index, sub) -> (value, assumed): what is known of an object, and whether it was only assumed."""
Counts = NDArray[np.int64]
Degrees = NDArray[np.float64]
_Known = tuple[int, bool] | None


@dataclass(frozen=True, slots=True)
class EncoderScale:
    """How counts become angles.

    `counts_per_turn` and `range_counts` (the wrap modulus R) are None where unknown. `assumed`
    names the settings that rest on a default or are not known ("cpr", "range", "scaling",
    "direction").
    """

    counts_per_turn: int | None
    range_counts: int | None
    clockwise: bool = True
    max_rpm: float | None = None
    assumed: tuple[str, ...] = ()
    cut_bits: int | None = None
    """Bits of the value that is sent where they are too few for the range: R is then 2^bits."""
    signed: bool = False
    """Whether values below 0 are sent as well."""


LINEAR = range(6, 10)
MULTI_SENSOR = 10
"""Kinds of encoder in the upper half of 1000h (CiA 406): those that measure a way, and those that
may measure either."""
_MM_PER_NM = 1e-6


def linear_scale(
    device: Device, device_type: int | None, lookup: Lookup
) -> tuple[float, str] | None:
    """(factor, unit) of an encoder that measures a way: 6005h:1 in nm; None of a rotary one."""
    if device_type is None or device_type & 0xFFFF != 406:
        return None
    kind = device_type >> 16 & 0xFF
    per_turn = device.measurement.get("counts_per_turn")
    turns = kind == MULTI_SENSOR and per_turn is not None and lookup(*per_turn) is not None
    if kind not in (*LINEAR, MULTI_SENSOR) or turns:
        return None
    step = device.measurement.get("measuring_step")
    known = lookup(*step) if step is not None else None
    return (known[0] * _MM_PER_NM, "mm") if known and known[0] > 0 else (1.0, "counts")


class _Settings:
    """What is known of a device's settings: overrides first, then objects, then defaults."""

    def __init__(
        self, device: Device | None, lookup: Lookup, overrides: Mapping[str, Any] | None
    ) -> None:
        self.data = device.measurement if device else {}
        self._lookup = lookup
        self._given = dict(overrides or {})

    def given(self, name: str) -> Any:
        """The user's override; None where there is none or it says "auto"."""
        value = self._given.get(name)
        return None if value == "auto" else value

    def known(self, override: str, role: str) -> _Known:
        """Number for a role of the measurement: override, object, or the device's default."""
        value = self.given(override)
        if isinstance(value, int | float):
            return int(value), False
        key = self.data.get(role)
        found = self._lookup(*key) if key is not None else None
        if found is not None and found[0] >= 0:
            return found
        default = self.data.get("defaults", {}).get(role)
        return (int(default), True) if default is not None else None

    def flag(self, role: str) -> _Known:
        """One bit of an object: (0 or 1, assumed); None where the device has no such bit."""
        place = self.data.get(role)
        if place is None:
            return None
        found = self._lookup(*place["object"])
        value, assumed = found if found is not None else (0, True)
        return value >> place["bit"] & 1, assumed


def encoder_scale(
    device: Device | None, lookup: Lookup, overrides: Mapping[str, Any] | None = None
) -> EncoderScale:
    """Scale of an encoder from the user's overrides, the objects known, and the device's defaults.

    Overrides: `cpr`, `turns`, `range`, `scaling` ("on" | "off"), `direction` ("cw" | "ccw"),
    `max_rpm`.
    """
    settings = _Settings(device, lookup, overrides)
    cpr, scaling_assumed = _counts_per_turn(settings)
    range_counts = _range_counts(settings, cpr)
    direction, direction_assumed = _clockwise(settings)
    assumed = {
        "cpr": cpr is None or cpr[1],
        "range": range_counts is None or range_counts[1],
        "scaling": scaling_assumed,
        "direction": direction_assumed,
    }
    limit = settings.given("max_rpm") or (device.limits.get("max_rpm") if device else None)
    return EncoderScale(
        cpr[0] if cpr else None,
        range_counts[0] if range_counts else None,
        direction,
        float(limit) if limit is not None else None,
        tuple(name for name, is_so in assumed.items() if is_so),
    )


def sent_in(scale: EncoderScale, bits: int, *, signed: bool = False) -> EncoderScale:
    """The scale of a value of which only the lower `bits` are sent (6004h mapped with 16 bits).

    >>> sent_in(EncoderScale(4096, 1 << 24), 16).range_counts
    65536
    """
    scale = replace(scale, signed=signed)
    if scale.range_counts is None or scale.range_counts <= 1 << bits:
        return scale
    return replace(scale, range_counts=1 << bits, cut_bits=bits)


def _counts_per_turn(settings: _Settings) -> tuple[_Known, bool]:
    """Counts per turn, and whether the scaling switch was assumed."""
    programmed = _positive(settings.known("cpr", "counts_per_turn"))
    if isinstance(settings.given("cpr"), int):
        return programmed, False
    if "scaling" not in settings.data:
        hardware = _positive(settings.known("", "hardware_counts_per_turn"))
        return programmed or ((hardware[0], True) if hardware else None), False
    choice = settings.given("scaling")
    switch = (int(choice == "on"), False) if choice else settings.flag("scaling")
    assert switch is not None
    if switch[0]:
        return programmed, switch[1]
    hardware = _positive(settings.known("", "hardware_counts_per_turn"))
    if hardware is None:
        return None, switch[1]
    same = programmed is not None and programmed[0] == hardware[0] and not programmed[1]
    certain = not switch[1] or not hardware[1] or same
    return (hardware[0], not certain), switch[1] and not same


def _range_counts(settings: _Settings, cpr: _Known) -> _Known:
    total = _positive(settings.known("range", "range"))
    if total is not None and not total[1]:
        return total
    turns = _positive(settings.known("turns", "turns"))
    if cpr is None or turns is None:
        return total
    return cpr[0] * turns[0], cpr[1] or turns[1]


def _positive(known: _Known) -> _Known:
    return known if known is not None and known[0] > 0 else None


def _clockwise(settings: _Settings) -> tuple[bool, bool]:
    choice = settings.given("direction")
    if choice:
        return choice == "cw", False
    found = settings.flag("direction")
    return (found[0] == 0, found[1]) if found is not None else (True, True)


@dataclass(frozen=True, slots=True, eq=False)
class EncoderAngles:
    """Raw counts as people read them; all (n,).

    position: int64 counts modulo R. turn: float64. angle_deg: float64 in [0, 360); both NaN where
    the scale is not known, or too few bits are sent. in_range: bool, False where the raw value is not below R.
    """

    position: Counts
    turn: NDArray[np.float64]
    angle_deg: Degrees
    in_range: NDArray[np.bool_]


def encoder_angles(raw: Counts, scale: EncoderScale) -> EncoderAngles:
    """Position, turn = pos div cpr and angle = (pos mod cpr) x 360 / cpr of raw counts."""
    in_range = np.full(len(raw), True) if scale.signed else raw >= 0
    position = raw
    if scale.range_counts is not None:
        in_range = in_range & (np.abs(raw) < scale.range_counts)
        position = raw % scale.range_counts
    if scale.counts_per_turn is None:
        unknown = np.full(len(raw), np.nan)
        return EncoderAngles(position, unknown, unknown, in_range)
    turn, within = np.divmod(position, scale.counts_per_turn)
    turns, angle = turn.astype(np.float64), within * 360.0 / scale.counts_per_turn
    if scale.cut_bits is not None:
        turns = np.full(len(raw), np.nan)
        if (1 << scale.cut_bits) % scale.counts_per_turn:
            angle = turns
    return EncoderAngles(position, turns, angle, in_range)


def count_steps(position: Counts, range_counts: int) -> Counts:
    """Motion between samples the shortest way round: (n - 1,) counts in (-R/2, R/2].

    >>> count_steps(np.array([131070, 3]), 131072)
    array([5])
    """
    step = np.diff(position) % range_counts
    return np.where(step > range_counts // 2, step - range_counts, step)


def unwrapped(position: Counts, range_counts: int) -> Counts:
    """Positions joined the shortest way modulo R, starting at the first one: (n,) counts."""
    joined: Counts = np.concatenate(
        (position[:1], position[:1] + np.cumsum(count_steps(position, range_counts)))
    )
    return joined


def ambiguous_rpm(range_counts: int, counts_per_turn: int, spacing_s: float) -> float:
    """Speed above which samples `spacing_s` apart no longer tell the direction: 30 x turns / T.

    >>> round(ambiguous_rpm(131072, 131072, 0.515), 2)
    58.25
    """
    return 30.0 * (range_counts / counts_per_turn) / spacing_s


@dataclass(frozen=True, slots=True)
class AxisScale:
    """One axis of an inclinometer.

    Attributes:
        name: what the axis shows under the angle definition in force.
        low_deg, high_deg: possible angles, high included only for +/-180.
        unsigned_16: 16-bit values are to be read unsigned (0..360 deg overflows int16).
        ambiguous_16: 16-bit values repeat within the range.
    """

    name: str
    low_deg: float
    high_deg: float
    unsigned_16: bool
    ambiguous_16: bool


@dataclass(frozen=True, slots=True)
class TiltScale:
    """How an inclinometer's raw values become degrees.

    `axes` are longitudinal and lateral. `definition` is the angle definition's name. `assumed`
    names the settings that rest on a default ("res", "quad", "angle_def"). `angles` is what both
    angles mean together, None where that is not known. `full_circle` is True where the quadrant
    correction is known to be on, so that angles tell upside down. `geometry` is the kind of the
    angle definition, "" where the value of 2044h is none that is known.
    """

    deg_per_count: float
    axes: tuple[AxisScale, AxisScale]
    definition: str = ""
    assumed: tuple[str, ...] = ()
    angles: Angles | None = None
    full_circle: bool = False
    geometry: str = ""


_PLAIN: dict[str, Any] = {
    "name": "",
    "geometry": "perpendicular",
    "axes": ("longitudinal", "lateral"),
    "low": (-90, -90),
    "high": (90, 90),
    "corrected": (0, 1),
}


def tilt_scale(
    device: Device | None, lookup: Lookup, overrides: Mapping[str, Any] | None = None
) -> TiltScale:
    """Scale of an inclinometer from the user's overrides, the objects known, and the defaults.

    Overrides: `res` (value of 6000h), `quad`, `angle_def`, `i16_unsigned` ("yes" | "no"),
    `perp_formula` ("asin" | "atan").
    """
    settings = _Settings(device, lookup, overrides)
    resolution = _positive(settings.known("res", "resolution")) or (1, True)
    quadrant = settings.known("quad", "quadrant") or (0, False)
    chosen = settings.known("angle_def", "definition") or (0, False)
    deg_per_count = resolution[0] * float(settings.data.get("resolution_deg", 0.001))
    listed = {d["value"]: d for d in settings.data.get("definitions", ())}
    definition = listed.get(chosen[0], _PLAIN)
    geometry = "" if listed and chosen[0] not in listed else definition.get("geometry", "")
    choice = settings.given("i16_unsigned")
    first, second = (_axis(definition, axis, quadrant[0], deg_per_count, choice) for axis in (0, 1))
    assumed = (("res", resolution[1]), ("quad", quadrant[1]), ("angle_def", chosen[1]))
    return TiltScale(
        deg_per_count,
        (first, second),
        definition["name"],
        tuple(n for n, is_so in assumed if is_so),
        angles_of_geometry(geometry, str(settings.given("perp_formula"))),
        quadrant[0] in (1, 2) and not quadrant[1],
        geometry,
    )


def _axis(
    definition: Mapping[str, Any], axis: int, quadrant: int, deg_per_count: float, choice: Any
) -> AxisScale:
    corrected = quadrant == 2 and axis in definition["corrected"]
    full_circle = corrected or (quadrant == 0 and definition["high"][axis] > 180)
    low, high = (0.0, 360.0) if full_circle else (-180.0, 180.0)
    ambiguous = 65536 * deg_per_count < 360.0
    overflows = full_circle and 32768 * deg_per_count < 360.0 and not ambiguous
    unsigned = overflows if choice is None else choice in ("yes", True)
    return AxisScale(definition["axes"][axis], low, high, unsigned, ambiguous)


def tilt_axis(device: Device | None, index: int) -> int | None:
    """Which axis an object shows: 0 longitudinal, 1 lateral, None where it is no angle."""
    axes: Mapping[int, int] = device.measurement.get("axes", {}) if device else {}
    return axes.get(index)


def tilt_deg(raw: Counts, bits: int, deg_per_count: float, axis: AxisScale) -> Degrees:
    """Degrees of raw values of a `bits`-wide signed object: raw x 6000h / 1000 (JN2100 sheet 6.1).

    Where 0..360 deg overflow 16 bits, a value is read unsigned if that gives a possible angle;
    an impossible one stays as sent, so that it shows.

    >>> axis = AxisScale("", 0, 360, True, False)
    >>> tilt_deg(np.array([-30536, -2370]), 16, 0.01, axis).round(2).tolist()
    [350.0, -23.7]
    """
    signed = raw.astype(np.float64) * deg_per_count
    if bits != 16 or not axis.unsigned_16:
        return signed
    unsigned = (raw & 0xFFFF).astype(np.float64) * deg_per_count
    return np.where(unsigned < axis.high_deg, unsigned, signed)


def tilt_steps(angle_deg: Degrees) -> Degrees:
    """Motion between samples on the circle: (n - 1,) degrees in [-180, 180)."""
    steps: Degrees = (np.diff(angle_deg) + 180.0) % 360.0 - 180.0
    return steps


def measured_by(
    device: Device | None, device_type: int | None, index: int, sub: int
) -> tuple[Device | None, bool]:
    """Whose rules turn an object into a position, and whether that profile was only assumed.

    The device itself where it names its positions, else a device of the CiA profile that has the
    object: 1000h (`device_type`) names the profile in its lower half, 0 stands for none (CiA 301
    7.5.2.1). None where the object is no position, or the node follows another profile.
    """
    if position_objects(device):
        return (device if (index, sub) in position_objects(device) else None), False
    number, told = standard_of(index, sub), (device_type or 0) & 0xFFFF
    if number is None or told not in (0, number):
        return None, False
    return standard_device(number), told == 0


def position_objects(device: Device | None) -> tuple[tuple[int, int], ...]:
    """Objects (index, sub) whose values make angle traces."""
    return tuple(device.measurement.get("position", ())) if device else ()
