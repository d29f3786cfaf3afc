"""Findings on self-tests that a device was told to make and did not pass."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence

from syncline_analyzer.findings.config.settings import restart_after, value_words
from syncline_analyzer.findings.device.rules import Key, named, number, told, writes
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.results import Finding, SdoRow
from syncline_schemas.devices import Device
from syncline_schemas.named_tuples import NamedTuple

_NEVER = 1 << 63


class _Start(NamedTuple):
    """A write that started a self-test, and the object of its result."""

    row: SdoRow
    device: Device
    result: Key


def _failed(facts: Facts) -> Iterator[Finding]:
    """The first result of each node's self-tests that is not good, and whether one was later."""
    for starts in _starts(facts).values():
        good = starts[0].device.quirks.self_test_good
        results = _results(facts, starts)
        rows = [(at, row) for at, found in enumerate(results) for row in found]
        bad = next(((at, row) for at, row in rows if number(row) != good), None)
        if bad is not None:
            later = any(at > bad[0] and number(row) == good for at, row in rows)
            yield _finding(facts, bad[1], starts[0], later=later)


def _finding(facts: Facts, row: SdoRow, start: _Start, *, later: bool) -> Finding:
    node, device = (facts.number(row.bus), row.node), start.device
    words = value_words(facts, node, *start.result, number(row))
    passed = " A later self-test was passed." if later else ""
    return told(
        "device.self_test_failed",
        row,
        f"{facts.who(row.bus, row.node)} did not pass its self-test: {named(device, start.result)} ="
        f" {words}{facts.at(row.start_ns)}.{passed}",
        "The device finds a part of its own sensor faulty, or it was moved during the test.",
        "Repeat the self-test while the machine is at rest; replace the device if it fails again.",
        severe=True,
    )


def _starts(facts: Facts) -> dict[tuple[str, int, Key], list[_Start]]:
    """Self-tests by (bus, node, object of the result), in order."""
    found: dict[tuple[str, int, Key], list[_Start]] = {}
    for row, key, device in writes(facts):
        result = device.quirks.self_test.get(key)
        if result is not None and number(row) == 1:
            found.setdefault((row.bus, row.node, result), []).append(_Start(row, device, result))
    return found


def _results(facts: Facts, starts: Sequence[_Start]) -> list[list[SdoRow]]:
    """By self-test of a node the results that were read after it was over, before the next one."""
    reads = _reads(facts, starts[0])
    seqs = [row.seq for row in reads]
    edges = [*(bisect_left(seqs, start.row.seq) for start in starts), len(seqs)]
    return [_own(facts, start, reads[edges[at] : edges[at + 1]]) for at, start in enumerate(starts)]


def _own(facts: Facts, start: _Start, reads: Sequence[SdoRow]) -> list[SdoRow]:
    """Reads that tell of a test: not after a restart, nor after a gap, which may hide one."""
    bus, row = facts.number(start.row.bus), start.row
    restart = restart_after(facts, (bus, row.node), row.seq) if reads else None
    ready_ns = row.end_ns + start.device.quirks.self_test_ms * 1_000_000
    until_seq = restart[0] if restart else _NEVER
    gaps = (gap for gap in facts.analysis.capture.gaps if gap.bus in (None, row.bus))
    until_ns = min((gap.start_ns for gap in gaps if gap.end_ns > row.start_ns), default=_NEVER)
    return [read for read in reads if ready_ns <= read.start_ns < until_ns and read.seq < until_seq]


def _reads(facts: Facts, start: _Start) -> list[SdoRow]:
    """Every answer to a read of the result."""
    rows = facts.analysis.sdo.of_node(start.row.bus, start.row.node).of_object(*start.result)
    return [row for row in rows.ok if row.direction == "upload"]


RULES: tuple[Rule, ...] = (
    Rule(
        "device.self_test_failed",
        "A device was told to test itself, and a part of it did not pass.",
        "The answer with the result.",
        (
            "Only results that were read after a self-test was started, and after it was over.",
            "One after the next self-test began, after a restart or after a gap is not that test's.",
            "A result that is read without a test in the capture may be that of none.",
            "A test that was passed later is told beside it.",
        ),
        _failed,
    ),
)
