"""Object-dictionary shadow: what is known of each node's objects at each moment, and from where."""

from bisect import bisect_right, insort
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.object_history import (
    MAX_CHANGES,
    Cause,
    Change,
    Known,
    ObjectHistory,
    Source,
    Span,
    Value,
)
from syncline_analyzer.reads import Reads, raw_values
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import (
    ABSENT,
    Device,
    either,
    identify,
    identify_among,
    identity_objects,
    lookalikes,
    named_objects,
    quirks,
    standard_of,
)
from syncline_schemas.measurement import position_objects

__all__ = ["MAX_CHANGES", "Known", "Shadow", "Source"]

Key = tuple[int, int]
"""(index, subindex) of an object."""
RESET_COMMUNICATION = 0x82
BEFORE = -1
"""`seq` of what was known before the first frame."""
BOOT_NS = 10_000_000_000
"""A boot-up this long after a reset command is still its effect [ns]."""


class _Rereads:
    """Reads that only confirmed a value, the last ones of them."""

    def __init__(self) -> None:
        self._parts: list[Reads] = []
        self._count = 0

    def add(self, reads: Reads) -> None:
        """Take in further ones."""
        # Joined only now and then: most objects are never asked for.
        if self._count > 2 * MAX_CHANGES:
            self._parts = [self.joined().part(slice(-MAX_CHANGES, None))]
            self._count = len(self._parts[0])
        self._parts.append(reads)
        self._count += len(reads)

    def joined(self) -> Reads:
        """All of them in order."""
        return Reads.joined(*self._parts) if len(self._parts) > 1 else self._parts[0]


