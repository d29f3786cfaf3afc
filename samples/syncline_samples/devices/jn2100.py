"""ifm JN2100, firmware 2.1.0: two-axis inclinometer and vibration sensor (sheet ifm-jn2100.md)."""

from functools import partial

from syncline_samples.devices.common import const, error_list, serve_error_list, serve_storage
from syncline_samples.motion import Tilt
from syncline_samples.node import Node, State
from syncline_samples.objects import Object
from syncline_samples.tpdo import Tpdo
from syncline_samples.world import MS, Delay, World

_SETTLE_S = {0: 0, 1: 70, 2: 70, 3: 12, 4: 9, 5: 5}
"""Settle time of the vibration filter by 2049h."""
_SELF_TEST_NS = 2000 * MS
_FULL_TURN = 360_000
_FACTORY_NUMBER = 10
_MAPPING = ((0x60100010, 0x60200010), (0x61100020, 0x61200020), (0x5C100020, 0x5C110020))


def _objects(node_id: int, serial: int) -> list[Object]:
    objects = [
        const(0x1000, 0, "u32", 0x0004019A),
        const(0x1001, 0, "u8", 0),
        *error_list(50),
        Object(0x1005, 0, "u32", "rw", 0x80),
        const(0x1008, 0, "str", b"JN2100"),
        const(0x1009, 0, "str", b"1.0.0"),
        const(0x100A, 0, "str", b"2.1.0"),
        Object(0x100C, 0, "u16", "rw", 0, kept=True),
        Object(0x100D, 0, "u8", "rw", 0, kept=True),
        const(0x1010, 0, "u8", 1),
        Object(0x1010, 1, "u32", "rw", 0),
        const(0x1011, 0, "u8", 1),
        Object(0x1011, 1, "u32", "rw", 0),
        const(0x1014, 0, "u32", 0x80 + node_id),
        Object(0x1015, 0, "u16", "rw", 0, kept=True),
        Object(0x1017, 0, "u16", "rw", 0, kept=True),
        const(0x1018, 0, "u8", 4),
        const(0x1018, 1, "u32", 0x0069666D),
        const(0x1018, 2, "u32", 0),
        const(0x1018, 3, "u32", 0xAA),
        const(0x1018, 4, "u32", serial),
        const(0x1029, 0, "u8", 1),
        Object(0x1029, 1, "u8", "rw", 0, kept=True, low=0, high=2),
        const(0x1200, 0, "u8", 2),
        const(0x1200, 1, "u32", 0x600 + node_id),
        const(0x1200, 2, "u32", 0x580 + node_id),
        Object(0x2000, 0, "u8", "rw", node_id, kept=True, low=1, high=127),
        Object(0x2001, 0, "u16", "rw", 125, kept=True),
        Object(0x2002, 0, "u8", "rw", 0),
        const(0x4004, 0, "u8", 2),
        Object(0x4004, 1, "u8", "rw", 0),
        const(0x4004, 2, "u8", 0),
        const(0x4080, 0, "i32", 250),
        const(0x4081, 0, "u16", 450),
        Object(0x6000, 0, "u16", "rw", 100, kept=True),
        Object(0x207F, 0, "u8", "rw", 0),
    ]
    settings = {0x2040: 2, 0x2041: 1, 0x2042: 2, 0x2043: 2, 0x2044: 0, 0x2045: 1, 0x2046: 2}
    settings |= {0x2047: 0, 0x2048: 7, 0x2049: 5, 0x204A: 2}
    objects += [Object(index, 0, "u8", "rw", value, kept=True) for index, value in settings.items()]
    kinds = {
        0x6010: "i16",
        0x6020: "i16",
        0x6110: "i32",
        0x6120: "i32",
        0x5C10: "u32",
        0x5C11: "u32",
    }
    objects += [const(index, 0, kind, 0) for index, kind in kinds.items()]
    for number, mapping in enumerate(_MAPPING):
        kept = number < 2
        objects += [
            const(0x1800 + number, 0, "u8", 5),
            const(0x1800 + number, 1, "u32", 0x180 + 0x100 * number + node_id),
            Object(0x1800 + number, 2, "u8", "rw", 1, kept=kept),
            Object(0x1800 + number, 3, "u16", "rw", 0),
            Object(0x1800 + number, 5, "u16", "rw", 10, kept=kept),
            const(0x1A00 + number, 0, "u8", 2),
            const(0x1A00 + number, 1, "u32", mapping[0]),
            const(0x1A00 + number, 2, "u32", mapping[1]),
        ]
    return objects


