"""Devices that were exchanged: another serial number answers under the same node id."""

from collections.abc import Iterable

from syncline_analyzer.findings.nmt.twins import twins
from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.folds.bus.lss import LssSetting
from syncline_analyzer.folds.nmt.events import Lost
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.results import SdoRow
from syncline_schemas.named_tuples import NamedTuple

SERIAL = (0x1018, 4)
SERIAL_BYTES = 4
_PROGRAM = range(0x1F50, 0x1F5B)
"""Program download (CiA 302-3): a loader may have another serial number than the program."""
_UNSET = (0, 0xFFFFFFFF)
"""What devices tell that were given no number, or have not read it from their memory yet."""
BOOT_UP_NS = 1_000_000_000
"""A boot-up this soon after a silence belongs to it [ns]."""


class Exchange(NamedTuple):
    """The last read of the old serial number and the first one of the new.

    `given` is when LSS gave a device this number in between.
    """

    before: SdoRow
    after: SdoRow
    given: LssSetting | None = None

    def text(self, facts: Facts) -> str:
        """The sentence that tells it, with what shows it; begins with a blank."""
        old, new, given = self
        how = "the device was exchanged in between"
        if given is not None:
            how = "it is another device, and LSS gave a device this node id"
            how += facts.at(given.answer.t_ns)
        return (
            f" Node {old.node} told {_number(old):X}h as its serial number (1018h:4){facts.at(old.end_ns)}"
            f" and {_number(new):X}h{facts.at(new.end_ns)}: {how}."
        )

    @property
    def evidence(self) -> tuple[int, ...]:
        """The answers that tell the numbers."""
        reads = (self.before, self.after)
        proof = [row.seq if row.end_seq is None else row.end_seq for row in reads]
        if self.given is not None:
            proof[1:1] = [self.given.request.seq, self.given.answer.seq]
        return tuple(proof)


def exchanged_in(facts: Facts, bus: str, node: int, lost: Lost) -> Exchange | None:
    """The exchange of a node's device that can only have been in this silence of it."""
    timeline = facts.control.nmt.timelines[facts.number(bus), node]
    for each in facts.once(_exchanges).get((bus, node), ()):
        begin_ns, end_ns = each.before.end_ns, each.after.start_ns
        within = begin_ns <= lost.last_ns and lost.end_ns <= end_ns
        if within and _only(timeline, lost, begin_ns, end_ns):
            return each
    return None


def _exchanges(facts: Facts) -> dict[tuple[str, int], list[Exchange]]:
    """Every change of a serial number that nothing but another device explains."""
    reads = facts.analysis.sdo.reads.ok.of_object(*SERIAL)
    changes = {key: _changes(reads.of_node(*key)) for key in reads.nodes()}
    return {
        key: [_with_given(facts, each) for each in found if _plain(facts, each)]
        for key, found in changes.items()
    }


def _with_given(facts: Facts, each: Exchange) -> Exchange:
    """The same with the last time that LSS gave a device this number in between."""
    given = [
        setting
        for setting in facts.control.lss.settings
        if setting.request.bus == each.before.bus
        and setting.request.values.get("node_id") == each.before.node
        and not setting.refused
        and each.before.seq < setting.request.seq < each.after.seq
    ]
    return each._replace(given=given[-1]) if given else each


def _changes(rows: Iterable[SdoRow]) -> list[Exchange]:
    """Changes to a number that was not read before, from one that is not read again."""
    found: list[Exchange] = []
    seen: set[int] = set()
    before: SdoRow | None = None
    for row in rows:
        if len(row.data) != SERIAL_BYTES:
            continue
        number = _number(row)
        if before is not None and number != _number(before):
            found = [each for each in found if _number(each.before) != number]
            if number not in seen:
                found.append(Exchange(before, row))
        seen.add(number)
        before = row
    return [each for each in found if not {*_UNSET} & {_number(each.before), _number(each.after)}]


def _plain(facts: Facts, each: Exchange) -> bool:
    """Whether nothing else between both reads explains the new number, and nothing is hidden."""
    bus, node = each.before.bus, each.before.node
    begin_ns, end_ns = each.before.end_ns, each.after.start_ns
    written = facts.analysis.sdo.writes.of_node(bus, node).of_objects(
        lambda of: of.index == SERIAL[0] or of.index in _PROGRAM
    )
    hidden = any(
        gap.bus in (None, bus) and gap.start_ns < end_ns and begin_ns < gap.end_ns
        for gap in facts.analysis.capture.gaps
    )
    loaded = any(begin_ns <= row.end_ns and row.start_ns <= end_ns for row in written)
    return not hidden and not loaded and not twins(facts).at(bus, node, each.after.end_ns)


def _only(timeline: Timeline, silence: Lost, begin_ns: int, end_ns: int) -> bool:
    """Whether a node was away between two moments only in this silence."""
    away = [
        lost
        for lost in (*timeline.lost, *timeline.restarts)
        if begin_ns < lost.end_ns and lost.last_ns < end_ns
    ]
    anew = [
        boot
        for boot in timeline.boot_ups
        if begin_ns < boot.t_ns < end_ns
        and boot.command_seq is None
        and not silence.last_ns < boot.t_ns <= silence.end_ns + BOOT_UP_NS
    ]
    return away == [silence] and not anew


def _number(row: SdoRow) -> int:
    return int.from_bytes(row.data, "little")
