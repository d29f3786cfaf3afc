"""Trends in words, as rows."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from syncline_analyzer.fleet.quantities import QUANTITIES
from syncline_analyzer.fleet.trends.limits import LIMITS
from syncline_analyzer.fleet.trends.rows import TrendFinding, TrendId
from syncline_analyzer.fleet.trends.tracks import DAY_NS, Label
from syncline_analyzer.fleet.trends.trend import Trend
from syncline_analyzer.results.finding import Severity

WORDS: Mapping[str, str] = {
    "pdo-latency": "PDO latency",
    "sync-jitter": "SYNC jitter",
    "heartbeat": "heartbeat period",
    "resets": "resets that nobody commanded",
    "emcy": "EMCYs",
    "eeprom-wear": "EEPROM writes",
    "encoder-noise": "noise at rest",
    "bus-load": "bus load",
}
"""Quantities in a sentence."""
_PER = {"1/h": "an hour", "1/day": "a day"}
_FORECAST_DAYS = 5 * 365.0
_URGENT_DAYS = 30.0
_SHOWN = 3
"""Machines of a fleet's trend whose captures are its evidence."""

Periods = Mapping[tuple[str, str], float]
"""SYNC period by machine and bus [us]."""


def finding_of(trend: Trend, sync_us: Periods) -> TrendFinding:
    """The row of a trend."""
    lead = trend.lead
    nodes = sorted({label.node for label in trend.labels if label.node is not None})
    parts = list(dict.fromkeys(_part(label) for label in trend.labels))
    alone = len(nodes) <= 1
    reaches, reaches_ns = _forecast(trend, sync_us)
    before, after, first_ns, last_ns, onset_ns = _captures(trend)
    limits = LIMITS[trend.tracks.quantity]
    days = trend.tracks.bin_ns / DAY_NS
    return TrendFinding(
        id=_id(trend),
        severity=_severity(trend, reaches_ns, last_ns),
        quantity=trend.tracks.quantity,
        machine=None if trend.of_fleet else lead.machine,
        bus=lead.bus,
        node=lead.node if alone else None,
        name=lead.name if alone else None,
        device=_same([label.device for label in trend.labels]),
        part=_same([label.part for label in trend.labels]) if alone else None,
        unit="writes" if trend.kind == "wear" else QUANTITIES[trend.tracks.quantity].unit,
        onset_ns=onset_ns,
        first_ns=first_ns,
        last_ns=last_ns,
        before=trend.before,
        after=trend.after,
        change=trend.change,
        slope_per_day=trend.slope / days if trend.slope else None,
        q=trend.q,
        captures=before + after,
        captures_before=before,
        captures_after=after,
        machines=len(trend.machines),
        text=_text(trend, parts, nodes, onset_ns, reaches, reaches_ns),
        cause=limits.fleet_cause if trend.of_fleet else limits.cause,
        check_next=_check_next(trend),
        evidence=_evidence(trend),
        nodes=nodes,
        parts=parts,
        machine_names=trend.machines,
        reaches=reaches,
        reaches_ns=reaches_ns,
        assumed=list(trend.assumed),
    )


def date_text(t_ns: int) -> str:
    """The UTC date of a stamp.

    >>> date_text(1_772_431_200_000_000_000)
    '2026-03-02'
    """
    return f"{datetime.fromtimestamp(t_ns // 10**9, UTC):%Y-%m-%d}"


def _id(trend: Trend) -> TrendId:
    ids: dict[tuple[str, bool], TrendId] = {
        ("step", False): "trend.step",
        ("step", True): "trend.fleet_step",
        ("drift", False): "trend.drift",
        ("drift", True): "trend.fleet_drift",
        ("rate", False): "trend.rate_rising",
        ("rate", True): "trend.fleet_rate_rising",
        ("wear", False): "trend.wear_out",
    }
    return ids[trend.kind, trend.of_fleet]


def _severity(trend: Trend, reaches_ns: int | None, last_ns: int) -> Severity:
    if reaches_ns is not None and reaches_ns - last_ns <= _URGENT_DAYS * DAY_NS:
        return "error"
    return "warning" if trend.change > 0 else "info"


def _forecast(trend: Trend, sync_us: Periods) -> tuple[str, int | None]:
    """What a trend reaches when it goes on so, and when."""
    if trend.reaches:
        return trend.reaches, trend.reaches_ns
    period_us = sync_us.get((trend.lead.machine, trend.lead.bus))
    if trend.tracks.quantity != "pdo-latency" or trend.slope <= 0 or not period_us:
        return "", None
    last_ns = _captures(trend)[3]
    days = (period_us - (trend.after or 0.0)) / (trend.slope * DAY_NS / trend.tracks.bin_ns)
    if not 0 <= days <= _FORECAST_DAYS:
        return "", None
    return f"the SYNC period of {period_us:.0f} us", last_ns + round(days * DAY_NS)


