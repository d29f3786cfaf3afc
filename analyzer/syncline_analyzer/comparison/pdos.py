"""PDOs: which are sent, when, how long, and how fast they answer a SYNC."""

from collections.abc import Iterator
from typing import Any

from syncline_analyzer.comparison.bus import settled_load
from syncline_analyzer.comparison.chance import Sample, more_often, shifted, wider
from syncline_analyzer.comparison.node_presence import ENOUGH
from syncline_analyzer.comparison.periods import period_words
from syncline_analyzer.comparison.rows import ComparisonRow, NotSeenIn, UnseenRow
from syncline_analyzer.comparison.side import Pair, Side, cyclic, rhythmic
from syncline_analyzer.results import PdoRow
from syncline_analyzer.views.words import hex_code, number

_ANSWERS = 30
"""Answers to a SYNC that tell how fast a PDO is."""
_RESPONSE_SHARE, _RESPONSE_US = 0.25, 100.0
"""A response is another one where it is so much off, relatively and absolutely."""
_MISSED = 0.001
"""Share of SYNCs without an answer that is worth a word."""
_SAME_PERIOD = 0.05
_OTHER_LOAD = 0.15
"""Share by which the load of a usual second differs where there is other traffic."""


def pdo_rows(pair: Pair) -> Iterator[ComparisonRow | UnseenRow]:
    """Differences of PDOs; those of nodes that only one capture has are told with the node."""
    golden, capture = pair.golden.pdos, pair.capture.pdos
    for cob_id in sorted(golden.keys() | capture.keys()):
        before, now = golden.get(cob_id), capture.get(cob_id)
        if before is not None and now is not None:
            yield from _changed(pair, before, now)
        else:
            yield from _lone(pair, before, now)


def pdo_name(pair: Pair, row: PdoRow) -> str:
    """A PDO by node, number and identifier."""
    code = hex_code(row.cob_id, 3)
    return f"{pair.who(row.node)}, {row.pdo or 'PDO'} ({code})" if row.node else f"PDO {code}"


def _lone(
    pair: Pair, before: PdoRow | None, now: PdoRow | None
) -> Iterator[ComparisonRow | UnseenRow]:
    """A PDO that only one capture has, though its node is in both."""
    row = before or now
    assert row is not None
    here, there = (pair.golden, pair.capture) if before else (pair.capture, pair.golden)
    if row.node is not None and row.node not in there.nodes:
        return
    name = pdo_name(pair, row)
    side: NotSeenIn = "capture" if before else "golden"
    if (row.cob_id, False) in there.identifiers:
        why = "the identifier is there, but nothing tells whose PDO it is (its node's settings were not seen)"
        yield UnseenRow(pair.bus, row.node, name, side, why)
        return
    ran, runs = here.operational(row.node), there.operational(row.node)
    if not rhythmic(row) or not ran or row.frames / ran * runs < 2 * ENOUGH:
        why = (
            "it comes on events"
            if not rhythmic(row)
            else "its node was not OPERATIONAL long enough"
        )
        yield UnseenRow(pair.bus, row.node, name, side, why)
        return
    count = f"{row.frames:,} in {here.heard}"
    told = [count, "none"] if before else ["none", count]
    yield pair.row(
        "pdo.gone" if before else "pdo.new", "error" if before else "warning", row.node,
        f"{row.pdo or 'PDO'} ({hex_code(row.cob_id, 3)})",
        f"{name}: {told[1]}{f' in {there.heard}' if before else ''}, its node being OPERATIONAL;"
        f" golden: {told[0]}.",
        *told, cob_id=row.cob_id, golden_value=float(before.frames if before else 0),
        capture_value=float(now.frames if now else 0), unit="frames",
        capture_seq=[] if before else _first(there=here, cob_id=row.cob_id),
    )  # fmt: skip


def _first(there: Side, cob_id: int) -> list[int]:
    rows = [row for row in there.of_bus("pdo_lengths") if row.cob_id == cob_id]
    return sorted(row.first_seq for row in rows)[:5]


