"""Findings on error frames: what the recorder's controller saw of frames that were destroyed."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.bus.errors import ErrorStretch
from syncline_analyzer.results import BusStateRow, Finding
from syncline_schemas.can_errors import NOT_RECORDED
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.wording import counted

MANY = 10
"""Destroyed frames close together that are more than a plug being moved."""
MANY_NO_ACK = 5
MAX_FINDINGS = 10
"""More stretches of one kind on one bus become one finding."""
MAX_EVIDENCE = 20
_MOSTLY = 0.8
"""Share of the destroyed frames that must be repeated at once, and by one identifier."""
_UNUSUAL = 0.5
"""That identifier's share of all frames must be below this."""
_LAYERS = "Measure 60 ohm between CAN_H and CAN_L with the supply off; look at the shield and at"


def _passive(facts: Facts) -> Iterator[Finding]:
    """Stretches in which the recorder's controller was error-passive."""
    for bus in facts.context.buses:
        rows = [r for r in facts.analysis.bus_states if (r.bus, r.state) == (bus, "passive")]
        if rows:
            yield _state_finding(facts, "error.passive", "warning", rows)


def _warning_level(facts: Facts) -> Iterator[Finding]:
    """The warning level alone; where it went on to error-passive or bus-off, that says more."""
    for bus in facts.context.buses:
        rows = [r for r in facts.analysis.bus_states if r.bus == bus]
        states = [None, *(row.state for row in rows), None]
        warned = [
            row
            for row, before, after in zip(rows, states, states[2:], strict=False)
            if row.state == "warning" and not {before, after} & {"passive", "bus-off"}
        ]
        if warned:
            yield _state_finding(facts, "error.warning_level", "info", warned)


def _state_finding(facts: Facts, id: str, severity: str, rows: list[BusStateRow]) -> Finding:
    first, last = rows[0], rows[-1]
    ended = last.end_ns < facts.analysis.capture.end_ns
    often = f" {len(rows)} times" if len(rows) > 1 else ""
    total = sum(row.end_ns - row.start_ns for row in rows)
    until = (
        f"; it lasted {seconds(total)}{' in all' if len(rows) > 1 else ''}"
        if ended
        else "; it did not say that it recovered"
    )
    if not facts.context.timed:
        until = ""
    counters = _counters(rows)
    passive = id == "error.passive"
    what = "error-passive" if passive else "at its warning level"
    many = "more than 127" if passive else "96 or more"
    return Finding(
        id,
        "warning" if severity == "warning" else "info",
        first.bus,
        None,
        first.start_ns,
        last.end_ns if ended else last.start_ns,
        f"The recorder's controller on {first.bus} was{often} {what} ({many} on an error"
        f" counter{counters}){until}.",
        "Many frames on the wire are destroyed: wrong bit rate of a node or of the recorder, a"
        " missing or third terminating resistor, a bad plug, or interference."
        if passive
        else "More frames than usual are destroyed on the wire, for a short time.",
        f"{_LAYERS} the plugs; compare the bit rates; see which kinds of error frames there were.",
        [row.evidence for row in rows if row.evidence is not None][:MAX_EVIDENCE],
    )


def _counters(rows: list[BusStateRow]) -> str:
    """The highest counters that were told."""
    tx = [row.tx_errors for row in rows if row.tx_errors is not None]
    rx = [row.rx_errors for row in rows if row.rx_errors is not None]
    return f": transmit {max(tx)}, receive {max(rx)}" if tx and rx else ""


def _frames(facts: Facts) -> Iterator[Finding]:
    """Bursts of destroyed frames."""
    many = [each for each in facts.control.bus_errors.destroyed if each.count >= MANY]
    for bus in facts.context.buses:
        bursts = [each for each in many if each.bus == bus]
        if not bursts:
            continue
        for group in [bursts] if len(bursts) > MAX_FINDINGS else [[each] for each in bursts]:
            yield _burst(facts, group)


def _burst(facts: Facts, group: list[ErrorStretch]) -> Finding:
    first, last = group[0], group[-1]
    count = sum(each.count for each in group)
    kinds = sum((each.kinds for each in group[1:]), group[0].kinds)
    kind, number = kinds.most_common(1)[0]
    kind_text = f"{'all' if number == count else number} of them: {kind}"
    if kind == NOT_RECORDED and number == count:
        kind_text = "kind not recorded"
    spread = f" in {len(group)} bursts" if len(group) > 1 else ""
    hit = _hit(facts, group)
    lasted = f" within {seconds(last.end_ns - first.start_ns)}" if facts.context.timed else ""
    return Finding(
        "error.frames",
        "warning",
        first.bus,
        hit[1] if hit else None,
        first.start_ns,
        last.end_ns,
        f"{count} error frames on {first.bus}{spread}{lasted}, {kind_text}{hit[0] if hit else ''}.",
        "Something disturbs that node's frames: its stub, plug, transceiver or bit timing, or a"
        " second node that sends the same identifier."
        if hit and hit[1] is not None
        else "Frames are destroyed on the wire: a loose plug, missing termination, interference"
        " from a drive, or a node with a wrong bit rate.",
        f"{_LAYERS} the plugs, first of the node whose frames are hit; what was switched on at"
        " that time?",
        [seq for each in group for seq in each.evidence][:MAX_EVIDENCE],
    )


