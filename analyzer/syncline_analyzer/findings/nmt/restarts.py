"""Restarts: those nobody asked for, and resets after which a node does not come back as it should."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from itertools import groupby

from syncline_analyzer.findings.nmt.guarding_story import told_by_guarding
from syncline_analyzer.findings.nmt.lost import (
    BOOT_UP_NS,
    EVIDENCE,
    elsewhere,
    failed_resets,
    names,
    was_bus_off,
)
from syncline_analyzer.findings.nmt.power import power_breaks
from syncline_analyzer.findings.nmt.twins import twins
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import Stretch, seconds, several
from syncline_analyzer.folds.nmt.events import Lost
from syncline_analyzer.folds.nmt.table import BootUp, NodeKey
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.median import median
from syncline_analyzer.results import EmcyRow, Finding, NmtCommandRow
from syncline_schemas.canopen.emcy import code_meaning
from syncline_schemas.canopen.nmt import RESETS, NmtState, command_name
from syncline_schemas.devices import quirks

COMMAND_WINDOW_NS = 10_000_000_000
"""A reset this long before a boot-up explains it (analysis.md 4)."""
LOOP_NS = 60_000_000_000
"""Restarts no further apart than this are one loop [ns]."""
LOOP = 3
"""Restarts that make a loop."""
TOGETHER_NS = 2_000_000_000
"""Nodes that restart no further apart have the cause in common, most likely [ns]."""
COMMANDED = 6
"""Commanded resets in a row that are worth a word."""
WATCHDOG = 0x6010
"""EMCY after a software reset by the watchdog, in CiA 402 and in many other devices."""
PROGRAM_CONTROL = 0x1F51
PROGRAM_ORDERS = (b"\x00", b"\x01", b"\x02")
"""Values of 1F51h that stop, start and reset a program (CiA 302-3): the node boots anew."""
PROGRAM_NS = 60_000_000_000
"""A program may be checked for so long before it boots for the first time [ns]."""
_RESETS = tuple(command_name(specifier) for specifier in sorted(RESETS))
GROUPED = 5
"""More unexpected resets of one node than this are one finding."""
TIMES = 4
"""Times from reset to boot-up that must be known before one of them is called long."""
SLOW_FACTOR = 2.0
SLOW_NS = 1_000_000_000


def _unasked(facts: Facts) -> Iterator[list[tuple[BootUp, Lost | None]]]:
    """The restarts of each node that nothing explains, with the silence before each."""
    told, doubled = told_by_guarding(facts), twins(facts)
    boots = sorted(facts.control.nmt.boot_ups, key=lambda boot: (boot.bus, boot.node, boot.seq))
    for (bus, node), group in groupby(boots, key=lambda boot: (boot.bus, boot.node)):
        key = (facts.number(bus), node)
        silences = {lost.end_seq: lost for lost in facts.control.nmt.timelines[key].restarts}
        found = [
            (boot, silences.get(boot.seq))
            for boot in group
            if not doubled.at(bus, node, boot.t_ns)
            and not _explained(facts, key, boot, silences.get(boot.seq))
            and not any(each.covers(*key, boot.t_ns) for each in power_breaks(facts))
            and not _told(facts, key, silences.get(boot.seq), told)
        ]
        if found:
            yield found


def _told(facts: Facts, key: NodeKey, silence: Lost | None, told: AbstractSet[int]) -> bool:
    """Whether the silence before a restart belongs to a story of guarding or bus-off."""
    return silence is not None and (silence.last_seq in told or was_bus_off(facts, key, silence))


def _explained(facts: Facts, key: NodeKey, boot: BootUp, silence: Lost | None) -> bool:
    """Whether a boot-up is no restart of its own accord, or nobody can tell."""
    timeline = facts.control.nmt.timelines[key]
    return (
        boot.command_seq is not None
        or boot.repeated
        or boot.blind
        or _first_sign(timeline, boot)
        or any(0 <= boot.t_ns - lost.end_ns <= BOOT_UP_NS for lost in timeline.lost)
        or (silence is None and _recent_command(facts, timeline, boot))
        or _reset_by_sdo(facts, key, boot)
        or _program_ordered(facts, timeline, boot)
    )


def _first_sign(timeline: Timeline, boot: BootUp) -> bool:
    """Whether nothing was heard of the node before: switched on, not restarted.

    A command to it is no sign of it.
    """
    if any(earlier.seq < boot.seq for earlier in timeline.boot_ups):
        return False
    return not any(
        interval.state is not NmtState.UNKNOWN and (interval.evidence or 0) < boot.seq
        for interval in timeline.intervals
        if interval.evidence is not None and interval.certainty != "commanded"
    )


def _recent_command(facts: Facts, timeline: Timeline, boot: BootUp) -> bool:
    """Whether a reset was commanded shortly before; a step of the clock in between is no time.

    The silence that the reset itself brings, up to the boot-up that answers it, is none.
    """
    commands = facts.control.nmt.commands
    for at in range(bisect_left(commands, boot.seq, key=lambda row: row.seq) - 1, -1, -1):
        row = commands[at]
        passed = boot.t_ns - row.t_ns + _set_back_ns(facts, boot, row.seq)
        if passed > COMMAND_WINDOW_NS:
            passed -= timeline.quiet.unusual(_answered_ns(timeline, row, boot), boot.t_ns)
        if passed > COMMAND_WINDOW_NS:
            return False
        if row.bus == boot.bus and row.node in (0, boot.node) and row.command.startswith("reset"):
            return True
    return False


def _set_back_ns(facts: Facts, boot: BootUp, since_seq: int) -> int:
    """By how much the stamps stepped back before a boot-up, since an earlier frame [ns]."""
    steps = (each for each in facts.control.clock.steps if each.bus == boot.bus)
    return sum(each.back_ns for each in steps if since_seq < each.seq <= boot.seq)


def _answered_ns(timeline: Timeline, row: NmtCommandRow, boot: BootUp) -> int:
    """When a node had booted after a command, before another boot-up; else that of the command."""
    between = (each.t_ns for each in timeline.boot_ups if row.seq < each.seq < boot.seq)
    return next(between, row.t_ns)


def _reset_by_sdo(facts: Facts, key: NodeKey, boot: BootUp) -> bool:
    """Some devices restart when an object is written (2002h of the JN2100)."""
    writes = quirks(facts.context.shadow.device(*key)).reset_writes
    if not writes:
        return False
    own = facts.analysis.sdo.writes.of_node(boot.bus, boot.node)
    orders = own.of_objects(lambda of: (of.index or 0, of.sub or 0) in writes).records
    lately = boot.t_ns - orders["start_ns"] <= COMMAND_WINDOW_NS
    return bool((lately & (orders["seq"] < boot.seq)).any())


def _program_ordered(facts: Facts, timeline: Timeline, boot: BootUp) -> bool:
    """Whether the node's program was stopped, started or reset (1F51h), as for new firmware."""
    own = facts.analysis.sdo.writes.of_node(boot.bus, boot.node)
    for row in own.of_objects(lambda of: of.index == PROGRAM_CONTROL):
        if row.seq > boot.seq or row.result == "abort" or row.data[:1] not in PROGRAM_ORDERS:
            continue
        first = not any(row.seq < each.seq < boot.seq for each in timeline.boot_ups)
        if boot.t_ns - row.start_ns <= (PROGRAM_NS if first else COMMAND_WINDOW_NS):
            return True
    return False


