"""Simulated weeks of a fleet, as values of captures: with trends, and with what only looks like one.

Levels, steps of the stamps and what differs between nodes are those of analyses of captures of
`fleet.Template`; how days differ from one another is drawn: heavy tails, days that resemble the day
before, weekends, captures of minutes and of a shift, days and weeks without any, another recorder,
another device, a storm of messages, a site without power.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

DAY_NS = 86_400 * 10**9
BEGIN_NS = 1_772_409_600 * 10**9
"""2026-03-02, a Monday."""
Kind = Literal["step", "drift", "rate", "wear"]
Value = str | int | float | None
Row = dict[str, Value]
Floats = NDArray[np.float64]

DEVICES = {
    1: "lir-da158",
    2: "lir-da158a",
    3: "lir-ma158k",
    4: "lir-918",
    10: "jn2100",
    20: "haomiao-38",
}
_PDOS = {1: ("TPDO2", 644.2), 2: ("TPDO2", 663.8), 3: ("TPDO2", 814.9), 4: ("TPDO2", 981.1),
         10: ("TPDO1", 1323.4), 20: ("TPDO2", 1590.0)}  # fmt: skip
_BEATS = {1: 500.01, 2: 249.991, 3: 500.129, 20: 999.95}
_NOISE = {1: 0.031, 3: 0.048, 10: 0.012}
_COUNTED = (1, 2, 3, 4, 10, 20)


@dataclass(frozen=True, slots=True)
class Truth:
    """One trend that was planted; of the fleet where `machine` is None."""

    kind: Kind
    quantity: str
    machine: str | None
    node: int | None
    day: int
    change: float


@dataclass(frozen=True, slots=True)
class Lure:
    """Something that is no trend."""

    what: str
    quantity: str
    machine: str | None
    node: int | None


@dataclass(slots=True)
class Weeks:
    """A simulated fleet: rows of each quantity, what was planted, and what only looks so."""

    rows: dict[str, list[Row]] = field(default_factory=dict)
    truths: list[Truth] = field(default_factory=list)
    lures: list[Lure] = field(default_factory=list)
    either: list[Truth] = field(default_factory=list)
    """What is so near the least size that it may be told or not."""


@dataclass(frozen=True, slots=True)
class _Level:
    """How a level of one node goes in a healthy machine."""

    quantity: str
    node: int | None
    part: str
    level: float
    daily: float
    """Standard deviation of days [unit]."""
    single: float
    """Standard deviation of a capture of a minute, less for longer ones."""
    grain: float
    between: float
    """Share by which machines differ."""
    least: float
    """A change that is worth telling."""


def _levels() -> list[_Level]:
    found = [
        _Level("pdo-latency", node, part, level, 2.0, 3.0, 0.1, 0.02, max(25.0, 0.06 * level))
        for node, (part, level) in _PDOS.items()
    ]
    found.append(_Level("sync-jitter", None, "SYNC 080h", 33.4, 1.5, 4.0, 0.01, 0.15, 24.0))
    found += [
        _Level(
            "heartbeat", node, "heartbeat", level, 0.003, 0.02, 0.001, 2e-5, max(1.2, 0.025 * level)
        )
        for node, level in _BEATS.items()
    ]
    found += [
        _Level("encoder-noise", node, "Position 6004h", level, 0.002, 0.006, 1e-4, 0.1, 0.026)
        for node, level in _NOISE.items()
    ]
    found.append(_Level("bus-load", None, "bus", 27.5, 0.3, 0.4, 1e-3, 0.05, 3.4))
    return found


LEVELS: Sequence[_Level] = tuple(_levels())


@dataclass(slots=True)
class _Machine:
    """The captures of a machine: when each began, how long it is, who recorded it."""

    name: str
    begun_ns: NDArray[np.int64]
    hours: Floats
    day: NDArray[np.int64]
    recorder: list[str]
    serial: Mapping[int, list[str]]


def simulate(
    machines: int = 200,
    days: int = 30,
    seed: int = 0,
    *,
    planted: float = 0.02,
    lured: float = 0.04,
    fleet_wide: bool = True,
) -> Weeks:
    """A fleet.

    Args:
        planted: trends for each track of a level or counter.
        lured: what is no trend, for each track.
        fleet_wide: whether there is a roll-out, a drift of all, and an error that comes with both.
    """
    rng = np.random.default_rng(seed)
    weeks = Weeks()
    fleet = _fleet_changes(rng, days, weeks) if fleet_wide else {}
    shut = int(rng.integers(2, days - 2))
    for number in range(machines):
        machine = _machine(rng, f"press-{number:03}", days, lured)
        for level in LEVELS:
            _level_rows(rng, weeks, machine, level, days, fleet, planted, lured)
        dark = shut if number < machines // 10 else None
        _event_rows(rng, weeks, machine, days, fleet, planted, lured, dark)
        _wear_rows(rng, weeks, machine, days, planted, lured)
    return weeks


def _machine(rng: np.random.Generator, name: str, days: int, lured: float) -> _Machine:
    """When a machine was recorded."""
    works_weekends = rng.random() < 0.75
    typical_h = float(rng.choice([0.2, 1.0, 4.0]))
    outage = rng.random() < 0.1
    gone = int(rng.integers(0, days)) if outage else days
    back = gone + int(rng.integers(2, 11)) if outage else days
    begun, hours = [], []
    for day in range(days):
        weekend = day % 7 >= 5
        if (weekend and not works_weekends) or rng.random() < 0.08 or gone <= day < back:
            continue
        for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
            begun.append(BEGIN_NS + day * DAY_NS + int(rng.integers(5 * 3600, 20 * 3600)) * 10**9)
            hours.append(typical_h * float(np.exp(rng.normal(0, 0.7))))
    order = np.argsort(begun, kind="stable")
    begun_ns = np.array(begun, np.int64)[order]
    length = np.array(hours)[order]
    day_of = (begun_ns - BEGIN_NS) // DAY_NS
    at = int(rng.integers(8, max(9, days - 8)))
    replaced = at if rng.random() < lured else days
    recorder = [f"{name}-gw2" if day >= replaced else f"{name}-gw" for day in day_of]
    if rng.random() < lured:
        cut = int(rng.integers(8, max(9, days - 8)))
        length = np.where(day_of >= cut, length * rng.choice([0.1, 8.0]), length)
    exchanged = {
        node: int(rng.integers(6, days - 6)) for node in DEVICES if rng.random() < lured / 3
    }
    serial = {
        node: [f"{name}-{node}-{int(day >= exchanged.get(node, days))}" for day in day_of]
        for node in DEVICES
    }
    return _Machine(name, begun_ns, np.maximum(length, 0.02), day_of, recorder, serial)


Curve = Callable[[Floats], Floats]


def _fleet_changes(
    rng: np.random.Generator, days: int, weeks: Weeks
) -> dict[tuple[str, int | None], Curve]:
    """What changes on all machines: a firmware of one node, a temperature, and resets that it brings."""
    rolled = int(rng.integers(9, days - 9))
    late = float(rng.uniform(70, 160))
    warm = float(rng.uniform(0.04, 0.09))
    often = int(rng.integers(9, days - 9))
    weeks.truths += [
        Truth("step", "pdo-latency", None, 2, rolled, late),
        Truth("drift", "encoder-noise", None, 3, 0, warm),
        Truth("rate", "emcy", None, 20, often, 3.0),
    ]
    return {
        ("pdo-latency", 2): lambda day: np.where(day >= rolled, late, 0.0),
        ("encoder-noise", 3): lambda day: warm * day / (days - 1),
        ("emcy", 20): lambda day: np.where(day >= often, 4.0, 1.0),
    }


def _level_rows(
    rng: np.random.Generator,
    weeks: Weeks,
    machine: _Machine,
    of: _Level,
    days: int,
    fleet: Mapping[tuple[str, int | None], Curve],
    planted: float,
    lured: float,
) -> None:
    """The captures' values of one level, healthy or with one thing in it."""
    day = machine.day.astype(np.float64)
    base = of.level * (1 + rng.normal(0, of.between))
    wander = np.zeros(days)
    for each in range(1, days):
        wander[each] = 0.4 * wander[each - 1] + rng.normal(0, of.daily * 0.92)
    value = base + wander[machine.day]
    value += (
        rng.standard_t(3, len(day))
        * of.single
        * 0.58
        / np.sqrt(np.maximum(machine.hours * 60, 0.5))
    )
    shape = fleet.get((of.quantity, of.node))
    if shape is not None:
        value += shape(day) * rng.uniform(0.9, 1.1)
    chance = rng.random()
    if chance < planted and shape is None:
        value += _plant(rng, weeks, machine, of, days, base)
    elif chance < planted + lured:
        value = _lure(rng, weeks, machine, of, days, value)
    if of.quantity in ("pdo-latency", "sync-jitter"):
        # Another recorder, other stamps.
        other = np.array([each.endswith("2") for each in machine.recorder])
        value = value + other * of.least * 2.0
    if of.node is not None:
        serial = machine.serial[of.node]
        new = np.array([each != serial[0] for each in serial], np.bool_)
        value = value + new * of.least * 1.5
    if of.quantity == "bus-load":
        # The SDOs of a start-up weigh more in a short capture.
        value = value + 0.1 / machine.hours
    value = np.maximum(np.round(value / of.grain) * of.grain, 0.0)
    for number in range(len(day)):
        _add(weeks, machine, number, of.quantity, of.node, of.part, amount=float(value[number]))


