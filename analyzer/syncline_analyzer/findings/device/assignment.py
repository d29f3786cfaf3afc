"""Findings on what a node is taken for: a device that it cannot be, or one that it looks like."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_analyzer.results import Finding, NodeRow, PdoRow, TraceRow
from syncline_schemas.canopen.sdo import abort_meaning
from syncline_schemas.devices import (
    ABSENT,
    Device,
    evidence,
    excluded,
    identify,
    standard_device,
    suspects,
)
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.wording import counted

MIN_FRAMES = 3
"""Frames of a wrong length from which on they count."""
IMPOSSIBLE_SHARE = 0.1
"""Share of impossible values from which on the device itself is doubted."""
MIN_SAMPLES = 10
MISSING = 0x06020000
NAME, TYPE, VENDOR, PRODUCT = (0x1008, 0), (0x1000, 0), (0x1018, 1), (0x1018, 2)
STORE = (0x1010, 0)


class Contradiction(NamedTuple):
    """Something that the device does not do; `sure` where nothing but another device explains it."""

    text: str
    sure: bool
    seqs: tuple[int, ...] = ()


def _wrong_devices(facts: Facts) -> Iterator[Finding]:
    """Nodes that do what the device that the user named cannot do."""
    for row in facts.analysis.nodes:
        bus = facts.number(row.bus)
        device = facts.context.shadow.device(bus, row.node)
        if device is None or row.device_source not in ("--device", "bus description"):
            continue
        found = [*_identity(facts, bus, row, device), *_refused(facts, row, device)]
        found += _lengths(facts, bus, row, device)
        found += _impossible(facts, row)
        if not found:
            continue
        found += _more_pdos(facts, row, device)
        yield _finding(facts, row, device, found)


def _finding(facts: Facts, row: NodeRow, device: Device, found: list[Contradiction]) -> Finding:
    bus, capture = facts.number(row.bus), facts.analysis.capture
    named = identify(facts.context.shadow.identity(bus, row.node))
    better = named if named is not None and named.name != device.name else None
    by = "with --device" if row.device_source == "--device" else "in the bus description"
    sure = any(each.sure for each in found)
    return Finding(
        "device.wrong_device",
        "warning" if sure else "info",
        row.bus,
        row.node,
        capture.begin_ns,
        capture.end_ns,
        f"{facts.who(row.bus, row.node)} was named a {device.title} {by}, but"
        f" {'; '.join(each.text for each in found)}.",
        (
            f"It is a {better.title}."
            if better
            else "Another device is at this number, or the wrong one was named."
            if sure
            else "Its settings were changed before the capture began, or it is another device."
        ),
        (
            f"Name it {better.name}; what is told of its values and errors rests on the wrong device."
            if better
            else "Read 1008h and 1018h of the node and look at its type plate; what is told of its"
            " values and errors rests on the device that was named."
        ),
        sorted({seq for each in found for seq in each.seqs}),
    )


def _identity(facts: Facts, bus: int, row: NodeRow, device: Device) -> Iterator[Contradiction]:
    """What the node itself said of its name, its profile and its maker."""
    known = facts.context.shadow.identity(bus, row.node)
    learned = facts.context.shadow.learned(bus, row.node)

    def seqs(*keys: tuple[int, int]) -> tuple[int, ...]:
        found = (learned[key].seq for key in keys if key in learned)
        return tuple(seq for seq in found if seq is not None)

    wanted = device.identity.get("name")
    name = known.get(NAME)
    if wanted is not None and name is not None and name != ABSENT:
        raw = name if isinstance(name, bytes) else name.to_bytes(8, "little", signed=name < 0)
        told = raw.decode("latin-1").rstrip("\0 ")
        if told != wanted:
            yield Contradiction(f'it calls itself "{told}" (1008h)', True, seqs(NAME))
    for key in excluded(device, known):
        is_there = "does not exist" if known[key] == ABSENT else "exists"
        if known[key] != ABSENT and key == STORE:
            is_there = f"is {known[key]!r}"
        yield Contradiction(f"{key[0]:04X}h {is_there}, other than in that device", True, seqs(key))
    kind = known.get(TYPE)
    types = device.identity.get("device_type", ())
    default = device.default(*TYPE, row.node)
    types = types or ((default,) if isinstance(default, int) else ())
    profiles = {each & 0xFFFF for each in types} - {0}
    if isinstance(kind, int) and profiles and kind & 0xFFFF not in {*profiles, 0}:
        yield Contradiction(
            f"it follows CiA {kind & 0xFFFF} (1000h = {kind:08X}h), that device CiA"
            f" {' or '.join(map(str, sorted(profiles)))}",
            True,
            seqs(TYPE),
        )
    vendor, product = known.get(VENDOR), known.get(PRODUCT)
    if isinstance(vendor, int) and vendor not in device.identity.get("vendors", (vendor,)):
        yield Contradiction(f"its vendor number is {vendor:X}h (1018h)", True, seqs(VENDOR))
    if "vendor" in device.identity and isinstance(vendor, int) and vendor:
        if vendor != device.identity["vendor"]:
            yield Contradiction(f"its vendor number is {vendor:X}h (1018h)", True, seqs(VENDOR))
        elif isinstance(product, int) and product not in device.identity["product"]:
            yield Contradiction(f"its product code is {product:X}h (1018h)", True, seqs(PRODUCT))


def _refused(facts: Facts, row: NodeRow, device: Device) -> Iterator[Contradiction]:
    """Measured objects that the node says it does not have."""
    wanted = set(device.measurement.get("position", ()))
    for transfer in facts.analysis.sdo.aborted.of_node(row.bus, row.node):
        place = (transfer.index or 0, transfer.sub or 0)
        if transfer.abort_code == MISSING and transfer.abort_by == "server" and place in wanted:
            wanted.discard(place)
            words = abort_meaning(MISSING)
            yield Contradiction(
                f'it answered for {place[0]:04X}h, its position: "{words}"', True, (transfer.seq,)
            )


def _lengths(facts: Facts, bus: int, row: NodeRow, device: Device) -> Iterator[Contradiction]:
    """PDOs that are never as long as what the device maps into them."""
    bindings = PdoBindings(facts.context.shadow)
    bindings.refresh(bus)
    for sent in facts.analysis.pdos:
        if (sent.bus, sent.node) != (row.bus, row.node) or sent.frames < MIN_FRAMES:
            continue
        pdo = bindings.owner(bus, sent.cob_id)
        if pdo is None or pdo.guess or pdo.kind != "tpdo" or pdo.node != row.node:
            continue
        mapping = bindings.mapping(pdo)
        lengths = facts.context.pdo_lengths.get((bus, sent.cob_id), {})
        fixed = device.quirks.fixed_mapping
        if mapping is None or not lengths or mapping.length in lengths:
            continue
        if bindings.mapping_confirmed(pdo) and not fixed:
            continue
        seen = " or ".join(map(str, sorted(lengths)))
        yield Contradiction(
            f"its {pdo.name} ({sent.cob_id:03X}h) has {seen} bytes and not {mapping.length}",
            fixed,
            (min(lengths.values()),),
        )


def _impossible(facts: Facts, row: NodeRow) -> Iterator[Contradiction]:
    """Traces of which most values are impossible."""
    for trace in facts.analysis.traces:
        if (trace.bus, trace.node) != (row.bus, row.node) or trace.samples < MIN_SAMPLES:
            continue
        outside = trace.flags["out_of_range"]
        if outside >= IMPOSSIBLE_SHARE * trace.samples:
            yield Contradiction(
                f"{outside} of {counted(trace.samples, 'value')} of {trace.name} are impossible"
                " for it",
                False,
                tuple(_first_outside(facts, trace)),
            )


def _first_outside(facts: Facts, trace: TraceRow) -> list[int]:
    place = (trace.bus, trace.node, trace.object, "out of range")
    events = facts.analysis.trace_events
    return [e.seq for e in events if (e.bus, e.node, e.object, e.kind) == place][:1]


def _more_pdos(facts: Facts, row: NodeRow, device: Device) -> Iterator[Contradiction]:
    """TPDOs at the node's predefined identifiers that the device does not have."""
    for sent in facts.analysis.pdos:
        name, _, guess = (sent.pdo or "").partition(" ")
        number = name.removeprefix("TPDO")
        if (sent.bus, sent.node) != (row.bus, row.node) or not (guess and number.isdecimal()):
            continue
        if device.object(0x17FF + int(number), 1) is None:
            yield Contradiction(
                f"it sends {sent.cob_id:03X}h, a {name} that it does not have", False
            )


