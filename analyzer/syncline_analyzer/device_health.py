"""How the devices are, as far as somebody asked them: wear, hours, temperatures, stored errors."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, pairwise

from syncline_analyzer.change_words import object_facts
from syncline_analyzer.context import Context
from syncline_analyzer.results import DeviceHealthRow, ErrorHistoryRow, SdoRow, SdoTransfers
from syncline_schemas.canopen.sdo import SAVE_SIGNATURE
from syncline_schemas.devices import Device, ObjectFacts, quirks
from syncline_schemas.devices.standard import standard_profile
from syncline_schemas.wording import counted

ERROR_REGISTER, ERROR_LIST, STORE = 0x1001, 0x1003, 0x1010
WRITES = "writes"
"""Unit of counters that grow with every save."""
MAX_LISTED = 8

Key = tuple[int, int]


def device_health_rows(
    context: Context, transfers: SdoTransfers, errors: Sequence[ErrorHistoryRow]
) -> list[DeviceHealthRow]:
    """One row per node and quantity that was read, by bus, node and object.

    Args:
        context: of the capture.
        transfers: SDO transfers; reads of the objects that a device names as its health count.
        errors: reads of 1001h and 1003h.
    """
    numbers = {context.bus_name(bus): bus for bus in range(len(context.buses))}
    rows = list(_error_rows(context, numbers, errors))
    kinds = {
        (bus, node): _kind(context, numbers[bus], node)
        for bus, node in transfers.nodes()
        if bus in numbers
    }
    wanted = {key for kind in kinds.values() for key in _health(*kind).values()}
    # What is asked of few objects need not be asked of all transfers of a node.
    few = transfers.ok.of_objects(lambda of: of.index == STORE or of.key in wanted)
    for place, kind in kinds.items():
        rows.extend(_quantities(few.of_node(*place), *kind))
    return sorted(rows, key=lambda row: (row.bus, row.node, row.index, row.sub))


def _quantities(
    transfers: SdoTransfers, device: Device | None, profile: int | None
) -> Iterator[DeviceHealthRow]:
    """One row per quantity that was read of a node."""
    for what, key in _health(device, profile).items():
        asked = transfers.reads.of_object(*key)
        reads = [row for row in asked if isinstance(row.value, int | float | str)]
        facts = object_facts(device, profile, key)
        if reads and facts is not None:
            yield _row(device, what, facts, reads, _saves(transfers, reads))


def _kind(context: Context, bus: int, node: int) -> tuple[Device | None, int | None]:
    number = context.shadow.number(bus, node, 0x1000)
    return context.shadow.device(bus, node), None if number is None else number & 0xFFFF


def _health(device: Device | None, profile: int | None) -> Mapping[str, Key]:
    """Objects that tell how a device is, by what they are."""
    if device is not None:
        return device.health
    standard = standard_profile(profile or 0)
    return standard.health if standard is not None else {}


def _saves(transfers: SdoTransfers, reads: Sequence[SdoRow]) -> int:
    """Saves (1010h) between the first and the last read."""
    return sum(
        int.from_bytes(row.data[:4], "little") == SAVE_SIGNATURE
        and reads[0].seq < row.seq < reads[-1].seq
        for row in transfers.writes.of_objects(lambda of: of.index == STORE)
    )


def _row(
    device: Device | None, what: str, facts: ObjectFacts, reads: Sequence[SdoRow], saves: int
) -> DeviceHealthRow:
    numbers = [_number(row) for row in reads]
    figures = [
        round(value * facts.scale, 9)
        for value in numbers
        if value is not None and value not in facts.values
    ]
    last = numbers[-1]
    first, final = reads[0], reads[-1]
    return DeviceHealthRow(
        bus=final.bus,
        node=final.node,
        device=device.name if device else None,
        what=what,
        index=facts.index,
        sub=facts.sub,
        unit=facts.unit,
        reads=len(reads),
        first_value=figures[0] if figures else None,
        last_value=figures[-1] if figures else None,
        min=min(figures, default=None),
        max=max(figures, default=None),
        first_ns=first.end_ns,
        last_ns=final.end_ns,
        first_seq=first.seq,
        last_seq=final.seq,
        text=facts.describe(last) if isinstance(last, int) else "",
        note="; ".join(_notes(device, facts, figures, saves)),
    )


def _number(row: SdoRow) -> int | float | None:
    """The value as a number; an object of no known type is taken as unsigned."""
    if isinstance(row.value, str):
        return int.from_bytes(row.data, "little") if 0 < len(row.data) <= 8 else None
    return row.value


def _notes(
    device: Device | None, facts: ObjectFacts, figures: Sequence[float], saves: int
) -> Iterator[str]:
    if facts.meaning:
        yield facts.meaning
    if not figures:
        return
    key = (facts.index, facts.sub)
    fell = sum(after < before for before, after in pairwise(figures))
    if key in quirks(device).since_restart and fell:
        yield f"began anew {counted(fell, 'time')}: it restarted"
    if facts.unit == WRITES and len(figures) > 1:
        grown = figures[-1] - figures[0]
        yield f"{grown:+g} between the first and the last read, {counted(saves, 'save')} seen"


def _error_rows(
    context: Context, numbers: Mapping[str, int], errors: Sequence[ErrorHistoryRow]
) -> Iterator[DeviceHealthRow]:
    """The error list and the error register, as they were read."""

    def place(row: ErrorHistoryRow) -> tuple[str, int, int]:
        return row.bus, row.node, row.index

    for (bus, node, index), group in groupby(sorted(errors, key=place), key=place):
        if bus not in numbers:
            continue
        found = sorted(group, key=lambda row: row.seq)
        device, _ = _kind(context, numbers[bus], node)
        if index == ERROR_LIST:
            yield _error_list(device, found)
        elif index == ERROR_REGISTER:
            yield _register(device, found)


def _error_list(device: Device | None, rows: Sequence[ErrorHistoryRow]) -> DeviceHealthRow:
    """Number of stored errors by 1003h:0, and the entries as they were read last."""
    counts = [float(row.raw & 0xFF) for row in rows if row.seen == "count"]
    entries: dict[int, ErrorHistoryRow] = {}
    for row in rows:
        if row.seen == "count":
            entries = {sub: entry for sub, entry in entries.items() if sub <= row.raw & 0xFF}
        else:
            entries[row.sub] = row
    told = [entry for _, entry in sorted(entries.items()) if entry.code]
    figures = counts or [float(len(told))]
    listed = "; ".join(
        f"{entry.code:04X}h {entry.meaning} ({_seen(entry)})" for entry in told[:MAX_LISTED]
    )
    more = f" and {len(told) - MAX_LISTED} more" if len(told) > MAX_LISTED else ""
    note = next((row.note for row in reversed(rows) if row.note and row.seen == "count"), "")
    return _errors(
        device, "error list", "entries", rows, figures, (listed or "no entry") + more, note
    )


def _seen(entry: ErrorHistoryRow) -> str:
    return f"EMCY, frame {entry.emcy_seq}" if entry.seen == "seen" else entry.note or entry.seen


def _register(device: Device | None, rows: Sequence[ErrorHistoryRow]) -> DeviceHealthRow:
    figures = [float(row.raw) for row in rows]
    last = rows[-1]
    return _errors(device, "error register", "", rows, figures, last.meaning, last.note)


def _errors(
    device: Device | None,
    what: str,
    unit: str,
    rows: Sequence[ErrorHistoryRow],
    figures: Sequence[float],
    text: str,
    note: str,
) -> DeviceHealthRow:
    first, last = rows[0], rows[-1]
    return DeviceHealthRow(
        bus=last.bus,
        node=last.node,
        device=device.name if device else None,
        what=what,
        index=first.index,
        sub=0,
        unit=unit,
        reads=len(rows),
        first_value=figures[0],
        last_value=figures[-1],
        min=min(figures),
        max=max(figures),
        first_ns=first.t_ns,
        last_ns=last.t_ns,
        first_seq=first.seq,
        last_seq=last.seq,
        text=text,
        note=note,
    )
