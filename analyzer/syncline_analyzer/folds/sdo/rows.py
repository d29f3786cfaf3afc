"""Rows of SDO transfers: payloads as values of the object's type, sizes, aborts in words."""

from functools import lru_cache

from syncline_analyzer.context import Context
from syncline_analyzer.folds.sdo.transfer import Transfer
from syncline_analyzer.objects import named
from syncline_analyzer.results import SdoRow
from syncline_schemas.canopen.datatypes import DATA_TYPES, decode_value
from syncline_schemas.canopen.objects import standard_object
from syncline_schemas.canopen.sdo import abort_meaning
from syncline_schemas.devices import Device

_NUMBERS = ("signed", "unsigned", "bool")


class SdoRows:
    """Makes rows of transfers, with types and names as they are known at the end."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._objects: dict[tuple[int, int, int, int], tuple[int | None, str | None]] = {}

    def row(self, bus: int, node: int, transfer: Transfer) -> SdoRow:
        """The row of one transfer."""
        data = bytes(transfer.data)
        code, name = self._object(bus, node, transfer.index, transfer.sub)
        aborted = transfer.result == "abort"
        return SdoRow(
            bus=self._context.bus_name(bus),
            node=node,
            seq=transfer.seq,
            start_ns=transfer.start_ns,
            end_ns=max(transfer.end_ns, transfer.start_ns),
            index=transfer.index,
            sub=transfer.sub,
            direction=transfer.direction,
            kind=transfer.kind,
            size=_size(transfer, code),
            value=_value(code, data) if data and transfer.whole else None,
            result=transfer.result,
            abort_code=transfer.abort_code,
            answer_us=self._answer_us(transfer),
            name=name,
            data=data,
            end_seq=transfer.end_seq,
            announced=transfer.announced,
            crc_ok=transfer.crc_good,
            abort_by=transfer.abort_by,
            abort_text=_abort_text(transfer.abort_code) if aborted else None,
            client_cob_id=transfer.client_id,
        )

    def _answer_us(self, transfer: Transfer) -> float | None:
        if not self._context.timed or transfer.answered_ns is None:
            return None
        return max(0, transfer.answered_ns - transfer.start_ns) / 1000

    def _object(self, bus: int, node: int, index: int, sub: int) -> tuple[int | None, str | None]:
        key = (bus, node, index, sub)
        if key not in self._objects:
            device = self._context.shadow.device(bus, node)
            name, _ = named(device, index, sub)
            self._objects[key] = (type_code(device, index, sub), name)
        return self._objects[key]


def type_code(device: Device | None, index: int, sub: int) -> int | None:
    """Data type of an object by the device's dictionary, else by CiA 301."""
    facts = device.object(index, sub) if device else None
    if facts is not None and facts.data_type is not None:
        return facts.data_type
    return _usual_type(index, sub)


@lru_cache(4096)
def _usual_type(index: int, sub: int) -> int | None:
    usual = standard_object(index, sub)
    return usual.data_type if usual is not None else None


def shadow_value(device: Device | None, transfer: Transfer) -> int | bytes:
    """A transfer's value as the shadow keeps it."""
    return known_value(device, transfer.index, transfer.sub, bytes(transfer.data))


def known_value(device: Device | None, index: int, sub: int, data: bytes) -> int | bytes:
    """An object's bytes as the shadow keeps them: numbers as int, everything else as bytes."""
    code = type_code(device, index, sub)
    known = DATA_TYPES.get(code) if code is not None else None
    if known is not None and known.kind in _NUMBERS:
        value = decode_value(code, data)
        return value if isinstance(value, int) else int.from_bytes(data, "little")
    if known is not None or not 0 < len(data) <= 8:
        return data
    return int.from_bytes(data, "little")


def _value(code: int | None, data: bytes) -> int | float | str:
    value = decode_value(code, data)
    return value.hex().upper() if isinstance(value, bytes) else value


def _size(transfer: Transfer, code: int | None) -> int | None:
    """Bytes of the value: as received, as announced, or as the type says for size-less frames."""
    if transfer.kind == "expedited" and transfer.data:
        if transfer.announced is not None:
            return transfer.announced
        known = DATA_TYPES.get(code) if code is not None else None
        return (known.bits + 7) // 8 if known is not None and known.bits else None
    if transfer.result == "ok" and (transfer.whole or transfer.announced is None):
        return len(transfer.data) if transfer.whole else None
    return transfer.announced


def _abort_text(code: int | None) -> str:
    return abort_meaning(code) if code is not None else "no code given"
