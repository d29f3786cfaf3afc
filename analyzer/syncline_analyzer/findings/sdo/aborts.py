"""Findings on SDO transfers that were refused or broken off."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.sdo.groups import (
    alike,
    evidence,
    object_words,
    objects_words,
    timed_out_of,
    times,
)
from syncline_analyzer.findings.sdo.protocol import TOLD_BY_PROTOCOL
from syncline_analyzer.findings.sdo.writes import failed_configurations
from syncline_analyzer.results import Finding, SdoRow, SdoTransfers
from syncline_schemas.canopen.sdo import LOAD_SIGNATURE, SAVE_SIGNATURE, abort_meaning
from syncline_schemas.devices import quirks
from syncline_schemas.wording import counted

PROBING = (0x06010001, 0x06020000, 0x06090011, 0x08000024)
"""Abort codes with which a node says that it does not have what a master looks for."""
ERROR_LIST, NO_SUBINDEX, READ_ONLY = 0x1003, 0x06090011, 0x06010002
TIME_OUT = 0x05040000
_SIGNATURES = {0x1010: SAVE_SIGNATURE, 0x1011: LOAD_SIGNATURE}
_MANUAL = "Compare object, length and value with the device's manual; was it needed?"
_CAUSES: tuple[tuple[range, str, str], ...] = (
    (
        range(TIME_OUT, TIME_OUT + 1),
        "The client did not go on with the transfer in time: it stopped or started over.",
        "The client's log at that time, and bus errors.",
    ),
    (
        range(0x06010000, 0x06020000),
        "The node does not allow this kind of access to the object, always or at present.",
        "The object's access in the device's manual, and whether a PDO or state blocks it.",
    ),
    (
        range(0x06020000, 0x06020001),
        "The client takes the node for another device, or for another version of it.",
        "Compare 1000h, 1018h and the EDS with the device in the client's project.",
    ),
    (
        range(0x06040041, 0x06040043),
        "What the client maps into the PDO does not fit this device.",
        "Which objects the device can map (PDOMapping in its EDS), and how many bytes a PDO has.",
    ),
    (
        range(0x06060000, 0x06060001),
        "The node's own hardware, for example its memory, failed at this access.",
        "Repeat it; if it is refused again, read 1001h and 1003h of the node.",
    ),
    (
        range(0x06070000, 0x06080000),
        "The client sends another number of bytes than the object has.",
        "The object's data type in the device's manual, and the client's project.",
    ),
    (
        range(0x06090011, 0x06090012),
        "The client takes the node for another device, or for another version of it.",
        "Compare 1000h, 1018h and the EDS with the device in the client's project.",
    ),
    (
        range(0x06090030, 0x06090037),
        "The device does not allow this value.",
        "The limits of the object in the device's manual; what the client wants to set there.",
    ),
    (
        range(0x08000020, 0x08000023),
        "The node does not take it in its present state, or while it is operated locally.",
        "In which NMT state the device takes this write; is a PDO to be switched off first?",
    ),
)
"""Likely cause of a refusal and what to check, by abort code."""


def _aborts(facts: Facts) -> Iterator[Finding]:
    """One finding for all equal refusals of a node, and for all that it does not have."""
    for rows, kinds in _groups(facts, _refused(facts)):
        yield _probed(facts, rows, kinds) if len(kinds) > 1 else _abort(facts, rows)


def _refused(facts: Facts) -> SdoTransfers:
    """Transfers that were refused or broken off, and that no other finding tells."""
    aborted = facts.analysis.sdo.aborted
    if not len(aborted):
        return aborted
    told = [rows.records["seq"] for rows in (aborted[:0], *failed_configurations(facts))]
    left = ~np.isin(aborted.records["abort_code"], TOLD_BY_PROTOCOL) & ~timed_out_of(aborted)
    return aborted.part(left & ~np.isin(aborted.records["seq"], np.concatenate(told)))


def _groups(facts: Facts, refused: SdoTransfers) -> Iterator[tuple[SdoTransfers, list[SdoRow]]]:
    """What goes into one finding, in order of `seq`; and the first of each object and reason."""
    equal = alike(refused, "object", "direction", "abort_code", "abort_by")
    first = [refused[int(places[0])] for places in equal]
    kind = _kind(facts, first)
    chosen: dict[tuple[Any, ...], list[int]] = {}
    for number, row in enumerate(first):
        chosen.setdefault(kind(row), []).append(number)
    for _, numbers in sorted(chosen.items()):
        places = np.sort(np.concatenate([equal[number] for number in numbers]))
        kinds: dict[tuple[Any, ...], SdoRow] = {}
        for number in numbers:
            kinds.setdefault(_object(first[number]), first[number])
        yield refused.part(places), list(kinds.values())


def _kind(facts: Facts, rows: Sequence[SdoRow]) -> Callable[[SdoRow], tuple[Any, ...]]:
    """What goes into one finding: equal refusals, an object's reads with its writes, a search."""
    written = {_object(r) for r in rows if r.direction == "download" and r.abort_by != "client"}

    def kind(row: SdoRow) -> tuple[Any, ...]:
        node, by = (row.bus, row.node), row.abort_by or ""
        told_alone = by == "client" or _swapped(row) is not None or bool(_described(facts, row))
        if not told_alone and row.abort_code in PROBING and _object(row) in written:
            return *node, *_object(row)[2:], "", by
        if not told_alone and _probes(facts, row):
            return *node, -1, -1, -1, "upload", by
        return *node, *_object(row)[2:], row.direction, by

    return kind


