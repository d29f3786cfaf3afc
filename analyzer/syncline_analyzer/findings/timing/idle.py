"""Findings on PDOs that are not sent at all, or more often than the bus can carry."""

from collections.abc import Iterator, Sequence
from dataclasses import field

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.object_history import Known
from syncline_analyzer.pdo_binding import Pdo, PdoBindings
from syncline_analyzer.results import Finding, NodeRow
from syncline_analyzer.service_ids import FRAME_29_BIT, cob_id
from syncline_schemas.devices import quirks
from syncline_schemas.records import dataclass

SILENT_NS = 5_000_000_000
"""A node must have been OPERATIONAL for so long [ns]."""
FULL = 0.8
"""Share of the bit rate from which on settings alone fill a bus."""
_OFF = 1 << 31
_LAST_SYNC_TYPE = 240
_NO_SYNC = "waits for SYNC"
_DUE = (", and did not", ", and did not come")
"""Ends of what is told of a PDO that should have come."""


@dataclass(slots=True)
class _Reason:
    """Why a PDO does not come, and on what the reason rests."""

    text: str
    assumed: list[str] = field(default_factory=list)


def _silent(facts: Facts) -> Iterator[Finding]:
    """Nodes that are OPERATIONAL and send no PDO, with the reason for each PDO."""
    bindings = PdoBindings(facts.context.shadow)
    sending = {(pdo.bus, pdo.node) for pdo in facts.analysis.pdos if _is_sent(pdo.pdo)}
    for row in facts.analysis.nodes:
        lasted_ns, first_ns, last_ns, evidence = _operational(facts, row)
        if (row.bus, row.node) in sending or lasted_ns < SILENT_NS:
            continue
        pdos = _pdos(facts, row)
        if not pdos or any(_may_be_sent(facts, row, pdo) for pdo in pdos):
            continue
        reasons = [_reason(facts, bindings, row, pdo) for pdo in pdos]
        told = "; ".join(
            f"TPDO{pdo.number} ({_cob_id(facts, row, pdo)}) {reason.text}"
            for pdo, reason in zip(pdos, reasons, strict=True)
        )
        cause, check_next = _cause(reasons)
        yield Finding(
            "pdo.silent",
            "info",
            row.bus,
            row.node,
            first_ns,
            last_ns,
            f"{facts.who(row.bus, row.node)} was OPERATIONAL for {seconds(lasted_ns)} and sent no PDO:"
            f" {told}.",
            cause,
            check_next,
            evidence,
            assumed=[each for reason in reasons for each in reason.assumed],
        )


def _cause(reasons: Sequence[_Reason]) -> tuple[str, str]:
    """Likely cause of a node's silence, and what to check."""
    if any(reason.text.endswith(_DUE) for reason in reasons):
        return (
            "Its settings are others than those, or its application stopped; the node is alive.",
            "Read 180xh:1, 2 and 5, 1001h and 1003h of the node.",
        )
    if any(_NO_SYNC in reason.text for reason in reasons):
        return (
            "It waits for a SYNC that nobody sends; the node itself is alive.",
            "Is there to be a SYNC producer (1006h of the master)?",
        )
    return (
        "Its settings; the node itself is alive.",
        "Read 180xh:1, 2 and 5 of the node where they are not known.",
    )


def _is_sent(name: str | None) -> bool:
    return (name or "").startswith("TPDO")


def _may_be_sent(facts: Facts, row: NodeRow, pdo: Pdo) -> bool:
    """Whether a PDO is set to an identifier of 29 bits, or to one that another node sends on too."""
    known = facts.context.shadow.get(pdo.bus, row.node, pdo.communication, 1)
    if known is None or not isinstance(known.value, int) or known.value & _OFF:
        return False
    if known.value & FRAME_29_BIT:
        return True
    others = (sent for sent in facts.analysis.pdos if sent.bus == row.bus and sent.node != row.node)
    return known.confirmed and any(
        _is_sent(sent.pdo) and sent.frames and sent.cob_id == cob_id(known.value) for sent in others
    )


