"""Findings on the errors of nodes: active, partly cleared, from before the capture, in storms."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import reduce
from operator import or_
from typing import Any

from syncline_analyzer.findings.bus.bus_off import tells_bus_off
from syncline_analyzer.findings.emcy import history as emcy_history
from syncline_analyzer.findings.emcy import messages as emcy_messages
from syncline_analyzer.findings.emcy import pattern as emcy_pattern
from syncline_analyzer.findings.emcy.hints import explained
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import error_name, seconds
from syncline_analyzer.folds.emcy.rates import Storm
from syncline_analyzer.results import EmcyContextRow, EmcyRow, ErrorRow, Finding, Severity
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.devices import emcy_meaning
from syncline_schemas.named_tuples import NamedTuple

LIFE_GUARD = 0x8130
"""Told as the story of the master's silence, by the NMT findings."""
SETTLED_NS = 2_000_000_000
"""A node that was heard at work this long did not send its first EMCY because it started [ns]."""


def _active(facts: Facts) -> Iterator[Finding]:
    """Errors by what they are; those still active at the end are apart from those that are over."""
    contexts = {row.seq: row for row in facts.analysis.emcy_context}
    details = {row.seq: row.details for row in facts.analysis.emcy if row.code and row.details}
    for (_, _, _, maker), rows in sorted(emcy_pattern.kinds(facts).items()):
        for still in (False, True):
            found = [row for row in rows if (row.status == "still active") == still]
            if not found or _told_elsewhere(facts, found[0]):
                continue
            text = _reports(facts, found, maker, _bits(facts, found, details))
            told = _still_active(facts, found, text) if still else _over(facts, found, text)
            yield _error_finding(facts, found, told, contexts.get(found[0].evidence[0]))


def _told_elsewhere(facts: Facts, row: ErrorRow) -> bool:
    own_story = row.code == LIFE_GUARD or tells_bus_off(row.code, row.meaning)
    return facts.context.timed and own_story


class _Told(NamedTuple):
    """How bad it is, until when, and the sentence that says so."""

    severity: Severity
    end_ns: int
    text: str


def _still_active(facts: Facts, rows: Sequence[ErrorRow], text: str) -> _Told:
    end_ns = facts.control.nmt.end_ns
    if blind_ns := _blind_after(facts, rows[-1]):
        text += (
            f"; no clear was seen, but the recorder was blind for {seconds(blind_ns)} after it,"
            " so it may be over."
        )
        return _Told("warning", end_ns, text)
    if not any(row.certain for row in rows):
        text += "; it may be over: the node told later that one of several errors is gone, and not which."
        return _Told("warning", end_ns, text)
    if _fell_silent(facts, rows[0]):
        return _Told("error", end_ns, f"{text}; it was not cleared before the node fell silent.")
    if deaf_ns := _silent_after(facts, rows[-1]):
        text += (
            f"; no clear was seen, but nothing at all was heard on the bus for {seconds(deaf_ns)}"
            " after it, so it may be over."
        )
        return _Told("warning", end_ns, text)
    return _Told("error", end_ns, f"{text}; it is still active at the end of the capture.")


def _fell_silent(facts: Facts, row: ErrorRow) -> bool:
    """Whether the node is lost at the end of the capture, or its device has another number then."""
    if any((each.bus, each.old) == (row.bus, row.node) for each in facts.control.renumbered):
        return True
    states = facts.analysis.nmt_states
    own = [s.state for s in states if (s.bus, s.node) == (row.bus, row.node)]
    return bool(own) and own[-1] == NmtState.LOST


def _over(facts: Facts, rows: Sequence[ErrorRow], text: str) -> _Told:
    timed = facts.context.timed
    ends = [_end_ns(facts, row) for row in rows]
    passed = [(row.cleared_ns or row.raised_ns) - row.raised_ns for row in rows]
    timed = timed and min(passed) >= 0
    lasted = sum(passed)
    lost = sum(row.status == "lost at reset" for row in rows)
    if lost == len(rows):
        often = f"it came {lost} times, each time " if lost > 1 else ""
        text += f"; {often}ended by a restart of the node, not cleared."
    else:
        often = f"it came {len(rows)} times and was " if len(rows) > 1 else ""
        text += f"; {often}cleared"
        text += f" after {seconds(lasted)}" if timed else ""
        text += " altogether" if timed and often else ""
        read = sum(_cleared_by_read(facts, row) for row in rows)
        which = f"{read} of them" if read < len(rows) else "the node"
        text += (
            f" ({which} said so when its 1001h or 1003h was read, not by an EMCY)" if read else ""
        )
        text += f" ({lost} of them ended by a restart of the node)." if lost else "."
    return _Told("warning", max(*ends, rows[0].raised_ns), text)