def _resets(facts: Facts) -> Iterator[Finding]:
    """Single restarts; those in a loop are told by the loop."""
    unasked = list(_unasked(facts))
    boots = [boot for found in unasked for boot, _ in found]
    for found in unasked:
        single = [entry for run in _runs(found) if len(run) < LOOP for entry in run]
        if len(single) > GROUPED:
            yield _many(facts, "nmt.unexpected_reset", single, "")
        else:
            for boot, silence in single:
                yield _unexpected_reset(facts, boot, silence, _together(boots, boot))


def _together(boots: Sequence[BootUp], boot: BootUp) -> tuple[int, ...]:
    """Other nodes that restarted at about the same time."""
    near = (b for b in boots if b.bus == boot.bus and abs(b.t_ns - boot.t_ns) <= TOGETHER_NS)
    return tuple(sorted({b.node for b in near} - {boot.node}))


def _loops(facts: Facts) -> Iterator[Finding]:
    for found in _unasked(facts):
        for run in _runs(found):
            if len(run) >= LOOP:
                yield _many(facts, "nmt.boot_loop", run, " again and again")


def _runs(
    found: Sequence[tuple[BootUp, Lost | None]],
) -> list[list[tuple[BootUp, Lost | None]]]:
    """Restarts in runs without a long pause between two of them."""
    runs: list[list[tuple[BootUp, Lost | None]]] = []
    for entry in found:
        if runs and 0 <= entry[0].t_ns - runs[-1][-1][0].t_ns <= LOOP_NS:
            runs[-1].append(entry)
        else:
            runs.append([entry])
    return runs


