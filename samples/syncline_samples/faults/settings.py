"""What the master changes at run time by SDO: identifiers, mappings, storage, node ids, resets."""

from dataclasses import dataclass

from syncline_samples.devices.common import LOAD, SAVE
from syncline_samples.machine import Machine
from syncline_samples.master import RESET_COMMUNICATION, RESET_NODE, Master
from syncline_samples.sdo_client import SdoJob, read, write

PDO_OFF = 1 << 31
_SETTLE_S = 0.3
"""For a few transfers."""
_RESET_S = 0.02
"""For a reset command to reach its node."""


@dataclass(frozen=True, slots=True)
class MovePdo:
    """The master gives TPDO (or RPDO) `pdo` another identifier, with the PDO off meanwhile."""

    node: int
    at_s: float
    can_id: int
    pdo: int = 1
    receive: bool = False

    def arm(self, machine: Machine) -> None:
        """Queue the writes."""
        index = (0x13FF if self.receive else 0x17FF) + self.pdo
        off = write(index, 1, PDO_OFF | self.can_id, 4)
        machine.at(
            self.at_s, machine.master.sdo(self.node).run, off, write(index, 1, self.can_id, 4)
        )
        if self.receive:
            machine.at(self.at_s + _SETTLE_S / 3, setattr, machine, "outputs_id", self.can_id)
        else:
            _may_look_missed(machine, self.node, self.at_s)


@dataclass(frozen=True, slots=True)
class RemapPdo:
    """The master maps other objects into TPDO `pdo`; each entry as 1A0xh holds it."""

    node: int
    at_s: float
    entries: tuple[int, ...]
    pdo: int = 1

    def arm(self, machine: Machine) -> None:
        """Switch the PDO off, write the mapping, switch it on."""
        machine.at(self.at_s, self._begin, machine)
        _may_look_missed(machine, self.node, self.at_s)

    def _begin(self, machine: Machine) -> None:
        index = 0x17FF + self.pdo
        cob_id = machine.nodes[self.node].objects.number(index, 1)
        mapping = index + 0x200
        jobs = [write(index, 1, PDO_OFF | cob_id, 4), write(mapping, 0, 0, 1)]
        for sub, entry in enumerate(self.entries, 1):
            jobs.append(write(mapping, sub, entry, 4))
        jobs += [write(mapping, 0, len(self.entries), 1), write(index, 1, cob_id, 4)]
        machine.master.sdo(self.node).run(*jobs)


@dataclass(frozen=True, slots=True)
class MoveEmcy:
    """The master gives the EMCYs of a node another identifier (1014h)."""

    node: int
    at_s: float
    can_id: int

    def arm(self, machine: Machine) -> None:
        """Queue the write."""
        machine.at(self.at_s, machine.master.sdo(self.node).run, write(0x1014, 0, self.can_id, 4))


@dataclass(frozen=True, slots=True)
class MoveSync:
    """The master writes 1005h of some nodes, then the SYNC moves; other nodes get none any more."""

    at_s: float
    can_id: int
    nodes: tuple[int, ...]

    def arm(self, machine: Machine) -> None:
        """Queue the writes, then move the producer."""
        for node in self.nodes:
            machine.at(self.at_s, machine.master.sdo(node).run, write(0x1005, 0, self.can_id, 4))
        machine.at(self.at_s + _SETTLE_S, setattr, machine.sync, "can_id", self.can_id)
        for node in machine.nodes:
            _may_look_missed(machine, node, self.at_s, machine.scenario.seconds)
        machine.expect("sync.missing", None, self.at_s, machine.scenario.seconds, required=False)


@dataclass(frozen=True, slots=True)
class MoveSdo:
    """The master gives the SDO server of a node other identifiers: 1200h, save, reset."""

    node: int
    at_s: float
    request_id: int
    answer_id: int

    def arm(self, machine: Machine) -> None:
        """Write, save, reset; the master asks on the new identifiers from then on."""
        jobs = (
            write(0x1200, 1, self.request_id, 4),
            write(0x1200, 2, self.answer_id, 4),
            write(0x1010, 1, SAVE, 4),
        )
        machine.at(self.at_s, machine.master.sdo(self.node).run, *jobs)
        machine.at(self.at_s + _SETTLE_S, self._reset, machine.master)

    def _reset(self, master: Master) -> None:
        master.command(RESET_COMMUNICATION, self.node)
        master.sdo(self.node).move(self.request_id, self.answer_id)


