"""Findings on what a device does with the writes that it acknowledged (the device sheets' traps)."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.object_history import Change
from syncline_analyzer.results import Finding, SdoObject, SdoRow
from syncline_schemas.devices import Device, device_names, load_device, quirks

Key = tuple[int, int]
SCALING_FOLLOWS_NS = 10_000_000_000
"""The scaling may be switched on this long after the counts per turn were written [ns]."""
ORDERED_NS = 10_000_000_000
"""A boot-up this long after the order is its effect [ns]."""
TERMINATED = 3
"""Devices with their terminating resistor on, from which on a bus has too many."""
ERROR_FRAMES = 20
"""Error frames from which on the resistors are worth a hint."""
LISTED = 8


def writes(facts: Facts) -> Iterator[tuple[SdoRow, Key, Device]]:
    """Acknowledged writes to nodes whose device is known, with the object and the device."""
    for row in facts.analysis.sdo.accepted.of_objects(lambda of: _device(facts, of) is not None):
        device = _device(facts, row)
        if device is not None and row.index is not None:
            yield row, (row.index, row.sub or 0), device


def _device(facts: Facts, of: SdoRow | SdoObject) -> Device | None:
    return facts.context.shadow.device(facts.number(of.bus), of.node)


def number(row: SdoRow) -> int:
    """The written value as a number."""
    return row.value if isinstance(row.value, int) else int.from_bytes(row.data[:4], "little")


def named(device: Device | None, key: Key) -> str:
    """An object with its name: "1800h:05 (Event timer TPDO1)"."""
    place = f"{key[0]:04X}h:{key[1]:02X}" if key[1] else f"{key[0]:04X}h"
    facts = device.object(*key) if device else None
    return f"{place} ({facts.name})" if facts else place


def told(
    id: str,
    row: SdoRow,
    text: str,
    cause: str,
    check_next: str,
    *,
    severe: bool = False,
    assumed: Sequence[str] = (),
) -> Finding:
    """A finding on one transfer."""
    return Finding(
        id,
        "warning" if severe else "info",
        row.bus,
        row.node,
        row.start_ns,
        row.end_ns,
        text,
        cause,
        check_next,
        [row.seq] if row.end_seq in (None, row.seq) else [row.seq, row.end_seq or row.seq],
        assumed=list(assumed),
    )


def _undocumented(facts: Facts) -> Iterator[Finding]:
    """Writes to an index that the device's manual does not have and that relatives use."""
    for row, key, device in writes(facts):
        words = device.quirks.undocumented.get(key[0])
        if words is None or device.object(*key) is not None:
            continue
        elsewhere = _as_bit_rate(key, number(row))
        yield told(
            "device.undocumented_write",
            row,
            f"{facts.who(row.bus, row.node)} acknowledged a write of {number(row):X}h to"
            f" {key[0]:04X}h, which is not in the dictionary of a {device.title}: {words}.",
            f"The frame was taken from another manual.{elsewhere}",
            "Is it this device? Read 1000h and 1008h of the node; undo the write before the settings"
            " are saved.",
            severe=True,
        )


def _as_bit_rate(key: Key, value: int) -> str:
    """What the same write does on devices that keep their bit rate there."""
    for name in device_names(()):
        other = load_device(name, ())
        if other.quirks.bitrate_object == key and value in other.quirks.bitrates:
            rate = other.quirks.bitrates[value] / 1000
            return (
                f" On a {other.title} the same bytes set {rate:g} kbit/s, after a save and a reset."
            )
    return ""


def _scaling_off(facts: Facts) -> Iterator[Finding]:
    """Counts per turn that were written while the switch that makes them count was off."""
    for row, key, device in writes(facts):
        switch = device.measurement.get("scaling")
        if switch is None or key != device.measurement.get("counts_per_turn"):
            continue
        bus, place = facts.number(row.bus), switch["object"]
        shadow = facts.context.shadow
        later = [
            change.seq
            for change in _changes(facts, bus, row.node, place)
            if 0 <= change.t_ns - row.end_ns <= SCALING_FOLLOWS_NS
        ]
        seqs = [row.end_seq or row.seq, *later]
        index, sub = place
        values = [shadow.number(bus, row.node, index, sub, seq) or 0 for seq in seqs]
        if any(value >> switch["bit"] & 1 for value in values):
            continue
        known = shadow.get(bus, row.node, index, sub, seqs[-1])
        text = (
            f"{facts.who(row.bus, row.node)} acknowledged {number(row)} counts per turn"
            f" ({key[0]:04X}h), but its scaling is off ({place[0]:04X}h bit {switch['bit']} = 0):"
            f" {key[0]:04X}h has no effect."
        )
        finding = told(
            "device.scaling_off",
            row,
            text,
            "The switch for the scaling was forgotten.",
            f"Set bit {switch['bit']} of {place[0]:04X}h where the new counts per turn are wanted.",
        )
        if known is None or not known.confirmed:
            finding.assumed.append(f"{place[0]:04X}h = 0 (never read or written)")
        yield finding


