"""By which scale the values of a trace are read, as it is known at a moment."""

from collections.abc import Sequence
from dataclasses import replace

from syncline_analyzer.context import Context
from syncline_analyzer.folds.angle.samples import Key, Samples
from syncline_analyzer.folds.angle.trace import Converter, Encoder, Plain, Tilt
from syncline_analyzer.object_history import Known, ObjectHistory
from syncline_schemas.devices import Device, quirks
from syncline_schemas.measurement import (
    encoder_scale,
    linear_scale,
    measured_by,
    position_objects,
    tilt_axis,
    tilt_scale,
)

_SCALE_ROLES = (
    "counts_per_turn",
    "hardware_counts_per_turn",
    "range",
    "turns",
    "resolution",
    "quadrant",
    "definition",
)
"""Roles of objects in a device's `measurement` that make its scale."""
_STANDARD_SCALE = tuple((index, 0) for index in (0x6000, 0x6001, 0x6002, 0x6501, 0x6502))
"""Objects of the scale in CiA 406 and CiA 410."""


class Scales:
    """Finds the converter of a trace; some new scales wait for a reset."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._resets: dict[tuple[int, int], list[int]] = {}

    def reset(self, bus: int, node: int, seqs: Sequence[int]) -> None:
        """Take note of resets of a node."""
        self._resets.setdefault((bus, node), []).extend(seqs)

    def converter(self, key: Key, piece: Samples, seq: int) -> Converter:
        """Scale of a trace as known at `seq`."""
        bus, node, number = key
        shadow = self._context.shadow
        device = shadow.device(bus, node)

        def lookup(index: int, sub: int) -> tuple[int, bool] | None:
            known = self._acting(bus, node, device, (index, sub), seq)
            if known is None or not isinstance(known.value, int):
                return None
            doubtful = self._doubtful(bus, node, device, (index, sub), known, seq)
            return known.value, known.source == "eds-default" or doubtful

        index = number >> 8
        overrides = self._context.overrides(bus, node)
        device_type = shadow.number(bus, node, 0x1000, 0, seq)
        by, is_assumed = measured_by(device, device_type, index, number & 0xFF)
        profile = ("profile",) if is_assumed else ()
        axis = tilt_axis(by, index)
        if axis is not None:
            tilt = tilt_scale(by, lookup, overrides)
            if by is not device and "res" in tilt.assumed:
                return Plain(1.0, "counts", ("res", *profile))
            tilt = replace(tilt, assumed=(*tilt.assumed, *profile))
            reference = self._reference(bus, node, device, seq)
            zeroed = self._zeroed(bus, node, device, seq)
            bits = piece.entry.bits
            shown = tilt.axes[axis].of_bits(bits)
            if zeroed:
                shown = shown.relative
            return Tilt(tilt, shown, bits, reference=reference, zeroed=zeroed)
        if by is not None:
            way = linear_scale(by, device_type, lookup)
            if way is not None:
                return Plain(*way)
            signed = piece.entry.kind == "signed"
            encoder = encoder_scale(by, lookup, overrides)
            encoder = replace(encoder, signed=signed, assumed=(*encoder.assumed, *profile))
            return Encoder(encoder, piece.entry.bits)
        return Plain(piece.entry.scale, piece.entry.unit)

    def _acting(
        self, bus: int, node: int, device: Device | None, key: tuple[int, int], seq: int
    ) -> Known | None:
        """The value that acts at `seq`: on some devices a new scale acts after a restart only."""
        shadow, pending = self._context.shadow, quirks(device).pending_until_reset
        known = shadow.get(bus, node, key[0], key[1], seq)
        if known is not None and self._outdated(bus, node, device, key, known, seq):
            return None
        if not pending or device is None:
            return known
        histories = dict(shadow.history(bus, node))
        if key in pending and key in histories:
            resets = self._resets.get((bus, node), [])
            return _acting(histories[key], resets, seq) or shadow.assumed(bus, node, *key)
        per_turn = device.measurement.get("counts_per_turn")
        if key == device.measurement.get("range") and per_turn in pending and known is not None:
            changed = self._acting(bus, node, device, per_turn, seq)
            if changed is None or changed.source != "sdo-write":
                return known
            return known if (known.seq or 0) > (changed.seq or 0) else None
        return known

    def _outdated(
        self,
        bus: int,
        node: int,
        device: Device | None,
        key: tuple[int, int],
        known: Known,
        seq: int,
    ) -> bool:
        """Whether the direction bit itself became known after that of its alias."""
        roles = device.measurement if device else {}
        if key != roles.get("direction_alias", {}).get("object") or "direction" not in roles:
            return False
        index, sub = roles["direction"]["object"]
        own = self._context.shadow.get(bus, node, index, sub, seq)
        return own is not None and own.confirmed and (own.seq or 0) > (known.seq or 0)

    def _doubtful(
        self,
        bus: int,
        node: int,
        device: Device | None,
        key: tuple[int, int],
        known: Known,
        seq: int,
    ) -> bool:
        """Whether a reset came since, and the maker does not say that the value survives it."""
        facts = device.object(*key) if device else None
        if facts is None or facts.persisted != "?" or not known.confirmed:
            return False
        last = max((r for r in self._resets.get((bus, node), ()) if r <= seq), default=-1)
        again = self._context.shadow.read_again(bus, node, *key)
        return last > (known.seq or 0) and not any(last < read <= seq for read in again)

    def _reference(self, bus: int, node: int, device: Device | None, seq: int) -> str:
        """Whether angles count from gravity or from a pose that was taught."""
        keys = device.measurement.get("reference", ()) if device else ()
        if not keys:
            return ""
        values = [self._sure(bus, node, device, key, seq) for key in keys]
        if 1 in values:
            return "relative"
        return "absolute" if all(value == 2 for value in values) else "reference unknown"

    def _zeroed(self, bus: int, node: int, device: Device | None, seq: int) -> bool:
        """Whether the device subtracts a zero point from its angles."""
        key = device.measurement.get("zero") if device else None
        return key is not None and self._sure(bus, node, device, key, seq) == 1

    def _sure(
        self, bus: int, node: int, device: Device | None, key: tuple[int, int], seq: int
    ) -> int | None:
        """A number as the node told it; None after a reset that it may not have survived."""
        known = self._context.shadow.get(bus, node, *key, seq)
        if known is None or not known.confirmed or not isinstance(known.value, int):
            return None
        return None if self._doubtful(bus, node, device, key, known, seq) else known.value


def scale_objects(device: Device | None) -> list[tuple[int, int]]:
    """Objects on which the scale of a device's traces rests."""
    if not position_objects(device):
        return [(0x1000, 0), *_STANDARD_SCALE]
    assert device is not None
    keys = [device.measurement[role] for role in _SCALE_ROLES if role in device.measurement]
    keys += device.measurement.get("reference", ())
    flags = [device.measurement.get(role) for role in ("direction", "direction_alias", "scaling")]
    return keys + [flag["object"] for flag in flags if flag]


def _acting(history: ObjectHistory, resets: Sequence[int], seq: int) -> Known | None:
    """What an object acts as where a written value waits for the next reset."""
    acting: Known | None = None
    waits = False
    for change in history.changes:
        if change.seq > seq:
            break
        waits = (waits or change.cause == "sdo-write") and not any(
            change.seq < reset <= seq for reset in resets
        )
        if not waits:
            acting = change.known
    return acting