def _operational(facts: Facts, row: NodeRow) -> tuple[int, int, int, list[int]]:
    """(time in OPERATIONAL, its begin, its end, frames that prove it)."""
    spans = [
        state
        for state in facts.analysis.nmt_states
        if (state.bus, state.node, state.state) == (row.bus, row.node, "OPERATIONAL")
        and state.certainty == "observed"
    ]
    if not spans:
        return 0, 0, 0, []
    lasted = sum(state.end_ns - state.start_ns for state in spans)
    seqs = [state.evidence for state in spans if state.evidence is not None]
    return lasted, spans[0].start_ns, spans[-1].end_ns, seqs[:10]


def _pdos(facts: Facts, row: NodeRow) -> list[Pdo]:
    """TPDOs that the device has, or of which the bus told something."""
    bus = facts.number(row.bus)
    shadow = facts.context.shadow
    device = shadow.device(bus, row.node)
    indexes = {index for index, _ in device.facts} if device else set()
    indexes |= {index for index, _ in shadow.learned(bus, row.node)}
    numbers = sorted(index - 0x17FF for index in indexes if 0x1800 <= index < 0x1A00)
    return [Pdo(bus, row.node, "tpdo", number, "") for number in numbers]


def _cob_id(facts: Facts, row: NodeRow, pdo: Pdo) -> str:
    value = facts.context.shadow.number(pdo.bus, row.node, pdo.communication, 1)
    if value is None and pdo.number <= 4:
        value = 0x80 + 0x100 * pdo.number + row.node
    return "?" if value is None else f"{value & 0x7FF:03X}h"


def _reason(facts: Facts, bindings: PdoBindings, row: NodeRow, pdo: Pdo) -> _Reason:
    """Why a PDO does not come, by what is known at the end of the capture."""
    index = f"{pdo.communication:04X}h"
    shadow = facts.context.shadow
    cob_id = shadow.get(pdo.bus, pdo.node, pdo.communication, 1)
    if cob_id is not None and isinstance(cob_id.value, int) and cob_id.value & _OFF:
        return _Reason(f"is switched off (bit 31 of {index}:01)", _rests(index, 1, cob_id))
    settings = bindings.transmission(pdo)
    if settings.type is None or not isinstance(settings.type.value, int):
        return _Reason(f"does not come, its transmission type ({index}:02) is not known")
    assumed = _rests(index, 2, settings.type)
    kind = settings.type.value
    if kind == 0:
        return _Reason(_of_type_0(facts, pdo), assumed)
    if kind <= _LAST_SYNC_TYPE:
        return _Reason(_synchronous(facts, bindings, row, pdo, kind), assumed)
    return _by_timer(facts, bindings, pdo, index, kind, settings.event_timer_ms, assumed)


def _of_type_0(facts: Facts, pdo: Pdo) -> str:
    device = facts.context.shadow.device(pdo.bus, pdo.node)
    if quirks(device).type_0 == "off":
        return "is off: type 0 means so on this device"
    return "is of type 0: sent only after its value changed, with the next SYNC"


def _synchronous(facts: Facts, bindings: PdoBindings, row: NodeRow, pdo: Pdo, kind: int) -> str:
    listens = bindings.sync_cob_id(pdo.bus, pdo.node)
    if not any((s.bus, s.cob_id) == (row.bus, listens) and s.count for s in facts.analysis.sync):
        return f"{_NO_SYNC} (type {kind}), and no SYNC ({listens:03X}h) is on the bus"
    return _repeated(bindings, pdo) or f"is to answer SYNC (type {kind}){_DUE[0]}"


def _by_timer(
    facts: Facts,
    bindings: PdoBindings,
    pdo: Pdo,
    index: str,
    kind: int,
    timer: Known | None,
    assumed: list[str],
) -> _Reason:
    device = facts.context.shadow.device(pdo.bus, pdo.node)
    if timer is None or not isinstance(timer.value, int):
        return _Reason(
            f"is sent by its event timer (type {kind}), and {index}:05 is not known", assumed
        )
    assumed = [*assumed, *_rests(index, 5, timer)]
    if timer.value == 0 or kind not in quirks(device).event_timer_types:
        on_change = "" if kind == 0xFE and device else "; it is sent when its value changes"
        return _Reason(f"has no event timer ({index}:05 = 0, type {kind}){on_change}", assumed)
    text = _repeated(bindings, pdo)
    return _Reason(text or f"is due every {timer.value} ms (type {kind}){_DUE[1]}", assumed)