def _changed(pair: Pair, before: PdoRow, now: PdoRow) -> Iterator[ComparisonRow]:
    yield from _length(pair, before)
    yield from _type(pair, before, now)
    yield from _missed(pair, before, now)
    if pair.timed:
        yield from _response(pair, before, now)


def _length(pair: Pair, before: PdoRow) -> Iterator[ComparisonRow]:
    golden, capture = (_lengths(side, before.cob_id) for side in (pair.golden, pair.capture))
    new = {length: seq for length, seq in capture.items() if length not in golden}
    if not golden or not new:
        return
    told = [_bytes(golden), _bytes(capture)]
    yield pair.row(
        "pdo.length", "warning", before.node, _subject(before),
        f"{pdo_name(pair, before)} is {told[1]} long; golden: {told[0]}.", *told,
        cob_id=before.cob_id, capture_seq=sorted(new.values()), golden_seq=sorted(golden.values()),
        golden_value=float(max(golden)), capture_value=float(max(capture)), unit="bytes",
    )  # fmt: skip


def _lengths(side: Side, cob_id: int) -> dict[int, int]:
    return {r.length: r.first_seq for r in side.of_bus("pdo_lengths") if r.cob_id == cob_id}


def _bytes(lengths: dict[int, int]) -> str:
    return f"{' or '.join(map(str, sorted(lengths)))} bytes"


def _subject(row: PdoRow) -> str:
    return f"{row.pdo or 'PDO'} ({hex_code(row.cob_id, 3)})"


def _type(pair: Pair, before: PdoRow, now: PdoRow) -> Iterator[ComparisonRow]:
    """How often it answers a SYNC, or whether it does at all, by its frames."""
    golden, capture = _when(before), _when(now)
    if golden is None or capture is None or golden == capture or _as_often(before, now):
        return
    yield pair.row(
        "pdo.type", "warning", before.node, _subject(before),
        f"{pdo_name(pair, before)} comes {capture}; golden: {golden}.", golden, capture,
        cob_id=before.cob_id,
    )  # fmt: skip


def _as_often(before: PdoRow, now: PdoRow) -> bool:
    """A timer whose period is whole SYNCs cannot be told from a synchronous PDO by its frames."""
    golden, capture = before.period_us, now.period_us
    if golden is None or capture is None:
        return True
    return abs(capture.median - golden.median) <= _SAME_PERIOD * golden.median


def _when(row: PdoRow) -> str | None:
    """When a PDO comes, None where too few frames tell."""
    if row.every and row.answered >= _ANSWERS:
        return "at every SYNC" if row.every == 1 else f"at every {row.every}. SYNC"
    if row.every is None and cyclic(row) and row.frames >= _ANSWERS:
        return "by a timer"
    return None


def _missed(pair: Pair, before: PdoRow, now: PdoRow) -> Iterator[ComparisonRow]:
    golden, capture = before.missed + before.answered, now.missed + now.answered
    if not golden or not capture or now.missed < max(5, _MISSED * capture):
        return
    if not more_often(now.missed, capture, before.missed, golden):
        return
    told = [f"{r.missed:,} of {n:,} SYNCs" for r, n in ((before, golden), (now, capture))]
    yield pair.row(
        "pdo.missed", "warning", before.node, _subject(before),
        f"{pdo_name(pair, before)} missed {told[1]}; golden: {told[0]}.", *told,
        cob_id=before.cob_id, golden_value=float(before.missed), capture_value=float(now.missed),
        unit="SYNCs", capture_seq=now.missed_seq[:20], weight=now.missed / capture,
    )  # fmt: skip


