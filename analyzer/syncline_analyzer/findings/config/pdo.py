"""Findings on the configuration of PDOs: refused, left off, of the wrong length, contradictory."""

from collections.abc import Iterator
from dataclasses import replace

from syncline_analyzer.findings.config.settings import (
    NodeKey,
    object_words,
    operational_after,
    restart_after,
    value_words,
    written,
)
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.folds.timing.pdo_length import WrongLength
from syncline_analyzer.object_history import Change
from syncline_analyzer.pdo_binding import (
    COMMUNICATION,
    MAPPING,
    MAX_MAPPED,
    PDO_COUNT,
    Kind,
    Pdo,
    PdoBindings,
)
from syncline_analyzer.results import Finding, SdoRow
from syncline_analyzer.service_ids import OFF
from syncline_schemas.canopen.sdo import abort_meaning
from syncline_schemas.devices import quirks
from syncline_schemas.wording import counted

MIN_WRONG = 3
"""Frames of a wrong length from which on it is told."""
RUNNING_NS = 1_000_000_000
"""A node that is OPERATIONAL for this long is done with its configuration [ns]."""
_TIMED = (0xFE, 0xFF)
"""Transmission types whose PDOs an event timer sends."""

Place = tuple[Kind, int]
"""Kind and number of a PDO."""


def place_of(index: int) -> Place | None:
    """The PDO that a communication or mapping parameter belongs to.

    >>> place_of(0x1801), place_of(0x1600), place_of(0x1017)
    (('tpdo', 2), ('rpdo', 1), None)
    """
    kinds: tuple[Kind, ...] = ("tpdo", "rpdo")
    for kind in kinds:
        for base in (COMMUNICATION[kind], MAPPING[kind]):
            if base <= index < base + PDO_COUNT:
                return kind, index - base + 1
    return None


def _label(place: Place) -> str:
    return f"{place[0].upper()}{place[1]}"


def _unusable(facts: Facts, key: NodeKey, place: Place, seq: int | None) -> str | None:
    """Why a PDO carries nothing by what the node acknowledged; None where it may carry something."""
    kind, number = place
    shadow = facts.context.shadow
    cob_id = shadow.confirmed(*key, COMMUNICATION[kind] + number - 1, 1, seq)
    if cob_id is not None and cob_id & OFF:
        return "it is off (bit 31 of its COB-ID is set)"
    if shadow.confirmed(*key, MAPPING[kind] + number - 1, 0, seq) == 0:
        return "nothing is mapped into it"
    return None


def _refused(facts: Facts) -> Iterator[Finding]:
    """A write to a PDO's parameters that was refused and left the PDO without effect."""
    told: set[tuple[NodeKey, Place]] = set()
    for row in facts.analysis.sdo.writes.aborted:
        if row.abort_by == "client":
            continue
        place = place_of(row.index) if row.index is not None else None
        if place is None:
            continue
        key = (facts.number(row.bus), row.node)
        if (key, place) in told or quirks(facts.context.shadow.device(*key)).fixed_mapping:
            continue
        restart = restart_after(facts, key, row.seq)
        end = restart[0] - 1 if restart else None
        why = _unusable(facts, key, place, end)
        if why is None or not _handled(facts, key, place, row, end):
            continue
        told.add((key, place))
        assert row.index is not None
        value = "the write"
        if isinstance(row.value, int):
            value = value_words(facts, key, row.index, row.sub or 0, row.value)
        yield Finding(
            "config.mapping_refused",
            "warning",
            row.bus,
            row.node,
            row.start_ns,
            restart[1] if restart else facts.analysis.capture.end_ns,
            f"{facts.who(row.bus, row.node)} refused to have {_label(place)} configured: "
            f"{value} for {object_words(facts, key, row.index, row.sub or 0)} at "
            f'{facts.moment(row.start_ns)} ended with "{abort_meaning(row.abort_code or 0)}" '
            f"({row.abort_code or 0:08X}h), and {why} since.",
            "The configuration does not fit this device or this version of it.",
            "Which objects the device can map (PDOMapping in its EDS), and how many bytes a PDO has.",
            [row.seq],
        )