def _changes(facts: Facts, bus: int, node: int, key: Key) -> list[Change]:
    found = dict(facts.context.shadow.history(bus, node)).get(key)
    return list(found.changes) if found else []


def _identifier_kept(facts: Facts) -> Iterator[Finding]:
    """Writes to 180xh:1 of which the device takes over only the on/off bit."""
    for row, key, device in writes(facts):
        mask = device.quirks.pdo_cob_id_mask
        if not (0x1800 <= key[0] < 0x1A00 and key[1] == 1) or mask == 0xFFFFFFFF:
            continue
        fixed = device.default(*key, row.node)
        if not isinstance(fixed, int) or (number(row) ^ fixed) & 0x7FF == 0:
            continue
        kept = "only bit 31 (PDO on or off)" if mask else "nothing of it"
        yield told(
            "device.identifier_kept",
            row,
            f"{facts.who(row.bus, row.node)} acknowledged {named(device, key)} ="
            f" {number(row) & 0x7FF:03X}h, but a {device.title} takes over {kept}: the PDO stays"
            f" on {fixed & 0x7FF:03X}h.",
            "Identifiers of this device follow its node id (its manual); bit 31 alone counts.",
            "Change the node id where another identifier is needed.",
        )


def _restarted_unseen(facts: Facts) -> Iterator[Finding]:
    """Counters since the last restart that fell although no boot-up was seen."""
    for bus, node in sorted(facts.context.shadow.nodes()):
        device = facts.context.shadow.device(bus, node)
        name = facts.context.bus_name(bus)
        for key in quirks(device).since_restart:
            own = facts.analysis.sdo.reads.ok.of_node(name, node)
            for first, second in pairwise(own.of_object(*key)):
                if number(second) < number(first) and not _started(facts, first, second):
                    yield told(
                        "device.restarted_unseen",
                        second,
                        f"{facts.who(name, node)} must have restarted between"
                        f" {facts.moment(first.start_ns)} and {facts.moment(second.start_ns)}:"
                        f" {named(device, key)} fell from {number(first)} to {number(second)}, and"
                        " no boot-up was seen.",
                        "It was off or disturbed so shortly that its silence did not show, or the"
                        " boot-up was not recorded.",
                        "Measure its supply; look for a gap of its heartbeats or PDOs.",
                        severe=not _blind(facts, first, second),
                    )


def _started(facts: Facts, first: SdoRow, second: SdoRow) -> bool:
    return any(
        (boot.bus, boot.node) == (first.bus, first.node) and first.seq < boot.seq < second.seq
        for boot in facts.control.nmt.boot_ups
    )


def _blind(facts: Facts, first: SdoRow, second: SdoRow) -> bool:
    return any(
        gap.bus in (None, first.bus)
        and gap.start_ns < second.start_ns
        and gap.end_ns > first.start_ns
        for gap in facts.analysis.capture.gaps
    )


def _reset_by_sdo(facts: Facts) -> Iterator[Finding]:
    """Restarts that a write ordered, without any NMT command."""

    def may_reset(of: SdoRow | SdoObject) -> int | None:
        key = (of.index or 0, of.sub or 0)
        return quirks(_device(facts, of)).reset_writes.get(key)

    asked = facts.analysis.sdo.writes.of_objects(lambda of: may_reset(of) is not None)
    for row in asked:
        device, key = _device(facts, row), (row.index or 0, row.sub or 0)
        if device is None or row.result == "abort" or may_reset(row) != number(row):
            continue
        boot = next(
            (
                boot
                for boot in facts.control.nmt.boot_ups
                if (boot.bus, boot.node) == (row.bus, row.node)
                and boot.seq > row.seq
                and boot.t_ns - row.start_ns <= ORDERED_NS
            ),
            None,
        )
        if boot is not None:
            finding = told(
                "device.reset_by_sdo",
                row,
                f"{facts.who(row.bus, row.node)} restarted at {facts.moment(boot.t_ns)} because"
                f" {named(device, key)} = {number(row)} was written at"
                f" {facts.moment(row.start_ns)}: a reset by SDO, not a spontaneous one.",
                "A client reset the device without an NMT command.",
                "Nothing, if it was meant.",
            )
            finding.evidence.append(boot.seq)
            yield finding


