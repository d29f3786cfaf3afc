"""SKB IS LIR-DA158 (old) and LIR-DA158A, LIR-MA158K, LIR-918 (new): sheets skbis-lir-*.md."""

from dataclasses import dataclass
from functools import partial

from syncline_samples.devices.common import const, error_list, serve_error_list, serve_storage
from syncline_samples.motion import Shaft
from syncline_samples.node import Node, State
from syncline_samples.objects import Object
from syncline_samples.tpdo import Tpdo
from syncline_samples.world import MS, World

_TURN = 1_000_000_000
_PDO_OFF = 1 << 31


@dataclass(frozen=True, slots=True)
class LirModel:
    """What differs between the models; `old` is the generation of the LIR-DA158."""

    text: bytes
    product: int
    counts_per_turn: int = 1 << 17
    turns: int = 1
    old: bool = False


MODELS = {
    "lir-da158": LirModel(b"L158", 0x000CA001, old=True),
    "lir-da158a": LirModel(b"L158", 0x000CA001),
    "lir-ma158k": LirModel(b"M158", 0x000CB001, turns=4096),
    "lir-918": LirModel(b"L918", 0x000D0001, counts_per_turn=1 << 13, turns=4096),
}


def _communication(node_id: int, old: bool) -> list[Object]:
    objects = [
        const(0x1000, 0, "u32", 0x00010196),
        const(0x1001, 0, "u8", 0),
        *error_list(8),
        const(0x1005, 0, "u32", 0x80),
        const(0x1009, 0, "str", b"1.00"),
        const(0x100A, 0, "str", b"1.00"),
        Object(0x100C, 0, "u16", "rw", 0, kept=True),
        Object(0x100D, 0, "u8", "rw", 0, kept=True),
        const(0x1010, 0, "u8", 3 if old else 1),
        Object(0x1010, 1, "u32", "rw", 0),
        const(0x1011, 0, "u8", 4),
        Object(0x1011, 1, "u32", "rw", 0),
        const(0x1011, 4, "u32", 1),
        const(0x1014, 0, "u32", 0x80 + node_id),
        const(0x1016, 0, "u8", 1),
        Object(0x1016, 1, "u32", "rw", 0, kept=True),
        Object(0x1017, 0, "u16", "rw", 0, kept=True),
        const(0x1018, 0, "u8", 4),
        const(0x1018, 1, "u32", 0),
        const(0x1018, 3, "u32", 0x00010000),
        const(0x1029, 0, "u8", 1),
        Object(0x1029, 1, "u8", "rw", 1, kept=True, low=0, high=1 if old else 2),
        Object(0x2100, 0, "u8", "rw", 8, kept=True, low=0, high=8),
        Object(0x2101, 0, "u8", "rw", node_id, kept=True, low=1, high=127),
    ]
    for number, (kind, timer_ms) in enumerate(((0xFE, 0x0203), (2, 0x0100))):
        objects += [
            const(0x1800 + number, 0, "u8", 5),
            Object(0x1800 + number, 1, "u32", "rw", 0x180 + 0x100 * number + node_id),
            Object(0x1800 + number, 2, "u8", "rw", kind, kept=True),
            Object(0x1800 + number, 5, "u16", "rw", timer_ms, kept=True),
            const(0x1A00 + number, 0, "u8", 1),
            const(0x1A00 + number, 1, "u32", 0x60040020),
            Object(0x2800 + number, 0, "u8", "rw", 0, kept=True),
        ]
    if old:
        objects += [Object(0x1010, sub, "u32", "rw", 0) for sub in (2, 3)]
        objects += [Object(0x1011, sub, "u32", "rw", 0) for sub in (2, 3)]
    else:
        objects.append(Object(0x1015, 0, "u16", "rw", 0, kept=True))
    return objects


def _application(model: LirModel, serial: int, converter: bool) -> list[Object]:
    objects = [
        const(0x1008, 0, "str", model.text),
        const(0x1018, 2, "u32", model.product),
        const(0x1018, 4, "u32", serial),
        Object(0x6000, 0, "u16", "rw", 0, kept=True),
        Object(
            0x6001,
            0,
            "u32",
            "rw" if converter else "ro",
            model.counts_per_turn,
            kept=converter,
            low=1,
            high=model.counts_per_turn,
        ),
        const(0x6002, 0, "u32", model.counts_per_turn * model.turns),
        Object(0x6003, 0, "u32", "rw" if model.old else "wo", 0, kept=model.old),
        const(0x6004, 0, "u32", 0),
        const(0x6500, 0, "u16", 4),
        const(0x6501, 0, "u32", model.counts_per_turn),
        const(0x6502, 0, "u16", model.turns),
        Object(0x6509, 0, "i32", "ro", 0, kept=True),
        const(0x650B, 0, "u32", serial),
    ]
    if model.old:
        objects += [
            Object(0x6200, 0, "u16", "rw", 0x0203),
            const(0x6503, 0, "u16", 0),
            const(0x6504, 0, "u16", 1),
            const(0x6505, 0, "u16", 0),
            const(0x6506, 0, "u16", 4),
            const(0x6507, 0, "u32", 0x01000100),
            const(0x6508, 0, "u32", 0),
        ]
    return objects