class Shadow:
    """Values of objects per bus number and node over the capture, addressed by `seq`.

    Values learned from the bus come first, then the bus description, then the device's EDS.
    A None in a history means: thrown away by a reset, fall back to what is assumed. A capture gap
    forgets nothing: what was written before it is still the best that is known.
    """

    def __init__(
        self,
        bus_name: Callable[[int], str],
        description: BusDescription | None = None,
        devices: dict[int, Device] | None = None,
        attached: Sequence[Device] = (),
    ) -> None:
        self._bus_name = bus_name
        self._description = description or BusDescription()
        self._devices_by_node = dict(devices or {})
        self._attached = tuple(attached)
        """Devices whose files the capture carries: its recorder knew them, this machine may not."""
        self._telling = identity_objects() | named_objects(self._attached)
        self._identified: dict[tuple[int, int], Device | None] = {}
        self._known: dict[tuple[int, int], dict[Key, ObjectHistory]] = {}
        self._refused: dict[tuple[int, int], set[Key]] = {}
        self._rereads: dict[tuple[int, int, Key], _Rereads] = {}
        self._reset_seq: dict[tuple[int, int], int] = {}
        self._read_again: dict[tuple[int, int, Key], list[int]] = {}
        """`seq` of the first read after each reset that told the value of before."""
        self._partly_ns: dict[tuple[int, int], int] = {}
        """Time of the last command that reset a node's communication only."""
        self.version = 0
        """Grows with everything that may bind identifiers, so that readers know when to look again."""
        self.upset = 0
        """Grows when another object than the one that was read or written takes a new value."""
        self._configured: dict[tuple[int, int], list[int]] = {}
        """`seq` of every change of a node's communication profile."""

    def learn(self, bus: int, node: int, index: int, sub: int, known: Known) -> None:
        """Store a value seen on the bus; calls come in order of `seq`.

        A value that is read while no write waits to be saved is taken as the stored one.
        """
        key = (index, sub)
        if known.source == "sdo-read" and self.repeats(bus, node, key, known.value):
            self._note_read_again(bus, node, key, known.seq or 0)
            if self.is_position(bus, node, key):
                self.confirm(bus, node, key, Reads.of(known))
            return
        facts = quirks(self.device(bus, node))
        stored = facts.aliases.get(key, key)
        self.upset += stored != key
        self._store(bus, node, stored, known, key in facts.stored_at_once)
        if index in self._telling:
            self.version += 1
            self._identified.pop((bus, node), None)
        if known.source != "sdo-write":
            return
        self._follow_write(bus, node, key, known)

    def learn_columns(
        self,
        bus: int,
        node: int,
        key: Key,
        values: NDArray[Any],
        read: NDArray[np.bool_],
        seqs: NDArray[np.int64],
        t_ns: NDArray[np.int64],
    ) -> None:
        """Store reads and writes of one object in their order, as `learn` does with each of them.

        Not for objects that tell devices apart, or that change other ones by what a maker says.

        Args:
            bus, node, key: the object.
            values: (n,) int64, or objects (bytes); at least one.
            read: (n,) False for writes.
            seqs, t_ns: (n,) of the answers.
        """
        new = ~read
        new[1:] |= ~read[:-1] | (values[1:] != values[:-1])
        if read[0] and not self.repeats(bus, node, key, values[:1].tolist()[0]):
            new[0] = True
        elif read[0]:
            self._note_read_again(bus, node, key, int(seqs[0]))
        columns = (column[new].tolist() for column in (values, read, seqs, t_ns))
        told = [
            Known(value, "sdo-read" if by_read else "sdo-write", seq, at_ns)
            for value, by_read, seq, at_ns in zip(*columns, strict=True)
        ]
        if told:
            self._add(bus, node, key, told)
        if len(told) < len(new) and self.is_position(bus, node, key):
            raw = raw_values(values[~new])
            self.confirm(bus, node, key, Reads(seqs[~new], t_ns[~new], raw))

    def repeats(self, bus: int, node: int, key: Key, value: Value) -> bool:
        """Whether a read of a value only confirms what was read before."""
        history = self._known.get((bus, node), {}).get(key)
        last = history.changes[-1] if history and history.changes else None
        if last is None or last.known is None:
            return False
        return last.cause == "sdo-read" and last.known.value == value

    def tells(self, index: int) -> bool:
        """Whether devices are told apart by an object."""
        return index in self._telling

    def is_position(self, bus: int, node: int, key: Key) -> bool:
        """Whether every read of an object counts, also of a value that is known: it is measured."""
        return standard_of(*key) is not None or key in position_objects(self.device(bus, node))

    def confirm(self, bus: int, node: int, key: Key, reads: Reads) -> None:
        """Store reads of a position that brought what was known; see `take_rereads`."""
        kept = self._rereads.get((bus, node, key))
        if kept is None:
            kept = self._rereads[bus, node, key] = _Rereads()
        kept.add(reads)

    def recall(self, bus: int, node: int, key: Key, known: Known, *, kept: bool) -> None:
        """Store what was seen before the first frame; `kept`: a reset does not take it back."""
        self._store(bus, node, key, replace(known, seq=BEFORE), kept)
        self.version += 1
        if key[0] in self._telling:
            self._identified.pop((bus, node), None)

    def take_rereads(self, bus: int, node: int, index: int, sub: int, seq: int) -> Reads:
        """Reads of a position up to `seq` that only confirmed its value, since the last call."""
        kept = self._rereads.pop((bus, node, (index, sub)), None)
        if kept is None:
            return Reads.of()
        again = kept.joined()
        taken = int(np.searchsorted(again.seq, seq, "right"))
        if taken < len(again):
            left = self._rereads[bus, node, (index, sub)] = _Rereads()
            left.add(again.part(slice(taken, None)))
        return again.part(slice(taken))

    def refuse(self, bus: int, node: int, index: int, sub: int) -> None:
        """Note that the node said that it has no such object (abort 0602 0000)."""
        if self.is_refused(bus, node, index, sub):
            return
        self._refused.setdefault((bus, node), set()).add((index, sub))
        self.version += 1
        if index in self._telling:
            self._identified.pop((bus, node), None)

    def is_refused(self, bus: int, node: int, index: int, sub: int) -> bool:
        """Whether the node said that it has no such object."""
        return (index, sub) in self._refused.get((bus, node), ())

    def save(self, bus: int, node: int, seq: int, sub: int = 1) -> None:
        """Keep the values at `seq` as those that a reset falls back to (1010h `save`)."""
        for key, history in self._known.get((bus, node), {}).items():
            if history.changes and self.kept_by(bus, node, key, sub):
                history.keep(seq, history.last, unsaved=False)

    def restore(self, bus: int, node: int, seq: int, sub: int = 1) -> None:
        """Forget what was saved: the next reset falls back to what is assumed (1011h `load`)."""
        for key, history in self._known.get((bus, node), {}).items():
            if self.kept_by(bus, node, key, sub):
                history.keep(seq, None, unsaved=True)

    def reset(self, bus: int, node: int, seq: int, t_ns: int = 0, specifier: int = 0) -> None:
        """Throw written values back to the last saved ones; what came after `seq` stays.

        Args:
            bus, node: which node starts anew.
            seq, t_ns: the frame that tells it.
            specifier: 81h or 82h of the NMT command, 0 for a boot-up. 82h, and the boot-up that
                answers it, leave everything outside the communication profile 1000h..1FFFh alone
                (CiA 301 7.3.2.2), unless the device's maker says otherwise.
        """
        self.version += 1
        self.upset += 1
        self._reset_seq[bus, node] = seq
        all_of_it = not self._only_communication(bus, node, t_ns, specifier)
        for key, history in self._known.get((bus, node), {}).items():
            concerned = all_of_it or key[0] in _COMMUNICATION
            if concerned and history.reset(seq, t_ns) and key[0] in _COMMUNICATION:
                self._note(bus, node, seq)
        if self._identity_lost(bus, node):
            self._identified.pop((bus, node), None)

    def get(
        self, bus: int, node: int, index: int, sub: int = 0, seq: int | None = None
    ) -> Known | None:
        """What is known of an object at `seq` (at the end when None)."""
        history = self._known.get((bus, node), {}).get((index, sub))
        known = history.at(seq) if history is not None else None
        return known if known is not None else self.assumed(bus, node, index, sub)

    def number(
        self, bus: int, node: int, index: int, sub: int = 0, seq: int | None = None
    ) -> int | None:
        """The value of a numeric object, None when nothing is known."""
        known = self.get(bus, node, index, sub, seq)
        if known is None:
            return None
        return (
            known.value if isinstance(known.value, int) else int.from_bytes(known.value, "little")
        )

    def changes(self, bus: int, node: int, index: int, sub: int = 0) -> list[int]:
        """`seq` of every moment at which knowledge of an object changed."""
        history = self._known.get((bus, node), {}).get((index, sub))
        return list(history.seqs) if history else []

    def read_again(self, bus: int, node: int, index: int, sub: int = 0) -> list[int]:
        """`seq` of the first read after each reset that told the same value as before it."""
        return list(self._read_again.get((bus, node, (index, sub)), ()))

    def configured(self, bus: int, node: int, first: int, last: int) -> bool:
        """Whether anything of a node's communication profile changed at `first < seq <= last`."""
        seqs = self._configured.get((bus, node), [])
        return bisect_right(seqs, first) < bisect_right(seqs, last)

    def learned(self, bus: int, node: int) -> dict[Key, Known]:
        """The last value of every object that was seen on the bus and that no reset took back."""
        found = self._known.get((bus, node), {})
        return {key: known for key, h in found.items() if (known := h.last) is not None}

    def history(self, bus: int, node: int) -> Iterator[tuple[Key, ObjectHistory]]:
        """All objects of a node that were seen on the bus, by index and sub-index."""
        yield from sorted(self._known.get((bus, node), {}).items())

    def spans(self, bus: int, node: int, index: int, sub: int = 0) -> list[Span]:
        """Everything an object was over the capture, in order; empty when it was never seen."""
        history = self._known.get((bus, node), {}).get((index, sub))
        return list(history.spans()) if history is not None else []

    def confirmed(
        self, bus: int, node: int, index: int, sub: int = 0, seq: int | None = None
    ) -> int | None:
        """The value of a numeric object as the node itself told or acknowledged it, else None."""
        known = self.get(bus, node, index, sub, seq)
        sure = known is not None and known.confirmed
        return self.number(bus, node, index, sub, seq) if sure else None

    def nodes(self) -> list[tuple[int, int]]:
        """(bus, node) of which at least one object was seen."""
        return list(self._known)

    def nodes_of(self, bus: int) -> list[int]:
        """Nodes of a bus of which the bus, its description or the user tells anything."""
        name = self._bus_name(bus)
        seen = {node for on, node in self._known if on == bus}
        return sorted(
            seen | self._description.described(name).keys() | self._devices_by_node.keys()
        )

    def device(self, bus: int, node: int) -> Device | None:
        """Device of a node: as told by the user, else identified by the objects it answered."""
        if (bus, node) not in self._identified:
            self._identified[bus, node] = self._find_device(bus, node)
        return self._identified[bus, node]

    def name(self, bus: int, node: int) -> str | None:
        """Name of a node by the bus description."""
        entry = self._description.node(self._bus_name(bus), node)
        return entry.name if entry else None

    def described(self, bus: int, node: int) -> set[Key]:
        """Objects of which the bus description states a value."""
        entry = self._description.node(self._bus_name(bus), node)
        return set(entry.objects) if entry else set()

    def told_by(self, bus: int, node: int) -> Literal["--device", "bus description"] | None:
        """Who said what device a node is, before anything was seen of it."""
        if node in self._devices_by_node:
            return "--device"
        entry = self._description.node(self._bus_name(bus), node)
        return "bus description" if entry is not None and entry.device is not None else None

    def _find_device(self, bus: int, node: int) -> Device | None:
        if node in self._devices_by_node:
            return self._devices_by_node[node]
        entry = self._description.node(self._bus_name(bus), node)
        if entry is not None and entry.device is not None:
            return entry.device
        identity = self.identity(bus, node)
        if not identity:
            return None
        return (
            identify(identity)
            or either(lookalikes(identity))
            or identify_among(self._attached, identity)
        )

    def _note_read_again(self, bus: int, node: int, key: Key, seq: int) -> None:
        """Note that an object has the value of before a reset, once after each."""
        reset = self._reset_seq.get((bus, node), -1)
        history = self._known[bus, node][key]
        since = history.changes[-1].seq
        found = self._read_again.setdefault((bus, node, key), [])
        if reset > max(since, found[-1] if found else -1) and len(found) < MAX_CHANGES:
            found.append(seq)

    def _follow_write(self, bus: int, node: int, key: Key, known: Known) -> None:
        """What else changes with a write, by what the device's maker says."""
        facts = quirks(self.device(bus, node))
        for written, changed, value in facts.side_effects:
            if written == key:
                self.upset += 1
                self._store(bus, node, changed, replace(known, value=value), False, "side effect")
        seq, t_ns = known.seq or 0, known.t_ns or 0
        if facts.factory_reset_writes.get(key) == known.value:
            self.upset += 1
            for (index, _), history in self._known[bus, node].items():
                if index in _MANUFACTURER:
                    history.add(Change(seq, t_ns, None, "factory reset"))
                    history.keep(seq, None, unsaved=False)
        if facts.reset_writes.get(key) == known.value:
            self.reset(bus, node, seq, t_ns)

    def _only_communication(self, bus: int, node: int, t_ns: int, specifier: int) -> bool:
        """Whether a reset spares what is outside the communication profile."""
        if specifier == RESET_COMMUNICATION:
            self._partly_ns[bus, node] = t_ns
        elif specifier:
            self._partly_ns.pop((bus, node), None)
        since_ns = self._partly_ns.get((bus, node))
        facts = quirks(self.device(bus, node))
        quiet_ns = facts.reset_quiet_ms * 1_000_000
        if since_ns is None or facts.communication_reset_all:
            return False
        return t_ns - since_ns <= BOOT_NS + quiet_ns

    def _identity_lost(self, bus: int, node: int) -> bool:
        found = self._known.get((bus, node), {})
        return any(found[key].last is None for key in found if key[0] in self._telling)

    def _store(
        self, bus: int, node: int, key: Key, known: Known, at_once: bool, cause: Cause | None = None
    ) -> None:
        seq = known.seq
        assert seq is not None
        history = self._known.setdefault((bus, node), {}).setdefault(key, ObjectHistory())
        if known.source == "sdo-write":
            known = self._as_taken_over(bus, node, key, known)
            history.keep(seq, history.saved, unsaved=not at_once)
        if key[0] in _COMMUNICATION:
            self._note(bus, node, seq)
        reason: Cause = cause or ("sdo-write" if known.source == "sdo-write" else "sdo-read")
        history.add(Change(seq, known.t_ns or 0, known, reason))
        if not history.unsaved:
            history.keep(seq, known, unsaved=False)

    def _add(self, bus: int, node: int, key: Key, told: Sequence[Known]) -> None:
        """Store new values of one object, in their order."""
        history = self._known.setdefault((bus, node), {}).setdefault(key, ObjectHistory())
        at_once = key in quirks(self.device(bus, node)).stored_at_once
        changes = []
        for each in told:
            seq, cause = each.seq or 0, each.source
            changes.append(Change(seq, each.t_ns or 0, each, cause))  # type: ignore[arg-type]
            if cause == "sdo-write":
                history.keep(seq, history.saved, unsaved=not at_once)
            if not history.unsaved:
                history.keep(seq, each, unsaved=False)
            if key[0] in _COMMUNICATION:
                self._note(bus, node, seq)
        history.extend(changes)

    def _note(self, bus: int, node: int, seq: int) -> None:
        """Note that a node's communication profile changed."""
        self.version += 1
        seqs = self._configured.setdefault((bus, node), [])
        insort(seqs, seq)
        if len(seqs) > MAX_CHANGES:
            del seqs[: MAX_CHANGES // 2]

    def _as_taken_over(self, bus: int, node: int, key: Key, known: Known) -> Known:
        """A written PDO COB-ID as the device takes it: some only let bits of it change."""
        mask = quirks(self.device(bus, node)).pdo_cob_id_mask
        if not (0x1800 <= key[0] < 0x1A00 and key[1] == 1) or mask == 0xFFFFFFFF:
            return known
        before = self.number(bus, node, *key)
        if before is None or not isinstance(known.value, int):
            return known
        return replace(known, value=before & ~mask | known.value & mask)

    def kept_by(self, bus: int, node: int, key: Key, sub: int) -> bool:
        """Whether 1010h:sub keeps an object (CiA 301 7.5.2.13, or what the device's maker says)."""
        facts = quirks(self.device(bus, node))
        if facts.storage and not facts.saves_all:
            return key in facts.storage.get(sub, ())
        return key[0] in _SAVED_BY_SUB.get(sub, _ALL)

    def identity(self, bus: int, node: int) -> dict[Key, Value]:
        """What a node told of itself: value, or `ABSENT`, of the objects that tell devices apart.

        A node whose defaults were restored is the same device, whatever its objects hold now; one
        that says that it has no such object is not.
        """
        known = self._known.get((bus, node), {})
        refused = self._refused.get((bus, node), set())
        identity: dict[Key, Value] = {key: ABSENT for key in refused if key[0] in self._telling}
        for key, history in known.items():
            value = history.last if key in refused else history.told
            if key[0] in self._telling and value is not None:
                identity[key] = value.value
        return identity

    def assumed(self, bus: int, node: int, index: int, sub: int = 0) -> Known | None:
        """What the bus description or the device's EDS says of an object, bus or not."""
        entry = self._description.node(self._bus_name(bus), node)
        if entry is not None and (index, sub) in entry.objects:
            return Known(entry.objects[index, sub], "bus-description")
        device = self.device(bus, node)
        default = device.default(index, sub, node) if device else None
        return Known(default, "eds-default") if default is not None else None


_ALL = range(0x1000, 0x10000)
_COMMUNICATION = range(0x1000, 0x2000)
_MANUFACTURER = range(0x2000, 0x6000)
_SAVED_BY_SUB = {2: range(0x1000, 0x2000), 3: range(0x6000, 0xA000)}