class Jn2100(Node):
    """The inclinometer on a tilting platform; 2000h.. and 6000h survive a reset here (C26)."""

    response_delay = Delay(900_000, 250_000)
    number_object = 0x2000

    def __init__(
        self,
        world: World,
        node_id: int,
        tilt: Tilt,
        *,
        serial: int = 4711,
        drift_ppm: int = 0,
    ) -> None:
        self.tilt = tilt
        self._zero = (0, 0)
        super().__init__(world, node_id, _objects(node_id, serial), drift_ppm=drift_ppm)
        self.tpdos.answers_remote = True
        serve_error_list(self, 50, abort_beyond_count=False)
        serve_storage(self, {1: (0x1000, 0x1FFF)})
        self._serve()

    def make_tpdos(self) -> list[Tpdo]:
        """Angles in 16 and in 32 bits, and vibration."""
        return [Tpdo(1, self._angles_16), Tpdo(2, self._angles_32), Tpdo(3, self._vibration_pdo)]

    def restart(self, delay_ns: int, *, commanded: bool) -> None:
        """Restart; the settings took effect at once and stay."""
        self.objects.save(0x2000, 0x6FFF)
        super().restart(delay_ns, commanded=commanded)

    def guard_lost(self) -> None:
        """Leave OPERATIONAL as 1029h:1 asks (factory: PRE-OPERATIONAL)."""
        reaction = self.objects.number(0x1029, 1)
        if reaction == 2:
            self.enter(State.STOPPED)
        elif reaction == 0 and self.state is State.OPERATIONAL:
            self.enter(State.PRE_OPERATIONAL)

    def _serve(self) -> None:
        objects = self.objects
        objects.on_read(0x1001, 0, lambda: self.emcy.register)
        objects.on_write(0x2002, 0, lambda value: self.after(5 * MS, self._reset))
        objects.on_write(0x207F, 0, self._factory_reset)
        objects.on_write(0x2046, 0, self._set_zero)
        objects.on_write(0x2042, 0, self._set_zero)
        objects.on_write(0x2049, 0, self._change_filter)
        objects.on_write(0x4004, 1, self._self_test)
        for index, axis in ((0x6010, 0), (0x6020, 1), (0x6110, 0), (0x6120, 1)):
            objects.on_read(index, 0, partial(self._axis, axis))
        for index, part in ((0x5C10, 0), (0x5C11, 1)):
            objects.on_read(index, 0, partial(self._vibration_part, part))

    def _axis(self, axis: int) -> int:
        return self._counts(self.now_ns)[axis]

    def _vibration_part(self, part: int) -> int:
        return self._vibration(self.now_ns)[part]

    def _reset(self) -> None:
        self.restart(self.boot_ns, commanded=True)

    def _factory_reset(self, value: int) -> None:
        """Factory values at once, node 10 from the next reset on (sheet, trap 14)."""
        if value == 1:
            self.objects.restore(0x2000, 0x5FFF)
            self.objects.reload(0x2000, 0x5FFF)
            self.objects.put(0x2000, 0, _FACTORY_NUMBER)
            self.objects.put(0x207F, 0, 1)

    def _self_test(self, value: int) -> None:
        self.after(_SELF_TEST_NS, self.objects.put, 0x4004, 1, 0)
        self.after(_SELF_TEST_NS, self.objects.put, 0x4004, 2, 7)

    def _change_filter(self, value: int) -> None:
        self.tpdos[3].quiet_until_ns = self.now_ns + _SETTLE_S.get(value, 0) * 1000 * MS

    def _set_zero(self, value: int) -> None:
        if value == 1:
            self._zero = self.tilt.millidegrees(self.now_ns)
        elif value == 2:
            self._zero = (0, 0)

    def millidegrees(self, t_ns: int) -> tuple[int, int]:
        """Longitudinal and lateral angle after zero and quadrant correction (2040h)."""
        quadrant = self.objects.number(0x2040)
        long, lat = self.tilt.millidegrees(t_ns)
        angles = (long - self._zero[0], lat - self._zero[1])
        if quadrant == 2:
            return angles[0] % _FULL_TURN, angles[1] % _FULL_TURN
        return angles

    def _counts(self, t_ns: int) -> tuple[int, int]:
        step = self.objects.number(0x6000) or 100
        long, lat = self.millidegrees(t_ns)
        return long // step, lat // step

    def _angles(self, t_ns: int, width: int) -> tuple[bytes, tuple[int, ...]]:
        mask = (1 << 8 * width) - 1
        long, lat = self._counts(t_ns)
        data = (long & mask).to_bytes(width, "little") + (lat & mask).to_bytes(width, "little")
        return data, self.millidegrees(t_ns)

    def _angles_16(self, t_ns: int) -> tuple[bytes, tuple[int, ...]]:
        return self._angles(t_ns, 2)

    def _angles_32(self, t_ns: int) -> tuple[bytes, tuple[int, ...]]:
        return self._angles(t_ns, 4)

    def _vibration(self, t_ns: int) -> tuple[int, int]:
        phase = t_ns // MS % 4000
        ramp = min(phase, 4000 - phase)
        return 20 + ramp // 50, 100 + ramp // 10

    def _vibration_pdo(self, t_ns: int) -> tuple[bytes, tuple[int, ...]]:
        velocity, peak = self._vibration(t_ns)
        return velocity.to_bytes(4, "little") + peak.to_bytes(4, "little"), (velocity, peak)