def _response(pair: Pair, before: PdoRow, now: PdoRow) -> Iterator[ComparisonRow]:
    """How long answers to a SYNC take.

    How long a PDO waits for others hangs on whose answer happens to be ready first: that is told
    only where the bus carries other traffic than in golden.
    """
    golden, capture = before.response_us, now.response_us
    if golden is None or capture is None or min(before.answered, now.answered) < _ANSWERS:
        return
    least = max(
        _RESPONSE_US, _RESPONSE_SHARE * golden.median, before.resolution_us, now.resolution_us
    )
    cause = _device_cause(before, now, least)
    later = capture.median - golden.median
    if cause is None and _other_traffic(pair) and _shifted(before, now, least):
        cause = "the bus carries other traffic"
    common: dict[str, Any] = {
        "cob_id": before.cob_id,
        "unit": "us",
        "golden_value": golden.median,
        "capture_value": capture.median,
        "weight": abs(later) / golden.median,
    }
    told = [period_words(golden), period_words(capture)]
    if cause is not None:
        yield pair.row(
            "pdo.response", "warning" if later > 0 else "info", before.node, _subject(before),
            f"{pdo_name(pair, before)} answers a SYNC after {number(capture.median, 'us')}"
            f" ({cause}); golden: {number(golden.median, 'us')}.",
            *told, golden_seq=_slowest(pair.golden, before), capture_seq=_slowest(pair.capture, before), **common,
        )  # fmt: skip
    elif (spread := _device_spread(pair, before, now, least)) is not None:
        yield pair.row(
            "jitter", "warning", before.node, _subject(before),
            f"{pdo_name(pair, before)}: on an idle bus the device takes times within {spread[1]} of"
            f" one another from SYNC to PDO; golden: within {spread[0]}.",
            *told, golden_seq=_slowest(pair.golden, before), capture_seq=_slowest(pair.capture, before), **common,
        )  # fmt: skip


def _device_cause(before: PdoRow, now: PdoRow, least: float) -> str | None:
    """Words for a device that takes another time whatever the bus did: its bounds lie apart."""
    low, high = now.device_us_least or now.device_us_low, now.device_us_high
    was_low, was_high = before.device_us_least or before.device_us_low, before.device_us_high
    if not (low and high and was_low and was_high):
        return None
    if low.median - was_high.median > least / 2:
        told = [number(value, "us") for value in (was_high.median, low.median)]
        return f"the device takes at least {told[1]}, in golden at most {told[0]}"
    if was_low.median - high.median > least / 2:
        told = [number(value, "us") for value in (was_low.median, high.median)]
        return f"the device takes at most {told[1]}, in golden at least {told[0]}"
    return None


def _shifted(before: PdoRow, now: PdoRow, least: float) -> bool:
    golden, capture = (
        Sample(row.response_us, row.jitter_us, row.answered, row.resolution_us, row.quantile_error)
        for row in (before, now)
        if row.response_us is not None
    )
    return shifted(golden, capture, max(least, golden.spread_us / 2)) is not None


def _device_spread(pair: Pair, before: PdoRow, now: PdoRow, least: float) -> list[str] | None:
    """How far the device's own time scatters in both, where it does so more than in golden."""
    samples = [
        Sample(row.device_us_free, None, _free(side, row.cob_id), row.resolution_us, row.quantile_error)
        for side, row in ((pair.golden, before), (pair.capture, now))
        if row.device_us_free is not None
    ]  # fmt: skip
    if len(samples) < 2 or not wider(samples[0], samples[1], least):
        return None
    return [number(each.spread_us, "us") for each in samples]


def _free(side: Side, cob_id: int) -> int:
    """Answers that found the bus idle."""
    return next((row.free for row in side.of_bus("lateness") if row.cob_id == cob_id), 0)


def _slowest(side: Side, row: PdoRow) -> list[int]:
    found = [each for each in side.of_bus("worst") if each.cob_id == row.cob_id]
    return [each.seq for each in found if each.quantity == "response"][:5]


def _other_traffic(pair: Pair) -> bool:
    """Whether the bus carries more or fewer frames than in golden, or other ones."""
    golden, capture = settled_load(pair.golden), settled_load(pair.capture)
    if golden is None or capture is None:
        return False
    return abs(capture - golden) > _OTHER_LOAD * golden
