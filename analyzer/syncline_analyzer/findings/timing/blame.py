"""Whether bus or device made a synchronous PDO late, in words."""

from collections.abc import Callable, Iterable

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.findings.stretch import milliseconds
from syncline_analyzer.results import Ahead, LatenessRow, PdoRow, WaitRow
from syncline_schemas.records import dataclass
from syncline_schemas.wording import counted

_GUESS = " (guess)"
_SHARE = 1 / 3
"""So many of the answers that the bus made late make frames a cause of it."""
_NAMED = 3
"""Blockers that a sentence names."""


@dataclass(frozen=True, slots=True)
class Why:
    """Likely cause and next check of a PDO that was late or missed, and what they rest on."""

    cause: str
    check_next: str
    assumed: list[str]


def lateness_of(facts: Facts, row: PdoRow) -> LatenessRow | None:
    """What arbitration tells of one PDO, None where it tells nothing."""
    rows = facts.analysis.lateness
    return next((each for each in rows if (each.bus, each.cob_id) == (row.bus, row.cob_id)), None)


def waits_of(facts: Facts, row: LatenessRow | PdoRow) -> list[WaitRow]:
    """The worst answers of one PDO."""
    return [e for e in facts.analysis.waits if (e.bus, e.cob_id) == (row.bus, row.cob_id)]


@dataclass(frozen=True, slots=True)
class Behind:
    """Late answers of a PDO that would have been in time without some frames of others.

    Attributes:
        found: how many of those that are known one by one.
        count: at least so many of them are the bus's doing (`LatenessRow.late_by_bus`).
        ahead: those frames ahead of them, by identifier.
        late: all late answers of the PDO.
        whole: whether all that frames of others explain are known one by one.
    """

    found: int
    count: int
    ahead: list[Ahead]
    late: int
    whole: bool

    def __str__(self) -> str:
        """How many of the late answers, in words."""
        if self.count == self.late:
            return counted(self.count, "time")
        least = "" if self.whole else "at least "
        return f"{least}{self.count} of {counted(self.late, 'time')}"


def behind(
    facts: Facts,
    row: LatenessRow,
    chosen: Callable[[Ahead], bool],
    share: float = _SHARE,
) -> Behind | None:
    """What some frames made late, None where that is less than a share of what the bus did."""
    known = facts.context.late_behind.get((row.bus, row.cob_id))
    if known is None or not row.late_by_bus:
        return None
    found, ahead = known.without(chosen)
    count = found - (known.total - row.late_by_bus)
    if count < 1 or count < share * min(row.late_by_bus, known.kept):
        return None
    return Behind(found, count, ahead, row.late, known.kept == known.total)


def why_late(facts: Facts, row: PdoRow) -> Why | None:
    """Why a PDO was late; None where it stays open for most of its late answers."""
    found = lateness_of(facts, row)
    if found is None or 2 * (found.late_by_device + found.late_by_bus) <= found.late:
        return None
    if found.late_by_device >= found.late_by_bus:
        return _late_by_device(facts, row, found)
    return _late_by_bus(facts, row, found)


def _late_by_device(facts: Facts, row: PdoRow, found: LatenessRow) -> Why:
    least = row.device_us_least.max / 1000 if row.device_us_least else 0.0
    return Why(
        f"The device itself{_of(found.late_by_device, found.late)}: with the bus to itself the PDO"
        f" would have been late, too. It took at least {least:.4g} ms in the worst case.",
        "Look at the device: its cycle, what else it has to do at that time (SDO traffic, other"
        " PDOs), and whether 1007h asks for more than it can do.",
        facts.context.assumed_wire(row.bus),
    )


def _late_by_bus(facts: Facts, row: PdoRow, found: LatenessRow) -> Why:
    ahead = named(facts, row.bus, row.node, found.blockers)
    after = f", most of it behind {ahead}" if ahead else ""
    longest = f" up to {milliseconds(row.waiting_us.max)}" if row.waiting_us else ""
    return Why(
        f"Frames of others kept the bus busy{_of(found.late_by_bus, found.late)}: each of the"
        f" {found.free:,} times that the bus was idle the PDO was in time, but it waited{longest}"
        f"{after}.",
        _give_way(row, found),
        facts.context.assumed_wire(row.bus),
    )


