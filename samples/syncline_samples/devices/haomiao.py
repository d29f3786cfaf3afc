"""Haomiao 38 mm multi-turn encoder, protocol manual v4.0 (sheet haomiao-38.md)."""

from syncline_samples.devices.common import (
    const,
    error_list,
    serve_error_list,
    serve_mapping,
    serve_storage,
)
from syncline_samples.motion import Shaft
from syncline_samples.node import Node
from syncline_samples.objects import Object
from syncline_samples.tpdo import Tpdo
from syncline_samples.world import Delay, World

_TURN = 1_000_000_000
_TURNS = 4096
_HARDWARE_COUNTS = 8192
_SCALING = 1 << 2


def _objects(node_id: int) -> list[Object]:
    objects = [
        const(0x1000, 0, "u32", 0x00020196),
        const(0x1001, 0, "u8", 0),
        *error_list(8),
        const(0x1004, 0, "u32", 2),
        const(0x1004, 1, "u32", 1),
        const(0x1004, 2, "u32", 1),
        Object(0x1005, 0, "u32", "rw", 0x80, kept=True),
        const(0x1008, 0, "str", b"MAGA"),
        const(0x1009, 0, "str", b"V4.0"),
        const(0x100A, 0, "str", b"V4.0"),
        const(0x1010, 0, "u8", 1),
        Object(0x1010, 1, "u32", "rw", 0),
        const(0x1011, 0, "u8", 1),
        Object(0x1011, 1, "u32", "rw", 0),
        Object(0x1014, 0, "u32", "rw", 0x80 + node_id, kept=True),
        Object(0x1017, 0, "u16", "rw", 0, kept=True),
        const(0x1018, 0, "u8", 4),
        const(0x1018, 1, "u32", 0x000002C1),
        const(0x1018, 2, "u32", 0x00000026),
        const(0x1018, 3, "u32", 0x00040000),
        const(0x1018, 4, "u32", 0x00000001),
        Object(0x2100, 0, "u8", "rw", 0),
        Object(0x3000, 0, "u8", "rw", node_id, kept=True, low=1, high=127),
        Object(0x3001, 0, "u8", "rw", 3, kept=True, low=0, high=7),
        Object(0x6000, 0, "u16", "rw", 0, kept=True),
        Object(0x6001, 0, "u32", "rw", _HARDWARE_COUNTS, kept=True, low=1, high=_HARDWARE_COUNTS),
        Object(0x6003, 0, "u32", "rw", 0, kept=True, low=0, high=_HARDWARE_COUNTS * _TURNS - 1),
        const(0x6004, 0, "u32", 0),
        const(0x6500, 0, "u16", 0),
        const(0x6501, 0, "u32", _HARDWARE_COUNTS),
        const(0x6502, 0, "u16", _TURNS),
        const(0x6503, 0, "u16", 0),
        const(0x6504, 0, "u16", 1),
        const(0x6505, 0, "u16", 0),
        const(0x6506, 0, "u16", 4),
        const(0x650B, 0, "u32", 0xFFFFFFFF),
    ]
    for number, kind in enumerate((0xFE, 1)):
        objects += [
            const(0x1800 + number, 0, "u8", 5),
            Object(0x1800 + number, 1, "u32", "rw", 0x180 + 0x100 * number + node_id, kept=True),
            Object(0x1800 + number, 2, "u8", "rw", kind, kept=True),
            Object(0x1800 + number, 3, "u16", "rw", 0, kept=True),
            Object(0x1800 + number, 5, "u16", "rw", 100, kept=True),
            Object(0x1A00 + number, 0, "u8", "rw", 1, kept=True),
            Object(0x1A00 + number, 1, "u32", "rw", 0x60040020, kept=True),
            Object(0x1A00 + number, 2, "u32", "rw", 0, kept=True),
        ]
    return objects


class Haomiao38(Node):
    """The multi-turn encoder on a shaft."""

    response_delay = Delay(500_000, 150_000)
    number_object = 0x3000

    def __init__(
        self,
        world: World,
        node_id: int,
        shaft: Shaft,
        *,
        drift_ppm: int = 0,
    ) -> None:
        self.shaft = shaft
        self._offset = 0
        super().__init__(world, node_id, _objects(node_id), drift_ppm=drift_ppm)
        objects = self.objects
        objects.on_read(0x1001, 0, lambda: self.emcy.register)
        objects.on_read(0x6004, 0, lambda: self.position(self.now_ns))
        objects.on_read(0x6500, 0, lambda: objects.number(0x6000))
        objects.on_write(0x6003, 0, self._preset)
        for number in (1, 2):
            serve_mapping(self, number)
        serve_error_list(self, 8, abort_beyond_count=False)
        serve_storage(self, {1: (0, 0xFFFF)})

    def make_tpdos(self) -> list[Tpdo]:
        """TPDO1 by timer and TPDO2 by SYNC, both with the position until somebody remaps them."""
        return [Tpdo(1, self._position_pdo), Tpdo(2, self._position_pdo)]

    @property
    def counts_per_turn(self) -> int:
        """6001h counts only while scaling is on."""
        scaling = self.objects.number(0x6000) & _SCALING
        return self.objects.number(0x6001) if scaling else _HARDWARE_COUNTS

    def _raw(self, t_ns: int) -> int:
        raw = self.shaft.nanoturns(t_ns) * self.counts_per_turn // _TURN
        return -raw if self.objects.number(0x6000) & 1 else raw

    def position(self, t_ns: int) -> int:
        """6004h [counts]."""
        return (self._raw(t_ns) + self._offset) % (self.counts_per_turn * _TURNS)

    def press_set_input(self) -> None:
        """Preset by the grey wire: no bus message tells of it (sheet, trap 4)."""
        self._preset(self.objects.number(0x6003))

    def _preset(self, value: int) -> None:
        self._offset = value - self._raw(self.now_ns)

    def _position_pdo(self, t_ns: int) -> tuple[bytes, tuple[int, ...]]:
        position = self.position(t_ns)
        return position.to_bytes(4, "little"), (position,)