def _terminators(facts: Facts) -> Iterator[Finding]:
    """Several devices with their terminating resistor on, on a bus with error frames."""
    for bus in facts.analysis.capture.buses:
        errors = [row for row in facts.analysis.bus_errors if row.bus == bus]
        count = sum(row.count for row in errors)
        if count < ERROR_FRAMES:
            continue
        switched, assumed = _switched_on(facts, bus)
        if len(switched) < TERMINATED:
            continue
        nodes = ", ".join(map(str, switched))
        index = f"{_termination(facts, bus, switched[0])[0]:04X}h"
        yield Finding(
            "device.terminators",
            "info",
            bus,
            None,
            min(row.first_ns for row in errors),
            max(row.last_ns for row in errors),
            f"{len(switched)} devices on {bus} (nodes {nodes}) have their internal terminating"
            f" resistor on ({index} = 1), and there are {count} error frames.",
            "A bus needs exactly two terminating resistors; these devices leave the factory with"
            " theirs on.",
            f"Measure 60 ohm between CAN_H and CAN_L with the power off; set {index} = 0 in all"
            " devices that are not at an end of the cable.",
            [seq for row in errors for seq in row.evidence][:LISTED],
            assumed=assumed,
        )


def _switched_on(facts: Facts, bus: str) -> tuple[list[int], list[str]]:
    """(nodes with their resistor on, those of which it is only assumed, in words)."""
    nodes, assumed = [], []
    for node in sorted({row.node for row in facts.analysis.nodes if row.bus == bus}):
        key = _termination(facts, bus, node)
        known = facts.context.shadow.get(facts.number(bus), node, *key) if key[0] else None
        if known is not None and known.value == 1:
            nodes.append(node)
            if not known.confirmed:
                assumed.append(f"{key[0]:04X}h = 1 of node {node} ({known.source})")
    return nodes, assumed


def _termination(facts: Facts, bus: str, node: int) -> Key:
    device = facts.context.shadow.device(facts.number(bus), node)
    return quirks(device).termination or (0, 0)


def _settling(facts: Facts) -> Iterator[Finding]:
    """Writes after which a PDO stays away until a filter has settled."""
    for row, key, device in writes(facts):
        settle = device.quirks.settle_s.get(key, {}).get(number(row))
        if settle is None:
            continue
        pdo = device.quirks.settle_pdos.get(key)
        which = f"TPDO{pdo}" if pdo else "The values"
        yield told(
            "device.settling",
            row,
            f"{which} of {facts.inside(row.bus, row.node)} stay{'s' if pdo else ''} away for about {seconds(round(settle * 1e9))} after"
            f" {named(device, key)} was written at {facts.moment(row.start_ns)}: its filter settles.",
            "The device sends no value before its filter has settled.",
            "Nothing; wait.",
        )


RULES: tuple[Rule, ...] = (
    Rule(
        "device.undocumented_write",
        "A device acknowledged a write to an object that its manual does not have.",
        "The transfer.",
        ("Only for objects of which relatives of the device are known to make something else.",),
        _undocumented,
        untimed=True,
    ),
    Rule(
        "device.scaling_off",
        "Counts per turn were written while the device's scaling is off, so they have no effect.",
        "The transfer.",
        (f"The scaling may be switched on up to {seconds(SCALING_FOLLOWS_NS)} later.",),
        _scaling_off,
        untimed=True,
    ),
    Rule(
        "device.identifier_kept",
        "A write to a PDO's COB-ID was acknowledged, and the PDO stays where it was.",
        "The transfer.",
        ("Only on devices whose manual says that their identifiers are fixed.",),
        _identifier_kept,
        untimed=True,
    ),
    Rule(
        "device.restarted_unseen",
        "A counter since the last restart began anew although no boot-up was seen.",
        "The read with the smaller value.",
        ("A boot-up between the reads explains it; a capture gap makes it an info.",),
        _restarted_unseen,
        untimed=True,
    ),
    Rule(
        "device.reset_by_sdo",
        "A node restarted because a write to one of its objects ordered it.",
        "The write and the boot-up.",
        ("Only objects of which the maker says so.",),
        _reset_by_sdo,
    ),
    Rule(
        "device.terminators",
        "Several devices have their terminating resistor on, and the bus has error frames.",
        "The first error frames.",
        (f"From {TERMINATED} devices and {ERROR_FRAMES} error frames on.",),
        _terminators,
        untimed=True,
    ),
    Rule(
        "device.settling",
        "A PDO stays away while a filter of the device settles.",
        "The write that started it.",
        ("Only what the maker says of its filters.",),
        _settling,
        untimed=True,
    ),
)