def _many(
    facts: Facts, rule: str, entries: Sequence[tuple[BootUp, Lost | None]], how: str
) -> Finding:
    """Several restarts of one node as one finding."""
    boots = [boot for boot, _ in entries]
    first, last = boots[0], boots[-1]
    alone = all(silence is not None and silence.whole_bus for _, silence in entries)
    often = several([facts.moment(boot.t_ns) for boot in boots]).strip()
    watchdog = next((row for boot in boots[:LOOP] if (row := _watchdog_emcy(facts, boot))), None)
    cause = f"Its watchdog resets it (EMCY {watchdog.code:04X}h)." if watchdog else ""
    return Finding(
        rule,
        "warning" if alone else "error",
        first.bus,
        first.node,
        entries[0][1].last_ns if entries[0][1] else first.t_ns,
        last.t_ns,
        f"{facts.who(first.bus, first.node)} restarted{how} without a reset command: {often},"
        f" within {seconds(last.t_ns - first.t_ns)}.{_disguise(first)}",
        cause
        or "Its supply breaks down when it starts to work, its watchdog, or a crash of its"
        " firmware at the same point each time.",
        "Measure the node's supply while it starts; read its error memory (1003h); does it also"
        " restart when it stays in PRE-OPERATIONAL?",
        [boot.seq for boot in boots][:EVIDENCE],
        assumed=_read_as(watchdog),
    )


def _unexpected_reset(
    facts: Facts, boot: BootUp, silence: Lost | None, together: tuple[int, ...]
) -> Finding:
    """The restart with the silence before it, a second boot-up frame, and the node's own word."""
    own = [b for b in facts.control.nmt.boot_ups if (b.bus, b.node) == (boot.bus, boot.node)]
    pair = [b for b in own if b.repeated and 0 < b.t_ns - boot.t_ns < BOOT_UP_NS][:1]
    again = any(not b.repeated and 0 < boot.t_ns - b.t_ns < BOOT_UP_NS for b in own)
    watchdog = _watchdog_emcy(facts, boot)
    timeline = facts.control.nmt.timelines[(facts.number(boot.bus), boot.node)]
    text = f"{facts.who(boot.bus, boot.node)} restarted at {facts.moment(boot.t_ns)} although "
    if _recent_command(facts, timeline, boot):
        text += "it had booted since the last reset that was commanded"
    else:
        text += "no reset was commanded in the 10 s before"
    if silence is not None:
        text += f", after a silence of {seconds(silence.end_ns - silence.last_ns)}"
    text += f" (two boot-up frames, {seconds(pair[0].t_ns - boot.t_ns)} apart)" if pair else ""
    text += f".{_disguise(boot)}"
    alone = silence is not None and silence.whole_bus
    if alone:
        text += " No other node is on the bus and nobody was heard meanwhile: the capture cannot"
        text += " tell whether the node restarted or the whole machine was switched off and on."
    cause = "Short break of its supply, watchdog, or a crash of its firmware."
    check = "Measure the node's supply under load; look at its error memory"
    if together:
        others = names(together)
        text += f" {others[:1].upper()}{others[1:]} restarted at about the same time."
        cause = "A short break of the supply that these nodes have in common."
        check = "Measure the common supply of these nodes under load; look at their error memories"
    if watchdog:
        cause = f"Its watchdog reset it (EMCY {watchdog.code:04X}h)."
        check += (
            " (1003h), the firmware's version (100Ah) and what came on the bus just before: a dip"
        )
        check += " of the supply can hang a program too."
    else:
        check += " (1003h) and for a watchdog EMCY after the boot-up."
    if again and not watchdog:
        cause = "Its supply is not steady when it is switched on, or two devices carry this number"
        cause += " and each sent its own boot-up."
    return Finding(
        "nmt.unexpected_reset",
        "warning" if alone else "error",
        boot.bus,
        boot.node,
        silence.last_ns if silence else boot.t_ns,
        boot.t_ns,
        text,
        cause,
        check,
        [
            *([silence.last_seq] if silence else []),
            boot.seq,
            *(b.seq for b in pair),
            *([watchdog.seq] if watchdog else []),
        ],
        assumed=_read_as(watchdog),
    )


