"""From raw counts to angles: encoders (CiA 406) and inclinometers (CiA 410), as columns.

The rules are the device sheets' section 6; which objects hold the scale is data of the device
(`[measurement]` of its TOML file).
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.devices import Device, standard_device, standard_of
from syncline_schemas.records import dataclass
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
    """What is known of a device's settings: by the bus, the user's overrides, and defaults."""

    def __init__(
        self, device: Device | None, lookup: Lookup, overrides: Mapping[str, Any] | None
    ) -> None:
        self.device = device
        self.data = device.measurement if device else {}
        self._lookup = lookup
        self._given = dict(overrides or {})

    def given(self, name: str) -> Any:
        """The user's override; None where there is none or it says "auto"."""
        value = self._given.get(name)
        return None if value == "auto" else value

    def known(self, override: str, role: str, least: int = 0) -> _Known:
        """Number for a role of the measurement: what the bus told, the override, what is assumed.

        Numbers below `least` tell nothing.
        """
        found = self.object(role, least)
        if found is not None and not found[1]:
            return found
        value = self.given(override)
        if isinstance(value, int | float):
            return int(value), False
        if found is not None:
            return found
        default = self.data.get("defaults", {}).get(role)
        return (int(default), True) if default is not None else None

    def object(self, role: str, least: int = 0) -> _Known:
        """Value of the object that has a role, None where it is not known or below `least`."""
        key = self.data.get(role)
        found = self._lookup(*key) if key is not None else None
        return found if found is not None and found[0] >= least else None

    def aliased_direction(self) -> int | None:
        """Direction bit of an object that only related firmware has; None where none is known."""
        place = self.data.get("direction_alias")
        quirks = self.device.quirks.undocumented if self.device else {}
        if place is None or place["object"][0] not in quirks:
            return None
        found = self._lookup(*place["object"])
        return found[0] >> place["bit"] & 1 if found is not None else None

    def lacks(self, role: str, beside: str) -> bool:
        """Whether the device's dictionary has the object of one role and not that of another."""
        missing, there = self.data.get(role), self.data.get(beside)
        if self.device is None or missing is None or there is None:
            return False
        return self.device.object(*there) is not None and self.device.object(*missing) is None

    def switched(self) -> _Known:
        """Whether the scaling is on: 1 or 0; None where nothing says so."""
        choice = self.given("scaling")
        if choice:
            return int(choice == "on"), False
        place = self.data["scaling"]
        return self.flag("scaling") if self._lookup(*place["object"]) is not None else None

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
    """Scale of an encoder from the objects known, the user's overrides, and the device's defaults.

    Overrides: the numbers `cpr`, `turns` and `range` hold unless the bus told otherwise; `scaling`
    ("on" | "off") and `direction` ("cw" | "ccw") say how its bits are to be read; `max_rpm`.
    """
    settings = _Settings(device, lookup, overrides)
    per_turn = _counts_per_turn(settings)
    cpr, range_counts = per_turn.known, _range_counts(settings, per_turn)
    direction, direction_assumed = _clockwise(settings)
    assumed = {
        "cpr": cpr is None or cpr[1],
        "range": range_counts is None or range_counts[1],
        "scaling": per_turn.switch_assumed,
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


@dataclass(frozen=True, slots=True)
class _PerTurn:
    """Counts per turn; `is_programmed` where they are those of 6001h, with which 6002h counts.

    `in_doubt` where that rests on a switch that is not known.
    """

    known: _Known
    switch_assumed: bool = False
    is_programmed: bool = True
    in_doubt: bool = False


def _counts_per_turn(settings: _Settings) -> _PerTurn:
    """Counts per turn in force: what the bus told of them counts more than the override."""
    told = _told_per_turn(settings)
    value = settings.given("cpr")
    if isinstance(value, int) and (told.known is None or told.known[1]):
        return _PerTurn((value, False))
    return told


def _told_per_turn(settings: _Settings) -> _PerTurn:
    """Counts per turn by 6001h, or by 6501h while the scaling is off (CiA 406, 6000h bit 2)."""
    programmed = settings.known("", "counts_per_turn", 1)
    hardware = settings.known("", "hardware_counts_per_turn", 1)
    guess = (hardware[0], True) if hardware else None
    no_hardware = settings.lacks("hardware_counts_per_turn", "counts_per_turn")
    if "scaling" not in settings.data or (hardware is None and no_hardware):
        return _PerTurn(programmed or guess)
    switch = settings.switched()
    same = programmed is not None and hardware is not None and programmed[0] == hardware[0]
    if switch is None and programmed is not None:
        certain = same or hardware is None
        known = programmed[0], programmed[1] or not certain
        return _PerTurn(known, not same, in_doubt=not certain)
    if switch is not None and switch[0]:
        return _PerTurn(programmed or guess, switch[1])
    if hardware is None:
        unsure = (programmed[0], True) if programmed else None
        return _PerTurn(unsure, switch is None or switch[1], in_doubt=True)
    is_sure = programmed is not None and not programmed[1]
    same = same and is_sure
    is_off = switch is not None and not switch[1]
    certain = same or is_off or not (hardware[1] or is_sure)
    return _PerTurn((hardware[0], not certain), not is_off and not same, same)


def _range_counts(settings: _Settings, per_turn: _PerTurn) -> _Known:
    """The measuring range in force: 6002h counts in units of 6001h, so only where those count."""
    cpr, total = per_turn.known, settings.object("range", 1)
    if total is not None and not total[1] and per_turn.is_programmed:
        return total[0], per_turn.in_doubt
    turns = settings.object("turns", 1)
    if cpr is not None and turns is not None and not cpr[1] and not turns[1]:
        return cpr[0] * turns[0], False
    value = settings.given("range")
    if isinstance(value, int):
        return value, False
    turns = settings.known("turns", "turns", 1)
    if cpr is not None and turns is not None:
        return cpr[0] * turns[0], cpr[1] or turns[1]
    if per_turn.is_programmed or cpr is None or total is None:
        return total
    programmed = settings.object("counts_per_turn", 1)
    turned = total[0] // programmed[0] if programmed and not total[0] % programmed[0] else 0
    return (cpr[0] * turned, True) if turned else None


def _clockwise(settings: _Settings) -> tuple[bool, bool]:
    choice = settings.given("direction")
    if choice:
        return choice == "cw", False
    by_alias = settings.aliased_direction()
    if by_alias is not None:
        return by_alias == 0, True
    found = settings.flag("direction")
    return (found[0] == 0, found[1]) if found is not None else (True, True)


@dataclass(frozen=True, slots=True)
class ContradictedSetting:
    """A number that the user gave of a device, and what the device told of it by its objects."""

    name: str
    given: int
    told: int
    objects: tuple[tuple[int, int], ...]


_PER_TURN = ("counts_per_turn", "hardware_counts_per_turn")
_TOLD_BY = {
    "cpr": _PER_TURN,
    "range": ("range", "turns", *_PER_TURN),
    "turns": ("turns",),
    "res": ("resolution",),
    "quad": ("quadrant",),
    "angle_def": ("definition",),
}
"""Roles of the objects that tell the number of a setting."""


def contradicted_settings(
    device: Device | None, lookup: Lookup, overrides: Mapping[str, Any]
) -> list[ContradictedSetting]:
    """Numbers among the overrides that the device tells otherwise, which counts more."""
    settings = _Settings(device, lookup, {"scaling": overrides.get("scaling", "auto")})
    per_turn = _counts_per_turn(settings)
    found = []
    for name, roles in _TOLD_BY.items():
        given = overrides.get(name)
        if not isinstance(given, int):
            continue
        match name:
            case "cpr":
                told = per_turn.known
            case "range":
                told = _range_counts(settings, per_turn)
            case _:
                told = settings.object(roles[0], 0 if name in ("quad", "angle_def") else 1)
        if told is not None and not told[1] and told[0] != given:
            keys = (settings.data[role] for role in roles if role in settings.data)
            found.append(ContradictedSetting(name, given, told[0], tuple(keys)))
    return found


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
        position = modulo(raw, scale.range_counts)
    if scale.counts_per_turn is None:
        unknown = np.full(len(raw), np.nan)
        return EncoderAngles(position, unknown, unknown, in_range)
    turn, within = _turns(position, scale.counts_per_turn)
    turns, angle = turn.astype(np.float64), within * 360.0 / scale.counts_per_turn
    if scale.cut_bits is not None:
        turns = np.full(len(raw), np.nan)
        if (1 << scale.cut_bits) % scale.counts_per_turn:
            angle = turns
    return EncoderAngles(position, turns, angle, in_range)


def modulo(counts: Counts, total: int) -> Counts:
    """(n,) counts modulo a positive total; division takes ten times as long as what avoids it.

    >>> modulo(np.array([-1, 7]), 10), modulo(np.array([-21, 17]), 10), modulo(np.array([-1]), 8)
    (array([9, 7]), array([9, 7]), array([7]))
    """
    if total & (total - 1) == 0:
        return counts & (total - 1)
    low, high = int(counts.min(initial=0)), int(counts.max(initial=0))
    if -total <= low and high < total:
        return counts if low >= 0 else np.where(counts < 0, counts + total, counts)
    return counts % total


def _turns(position: Counts, per_turn: int) -> tuple[Counts, Counts]:
    """(turns, counts within the turn) of positions (n,)."""
    if per_turn & (per_turn - 1) == 0:
        return position >> (per_turn.bit_length() - 1), position & (per_turn - 1)
    return np.divmod(position, per_turn)


def count_steps(position: Counts, range_counts: int) -> Counts:
    """Motion between samples the shortest way round: (n - 1,) counts in (-R/2, R/2].

    >>> count_steps(np.array([131070, 3]), 131072)
    array([5])
    """
    step = modulo(np.diff(position), range_counts)
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
        low_deg, high_deg: possible angles; 360 itself is none.
        unsigned_16: 16-bit values are to be read unsigned (0..360 deg overflows int16).
        ambiguous_16: 16-bit values repeat within the range.
        forced_16: the user says that 16-bit values are unsigned, so that they show 0..360.
    """

    name: str
    low_deg: float
    high_deg: float
    unsigned_16: bool
    ambiguous_16: bool
    forced_16: bool = False

    def of_bits(self, bits: int) -> "AxisScale":
        """The axis as an object of so many bits shows it."""
        if bits != 16 or not self.forced_16:
            return self
        return replace(self, low_deg=0.0, high_deg=360.0)

    @property
    def relative(self) -> "AxisScale":
        """The axis where a zero point is subtracted from it: half a circle becomes a whole one."""
        if self.high_deg - self.low_deg >= 360.0:
            return self
        return replace(self, low_deg=-180.0, high_deg=180.0)

    def outside(self, angle_deg: Degrees) -> NDArray[np.bool_]:
        """Which angles the axis cannot show (JN2100 sheet 6.2, 6.3, 6.6)."""
        beyond = angle_deg >= 360.0 if self.high_deg == 360.0 else angle_deg > self.high_deg
        outside: NDArray[np.bool_] = (angle_deg < self.low_deg) | beyond
        return outside


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
    "low": (-180, -180),
    "high": (180, 180),
    "corrected": (),
}


def tilt_scale(
    device: Device | None, lookup: Lookup, overrides: Mapping[str, Any] | None = None
) -> TiltScale:
    """Scale of an inclinometer from the user's overrides, the objects known, and the defaults.

    Overrides: `res` (value of 6000h), `quad`, `angle_def`, `i16_unsigned` ("yes" | "no"),
    `perp_formula` ("asin" | "atan").
    """
    settings = _Settings(device, lookup, overrides)
    resolution = settings.known("res", "resolution", 1) or (1, True)
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
    low, high = float(definition["low"][axis]), float(definition["high"][axis])
    if quadrant and axis in definition["corrected"]:
        low, high = (0.0, 360.0) if quadrant == 2 else (-180.0, 180.0)
    ambiguous = 65536 * deg_per_count < 360.0
    overflows = high > 180 and 32768 * deg_per_count < 360.0 and not ambiguous
    forced = choice in ("yes", True)
    unsigned = overflows if choice is None else forced
    return AxisScale(definition["axes"][axis], low, high, unsigned, ambiguous, forced)


def tilt_axis(device: Device | None, index: int) -> int | None:
    """Which axis an object shows: 0 longitudinal, 1 lateral, None where it is no angle."""
    axes: Mapping[int, int] = device.measurement.get("axes", {}) if device else {}
    return axes.get(index)


def tilt_deg(raw: Counts, bits: int, deg_per_count: float, axis: AxisScale) -> Degrees:
    """Degrees of raw values of a `bits`-wide signed object: raw x 6000h / 1000 (JN2100 sheet 6.1).

    Where 0..360 deg overflow 16 bits, a value is read unsigned if that gives a possible angle;
    an impossible one stays as sent, so that it shows. Where the user says that 16 bits are
    unsigned, all of them are.

    >>> axis = AxisScale("", 0, 360, True, False)
    >>> tilt_deg(np.array([-30536, -2370]), 16, 0.01, axis).round(2).tolist()
    [350.0, -23.7]
    """
    signed = raw.astype(np.float64) * deg_per_count
    if bits != 16 or not axis.unsigned_16:
        return signed
    unsigned = (raw & 0xFFFF).astype(np.float64) * deg_per_count
    possible = unsigned < axis.high_deg
    return unsigned if axis.forced_16 else np.where(possible, unsigned, signed)


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


def measuring_device(device: Device | None, device_type: int | None) -> Device | None:
    """Whose rules a node measures by: its device, else one of the CiA profile that 1000h names."""
    if position_objects(device):
        return device
    return standard_device((device_type or 0) & 0xFFFF)
