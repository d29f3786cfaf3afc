"""From frames to what the live view shows: states, EMCYs, decoded values, bus load."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from syncline_logger.bus_condition import BusCondition
from syncline_logger.decoding import LiveDecoder
from syncline_logger.live_status import LiveStatus
from syncline_logger.live_view.taken import Begun, Taken
from syncline_logger.pdo_values import PdoValues
from syncline_logger.triggers.event import Event
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.canopen import nmt
from syncline_schemas.canopen.emcy import EMCY_BYTES
from syncline_schemas.canopen.nmt import RESETS, STATE_OF_BYTE, NmtState
from syncline_schemas.canopen.services import Service, service_of
from syncline_schemas.devices.model import Quirks, emcy_meaning, quirks, register_bits

LOOK_NS = 500_000_000
"""How often bus load and silent nodes are looked at [ns]."""
START_NS = 3_000_000_000
"""A node that was reset is not called lost for so long [ns], and what its device needs besides."""
MAX_SIGNALS = 500
"""Different values that are shown; further ones are not."""

Level = Literal["ERROR", "WARN", "INFO"]
Int64s = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Node:
    """A node by bus, number and name."""

    bus: str
    number: int
    name: str = ""

    @property
    def label(self) -> str:
        """Number and name."""
        return f"{self.number} {self.name}".strip()


@dataclass(frozen=True, slots=True)
class StateRow:
    """A node has this state from then on."""

    node: Node
    t_ns: int
    state: str


@dataclass(frozen=True, slots=True)
class LogRow:
    """Something that is worth a line."""

    t_ns: int
    level: Level
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class SignalRows:
    """Values of one mapped object. t_ns: (n,) int64; values: (n,) float64."""

    node: Node
    name: str
    unit: str
    t_ns: Int64s
    values: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoadRow:
    """How full a bus was until then [%]."""

    bus: str
    t_ns: int
    percent: float


@dataclass(slots=True)
class Shown:
    """What is new."""

    states: list[StateRow] = field(default_factory=list)
    log: list[LogRow] = field(default_factory=list)
    signals: list[SignalRows] = field(default_factory=list)
    loads: list[LoadRow] = field(default_factory=list)


class Scene:
    """Knows what was shown, to show what is new; fed with frames, no I/O."""

    def __init__(self, begun: Begun) -> None:
        self._names = {bus.number: bus.name for bus in begun.buses}
        self._description = begun.description
        self._conditions = [BusCondition(bus.interface, bus.number) for bus in begun.buses]
        self._status = LiveStatus(begun.buses, begun.start_ns)
        self._columns = _Columns(self)
        self._decoder = LiveDecoder(self._names, self._description, watch=self._columns)
        self._states: dict[tuple[int, int], str] = {}
        self._quiet_until_ns: dict[tuple[int, int], int] = {}
        self._looked_ns = begun.start_ns

    def take(self, taken: Taken) -> Shown:
        """What the next frames bring."""
        shown = Shown()
        self._columns.shown = shown
        frames = taken.frames
        self._status.update(frames, taken.log_ns)
        for heard in taken.heard:
            self._status.listened(*heard)
        if len(frames):
            self._decoder.decode(frames, taken.log_ns)
            self._look_at_frames(frames, shown)
        now_ns = max((heard.end_ns for heard in taken.heard), default=self._looked_ns)
        if now_ns - self._looked_ns >= LOOK_NS:
            self._looked_ns = now_ns
            self._look_around(now_ns, shown)
        shown.states.sort(key=lambda row: row.t_ns)
        shown.log.sort(key=lambda row: row.t_ns)
        return shown

    def node(self, bus: int, number: int) -> Node:
        """A node with the name that its description gives."""
        name = self._names[bus]
        entry = self._description.node(name, number)
        return Node(name, number, entry.name or "" if entry else "")

    def _look_at_frames(self, frames: FrameBatch, shown: Shown) -> None:
        service = service_of(frames)
        data = (frames.flags & np.uint16(FrameFlag.REMOTE)) == 0
        for row in np.flatnonzero(data & (service == Service.EMCY)).tolist():
            shown.log.append(self._emcy(frames, row))
        for row in np.flatnonzero(data & (service == Service.NMT) & (frames.dlc == 2)).tolist():
            shown.log.append(self._command(frames, row))
            shown.states += self._reset_by(frames, row)
        heard = data & (service == Service.ERROR_CONTROL) & (frames.dlc == 1)
        shown.states += self._states_of(frames, np.flatnonzero(heard), shown)

    def _emcy(self, frames: FrameBatch, row: int) -> LogRow:
        bus, number = int(frames.bus[row]), int(frames.can_id[row]) & 0x7F
        data = frames.payload(row)
        entry = self._description.node(self._names[bus], number)
        device = entry.device if entry else None
        code = int.from_bytes(data[:2], "little")
        text = f"EMCY {code:04X}h {emcy_meaning(device, code)}"
        if len(data) >= EMCY_BYTES and data[2]:
            text += f", register {data[2]:02X}h {' '.join(register_bits(device, data[2]))}"
        level: Level = "ERROR" if code >> 8 else "INFO"
        return LogRow(int(frames.t_ns[row]), level, f"{self._who(bus, number)}: {text}")

    def _command(self, frames: FrameBatch, row: int) -> LogRow:
        command, number = (int(byte) for byte in frames.data[row, :2])
        whom = self._who(int(frames.bus[row]), number) if number else "all nodes"
        return LogRow(int(frames.t_ns[row]), "INFO", f"{nmt.command_name(command)}: {whom}")

    def _reset_by(self, frames: FrameBatch, row: int) -> Iterator[StateRow]:
        """Nodes that a command resets start anew, and may be silent for as long as their kind is."""
        command, target = (int(byte) for byte in frames.data[row, :2])
        t_ns, bus = int(frames.t_ns[row]), int(frames.bus[row])
        for key in [key for key in self._states if key[0] == bus and target in (0, key[1])]:
            if command in RESETS:
                quiet_ns = self._quirks(*key).reset_quiet_ms * 1_000_000
                self._quiet_until_ns[key] = t_ns + quiet_ns + START_NS
                yield from self._changed(*key, t_ns, NmtState.INITIALISING)

    def _quirks(self, bus: int, number: int) -> Quirks:
        entry = self._description.node(self._names[bus], number)
        return quirks(entry.device if entry else None)

    def _who(self, bus: int, number: int) -> str:
        several = f"{self._names[bus]} " if len(self._names) > 1 else ""
        return f"{several}node {self.node(bus, number).label}"

    def _states_of(
        self, frames: FrameBatch, rows: NDArray[np.intp], shown: Shown
    ) -> Iterator[StateRow]:
        """Each change that a heartbeat, guard answer or boot-up tells, at its own time."""
        key = frames.bus[rows].astype(np.int64) << 7 | (frames.can_id[rows] & 0x7F)
        for each in np.unique(key).tolist():
            bus, number = each >> 7, each & 0x7F
            mine = rows[key == each]
            if self._tells_nothing(bus, number):
                mine = mine[frames.data[mine, 0] != 0]
            state = frames.data[mine, 0] & 0x7F
            new = np.concatenate(([True], state[1:] != state[:-1])) | (frames.data[mine, 0] == 0)
            for row in mine[new].tolist():
                t_ns, byte = int(frames.t_ns[row]), int(frames.data[row, 0]) & 0x7F
                if not byte:
                    shown.log.append(LogRow(t_ns, "WARN", f"{self._who(bus, number)}: boot-up"))
                told = NmtState.PRE_OPERATIONAL if not byte else STATE_OF_BYTE.get(byte)
                yield from self._changed(bus, number, t_ns, told or NmtState.UNKNOWN)

    def _tells_nothing(self, bus: int, number: int) -> bool:
        """Whether the byte 00h of a node may be no boot-up, but its answer to a remote frame."""
        odd = self._quirks(bus, number).empty_heartbeat_after_rtr
        return odd and (bus, number) in self._states

    def _changed(self, bus: int, number: int, t_ns: int, state: str) -> Iterator[StateRow]:
        if self._states.get((bus, number)) != state:
            self._states[bus, number] = state
            yield StateRow(self.node(bus, number), t_ns, state)

    def _look_around(self, now_ns: int, shown: Shown) -> None:
        """Nodes that have become silent, and how full the buses are."""
        numbers = {name: number for number, name in self._names.items()}
        for bus in self._status.snapshot(now_ns, "", 0, self._conditions).buses:
            number = numbers[bus.name]
            if bus.load_percent is not None:
                shown.loads.append(LoadRow(bus.name, now_ns, bus.load_percent))
            for node, state in bus.nodes.items():
                if now_ns < self._quiet_until_ns.get((number, node), now_ns):
                    continue
                if state == NmtState.LOST and self._states.get((number, node)) != state:
                    shown.states += self._changed(number, node, now_ns, state)
                    text = f"{self._who(number, node)} is silent: LOST"
                    shown.log.append(LogRow(now_ns, "ERROR", text))


class _Columns:
    """Takes the decoded columns of PDOs."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._known: set[tuple[int, int, str]] = set()
        self.shown = Shown()

    def update(self, values: PdoValues) -> tuple[list[Event], list[str]]:
        """Show the values of one PDO; there are no events and no problems."""
        who = self._scene.node(values.bus, values.node)
        for column in values.columns:
            entry = column.entry
            key = (values.bus, values.node, entry.name)
            if key not in self._known and len(self._known) >= MAX_SIGNALS:
                continue
            self._known.add(key)
            rows = SignalRows(who, entry.name, entry.unit, values.t_ns, column.value)
            self.shown.signals.append(rows)
        return [], []
