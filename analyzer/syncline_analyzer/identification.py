"""What device a node is, who says so and why; and what its PDOs look like where nobody does."""

from collections.abc import Iterator, Sequence
from dataclasses import field
from typing import Literal

from syncline_analyzer.context import Context
from syncline_analyzer.results import PdoRow
from syncline_schemas.canopen.objects import standard_meaning
from syncline_schemas.devices import (
    ABSENT,
    Device,
    evidence,
    lookalikes,
    standard_device,
    suspects,
    telling_objects,
)
from syncline_schemas.devices.catalog import hallmarks
from syncline_schemas.devices.factory import FactoryPdo
from syncline_schemas.records import dataclass

Source = Literal["--device", "bus description", "objects"]
Key = tuple[int, int]
ENOUGH = 4
"""Points from which on PDOs look like a device's."""
TIMER_SHARE = 0.02
"""An event timer is kept as well as this."""
ROUND_MS = (1, 2, 5, 10, 20, 25, 50, 100, 200, 250, 500, 1000)
"""Event timers that many devices have."""
_TIMED = (0xFE, 0xFF)
_NAME, _TYPE, _PRODUCT = (0x1008, 0), (0x1000, 0), (0x1018, 2)


@dataclass(frozen=True, slots=True)
class Identification:
    """Who says what a node is, why, and what it looks like where nobody does."""

    source: Source | None = None
    reason: str = ""
    guesses: list[str] = field(default_factory=list)


def identification(
    context: Context, bus: int, node: int, pdos: Sequence[PdoRow] = ()
) -> Identification:
    """Why a node is the device that it is taken for; `pdos` are those that it sends."""
    shadow = context.shadow
    known = shadow.identity(bus, node)
    device, told_by = shadow.device(bus, node), shadow.told_by(bus, node)
    if told_by is not None and device is not None:
        own = [key for key in evidence(device, known) if known.get(key) is not None]
        agreeing = ", ".join(_seen(context, bus, node, own))
        words = f"told by {told_by}" if told_by == "--device" else f"told by the {told_by}"
        return Identification(told_by, f"{words}; {agreeing} agrees" if agreeing else words)
    if device is None:
        return Identification(None, *_unknown(context, bus, node, pdos))
    either = lookalikes(known)
    if either:
        words = ", ".join(_seen(context, bus, node, evidence(either[0], known)))
        open_ = ", ".join(_place(key) for key in telling_objects(either))
        names = " and ".join(one.name for one in either)
        guesses, why = _by_type_0(either, pdos)
        return Identification(
            "objects", f"{words} fits {names}: one of {open_} would tell which{why}", guesses
        )
    return Identification("objects", ", ".join(_seen(context, bus, node, evidence(device, known))))


def _by_type_0(either: Sequence[Device], pdos: Sequence[PdoRow]) -> tuple[list[str], str]:
    """Those of several devices that send PDOs of type 0, if one is sent, and the words for it."""
    sent = [
        pdo
        for pdo in pdos
        if (pdo.transmission_type, pdo.type_source) == (0, "sdo-read") and pdo.answered >= ENOUGH
    ]
    names = [device.name for device in either if device.quirks.type_0 != "off"]
    if not sent or not 0 < len(names) < len(either):
        return [], ""
    words = f"{sent[0].cob_id:03X}h is sent though its transmission type is 0"
    return names, f"; {words}, as {' or '.join(names)} does"


def _seen(context: Context, bus: int, node: int, keys: Sequence[Key]) -> Iterator[str]:
    """Objects as the node told them: '1008h = "JN2100" (frame 12)'."""
    shadow = context.shadow
    known = shadow.identity(bus, node)
    for key in keys:
        value = known[key]
        if value == ABSENT:
            yield f"{_place(key)} does not exist"
            continue
        found = shadow.learned(bus, node).get(key)
        frame = f" (frame {found.seq})" if found is not None and found.seq is not None else ""
        yield f"{_place(key)} = {_value(key, value)}{frame}"


def _place(key: Key) -> str:
    return f"{key[0]:04X}h:{key[1]}" if key[1] else f"{key[0]:04X}h"