def _repeated(bindings: PdoBindings, pdo: Pdo) -> str:
    """That a repeat counter keeps it silent at standstill, where the device has one."""
    counter = bindings.repeat_counter(pdo)
    if counter is None or not counter.value or not counter.confirmed:
        return ""
    assert isinstance(counter.value, int)
    index = 0x27FF + pdo.number
    return f"comes {counter.value} times after a change only ({index:04X}h), and nothing changed"


def _rests(index: str, sub: int, known: Known) -> list[str]:
    return [] if known.confirmed else [f"{index}:{sub:02X} = {known.value!r} ({known.source})"]


def _overload(facts: Facts) -> Iterator[Finding]:
    """Buses that their cyclic PDOs alone would fill."""
    bindings = PdoBindings(facts.context.shadow)
    for bus in facts.analysis.capture.buses:
        rate = facts.context.bitrates.get(bus)
        rows = [row for row in facts.analysis.nodes if row.bus == bus]
        loads = {row.node: _bits_per_s(facts, bindings, row) for row in rows}
        loads = {node: load for node, load in loads.items() if load}
        total = sum(loads.values())
        if rate is None or total <= FULL * rate:
            continue
        worst = sorted(loads.items(), key=lambda item: -item[1])[:8]
        listed = ", ".join(f"node {node} {load / 1000:.1f}" for node, load in worst)
        capture = facts.analysis.capture
        yield Finding(
            "device.overload_by_settings",
            "warning",
            bus,
            None,
            capture.begin_ns,
            capture.end_ns,
            f"By their event timers the PDOs on {bus} need up to {total / 1000:.1f} kbit/s of"
            f" {rate / 1000:g} kbit/s ({100 * total / rate:.0f} %): {listed} kbit/s.",
            "The event timers (180xh:5) are too short for this bit rate; this is no fault of a"
            " device or a cable.",
            "Lengthen the timers, switch unused PDOs off, use SYNC, or raise the bit rate.",
            [],
            assumed=facts.context.assumed_bitrate(bus),
        )


def _bits_per_s(facts: Facts, bindings: PdoBindings, row: NodeRow) -> float:
    """Bits per second of a node's cyclic PDOs at worst-case stuffing, by confirmed settings."""
    total = 0.0
    types = quirks(facts.context.shadow.device(facts.number(row.bus), row.node)).event_timer_types
    for pdo in _pdos(facts, row):
        settings = bindings.transmission(pdo)
        cob_id = facts.context.shadow.number(pdo.bus, pdo.node, pdo.communication, 1) or 0
        timer, kind = settings.event_timer_ms, settings.type
        mapping = bindings.mapping(pdo)
        known = timer is not None and kind is not None and timer.confirmed and kind.confirmed
        if not known or mapping is None or cob_id & _OFF:
            continue
        assert timer is not None
        assert kind is not None
        if kind.value in types and isinstance(timer.value, int) and timer.value:
            total += _worst_bits(mapping.length) * 1000 / timer.value
    return total


def _worst_bits(data_bytes: int) -> int:
    """Bits of an 11-bit frame with the most stuff bits, its intermission included.

    >>> _worst_bits(4) + 2 * _worst_bits(8)
    365
    """
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


RULES: tuple[Rule, ...] = (
    Rule(
        "pdo.silent",
        "A node is OPERATIONAL and sends no PDO at all; the text gives the reason for each.",
        "The frames that prove OPERATIONAL.",
        (
            f"From {seconds(SILENT_NS)} in OPERATIONAL by the node's own word on.",
            "It is an info: the settings, a missing SYNC or standstill explain the silence.",
            "Not where a PDO is set to 29 bits, or to an identifier on which another node sends.",
        ),
        _silent,
    ),
    Rule(
        "device.overload_by_settings",
        "The event timers of the PDOs on a bus ask for more than its bit rate can carry.",
        "The settings as they were read or written; no single frame.",
        ("Only with confirmed timers and types, and a known bit rate.",),
        _overload,
        untimed=True,
    ),
)
