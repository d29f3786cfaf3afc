"""Findings on how errors come: again and again, after a restart, after an SDO write."""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import pairwise

from syncline_analyzer.findings.emcy.hints import explained
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import error_name, seconds
from syncline_analyzer.results import EmcyContextRow, ErrorRow, Finding
from syncline_schemas.emcy_errors import MAX_ALIKE
from syncline_schemas.wording import counted

OFTEN = 4
"""An error that was raised and cleared this often comes and goes."""
RETURN_NS = 60_000_000_000
"""An error that is back this soon after a restart was not cured by it [ns]."""
AFTER_WRITE_MS = 50.0
"""An error this soon after the answer to an SDO write may come of it."""

Kind = tuple[str, int, int, str]
"""(bus, node, code, maker's bytes where the code alone does not tell errors apart)."""


def kinds(facts: Facts) -> dict[Kind, list[ErrorRow]]:
    """Errors by what they are, each in order of `seq`."""
    makers = {row.seq: row.manufacturer_hex for row in facts.analysis.emcy if not row.details}
    found: dict[Kind, list[ErrorRow]] = defaultdict(list)
    numbers: dict[tuple[str, int, int], set[str]] = defaultdict(set)
    for row in facts.analysis.errors:
        numbers[row.bus, row.node, row.code].add(makers.get(row.evidence[0], ""))
    for row in facts.analysis.errors:
        few = len(numbers[row.bus, row.node, row.code]) <= MAX_ALIKE
        maker = makers.get(row.evidence[0], "") if few and not row.code & 0xFF else ""
        found[row.bus, row.node, row.code, maker].append(row)
    return found


def _intermittent(facts: Facts) -> Iterator[Finding]:
    storms = _storms(facts)
    for (bus, node, code, _), rows in sorted(kinds(facts).items()):
        passed = [row for row in rows if row.cleared_ns and row.cleared_ns >= row.raised_ns]
        wild = storms.get((bus, node), ([], []))
        calm = [row for row in passed if not _in_storm(wild, row.raised_ns)]
        if len(calm) < OFTEN:
            continue
        lasted = [(row.cleared_ns or row.raised_ns) - row.raised_ns for row in calm]
        first, last = calm[0], calm[-1]
        end_ns = max(first.raised_ns, last.cleared_ns or last.raised_ns)
        yield Finding(
            "emcy.intermittent",
            "warning",
            bus,
            node,
            first.raised_ns,
            end_ns,
            f"{facts.who(bus, node)}: {error_name(code, first.meaning)} came and went"
            f" {len(calm)} times within {seconds(end_ns - first.raised_ns)}, for"
            f" {seconds(min(lasted))} to {seconds(max(lasted))} each time.",
            "A fault at the edge: loose contact, a limit value that is just reached, or a state of"
            " the machine that comes again and again.",
            f"What does the machine do each time it comes (movement, load, vibration)?"
            f" {explained(facts, bus, node, code)[1]}",
            [seq for row in calm for seq in (row.evidence[0], row.evidence[-1])][:20],
        )


def _storms(facts: Facts) -> dict[tuple[str, int], tuple[list[int], list[int]]]:
    """Starts and ends of the storms of each node, in order of their start."""
    found: dict[tuple[str, int], tuple[list[int], list[int]]] = {}
    for storm in sorted(facts.control.emcy.storms, key=lambda each: each.start_ns):
        starts, ends = found.setdefault((storm.bus, storm.node), ([], []))
        starts.append(storm.start_ns)
        ends.append(storm.end_ns)
    return found


def _in_storm(storms: tuple[list[int], list[int]], t_ns: int) -> bool:
    starts, ends = storms
    place = bisect_right(starts, t_ns) - 1
    return place >= 0 and t_ns <= ends[place]