def _looks_like(facts: Facts) -> Iterator[Finding]:
    """Nodes of which nobody says what they are, and whose PDOs look like those of a device."""
    for row in facts.analysis.nodes:
        if not row.device_guess:
            continue
        capture = facts.analysis.capture
        devices = " or ".join(row.device_guess)
        if row.device is not None:
            yield _one_of_several(facts, row)
            continue
        seqs = _suspicion_seqs(facts, row)
        yield Finding(
            "device.looks_like",
            "info",
            row.bus,
            row.node,
            capture.begin_ns,
            capture.end_ns,
            f"{facts.who(row.bus, row.node)} may be a {devices}: {row.device_reason}."
            if seqs
            else f"Nobody says what {facts.inside(row.bus, row.node)} is; its PDOs look like those"
            f" of {devices}: {row.device_reason.partition(': as')[0]}.",
            "What would prove it was not read while the recorder listened."
            if seqs
            else "The recorder started after the node was asked for its name, or nobody asks it.",
            f"If it is one, name it: --device {row.node}={row.device_guess[0]}. Its values are not"
            " shown before that, since other devices may send the same.",
            seqs,
        )


def _one_of_several(facts: Facts, row: NodeRow) -> Finding:
    """A node whose name several devices have, and that behaves as one of them."""
    capture = facts.analysis.capture
    learned = facts.context.shadow.learned(facts.number(row.bus), row.node)
    name = learned.get(NAME)
    return Finding(
        "device.looks_like",
        "info",
        row.bus,
        row.node,
        capture.begin_ns,
        capture.end_ns,
        f"{facts.who(row.bus, row.node)} is a {row.device}, more likely a"
        f" {' or '.join(row.device_guess)}: {row.device_reason}.",
        "Both answer the same name; what would prove it was not read while the recorder listened.",
        f"If it is one, name it: --device {row.node}={row.device_guess[0]}. Only what both have in"
        " common is told of it before that.",
        [name.seq] if name is not None and name.seq is not None else [],
    )