@dataclass(frozen=True, slots=True)
class Storage:
    """The master writes, stores (`save`) or restores (`load`) and resets the node: no finding.

    Attributes:
        jobs: writes before.
        what: `save`, `load`, or nothing: the reset then throws unsaved writes away.
        sub: which group of 1010h or 1011h.
        specifier: NMT reset node or reset communication.
    """

    node: int
    at_s: float
    jobs: tuple[SdoJob, ...] = ()
    what: str = "save"
    sub: int = 1
    specifier: int = RESET_NODE

    def arm(self, machine: Machine) -> None:
        """Queue the writes and the reset."""
        jobs = list(self.jobs)
        if self.what == "save":
            jobs.append(write(0x1010, self.sub, SAVE, 4))
        elif self.what == "load":
            jobs.append(write(0x1011, self.sub, LOAD, 4))
        machine.at(self.at_s, machine.master.sdo(self.node).run, *jobs)
        at_s = self.at_s + _SETTLE_S
        machine.at(at_s, machine.master.command, self.specifier, self.node)
        machine.at(at_s + _RESET_S, machine.learn_boot_up, self.node)
        for finding in ("device.defaults_pending", "device.lost_at_reset", "config.not_saved"):
            machine.expect(finding, self.node, self.at_s, machine.scenario.seconds, required=False)


@dataclass(frozen=True, slots=True)
class ResetBySdo:
    """The master resets a JN2100 by 2002h: a boot-up without any NMT command, but no fault."""

    node: int
    at_s: float

    def arm(self, machine: Machine) -> None:
        """Queue the write."""
        machine.at(self.at_s, machine.master.sdo(self.node).run, write(0x2002, 0, 1, 1))
        machine.expect("device.reset_by_sdo", self.node, self.at_s, required=False)


@dataclass(frozen=True, slots=True)
class FactoryReset:
    """The master resets a JN2100 to factory values by 207Fh: after the next reset it is node 10."""

    node: int
    at_s: float

    def arm(self, machine: Machine) -> None:
        """Queue the write, its check and the reset."""
        jobs = (write(0x207F, 0, 1, 1), read(0x207F))
        machine.at(self.at_s, machine.master.sdo(self.node).run, *jobs)
        at_s = self.at_s + _SETTLE_S
        machine.at(at_s, machine.master.adopt, self.node, 10)
        machine.at(at_s, machine.master.command, RESET_NODE, self.node)
        number_changed(machine, self.node, at_s)


@dataclass(frozen=True, slots=True)
class NodeIdChange:
    """The master gives a node another number, stores it and resets the node.

    The old number is silent from then on; the master knows the new one.
    """

    node: int
    at_s: float
    to: int

    def arm(self, machine: Machine) -> None:
        """Queue the writes and the reset."""
        index = machine.nodes[self.node].number_object
        width = 0 if index == 0x2101 else 1
        jobs = (write(index, 0, self.to, width), write(0x1010, 1, SAVE, 4))
        machine.at(self.at_s, machine.master.sdo(self.node).run, *jobs)
        at_s = self.at_s + _SETTLE_S
        machine.at(at_s, machine.master.adopt, self.node, self.to)
        machine.at(at_s, machine.master.command, RESET_NODE, self.node)
        machine.at(at_s + _RESET_S, machine.learn_boot_up, self.node)
        number_changed(machine, self.node, at_s)
        # The description knows the device under its old number only.
        machine.expect("device.looks_like", self.to, at_s, machine.scenario.seconds, required=False)


def number_changed(machine: Machine, node: int, at_s: float) -> None:
    """What may be said of a number that a node has left for another one."""
    for finding in (
        "nmt.node_lost",
        "nmt.missing_after_gap",
        "nmt.command_ignored",
        "nmt.no_boot_up",
        "device.node_id_change",
        "device.factory_reset",
        "device.lost_at_reset",
        "config.pending_node_id",
        "config.factory_defaults",
    ):
        machine.expect(finding, node, at_s, machine.scenario.seconds, required=False)


def _may_look_missed(machine: Machine, node: int, at_s: float, for_s: float = 1.0) -> None:
    machine.expect("pdo.missed", node, at_s, for_s, required=False)