def _returns(facts: Facts) -> Iterator[Finding]:
    """Errors that a restart ended and that came again soon after it."""
    boots = {boot.seq: boot for boot in facts.control.nmt.boot_ups}
    for (bus, node, code, _), rows in sorted(kinds(facts).items()):
        back = []
        for lost, again in pairwise(rows):
            boot = boots.get(lost.evidence[-1]) if lost.status == "lost at reset" else None
            if boot is not None and 0 <= again.raised_ns - boot.t_ns <= RETURN_NS:
                back.append((boot, lost, again))
        if not back:
            continue
        boot, lost, again = back[0]
        often = f" (and so after {len(back)} restarts in all)" if len(back) > 1 else ""
        yield Finding(
            "emcy.returns_after_reset",
            "warning",
            bus,
            node,
            min(lost.raised_ns, again.raised_ns),
            max(y.raised_ns for _, _, y in back),
            f"{facts.who(bus, node)}: {error_name(code, lost.meaning)} was there before the restart"
            f" at {facts.moment(boot.t_ns)} and came back"
            f" {seconds(again.raised_ns - boot.t_ns)} after it{often}.",
            "The cause is still there; a restart only empties the error list.",
            explained(facts, bus, node, code)[1],
            [seq for b, x, y in back for seq in (x.evidence[0], b.seq, y.evidence[0])][:20],
        )


def _after_write(facts: Facts) -> Iterator[Finding]:
    """Errors that were raised right after an SDO write to the node."""
    raised = {row.evidence[0]: row for row in facts.analysis.errors}
    found: dict[tuple[str, int, int, int, int], list[EmcyContextRow]] = defaultdict(list)
    for row in facts.analysis.emcy_context:
        near = row.write_ms is not None and row.write_ms <= AFTER_WRITE_MS
        if near and row.seq in raised and row.code is not None:
            key = (row.bus, row.node, row.code, row.write_index or 0, row.write_sub or 0)
            found[key].append(row)
    for (_, _, code, _, _), rows in sorted(found.items()):
        yield _after_write_finding(facts, raised[rows[0].seq], code, rows)


def _after_write_finding(
    facts: Facts, error: ErrorRow, code: int, rows: Sequence[EmcyContextRow]
) -> Finding:
    first = rows[0]
    written = first.writes[0].rpartition(", ")[0]
    times = f", {len(rows)} times in all" if len(rows) > 1 else ""
    return Finding(
        "emcy.after_write",
        "info",
        first.bus,
        first.node,
        min(row.t_ns for row in rows),
        max(row.t_ns for row in rows),
        f"{facts.who(first.bus, first.node)} raised {error_name(code, error.meaning)}"
        f" {first.write_ms or 0:.3g} ms after an SDO write to it ({written}){times}.",
        "The value that was written may not be allowed at that moment, or the two only coincide.",
        "Write the same value again while nothing else happens, and see whether the error comes.",
        [seq for row in rows for seq in (row.write_seq or row.seq, row.seq)][:20],
    )


RULES: tuple[Rule, ...] = (
    Rule(
        "emcy.intermittent",
        "The same error of a node comes and goes again and again.",
        "The EMCYs that raise and clear it.",
        (
            f"At least {OFTEN} times raised and cleared by the node itself.",
            "Errors that share an unspecific code are told apart by the maker's bytes.",
            "Not what belongs to a storm.",
        ),
        _intermittent,
    ),
    Rule(
        "emcy.returns_after_reset",
        "An error that a restart ended came back soon after it.",
        "The EMCY before the restart, the boot-up, and the EMCY after it.",
        (f"Only the same error within {counted(RETURN_NS // 10**9, 'second')} of the boot-up.",),
        _returns,
    ),
    Rule(
        "emcy.after_write",
        "A node raised an error right after an SDO write to it.",
        "The SDO write and the EMCY.",
        (
            f"At most {AFTER_WRITE_MS:.0f} ms after the answer to the write.",
            "Only the message that raises the error, no repetition of it.",
        ),
        _after_write,
    ),
)
