"""Stories: what follows from a finding becomes a link of its chain, and nothing else does."""

from typing import Any

import pytest

from syncline_analyzer.findings import story
from syncline_analyzer.findings.bonds import BONDS, Bond
from syncline_analyzer.findings.story import joined
from syncline_analyzer.results import Finding, Severity

S = 1_000_000_000


def finding(
    rule_id: str,
    start_s: float,
    end_s: float | None = None,
    *,
    node: int | None = 5,
    **changes: Any,
) -> Finding:
    severity: Severity = changes.pop("severity", "warning")
    end_ns = round((start_s if end_s is None else end_s) * S)
    text = f"{rule_id} at {start_s} s."
    plain = Finding(
        rule_id, severity, "can0", node, round(start_s * S), end_ns, text, "", "", [round(start_s)]
    )
    for name, value in changes.items():
        object.__setattr__(plain, name, value)
    return plain


def ids(found: list[Finding]) -> list[tuple[str, list[str]]]:
    return [(root.id, [link.id for link in root.chain]) for root in found]


LOST = "nmt.node_lost"
RESET = "nmt.unexpected_reset"
MISSED = "pdo.missed"


def test_a_consequence_is_told_with_its_cause() -> None:
    told = joined([finding(MISSED, 10.2, 12), finding(LOST, 10, 12)])
    assert ids(told) == [(LOST, [MISSED])]
    assert told[0].chain[0].text == "pdo.missed at 10.2 s."
    assert told[0].chain[0].evidence == [10]


def test_a_chain_of_consequences_hangs_on_its_root_in_order_of_time() -> None:
    emcy = finding("emcy.active", 12.6, 60)
    told = joined([emcy, finding(RESET, 12.2), finding(MISSED, 10.1, 12), finding(LOST, 10, 12)])
    assert ids(told) == [(LOST, [MISSED, RESET, "emcy.active"])]


def test_a_story_is_as_severe_as_its_worst_piece() -> None:
    told = joined([finding(LOST, 10, 12), finding(RESET, 12.1, severity="error")])
    assert [root.severity for root in told] == ["error"]


def test_a_story_names_all_that_was_assumed_in_it_once() -> None:
    told = joined(
        [
            finding(LOST, 10, 12, assumed=["1017h = 500 (eds-default)"]),
            finding(RESET, 12.1, assumed=["1017h = 500 (eds-default)", "100Ch = 0 (eds-default)"]),
        ]
    )
    assert told[0].assumed == ["1017h = 500 (eds-default)", "100Ch = 0 (eds-default)"]


@pytest.mark.parametrize(
    "other",
    [
        finding(MISSED, 10.2, 12, node=6),
        finding(MISSED, 10.2, 12, bus="can1"),
        finding(MISSED, 14, 15),
        finding(MISSED, 5, 6),
        finding(MISSED, 10.2, 40),
    ],
    ids=["another node", "another bus", "later", "before", "far beyond"],
)
def test_what_only_stands_near_stays_a_finding_of_its_own(other: Finding) -> None:
    told = joined([finding(LOST, 10, 12), other])
    assert ids(told) == [(LOST, []), (MISSED, [])]


def test_of_two_causes_the_nearer_one_is_taken() -> None:
    told = joined([finding(LOST, 10, 12), finding(LOST, 12.5, 13), finding(MISSED, 12.6, 13)])
    assert ids(told) == [(LOST, []), (LOST, [MISSED])]


def test_findings_of_the_bus_need_no_node(monkeypatch: pytest.MonkeyPatch) -> None:
    bond = Bond("a.cause", "a.effect", S, same_node=False)
    monkeypatch.setattr(story, "BONDS", (*BONDS, bond))
    told = joined([finding("a.cause", 1, 2, node=None), finding("a.effect", 1.5, node=7)])
    assert ids(told) == [("a.cause", ["a.effect"])]


def test_a_length_error_is_told_from_its_pdo() -> None:
    """roboteq: 8220h is the word of the node; the PDO that it complains of is the root."""
    pdo = finding("emcy.pdo_length", 10, 40)
    error = finding("emcy.active", 10, 40, severity="error")
    (root,) = joined([error, pdo])
    assert (root.id, root.severity) == ("emcy.pdo_length", "error")
    assert ids(joined([error, finding("emcy.pdo_length", 11, 40)])) == [
        ("emcy.active", []),
        ("emcy.pdo_length", []),
    ]
