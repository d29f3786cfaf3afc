"""Findings on EMCY messages as such: their form, register, codes and moments."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

from syncline_analyzer.findings.emcy.hints import MANUAL
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import LISTED, error_name, seconds
from syncline_analyzer.folds.emcy.rates import TooSoon
from syncline_analyzer.folds.emcy.rpdo import LENGTH_CODES, Suspect
from syncline_analyzer.results import EmcyRow, Finding, NmtStateRow
from syncline_schemas.canopen.emcy import UNKNOWN, short_message
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.devices import Device, quirks
from syncline_schemas.wording import counted

IN_FLIGHT_NS = 10_000_000
"""An EMCY this soon after a change of state was on its way already [ns] (analysis.md 4)."""
UNTIL_HEARD_NS = 2_000_000_000
"""A state that is told only now and then holds for sure where it goes on this long [ns]."""
LONGER = 0x8220
EMPTY = short_message(b"")
"""Words for an EMCY without any byte."""
_LENGTH = frozenset(int.from_bytes(code, "little") for code in LENGTH_CODES)


def _by_node(rows: Iterable[EmcyRow]) -> Iterator[tuple[str, int, list[EmcyRow]]]:
    """Messages of each node, in order of `seq`."""
    ordered = sorted(rows, key=lambda row: (row.bus, row.node, row.seq))
    for (bus, node), group in groupby(ordered, key=lambda row: (row.bus, row.node)):
        yield bus, node, list(group)


def _span(rows: Sequence[EmcyRow] | Sequence[TooSoon]) -> tuple[int, int]:
    """First and last time of messages [ns], whatever the clock did."""
    times = [row.t_ns for row in rows]
    return min(times), max(times)


def _device(facts: Facts, bus: str, node: int) -> Device | None:
    return facts.context.shadow.device(facts.number(bus), node)


def _too_soon(facts: Facts) -> Iterator[Finding]:
    rows = sorted(facts.control.emcy.too_soon, key=lambda row: (row.bus, row.node, row.seq))
    for (bus, node), group in groupby(rows, key=lambda row: (row.bus, row.node)):
        found = list(group)
        first = found[0]
        yield Finding(
            "emcy.inhibit_time",
            "info",
            bus,
            node,
            *_span(found),
            f"{facts.who(bus, node)} sent {counted(len(found), 'EMCY')} sooner than its inhibit"
            f" time 1015h allows; the first{facts.at(first.t_ns)} came"
            f" {seconds(round(first.passed_us * 1000))} after the one before instead of"
            f" {seconds(round(first.inhibit_us * 1000))} ({first.source}).",
            "1015h is not in effect yet (some devices take it only after a reset), or the recorder's"
            " stamps are not exact.",
            "Read 1015h back.",
            [row.seq for row in found[:20]],
        )


def _malformed(facts: Facts) -> Iterator[Finding]:
    """EMCYs that are too short to tell an error (CiA 301 7.2.7.3: eight bytes)."""
    rows = [row for row in facts.analysis.emcy if row.transition == "malformed"]
    for bus, node, found in _by_node(row for row in rows if row.meaning == EMPTY):
        yield _empty(facts, bus, node, found)
    for bus, node, found in _by_node(row for row in rows if row.meaning != EMPTY):
        one = len(found) == 1
        yield Finding(
            "emcy.malformed",
            "warning",
            bus,
            node,
            *_span(found),
            f"{counted(len(found), 'frame')} on the EMCY identifier of {facts.inside(bus, node)}"
            f" {'does' if one else 'do'} not have eight bytes"
            f" ({'it' if one else 'the first'}{facts.at(found[0].t_ns)} is an"
            f" {found[0].meaning}): no error is concluded from {'it' if one else 'them'}.",
            "The device does not keep to CiA 301, or another device sends something else on the"
            " identifier.",
            "Look at the frames; read 1014h of the node, and 1005h and 180xh:1 of all nodes.",
            [row.seq for row in found[:20]],
        )


def _empty(facts: Facts, bus: str, node: int, rows: Sequence[EmcyRow]) -> Finding:
    """Empty EMCYs: how devices announced their boot-up before CiA 301 V4 (DS-301 V3)."""
    listed = ", ".join(facts.moment(row.t_ns) for row in rows[:LISTED])
    listed += ", ..." if len(rows) > LISTED else ""
    when = f" at {listed}" if facts.context.timed else ""
    often = "an empty EMCY" if len(rows) == 1 else f"{len(rows)} empty EMCYs"
    return Finding(
        "emcy.malformed",
        "info",
        bus,
        node,
        *_span(rows),
        f"{facts.who(bus, node)} sent {often}{when} (0 instead of 8 bytes): most likely it started.",
        "Devices made after CiA DS-301 V3 announce their boot-up with an empty EMCY instead of"
        " 700h + node id; it tells of no error.",
        "Was the node reset or switched on then? If not, look at its supply.",
        [row.seq for row in rows[:20]],
    )


def _without_register(facts: Facts) -> Iterator[Finding]:
    """Errors that do not show in the error register, where the device's table wants them there."""
    odd = (
        row
        for row in facts.analysis.emcy
        if row.error_register == 0
        and (row.code or 0) >> 8
        and not _shown_in_words(_device(facts, row.bus, row.node), row.code or 0)
    )
    for bus, node, rows in _by_node(odd):
        first = rows[0]
        yield Finding(
            "emcy.register_mismatch",
            "info",
            bus,
            node,
            *_span(rows),
            f"{facts.who(bus, node)} reports"
            f" {error_name(first.code or 0, first.meaning)}{facts.at(first.t_ns)} with an error"
            f" register of 00h{f', and so in {len(rows)} EMCYs' if len(rows) > 1 else ''}:"
            " its 1001h does not show its errors.",
            "The device does not set bit 0 of 1001h with every error, as CiA 301 7.5.2.2 asks.",
            "Judge this node by its EMCYs and 1003h, not by 1001h.",
            [row.seq for row in rows[:20]],
        )