def _cleared_by_read(facts: Facts, row: ErrorRow) -> bool:
    """Whether a read showed that an error is over, and no EMCY."""
    return row.status == "cleared" and row.evidence[-1] not in facts.once(_emcy_seqs)


def _emcy_seqs(facts: Facts) -> frozenset[int]:
    return frozenset(row.seq for row in facts.analysis.emcy)


def _end_ns(facts: Facts, row: ErrorRow) -> int:
    """When an error was cleared, or when the boot-up came that ended it."""
    if row.cleared_ns is not None:
        return row.cleared_ns
    resets = (m for m in facts.analysis.emcy if m.seq == row.evidence[-1])
    return next((reset.t_ns for reset in resets), row.raised_ns)


def _bits(facts: Facts, rows: Sequence[ErrorRow], details: Mapping[int, Mapping[str, Any]]) -> str:
    """Names of the bits with which a device tells an error more closely: its own word for it."""
    device = facts.context.shadow.device(facts.number(rows[0].bus), rows[0].node)
    for field in device.emcy_fields if device else ():
        if rows[0].code not in field.codes.values() or len(field.bits) < 2:
            continue
        values = (details.get(seq, {}).get(field.name, 0) for row in rows for seq in row.evidence)
        seen = reduce(or_, (value for value in values if isinstance(value, int)), 0)
        names = [f'"{name}"' for bit, name in sorted(field.bits.items()) if seen >> bit & 1]
        if names:
            return f" with {field.name} {' and '.join(names)}"
    return ""


def _reports(facts: Facts, rows: Sequence[ErrorRow], maker: str, bits: str) -> str:
    first, count = rows[0], sum(row.count for row in rows)
    name = error_name(first.code, first.meaning)
    text = f"{facts.who(first.bus, first.node)} reports {name}{bits}"
    text += f" with the maker's bytes {maker}" if maker.strip("0") else ""
    text += f" in {count} messages" if count > len(rows) else ""
    when = facts.at(first.raised_ns)
    return f"{text}, first{when}" if when and count > 1 else text + when


def _error_finding(
    facts: Facts, rows: Sequence[ErrorRow], told: _Told, context: EmcyContextRow | None
) -> Finding:
    first = rows[0]
    cause, check_next = explained(facts, first.bus, first.node, first.code)
    return Finding(
        "emcy.active",
        told.severity,
        first.bus,
        first.node,
        first.raised_ns,
        told.end_ns,
        told.text,
        f"{cause}{_around(context)}",
        check_next,
        [seq for row in rows for seq in row.evidence][:20],
        assumed=_assumed(context),
    )


def _assumed(context: EmcyContextRow | None) -> list[str]:
    """Settings that the values around an error rest on and that were only assumed."""
    values = list(context.values.values())[:3] if context is not None else []
    return [
        f"scale of {value['name']}: {name}"
        for value in values
        if value["before"] is not None
        for name in value.get("assumed", ())
    ]


def _around(context: EmcyContextRow | None) -> str:
    """What else was known when the error came: states and measured values; begins with a blank."""
    if context is None:
        return ""
    told = []
    if context.state != NmtState.UNKNOWN:
        sure = "" if context.certainty == "observed" else f" ({context.certainty})"
        told.append(f"the node was {context.state}{sure}")
    if context.bus_state not in (None, "active", "unknown"):
        told.append(f"the recorder's controller was {context.bus_state}")
    for value in list(context.values.values())[:3]:
        if value["before"] is not None:
            sure = " (by an assumed scale)" if value.get("assumed") else ""
            was = f"its {value['name']} was {value['before']:.10g} {value['unit']}".rstrip()
            told.append(was + sure)
    listed = ", ".join(told[:-1]) + " and " + told[-1] if len(told) > 1 else "".join(told)
    return f" When it came, {listed}." if told else ""


def _blind_after(facts: Facts, row: ErrorRow) -> int:
    """How long the recorder was blind after the last EMCY of the node [ns]."""
    last_ns = facts.once(_last_emcy).get((row.bus, row.node), row.raised_ns)
    gaps = [gap for gap in facts.analysis.capture.gaps if gap.bus in (None, row.bus)]
    return sum(gap.end_ns - gap.start_ns for gap in gaps if gap.start_ns >= last_ns)


def _silent_after(facts: Facts, row: ErrorRow) -> int:
    """How long the whole bus was silent after it, and went on: the recorder may have been off [ns]."""
    last_ns = facts.once(_last_emcy).get((row.bus, row.node), row.raised_ns)
    return sum(
        silence.end_ns - silence.start_ns
        for silence in facts.analysis.bus_silences
        if silence.bus == row.bus and last_ns <= silence.start_ns and len(silence.evidence) > 1
    )


