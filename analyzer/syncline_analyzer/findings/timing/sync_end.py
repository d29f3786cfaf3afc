"""SYNC that ends for good while the nodes that wait for it live on."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.timing.sync_settings import producers
from syncline_analyzer.results import Finding, SyncRow
from syncline_schemas.canopen.nmt import NmtState

ENOUGH = 50
"""SYNCs that make a rhythm."""
SILENT_NS = 5_000_000_000
SILENT_PERIODS = 20
"""SYNC has ended when it stays away for so long and so many of its periods."""
COMMAND_NS = 10_000_000_000
"""A command to all nodes this close to the last SYNC goes with it [ns]."""
TOGETHER_NS = 300_000_000
"""The producer's own last sign of life is no further from the last SYNC, beside its timeout [ns]."""
_DOWN = ("stop", "enter pre-operational", "reset")
_SETTINGS = (0x1005, 0x1006)


def _stopped(facts: Facts) -> Iterator[Finding]:
    """The end of SYNC, with the node that sent it where something names it."""
    for row in facts.analysis.sync:
        bus = facts.number(row.bus)
        end_ns = facts.control.clock.ended_ns.get(bus)
        if row.last_ns is None or row.period_us is None or row.count < ENOUGH or end_ns is None:
            continue
        silent_ns = end_ns - row.last_ns
        if silent_ns < max(SILENT_NS, SILENT_PERIODS * row.period_us.median * 1000):
            continue
        waiting = _waiting(facts, bus, row.last_ns)
        if len(_gone(facts, bus, row.last_ns)) > len(waiting):
            continue
        if waiting and not _meant(facts, row, row.last_ns) and not _elsewhere(facts, row):
            yield _finding(facts, row, row.last_ns, silent_ns, waiting)


def _waiting(facts: Facts, bus: int, last_ns: int) -> list[int]:
    """Nodes that tell OPERATIONAL long after the last SYNC, and send a PDO."""
    found = []
    for (on, node), nmt in facts.control.nmt.nodes.items():
        if on != bus or nmt.told_ns is None or nmt.told_ns < last_ns + SILENT_NS:
            continue
        intervals = facts.control.nmt.timelines[on, node].intervals
        state = next((i for i in intervals if i.start_ns <= nmt.told_ns < i.end_ns), intervals[-1])
        operational = state.state is NmtState.OPERATIONAL and state.certainty == "observed"
        if operational and nmt.pdos != "no":
            found.append(node)
    return sorted(found)


def _meant(facts: Facts, row: SyncRow, last_ns: int) -> bool:
    """Whether somebody sent the nodes down, or set the producer, about then."""
    down = any(
        each.bus == row.bus
        and each.node == 0
        and each.command.startswith(_DOWN)
        and each.t_ns >= last_ns - COMMAND_NS
        for each in facts.control.nmt.commands
    )
    return down or any(
        each.bus == row.bus and abs(each.end_ns - last_ns) <= COMMAND_NS
        for each in facts.analysis.sdo.writes.of_objects(lambda of: of.index in _SETTINGS)
    )


def _elsewhere(facts: Facts, row: SyncRow) -> bool:
    """Whether another SYNC of the bus goes on."""
    return any(
        other.bus == row.bus
        and other.cob_id != row.cob_id
        and (other.last_ns is None or other.last_ns > (row.last_ns or 0))
        for other in facts.analysis.sync
    )


def _gone(facts: Facts, bus: int, last_ns: int) -> list[int]:
    """Nodes that were heard last at about the last SYNC, and not again."""
    return [
        node
        for (on, node), timeline in facts.control.nmt.timelines.items()
        for lost in timeline.lost
        if on == bus
        and lost.end_seq is None
        and abs(lost.last_ns - last_ns) <= lost.timeout_ns + TOGETHER_NS
    ]


def _finding(
    facts: Facts, row: SyncRow, last_ns: int, silent_ns: int, waiting: list[int]
) -> Finding:
    bus = facts.number(row.bus)
    told = producers(facts.context.shadow, bus, row.cob_id)
    gone = _gone(facts, bus, last_ns)
    both = [node for node in gone if node in told] or (gone if len(gone) == 1 else [])
    producer = both[0] if len(both) == 1 else None
    pdos = [
        f"{each.cob_id:03X}h"
        for each in facts.analysis.pdos
        if each.bus == row.bus and each.response_us is not None
    ]
    text = f"SYNC {row.cob_id:03X}h ended{facts.at(last_ns)} and did not come again in the"
    text += f" {seconds(silent_ns)} up to the end, while"
    text += f" {'node' if len(waiting) == 1 else 'nodes'} {', '.join(map(str, waiting))} stayed"
    text += " OPERATIONAL"
    text += f"; the PDOs that answer it ({', '.join(pdos)}) ended with it." if pdos else "."
    cause = "The SYNC producer stopped or was switched off; the nodes only wait for it."
    if producer is not None:
        why = " (1005h bit 30)" if producer in told else ""
        text += f" Node {producer}{why} fell silent at the same moment."
        cause = (
            f"Node {producer} sent it and is gone: the root is there, not at the nodes that wait"
        )
        cause += " for SYNC."
    elif told:
        cause = f"Node {told[0]}, which is to send it (1005h bit 30), stopped doing so."
    return Finding(
        "sync.stopped",
        "warning",
        row.bus,
        producer if producer is not None else (told[0] if told else None),
        last_ns,
        last_ns + 1,
        text,
        cause,
        "Look at the SYNC producer (1005h bit 30, 1006h; is its program running?), not at the nodes"
        " whose PDOs stay away.",
        [] if row.last_seq is None else [row.last_seq],
        assumed=[]
        if producer is None or producer in told
        else [f"node {producer} sends SYNC: only the common moment says so"],
    )


RULES = (
    Rule(
        "sync.stopped",
        "SYNC ended for good while nodes that wait for it stayed OPERATIONAL.",
        "The last SYNC.",
        (
            "At least 50 SYNCs before, and 5 s and 20 periods without one up to the end.",
            "Not after a stop, PRE-OPERATIONAL or reset of all nodes, nor where 1005h or 1006h is set.",
            "Only where heartbeats or guard answers tell OPERATIONAL afterwards.",
            "Not where the whole bus is silent, a gap follows, or another SYNC goes on.",
            "Not where most nodes are lost at the same moment: that is told of them.",
        ),
        _stopped,
    ),
)
