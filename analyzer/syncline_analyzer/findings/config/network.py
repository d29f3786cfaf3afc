"""Findings on settings of several nodes that do not go together."""

from collections.abc import Iterator
from itertools import combinations

from syncline_analyzer.findings.config.settings import (
    NodeKey,
    alive,
    assumed_words,
    overlap,
)
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.object_history import Change, Known, Span
from syncline_analyzer.pdo_binding import COMMUNICATION, PDO_COUNT, PdoBindings
from syncline_analyzer.results import Finding
from syncline_analyzer.service_ids import PRODUCES, SYNC, moved_emcy_id, sync_id
from syncline_schemas.canopen.services import predefined_pdo
from syncline_schemas.devices import quirks
from syncline_schemas.records import dataclass

_TPDOS = range(COMMUNICATION["tpdo"], COMMUNICATION["tpdo"] + PDO_COUNT)
_RESERVED = {
    "NMT commands": range(0x001),
    "SDO answers": range(0x581, 0x600),
    "SDO requests": range(0x601, 0x680),
    "error control": range(0x701, 0x780),
    "LSS": range(0x7E4, 0x7E6),
}
"""Identifiers that no PDO may have (CiA 301 7.3.5, table 42), by what uses them."""
_ERROR_CONTROL = (0x1017, 0x100C, 0x100D)
"""Heartbeat time, guard time and life time factor."""


@dataclass(frozen=True, slots=True)
class _Claim:
    """A node sends something on an identifier for as long as `span` holds."""

    can_id: int
    key: NodeKey
    what: str
    index: int
    sub: int
    known: Known
    span: Span


def _claims(facts: Facts) -> Iterator[_Claim]:
    """Identifiers on which nodes that were heard send TPDOs and moved EMCYs."""
    shadow = facts.context.shadow
    bindings = PdoBindings(shadow)
    for number in range(len(facts.context.buses)):
        for node in shadow.nodes_of(number):
            key = (number, node)
            if alive(facts, key):
                yield from _tpdo_claims(facts, bindings, key)
                yield from _emcy_claims(facts, key)


def _tpdo_claims(facts: Facts, bindings: PdoBindings, key: NodeKey) -> Iterator[_Claim]:
    shadow = facts.context.shadow
    device = shadow.device(*key)
    indexes = {index for (index, sub), _ in shadow.history(*key) if index in _TPDOS and sub == 1}
    for index, sub in device.facts if device else ():
        if index in _TPDOS and sub == 1:
            indexes.add(index)
    for index in sorted(indexes):
        tpdo = index - _TPDOS.start + 1
        for span in _spans_of(facts, key, index, 1):
            known = bindings.identifier(*key, "tpdo", tpdo, span.change.seq)
            if known is None or not isinstance(known.value, int):
                continue
            # Files often state nonsense for PDOs beyond the predefined four.
            usual = predefined_pdo(known.value) == ("tpdo", tpdo, key[1])
            if usual or known.source != "eds-default":
                yield _Claim(known.value, key, f"TPDO{tpdo}", index, 1, known, span)


def _emcy_claims(facts: Facts, key: NodeKey) -> Iterator[_Claim]:
    for span in _spans_of(facts, key, 0x1014, 0):
        can_id = moved_emcy_id(facts.context.shadow, *key, span.change.seq)
        known = facts.context.shadow.get(*key, 0x1014, 0, span.change.seq)
        if can_id is not None and known is not None:
            yield _Claim(can_id, key, "EMCY", 0x1014, 0, known, span)


def _spans_of(facts: Facts, key: NodeKey, index: int, sub: int) -> list[Span]:
    """What an object was, with what is assumed of it until the bus tells something."""
    seen = facts.context.shadow.spans(*key, index, sub)
    assumed = facts.context.shadow.assumed(*key, index, sub)
    if assumed is None:
        return seen
    first = seen[0].change if seen else None
    begin = Span(
        Change(-1, facts.analysis.capture.begin_ns, assumed, "reset"),
        first.seq if first else None,
        first.t_ns if first else None,
    )
    # A value that was read first is taken to have held before as well.
    return seen if first is not None and first.cause == "sdo-read" else [begin, *seen]


