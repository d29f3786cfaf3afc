"""Devices that have a number again which they had before LSS changed it (CiA 305)."""

from collections.abc import Iterator
from itertools import takewhile

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.folds.bus.lss import LssSetting
from syncline_analyzer.folds.nmt.events import IN_FLIGHT_NS, BootUpEvent, Command, Lost
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.folds.renumbered import another, begins_with, searched
from syncline_schemas.canopen.lss import UNCONFIGURED
from syncline_schemas.canopen.nmt import RESETS
from syncline_schemas.named_tuples import NamedTuple

_OTHERS = ("switch state", "configure node-ID")
"""After these another slave, or another number, is spoken of."""


class Back(NamedTuple):
    """A device left the number `left` and booted as `node`, which it had been before.

    `ordered`: LSS gave it that number again; else it had not stored the other one.
    """

    bus: str
    left: int
    node: int
    setting_seq: int
    since_ns: int
    last_ns: int
    boot_seq: int
    boot_ns: int
    ordered: bool
    unasked: bool
    """Nobody commanded the start under the old number."""

    def explains(self, bus: str, node: int, last_ns: int, end_ns: int) -> bool:
        """Whether a silence after a last sign of life is that of the number it left."""
        inside = self.since_ns <= last_ns <= self.boot_ns <= end_ns
        return inside and (self.bus, self.left) == (bus, node)


def gone_back(facts: Facts) -> list[Back]:
    """Numbers that fell silent because their device has its old one again."""
    return facts.once(_all)


def _all(facts: Facts) -> list[Back]:
    return [back for setting in facts.control.lss.settings for back in _of(facts, setting)]


def _of(facts: Facts, setting: LssSetting) -> Iterator[Back]:
    new, told = setting.request.values.get("node_id"), facts.control.lss.node_before(setting)
    if not facts.context.timed or setting.refused or new in (None, UNCONFIGURED, told):
        return
    if told is not None and told != UNCONFIGURED:
        yield from _ordered(facts, setting, told, new)
    store = stored(facts, setting)
    if told == UNCONFIGURED or (store is not None and not store.refused):
        return
    if told is not None or not searched(facts.control.lss, setting):
        yield from _not_stored(facts, setting, told, new)


def _ordered(facts: Facts, setting: LssSetting, left: int, new: int) -> Iterator[Back]:
    """LSS gave a device the number under which it was heard long before; it told the present one."""
    key, gone = (facts.number(setting.request.bus), new), setting.request.t_ns
    for lost, boot in _returns(facts, key):
        away = lost.last_ns < gone and boot.seq > setting.answer.seq
        heard = facts.control.nmt.nodes.get((key[0], left))
        if away and heard is not None and (heard.heard_ns or 0) < boot.t_ns:
            yield from _back(facts, setting, left, new, (gone, heard.heard_ns or 0), boot, True)
            return


def _not_stored(facts: Facts, setting: LssSetting, told: int | None, left: int) -> Iterator[Back]:
    """The only node that was silent while its device had the other number, and then booted."""
    bus = facts.number(setting.request.bus)
    life = _life(facts, (bus, left), setting)
    found = [
        (node, boot)
        for on, node in facts.control.nmt.timelines
        if on == bus and node != left and told in (None, node) and life is not None
        for lost, boot in _returns(facts, (bus, node))
        if setting.request.t_ns <= lost.last_ns <= life[0] < life[1] <= lost.end_ns
    ]
    if life is not None and len(found) == 1:
        node, boot = found[0]
        yield from _back(facts, setting, left, node, life, boot, False)


def _life(facts: Facts, key: NodeKey, setting: LssSetting) -> tuple[int, int] | None:
    """From when to when a number was heard that began with a boot-up after a setting."""
    boot, nmt = begins_with(facts.control.nmt, key, setting), facts.control.nmt.nodes.get(key)
    if boot is None or nmt is None or nmt.heard_ns is None:
        return None
    lost = any(each.end_seq is None for each in facts.control.nmt.timelines[key].lost)
    return (boot.t_ns, nmt.heard_ns) if lost else None


def _returns(facts: Facts, key: NodeKey) -> Iterator[tuple[Lost, BootUpEvent]]:
    """Silences of a node that a boot-up ended."""
    timeline = facts.control.nmt.timelines.get(key)
    boots = {boot.seq: boot for boot in timeline.boot_ups} if timeline is not None else {}
    for lost in (*timeline.lost, *timeline.restarts) if timeline is not None else ():
        if lost.end_seq in boots and not lost.whole_bus:
            yield lost, boots[lost.end_seq]


def _back(
    facts: Facts,
    setting: LssSetting,
    left: int,
    node: int,
    life: tuple[int, int],
    boot: BootUpEvent,
    ordered: bool,
) -> Iterator[Back]:
    """It, unless its identity is another one's, or a gap or a step of the clock hides the truth."""
    bus = facts.number(setting.request.bus)
    history = facts.control.nmt.timelines[bus, node].history
    hidden = any(gap.end_ns > setting.request.t_ns for _, gap in history.gaps)
    if hidden or another(facts.context, bus, node, left, facts.control.lss.identity(setting)):
        return
    place = (setting.request.bus, left, node, setting.answer.seq)
    since_ns = life[1] - IN_FLIGHT_NS
    resets = [c for c in facts.control.nmt.timelines[bus, left].history.commands if _reset(c)]
    asked = any(since_ns <= command.t_ns <= boot.t_ns for command in resets)
    yield Back(*place, *life, boot.seq, boot.t_ns, ordered, not (ordered or asked))


def _reset(command: Command) -> bool:
    return command.specifier in RESETS


def stored(facts: Facts, setting: LssSetting) -> LssSetting | None:
    """The answered order to store a setting, given to the same slave before anything else was."""
    lss, bus = facts.control.lss, setting.request.bus
    later = (
        row
        for row in lss.rows
        if row.bus == bus and row.sender == "master" and row.seq > setting.answer.seq
    )
    orders = takewhile(lambda row: not row.command.startswith(_OTHERS), later)
    asked = {row.seq for row in orders if row.command == "store configuration"}
    found = [each for each in lss.settings if each.request.bus == bus and each.request.seq in asked]
    return found[-1] if found and not _blind(facts, setting, found[-1]) else None


def _blind(facts: Facts, first: LssSetting, last: LssSetting) -> bool:
    """Whether the recorder may have missed something between two settings."""
    return any(
        gap.bus in (None, first.request.bus)
        and gap.start_ns < last.answer.t_ns
        and first.request.t_ns < gap.end_ns
        for gap in facts.analysis.capture.gaps
    )
