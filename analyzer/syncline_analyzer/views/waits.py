"""What synchronous PDOs waited for, in rows for the text and HTML views alike."""

from collections.abc import Callable, Iterator

from syncline_analyzer.results import Ahead, Analysis, DelayRow, LatenessRow, PdoRow, WaitRow
from syncline_analyzer.views.services import Listing
from syncline_analyzer.views.words import Clock, hex_code, number

_SHOWN = 5
"""PDOs, and senders of each bus, that are listed."""
_AHEAD = 3
"""Identifiers ahead of an answer that are named."""


def waiting_listings(analysis: Analysis, clock: Clock) -> Iterator[Listing]:
    """The longest wait of the PDOs that waited longest, and whose frames were waited for most."""
    if rows := [_wait(row, clock) for row in _longest(analysis)]:
        heads = ["when", "bus", "PDO", ">response", ">device", ">waited", "behind"]
        yield Listing("Longest waits for the bus (at most)", heads, rows)
    label = pdo_label(analysis)
    if rows := [_delay(row, label) for row in _most(analysis)]:
        heads = ["bus", "sender", ">answers", ">frames", ">in all", ">worst", "worst of"]
        yield Listing("Whose frames synchronous PDOs waited for (at most)", heads, rows)


def pdo_label(analysis: Analysis) -> Callable[[str, int], str]:
    """Names a PDO by bus and identifier: "TPDO1 of node 5 (185h)"."""
    rows = {(row.bus, row.cob_id): row for row in analysis.pdos}

    def label(bus: str, cob_id: int) -> str:
        row = rows.get((bus, cob_id))
        if row is None or row.node is None:
            return hex_code(cob_id, 3)
        return f"{row.pdo or 'PDO'} of node {row.node} ({hex_code(cob_id, 3)})"

    return label


def late_because(pdo: PdoRow, why: LatenessRow | None) -> str:
    """How often a synchronous PDO was late or missed, and whose doing it was; "" where never.

    >>> row = PdoRow("can0", 0x185, 5, "TPDO1", 9, 1, "unknown", None, None, None, None, 3, 0, 2)
    >>> late_because(row, None)
    '3 missed, 2 late'
    """
    told = [
        _because(pdo.missed, "missed", (why.missed_by_bus, why.missed_by_device) if why else ()),
        _because(pdo.late, "late", (why.late_by_bus, why.late_by_device) if why else ()),
    ]
    return ", ".join(part for part in told if part)


def _because(count: int, word: str, by: tuple[int, ...]) -> str:
    if not count:
        return ""
    parts = zip(by, ("bus", "device"), strict=False)
    told = ", ".join(f"{n} {whose}" for n, whose in parts if n)
    return f"{count} {word}" + (f" ({told})" if told else "")


def _longest(analysis: Analysis) -> list[WaitRow]:
    """The longest wait of each PDO, the longest first."""
    best: dict[tuple[str, int], WaitRow] = {}
    for row in analysis.waits:
        key = (row.bus, row.cob_id)
        if row.ahead and (key not in best or row.waiting_us > best[key].waiting_us):
            best[key] = row
    return sorted(best.values(), key=lambda row: -row.waiting_us)[:_SHOWN]


def _wait(row: WaitRow, clock: Clock) -> list[str]:
    whose = f" of node {row.node}" if row.node is not None else ""
    ahead = ", ".join(_ahead(each) for each in row.ahead[:_AHEAD])
    more = ", ..." if len(row.ahead) > _AHEAD else ""
    return [
        clock.short(row.t_ns),
        row.bus,
        f"{row.pdo or 'PDO'}{whose} ({hex_code(row.cob_id, 3)})",
        _ms(row.response_us),
        f"{number(row.device_us_least / 1000)} to {_ms(row.device_us_most)}",
        _ms(row.waiting_us),
        f"{ahead}{more}",
    ]


def _ahead(ahead: Ahead) -> str:
    often = f" x{ahead.frames}" if ahead.frames > 1 else ""
    return f"{hex_code(ahead.cob_id, 3)}{often} {_whose(ahead.service, ahead.node)}"


def _most(analysis: Analysis) -> list[DelayRow]:
    """The senders that were waited for most, the worst first, for each bus."""
    chosen: list[DelayRow] = []
    for bus in dict.fromkeys(row.bus for row in analysis.delays):
        chosen += [r for r in analysis.delays if r.bus == bus and r.cob_id is None][:_SHOWN]
    return chosen


def _delay(row: DelayRow, label: Callable[[str, int], str]) -> list[str]:
    return [
        row.bus,
        "master" if row.node is None else f"node {row.node}",
        f"{row.delayed:,}",
        f"{row.frames:,}",
        _ms(row.us),
        _ms(row.worst_us),
        label(row.bus, row.worst_cob_id),
    ]


def _whose(service: str, node: int | None) -> str:
    return f"({service})" if node is None else f"({service} of node {node})"


def _ms(us: float) -> str:
    return number(us / 1000, "ms")