def _handled(facts: Facts, key: NodeKey, place: Place, row: SdoRow, end: int | None) -> bool:
    """Whether a write of the same sequence, not a reading of before, made the PDO unusable."""
    kind, number = place
    shadow = facts.context.shadow
    keys = ((COMMUNICATION[kind] + number - 1, 1), (MAPPING[kind] + number - 1, 0))
    last = [shadow.get(*key, index, sub, end) for index, sub in keys]
    return any(
        known is not None and known.source == "sdo-write" and known.seq is not None
        for known in last
    ) and not _written_later(facts, key, row, end)


def _written_later(facts: Facts, key: NodeKey, row: SdoRow, end: int | None) -> bool:
    return any(
        other == key and (later.index, later.sub) == (row.index, row.sub) and later.seq > row.seq
        and (end is None or later.seq <= end)
        for other, later in written(facts)
    )  # fmt: skip


def _left_off(facts: Facts) -> Iterator[Finding]:
    """PDOs that were switched off to be configured, and never on again, while the node runs."""
    shadow = facts.context.shadow
    refused = {(f.bus, f.node) for f in _refused(facts)}
    for key in sorted(shadow.nodes()):
        bus = facts.context.bus_name(key[0])
        if (bus, key[1]) in refused:
            continue
        for place in sorted({p for (i, _), _ in shadow.history(*key) if (p := place_of(i))}):
            found = _off_since(facts, key, place)
            if found is None:
                continue
            off, last = found
            why = _unusable(facts, key, place, last.seq)
            yield Finding(
                "config.pdo_left_off",
                "warning",
                bus,
                key[1],
                off.t_ns,
                facts.analysis.capture.end_ns,
                f"{_label(place)} of {_lower(facts.who(bus, key[1]))} was configured at "
                f"{facts.moment(last.t_ns)} and never switched on again: {why}, and the node runs "
                f"without it.",
                "The client's configuration stopped in the middle or lacks its last step.",
                "Write the number of mapped objects, then the COB-ID without bit 31.",
                [off.seq, last.seq],
            )


def _lower(who: str) -> str:
    return who[0].lower() + who[1:]


def _off_since(facts: Facts, key: NodeKey, place: Place) -> tuple[Change, Change] | None:
    """(change that switched a PDO off, last change of its mapping after that)."""
    kind, number = place
    shadow = facts.context.shadow
    communication, mapping = COMMUNICATION[kind] + number - 1, MAPPING[kind] + number - 1
    empty = _last_write(facts, key, mapping, 0, 0xFF, 0)
    off = _last_write(facts, key, communication, 1, OFF, OFF)
    if empty is None and (off is None or not _was_on(facts, key, place, off)):
        return None
    begin = min(change for change in (empty, off) if change is not None)
    later = [
        span.change
        for sub in range(0 if empty is None else 1, MAX_MAPPED + 1)
        for span in shadow.spans(*key, mapping, sub)
        if span.change.cause == "sdo-write" and span.change.seq > begin.seq
    ]
    if not later:
        return None
    last = max(later, key=lambda change: change.seq)
    runs = operational_after(facts, key, last.t_ns) >= RUNNING_NS
    return (begin, last) if runs else None


def _last_write(
    facts: Facts, key: NodeKey, index: int, sub: int, bits: int, wanted: int
) -> Change | None:
    """The change by which an object has its last value, where a client wrote it and it fits."""
    spans = facts.context.shadow.spans(*key, index, sub)
    change = spans[-1].change if spans else None
    if change is None or change.cause != "sdo-write" or change.known is None:
        return None
    value = change.known.value
    return change if isinstance(value, int) and value & bits == wanted else None