def _object(row: SdoRow) -> tuple[str, int, int, int, int]:
    """The object of a transfer and why it failed."""
    code = row.abort_code if row.abort_code is not None else -1
    return row.bus, row.node, row.index or 0, row.sub or 0, code


def _probes(facts: Facts, row: SdoRow) -> bool:
    """Whether a read only finds out that a device does not have something, or is described."""
    reads = row.direction == "upload"
    return reads and (row.abort_code in PROBING or _normal(facts, row))


def _probed(facts: Facts, rows: SdoTransfers, kinds: Sequence[SdoRow]) -> Finding:
    """Reads of several objects that a node does not have; `kinds` are the first of each."""
    first = rows[0]
    reasons = list(dict.fromkeys(map(_reason, kinds)))
    count = len({(row.index, row.sub) for row in kinds})
    return Finding(
        "sdo.abort",
        "info",
        first.bus,
        first.node,
        first.start_ns,
        rows[-1].end_ns,
        f"{facts.who(first.bus, first.node)} refused {counted(len(rows), 'read')} of"
        f" {counted(count, 'object')}{_when(facts, rows)}: {objects_words(kinds)};"
        f" {' or '.join(reasons)}.",
        "The client looks for objects that this device does not have or does not let read.",
        "Nothing, if they are optional; else compare the device with the planned one.",
        evidence(rows),
    )


def _abort(facts: Facts, rows: SdoTransfers) -> Finding:
    writes = rows.writes
    judged = writes[0] if writes else rows[0]
    probing = _probes(facts, judged)
    who = facts.who(judged.bus, judged.node)
    what = _access(rows, writes)
    by_client = judged.abort_by == "client"
    gave_up = judged.abort_code == TIME_OUT
    said = f"{who} {'gave up' if gave_up else 'refused'} {what}"
    if by_client:
        said = f"{who}: the client broke off {what}"
    often = times(len(rows)) if len(writes) in (0, len(rows)) else ""
    cause, check = _why(facts, judged)
    return Finding(
        "sdo.abort",
        "info" if probing or _described(facts, judged) else "warning",
        judged.bus,
        judged.node,
        rows[0].start_ns,
        rows[-1].end_ns,
        f"{said}{_when(facts, rows)}: {_reason(judged)}{often}.",
        cause,
        check,
        evidence(rows),
    )


def _access(rows: Sequence[SdoRow], writes: Sequence[SdoRow]) -> str:
    """What was tried: the read, the write with its value, or how often each."""
    what = object_words(rows[0])
    if not writes:
        return f"the read of {what}"
    if len(writes) < len(rows):
        reads = len(rows) - len(writes)
        return f"{counted(len(writes), 'write')} and {counted(reads, 'read')} of {what}"
    first = writes[0].value
    value = first if all(row.value == first for row in writes) else None
    if not isinstance(value, int):
        return f"the write of {what}"
    return f"the write of {_shown(writes[0].index or 0, value)} to {what}"