def _plant(
    rng: np.random.Generator, weeks: Weeks, machine: _Machine, of: _Level, days: int, base: float
) -> Floats:
    """A step or a drift, where days enough are on either side."""
    day = machine.day.astype(np.float64)
    size = of.least * float(rng.uniform(1.2, 5.0))
    falls = of.quantity == "pdo-latency" and rng.random() < 0.3
    size = -min(size, 0.6 * base) if falls else size
    if rng.random() < 0.5:
        at = int(rng.integers(8, days - 8))
        sides = (len(set(machine.day[machine.day < at])), len(set(machine.day[machine.day >= at])))
        if min(sides) < 6:
            return np.zeros(len(day))
        first_seen = int(machine.day[machine.day >= at].min())
        weeks.truths.append(Truth("step", of.quantity, machine.name, of.node, first_seen, size))
        return np.where(day >= at, size, 0.0)
    begin = int(rng.integers(5, days // 2)) if rng.random() < 0.33 else 0
    seen = set(machine.day.tolist())
    if (
        len(seen) < 14
        or len([each for each in seen if each >= begin]) < 10
        or max(seen) < days - 3
        or min(seen) > 2
    ):
        return np.zeros(len(day))
    size *= 1.5
    weeks.truths.append(Truth("drift", of.quantity, machine.name, of.node, begin, size))
    return size * np.maximum(day - begin, 0.0) / (days - 1 - begin)


LURES = (
    "one bad day", "weekly rhythm", "one outlier", "too small", "a week off", "moved", "single captures",
)  # fmt: skip


def _lure(
    rng: np.random.Generator, weeks: Weeks, machine: _Machine, of: _Level, days: int, value: Floats
) -> Floats:
    """What comes near a trend."""
    day, size = machine.day, of.least * float(rng.uniform(2, 6))
    what = str(rng.choice(LURES))
    weeks.lures.append(Lure(what, of.quantity, machine.name, of.node))
    at = int(rng.integers(2, days - 2))
    if what == "one bad day":
        return value + np.where(day == at, size, 0.0)
    if what == "weekly rhythm":
        return value + np.where(day % 7 >= 5, size, 0.0)
    if what == "one outlier":
        more = np.zeros(len(value))
        more[rng.integers(0, len(value))] = 30 * size
        return value + more
    if what == "too small":
        return value + np.where(day >= days // 2, of.least * 0.25, 0.0)
    if what == "a week off":
        # It is another one for some days in the middle, and as before again.
        begin = int(rng.integers(8, max(9, days - 14)))
        return value + np.where((day >= begin) & (day < begin + 4), size, 0.0)
    if what == "moved":
        # Another hall, recorded at another hour: a little different, within what days differ.
        return value + np.where(day >= at, of.daily, 0.0)
    spoilt = rng.random(len(value)) < 0.12
    return value + spoilt * size


def _event_rows(
    rng: np.random.Generator,
    weeks: Weeks,
    machine: _Machine,
    days: int,
    fleet: Mapping[tuple[str, int | None], Curve],
    planted: float,
    lured: float,
    dark: int | None,
) -> None:
    """Resets and EMCYs of each capture; days differ more than chance alone would make them."""
    day = machine.day
    cut = (
        (machine.day == dark) & (rng.random(len(day)) < 0.7)
        if dark is not None
        else np.zeros(len(day), np.bool_)
    )
    for quantity, usual in (("resets", 0.01), ("emcy", 0.05)):
        for node in _COUNTED:
            own = usual * float(rng.gamma(1.5, 0.7))
            rate = own * rng.gamma(3.0, 1 / 3.0, days)[day]
            shape = fleet.get((quantity, node))
            if shape is not None:
                rate = rate * shape(day.astype(np.float64))
            chance = rng.random()
            storm = np.zeros(len(day))
            if chance < planted and shape is None:
                rate = rate + _plant_rate(rng, weeks, machine, quantity, node, days, own)
            elif chance < planted + lured:
                what = str(
                    rng.choice(["one storm", "one bad day", "longer captures", "often, as ever"])
                )
                weeks.lures.append(Lure(what, quantity, machine.name, node))
                if what == "one storm" and len(day):
                    storm[rng.integers(0, len(day))] = rng.integers(20, 400)
                elif what == "one bad day":
                    storm[day == int(rng.integers(days // 2, days))] = rng.integers(5, 60)
                elif what == "often, as ever":
                    rate = rate + 1.0
            count = rng.poisson(rate * machine.hours) + storm
            if quantity == "resets":
                count = count + cut
            part = "EMCY" if quantity == "emcy" else "resets"
            for number in range(len(day)):
                _add(
                    weeks, machine, number, quantity, node, part,
                    amount=float(count[number]), over=float(machine.hours[number]),
                )  # fmt: skip


def _plant_rate(
    rng: np.random.Generator,
    weeks: Weeks,
    machine: _Machine,
    quantity: str,
    node: int,
    days: int,
    own: float,
) -> Floats:
    """Events come more often from a day on; enough of them that somebody would see it."""
    at = int(rng.integers(8, days - 8))
    late = machine.day >= at
    if min(len(set(machine.day[late])), len(set(machine.day[~late]))) < 6:
        return np.zeros(len(machine.day))
    hours = float(machine.hours[late].sum())
    more = max(float(rng.uniform(22, 90)) / hours, 4 * own)
    weeks.truths.append(Truth("rate", quantity, machine.name, node, at, more))
    return np.where(late, more * rng.gamma(4.0, 0.25, days)[machine.day], 0.0)


def _wear_rows(
    rng: np.random.Generator,
    weeks: Weeks,
    machine: _Machine,
    days: int,
    planted: float,
    lured: float,
) -> None:
    """Readings of the write counter of node 3, one a capture; differences as a data set has them."""
    day = machine.day
    if not len(day):
        return
    pace = float(rng.uniform(1, 12))
    start = float(rng.integers(100, 20_000))
    per_day = rng.poisson(pace, days).astype(np.float64)
    chance = rng.random()
    if chance < 4 * planted:
        at = int(rng.integers(9, days - 9))
        if min(len(set(day[day < at])), len(set(day[day >= at]))) >= 7:
            more = float(rng.uniform(60, 400))
            per_day += np.where(np.arange(days) >= at, rng.poisson(more, days), 0.0)
            weeks.truths.append(Truth("rate", "eeprom-wear", machine.name, 3, at, more))
            left = 100_000 - start - per_day.sum()
            _worn(weeks, machine.name, left / (more + pace), more)
    elif chance < 6 * planted:
        steady = float(rng.uniform(350, 900))
        per_day += rng.poisson(steady, days)
        left = 100_000 - start - per_day.sum()
        _worn(weeks, machine.name, left / (steady + pace), steady)
    elif chance < 6 * planted + lured:
        weeks.lures.append(Lure("parameters set once", "eeprom-wear", machine.name, 3))
        per_day[int(rng.integers(0, days))] += 500
    grown = start + np.concatenate([[0.0], np.cumsum(per_day)])
    t_days = (machine.begun_ns - BEGIN_NS) / DAY_NS
    reading = np.floor(np.interp(t_days, np.arange(days + 1), grown))
    first = machine.serial[3][0]
    new = np.array([each != first for each in machine.serial[3]], np.bool_)
    if new.any():
        weeks.lures.append(Lure("counter set back", "eeprom-wear", machine.name, 3))
        reading = np.where(new, reading - reading[new][0], reading)
    for number in range(len(day)):
        amount: float | None = None
        over: float | None = None
        if number and reading[number] >= reading[number - 1]:
            amount = float(reading[number] - reading[number - 1])
            over = float(t_days[number] - t_days[number - 1])
        _add(
            weeks, machine, number, "eeprom-wear", 3, "EEPROM writes",
            amount=amount, over=over, reading=float(reading[number]),
        )  # fmt: skip


def _worn(weeks: Weeks, machine: str, left_days: float, pace: float) -> None:
    """Note when an EEPROM reaches its writes: within a year, about then, or later."""
    truth = Truth("wear", "eeprom-wear", machine, 3, 0, pace)
    if left_days < 330:
        weeks.truths.append(truth)
    elif left_days < 420:
        weeks.either.append(truth)


def _add(
    weeks: Weeks,
    machine: _Machine,
    number: int,
    quantity: str,
    node: int | None,
    part: str,
    *,
    amount: float | None,
    over: float | None = None,
    reading: float | None = None,
) -> None:
    weeks.rows.setdefault(quantity, []).append(
        {
            "machine": machine.name,
            "capture_id": f"{machine.name}-{number}",
            "bus": "can0",
            "node": node,
            "part": part,
            "amount": amount,
            "over": over,
            "reading": reading,
            "begun_ns": int(machine.begun_ns[number]),
            "duration_ns": int(machine.hours[number] * 3.6e12),
            "recorder": machine.recorder[number],
            "resolution_us": 1.0,
            "name": None,
            "device": DEVICES.get(node) if node is not None else None,
            "serial": machine.serial[node][number] if node is not None else None,
        }
    )
