"""Devices that LSS gave another node-ID (CiA 305), where the capture proves that they took it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby

from syncline_analyzer.context import Context
from syncline_analyzer.folds.bus.lss import SESSION_NS, LssSetting, LssTable
from syncline_analyzer.folds.nmt.events import IN_FLIGHT_NS, BootUpEvent, Interval, NodeHistory
from syncline_analyzer.folds.nmt.measures import shares
from syncline_analyzer.folds.nmt.silences import RESET_WINDOW_NS
from syncline_analyzer.folds.nmt.table import NmtTable, NodeKey
from syncline_analyzer.folds.nmt.timeline import GOES_ON
from syncline_analyzer.results import NmtStateRow
from syncline_analyzer.results.sdo_records import NONE
from syncline_analyzer.results.sdo_transfers import SdoTransfers
from syncline_schemas.canopen.lss import UNCONFIGURED
from syncline_schemas.canopen.nmt import RESETS, NmtState
from syncline_schemas.named_tuples import NamedTuple

_SEARCHES = ("identify non-configured remote slave", "identify non-configured slave", "fastscan")
"""They look for devices that have no node-ID yet."""
_IDENTITY = range(1, 5)
"""Subindices of 1018h: vendor, product, revision and serial number."""
_SERIAL = 4


class Renumbered(NamedTuple):
    """A device that went on under another number; `setting_seq` is that of the LSS answer."""

    bus: str
    old: int
    new: int
    setting_seq: int
    boot_seq: int
    boot_ns: int
    known: bool
    """The device told its old number, or a serial number shows that it is the same."""


def renumbered(
    context: Context, lss: LssTable, nmt: NmtTable, sdo: SdoTransfers
) -> list[Renumbered]:
    """Node-IDs that a slave took and booted with, never to be heard under its old one again."""
    numbers = _numbers(context, nmt)
    found: dict[tuple[str, int], Renumbered] = {}
    for setting in lss.settings if context.timed else ():
        name, new = setting.request.bus, setting.request.values.get("node_id")
        bus = numbers.get(name)
        if new is None or bus is None or setting.refused:
            continue
        boot = _first_boot(nmt, sdo, (bus, new), setting)
        old = _old(lss, nmt, bus, setting, boot) if boot else None
        if old is not None and another(context, bus, old, new, lss.identity(setting)):
            continue
        if boot is not None and old is not None:
            known = _known(context, (bus, old, new), lss, setting)
            place = (setting.answer.seq, boot.seq, boot.t_ns)
            found[name, new] = Renumbered(name, old, new, *place, known)
    return list(found.values())


def _numbers(context: Context, nmt: NmtTable) -> dict[str, int]:
    """Numbers of the buses on which nodes were heard, by name."""
    return {context.bus_name(bus): bus for bus, _ in nmt.timelines}


def _first_boot(
    nmt: NmtTable, sdo: SdoTransfers, new: NodeKey, setting: LssSetting
) -> BootUpEvent | None:
    """The boot-up that is the first sign of a number, after a setting, with no gap in between."""
    boot = begins_with(nmt, new, setting)
    if boot is None:
        return None
    gaps = nmt.timelines[new].history.gaps
    hidden = any(setting.request.seq < seq <= boot.seq for seq, _ in gaps)
    served = sdo.of_node(setting.request.bus, new[1]).records
    answered = (served["answer_ns"] != NONE) & (served["seq"] < boot.seq)
    return None if hidden or answered.any() else boot


def begins_with(nmt: NmtTable, key: NodeKey, setting: LssSetting) -> BootUpEvent | None:
    """The boot-up after a setting that is the first a number's error control and PDOs tell of it."""
    timeline = nmt.timelines.get(key)
    if timeline is None or not timeline.boot_ups:
        return None
    boot, history = timeline.boot_ups[0], timeline.history
    before = boot.seq < setting.answer.seq or history.beats[0].seq < boot.seq
    before |= any(span.first_seq < boot.seq for span in history.spans)
    return None if before else boot


def _old(
    lss: LssTable, nmt: NmtTable, bus: int, setting: LssSetting, boot: BootUpEvent
) -> int | None:
    """The number that the device had: as it told it, else the only one that a reset silenced."""
    told = lss.node_before(setting)
    if told == UNCONFIGURED or (told is None and searched(lss, setting)):
        return None
    gone = [
        node
        for number, node in nmt.timelines
        if number == bus and told in (None, node) and _gone(nmt, (bus, node), setting, boot)
    ]
    return gone[0] if len(gone) == 1 else None


def another(context: Context, bus: int, old: int, new: int, selected: Mapping[int, int]) -> bool:
    """Whether 1018h of the two numbers, or of what LSS selected, is that of two devices."""
    for sub in _IDENTITY:
        numbers = {selected.get(sub), *(_told(context, bus, node, sub) for node in (old, new))}
        if len(numbers - {None}) > 1:
            return True
    return False