def _collisions(facts: Facts) -> Iterator[Finding]:
    """Two nodes that send on one identifier."""
    by_id: dict[tuple[int, int], list[_Claim]] = {}
    for claim in _claims(facts):
        by_id.setdefault((claim.key[0], claim.can_id), []).append(claim)
    for (bus, can_id), claims in sorted(by_id.items()):
        for a, b in combinations(claims, 2):
            if a.key == b.key or not (a.known.confirmed or b.known.confirmed):
                continue
            since = overlap(a.span, b.span)
            if since is None:
                continue
            last = max((a, b), key=lambda claim: claim.span.change.seq)
            if any(_in_doubt(facts, claim, last.span.change.t_ns) for claim in (a, b)):
                continue
            who = " and ".join(
                f"{claim.what} of {_lower(facts.who(facts.context.bus_name(bus), claim.key[1]))}"
                for claim in (a, b)
            )
            assumed = [
                f"node {claim.key[1]}: {words}"
                for claim in (a, b)
                for words in assumed_words(claim.index, claim.sub, claim.known)
            ]
            yield Finding(
                "config.cob_id_collision",
                "info" if assumed else "warning",
                facts.context.bus_name(bus),
                last.key[1],
                max(last.span.change.t_ns, facts.analysis.capture.begin_ns),
                facts.analysis.capture.end_ns,
                f"{who} use the same identifier {can_id:03X}h: two nodes must not send on one.",
                "A PDO or EMCY was moved onto an identifier that another node already has.",
                f"COB-IDs of both; whoever receives {can_id:03X}h cannot tell the two apart, and "
                "frames of both at once destroy one another.",
                sorted(claim.known.seq for claim in (a, b) if claim.known.seq is not None),
                assumed=assumed,
            )
            break


def _in_doubt(facts: Facts, claim: _Claim, t_ns: int) -> bool:
    """Whether a capture gap before a moment may hide that a claim is not that of its node.

    A node that is not heard any more may have another number since the gap, with the identifiers
    that it had; answers that come since then and nothing else of their node are perhaps those of
    another one, whose SDO server was moved (1200h).
    """
    bus = facts.context.bus_name(claim.key[0])
    gaps = [gap for gap in facts.analysis.capture.gaps if gap.bus in (None, bus)]
    end_ns = max((gap.end_ns for gap in gaps if gap.end_ns <= t_ns), default=None)
    nmt = facts.control.nmt.nodes.get(claim.key)
    if end_ns is None:
        return False
    if nmt is not None and nmt.heard_ns is not None:
        return nmt.heard_ns < end_ns
    own = facts.analysis.sdo.of_node(bus, claim.key[1])
    return bool((own.records["start_ns"] >= end_ns).all())


def _reserved(facts: Facts) -> Iterator[Finding]:
    """PDOs on identifiers that belong to another service."""
    told: set[tuple[NodeKey, int]] = set()
    for claim in _claims(facts):
        uses = next((what for what, ids in _RESERVED.items() if claim.can_id in ids), None)
        if uses is None or not claim.known.confirmed or (claim.key, claim.can_id) in told:
            continue
        told.add((claim.key, claim.can_id))
        bus = facts.context.bus_name(claim.key[0])
        yield Finding(
            "config.cob_id_reserved",
            "warning",
            bus,
            claim.key[1],
            claim.span.change.t_ns,
            claim.span.until_ns or facts.analysis.capture.end_ns,
            f"{claim.what} of {_lower(facts.who(bus, claim.key[1]))} is set to {claim.can_id:03X}h, "
            f"which belongs to {uses}.",
            "A wrong COB-ID was written, or the node id was added twice.",
            f"{claim.index:04X}h:{claim.sub} of the node; every frame of it is taken for {uses}.",
            [claim.known.seq] if claim.known.seq is not None else [],
        )


def _lower(who: str) -> str:
    return who[0].lower() + who[1:]


def _sync_producers(facts: Facts) -> Iterator[Finding]:
    """Two nodes that are told to send the same SYNC."""
    shadow = facts.context.shadow
    producers = [
        (key, span)
        for key in sorted(shadow.nodes())
        if alive(facts, key) and shadow.confirmed(*key, 0x1006) != 0
        for span in shadow.spans(*key, SYNC)
        if span.change.known is not None
        and isinstance(span.change.known.value, int)
        and span.change.known.value & PRODUCES
    ]
    for (a, of_a), (b, of_b) in combinations(producers, 2):
        if a[0] != b[0] or a == b or (since := overlap(of_a, of_b)) is None:
            continue
        ids = [sync_id(shadow, *key, since) for key in (a, b)]
        if ids[0] != ids[1]:
            continue
        last = max(of_a, of_b, key=lambda span: span.change.seq).change
        bus = facts.context.bus_name(a[0])
        yield Finding(
            "config.sync_producers",
            "warning",
            bus,
            None,
            last.t_ns,
            facts.analysis.capture.end_ns,
            f"{facts.who(bus, a[1])} and {_lower(facts.who(bus, b[1]))} both produce the SYNC "
            f"{ids[0]:03X}h (1005h bit 30 is set in both).",
            "A bus has one SYNC producer; the second one was configured by mistake.",
            "Which node or master is to send the SYNC; clear bit 30 of 1005h in the other.",
            sorted((of_a.change.seq, of_b.change.seq)),
        )


