"""EEPROMs that reach the writes that they are rated for."""

import re
from functools import cache

import numpy as np

from syncline_analyzer.fleet.trends.limits import ENDURANCE, WEAR_DAYS
from syncline_analyzer.fleet.trends.statistics import Floats
from syncline_analyzer.fleet.trends.tracks import DAY_NS, Tracks
from syncline_analyzer.fleet.trends.trend import Trend

_LEAST_READINGS, _LEAST_DAYS = 4, 7.0
_LAST = 7
_RATED = re.compile(r"rated for at least ([\d ]+)")


def wear_trends(tracks: Tracks) -> list[Trend]:
    """Counters that reach their rating within a year as they went in the later half of the time."""
    trends = (_wear(tracks, number) for number in range(len(tracks.labels)))
    return [trend for trend in trends if trend is not None]


def _wear(tracks: Tracks, number: int) -> Trend | None:
    own = np.isfinite(tracks.reading[number])
    own &= tracks.epoch[number] == tracks.epoch[number].max()
    bins = np.flatnonzero(own)
    if len(bins) < _LEAST_READINGS:
        return None
    reading = tracks.reading[number, bins]
    begun_ns = tracks.begun_ns[tracks.last[number, bins]]
    days = (begun_ns - begun_ns[0]) / DAY_NS
    if days[-1] < _LEAST_DAYS:
        return None
    half = int(np.searchsorted(days, days[-1] / 2))
    # A burst, when a machine was set up, is no pace: of the whole and of the later half the slower,
    # or what is usual between the last readings, where the pace has just become another one.
    usual = float(np.median((np.diff(reading) / np.diff(days))[-_LAST:]))
    pace = max(usual, min(_pace(reading, days, 0), _pace(reading, days, half)))
    device = tracks.labels[number].device
    rated, told = rated_writes(device)
    left = rated - float(reading[-1])
    if pace <= 0 or left > pace * WEAR_DAYS:
        return None
    left_ns = round(max(left, 0.0) / pace * DAY_NS)
    assumed = () if told else (f"rated for {rated} writes, as EEPROMs usually are",)
    return Trend(
        kind="wear",
        tracks=tracks,
        members=(number,),
        of_fleet=False,
        onset=int(bins[0]),
        before=float(reading[0]),
        after=float(reading[-1]),
        change=float(reading[-1] - reading[0]),
        slope=pace * tracks.bin_ns / DAY_NS,
        size=WEAR_DAYS * pace / max(left, pace),
        p=0.0,
        q=0.0,
        reaches=f"{rated} writes",
        reaches_ns=int(begun_ns[-1]) + left_ns,
        assumed=assumed,
    )


def _pace(reading: Floats, days: Floats, begin: int) -> float:
    """Writes a day."""
    time = float(days[-1] - days[begin])
    return float(reading[-1] - reading[begin]) / time if time > 0 else 0.0


@cache
def rated_writes(device: str | None) -> tuple[int, bool]:
    """Writes that a device's EEPROM is rated for, and whether its sheet tells them.

    >>> rated_writes("lir-918"), rated_writes(None)
    ((100000, True), (100000, False))
    """
    from syncline_schemas.devices import device_names, load_device

    if device is not None and device in device_names(()):
        of = load_device(device, ())
        for facts in (of.object(*key) for key in of.health.values()):
            match = _RATED.search(facts.meaning) if facts is not None else None
            if match:
                return int(match[1].replace(" ", "")), True
    return ENDURANCE, False