def _disguise(boot: BootUp) -> str:
    """How a boot-up was told that looks like a heartbeat (sheet skbis-lir-canopen.md, trap 1)."""
    if boot.byte == 0:
        return ""
    return (
        f" Its boot-up carries {boot.byte:02X}h like a heartbeat, as this device's does when"
        " 1017h is stored."
    )


def _watchdog_emcy(facts: Facts, boot: BootUp) -> EmcyRow | None:
    """What the node itself says of its restart, within two seconds after it."""
    for row in facts.analysis.emcy:
        same = (row.bus, row.node) == (boot.bus, boot.node)
        raised = row.transition in ("raised", "further")
        soon = 0 <= row.t_ns - boot.t_ns <= 2_000_000_000
        if same and raised and soon and ("watchdog" in row.meaning or _read_as(row)):
            return row
    return None


def _read_as(row: EmcyRow | None) -> list[str]:
    """What is assumed where an EMCY tells of a watchdog by its code alone, not by a device's sheet."""
    if row is None or row.code != WATCHDOG or row.meaning != code_meaning(WATCHDOG):
        return []
    return ["6010h is a software reset by the watchdog, as CiA 402 has it"]


def _no_boot_up(facts: Facts) -> Iterator[Finding]:
    """Nodes that a reset command silenced: for long, or for good."""
    others = elsewhere(facts)
    for key, failed in failed_resets(facts):
        bus, node = facts.context.bus_name(key[0]), key[1]
        command, end_ns, end_seq, back = failed
        if any(each.explains(bus, node, command.t_ns, end_ns) for each in others):
            continue
        whom = "all nodes" if command.node == 0 else "it"
        lasted = seconds(end_ns - command.t_ns)
        silent = (
            f"only {lasted} later it was heard again" if back else f"it was silent for {lasted}"
        )
        until = "" if back else ", up to the end"
        yield Finding(
            "nmt.no_boot_up",
            "error",
            bus,
            node,
            command.t_ns,
            end_ns,
            f"{facts.who(bus, node)} did not come back from the reset at"
            f' {facts.moment(command.t_ns)} ("{command_name(command.specifier)}" to {whom}):'
            f" {silent}{until}.",
            "The node hangs in its start, its stored parameters are damaged, or it came back with"
            " another node id or bit rate that was written before and became active by the reset.",
            "Switch its supply off and on; look for a new node id on the bus; read back the node"
            " id and bit rate objects that were written.",
            [command.seq, *([end_seq] if end_seq is not None else [])],
        )


def _slow_boots(facts: Facts) -> Iterator[Finding]:
    """Single starts that took far longer than the others of the same node."""
    boots = sorted(facts.control.nmt.boot_ups, key=lambda boot: (boot.bus, boot.node, boot.seq))
    for (bus, node), group in groupby(boots, key=lambda boot: (boot.bus, boot.node)):
        timed = [
            (boot.t_ns - boot.command_ns, boot)
            for boot in group
            if boot.command_ns is not None and boot.t_ns - boot.command_ns >= 0
            if boot.t_ns - boot.command_ns <= COMMAND_WINDOW_NS
        ]
        usual = median(passed for passed, _ in timed) if len(timed) >= TIMES else None
        for passed, boot in timed if usual is not None else ():
            if usual is None or passed <= SLOW_FACTOR * usual or passed - usual <= SLOW_NS:
                continue
            yield Finding(
                "nmt.slow_boot",
                "info",
                bus,
                node,
                boot.t_ns - passed,
                boot.t_ns,
                f"{facts.who(bus, node)} took {seconds(passed)} from the reset command to its"
                f" boot-up at {facts.moment(boot.t_ns)}; usually it takes {seconds(round(usual))}.",
                "It checked or wrote its memory, started twice, or its supply came up slowly.",
                "Compare with other starts; a master that waits for less time will not find it.",
                [*([boot.command_seq] if boot.command_seq is not None else []), boot.seq],
            )