def _hit(facts: Facts, group: list[ErrorStretch]) -> tuple[str, int | None] | None:
    """Whose frame was destroyed, by what its sender repeats at once: (words, node)."""
    followers = sum((each.followers for each in group[1:]), group[0].followers)
    usual = facts.control.bus_errors.usual[group[0].bus]
    told = sum(followers.values())
    if told < max(MANY, _MOSTLY * sum(each.runs for each in group)):
        return None
    can_id, times = followers.most_common(1)[0]
    share = usual[can_id] / max(sum(usual.values()), 1)
    if times < _MOSTLY * told or share > _UNUSUAL:
        return None
    node = _sender(facts, group[0].bus, can_id)
    whose = f" of {_lower(facts.who(group[0].bus, node))}" if node is not None else ""
    return f"; after {times} of {told} the frame {can_id:03X}h{whose} came at once, repeated", node


def _sender(facts: Facts, bus: str, can_id: int) -> int | None:
    """The node that sends an identifier; None where that is not sure."""
    for row in facts.analysis.pdos:
        if (row.bus, row.cob_id) == (bus, can_id):
            sends = row.pdo is not None and row.pdo.startswith("TPDO") and "guess" not in row.pdo
            return row.node if sends else None
    if SERVICE_OF_ID[can_id] in (Service.SDO_ANSWER, Service.ERROR_CONTROL):
        return can_id & 0x7F
    return None


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _no_ack(facts: Facts) -> Iterator[Finding]:
    """Nobody acknowledged what the recorder sent."""
    for each in facts.control.bus_errors.no_ack:
        if each.count < MANY_NO_ACK:
            continue
        yield Finding(
            "error.no_ack",
            "warning",
            each.bus,
            None,
            each.start_ns,
            each.end_ns,
            f"Nobody acknowledged what the recorder sent on {each.bus}:"
            f" {counted(each.count, 'error frame')} say so.",
            "The recorder is alone on the bus, is not connected, or has another bit rate than the"
            " other nodes.",
            "Check the recorder's plug and bit rate, and whether any other node is switched on; a"
            " recorder that need not send should listen only.",
            each.evidence,
        )


def _overrun(facts: Facts) -> Iterator[Finding]:
    """Frames lost in the recorder, not on the bus."""
    for bus in facts.context.buses:
        rows = [each for each in facts.control.bus_errors.overflow if each.bus == bus]
        if not rows:
            continue
        count = sum(each.count for each in rows)
        yield Finding(
            "error.overrun",
            "warning",
            bus,
            None,
            rows[0].start_ns,
            rows[-1].end_ns,
            f"The receive buffer of the recorder's controller on {bus} overflowed"
            f" {'once' if count == 1 else f'{count} times, first'}{facts.at(rows[0].start_ns)}:"
            f" frames are missing in the capture that were on the bus.",
            "The recording computer did not fetch the frames in time; the machine is not at fault.",
            "Give the recorder a faster computer or adapter, or fewer other tasks; a frame that is"
            " missing at these times proves nothing.",
            [seq for each in rows for seq in each.evidence][:MAX_EVIDENCE],
        )


RULES = (
    Rule(
        "error.passive",
        "The recorder's controller was error-passive: many frames on the wire are destroyed.",
        "The error frames in which the controller says so.",
        ("Only the controller's own word, or its error counters from 128 on.",),
        _passive,
        untimed=True,
    ),
    Rule(
        "error.warning_level",
        "The recorder's controller reached its warning level and no worse state.",
        "The error frames in which the controller says so.",
        ("Only the controller's own word; not where it came from or went to a worse state.",),
        _warning_level,
        untimed=True,
    ),
    Rule(
        "error.frames",
        "Many frames were destroyed on the wire in a short time.",
        "The first 20 error frames.",
        (
            f"Fewer than {MANY} within ten seconds of one another are none.",
            "Lost arbitration and changes of the controller's state are no destroyed frames.",
            (
                "A node is named only where its frame is repeated right after most of them, and its"
                " identifier is bound to it."
            ),
        ),
        _frames,
        untimed=True,
    ),
    Rule(
        "error.no_ack",
        "Nobody acknowledged what the recorder sent.",
        "The first 20 error frames that say so.",
        (f"Fewer than {MANY_NO_ACK} are none: the first node of a bus starts alone.",),
        _no_ack,
        untimed=True,
    ),
    Rule(
        "error.overrun",
        "The recorder lost frames in its controller; they were on the bus.",
        "The error frames that tell of the overflow.",
        ("Only the controller's own word.", "Each overrun counts as a gap for all other rules."),
        _overrun,
        untimed=True,
    ),
)