def _captures(trend: Trend) -> tuple[int, int, int, int, int]:
    """Number before and after, when the first and the last began, and the first of the new kind."""
    tracks, members = trend.tracks, np.array(trend.members)
    count = tracks.captures[members]
    first, last = tracks.first[members], tracks.last[members]
    begun = tracks.begun_ns
    first_ns = int(begun[first[first >= 0]].min())
    last_ns = int(begun[last[last >= 0]].max())
    late = first[:, trend.onset :]
    onset_ns = int(begun[late[late >= 0]].min()) if (late >= 0).any() else last_ns
    before = int(count[:, : trend.onset].sum())
    return before, int(count.sum()) - before, first_ns, last_ns, onset_ns


def _evidence(trend: Trend) -> list[str]:
    """Captures: the first, the last before and the first after the onset, the last; of few machines."""
    found: list[str] = []
    tracks = trend.tracks
    for member in trend.members[: _SHOWN if trend.of_fleet else 1]:
        first, last = tracks.first[member], tracks.last[member]
        seen = np.flatnonzero(first >= 0)
        early, late = seen[seen < trend.onset], seen[seen >= trend.onset]
        numbers = [
            number
            for side in (early, late)
            if len(side)
            for number in (int(first[side[0]]), int(last[side[-1]]))
        ]
        found.extend(tracks.capture_id[number] for number in numbers)
    return list(dict.fromkeys(found))


def _text(
    trend: Trend,
    parts: Sequence[str],
    nodes: Sequence[int],
    onset_ns: int,
    reaches: str,
    reaches_ns: int | None,
) -> str:
    who, words = _who(trend, nodes), WORDS[trend.tracks.quantity]
    since = date_text(onset_ns)
    if trend.kind == "wear":
        return f"{who}: {_wear_text(trend, onset_ns)}"
    of = (
        f" of {_listed(parts)}" if trend.tracks.quantity in ("pdo-latency", "encoder-noise") else ""
    )
    values = f"from {_value(trend.before, trend)} to {_value(trend.after, trend)}"
    if trend.kind == "rate":
        return f"{who}: {words} come more often since {since}, {values}"
    if trend.kind == "step":
        moved = "rose" if trend.change > 0 else "fell"
        return f"{who}: {words}{of} {moved} on {since}, {values}"
    moved = "rises" if trend.change > 0 else "falls"
    pace = abs(trend.slope) * DAY_NS / trend.tracks.bin_ns
    unit = QUANTITIES[trend.tracks.quantity].unit
    told = f"{who}: {words}{of} {moved} by {pace:.3g} {unit} a day since {since}, {values}"
    if reaches and reaches_ns is not None:
        told += f"; it reaches {reaches} on {date_text(reaches_ns)}"
    return told


def _wear_text(trend: Trend, onset_ns: int) -> str:
    pace = trend.slope * DAY_NS / trend.tracks.bin_ns
    told = f"the EEPROM has had {trend.after:.0f} writes and gets {pace:.0f} a day"
    reaches_ns = trend.reaches_ns or onset_ns
    if reaches_ns <= _captures(trend)[3]:
        return f"{told}: it has reached {trend.reaches}, which it is rated for"
    return f"{told}: it reaches {trend.reaches} on {date_text(reaches_ns)}"


def _who(trend: Trend, nodes: Sequence[int]) -> str:
    if trend.of_fleet:
        fleet = len({label.machine for label in trend.tracks.labels})
        machines = len(trend.machines)
        count = f"{machines} machines" if machines < fleet else f"All {machines} machines"
        return f"{count}{f' of {fleet}' if machines < fleet else ''}{_of_nodes(trend, nodes)}"
    return f"Machine {trend.lead.machine}{_of_nodes(trend, nodes)}"


def _of_nodes(trend: Trend, nodes: Sequence[int]) -> str:
    if not nodes:
        return f", bus {trend.lead.bus}"
    if len(nodes) == 1:
        name = trend.lead.name
        return f", node {nodes[0]}" + (f" ({name})" if name else "")
    return f", nodes {_listed([str(node) for node in nodes])}"


def _part(label: Label) -> str:
    return label.part if label.node is None else f"node {label.node} {label.part}"


def _listed(words: Sequence[str]) -> str:
    """Up to three words.

    >>> _listed(["a"]), _listed(["a", "b"]), _listed(["a", "b", "c", "d"])
    ('a', 'a and b', 'a, b and 2 more')
    """
    if len(words) > 3:
        return f"{', '.join(words[:2])} and {len(words) - 2} more"
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _value(value: float | None, trend: Trend) -> str:
    if value is None:
        return "unknown"
    unit = QUANTITIES[trend.tracks.quantity].unit
    number = f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return f"{number} {_PER.get(unit, unit)}"


def _same(values: Sequence[str | None]) -> str | None:
    return values[0] if len(set(values)) == 1 else None


def _check_next(trend: Trend) -> str:
    limits = LIMITS[trend.tracks.quantity]
    if trend.of_fleet:
        return f"ask what was changed on these machines on that day; {limits.check_next}"
    if trend.kind == "wear":
        return "plan the exchange of the device; " + limits.check_next
    return limits.check_next
