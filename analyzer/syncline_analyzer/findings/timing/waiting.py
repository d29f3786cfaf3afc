"""Findings on who keeps synchronous PDOs waiting: identifiers, nodes, SDO traffic."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.timing.blame import (
    assumed_window,
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
_SHARE = 1 / 3
"""So much of the time that late answers waited makes frames a cause of it."""
_MOST = 0.5
_FEW = 3
_ENOUGH = 20
_BESIDE_SDO = 0.8
"""So many of the late answers beside SDO traffic make it the cause."""


def _outranked(facts: Facts) -> Iterator[Finding]:
    """Synchronous PDOs that waited for PDOs of other types with lower identifiers."""
    for row in facts.analysis.lateness:
        outranking = {
            pdo.cob_id
            for pdo in facts.analysis.pdos
            if pdo.bus == row.bus and pdo.cob_id < row.cob_id and _not_synchronous(pdo)
        }
        late = [each for each in _others(row, row.blockers) if each.cob_id in outranking]
        if row.late_by_bus and _us(late) >= _SHARE * _us(_others(row, row.blockers)):
            yield _outranked_late(facts, row, late)
            continue
        period_us = _sync_period_us(facts, row.bus)
        long = [
            (wait, ahead)
            for wait in waits_of(facts, row)
            if (ahead := [e for e in _others(row, wait.ahead) if e.cob_id in outranking])
            and period_us
            and _us(ahead) >= _LONG * period_us
        ]
        if len(long) >= _FEW:
            yield _outranked_long(facts, row, long)


def _outranked_late(facts: Facts, row: LatenessRow, late: Sequence[Ahead]) -> Finding:
    waits = _late_waits(facts, row)
    return Finding(
        "pdo.outranked",
        "warning",
        row.bus,
        row.node,
        row.late_first_ns or 0,
        (row.late_last_ns or 0) + 1,
        f"{_name(facts, row)} was late {counted(row.late_by_bus, 'time')} behind frames that are not"
        f" bound to SYNC and go first by their lower identifiers: {_listed(facts, row.bus, late)}.",
        "Identifiers decide who goes first, and by default they follow the node-ID (CiA 301 7.3.5),"
        " not what is urgent: each of these frames that is sent about the time of a SYNC goes ahead.",
        f"Give {row.cob_id:03X}h a lower identifier (180xh:1) than these, or let them be sent less"
        " often (inhibit time 180xh:3, event timer 180xh:5) or as answers to SYNC, too.",
        _evidence(waits),
        assumed=[*_assumed(facts, row), *_assumed_types(facts, row, late)],
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
        assumed=[*_assumed(facts, row), *_assumed_types(facts, row, ahead)],
    )


def _delaying_node(facts: Facts) -> Iterator[Finding]:
    """The node whose frames the synchronous PDOs of others wait for most."""
    for bus in dict.fromkeys(row.bus for row in facts.analysis.delays):
        senders = [r for r in facts.analysis.delays if r.bus == bus and r.cob_id is None]
        total_us = sum(row.us for row in senders)
        nodes = [row for row in senders if row.node is not None]
        if not nodes:
            continue
        most = max(nodes, key=lambda row: row.us)
        late = _late_behind(facts, most)
        if late:
            yield _delaying(facts, most, late)
        elif (
            len(senders) > 1
            and most.us >= _MOST * total_us
            and most.delayed >= _ENOUGH
            and most.worst_us >= _LONG * (_sync_period_us(facts, bus) or float("inf"))
        ):
            yield _delaying(facts, most, [])


def _late_behind(facts: Facts, delay: DelayRow) -> list[LatenessRow]:
    """PDOs that the bus made late, where most of what they waited for came from one node."""
    return [
        row
        for row in facts.analysis.lateness
        if row.bus == delay.bus
        and row.late_by_bus
        and row.node != delay.node
        and _us([e for e in row.blockers if e.node == delay.node])
        >= _MOST * _us(_others(row, row.blockers))
    ]


def _delaying(facts: Facts, delay: DelayRow, late: Sequence[LatenessRow]) -> Finding:
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
    behind = ", ".join(f"{row.cob_id:03X}h" for row in late)
    made = f"; most of what made {behind} late was behind them" if late else ""
    waits = [wait for row in late for wait in _late_waits(facts, row)]
    capture = facts.analysis.capture
    times = [t for row in late for t in (row.late_first_ns, row.late_last_ns) if t is not None]
    return Finding(
        "pdo.delaying_node",
        "warning" if late else "info",
        delay.bus,
        delay.node,
        min(times, default=capture.begin_ns),
        max(times, default=capture.end_ns - 1) + 1,
        f"{facts.who(delay.bus, delay.node)} delays the synchronous PDOs of others most: they waited"
        f" up to {delay.us / 1000:.4g} ms in all for its frames ({told}), one of them up to"
        f" {delay.worst_us / 1000:.4g} ms{made}.",
        "It sends many frames about the time of the SYNC, and they have lower identifiers.",
        "Look at how many PDOs it sends on each SYNC or event (180xh:2, 180xh:3, 180xh:5); give it"
        " higher identifiers where the others are more urgent.",
        sorted({*_evidence(waits), delay.worst_seq}) if late else [delay.worst_seq],
        assumed=[*facts.context.assumed_bitrate(delay.bus), *guessed],
    )


def _sdo(facts: Facts) -> Iterator[Finding]:
    """PDOs that come late while SDO transfers with their node go on."""
    for row in facts.analysis.lateness:
        rare = row.beside_sdo <= _MOST * row.answers
        if rare and row.late_beside_sdo >= max(_FEW, _BESIDE_SDO * row.late):
            yield _beside_sdo(
                facts, row, "warning", f"{row.late_beside_sdo} of {row.late} late answers"
            )
            continue
        period_us = _sync_period_us(facts, row.bus)
        slow, usual = row.device_us_beside_sdo, row.device_us_without_sdo
        if period_us and slow and usual and rare and row.beside_sdo >= _ENOUGH:
            resolution_us = facts.context.resolution_ns / 1000
            if slow.median > usual.p99 + max(_SLOWER * period_us, 2 * resolution_us):
                yield _beside_sdo(facts, row, "info", "the slow answers")
    yield from _behind_sdo(facts)


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
        sdo = [each for each in _others(row, row.blockers) if each.service.startswith("SDO")]
        if not row.late_by_bus or _us(sdo) < _SHARE * _us(_others(row, row.blockers)):
            continue
        yield Finding(
            "sdo.delays_pdo",
            "warning",
            row.bus,
            row.node,
            row.late_first_ns or 0,
            (row.late_last_ns or 0) + 1,
            f"{_name(facts, row)} was late {counted(row.late_by_bus, 'time')} behind SDO traffic:"
            f" {_listed(facts, row.bus, sdo)}.",
            "A program reads or writes objects in a burst while the machine runs.",
            "Let the program wait between two transfers; SDO needs no more than a few frames per"
            " SYNC period.",
            _evidence(_late_waits(facts, row)),
            assumed=_assumed(facts, row),
        )


def _not_synchronous(pdo: PdoRow) -> bool:
    """Whether a PDO is sent by events or a timer, as far as somebody or its frames tell."""
    kind = pdo.transmission_type
    if kind is not None:
        return kind > 0xF0
    return pdo.type_source.startswith("inferred")


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
    return [*facts.context.assumed_bitrate(row.bus), *assumed_window(facts, row)]


def _assumed_types(facts: Facts, row: LatenessRow, ahead: Sequence[Ahead]) -> list[str]:
    """Transmission types of the PDO and those ahead of it that only a device's EDS tells."""
    ids = {row.cob_id, *(each.cob_id for each in ahead[:_FEW])}
    return [
        f"{pdo.cob_id:03X}h is of type {pdo.transmission_type} (eds-default)"
        for pdo in facts.analysis.pdos
        if pdo.bus == row.bus and pdo.cob_id in ids and pdo.type_source == "eds-default"
    ]


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
                "A warning only where answers were late (1007h) that are in time whenever the bus is idle;"
                " else at least three waits of a fifth of the SYNC period."
            ),
            "Frames of the node itself are its own queue and do not count.",
        ),
        _outranked,
    ),
    Rule(
        "pdo.delaying_node",
        "One node delays the synchronous PDOs of others more than all the others do.",
        "The late answers and the frames ahead of them, or the answer that waited longest.",
        (
            _EXACT_STAMPS,
            (
                "A warning only where others were late (1007h) mostly because of it; else a wait of a"
                " fifth of the SYNC period behind its frames alone."
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
                " of the late ones, or slows down the answers by a tenth of the SYNC period."
            ),
            (
                "On the wire an SDO frame delays a PDO by one frame at most unless the PDO has the higher"
                " identifier."
            ),
        ),
        _sdo,
    ),
)
