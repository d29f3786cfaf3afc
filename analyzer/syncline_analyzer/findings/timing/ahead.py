"""What went ahead of synchronous PDOs, in words, and what that rests on."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.findings.stretch import milliseconds
from syncline_analyzer.findings.timing.blame import (
    assumed_window,
    frames_of,
    is_guess,
    is_own,
    waits_of,
)
from syncline_analyzer.results import Ahead, LatenessRow, PdoRow, WaitRow
from syncline_schemas.wording import counted

_FEW = 3
EXACT_STAMPS = (
    "Only where the bit rate is known and the stamps are exact enough to tell which frames followed"
    " one another: not with stamps of 1 ms, of bundles, or beside error frames."
)


def of_others(row: LatenessRow, ahead: Sequence[Ahead]) -> list[Ahead]:
    """Those that the node did not send itself."""
    return [each for each in ahead if not is_own(each, row.node)]


def total_us(ahead: Sequence[Ahead]) -> float:
    """What they took on the wire."""
    return sum(each.us for each in ahead)


def joined(ahead: Iterator[Ahead]) -> list[Ahead]:
    """Summed up by identifier, the longest first."""
    found: dict[tuple[int, str], Ahead] = {}
    for each in ahead:
        old = found.get((each.cob_id, each.service))
        if old is not None:
            each = replace(each, frames=old.frames + each.frames, us=old.us + each.us)
        found[each.cob_id, each.service] = each
    return sorted(found.values(), key=lambda each: -each.us)


def listed(facts: Facts, bus: str, ahead: Sequence[Ahead]) -> str:
    """The frames with their time, the longest first."""
    first = ", ".join(
        f"{frames_of(facts, bus, each)} {milliseconds(each.us)} in {counted(each.frames, 'frame')}"
        for each in ahead[:_FEW]
    )
    return f"{first} and others" if len(ahead) > _FEW else first


def late_waits(facts: Facts, row: LatenessRow) -> list[WaitRow]:
    """Those of the worst answers that were late."""
    return [wait for wait in waits_of(facts, row) if is_late(wait, row)]


def is_late(wait: WaitRow, row: LatenessRow) -> bool:
    """Whether an answer came after the synchronous window (1007h)."""
    return row.window_us is not None and wait.response_us > row.window_us


def evidence_of(waits: Sequence[WaitRow]) -> list[int]:
    """The answers and the frames ahead of them."""
    ahead = (seq for wait in waits for each in wait.ahead for seq in each.seq[:_FEW])
    return sorted({*(wait.seq for wait in waits), *ahead})


def assumed(facts: Facts, row: LatenessRow) -> list[str]:
    """What the times of a PDO rest on."""
    return [*facts.context.assumed_wire(row.bus), *assumed_window(facts, row)]


def assumed_ahead(facts: Facts, row: LatenessRow, ahead: Sequence[Ahead]) -> list[str]:
    """Senders and transmission types of the frames ahead that nobody told for certain."""
    named = ahead[:_FEW]
    ids = {row.cob_id, *(each.cob_id for each in named)}
    guessed = [_assumed_sender(each) for each in named if is_guess(each.service)]
    types = [
        _assumed_type(pdo)
        for pdo in facts.analysis.pdos
        if pdo.bus == row.bus and pdo.cob_id in ids and _is_assumed(pdo)
    ]
    return [*guessed, *types]


def _assumed_sender(each: Ahead) -> str:
    if each.node is None:
        return f"{each.cob_id:03X}h is a PDO (by its identifier alone)"
    return f"{each.cob_id:03X}h comes from node {each.node} (by its identifier alone)"


def _is_assumed(pdo: PdoRow) -> bool:
    inferred = pdo.transmission_type is None and pdo.type_source.startswith("inferred")
    return inferred or pdo.type_source == "eds-default"


def _assumed_type(pdo: PdoRow) -> str:
    if pdo.type_source == "eds-default":
        return f"{pdo.cob_id:03X}h is of type {pdo.transmission_type} (eds-default)"
    return (
        f"{pdo.cob_id:03X}h is {pdo.type_source.removeprefix('inferred: ')} (by its frames alone)"
    )


def sync_period_us(facts: Facts, bus: str) -> float | None:
    """Median of the fastest SYNC of a bus."""
    periods = [
        row.period_us.median for row in facts.analysis.sync if row.bus == bus and row.period_us
    ]
    return min(periods, default=None)


def named_pdo(facts: Facts, row: LatenessRow) -> str:
    """A PDO by its node, its number and its identifier, at the head of texts."""
    if row.node is None or row.pdo is None:
        return f"A PDO ({row.cob_id:03X}h)"
    return f"{facts.who(row.bus, row.node)}: {row.pdo.split()[0]} ({row.cob_id:03X}h)"
