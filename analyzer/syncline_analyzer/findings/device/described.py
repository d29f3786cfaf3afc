"""Findings on what the bus description says of a device and the bus does not bear out."""

from collections.abc import Iterator
from dataclasses import field

from syncline_analyzer.context import Context
from syncline_analyzer.findings.device.rules import named
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.object_history import Known
from syncline_analyzer.results import Finding
from syncline_schemas.description import NodeEntry
from syncline_schemas.measurement import contradicted_settings, measuring_device
from syncline_schemas.records import dataclass

Key = tuple[int, int]


@dataclass
class _Told:
    """What is known of a node's objects; `by_bus` what the bus told of those that were looked up."""

    context: Context
    bus: int
    node: int
    by_bus: dict[Key, Known] = field(default_factory=dict)

    def lookup(self, index: int, sub: int) -> tuple[int, bool] | None:
        """(value, whether it is only assumed)."""
        known = self.context.shadow.get(self.bus, self.node, index, sub)
        if known is None or not isinstance(known.value, int):
            return None
        if known.confirmed:
            self.by_bus[index, sub] = known
        return known.value, not known.confirmed


def _contradicted(facts: Facts) -> Iterator[Finding]:
    """Numbers among a node's settings that are others by the bus, which counts more."""
    for bus, name, node, entry in _described(facts.context):
        if not entry.overrides:
            continue
        shadow = facts.context.shadow
        device = measuring_device(shadow.device(bus, node), shadow.number(bus, node, 0x1000))
        told = _Told(facts.context, bus, node)
        for setting in contradicted_settings(device, told.lookup, entry.overrides):
            keys = [key for key in setting.objects if key in told.by_bus]
            by = " and ".join(named(device, key) for key in keys)
            seqs = sorted(seq for key in keys if (seq := told.by_bus[key].seq) is not None)
            yield Finding(
                "device.override_contradicted",
                "warning",
                name,
                node,
                min((told.by_bus[key].t_ns or 0 for key in keys), default=0),
                facts.analysis.capture.end_ns,
                f"The bus description says {setting.name} = {setting.given} of"
                f" {facts.inside(name, node)}, the device itself told {setting.told} by {by}: what"
                " the bus told is used.",
                "The description is of another device or of former settings.",
                f"Correct {setting.name} in the bus description, or leave it out.",
                seqs,
            )


def _not_compared(facts: Facts) -> Iterator[Finding]:
    """Encoders that should be compared with another one, and never were."""
    compared = {(row.bus, row.node, row.other): row.compared for row in facts.analysis.shafts}
    capture = facts.analysis.capture
    seen = {(row.bus, row.node) for row in facts.analysis.nodes}
    traced = {(row.bus, row.node) for row in facts.analysis.traces}
    for _, name, node, entry in _described(facts.context):
        other = entry.same_shaft_as
        if other is None or compared.get((name, node, other)):
            continue
        if not seen & {(name, node), (name, other)}:
            continue
        missing = [each for each in (node, other) if (name, each) not in traced]
        who = " and ".join(facts.inside(name, each) for each in missing)
        yield Finding(
            "device.shafts_not_compared",
            "info",
            name,
            node,
            capture.begin_ns,
            capture.end_ns,
            f"{facts.who(name, node)} and node {other} were never compared, though the bus"
            " description places them on one shaft: "
            + (
                f"no position of {who} is in this capture."
                if missing
                else "their positions have no scale in degrees, or are never near one another in"
                " time."
            ),
            "The number in same_shaft_as is wrong, or the encoder was off or sends no position."
            if missing
            else "The counts per turn are not known, or the samples come too seldom.",
            f"Check same_shaft_as = {other} of node {node} in the bus description, and whether both"
            " encoders send.",
            [],
        )


def _described(context: Context) -> Iterator[tuple[int, str, int, NodeEntry]]:
    """(bus number, bus name, node, what is said of it) on every bus of the capture."""
    for bus, name in enumerate(context.buses):
        for node, entry in sorted(context.description.described(name).items()):
            yield bus, name, node, entry


RULES: tuple[Rule, ...] = (
    Rule(
        "device.override_contradicted",
        "A number in the overrides of the bus description is another one by what the device told.",
        "The answer or the acknowledged write that tells it.",
        (
            "Only what the bus told counts, no default of an EDS.",
            "A number that the device did not tell is taken from the description.",
            "How bits are to be read (scaling, direction) is the user's to say.",
        ),
        _contradicted,
        untimed=True,
    ),
    Rule(
        "device.shafts_not_compared",
        "Two encoders that the bus description places on one shaft were never compared.",
        "No single frame: positions of one of them are not there.",
        (
            "Only where at least one of both nodes is on the bus.",
            "One comparison is enough.",
        ),
        _not_compared,
        untimed=True,
    ),
)
