"""What the rules on configuration share: objects and their values in words, writes, restarts."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.object_history import Known, Span
from syncline_analyzer.objects import meaning, named
from syncline_analyzer.results import SdoRow

NodeKey = tuple[int, int]
"""(bus number, node)."""
COMMUNICATION = range(0x1000, 0x2000)
PDO_PARAMETERS = range(0x1400, 0x1C00)
"""Communication and mapping parameters of all PDOs."""
_PDO_COMMUNICATION = {*range(0x1400, 0x1600), *range(0x1800, 0x1A00)}
_SDO_PARAMETERS = range(0x1200, 0x1300)
_COB_IDS = {0x1005, 0x1012, 0x1014}
"""Objects whose value is an identifier (CiA 301 7.5.2), which people write in hexadecimal digits."""


def object_words(facts: Facts, key: NodeKey, index: int, sub: int) -> str:
    """An object as a sentence names it: "1017h (producer heartbeat time)"."""
    name, _ = named(facts.context.shadow.device(*key), index, sub)
    number = f"{index:04X}h:{sub}" if sub or index in PDO_PARAMETERS else f"{index:04X}h"
    return f"{number} ({name})" if name else number


def value_words(facts: Facts, key: NodeKey, index: int, sub: int, value: int | bytes) -> str:
    """A value with its unit or meaning: "500 ms", "254 (cyclic by the event timer)"."""
    if isinstance(value, bytes):
        return value.hex(" ").upper()
    device = facts.context.shadow.device(*key)
    words, (_, unit) = meaning(device, index, sub, value), named(device, index, sub)
    if words:
        return f"{value} ({words})" if value < 1 << 16 else words
    return f"{value} {unit}" if unit and unit != "us" else str(value)


def assumed_words(index: int, sub: int, known: Known | None) -> list[str]:
    """What a finding has to say of a value that the node itself did not tell."""
    if known is None or known.confirmed:
        return []
    number = f"{index:04X}h:{sub}" if sub else f"{index:04X}h"
    return [f"{number} = {_shown(index, sub, known.value)} ({known.source})"]


def _shown(index: int, sub: int, value: int | bytes) -> str:
    """
    >>> _shown(0x1800, 1, 0x185), _shown(0x1A00, 0, 1), _shown(0x1A00, 1, 0x60040020)
    ('185h', '1', '60040020h')
    """
    if isinstance(value, bytes):
        return value.hex(" ").upper()
    holds_id = index in _COB_IDS or (index in _PDO_COMMUNICATION and sub == 1)
    mapped = index in PDO_PARAMETERS and index not in _PDO_COMMUNICATION and sub > 0
    sdo = index in _SDO_PARAMETERS and sub in (1, 2)
    return f"{value:X}h" if value and (holds_id or mapped or sdo) else str(value)


def written(facts: Facts) -> Iterator[tuple[NodeKey, SdoRow]]:
    """Acknowledged writes by (bus number, node), in order of `seq`."""
    for row in facts.analysis.sdo.accepted:
        if row.index is not None:
            yield (facts.number(row.bus), row.node), row


def restart_after(facts: Facts, key: NodeKey, seq: int) -> tuple[int, int] | None:
    """(seq, t_ns) of the first boot-up or reset command of a node after `seq`."""
    bus = facts.context.bus_name(key[0])
    boots = [
        (boot.seq, boot.t_ns)
        for boot in facts.control.nmt.boot_ups
        if (boot.bus, boot.node) == (bus, key[1]) and boot.seq > seq
    ]
    commands = [
        (row.seq, row.t_ns)
        for row in facts.analysis.nmt_commands
        if row.bus == bus
        and row.node in (0, key[1])
        and row.seq > seq
        and row.command.startswith("reset")
    ]
    return min([*boots, *commands], default=None)


def alive(facts: Facts, key: NodeKey) -> bool:
    """Whether a node was heard for certain, not only guessed from PDO identifiers."""
    bus = facts.context.bus_name(key[0])
    return any(
        row.node == key[1] and row.bus == bus and set(row.proof) - {"pdo (guess)"}
        for row in facts.analysis.nodes
    )


def overlap(a: Span, b: Span) -> int | None:
    """First `seq` at which both hold, None where they never do."""
    start = max(a.change.seq, b.change.seq)
    ends = [span.until_seq for span in (a, b) if span.until_seq is not None]
    return start if start < min(ends, default=start + 1) else None


def operational_after(facts: Facts, key: NodeKey, t_ns: int) -> int:
    """How long a node is OPERATIONAL after a moment [ns]."""
    bus = facts.context.bus_name(key[0])
    return sum(
        max(0, row.end_ns - max(row.start_ns, t_ns))
        for row in facts.analysis.nmt_states
        if (row.bus, row.node, row.state) == (bus, key[1], "OPERATIONAL")
    )
