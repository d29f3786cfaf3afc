"""A plain I/O module (CiA 401): PDOs in both directions, segmented and block transfers."""

from syncline_samples.bus import Frame
from syncline_samples.devices.common import const, error_list, serve_error_list
from syncline_samples.node import Node, State
from syncline_samples.objects import Object
from syncline_samples.tpdo import Tpdo
from syncline_samples.world import World

_LOG = bytes(range(256)) * 4


def _objects(node_id: int) -> list[Object]:
    return [
        const(0x1000, 0, "u32", 0x00030191),
        const(0x1001, 0, "u8", 0),
        *error_list(4),
        const(0x1008, 0, "str", b"simulated I/O 8/8"),
        const(0x1014, 0, "u32", 0x80 + node_id),
        Object(0x1017, 0, "u16", "rw", 0),
        const(0x1018, 0, "u8", 4),
        const(0x1018, 1, "u32", 0),
        const(0x1018, 2, "u32", 1),
        const(0x1018, 3, "u32", 1),
        const(0x1018, 4, "u32", 1),
        const(0x1400, 0, "u8", 2),
        const(0x1400, 1, "u32", 0x200 + node_id),
        const(0x1400, 2, "u8", 0xFF),
        const(0x1600, 0, "u8", 1),
        const(0x1600, 1, "u32", 0x62000108),
        const(0x1800, 0, "u8", 5),
        const(0x1800, 1, "u32", 0x180 + node_id),
        Object(0x1800, 2, "u8", "rw", 0xFF),
        Object(0x1800, 3, "u16", "rw", 0),
        Object(0x1800, 5, "u16", "rw", 0),
        const(0x1A00, 0, "u8", 1),
        const(0x1A00, 1, "u32", 0x60000108),
        Object(0x2F00, 0, "str", "rw", _LOG),
        Object(0x2F01, 0, "str", "rw", b"terminal strip 4, cabinet B"),
        const(0x6000, 0, "u8", 1),
        const(0x6000, 1, "u8", 0),
        const(0x6200, 0, "u8", 1),
        Object(0x6200, 1, "u8", "rw", 0),
    ]


class IoModule(Node):
    """Eight outputs on RPDO1, eight inputs on TPDO1 that follow the outputs when they change."""

    def __init__(self, world: World, node_id: int, *, sizeless: bool = False) -> None:
        super().__init__(world, node_id, _objects(node_id), block=True, sizeless=sizeless)
        self.error_control.always_answers = True
        serve_error_list(self, 4, abort_beyond_count=False)
        self.objects.on_read(0x1001, 0, lambda: self.emcy.register)
        world.bus.listen(0x200 + node_id, self._on_rpdo)

    def make_tpdos(self) -> list[Tpdo]:
        """The inputs."""
        return [Tpdo(1, self._inputs)]

    def _inputs(self, t_ns: int) -> tuple[bytes, tuple[int, ...]]:
        inputs = self.objects.number(0x6000, 1)
        return bytes([inputs]), (inputs,)

    def _on_rpdo(self, frame: Frame, t_ns: int) -> None:
        if self.state is not State.OPERATIONAL or not frame.data or not self.connected:
            return
        self.objects.put(0x6200, 1, frame.data[0])
        if frame.data[0] != self.objects.number(0x6000, 1):
            self.objects.put(0x6000, 1, frame.data[0])
            self.after(2_000_000, self.tpdos.trigger, 1)