def _last_emcy(facts: Facts) -> dict[tuple[str, int], int]:
    """When the last EMCY of each node came [ns]."""
    found: dict[tuple[str, int], int] = {}
    for row in facts.analysis.emcy:
        key = (row.bus, row.node)
        found[key] = max(found.get(key, row.t_ns), row.t_ns)
    return found


def _partly_cleared(facts: Facts) -> Iterator[Finding]:
    """Nodes whose last word was "no error" while errors were left."""
    told_before = {row.seq for row in _shown_before(facts) if not _blind_before(facts, row)}
    started = {(boot.bus, boot.node): boot.seq for boot in facts.control.nmt.boot_ups}
    last: dict[tuple[str, int], EmcyRow] = {}
    for row in facts.analysis.emcy:
        if row.transition != "malformed":
            last[row.bus, row.node] = row
    for key, row in sorted(last.items()):
        over = started.get(key, -1) > row.seq
        if row.transition == "partly cleared" and row.seq not in told_before and not over:
            when = f" at {facts.moment(row.t_ns)}" if facts.context.timed else ""
            yield Finding(
                "emcy.partly_cleared",
                "warning",
                row.bus,
                row.node,
                row.t_ns,
                row.t_ns,
                f"{facts.who(row.bus, row.node)} said that an error is gone (EMCY"
                f" {row.code or 0:04X}h{when}), but it is not healthy: {_left(facts, row)} still"
                " there.",
                "The code 0000h only says that one error is gone; the error register and the"
                " maker's bytes of the same message tell of others.",
                "Do not take EMCY 0000h alone as healthy; read 1001h and 1003h of the node.",
                [row.seq],
            )


def _left(facts: Facts, row: EmcyRow) -> str:
    """What a partial clear leaves: the errors that were raised, else the bits; and a verb."""
    device = facts.context.shadow.device(facts.number(row.bus), row.node)
    doubtful = {
        error.code
        for error in facts.analysis.errors
        if (error.bus, error.node) == (row.bus, row.node) and not error.certain
    }
    named = [
        f"{'maybe ' if code in doubtful else ''}{error_name(code, emcy_meaning(device, code))}"
        for code in sorted(row.active, key=lambda code: code in doubtful)
    ]
    bits = [bit for name, value in row.details.items() if name.endswith("_bits") for bit in value]
    left = named or bits or row.registers or [f"register {row.error_register or 0:02X}h"]
    return f"{', '.join(left)} {'is' if len(left) == 1 else 'are'}"


def _storms(facts: Facts) -> Iterator[Finding]:
    for storm in facts.control.emcy.storms:
        yield Finding(
            "emcy.storm",
            "error",
            storm.bus,
            storm.node,
            storm.start_ns,
            storm.end_ns,
            f"{facts.who(storm.bus, storm.node)} sent {storm.number} EMCYs within"
            f" {seconds(storm.end_ns - storm.start_ns)}{facts.at(storm.start_ns)}"
            f"{_codes_of(facts, storm)}.",
            "A fault that comes and goes many times a second: loose contact, or a limit without"
            " hysteresis; no inhibit time (1015h) holds it back.",
            "Find what makes the fault come and go; set 1015h to keep the bus free meanwhile.",
            [storm.first_seq],
        )


def _codes_of(facts: Facts, storm: Storm) -> str:
    """The errors that a storm tells, the most frequent first; begins with a colon."""
    codes = Counter(
        error_name(row.code, row.meaning)
        for row in facts.analysis.emcy
        if (row.bus, row.node) == (storm.bus, storm.node)
        and storm.start_ns <= row.t_ns <= storm.end_ns
        and row.code is not None
        and row.code >> 8
    )
    told = [f"{count} times {name}" for name, count in codes.most_common(3)]
    return f": {', '.join(told)}{', ...' if len(codes) > 3 else ''}" if told else ""


def _before(facts: Facts) -> Iterator[Finding]:
    """Errors that no EMCY of the capture raised: by bits left, by 1001h, by a first clear."""
    told = {entry.seq: entry.codes for entry in facts.control.emcy.before}
    by_bits = _shown_before(facts)
    yield from (_before_by_bits(facts, row, told[row.seq]) for row in by_bits)
    known = {(row.bus, row.node) for row in by_bits}
    if facts.context.timed:
        yield from _cleared_first(facts, known)
        yield from emcy_history.register_before(facts)


def _shown_before(facts: Facts) -> list[EmcyRow]:
    """EMCYs whose bits tell of errors that no EMCY of the capture raised."""
    seqs = {entry.seq for entry in facts.control.emcy.before}
    return [row for row in facts.analysis.emcy if row.seq in seqs]


