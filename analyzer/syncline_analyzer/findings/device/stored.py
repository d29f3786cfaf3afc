"""Findings on what devices keep over a reset, and what they forget."""

from collections.abc import Iterable, Iterator
from itertools import pairwise

from syncline_analyzer.findings.config.settings import assumed_words, restart_after
from syncline_analyzer.findings.device.identity import factory_place, gone_since, with_restart
from syncline_analyzer.findings.device.rules import Key, named, told, writes
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.object_history import Change, Known
from syncline_analyzer.results import Finding, SdoRow
from syncline_schemas.devices import Device, quirks
from syncline_schemas.records import dataclass

SAVE, LOAD = 0x1010, 0x1011
REWRITTEN_NS = 30_000_000_000
"""A master that writes its settings again this soon after a reset has lost nothing [ns]."""
LISTED = 8
_WIDE = 1 << 16
"""From here on numbers are written in hexadecimal digits: they are identifiers and mappings."""


def _defaults_pending(facts: Facts) -> Iterator[Finding]:
    """Defaults that were put into the memory and act from the next reset on."""
    for row, key, device in writes(facts):
        if key[0] != LOAD or not device.quirks.load_writes_storage:
            continue
        restart = restart_after(facts, (facts.number(row.bus), row.node), row.seq)
        since = (
            f"the defaults hold since the reset at {facts.moment(restart[1])}" if restart else None
        )
        if _set_again(facts, row):
            since = "the running ones were saved (1010h) in their place before a reset"
        moved = _moved_by_defaults(facts, row, device)
        finding = told(
            "device.defaults_pending",
            row,
            f"The maker's defaults were put into the memory of {facts.inside(row.bus, row.node)}"
            f" ({key[0]:04X}h:{key[1]:02X} written{facts.at(row.start_ns)}): the settings saved"
            f" before are gone, {since or 'the running ones stay until the next reset'}{moved}.",
            "A client restored the defaults.",
            f"Look for {factory_place(device)}, and configure it anew."
            if moved
            else "Was it meant? After the reset the master must write its settings again.",
            severe=bool(moved),
        )
        yield with_restart(facts, row, finding) if moved else finding


def _moved_by_defaults(facts: Facts, row: SdoRow, device: Device) -> str:
    """Words for a node that was not heard again since its defaults gave it another number."""
    order, bus = device.quirks.node_id_object, facts.number(row.bus)
    gone_ns = gone_since(facts, row)
    if gone_ns is None or order is None or device.default_node is None:
        return ""
    # Gone by the bit rate alone it is where it had its factory number already.
    moves = facts.context.shadow.kept_by(bus, row.node, order, row.sub or 0)
    rate = facts.context.bitrates.get(row.bus)
    other = device.default_node != row.node or rate not in (None, device.default_bitrate)
    if not moves or not other or _set_again(facts, row, order):
        return ""
    switches = (
        ", unless its rotary switches say otherwise" if device.quirks.node_id_switches else ""
    )
    return (
        f"; by these it is {factory_place(device)}{switches}; as node {row.node} it was not heard"
        f" again since {facts.moment(gone_ns)}"
    )


def _set_again(facts: Facts, load: SdoRow, order: Key | None = None) -> bool:
    """Whether a node saved what it had, or an object was written, between defaults and reset."""
    restart = restart_after(facts, (facts.number(load.bus), load.node), load.seq)
    return any(
        (row.bus, row.node) == (load.bus, load.node)
        and row.seq > load.seq
        and (restart is None or row.seq < restart[0])
        for row in facts.analysis.sdo.accepted.of_objects(
            lambda of: of.index == SAVE or (of.index, of.sub or 0) == order
        )
    )


@dataclass(frozen=True, slots=True)
class _Fall:
    """A written value that a reset took back; `now` is the best that is known of it since."""

    key: Key
    reset: Change
    written: Known
    now: Known | None
    why: str
    """Why it was not kept: "not saved", "not storable" or "the defaults were restored"."""