def _value(key: Key, value: int | bytes) -> str:
    if key[0] in (0x1008, 0x1009, 0x100A):
        raw = value if isinstance(value, bytes) else value.to_bytes(8, "little", signed=value < 0)
        return '"' + raw.decode("latin-1").rstrip("\0 ") + '"'
    if isinstance(value, bytes):
        return value.hex(" ").upper()
    return f"{value:08X}h" if key in (_TYPE, _PRODUCT, (0x1018, 1)) else str(value)


def _unknown(
    context: Context, bus: int, node: int, pdos: Sequence[PdoRow]
) -> tuple[str, list[str]]:
    """What is known of a node that is no device of the catalogue: its words, what it looks like."""
    known = context.shadow.identity(bus, node)
    suspected = suspects(known)
    if suspected:
        return _suspicion(context, bus, node, suspected), [device.name for device in suspected]
    keys = [
        key for key in (_NAME, _TYPE, (0x1018, 1), _PRODUCT) if known.get(key, ABSENT) != ABSENT
    ]
    told = ", ".join(_seen(context, bus, node, keys))
    kind = known.get(_TYPE)
    standard = standard_device(kind & 0xFFFF) if isinstance(kind, int) else None
    if standard is not None:
        return f"{told}: a {standard.title} of a maker that is not known", []
    if told:
        return f"{told}: no device of the catalogue", []
    guesses, words = _looks_like(context, bus, node, pdos)
    return words, guesses


def _suspicion(context: Context, bus: int, node: int, suspected: Sequence[Device]) -> str:
    """What speaks for devices that nothing proves, and what would."""
    known = context.shadow.identity(bus, node)
    keys = dict.fromkeys(key for device in suspected for key in evidence(device, known))
    names = " or ".join(device.name for device in suspected)
    open_ = [_place(key) for key in (_NAME, *telling_objects(suspected)) if key not in known]
    proof = f"; {' or '.join(open_)} would tell" if open_ else ""
    words = ", ".join(_seen(context, bus, node, list(keys)))
    return f"{words} fits {names}, but may be another device's too{proof}"


def _looks_like(
    context: Context, bus: int, node: int, pdos: Sequence[PdoRow]
) -> tuple[list[str], str]:
    """Devices whose factory settings the PDOs of a node fit best, and what speaks for them."""
    sent = {pdo.cob_id: pdo for pdo in pdos if (pdo.pdo or "").startswith("TPDO")}
    lengths = {can_id: context.pdo_lengths.get((bus, can_id), {}) for can_id in sent}
    if not sent or any(len(found) != 1 for found in lengths.values()):
        return [], ""
    observed = {can_id: next(iter(found)) for can_id, found in lengths.items()}
    points = {}
    for name, each in hallmarks():
        expected = {can_id + node: pdo for can_id, pdo in each.tpdos.items()}
        fits = all(can_id in expected for can_id in observed) and all(
            expected[can_id].length == length for can_id, length in observed.items()
        )
        if fits:
            points[name] = sum(1 + _timing(expected[can_id], sent[can_id]) for can_id in observed)
    best = max(points.values(), default=0)
    if best < ENOUGH:
        return [], ""
    names = [name for name, count in points.items() if count == best]
    listed = ", ".join(
        f"{can_id:03X}h has {length} bytes{_rhythm(sent[can_id])}"
        for can_id, length in sorted(observed.items())
    )
    return names, f"{listed}: as the factory settings of {' or '.join(names)}"


def _timing(factory: FactoryPdo, seen: PdoRow) -> int:
    """Points for a PDO that keeps its factory rhythm."""
    if factory.type is not None and 1 <= factory.type <= 0xF0:
        return int(seen.every == factory.type)
    if factory.type not in _TIMED or not factory.timer_ms or seen.period_us is None:
        return 0
    off = abs(seen.period_us.median - factory.timer_ms * 1000)
    if seen.every is not None or off > TIMER_SHARE * factory.timer_ms * 1000:
        return 0
    return 1 if factory.timer_ms in ROUND_MS else 3


def _rhythm(seen: PdoRow) -> str:
    if seen.every is not None:
        return f" at {standard_meaning(0x1800, 2, seen.every)}"
    return f" every {seen.period_us.median / 1000:.0f} ms" if seen.period_us else ""