def _was_on(facts: Facts, key: NodeKey, place: Place, off: Change) -> bool:
    """Whether a PDO was on before: a client that writes whole files keeps unused ones off."""
    kind, number = place
    before = facts.context.shadow.confirmed(*key, COMMUNICATION[kind] + number - 1, 1, off.seq - 1)
    if before is not None:
        return not before & OFF
    bus, name = facts.context.bus_name(key[0]), _label(place)
    return any(
        (row.bus, row.node) == (bus, key[1]) and (row.pdo or "").split(" ")[0] == name
        for row in facts.analysis.pdos
    )


def _without_remote(wrong: WrongLength) -> WrongLength:
    """Without the empty frames, which may be remote frames where a log does not mark them."""
    return replace(wrong, lengths={k: n for k, n in wrong.lengths.items() if k})


def _wrong_length(facts: Facts) -> Iterator[Finding]:
    """PDOs whose frames do not fit the mapping that the node confirmed."""
    for found in facts.control.lengths:
        wrong = _without_remote(found) if facts.analysis.capture.remote_lost else found
        pdo = wrong.pdo
        if wrong.frames < MIN_WRONG or (wrong.mapping_seq is None and _unused(facts, pdo)):
            continue
        if _tells_otherwise(facts, pdo):
            continue
        bus = facts.context.bus_name(pdo.bus)
        lengths = ", ".join(f"{length}" for length in sorted(wrong.lengths))
        short = min(wrong.lengths) < wrong.mapped
        sends = pdo.kind == "tpdo"
        yield Finding(
            "config.pdo_length",
            "warning",
            bus,
            pdo.node,
            wrong.first_ns,
            wrong.last_ns,
            f"{counted(wrong.frames, 'frame')} of {_label((pdo.kind, pdo.number))} of "
            f"{_lower(facts.who(bus, pdo.node))} ({wrong.can_id:03X}h) have {lengths} bytes, its "
            f"mapping has {wrong.mapped}{_only_one(facts, wrong)}.",
            ("Another device sends on this identifier, or the mapping took no effect."
             if sends and wrong.mapping_seq is not None else
             "Another device sends on this identifier, or the firmware is not that of the manual."
             if sends else
             "The sender's mapping does not fit: the node does not take the PDO (EMCY 8210h)."
             if short else "The sender's mapping does not fit."),
            "The mapping of sender and receivers, and who else uses this identifier.",
            [seq for seq in (wrong.mapping_seq, wrong.first_seq) if seq is not None],
            assumed=[] if wrong.mapping_seq is not None else [_by_the_eds(wrong)],
        )  # fmt: skip


def _unused(facts: Facts, pdo: Pdo) -> bool:
    """Whether the device was in a mode that leaves open what is in the PDO."""
    shadow = facts.context.shadow
    rules = quirks(shadow.device(pdo.bus, pdo.node))
    if rules.output_mode is None:
        return False
    modes = {
        shadow.number(pdo.bus, pdo.node, *rules.output_mode, seq)
        for seq in (None, *shadow.changes(pdo.bus, pdo.node, *rules.output_mode))
    }
    used = (rules.mode_pdos.get(mode) for mode in modes if mode is not None)
    return any(numbers is not None and pdo.number not in numbers for numbers in used)


def _tells_otherwise(facts: Facts, pdo: Pdo) -> bool:
    """Whether a node of fixed mapping told another one than that of its manual."""
    shadow = facts.context.shadow
    device = shadow.device(pdo.bus, pdo.node)
    if device is None or not device.quirks.fixed_mapping:
        return False
    return any(
        known.source == "sdo-read" and known.value != device.default(pdo.mapping, sub, pdo.node)
        for sub in range(MAX_MAPPED + 1)
        for span in shadow.spans(pdo.bus, pdo.node, pdo.mapping, sub)
        if (known := span.change.known) is not None
    )


