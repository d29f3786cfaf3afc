"""Findings on self-tests that a device was told to make and did not pass."""

from collections.abc import Iterator

from syncline_analyzer.findings.config.settings import restart_after, value_words
from syncline_analyzer.findings.device.rules import Key, named, number, told, writes
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.results import Finding, SdoRow
from syncline_schemas.devices import Device

_NEVER = 1 << 63


def _failed(facts: Facts) -> Iterator[Finding]:
    """The first result of each node's self-tests that is not good, and whether one was later."""
    told_of: set[tuple[str, int]] = set()
    for start, key, device in writes(facts):
        result = device.quirks.self_test.get(key)
        place = start.bus, start.node
        if result is None or number(start) != 1 or place in told_of:
            continue
        bad = [row for row in _results(facts, start, result, device) if not _good(device, row)]
        if bad:
            told_of.add(place)
            yield _finding(facts, bad[0], result, device)


def _finding(facts: Facts, row: SdoRow, result: Key, device: Device) -> Finding:
    node = facts.number(row.bus), row.node
    words = value_words(facts, node, *result, number(row))
    passed = " A later self-test was passed." if _passed_later(facts, row, result) else ""
    return told(
        "device.self_test_failed",
        row,
        f"{facts.who(row.bus, row.node)} did not pass its self-test: {named(device, result)} ="
        f" {words}{facts.at(row.start_ns)}.{passed}",
        "The device finds a part of its own sensor faulty, or it was moved during the test.",
        "Repeat the self-test while the machine is at rest; replace the device if it fails again.",
        severe=True,
    )


def _passed_later(facts: Facts, bad: SdoRow, result: Key) -> bool:
    """Whether another self-test of the node was started after a bad result, and passed."""
    return any(
        (start.bus, start.node) == (bad.bus, bad.node)
        and start.seq > bad.seq
        and device.quirks.self_test.get(key) == result
        and any(_good(device, row) for row in _results(facts, start, result, device))
        for start, key, device in writes(facts)
    )


def _good(device: Device, row: SdoRow) -> bool:
    return number(row) == device.quirks.self_test_good


def _results(facts: Facts, start: SdoRow, result: Key, device: Device) -> list[SdoRow]:
    """Results that were read after a self-test was over, before anything ended or may have ended it.

    The next self-test does, a restart, and a gap, which may hide either.
    """
    ready_ns = start.end_ns + device.quirks.self_test_ms * 1_000_000
    until_seq, until_ns = _until(facts, start)
    return [
        row
        for row in _reads(facts, start, result)
        if ready_ns <= row.start_ns < until_ns and row.seq < until_seq
    ]


def _until(facts: Facts, start: SdoRow) -> tuple[int, int]:
    """(`seq`, time) from which on a result need not be that of a self-test."""
    restart = restart_after(facts, (facts.number(start.bus), start.node), start.seq)
    again = (
        row.seq
        for row in facts.analysis.sdo.writes.of_objects(
            lambda of: (
                (of.bus, of.node, of.index, of.sub)
                == (start.bus, start.node, start.index, start.sub)
            )
        )
        if row.seq > start.seq
    )
    gaps = (
        gap.start_ns
        for gap in facts.analysis.capture.gaps
        if gap.bus in (None, start.bus) and gap.end_ns > start.start_ns
    )
    until_seq = min([*again, *([restart[0]] if restart else [])], default=_NEVER)
    return until_seq, min(gaps, default=_NEVER)


def _reads(facts: Facts, after: SdoRow, result: Key) -> list[SdoRow]:
    """Every answer to a read of the result after a transfer."""
    rows = facts.analysis.sdo.of_node(after.bus, after.node)
    return [
        row
        for row in rows.of_objects(lambda of: (of.index, of.sub or 0) == result)
        if row.direction == "upload" and row.result == "ok" and row.seq > after.seq
    ]


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
