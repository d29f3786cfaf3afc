"""However much goes wrong, the number of findings stays small, and the rules stay quick."""

import pytest

from syncline_analyzer.findings.bounded import KINDS, PLACES, bounded
from syncline_analyzer.findings.nmt.guarding_story import guarding_stories
from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.results import Finding
from tests.analyzer.control_runs import Row, frame, run
from tests.analyzer.whole_run import beats, whole


def errors(number: int) -> list[Row]:
    """So many different errors of node 5, each cleared 50 ms later."""
    rows: list[Row] = []
    for k in range(number):
        code = (0x3100 + k).to_bytes(2, "little").hex()
        rows.append(frame(2000 + 200 * k, 0x085, f"{code}010000000000"))
        rows.append(frame(2050 + 200 * k, 0x085, "0000000000000000"))
    return rows


@pytest.mark.parametrize("number", [KINDS + 1, KINDS + 2, 300])
def test_many_kinds_of_one_rule_and_node_end_in_one_finding(number: int) -> None:
    rows = sorted([*errors(number), *beats(5, 0, 70_000)], key=lambda row: row[0])
    found = [each for each in whole(rows).findings if each.id == "emcy.active"]
    assert len(found) == KINDS + 1
    rest = [each for each in found if "more kinds of emcy.active" in each.text]
    assert len(rest) == (number > KINDS + 1)
    for each in rest:
        assert each.text.startswith(f"And {number - KINDS} more kinds")
        assert each.node == 5
        assert each.evidence


def told(node: int, t_ns: int, severity: str = "warning") -> Finding:
    text = f"Node {node}."
    return Finding("x.y", severity, "can0", node, t_ns, t_ns, text, "", "", [t_ns])  # type: ignore[arg-type]


def test_the_worst_of_many_places_are_the_ones_that_are_told() -> None:
    result = run(frame(0, 0x705, "05"))
    facts = Facts(result.analysis, result.tables, result.context)
    findings = [told(n % 120, n, "error" if n > 2390 else "warning") for n in range(2400)]
    found = bounded(facts, findings)
    assert len(found) == PLACES + 1
    assert sum(each.severity == "error" for each in found) == 9
    assert found[-1].node is None
    assert bounded(facts, findings[:100]) == findings[:100]


def test_what_rules_share_is_worked_out_once() -> None:
    result = run(frame(0, 0x705, "05"), frame(10, 0x085, "3081110000000000"))
    facts = Facts(result.analysis, result.tables, result.context)
    first, second = guarding_stories(facts), guarding_stories(facts)
    assert len(first) == 1
    assert first[0] is second[0]
