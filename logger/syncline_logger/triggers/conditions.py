"""From the words of --trigger to conditions on events."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from syncline_logger.triggers.event import Event, Kind
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.errors import SeveralErrors, UsageError

FORMS = (
    "emcy[:NODE[:CODE]]",
    "node-lost[:NODE]",
    "boot-up[:NODE]",
    "nmt:NODE:STATE",
    "bus-off[:BUS]",
    "sdo-abort[:NODE]",
    "value:NODE:NAME>NUMBER[UNIT]",
    "gap[:BUS]",
)
"""What there is, as a user writes it."""

_OF_NODE: dict[str, Kind] = {
    "node-lost": "node-lost",
    "boot-up": "boot-up",
    "sdo-abort": "sdo-abort",
}
_OF_BUS: dict[str, Kind] = {"bus-off": "bus-off", "gap": "gap"}
_STATES = {
    "pre-operational": NmtState.PRE_OPERATIONAL,
    "operational": NmtState.OPERATIONAL,
    "stopped": NmtState.STOPPED,
}
_NODE = re.compile(r"(?:(?P<bus>[^/]+)/)?(?P<node>\d{1,3}|\*)")
_CODE = re.compile(r"(?:0x)?([0-9a-f]{2})(?:([0-9a-f]{2})|xx)h?", re.IGNORECASE)
_VALUE = re.compile(
    r"(?P<name>.+?)\s*(?P<than>>=|<=|>|<)\s*(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)"
    r"\s*(?P<unit>.*)",
    re.IGNORECASE,
)
_OBJECT = re.compile(r"(?:0x)?([0-9a-f]{4})h?(?::(?:0x)?([0-9a-f]{1,2})h?)?", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ValueTest:
    """A bound of a decoded value.

    By an object's number its raw number is compared, unless a unit is given; by its name, and with
    a unit, the value in that unit.
    """

    name: str
    key: tuple[int, int] | None
    than: str
    bound: float
    unit: str = ""

    @property
    def raw(self) -> bool:
        """Whether the number is compared as the bus carries it."""
        return self.key is not None and not self.unit


@dataclass(frozen=True, slots=True)
class Condition:
    """Which events are waited for; None = any."""

    word: str
    kind: Kind
    bus: str | None = None
    node: int | None = None
    code: int | None = None
    code_mask: int = 0xFFFF
    state: NmtState | None = None
    value: ValueTest | None = None

    def takes(self, event: Event, bus_name: str | None) -> bool:
        """Whether it waits for this event."""
        if event.kind != self.kind or self.node not in (None, event.node):
            return False
        if self.bus is not None and bus_name is not None and bus_name != self.bus:
            return False
        if self.code is not None:
            return isinstance(event.detail, int) and event.detail & self.code_mask == self.code
        if self.state is not None or self.value is not None:
            return event.detail == (self.word if self.value else self.state)
        return True


def parse_conditions(words: Iterable[str], buses: Sequence[str] = ()) -> tuple[Condition, ...]:
    """The conditions of several words; all that is wrong with them is told at once.

    buses: names that a condition may give; none = any name.

    Raises: UsageError.
    """
    found, problems = [], []
    for word in words:
        try:
            condition = parse_condition(word)
            if buses and condition.bus is not None and condition.bus not in buses:
                raise _wrong(word, f"there is no bus '{condition.bus}', only {', '.join(buses)}")
            found.append(condition)
        except UsageError as error:
            problems.append(str(error))
    if len(problems) > 1:
        raise SeveralErrors(problems)
    if problems:
        raise UsageError(problems[0])
    return tuple(found)


def parse_condition(word: str) -> Condition:
    """One condition.

    >>> parse_condition("emcy:7:8130").code == 0x8130, parse_condition("nmt:7:stopped").state
    (True, <NmtState.STOPPED: 'STOPPED'>)
    >>> parse_condition("value:7:Position>350deg").value.bound
    350.0

    Raises: UsageError with what there is.
    """
    kind, *rest = word.strip().split(":", 2)
    kind = kind.strip().lower()
    if kind in _OF_BUS and len(rest) <= 1:
        return Condition(word, _OF_BUS[kind], bus=rest[0] if rest else None)
    if kind in _OF_NODE and len(rest) <= 1:
        bus, node = _node(word, rest[0]) if rest else (None, None)
        return Condition(word, _OF_NODE[kind], bus, node)
    if kind == "emcy":
        bus, node = _node(word, rest[0]) if rest else (None, None)
        code, mask = _code(word, rest[1]) if len(rest) > 1 else (None, 0xFFFF)
        return Condition(word, "emcy", bus, node, code, mask)
    if kind == "nmt" and len(rest) == 2:
        bus, node = _node(word, rest[0])
        state = _STATES.get(rest[1].strip().lower())
        if state is None:
            raise _wrong(word, f"'{rest[1]}' is no NMT state; write {', '.join(_STATES)}")
        return Condition(word, "nmt", bus, node, state=state)
    if kind == "value" and len(rest) == 2:
        bus, node = _node(word, rest[0])
        return Condition(word, "value", bus, node, value=_value(word, rest[1]))
    raise _wrong(word, "there is " + ", ".join(FORMS))


def _node(word: str, text: str) -> tuple[str | None, int | None]:
    match = _NODE.fullmatch(text.strip() or "*")
    if match is None or (match["node"] != "*" and not 1 <= int(match["node"]) <= 127):
        raise _wrong(word, f"'{text}' is no node; write 1 to 127, * for all, or BUS/NODE")
    return match["bus"], None if match["node"] == "*" else int(match["node"])


def _code(word: str, text: str) -> tuple[int, int]:
    match = _CODE.fullmatch(text.strip())
    if match is None:
        raise _wrong(word, f"'{text}' is no EMCY code; write 8130, or 81xx for a group")
    return int(match[1] + (match[2] or "00"), 16), 0xFFFF if match[2] else 0xFF00


def _value(word: str, text: str) -> ValueTest:
    match = _VALUE.fullmatch(text.strip())
    if match is None:
        raise _wrong(
            word, "write a name or an object, > or <, and a number: Position>350deg, 6004h>4000"
        )
    known = _OBJECT.fullmatch(match["name"])
    key = (int(known[1], 16), int(known[2] or "0", 16)) if known else None
    return ValueTest(
        match["name"], key, match["than"], float(match["number"]), match["unit"].strip()
    )


def _wrong(word: str, why: str) -> UsageError:
    return UsageError(f"trigger '{word}': {why}")