def _told(context: Context, bus: int, node: int, sub: int) -> int | None:
    """What a node answered of its identity (1018h)."""
    known = context.shadow.get(bus, node, 0x1018, sub)
    told = known is not None and known.source.startswith("sdo")
    return context.shadow.number(bus, node, 0x1018, sub) if told else None


def _known(
    context: Context, place: tuple[int, int, int], lss: LssTable, setting: LssSetting
) -> bool:
    """Whether a device told its old number, or its serial number shows that it is the same.

    `place` is its bus, its old number and the new one.
    """
    bus, old, new = place
    serial, selected = _told(context, bus, old, _SERIAL), lss.identity(setting).get(_SERIAL)
    same = serial is not None and serial in (selected, _told(context, bus, new, _SERIAL))
    return same or lss.node_before(setting) == old


def searched(lss: LssTable, setting: LssSetting) -> bool:
    """Whether the master looked for devices without a node-ID shortly before."""
    return any(
        row.command in _SEARCHES
        and row.bus == setting.request.bus
        and row.seq < setting.request.seq
        and setting.request.t_ns - row.t_ns <= SESSION_NS
        for row in lss.rows
    )


def _gone(nmt: NmtTable, key: NodeKey, setting: LssSetting, boot: BootUpEvent) -> bool:
    """Whether a node was there, was reset just before a boot-up, and is not heard any more."""
    timeline = nmt.timelines[key]
    history, heard_ns = timeline.history, nmt.nodes[key].heard_ns
    reset_ns = _reset_ns(history, setting, boot)
    if reset_ns is None or heard_ns is None or not history.beats:
        return False
    there = history.beats[0].seq < setting.request.seq and heard_ns <= reset_ns + IN_FLIGHT_NS
    return there and not any(lost.start_ns <= reset_ns < lost.end_ns for lost in timeline.lost)


def _reset_ns(history: NodeHistory, setting: LssSetting, boot: BootUpEvent) -> int | None:
    """When a node was reset last between a setting and a boot-up, and shortly before that."""
    resets = [
        command.t_ns
        for command in history.commands
        if command.specifier in RESETS and setting.answer.seq < command.seq < boot.seq
    ]
    return resets[-1] if resets and boot.t_ns - resets[-1] <= RESET_WINDOW_NS else None


def told_renumbered(context: Context, nmt: NmtTable, moved: Sequence[Renumbered]) -> NmtTable:
    """The same with the old numbers not LOST: their devices go on under the new ones."""
    if not moved:
        return nmt
    numbers = _numbers(context, nmt)
    by_node = {(each.bus, each.old): each for each in moved}
    states: list[NmtStateRow] = []
    for place, rows in groupby(nmt.states, key=lambda row: (row.bus, row.node)):
        own = list(rows)
        if (each := by_node.get(place)) is not None:
            own = _until_moved(own, each)
            node = nmt.nodes[numbers[each.bus], each.old]
            node.final_state, node.share = own[-1].state, shares([*map(_interval, own)])
        states += own
    return replace(nmt, states=states)


def _until_moved(rows: Sequence[NmtStateRow], each: Renumbered) -> list[NmtStateRow]:
    """A number's states up to the moment at which its device booted under another one."""
    at = _told_at(rows, each)
    last = rows[at]
    before = [*rows[:at], replace(last, end_ns=each.boot_ns)]
    cause = f"its device is node {each.new} since then: LSS gave it this node-ID"
    if not each.known:
        cause = (
            f"its device is taken for node {each.new} since then: LSS gave a device this node-ID"
        )
        cause += ", and no serial number tells which"
    after = [
        replace(
            last,
            state=NmtState.UNKNOWN.value,
            start_ns=each.boot_ns,
            cause=cause,
            certainty="implied",
            evidence=each.boot_seq,
        )
    ]
    for row in rows[at + 1 :]:
        if row.start_ns >= after[-1].end_ns:
            after[-1] = replace(after[-1], end_ns=row.end_ns)
        else:
            on = cause + GOES_ON
            after.append(replace(after[0], start_ns=row.start_ns, end_ns=row.end_ns, cause=on))
    return [*(row for row in before if row.end_ns > row.start_ns), *after]


def _told_at(rows: Sequence[NmtStateRow], each: Renumbered) -> int:
    """Which of the states was told when the device booted; the stamps may have stepped back."""
    found = [n for n, row in enumerate(rows) if row.start_ns <= each.boot_ns <= row.end_ns]
    since = [n for n in found if (rows[n].evidence or 0) > each.setting_seq]
    return [*since[:1], *found[-1:], len(rows) - 1][0]


def _interval(row: NmtStateRow) -> Interval:
    return Interval(
        NmtState(row.state), row.start_ns, row.end_ns, row.cause, row.certainty, row.evidence
    )