def _both_error_controls(facts: Facts) -> Iterator[Finding]:
    """Heartbeat and guarding set on a device whose maker does not say which of them wins."""
    shadow = facts.context.shadow
    for key in sorted(shadow.nodes()):
        device = shadow.device(*key)
        values = [shadow.confirmed(*key, index) for index in _ERROR_CONTROL]
        if device is None or device.quirks.heartbeat_wins is not None or not all(values):
            continue
        changes = [shadow.spans(*key, index)[-1].change for index in _ERROR_CONTROL]
        last = max(changes, key=lambda change: change.seq)
        bus = facts.context.bus_name(key[0])
        heartbeat, guard, factor = values
        yield Finding(
            "config.guarding_and_heartbeat",
            "warning",
            bus,
            key[1],
            last.t_ns,
            last.t_ns,
            f"{facts.who(bus, key[1])} is set to heartbeat (1017h = {heartbeat} ms) and to guarding"
            f" (100Ch = {guard} ms, 100Dh = {factor}) at once.",
            "Only one of both is allowed (CiA 301 7.2.8.3.2.2), and the maker of this device does"
            " not say which one wins.",
            "Set 1017h or 100Ch to 0, as the master supervises the node.",
            sorted(change.seq for change in changes),
        )


def _short_consumers(facts: Facts) -> Iterator[Finding]:
    """Heartbeat consumers that wait no longer than the producer takes."""
    shadow = facts.context.shadow
    for key in sorted(shadow.nodes()):
        if not quirks(shadow.device(*key)).consumes_heartbeat or not alive(facts, key):
            continue
        for (index, sub), _ in shadow.history(*key):
            watch = shadow.get(*key, index, sub) if index == 0x1016 and sub else None
            if watch is None or not watch.confirmed or not isinstance(watch.value, int):
                continue
            producer, wait_ms = watch.value >> 16 & 0x7F, watch.value & 0xFFFF
            if producer and wait_ms:
                yield from _short(facts, key, sub, watch, (key[0], producer), wait_ms)


def _short(
    facts: Facts, key: NodeKey, sub: int, watch: Known, producer: NodeKey, wait_ms: int
) -> Iterator[Finding]:
    sent = facts.context.shadow.get(*producer, 0x1017)
    period_ms = sent.value if sent is not None and isinstance(sent.value, int) else 0
    if not alive(facts, producer) or not 0 < wait_ms <= period_ms:
        return
    bus = facts.context.bus_name(key[0])
    seqs = [known.seq for known in (watch, sent) if known is not None and known.seq is not None]
    assumed = assumed_words(0x1017, 0, sent)
    yield Finding(
        "config.heartbeat_consumer",
        "info" if assumed else "warning",
        bus,
        key[1],
        watch.t_ns or facts.analysis.capture.begin_ns,
        facts.analysis.capture.end_ns,
        f"{facts.who(bus, key[1])} waits {wait_ms} ms for the heartbeat of {facts.inside(bus, producer[1])} "
        f"(1016h:{sub}), which is set to send one every {period_ms} ms (1017h): it will take a "
        "healthy node for lost.",
        "Consumer and producer heartbeat times were set without regard to one another.",
        "Set 1016h of the consumer to at least 1.5 times 1017h of the producer.",
        sorted(seqs),
        assumed=assumed,
    )


RULES: tuple[Rule, ...] = (
    Rule(
        "config.cob_id_collision",
        "Two nodes are set to send on the same identifier.",
        "The transfers that told or wrote the COB-IDs.",
        (
            "Both nodes must have been heard, and both settings hold at the same time.",
            "At least one of the two was told or acknowledged by its node.",
            "An info where the other is only assumed: it may have been moved before the capture.",
            "PDOs that are off (bit 31, or identifier 0) do not count, nor do receivers.",
            "Not where a gap may hide that one of the two is the other: it is heard no more after it.",
            "Nor where one only answers SDO requests since a gap: 1200h may have been written in it.",
        ),
        _collisions,
        untimed=True,
    ),
    Rule(
        "config.cob_id_reserved",
        "A PDO is set to an identifier that belongs to NMT, SDO, error control or LSS.",
        "The transfer that told or wrote the COB-ID.",
        ("Only identifiers that the node itself told or acknowledged, and only PDOs that are on.",),
        _reserved,
        untimed=True,
    ),
    Rule(
        "config.sync_producers",
        "Two nodes are set to produce the same SYNC.",
        "The transfers that told or wrote 1005h with bit 30.",
        (
            "Both nodes must have been heard, and both settings hold at the same time.",
            "A node whose cycle period 1006h is 0 sends none.",
        ),
        _sync_producers,
        untimed=True,
    ),
    Rule(
        "config.guarding_and_heartbeat",
        "Heartbeat and node guarding are both set on one device.",
        "The transfers that told or wrote 1017h, 100Ch and 100Dh.",
        (
            "Only values that the node itself told or acknowledged.",
            "Silent where the device's maker says that heartbeat wins.",
        ),
        _both_error_controls,
        untimed=True,
    ),
    Rule(
        "config.heartbeat_consumer",
        "A node is set to wait no longer for a heartbeat than its producer is set to take.",
        "The transfers that told or wrote 1016h of the one and 1017h of the other.",
        (
            "The values at the end of the capture count, and both nodes must have been heard.",
            "Devices that are known not to watch anybody are left out.",
        ),
        _short_consumers,
        untimed=True,
    ),
)
