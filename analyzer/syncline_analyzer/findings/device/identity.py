"""Findings on node ids and bit rates that a write changed: who is who before and after a reset."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

from syncline_analyzer.findings.config.settings import restart_after
from syncline_analyzer.findings.device.rules import named, number, told, writes
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.folds.bus.lss import LssSetting
from syncline_analyzer.folds.renumbered import another
from syncline_analyzer.results import Finding, NodeRow, PdoRow, SdoRow
from syncline_schemas.devices import Device, quirks
from syncline_schemas.named_tuples import NamedTuple

SAVE = 0x1010
GONE_NS = 5_000_000_000
"""A node that is not heard for so long after a reset, and its own time of silence, is gone [ns]."""
FADE_NS = 1_000_000_000
"""So long after a reset command frames of before it may still come [ns]."""
_NO_LIFE = ("UNKNOWN", "LOST", "INITIALISING")


class Renaming(NamedTuple):
    """A node id that was written and what came of it; times are None where it did not happen."""

    row: SdoRow
    device: Device
    wanted: int
    new: int | None
    """Number under which the device was heard after the write."""
    new_ns: int | None
    back_ns: int | None
    """When it started under its old number again."""
    saved: bool


def renamings(facts: Facts) -> list[Renaming]:
    """Every node id that was written and acknowledged; of equal writes in a row the last."""
    found: dict[tuple[str, int, int], Renaming] = {}
    for row, key, device in writes(facts):
        wanted = number(row)
        if key == device.quirks.node_id_object and wanted != row.node and 0 < wanted < 128:
            found[row.bus, row.node, wanted] = _renaming(facts, row, device, wanted)
    return list(found.values())


def _renaming(facts: Facts, row: SdoRow, device: Device, wanted: int) -> Renaming:
    starts = [
        (t_ns, node)
        for node in _possible(facts, row, device, wanted)
        if (t_ns := _first_life(facts, row.bus, node)) is not None and t_ns > row.end_ns
    ]
    new_ns, new = min(starts, default=(None, None))
    after_ns = row.end_ns if new_ns is None else new_ns
    back_ns = min(
        (
            boot.t_ns
            for boot in facts.control.nmt.boot_ups
            if (boot.bus, boot.node) == (row.bus, row.node) and boot.t_ns > after_ns
        ),
        default=None,
    )
    saved = any(
        save.bus == row.bus
        and save.node in (row.node, new)
        and save.seq > row.seq
        and (back_ns is None or save.end_ns < back_ns)
        for save in facts.analysis.sdo.accepted.of_objects(lambda of: of.index == SAVE)
    )
    return Renaming(row, device, wanted, new, new_ns, back_ns, saved)


def _possible(facts: Facts, row: SdoRow, device: Device, wanted: int) -> tuple[int, ...]:
    """Numbers that the written value may mean: some firmware counts one more than it stores."""
    if "node_id_offset" not in device.overrides:
        return (wanted,)
    given = facts.context.overrides(facts.number(row.bus), row.node).get("node_id_offset")
    return (wanted, wanted + 1) if given is None else (wanted + int(given),)


def _first_life(facts: Facts, bus: str, node: int) -> int | None:
    """When a node was heard first."""
    boots = [b.t_ns for b in facts.control.nmt.boot_ups if (b.bus, b.node) == (bus, node)]
    states = [
        row.start_ns
        for row in facts.analysis.nmt_states
        if (row.bus, row.node) == (bus, node) and row.state not in _NO_LIFE
    ]
    return min([*boots, *states], default=None)


class Absence(NamedTuple):
    """A silence of this number that begins within and lasts beyond the end has its reason.

    The device went by another number then.
    """

    bus: str
    node: int
    start_ns: int
    end_ns: int

    def explains(self, bus: str, node: int, last_ns: int, end_ns: int) -> bool:
        """Whether a silence after a last sign of life is this one."""
        inside = self.start_ns <= last_ns <= self.end_ns <= end_ns
        return inside and (self.bus, self.node) == (bus, node)


def absences(facts: Facts) -> list[Absence]:
    """When numbers fell silent because their device was heard under another one."""
    found: list[Absence] = []
    for each in renamings(facts):
        if each.new is None or each.new_ns is None:
            continue
        found.append(Absence(each.row.bus, each.row.node, each.row.start_ns, each.new_ns))
        if each.back_ns is not None:
            found.append(Absence(each.row.bus, each.new, each.new_ns, each.back_ns))
    return [*found, *_renamed_by_lss(facts)]


def _renamed_by_lss(facts: Facts) -> Iterator[Absence]:
    """Node ids given by LSS (CiA 305): the old number falls silent when the new one is heard."""
    lss = facts.control.lss
    for setting in lss.settings:
        bus, start_ns = setting.request.bus, setting.request.t_ns
        new = setting.request.values.get("node_id")
        if new is None or setting.refused:
            continue
        heard_ns = _first_life(facts, bus, new)
        if heard_ns is None or heard_ns < start_ns:
            continue
        old = _old_of(facts, setting)
        known = {row.node for row in facts.analysis.nodes if row.bus == bus} - {new}
        identity, on = lss.identity(setting), facts.number(bus)
        for node in [old] if old is not None else sorted(known):
            if not another(facts.context, on, node, new, identity):
                yield Absence(bus, node, start_ns, heard_ns)


def _old_of(facts: Facts, setting: LssSetting) -> int | None:
    """The number that the device of an LSS setting had: proven, else as it told it."""
    proven = (m.old for m in facts.control.renumbered if m.setting_seq == setting.answer.seq)
    return next(proven, facts.control.lss.node_before(setting))


def _node_ids(facts: Facts) -> Iterator[Finding]:
    """What came of every node id that was written."""
    for each in renamings(facts):
        row, device = each.row, each.device
        key = device.quirks.node_id_object
        assert key is not None
        text = f"{facts.who(row.bus, row.node)} was told to be node {each.wanted}"
        text += f" ({named(device, key)} written at {facts.moment(row.start_ns)})"
        cause = "A client changed the node id."
        check_next = "Save the settings (1010h) if the new number is to stay."
        if each.new is not None and each.new_ns is not None:
            text += f"; it is now node {each.new}, heard since {facts.moment(each.new_ns)}"
            if each.back_ns is None and _saved_in_order(facts, each):
                check_next = "Nothing, if it was meant: the settings were saved (1010h)."
            if each.new != each.wanted:
                text += " (this firmware counts one more than it stores)"
            if each.back_ns is not None:
                text += f". At {facts.moment(each.back_ns)} it started as node {row.node} again"
                text += "." if each.saved else ": the change was not saved."
            else:
                text += "."
        elif each.back_ns is not None:
            reason = _still(each)
            text += f", yet it started as node {row.node} again at {facts.moment(each.back_ns)}:"
            text += f" {reason}."
            cause = reason[0].upper() + reason[1:] + "."
            check_next = "Look at the rotary switches of the device, or save and reset it."
        else:
            text += "; that acts after a reset, which is not in this capture."
            check_next = f"Order of this device: {device.quirks.node_id_order or 'reset it'}."
        finding = told("device.node_id_change", row, text, cause, check_next)
        yield finding


def _saved_in_order(facts: Facts, each: Renaming) -> bool:
    """Whether a new number was saved when its device takes it: some only under the new number."""
    first = (each.device.quirks.node_id_order or "").startswith("write, save")
    return each.saved and (
        first
        or any(
            (save.bus, save.node) == (each.row.bus, each.new) and save.seq > each.row.seq
            for save in facts.analysis.sdo.accepted.of_objects(lambda of: of.index == SAVE)
        )
    )


def _still(each: Renaming) -> str:
    """Why a device kept its number."""
    switches = each.device.quirks.node_id_switches
    if switches and each.saved:
        return "its node id is given by the rotary switches"
    if switches:
        return "the change was not saved, or the rotary switches give its node id"
    return "the change was not saved"


def _bit_rates(facts: Facts) -> Iterator[Finding]:
    """Bit rates that were written, in kbit/s."""
    for row, key, device in writes(facts):
        if key != device.quirks.bitrate_object:
            continue
        value = number(row)
        rate = device.quirks.bitrates.get(value)
        who = facts.who(row.bus, row.node)
        if rate is None:
            listed = ", ".join(f"{each / 1000:g}" for each in device.quirks.bitrates.values())
            yield told(
                "device.bit_rate_change",
                row,
                f"{who} acknowledged {named(device, key)} = {value}, which is not a bit rate of a"
                f" {device.title}: it knows {listed} kbit/s.",
                "The value was meant for another device.",
                "Write a bit rate that the device has before it is reset.",
                severe=True,
            )
        elif rate != facts.context.bitrates.get(row.bus):
            text = f"{who} was told to use {rate / 1000:g} kbit/s ({named(device, key)} = {value});"
            yield _new_bit_rate(facts, row, device, text)


def _new_bit_rate(facts: Facts, row: SdoRow, device: Device, text: str) -> Finding:
    """A bit rate that the device has, and whether it can have become active."""
    save_first = (device.quirks.node_id_order or "").startswith("write, save")
    restart = restart_after(facts, (facts.number(row.bus), row.node), row.seq)
    back = restart is not None and _last_heard_ns(facts, row) > restart[1] + FADE_NS
    if save_first and restart and back and not _saved_before(facts, row, restart[0]):
        return told(
            "device.bit_rate_change",
            row,
            f"{text} it was reset at {facts.moment(restart[1])} without a save (1010h) in"
            " between, so that it keeps the bit rate that it had.",
            "A client changed the bit rate and did not save it.",
            "Where the new bit rate is meant: write it, save it, then reset the device.",
        )
    return told(
        "device.bit_rate_change",
        row,
        f"{text} that acts after a {'save and a ' if save_first else ''}reset.",
        "A client changed the bit rate.",
        "Change all devices of the bus; one with another bit rate disturbs it.",
    )


def _saved_before(facts: Facts, row: SdoRow, restart_seq: int) -> bool:
    """Whether a node saved its settings between a write and its next restart, or may have."""
    end_ns = row.end_ns or row.start_ns
    hidden = any(
        gap.bus in (None, row.bus) and gap.end_ns > end_ns for gap in facts.analysis.capture.gaps
    )
    return hidden or any(
        (save.bus, save.node) == (row.bus, row.node)
        and row.seq < save.seq < restart_seq
        and save.result != "abort"
        for save in facts.analysis.sdo.writes.of_objects(lambda of: of.index == SAVE)
    )


def _factory_resets(facts: Facts) -> Iterator[Finding]:
    """Factory resets: the node is another one afterwards."""
    for row, key, device in writes(facts):
        if device.quirks.factory_reset_writes.get(key) != number(row):
            continue
        rate = device.default_bitrate
        bus_rate = facts.context.bitrates.get(row.bus)
        home = factory_place(device)
        gone_ns = gone_since(facts, row)
        moves = device.default_node != row.node or (bus_rate is not None and bus_rate != rate)
        text = f"{facts.who(row.bus, row.node)} was set back to its factory values"
        text += f" ({named(device, key)} at {facts.moment(row.start_ns)}): after its next reset it"
        text += f" is {home}"
        if gone_ns is not None and moves:
            text += f"; as node {row.node} it was not heard again since {facts.moment(gone_ns)}"
            errors = _errors_since(facts, row.bus, gone_ns)
            if errors:
                text += f". The {errors} error frames since then have this cause: it sends at"
                text += " another bit rate" if bus_rate != rate else " a time when others send"
        finding = told(
            "device.factory_reset",
            row,
            text + ".",
            "A client gave the order; all settings of the device are gone with it.",
            f"Look for {home}, and configure it anew.",
            severe=gone_ns is not None and moves,
            assumed=facts.context.assumed_bitrate(row.bus) if bus_rate != rate else (),
        )
        yield with_restart(facts, row, finding) if finding.severity != "info" else finding


def factory_place(device: Device) -> str:
    """Number and bit rate that a device has by its factory settings."""
    return f"node {device.default_node} at {(device.default_bitrate or 0) / 1000:g} kbit/s"


def with_restart(facts: Facts, row: SdoRow, finding: Finding) -> Finding:
    """The same with the restart that moved the device: what is missed of it since follows."""
    restart = restart_after(facts, (facts.number(row.bus), row.node), row.seq)
    if restart is None:
        return finding
    return replace(finding, evidence=[*finding.evidence, restart[0]])


def gone_since(facts: Facts, row: SdoRow) -> int | None:
    """When the node was reset after the order, or heard last, if nothing was heard of it later."""
    key = facts.number(row.bus), row.node
    resets = [
        command.t_ns
        for command in facts.analysis.nmt_commands
        if command.bus == row.bus
        and command.node in (0, row.node)
        and command.command.startswith("reset")
        and command.seq > row.seq
    ]
    last_ns = _last_heard_ns(facts, row)
    gone_ns = min(resets, default=last_ns)
    quiet_ns = quirks(facts.context.shadow.device(*key)).reset_quiet_ms * 1_000_000
    if last_ns - gone_ns > FADE_NS or _listened_ns(facts, *key, gone_ns) < GONE_NS + quiet_ns:
        return None
    heard = [
        state
        for state in facts.analysis.nmt_states
        if (state.bus, state.node) == (row.bus, row.node)
        and state.start_ns > min(resets, default=row.end_ns)
        and state.state not in _NO_LIFE
    ]
    lost = any(
        (state.bus, state.node, state.state) == (row.bus, row.node, "LOST")
        and state.end_ns > row.end_ns
        for state in facts.analysis.nmt_states
    )
    return gone_ns if not heard and (lost or resets) else None


def _last_heard_ns(facts: Facts, order: SdoRow) -> int:
    """When a node sent anything last; of one without error control, when it answered last."""
    nmt = facts.control.nmt.nodes.get((facts.number(order.bus), order.node))
    rows = reversed(facts.analysis.sdo.of_node(order.bus, order.node))
    answered = (row for row in rows if row.result == "ok" or row.abort_by == "server")
    last_ns = next((row.end_ns for row in answered), order.end_ns)
    return max(order.end_ns, last_ns, (nmt.heard_ns if nmt else None) or 0)


def _listened_ns(facts: Facts, bus: int, node: int, since_ns: int) -> int:
    """How long a node could have been heard: not in gaps, nor while its whole bus was silent [ns]."""
    name, capture = facts.context.bus_name(bus), facts.analysis.capture
    unheard = sum(
        max(0, gap.end_ns - max(gap.start_ns, since_ns))
        for gap in capture.gaps
        if gap.bus in (None, name)
    )
    # Of a bus with a single node it is the node's own silence.
    if any(row.bus == name and row.node != node for row in facts.analysis.nodes):
        silence = facts.control.clock.silence_within(bus, since_ns, capture.end_ns)
        unheard += silence.end_ns - silence.start_ns if silence else 0
    return capture.end_ns - since_ns - unheard


def _errors_since(facts: Facts, bus: str, since_ns: int) -> int:
    return sum(
        row.count
        for row in facts.analysis.bus_errors
        if row.bus == bus and row.last_ns >= since_ns and row.first_ns >= since_ns
    )


def _foreign(facts: Facts) -> Iterator[Finding]:
    """Devices that send under the identifiers of a number that nobody else carries."""
    guessed = [pdo for pdo in facts.analysis.pdos if (pdo.pdo or "").endswith("(guess)")]
    for row in facts.analysis.nodes:
        device = facts.context.shadow.device(facts.number(row.bus), row.node)
        if device is None or device.quirks.pdo_cob_id_mask or "error control" not in row.proof:
            continue
        if any((pdo.bus, pdo.node) == (row.bus, row.node) for pdo in facts.analysis.pdos):
            continue
        strange = [pdo for pdo in guessed if pdo.bus == row.bus and _nobodys(facts, pdo)]
        owners = {pdo.node for pdo in strange}
        if owners == {device.default_node} and all(_fits(device, pdo) for pdo in strange):
            yield _bound_elsewhere(facts, row, strange, owners.pop() or 0)


def _nobodys(facts: Facts, pdo: PdoRow) -> bool:
    """Whether nothing but this PDO speaks for the number that its identifier belongs to."""
    return all(
        row.proof == ["pdo (guess)"]
        for row in facts.analysis.nodes
        if (row.bus, row.node) == (pdo.bus, pdo.node)
    )


def _fits(device: Device, pdo: PdoRow) -> bool:
    name = (pdo.pdo or "").split()[0]
    number = name.removeprefix("TPDO")
    return number.isdecimal() and device.object(0x1800 + int(number) - 1, 1) is not None


def _bound_elsewhere(facts: Facts, row: NodeRow, strange: Iterable[PdoRow], owner: int) -> Finding:
    pdos = sorted(strange, key=lambda pdo: pdo.cob_id)
    identifiers = ", ".join(f"{pdo.cob_id:03X}h" for pdo in pdos)
    settings = ", ".join(
        f'"{0x17FF + int((pdo.pdo or "TPDO1").split()[0][4:]):X}:1" = {pdo.cob_id:#x}'
        for pdo in pdos
    )
    capture = facts.analysis.capture
    return Finding(
        "device.foreign_identifiers",
        "info",
        row.bus,
        row.node,
        capture.begin_ns,
        capture.end_ns,
        f"{facts.who(row.bus, row.node)} sends no PDO under its own identifiers, and {identifiers}"
        f" of node {owner} come without a node {owner}: most likely they are its own.",
        "Its node id was changed after its settings had been saved, so that the saved identifiers"
        f" still belong to node {owner}.",
        f"State in the bus description [node.{row.node}.objects] {settings}; in the device restore"
        " the defaults (1011h), then save again.",
        [],
    )


RULES: tuple[Rule, ...] = (
    Rule(
        "device.node_id_change",
        "A node id was written; the text says under which number the device went on.",
        "The write.",
        (
            "A number that was heard before the write is not taken for the new one.",
            "The old number is not called lost where the device is heard under the new one.",
        ),
        _node_ids,
    ),
    Rule(
        "device.bit_rate_change",
        "A bit rate was written, which acts after a reset, or one that the device does not have.",
        "The write.",
        (
            "Writing the bit rate that the bus has is not told.",
            "It is not said to be kept where a gap, or a lost answer, may hide that it was saved.",
            "Nor is it of a node that was not heard again.",
        ),
        _bit_rates,
        untimed=True,
    ),
    Rule(
        "device.factory_reset",
        "A device was set back to its factory values: number and bit rate are others after a reset.",
        "The write.",
        (
            "It is a warning only where the node was not heard again.",
            "A node that may still be starting is not gone: 5 s, and its own silence after a reset.",
            "Gaps, and silences of the whole bus, do not count; any frame of the node does.",
        ),
        _factory_resets,
        untimed=True,
    ),
    Rule(
        "device.foreign_identifiers",
        "A device seems to send under identifiers that belong to another number.",
        "No single frame: the PDOs and the node without PDOs.",
        (
            "Only where nothing else speaks for the other number.",
            "Only devices whose identifiers cannot be written, and their factory number.",
        ),
        _foreign,
        untimed=True,
    ),
)