def _before_by_bits(facts: Facts, row: EmcyRow, codes: Sequence[int]) -> Finding:
    device = facts.context.shadow.device(facts.number(row.bus), row.node)
    named = [error_name(code, emcy_meaning(device, code)) for code in codes]
    left = " or ".join(named[:4]) or ", ".join(row.registers)
    left = left or f"register {row.error_register or 0:02X}h"
    who = facts.who(row.bus, row.node)
    clears = row.transition == "partly cleared"
    text = (
        f"An EMCY of {_lower(who)}{facts.at(row.t_ns)} clears one error and leaves others: {left}."
        if clears
        else f"An EMCY of {_lower(who)}{facts.at(row.t_ns)} also shows the bits of another error: {left}."
    )
    blind = _blind_before(facts, row)
    return Finding(
        "emcy.active_before",
        "info" if blind else "warning",
        row.bus,
        row.node,
        row.t_ns,
        row.t_ns,
        text,
        "No EMCY of the capture raised it: it came before the capture began"
        + (", or while the recorder was blind." if blind else "."),
        "Read 1003h of the node for the codes.",
        [row.seq],
    )


def _lower(who: str) -> str:
    return who[:1].lower() + who[1:]


def _blind_before(facts: Facts, row: EmcyRow) -> bool:
    gaps = facts.analysis.capture.gaps
    return any(gap.bus in (None, row.bus) and gap.start_ns < row.t_ns for gap in gaps)


def _cleared_first(facts: Facts, known: Iterable[tuple[str, int]]) -> Iterator[Finding]:
    """A node at work whose first EMCY is a clear, and no start of it before that explains it."""
    started: dict[tuple[str, int], int] = {}
    for boot in facts.control.nmt.boot_ups:
        started.setdefault((boot.bus, boot.node), boot.seq)
    first: dict[tuple[str, int], EmcyRow] = {}
    clears: dict[tuple[str, int], int] = {}
    for row in facts.analysis.emcy:
        key = (row.bus, row.node)
        first.setdefault(key, row)
        clears[key] = clears.get(key, 0) + (row.transition == "all cleared")
    for key, row in sorted(first.items()):
        plain = key not in known and row.transition == "all cleared" and clears[key] == 1
        if not plain or started.get(key, row.seq) < row.seq or _blind_before(facts, row):
            continue
        if _at_work_ns(facts, row) >= SETTLED_NS:
            yield Finding(
                "emcy.active_before",
                "info",
                row.bus,
                row.node,
                row.t_ns,
                row.t_ns,
                f"{facts.who(*key)} says at {facts.moment(row.t_ns)} that its error is gone; the"
                " capture holds none that it raised.",
                "The error came before the capture began.",
                "Read 1003h of the node for its code.",
                [row.seq],
            )


def _at_work_ns(facts: Facts, row: EmcyRow) -> int:
    """How long the node had been heard in a steady state before a message [ns]."""
    steady = (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL)
    begun = [
        state.start_ns
        for state in facts.analysis.nmt_states
        if (state.bus, state.node) == (row.bus, row.node)
        and state.state in steady
        and state.certainty == "observed"
        and state.start_ns <= row.t_ns
    ]
    return row.t_ns - min(begun) if begun else 0


RULES: tuple[Rule, ...] = (
    Rule(
        "emcy.storm",
        "A node sends more than 10 EMCYs in a second.",
        "The first EMCY of the storm.",
        ("Malformed EMCYs are counted elsewhere.",),
        _storms,
    ),
    Rule(
        "emcy.active",
        "A node reports an error of its own, with its code in words.",
        "The EMCYs that raise, repeat and clear it.",
        (
            "Life-guard and bus-off errors are told as the stories of their causes.",
            "Nothing is concluded from frames shorter than eight bytes.",
            "A later read of 1001h = 0, or of an empty 1003h that nobody emptied, ends an error too.",
            "After a capture gap an error that was not seen cleared is only said to be possible.",
            (
                "Codes 2xxxh to 7xxxh of a device that is not known and whose 1000h names a profile other"
                " than CiA 401, 406 and 410 are given no cause: profiles divide these groups."
            ),
        ),
        _active,
        untimed=True,
    ),
    Rule(
        "emcy.partly_cleared",
        'A node\'s last EMCY says "no error" (00xxh), but bits in it tell of errors that are left.',
        "The EMCY with its register and the maker's bytes.",
        (
            "Not where a later EMCY clears everything, or the node started again.",
            "Bits that no error of the capture explains are errors from before it.",
        ),
        _partly_cleared,
        untimed=True,
    ),
    Rule(
        "emcy.active_before",
        "An error was active before the capture began.",
        "The EMCY that clears or shows an error that none raised, or the read of 1001h.",
        (
            "The bits generic and communication alone tell of no other error.",
            "A first EMCY 0000h of a node that just started is how some devices begin.",
            "After a capture gap only where bits are left, and as a note: the gap may hold its raise.",
        ),
        _before,
        untimed=True,
    ),
    *emcy_pattern.RULES,
    *emcy_messages.RULES,
    *emcy_history.RULES,
)