_UNASKED = (
    (
        "No reset command, and no write that resets the device, in the 10 s before, unless the node"
        " had booted and told its state since, and fell silent before it booted again."
    ),
    (
        "A write to 1F51h that stops, starts or resets the program is such a write (CiA 302-3); the"
        " first boot-up after it may take 60 s."
    ),
    "The first boot-up of a node that was not heard before is its switching on.",
    "Not where a capture gap or a silence of the whole bus lies just before it.",
    "The second frame of a pair that one start sends is none.",
    (
        "A state byte that may be a device's boot-up is none where the heartbeats before and after it"
        " keep their rhythm."
    ),
)


def _resets_again(facts: Facts) -> Iterator[Finding]:
    """Reset commands that come again and again: whoever sends them is not content."""
    by_target: dict[tuple[str, int], list[NmtCommandRow]] = {}
    for row in facts.control.nmt.commands:
        if row.command in _RESETS:
            by_target.setdefault((row.bus, row.node), []).append(row)
    for (bus, node), rows in sorted(by_target.items()):
        apart = [
            row for row, before in zip(rows, [None, *rows], strict=False) if _later(row, before)
        ]
        for begin, end in Stretch.of([row.t_ns for row in apart], LOOP_NS):
            run = [row for row in apart if begin <= row.t_ns <= end]
            if len(run) >= COMMANDED:
                yield _reset_again(facts, bus, node, run)


def _later(row: NmtCommandRow, before: NmtCommandRow | None) -> bool:
    """Whether a reset is no repetition that belongs to the one before it."""
    return before is None or abs(row.t_ns - before.t_ns) > BOOT_UP_NS


def _reset_again(facts: Facts, bus: str, node: int, run: Sequence[NmtCommandRow]) -> Finding:
    whom = facts.inside(bus, node) if node else "all nodes"
    first, last = run[0], run[-1]
    return Finding(
        "nmt.reset_again",
        "info",
        bus,
        node or None,
        first.t_ns,
        last.t_ns,
        f"The master reset {whom} {len(run)} times within {seconds(last.t_ns - first.t_ns)}, first"
        f" at {facts.moment(first.t_ns)}.",
        "The master starts over again and again: it misses a node that it takes for mandatory, its"
        " configuration of a node fails, or somebody tests.",
        "The master's log; which node does it ask for that does not answer, or refuses a setting?",
        [row.seq for row in run][:EVIDENCE],
    )


RULES = (
    Rule(
        "nmt.reset_again",
        "The master resets a node, or all of them, again and again.",
        "The reset commands.",
        (
            f"At least {COMMANDED} resets, none more than 60 s after the one before.",
            "Resets within a second count as one: a master may send both kinds.",
        ),
        _resets_again,
    ),
    Rule(
        "nmt.unexpected_reset",
        "A node restarted although nobody commanded it.",
        "The boot-up, and the last frame before it.",
        _UNASKED,
        _resets,
    ),
    Rule(
        "nmt.boot_loop",
        "A node restarts again and again without a command.",
        "Its boot-ups.",
        (*_UNASKED, "At least three restarts, none more than 60 s after the one before."),
        _loops,
    ),
    Rule(
        "nmt.no_boot_up",
        "A node was reset and did not come back, or only after a long time.",
        "The reset command, and the first frame after it.",
        (
            "Devices that are silent after a reset by their maker's word have that time.",
            "The node was heard before the command, and others after it.",
            "Any frame of the node after the reset, also an SDO answer, shows that it lives.",
        ),
        _no_boot_up,
    ),
    Rule(
        "nmt.slow_boot",
        "A node took far longer to start than it usually does.",
        "The reset command and the boot-up.",
        ("At least four timed starts of the same node; twice the usual time and one second more.",),
        _slow_boots,
    ),
)