def _shown_in_words(device: Device | None, code: int) -> bool:
    """Whether a device's table has the code in its alarm words and in no bit of the register."""
    if device is None:
        return False
    register = any(code in codes for codes in device.emcy_registers.values())
    return not register and any(code in part.codes.values() for part in device.emcy_fields)


def _unknown_code(facts: Facts) -> Iterator[Finding]:
    unknown = (row for row in facts.analysis.emcy if row.meaning == UNKNOWN)
    for bus, node, rows in _by_node(unknown):
        codes = [f"{code:04X}h" for code in dict.fromkeys(row.code or 0 for row in rows)]
        listed = ", ".join(codes[:10]) + (", ..." if len(codes) > 10 else "")
        device = _device(facts, bus, node)
        table = f" nor the table of {device.title or device.name}" if device else ""
        yield Finding(
            "emcy.unknown_code",
            "info",
            bus,
            node,
            *_span(rows),
            f"{facts.who(bus, node)} sent {counted(len(rows), 'EMCY')} with"
            f" {counted(len(codes), 'code')} ({listed}) that {'neither ' if device else ''}CiA"
            f" 301{table} {'explains' if device else 'does not explain'}; the first came"
            f"{facts.at(rows[0].t_ns) or ' in frame ' + str(rows[0].seq)}.",
            "A code of the maker's own.",
            f"{MANUAL} A device description with this code gives it words here.",
            [row.seq for row in rows[:20]],
        )


def _while_stopped(facts: Facts) -> Iterator[Finding]:
    """EMCYs of a node that is Stopped and must not send any (CiA 301 7.3.2.2.4)."""
    stopped: dict[tuple[str, int], list[NmtStateRow]] = {
        (row.bus, row.node): []
        for row in facts.analysis.emcy_context
        if row.state == NmtState.STOPPED and row.certainty == "observed"
    }
    for state in facts.analysis.nmt_states:
        if (state.bus, state.node) in stopped and state.state == NmtState.STOPPED:
            stopped[state.bus, state.node].append(state)
    rows = (
        row
        for row in facts.analysis.emcy
        if row.code is not None
        and row.transition != "malformed"
        and _surely_in(stopped.get((row.bus, row.node), ()), row)
        and "emcy" in quirks(_device(facts, row.bus, row.node)).mute_in_stopped
    )
    for bus, node, found in _by_node(rows):
        yield Finding(
            "emcy.while_stopped",
            "info",
            bus,
            node,
            *_span(found),
            f"{facts.who(bus, node)} sent {counted(len(found), 'EMCY')} while it was STOPPED, which"
            f" CiA 301 does not allow (the first{facts.at(found[0].t_ns)}:"
            f" {error_name(found[0].code or 0, found[0].meaning)}).",
            "The device does not keep to CiA 301, or another node sends on this identifier.",
            "Compare node ids and 1014h (COB-ID of the EMCY) of all nodes.",
            [row.seq for row in found[:20]],
        )


def _surely_in(states: Sequence[NmtStateRow], row: EmcyRow) -> bool:
    """Whether a node said that it was in one of these intervals, before the message and after."""
    return any(
        state.certainty == "observed"
        and state.start_ns + IN_FLIGHT_NS < row.t_ns < state.end_ns - UNTIL_HEARD_NS
        for state in states
    )


def _pdo_length(facts: Facts) -> Iterator[Finding]:
    """8210h and 8220h: the RPDO that came just before, and how long it should be."""
    rows = (
        row
        for row in facts.analysis.emcy
        if row.code in _LENGTH and row.transition in ("raised", "further")
    )
    suspects = facts.control.emcy.suspects
    for bus, node, found in _by_node(rows):
        by_id: dict[int, list[Suspect]] = defaultdict(list)
        for row in found:
            if row.seq in suspects:
                by_id[suspects[row.seq].can_id].append(suspects[row.seq])
        yield _pdo_length_finding(facts, bus, node, found, by_id)


