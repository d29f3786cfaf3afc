"""Findings on self-tests that a device was told to make and did not pass."""

from collections.abc import Iterator

from syncline_analyzer.findings.config.settings import restart_after, value_words
from syncline_analyzer.findings.device.rules import Key, named, number, told, writes
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.results import Finding, SdoRow
from syncline_schemas.devices import Device


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
    later = any(_good(device, each) for each in _reads(facts, row, result))
    passed = " A later self-test was passed." if later else ""
    return told(
        "device.self_test_failed",
        row,
        f"{facts.who(row.bus, row.node)} did not pass its self-test: {named(device, result)} ="
        f" {words}{facts.at(row.start_ns)}.{passed}",
        "The device finds a part of its own sensor faulty, or it was moved during the test.",
        "Repeat the self-test while the machine is at rest; replace the device if it fails again.",
        severe=True,
    )


def _good(device: Device, row: SdoRow) -> bool:
    return number(row) == device.quirks.self_test_good


def _results(facts: Facts, start: SdoRow, result: Key, device: Device) -> list[SdoRow]:
    """Results that were read after a self-test was over, before the node started anew."""
    restart = restart_after(facts, (facts.number(start.bus), start.node), start.seq)
    ready_ns = start.end_ns + device.quirks.self_test_ms * 1_000_000
    return [
        row
        for row in _reads(facts, start, result)
        if row.start_ns >= ready_ns and (restart is None or row.seq < restart[0])
    ]


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
            "A result that is read without a test in the capture may be that of none.",
            "A test that was passed later is told beside it.",
        ),
        _failed,
    ),
)
