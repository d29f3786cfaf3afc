"""Findings on who keeps synchronous PDOs waiting: identifiers, nodes, SDO traffic."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.timing.blame import (
    Behind,
    assumed_window,
    behind,
    frames_of,
    is_guess,
    is_own,
    waits_of,
)
from syncline_analyzer.results import (
    Ahead,
    DelayRow,
    Finding,
    LatenessRow,
    PdoRow,
    Quantiles,
    WaitRow,
)
from syncline_schemas.wording import counted

_LONG = 0.2
"""Share of the SYNC period that is a long wait."""
_SLOWER = 0.1
"""Share of the SYNC period by which SDO traffic must slow down the answers."""
_MOST = 0.5
_FEW = 3
_ENOUGH = 20
_SEVERAL = 1.5
"""Frames of a node ahead of each late answer that are more than one PDO per SYNC."""
_MOSTLY = 0.9
_LAST_SYNCHRONOUS = 0xF0
_IN_STEP = 0.05
"""Distances of a PDO off a whole number of SYNC periods by less may come from SYNC [periods]."""
_BESIDE_SDO = 0.8
"""So many of the late answers beside SDO traffic make it the cause."""
_CHANCE = 0.01


def _outranked(facts: Facts) -> Iterator[Finding]:
    """Synchronous PDOs that waited for PDOs of other types with lower identifiers."""
    for row in facts.analysis.lateness:
        told, inferred = _outranking(facts, row)
        late = behind(facts, row, _among(told))
        if late:
            yield _outranked_late(facts, row, late)
            continue
        late = behind(facts, row, _among(told | inferred))
        if late:
            yield replace(_outranked_late(facts, row, late), severity="info")
            continue
        period_us = _sync_period_us(facts, row.bus)
        long = [
            (wait, ahead)
            for wait in waits_of(facts, row)
            if (ahead := [e for e in _others(row, wait.ahead) if e.cob_id in told | inferred])
            and period_us
            and _us(ahead) >= _LONG * period_us
        ]
        if len(long) >= _FEW:
            yield _outranked_long(facts, row, long)


def _outranking(facts: Facts, row: LatenessRow) -> tuple[set[int], set[int]]:
    """PDOs of lower identifiers that are not bound to SYNC: as told, and by their frames alone."""
    lower = [p for p in facts.analysis.pdos if p.bus == row.bus and p.cob_id < row.cob_id]
    told = {p.cob_id for p in lower if (p.transmission_type or 0) > _LAST_SYNCHRONOUS}
    period_us = _sync_period_us(facts, row.bus)
    inferred = {
        p.cob_id
        for p in lower
        if p.transmission_type is None
        and p.type_source.startswith("inferred")
        and not _in_step(p, period_us)
    }
    return told, inferred


def _in_step(pdo: PdoRow, sync_us: float | None) -> bool:
    """Whether the distances of a PDO are whole SYNC periods: it may answer some SYNCs (type 0)."""
    if not sync_us or pdo.period_us is None:
        return False
    periods = pdo.period_us.median / sync_us
    return round(periods) > 0 and abs(periods - round(periods)) <= _IN_STEP


def _outranked_late(facts: Facts, row: LatenessRow, late: Behind) -> Finding:
    waits = _late_waits(facts, row)
    return Finding(
        "pdo.outranked",
        "warning",
        row.bus,
        row.node,
        row.late_first_ns or 0,
        (row.late_last_ns or 0) + 1,
        f"{_name(facts, row)} was late {late} behind frames that are not bound to"
        f" SYNC and go first by their lower identifiers: {_listed(facts, row.bus, late.ahead)}.",
        "Identifiers decide who goes first, and by default they follow the node-ID (CiA 301 7.3.5),"
        " not what is urgent: each of these frames that is sent about the time of a SYNC goes ahead.",
        f"Give {row.cob_id:03X}h a lower identifier (180xh:1) than these, or let them be sent less"
        " often (inhibit time 180xh:3, event timer 180xh:5) or as answers to SYNC, too.",
        _evidence(waits),
        assumed=[*_assumed(facts, row), *_assumed_ahead(facts, row, late.ahead)],
    )


def _outranked_long(
    facts: Facts, row: LatenessRow, long: Sequence[tuple[WaitRow, list[Ahead]]]
) -> Finding:
    worst = max(_us(ahead) for _, ahead in long)
    ahead = _joined(each for _, found in long for each in found)
    waits = [wait for wait, _ in long]
    return Finding(
        "pdo.outranked",
        "info",
        row.bus,
        row.node,
        min(wait.t_ns for wait in waits),
        max(wait.t_ns for wait in waits) + 1,
        f"{_name(facts, row)} answers SYNC, but can have waited up to {worst / 1000:.4g} ms for"
        " frames that are not bound to SYNC and go first by their lower identifiers:"
        f" {_listed(facts, row.bus, ahead)}.",
        "Identifiers decide who goes first, and by default they follow the node-ID (CiA 301 7.3.5),"
        " not what is urgent.",
        f"Where {row.cob_id:03X}h is the more urgent one, give it a lower identifier (180xh:1) than"
        " these.",
        _evidence([wait for wait in waits if not _is_late(wait, row)]),
        assumed=[*_assumed(facts, row), *_assumed_ahead(facts, row, ahead)],
    )


def _delaying_node(facts: Facts) -> Iterator[Finding]:
    """Nodes whose frames make the synchronous PDOs of others late, or keep them waiting most."""
    for bus in dict.fromkeys(row.bus for row in facts.analysis.delays):
        senders = [r for r in facts.analysis.delays if r.bus == bus and r.cob_id is None]
        total_us = sum(row.us for row in senders)
        nodes = [row for row in senders if row.node is not None]
        late = [(row, _late_behind(facts, row)) for row in nodes]
        accused = [(row, blamed) for row, blamed in late if blamed]
        for row, blamed in accused:
            yield _delaying_late(facts, row, blamed)
        if accused or not nodes:
            continue
        most = max(nodes, key=lambda row: row.us)
        if (
            len(senders) > 1
            and most.us >= _MOST * total_us
            and most.delayed >= _ENOUGH
            and most.worst_us >= _LONG * (_sync_period_us(facts, bus) or float("inf"))
        ):
            yield _delaying(facts, most)


def _late_behind(facts: Facts, delay: DelayRow) -> list[tuple[LatenessRow, Behind]]:
    """PDOs that are late mostly because of several frames of one node each time."""
    found = []
    for row in facts.analysis.lateness:
        if row.bus != delay.bus or row.node == delay.node:
            continue
        late = behind(facts, row, _of_node(delay.node), _MOST)
        if late is None or sum(each.frames for each in late.ahead) < _SEVERAL * late.found:
            continue
        own = [each for each in row.blockers if each.node == delay.node]
        if _us(own) >= _MOST * _us(_others(row, row.blockers)):
            found.append((row, late))
    return found


def _delaying_late(
    facts: Facts, delay: DelayRow, late: Sequence[tuple[LatenessRow, Behind]]
) -> Finding:
    assert delay.node is not None
    ahead = _joined(each for _, found in late for each in found.ahead)
    made = ", ".join(f"{row.cob_id:03X}h late {found}" for row, found in late[:_FEW])
    more = f" and {len(late) - _FEW} other PDOs" if len(late) > _FEW else ""
    frames, answers = (
        sum(each.frames for each in ahead),
        sum(found.found for _, found in late),
    )
    first = [(each.us, each.cob_id < row.cob_id) for row, found in late for each in found.ahead]
    times = [t for row, _ in late for t in (row.late_first_ns, row.late_last_ns) if t is not None]
    waits = [wait for row, _ in late for wait in _late_waits(facts, row)]
    return Finding(
        "pdo.delaying_node",
        "warning",
        delay.bus,
        delay.node,
        min(times),
        max(times) + 1,
        f"{facts.who(delay.bus, delay.node)} made {made}{more}: they would have been in time without"
        f" its frames ahead of them ({_listed(facts, delay.bus, ahead)}).",
        *_why_first(frames / answers, first),
        sorted({*_evidence(waits), *(seq for row, _ in late for seq in row.late_seq)}),
        assumed=[
            *dict.fromkeys(
                text
                for row, found in late
                for text in (*_assumed(facts, row), *_assumed_ahead(facts, row, found.ahead))
            )
        ],
    )


def _delaying(facts: Facts, delay: DelayRow) -> Finding:
    assert delay.node is not None
    own = [r for r in facts.analysis.delays if (r.bus, r.node) == (delay.bus, delay.node)]
    frames = [row for row in own if row.cob_id is not None]
    told = ", ".join(
        f"{row.service.split(' (')[0]} ({row.cob_id:03X}h) {row.us / 1000:.4g} ms"
        for row in frames[:_FEW]
    )
    guessed = [
        f"{row.cob_id:03X}h comes from node {row.node} (by its identifier alone)"
        for row in frames[:_FEW]
        if is_guess(row.service)
    ]
    first = [(row.us, (row.cob_id or 0) < row.worst_cob_id) for row in frames]
    capture = facts.analysis.capture
    return Finding(
        "pdo.delaying_node",
        "info",
        delay.bus,
        delay.node,
        capture.begin_ns,
        capture.end_ns,
        f"{facts.who(delay.bus, delay.node)} delays the synchronous PDOs of others most: they waited"
        f" up to {delay.us / 1000:.4g} ms in all for its frames ({told}), one of them up to"
        f" {delay.worst_us / 1000:.4g} ms.",
        *_why_first(delay.frames / delay.delayed, first),
        [delay.worst_seq],
        assumed=[*facts.context.assumed_wire(delay.bus), *guessed],
    )


def _why_first(each: float, first: Sequence[tuple[float, bool]]) -> tuple[str, str]:
    """Why frames go ahead of those of others, and what to check next.

    Args:
        each: how many of them go ahead of an answer on average.
        first: time on the wire, and whether they win by a lower identifier, of each identifier.
    """
    lower_us, all_us = sum(us for us, lower in first if lower), sum(us for us, _ in first)
    often = f"On average {each:.1f} of its frames go ahead of an answer that waits for it"
    sends = "Look at when it sends them and how many (180xh:2, 180xh:3, 180xh:5)"
    if lower_us >= _MOSTLY * all_us:
        return (
            f"{often}; they have lower identifiers.",
            f"{sends}; give it higher identifiers where the others are more urgent.",
        )
    if lower_us > (1 - _MOSTLY) * all_us:
        return (
            f"{often}; part of them have lower identifiers, the others were on the wire first.",
            f"{sends}; higher identifiers help against the first ones only.",
        )
    return (
        f"{often}; they were on the wire first, though their identifiers are higher.",
        f"{sends}; other identifiers would change little.",
    )


def _sdo(facts: Facts) -> Iterator[Finding]:
    """PDOs that come late while SDO transfers with their node go on."""
    for row in facts.analysis.lateness:
        rare = row.beside_sdo <= _MOST * row.answers
        if rare and _late_beside_sdo(row):
            which = (
                f"{row.late_by_device_beside_sdo} of {row.late_by_device} answers that the device"
            )
            yield _beside_sdo(facts, row, "warning", f"{which} itself made late")
            continue
        period_us = _sync_period_us(facts, row.bus)
        slow, usual = row.device_us_beside_sdo, row.device_us_without_sdo
        if period_us and slow and usual and rare and row.beside_sdo >= _ENOUGH:
            resolution_us = facts.context.resolution_ns / 1000
            more_us = max(_SLOWER * period_us, 2 * resolution_us)
            if slow.median > max(usual.p99, _at_most_us(facts, row)) + more_us:
                yield _beside_sdo(facts, row, "info", "the slow answers")
    yield from _behind_sdo(facts)


def _late_beside_sdo(row: LatenessRow) -> bool:
    """Whether what the device made late itself comes beside SDO traffic, and not by chance."""
    late, beside = row.late_by_device, row.late_by_device_beside_sdo
    if beside < max(_FEW, _BESIDE_SDO * late) or not row.beside_sdo:
        return False
    # Chernoff's bound of the chance to find so many of them beside it.
    share, usual = beside / late, row.beside_sdo / row.answers
    bits = share * math.log(share / usual)
    if share < 1:
        bits += (1 - share) * math.log((1 - share) / (1 - usual))
    return late * bits >= -math.log(_CHANCE)


def _at_most_us(facts: Facts, row: LatenessRow) -> float:
    """Half of the answers took the device no longer than this."""
    pdos = facts.analysis.pdos
    pdo = next((p for p in pdos if (p.bus, p.cob_id) == (row.bus, row.cob_id)), None)
    return pdo.device_us_high.median if pdo and pdo.device_us_high else float("inf")


def _beside_sdo(facts: Facts, row: LatenessRow, severity: str, which: str) -> Finding:
    late = severity == "warning"
    chosen = _late_waits(facts, row) if late else waits_of(facts, row)
    waits = [wait for wait in chosen if late or not _is_late(wait, row)]
    return Finding(
        "sdo.delays_pdo",
        "warning" if late else "info",
        row.bus,
        row.node,
        min((wait.t_ns for wait in waits), default=facts.analysis.capture.begin_ns),
        max((wait.t_ns for wait in waits), default=facts.analysis.capture.begin_ns) + 1,
        f"{_name(facts, row)} answers SYNC later while SDO transfers with its node go on: {which}"
        f" come beside them, though only {row.beside_sdo} of {row.answers} answers do; the device"
        f" then takes {_median(row.device_us_beside_sdo)}, else {_median(row.device_us_without_sdo)}"
        " (median of the least it can have taken).",
        "The device works off SDO requests before it sends its PDOs.",
        "Read and write its objects less often while the machine runs, or let the program wait"
        " between two transfers.",
        _evidence(waits),
        assumed=_assumed(facts, row),
    )


def _behind_sdo(facts: Facts) -> Iterator[Finding]:
    """PDOs that SDO frames on the wire made late."""
    for row in facts.analysis.lateness:
        late = behind(facts, row, _is_sdo)
        if late is None:
            continue
        yield Finding(
            "sdo.delays_pdo",
            "warning",
            row.bus,
            row.node,
            row.late_first_ns or 0,
            (row.late_last_ns or 0) + 1,
            f"{_name(facts, row)} was late {late} behind SDO traffic:"
            f" {_listed(facts, row.bus, late.ahead)}.",
            "A program reads or writes objects in a burst while the machine runs.",
            "Let the program wait between two transfers; SDO needs no more than a few frames per"
            " SYNC period.",
            _evidence(_late_waits(facts, row)),
            assumed=_assumed(facts, row),
        )


def _is_sdo(each: Ahead) -> bool:
    return each.service.startswith("SDO")


def _among(ids: set[int]) -> Callable[[Ahead], bool]:
    """Picks the frames of some identifiers."""
    return lambda each: each.cob_id in ids


def _of_node(node: int | None) -> Callable[[Ahead], bool]:
    """Picks the frames of a node."""
    return lambda each: each.node == node


def _others(row: LatenessRow, ahead: Sequence[Ahead]) -> list[Ahead]:
    return [each for each in ahead if not is_own(each, row.node)]


def _us(ahead: Sequence[Ahead]) -> float:
    return sum(each.us for each in ahead)


def _joined(ahead: Iterator[Ahead]) -> list[Ahead]:
    """Summed up by identifier, the longest first."""
    found: dict[tuple[int, str], Ahead] = {}
    for each in ahead:
        old = found.get((each.cob_id, each.service))
        if old is not None:
            each = replace(each, frames=old.frames + each.frames, us=old.us + each.us)
        found[each.cob_id, each.service] = each
    return sorted(found.values(), key=lambda each: -each.us)


def _listed(facts: Facts, bus: str, ahead: Sequence[Ahead]) -> str:
    """The frames with their time, the longest first."""
    first = ", ".join(
        f"{frames_of(facts, bus, each)} {each.us / 1000:.4g} ms in {counted(each.frames, 'frame')}"
        for each in ahead[:_FEW]
    )
    return f"{first} and others" if len(ahead) > _FEW else first


def _late_waits(facts: Facts, row: LatenessRow) -> list[WaitRow]:
    """Those of the worst answers that were late."""
    return [wait for wait in waits_of(facts, row) if _is_late(wait, row)]


def _is_late(wait: WaitRow, row: LatenessRow) -> bool:
    return row.window_us is not None and wait.response_us > row.window_us


def _evidence(waits: Sequence[WaitRow]) -> list[int]:
    """The answers and the frames ahead of them."""
    ahead = (seq for wait in waits for each in wait.ahead for seq in each.seq[:_FEW])
    return sorted({*(wait.seq for wait in waits), *ahead})


def _assumed(facts: Facts, row: LatenessRow) -> list[str]:
    """What the times of a PDO rest on."""
    return [*facts.context.assumed_wire(row.bus), *assumed_window(facts, row)]


def _assumed_ahead(facts: Facts, row: LatenessRow, ahead: Sequence[Ahead]) -> list[str]:
    """Senders and transmission types of the frames ahead that nobody told for certain."""
    named = ahead[:_FEW]
    ids = {row.cob_id, *(each.cob_id for each in named)}
    guessed = [_assumed_sender(each) for each in named if is_guess(each.service)]
    types = [
        _assumed_type(pdo)
        for pdo in facts.analysis.pdos
        if pdo.bus == row.bus and pdo.cob_id in ids and _is_assumed(pdo)
    ]
    return [*guessed, *types]


def _assumed_sender(each: Ahead) -> str:
    if each.node is None:
        return f"{each.cob_id:03X}h is a PDO (by its identifier alone)"
    return f"{each.cob_id:03X}h comes from node {each.node} (by its identifier alone)"


def _is_assumed(pdo: PdoRow) -> bool:
    inferred = pdo.transmission_type is None and pdo.type_source.startswith("inferred")
    return inferred or pdo.type_source == "eds-default"


def _assumed_type(pdo: PdoRow) -> str:
    if pdo.type_source == "eds-default":
        return f"{pdo.cob_id:03X}h is of type {pdo.transmission_type} (eds-default)"
    return (
        f"{pdo.cob_id:03X}h is {pdo.type_source.removeprefix('inferred: ')} (by its frames alone)"
    )


def _sync_period_us(facts: Facts, bus: str) -> float | None:
    """Median of the fastest SYNC of a bus."""
    periods = [
        row.period_us.median for row in facts.analysis.sync if row.bus == bus and row.period_us
    ]
    return min(periods, default=None)


def _median(quantiles: Quantiles | None) -> str:
    return f"{quantiles.median / 1000:.4g} ms" if quantiles else "unknown time"


def _name(facts: Facts, row: LatenessRow) -> str:
    if row.node is None or row.pdo is None:
        return f"A PDO ({row.cob_id:03X}h)"
    return f"{facts.who(row.bus, row.node)}: {row.pdo.split()[0]} ({row.cob_id:03X}h)"


_EXACT_STAMPS = (
    "Only where the bit rate is known and the stamps are exact enough to tell which frames followed"
    " one another: not with stamps of 1 ms, of bundles, or beside error frames."
)

RULES = (
    Rule(
        "pdo.outranked",
        "A synchronous PDO waits for PDOs that are not bound to SYNC and have lower identifiers.",
        "The answers that waited longest, or were late, and the frames ahead of them.",
        (
            _EXACT_STAMPS,
            (
                "A warning only where answers were late (1007h) that would have been in time without these"
                " frames, and the device itself was never late; else at least three waits of a fifth of"
                " the SYNC period."
            ),
            (
                "A PDO whose transmission type nobody tells makes a note at most, and none where its"
                " distances are whole SYNC periods: it may answer some SYNCs."
            ),
            "Frames of the node itself are its own queue and do not count.",
        ),
        _outranked,
    ),
    Rule(
        "pdo.delaying_node",
        "The frames of one node make synchronous PDOs of others late, or delay them most.",
        "The late answers and the frames ahead of them, or the answer that waited longest.",
        (
            _EXACT_STAMPS,
            (
                "A warning only where others were late (1007h) and would have been in time without its"
                " frames, several of them ahead of each: one PDO for each SYNC accuses nobody; else a"
                " wait of a fifth of the SYNC period behind its frames alone."
            ),
        ),
        _delaying_node,
    ),
    Rule(
        "sdo.delays_pdo",
        "A synchronous PDO comes late while SDO transfers go on.",
        "The late answers, or the slowest ones, and the frames ahead of them.",
        (
            _EXACT_STAMPS,
            (
                "Only where SDO traffic stands beside at most half of the answers, but beside four fifths"
                " of those that the device itself made late, more than by chance; or where the device"
                " takes longer beside it for certain, by a tenth of the SYNC period."
            ),
            ("Late behind SDO frames are only answers that would have been in time without them."),
        ),
        _sdo,
    ),
)