def _suspicion_seqs(facts: Facts, row: NodeRow) -> list[int]:
    """Answers that fit a device without proving it; empty where only the PDOs do."""
    bus = facts.number(row.bus)
    known = facts.context.shadow.identity(bus, row.node)
    learned = facts.context.shadow.learned(bus, row.node)
    keys = {key for device in suspects(known) for key in evidence(device, known)}
    found = (learned[key].seq for key in keys if key in learned)
    return sorted(seq for seq in found if seq is not None)


def _unmapped(facts: Facts, row: NodeRow) -> list[PdoRow]:
    """TPDOs of a node, if nobody says of any what it holds."""
    bus = facts.number(row.bus)
    bindings = PdoBindings(facts.context.shadow)
    bindings.refresh(bus)
    sent = [
        pdo
        for pdo in facts.analysis.pdos
        if (pdo.bus, pdo.node) == (row.bus, row.node)
        and (pdo.pdo or "").startswith("TPDO")
        and pdo.frames >= MIN_FRAMES
    ]
    owners = [bindings.owner(bus, pdo.cob_id) for pdo in sent]
    mapped = any(owner is not None and bindings.mapping(owner) for owner in owners)
    return [] if mapped else sent


def _not_shown(facts: Facts) -> Iterator[Finding]:
    """Encoders and inclinometers by their own word, of whose PDOs nobody says what they hold."""
    traced = {(trace.bus, trace.node) for trace in facts.analysis.traces}
    for row in facts.analysis.nodes:
        if row.device is not None or row.device_guess or (row.bus, row.node) in traced:
            continue
        known = facts.context.shadow.learned(facts.number(row.bus), row.node).get(TYPE)
        kind = known.value if known is not None else None
        standard = standard_device(kind & 0xFFFF) if isinstance(kind, int) else None
        sent = _unmapped(facts, row)
        if standard is None or not isinstance(kind, int) or not sent:
            continue
        assert known is not None
        capture = facts.analysis.capture
        listed = ", ".join(f"{pdo.cob_id:03X}h" for pdo in sent)
        yield Finding(
            "device.position_not_shown",
            "info",
            row.bus,
            row.node,
            capture.begin_ns,
            capture.end_ns,
            f"{facts.who(row.bus, row.node)} says that it is a {standard.title} (1000h ="
            f" {kind:08X}h), but what its PDOs hold ({listed}) was not read or stated: its position"
            " is not shown.",
            "The recorder started after the mapping (1A0xh) was read, or nobody reads it.",
            f"Name its device or its EDS: --device {row.node}=NAME or --device"
            f" {row.node}=FILE.eds; or record while its mapping is read.",
            [known.seq] if known.seq is not None else [],
        )


RULES: tuple[Rule, ...] = (
    Rule(
        "device.wrong_device",
        "A node does what the device that the user named for it cannot do.",
        "The answers, and the first PDOs and values, that do not fit.",
        (
            "Only nodes that the bus description or --device names; what a node says itself counts.",
            "A PDO whose mapping the node acknowledged is judged by that mapping.",
            "Impossible values, and PDO lengths where the mapping can be changed, are an info.",
            "Product codes do not count where a device is known by its name.",
            "PDOs that the device does not have are told only beside something else.",
        ),
        _wrong_devices,
        untimed=True,
    ),
    Rule(
        "device.looks_like",
        "Nobody says what a node is, and it looks like a known device: its PDOs, or what it told of itself.",
        "What it told of itself; else identifiers, lengths and rhythm of its PDOs, no single frame.",
        (
            "All its PDOs must fit in identifier and length, and several in their rhythm.",
            "It is a hint only: nothing is decoded by it.",
            "A name that several makers use is a hint until an object of the maker's own was read.",
        ),
        _looks_like,
    ),
    Rule(
        "device.position_not_shown",
        "An encoder or inclinometer sends PDOs of which nobody says what they hold.",
        "The answer to 1000h.",
        (
            "Only where the node itself names its profile (CiA 406 or 410) in 1000h.",
            "Not told where its device or any of its mappings is known, or its position was read.",
        ),
        _not_shown,
        untimed=True,
    ),
)