def _only_one(facts: Facts, wrong: WrongLength) -> str:
    """That the mapping cannot be changed, where the node did not tell it."""
    if wrong.mapping_seq is not None:
        return ""
    device = facts.context.shadow.device(wrong.pdo.bus, wrong.pdo.node)
    return f", the only one that a {device.title} has" if device else ""


def _by_the_eds(wrong: WrongLength) -> str:
    return f"{wrong.pdo.mapping:04X}h: {wrong.mapped} bytes (eds-default)"


def _inhibited(facts: Facts) -> Iterator[Finding]:
    """Inhibit times that are longer than the event timer of the same PDO."""
    shadow = facts.context.shadow
    bindings = PdoBindings(shadow)
    for key in sorted(shadow.nodes()):
        bus = facts.context.bus_name(key[0])
        for (index, sub), _ in shadow.history(*key):
            place = place_of(index)
            if sub != 3 or place is None or place[0] != "tpdo" or index >= MAPPING["tpdo"]:
                continue
            kind, inhibit, timer = (shadow.confirmed(*key, index, entry) for entry in (2, 3, 5))
            if kind not in _TIMED or not timer or not inhibit or inhibit <= timer * 10:
                continue
            if bindings.identifier(*key, "tpdo", place[1]) is None:
                continue
            changes = [shadow.spans(*key, index, entry)[-1].change for entry in (3, 5)]
            last = max(changes, key=lambda change: change.seq)
            yield Finding(
                "config.inhibit_time",
                "warning",
                bus,
                key[1],
                last.t_ns,
                last.t_ns,
                f"{_label(place)} of {_lower(facts.who(bus, key[1]))} is to be sent every {timer} ms "
                f"(event timer) but not more often than every {inhibit / 10:g} ms (inhibit time).",
                "The two times were set without regard to one another; the inhibit time wins.",
                f"Inhibit time {index:04X}h:3 (unit 100 us) and event timer {index:04X}h:5 (unit ms).",
                [change.seq for change in changes],
            )


RULES: tuple[Rule, ...] = (
    Rule(
        "config.mapping_refused",
        "The node refused a step of a PDO's configuration and was left with the PDO off or empty.",
        "The refused write to 140xh, 160xh, 180xh or 1A0xh.",
        (
            "Silent when the PDO keeps its former mapping, or the write succeeds later.",
            "Silent for devices whose mapping is known to be fixed.",
        ),
        _refused,
        untimed=True,
    ),
    Rule(
        "config.pdo_left_off",
        "A PDO was switched off to be configured and never switched on again.",
        "The write that switched it off, and the last write of its configuration.",
        (
            "A PDO that is only switched off is meant to be off: its mapping must follow.",
            "A PDO that was never on is not missed, unless its mapping was left without a number.",
            "The node must have been OPERATIONAL for a second after the last write.",
        ),
        _left_off,
    ),
    Rule(
        "config.pdo_length",
        "Frames of a PDO are shorter or longer than what is mapped into it.",
        "The frame that confirmed the mapping, and the first frame that does not fit.",
        (
            "Only where the node itself told or acknowledged the whole mapping, or cannot change it.",
            "It cannot where it is by its own word a device of fixed mapping, in a mode that uses it.",
            "A device of fixed mapping that tells another one than its manual is not judged by that.",
            "Three frames or more; those within 100 ms of a change of the mapping do not count.",
            "An RPDO may be longer than its mapping.",
            "In a log that does not mark remote frames, empty frames do not count.",
        ),
        _wrong_length,
        untimed=True,
    ),
    Rule(
        "config.inhibit_time",
        "A PDO has an inhibit time longer than its event timer, so the timer cannot be kept.",
        "The transfers that told or wrote the two times.",
        (
            "Only confirmed values of one PDO that is on, and only transmission types FEh and FFh.",
            "The values at the end of the capture count.",
        ),
        _inhibited,
        untimed=True,
    ),
)
