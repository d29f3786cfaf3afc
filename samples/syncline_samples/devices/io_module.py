"""A plain I/O module (CiA 401): PDOs in both directions, segmented and block transfers.

What it sends and where can be changed at run time: 1005h, 1014h, 1200h, 14xxh, 16xxh, 18xxh, 1A00h.
"""

from syncline_samples import abort
from syncline_samples.bus import Frame
from syncline_samples.devices.common import (
    const,
    error_list,
    serve_error_list,
    serve_mapping,
    serve_storage,
)
from syncline_samples.lss import LssSlave
from syncline_samples.node import Node, State
from syncline_samples.objects import Object, SdoAbort
from syncline_samples.tpdo import Tpdo
from syncline_samples.world import MS, World

_LOG = bytes(range(256)) * 4
_FIRMWARE = bytes((7 * number + number // 251) & 0xFF for number in range(2999))
"""Of no particular length: the last segment of a block is not full."""
_PDO_OFF = 1 << 31


def _communication(node_id: int) -> list[Object]:
    return [
        const(0x1000, 0, "u32", 0x00030191),
        const(0x1001, 0, "u8", 0),
        *error_list(4),
        Object(0x1005, 0, "u32", "rw", 0x80, kept=True),
        const(0x1008, 0, "str", b"simulated I/O 8/8"),
        Object(0x1010, 1, "u32", "rw", 0),
        Object(0x1011, 1, "u32", "rw", 0),
        Object(0x1014, 0, "u32", "rw", 0x80 + node_id, kept=True),
        Object(0x1015, 0, "u16", "rw", 0, kept=True),
        Object(0x1016, 1, "u32", "rw", 0, kept=True),
        Object(0x1017, 0, "u16", "rw", 0, kept=True),
        const(0x1018, 0, "u8", 4),
        const(0x1018, 1, "u32", 0),
        const(0x1018, 2, "u32", 1),
        const(0x1018, 3, "u32", 1),
        const(0x1018, 4, "u32", 1),
        const(0x1200, 0, "u8", 2),
        Object(0x1200, 1, "u32", "rw", 0x600 + node_id, kept=True),
        Object(0x1200, 2, "u32", "rw", 0x580 + node_id, kept=True),
        const(0x1400, 0, "u8", 2),
        Object(0x1400, 1, "u32", "rw", 0x200 + node_id, kept=True),
        const(0x1400, 2, "u8", 0xFF),
        Object(0x1600, 0, "u8", "rw", 1, kept=True),
        Object(0x1600, 1, "u32", "rw", 0x62000108, kept=True),
        const(0x1800, 0, "u8", 5),
        Object(0x1800, 1, "u32", "rw", 0x180 + node_id, kept=True),
        Object(0x1800, 2, "u8", "rw", 0xFF, kept=True),
        Object(0x1800, 3, "u16", "rw", 0, kept=True),
        Object(0x1800, 5, "u16", "rw", 0, kept=True),
        Object(0x1A00, 0, "u8", "rw", 1, kept=True),
        Object(0x1A00, 1, "u32", "rw", 0x60000108, kept=True),
        *(Object(0x1A00, sub, "u32", "rw", 0, kept=True) for sub in range(2, 5)),
        const(0x1F50, 0, "u8", 1),
        Object(0x1F50, 1, "str", "wo", b""),
    ]


def _application(node_id: int) -> list[Object]:
    return [
        Object(0x2000, 0, "u8", "ro", node_id, kept=True),
        Object(0x2F00, 0, "str", "rw", _LOG),
        Object(0x2F01, 0, "str", "rw", b"terminal strip 4, cabinet B"),
        Object(0x2F02, 0, "str", "rw", _FIRMWARE),
        Object(0x2F03, 0, "str", "rw", b"A/B"),
        const(0x6000, 0, "u8", 1),
        const(0x6000, 1, "u8", 0),
        const(0x6200, 0, "u8", 1),
        Object(0x6200, 1, "u8", "rw", 0),
        const(0x6401, 0, "u8", 2),
        const(0x6401, 1, "i16", 0),
        const(0x6401, 2, "i16", 0),
    ]


class IoModule(Node):
    """Eight outputs on RPDO1, eight inputs on TPDO1 that follow the outputs when they change."""

    number_object = 0x2000

    def __init__(self, world: World, node_id: int, *, sizeless: bool = False) -> None:
        objects = _communication(node_id) + _application(node_id)
        super().__init__(world, node_id, objects, block=True, sizeless=sizeless)
        self.error_control.always_answers = True
        serve_error_list(self, 4, abort_beyond_count=False)
        serve_storage(self, {1: (0, 0xFFFF)})
        serve_mapping(self, 1)
        self.lss = LssSlave(self, (self.number_object, 0))
        self.objects.on_read(0x1001, 0, lambda: self.emcy.register)
        self.objects.on_read(0x6401, 1, lambda: self.now_ns // MS % 20_000 - 10_000)
        self.objects.on_read(0x6401, 2, lambda: self.now_ns // (7 * MS) % 4_000)
        self.objects.on_write(0x1800, 1, self._move_tpdo)
        self.objects.on_write(0x1400, 1, self._move_rpdo)
        self.restarted()

    def make_tpdos(self) -> list[Tpdo]:
        """The inputs, until somebody maps something else."""
        return [Tpdo(1, self._inputs)]

    def restarted(self) -> None:
        """Listen where 1400h:1 says."""
        self._move_rpdo(self.objects.number(0x1400, 1))

    def _inputs(self, t_ns: int) -> tuple[bytes, tuple[int, ...]]:
        inputs = self.objects.number(0x6000, 1)
        return bytes([inputs]), (inputs,)

    def _move_tpdo(self, value: int) -> None:
        """Take another identifier; a PDO that is on must be switched off first (CiA 301 7.5.2.37)."""
        tpdo = self.tpdos[1]
        if tpdo.enabled and not value & _PDO_OFF and value & 0x7FF != tpdo.can_id:
            raise SdoAbort(abort.VALUE_RANGE)
        self.tpdos.rewritten(value)

    def _move_rpdo(self, value: int) -> None:
        if not value & _PDO_OFF:
            self.hear("RPDO1", value & 0x7FF, self._on_rpdo)

    def _on_rpdo(self, frame: Frame, t_ns: int) -> None:
        if self.state is not State.OPERATIONAL or not frame.data or not self.connected:
            return
        self.objects.put(0x6200, 1, frame.data[0])
        if frame.data[0] != self.objects.number(0x6000, 1):
            self.objects.put(0x6000, 1, frame.data[0])
            self.after(2_000_000, self.tpdos.trigger, 1)