def _lost_at_reset(facts: Facts) -> Iterator[Finding]:
    """Values that were written, not saved, and fell back with a reset."""
    saves, loads = _orders(facts, SAVE), _orders(facts, LOAD)
    for bus, node in sorted(facts.context.shadow.nodes()):
        place = facts.context.bus_name(bus), node
        fallen = _fallen_back(facts, bus, node, saves.get(place, []), loads.get(place, []))
        lost = sorted(fallen, key=lambda fall: (fall.reset.seq, fall.key))
        if not lost:
            continue
        device = facts.context.shadow.device(bus, node)
        first, last = lost[0].reset, lost[-1].reset
        resets = len({fall.reset.seq for fall in lost})
        texts = list(dict.fromkeys(_in_words(device, fall) for fall in lost))
        more = f" and {len(texts) - LISTED} more" if len(texts) > LISTED else ""
        often = f", {resets} times in all" if resets > 1 else ""
        name = facts.context.bus_name(bus)
        assumed = (each for f in lost for each in assumed_words(*f.key, f.now))
        yield Finding(
            "device.lost_at_reset",
            "info",
            name,
            node,
            first.t_ns,
            last.t_ns,
            f"{facts.who(name, node)} went back to its stored values when it was reset at"
            f" {facts.moment(first.t_ns)}{often}: {'; '.join(texts[:LISTED])}{more}.",
            "The values were written but not saved (1010h), or the device cannot store them; and"
            " nobody wrote them again after the reset.",
            "Save the settings after writing them, or let the master write them after each boot-up.",
            [fall.reset.seq for fall in lost][:LISTED],
            assumed=list(dict.fromkeys(assumed)),
        )


def _fallen_back(
    facts: Facts, bus: int, node: int, saves: list[int], loads: list[int]
) -> Iterator[_Fall]:
    """Every written value that a reset took back.

    `saves` and `loads` are the times at which the node was told to save, to restore its defaults.
    """
    shadow = facts.context.shadow
    device = shadow.device(bus, node)
    for key, history in shadow.history(bus, node):
        if key[0] in (0x1010, LOAD) or _is_command(device, key):
            continue
        for before, after, following in _triples(history.changes):
            written = before.known
            if after.cause != "reset" or written is None or written.source != "sdo-write":
                continue
            read = following is not None and following.cause == "sdo-read"
            if _rewritten(after, following) or not (read or _persistence_known(device, key)):
                continue
            if not read and _unseen(facts, bus, before.t_ns, after.t_ns):
                continue
            now = after.known or shadow.assumed(bus, node, *key)
            if following is not None and read:
                now = following.known
            made_offset = _makes_offset(device, key)
            if made_offset and _offset_told(facts, bus, node, device, before.seq, after.seq):
                continue
            kept = now is not None and now.value == written.value
            if kept and (read or not made_offset):
                continue
            saved = any(before.t_ns < save_ns <= after.t_ns for save_ns in saves)
            restored = any(before.t_ns < load_ns <= after.t_ns for load_ns in loads)
            if restored or not (saved and _effect_kept(device, key)):
                why = "not storable" if saved else "not saved"
                why = "the defaults were restored" if restored else why
                yield _Fall(key, after, written, now, why)


def _rewritten(reset: Change, following: Change | None) -> bool:
    """Whether somebody wrote the object again soon after the reset."""
    if following is None or following.cause != "sdo-write":
        return False
    return following.t_ns - reset.t_ns <= REWRITTEN_NS


def _persistence_known(device: Device | None, key: Key) -> bool:
    """Whether the maker says what a reset does to an object; else only a read proves it."""
    facts = device.object(*key) if device else None
    return facts is not None and facts.persisted in ("yes", "no")


def _triples(changes: list[Change]) -> Iterable[tuple[Change, Change, Change | None]]:
    after: list[Change | None] = [*changes[2:], None]
    return ((a, b, c) for (a, b), c in zip(pairwise(changes), after, strict=False))


def _is_command(device: Device | None, key: Key) -> bool:
    """Whether a write to the object is an order and not a setting."""
    facts = quirks(device)
    orders = {*facts.reset_writes, *facts.factory_reset_writes}
    identity = (facts.node_id_object, facts.bitrate_object)
    return key in orders or key in identity