class Lir(Node):
    """An encoder of SKB IS on a shaft.

    Args:
        model: `lir-da158`, `lir-da158a`, `lir-ma158k` or `lir-918`.
        empty_heartbeat: state byte after a remote frame hit the heartbeat: empty or one zero byte.
    """

    reset_quiet_ns = 4000 * MS
    number_object = 0x2101

    def __init__(
        self,
        world: World,
        node_id: int,
        model: str,
        shaft: Shaft,
        *,
        serial: int = 0x1401DCA5,
        empty_heartbeat: bytes = b"\0",
        drift_ppm: int = 0,
    ) -> None:
        self.model = MODELS[model]
        self.shaft = shaft
        self.jumped_counts = 0
        self._counts_per_turn = self.model.counts_per_turn
        self._offset = 0
        objects = _communication(node_id, self.model.old)
        objects += _application(self.model, serial, model == "lir-918")
        super().__init__(world, node_id, objects, drift_ppm=drift_ppm, answers_43h=self.model.old)
        self.tpdos.type0_sends = not self.model.old
        self.error_control.guard_register = 0x20
        self.emcy.inhibit_drops = True
        if not self.model.old:
            self.error_control.empty_after_remote = empty_heartbeat
        self._serve()

    def make_tpdos(self) -> list[Tpdo]:
        """TPDO1 by timer and TPDO2 by SYNC, both with the position."""
        return [Tpdo(1, self._position_pdo), Tpdo(2, self._position_pdo)]

    def boot_up_byte(self) -> int:
        """7Fh on the new generation when it starts with heartbeat on (sheet, trap 1)."""
        heartbeat = self.objects.number(0x1017)
        return 0x7F if heartbeat and not self.model.old else 0x00

    def emcy_bytes(self, code: int, register: int, alarms: int, warnings: int) -> bytes:
        """Code, register, alarms, warnings, unused."""
        head = code.to_bytes(2, "little") + bytes([register])
        return head + alarms.to_bytes(2, "little") + warnings.to_bytes(2, "little") + b"\0"

    def guard_lost(self) -> None:
        """Change the state as 1029h:1 asks; the factory setting keeps it."""
        self.communication_error()

    def communication_error(self) -> None:
        """React to a lost connection: 1029h:1."""
        reaction = self.objects.number(0x1029, 1)
        if reaction == 2:
            self.enter(State.STOPPED)
        elif reaction == 0 and self.state is State.OPERATIONAL:
            self.enter(State.PRE_OPERATIONAL)

    def restarted(self) -> None:
        """Take the scale and the offset from the EEPROM."""
        self._counts_per_turn = self.objects.number(0x6001)
        self._offset = self.objects.number(0x6509)
        self.objects.put(0x6002, 0, self.range)

    @property
    def range(self) -> int:
        """Measuring range R [counts]."""
        return self._counts_per_turn * self.model.turns

    def _raw(self, t_ns: int) -> int:
        raw = self.shaft.nanoturns(t_ns) * self._counts_per_turn // _TURN + self.jumped_counts
        return -raw if self.objects.number(0x6000) & 1 else raw

    def position(self, t_ns: int) -> int:
        """6004h [counts]."""
        return (self._raw(t_ns) + self._offset) % self.range

    def _position_pdo(self, t_ns: int) -> tuple[bytes, tuple[int, ...]]:
        position = self.position(t_ns)
        return position.to_bytes(4, "little"), (position,)

    def _serve(self) -> None:
        objects = self.objects
        objects.on_read(0x1001, 0, self._error_register)
        objects.on_read(0x6004, 0, lambda: self.position(self.now_ns))
        objects.on_read(0x6509, 0, lambda: self._offset)
        objects.on_read(0x6500, 0, lambda: objects.number(0x6000))
        objects.on_write(0x6003, 0, self._preset)
        serve_error_list(self, 8, abort_beyond_count=not self.model.old)
        groups = {1: (0, 0xFFFF)}
        if self.model.old:
            groups |= {2: (0x1000, 0x2FFF), 3: (0x6000, 0x6FFF)}
            objects.on_read(0x6200, 0, lambda: objects.number(0x1800, 5))
            objects.on_write(0x6200, 0, self._cyclic_timer)
            objects.on_read(0x6503, 0, lambda: self._bits("alarms"))
            objects.on_read(0x6505, 0, lambda: self._bits("warnings"))
        else:
            objects.on_write(0x6000, 0, lambda value: self._set_offset(0))
        serve_storage(self, groups)
        for number in (1, 2):
            objects.on_write(0x17FF + number, 1, partial(self._switch_pdo, number))

    def _bits(self, name: str) -> int:
        bits = 0
        for error in self.emcy.active.values():
            bits |= int(getattr(error, name))
        return bits

    def _error_register(self) -> int:
        if not self.model.old:
            return self.emcy.register
        register, self.emcy.latched = self.emcy.latched, 0
        return register

    def _preset(self, value: int) -> None:
        self._set_offset(value - self._raw(self.now_ns) % self.range)

    def _set_offset(self, offset: int) -> None:
        self._offset = offset
        self.objects.put(0x6509, 0, offset)

    def _cyclic_timer(self, value: int) -> None:
        self.objects.put(0x1800, 5, value)
        self.tpdos.rewritten(value)

    def _switch_pdo(self, number: int, value: int) -> None:
        fixed = 0x080 + 0x100 * number + self.node_id
        self.objects.put(0x17FF + number, 1, fixed | (value & _PDO_OFF))
        self.tpdos.rewritten(value)