def _pdo_length_finding(
    facts: Facts, bus: str, node: int, rows: Sequence[EmcyRow], by_id: dict[int, list[Suspect]]
) -> Finding:
    first = rows[0]
    often = f" in {len(rows)} messages" if len(rows) > 1 else ""
    first_at = facts.at(first.t_ns)
    often += f", first{first_at}" if often and first_at else first_at
    complains = (
        f"{facts.who(bus, node)} complains of {error_name(first.code or 0, first.meaning)}{often}"
    )
    seen = [suspects[0] for suspects in by_id.values() if suspects[0].number]
    others = sorted((each for each in by_id.values() if not each[0].number), key=len)
    if seen:
        text = f"{complains}; just before came {' and '.join(_suspect(facts, s) for s in seen)}."
        cause = "The sender of this PDO and the node's mapping do not agree on its length."
    elif others:
        text = f"{complains}; the last PDO before it was {_whose(others[-1])}."
        cause = (
            f"An RPDO of the node most likely receives {others[-1][0].can_id:03X}h and is mapped to"
            f" {'fewer' if first.code == LONGER else 'more'} bytes; no setting in the capture tells"
            " which RPDO it is."
        )
    else:
        text = f"{complains}; no PDO of another node came just before."
        cause = "An RPDO of the node receives an identifier that carries another length."
    return Finding(
        "emcy.pdo_length",
        "warning",
        bus,
        node,
        *_span(rows),
        text,
        cause,
        "Read 140xh:1 and 160xh of the node and compare with the length of the frames; at the"
        " sender 1A0xh.",
        [s.seq for s in seen] + [row.seq for row in rows[:20]],
        assumed=[
            f"RPDO{s.number} of node {node} is {s.can_id:03X}h (predefined)"
            for s in seen
            if s.guess
        ],
    )


def _suspect(facts: Facts, suspect: Suspect) -> str:
    mapped = f", its mapping takes {suspect.mapped}" if suspect.mapped is not None else ""
    passed = f" {seconds(suspect.before_ns)} earlier" if facts.context.timed else ""
    return (
        f"RPDO{suspect.number} ({suspect.can_id:03X}h) with"
        f" {counted(suspect.dlc, 'byte')}{mapped}{passed}"
    )


def _whose(suspects: Sequence[Suspect]) -> str:
    """A PDO that came last before several EMCYs, whoever sent it."""
    often = f" ({len(suspects)} times)" if len(suspects) > 1 else ""
    return f"{suspects[0].can_id:03X}h with {counted(suspects[0].dlc, 'byte')}{often}"


RULES: tuple[Rule, ...] = (
    Rule(
        "emcy.inhibit_time",
        "EMCYs follow one another sooner than 1015h allows.",
        "The EMCYs that came too soon.",
        ("Only where 1015h was seen on the bus or described; what an EDS says is not enough.",),
        _too_soon,
    ),
    Rule(
        "emcy.malformed",
        "Frames on an EMCY identifier do not have eight bytes; an empty one is most likely a boot-up.",
        "These frames.",
        (
            "No error is concluded from them.",
            "Empty ones are a note: devices made after DS-301 V3 announce their boot-up so.",
            "Not for a SYNC or a PDO that lies on the identifier.",
        ),
        _malformed,
        untimed=True,
    ),
    Rule(
        "emcy.register_mismatch",
        "Error code and error register 1001h of a node do not agree.",
        "The EMCYs with a code and register 0.",
        ("Not where the device's own table shows the error in its alarm or warning word.",),
        _without_register,
        untimed=True,
    ),
    Rule(
        "emcy.unknown_code",
        "A node sends error codes that neither CiA 301 nor its description explains.",
        "The EMCYs with these codes.",
        ("Codes of a known group are named by their group.",),
        _unknown_code,
        untimed=True,
    ),
    Rule(
        "emcy.while_stopped",
        "A node sends EMCYs while it is Stopped.",
        "These EMCYs; the node's own messages say STOPPED before and after.",
        (
            "Only where the node itself says that it is Stopped, and for long enough.",
            "Not for devices whose sheet allows it.",
        ),
        _while_stopped,
    ),
    Rule(
        "emcy.pdo_length",
        "A node reports a PDO of the wrong length; the RPDO that came just before is named.",
        "The RPDO frame and the EMCY 8210h or 8220h.",
        (
            "An identifier that only the predefined connection set gives is said to be assumed.",
            "What the node sends itself is none of its RPDOs.",
        ),
        _pdo_length,
        untimed=True,
    ),
)