def _makes_offset(device: Device | None, key: Key) -> bool:
    """Whether a write makes the offset that moves the position: a preset."""
    measured = device.measurement if device else {}
    return key == measured.get("preset") and "offset" in measured


def _offset_told(
    facts: Facts, bus: int, node: int, device: Device | None, first: int, last: int
) -> bool:
    """Whether another write gave the offset a new value between a preset and a reset.

    Or whether it was read after the preset, and the same again after the reset.
    """
    shadow, offset = facts.context.shadow, device.measurement["offset"] if device else (0, 0)
    spans = shadow.spans(bus, node, *offset)
    inside = [span.change for span in spans if first < span.change.seq < last]
    if any(change.cause == "side effect" for change in inside):
        return True
    again = any(seq > last for seq in shadow.read_again(bus, node, *offset))
    return again and bool(inside) and inside[-1].cause == "sdo-read"


def _unseen(facts: Facts, bus: int, start_ns: int, end_ns: int) -> bool:
    """Whether a gap may hide that a node was told to save."""
    return any(
        gap.bus in (None, facts.context.bus_name(bus))
        and gap.start_ns < end_ns
        and gap.end_ns > start_ns
        for gap in facts.analysis.capture.gaps
    )


def _effect_kept(device: Device | None, key: Key) -> bool:
    """Whether what a write did is saved although the object itself is not (a preset's offset)."""
    measured = device.measurement if device else {}
    if not _makes_offset(device, key):
        return False
    return any(measured["offset"] in kept for kept in quirks(device).storage.values())


def _in_words(device: Device | None, fall: _Fall) -> str:
    measured = device.measurement if device else {}
    then, name = _shown(fall.written.value), named(device, fall.key)
    if _makes_offset(device, fall.key):
        offset = f"{measured['offset'][0]:04X}h"
        return f"{name} = {then}: the offset {offset} that it made is lost"
    why = fall.why
    if fall.now is None:
        return f"{name} no longer {then}, its value is not known ({why})"
    wide = any(
        isinstance(value, int) and abs(value) >= _WIDE
        for value in (fall.written.value, fall.now.value)
    )
    then, back = (_shown(value, wide=wide) for value in (fall.written.value, fall.now.value))
    return f"{name} back from {then} to {back} ({why})"


def _shown(value: int | bytes, *, wide: bool = False) -> str:
    if isinstance(value, bytes):
        return value.hex(" ").upper()
    return f"{value:X}h" if value and (wide or abs(value) >= _WIDE) else str(value)


def _orders(facts: Facts, index: int) -> dict[tuple[str, int], list[int]]:
    """Times [ns] at which writes to 1010h or 1011h of each node were confirmed."""
    found: dict[tuple[str, int], list[int]] = {}
    for row in facts.analysis.sdo.accepted.of_objects(lambda of: of.index == index):
        found.setdefault((row.bus, row.node), []).append(row.end_ns)
    return found


RULES: tuple[Rule, ...] = (
    Rule(
        "device.defaults_pending",
        "Defaults were restored; they act only from the next reset on.",
        "The write to 1011h.",
        (
            "A refused write restores nothing.",
            "A node is sought elsewhere only where the defaults hold its number, and it was silent.",
            "It is silent from 5 s after the reset on, and its own time of silence.",
            "Gaps, and silences of the whole bus, do not count; any frame of the node does.",
            "One that saved its settings, or took a number, before the reset is not sought there.",
        ),
        _defaults_pending,
        untimed=True,
    ),
    Rule(
        "device.lost_at_reset",
        "Settings that were written fell back at a reset, because they were not saved.",
        "The frames that tell of the resets.",
        (
            "Settings that the master writes again after the reset are not told.",
            "Where the maker does not say what survives, only a read after the reset proves it.",
            "A preset whose offset was saved is not lost, nor one whose offset another write ended.",
            "Nor is one whose offset (6509h) is read after the reset as before it.",
            "After a gap, which may hide a save, only a read proves that a value was lost.",
        ),
        _lost_at_reset,
    ),
)