def _shown(index: int, value: int) -> str:
    """A value as people write it: "save", identifiers and mappings in hexadecimal digits."""
    if value == _SIGNATURES.get(index):
        return f'"{value.to_bytes(4, "little").decode()}"'
    return str(value) if abs(value) < 1 << 16 else f"{value:X}h"


def _misspelt(row: SdoRow) -> str:
    """Why a node does not save or restore: "" where the right word was written."""
    word = _SIGNATURES.get(row.index or 0)
    if row.direction != "download" or word is None or row.value in (None, word):
        return ""
    if row.abort_code in (*PROBING, READ_ONLY):
        return ""
    return (
        f'{row.index:04X}h takes only "{word.to_bytes(4, "little").decode()}" ({word:08X}h), and'
        " another value was written: it is a guard against writes by mistake."
    )


def _when(facts: Facts, rows: Sequence[SdoRow]) -> str:
    first, last = rows[0].start_ns, rows[-1].start_ns
    if not facts.context.timed or facts.moment(first) == facts.moment(last):
        return facts.at(first)
    return f" between {facts.moment(first)} and {facts.moment(last)}"


def _why(facts: Facts, row: SdoRow) -> tuple[str, str]:
    """Likely cause of a refusal, and what to check."""
    swapped, described = _swapped(row), _described(facts, row)
    if described:
        return described, "Nothing, if the client can do without it."
    if swapped is not None:
        return (
            f"The client sends the index with its bytes exchanged: {swapped:04X}h is meant.",
            "The byte order of the index in the client's program: low byte first.",
        )
    if _probes(facts, row):
        return (
            "The client looks for an object that this device does not have or does not let read.",
            "Nothing, if the object is optional; else compare the device with the planned one.",
        )
    if row.abort_by != "client" and _misspelt(row):
        return _misspelt(row), "What the client writes there, and its byte order."
    if row.abort_by == "client":
        return (
            "The client did not accept what the node answered, or was told to stop.",
            "The client's log at that time; the node's answer against its manual.",
        )
    for codes, cause, check in _CAUSES:
        if row.abort_code in codes:
            return cause, check
    return "What the client asks does not fit this device or its present state.", _MANUAL


def _described(facts: Facts, row: SdoRow) -> str:
    """Why a node refuses by its description or by CiA 301; "" where nothing there says so."""
    if row.abort_by == "client":
        return ""
    if row.index == ERROR_LIST and row.abort_code == NO_SUBINDEX:
        if row.direction == "upload":
            return (
                "The error list has no such entry yet: fewer errors are stored (CiA 301 7.5.2.3)."
            )
        return "The node did not clear its error list: only a 0 to 1003h:0 clears it."
    device = facts.context.shadow.device(facts.number(row.bus), row.node)
    if device is None or row.direction == "upload":
        return ""
    known = device.object(row.index or 0, row.sub or 0)
    if known is None and row.abort_code in PROBING:
        return f"A {device.title} has no such object, as its description says."
    if known is not None and known.access in ("ro", "const") and row.abort_code == READ_ONLY:
        return f"The object is read-only on a {device.title}, as its description says."
    return ""


def _swapped(row: SdoRow) -> int | None:
    """The index that is meant where the refused one is none of an object (0000h to 0FFFh)."""
    index = row.index or 0
    meant = (index & 0xFF) << 8 | index >> 8
    return meant if 0 < index < 0x1000 <= meant and row.abort_code == 0x06020000 else None


def _reason(row: SdoRow) -> str:
    if row.abort_code is None:
        return "the abort frame is cut short and gives no code"
    return f"{abort_meaning(row.abort_code)} ({row.abort_code:08X}h)"


def _normal(facts: Facts, row: SdoRow) -> bool:
    """Refusals that the device's maker describes."""
    device = facts.context.shadow.device(facts.number(row.bus), row.node)
    known = device.object(row.index or 0, row.sub or 0) if device else None
    return row.index in quirks(device).absent or (known is not None and known.access == "wo")


RULES: tuple[Rule, ...] = (
    Rule(
        "sdo.abort",
        "An SDO transfer was refused or broken off, with the reason in words.",
        "The requests that were refused.",
        (
            "Reads of objects that a device does not have are one note per node: a search.",
            "Refusals that the device's maker describes are a note.",
            "Time-outs, CRC and toggle errors and failed configurations have rules of their own.",
        ),
        _aborts,
        untimed=True,
    ),
)