def _give_way(row: PdoRow, found: LatenessRow) -> str:
    """What helps a PDO that waits for others; an identifier only against lower ones."""
    others = [each for each in found.blockers if not is_own(each, row.node)]
    lower_us = sum(each.us for each in others if each.cob_id < row.cob_id)
    fewer = (
        "et fewer frames be sent at the SYNC (transmission types, event timers, inhibit times), or raise"
        " the bit rate."
    )
    if 2 * lower_us < sum(each.us for each in others):
        return f"L{fewer}"
    return f"Give {row.cob_id:03X}h a lower identifier than what it waits for, l{fewer}"


def why_missed(facts: Facts, row: PdoRow) -> Why | None:
    """Why a PDO did not come; None where it stays open for most of the SYNCs without an answer."""
    found = lateness_of(facts, row)
    if found is None or not found.missed:
        return None
    assumed = facts.context.assumed_wire(row.bus)
    if 2 * found.missed_by_device > found.missed:
        who = "Its sender" if (row.pdo or "").startswith("RPDO") else "The device"
        return Why(
            f"{who} did not have it ready{_of(found.missed_by_device, found.missed)}: the bus was free"
            " for it later than it was ever ready when it answered. It was too busy, had no new"
            " value, or was about to leave OPERATIONAL.",
            "Look at the device and its EMCY messages at these times; read 180xh:2/5 and, on devices"
            " that have it, the repeat counter (280xh).",
            assumed,
        )
    if 2 * found.missed_by_bus > found.missed:
        return Why(
            f"The bus was not free for it until the next SYNC{_of(found.missed_by_bus, found.missed)}:"
            " frames with lower identifiers went first.",
            f"Look at the bus load at these times; give {row.cob_id:03X}h a lower identifier, or let"
            " fewer frames be sent at the SYNC.",
            assumed,
        )
    return None


def assumed_window(facts: Facts, row: PdoRow | LatenessRow) -> list[str]:
    """The synchronous window, where only the device's EDS tells it."""
    if row.node is None:
        return []
    known = facts.context.shadow.get(facts.number(row.bus), row.node, 0x1007)
    if known is None or known.source != "eds-default" or not isinstance(known.value, int):
        return []
    return [f"1007h = {known.value} us (eds-default)"]


def named(facts: Facts, bus: str, node: int | None, ahead: Iterable[Ahead]) -> str:
    """The frames of others that took the most time: "TPDO3 of node 1 (381h), 0.8 ms"."""
    others = sorted((e for e in ahead if not is_own(e, node)), key=lambda each: -each.us)
    return " and ".join(frames_of(facts, bus, each) for each in others[:_NAMED])


def frames_of(facts: Facts, bus: str, ahead: Ahead) -> str:
    """Frames of one identifier in words."""
    how = ", by its identifier alone" if is_guess(ahead.service) else ""
    width = 8 if ahead.service == "29-bit" else 3
    return f"{_sender_of(facts, bus, ahead)} ({ahead.cob_id:0{width}X}h{how})"


def _sender_of(facts: Facts, bus: str, ahead: Ahead) -> str:
    """What the frames are, and whose."""
    if ahead.service == "SDO request":
        return f"SDO requests to node {ahead.cob_id & 0x7F}"
    service = f"{ahead.service}s" if ahead.service == "SDO answer" else ahead.service
    service = service.removesuffix(_GUESS)
    if ahead.node is not None:
        return f"{service} of {facts.inside(bus, ahead.node)}"
    return "frames" if service in ("other", "29-bit") else service


def is_guess(service: str) -> bool:
    """Whether only the predefined connection set says what the frames are."""
    return service.endswith(_GUESS)


def is_own(ahead: Ahead, node: int | None) -> bool:
    """Whether the frames come from the node that waits: then it is the device's own queue."""
    return node is not None and ahead.node == node


def _of(some: int, all_of_them: int) -> str:
    return "" if some == all_of_them else f" ({some} of {all_of_them} times)"
