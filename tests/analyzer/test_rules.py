"""Every rule has an id of its own, words for a reader, a fault that triggers it and a near miss."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from syncline_analyzer.findings import RULES
from syncline_analyzer.findings.bonds import BONDS
from syncline_analyzer.findings.rule import Rule

TESTS = Path(__file__).parents[1]
IDS = [rule.id for rule in RULES]


def marked(marker: str) -> Iterator[str]:
    """Ids in `pytest.mark.<marker>(id)` of all tests, read from their source."""
    for path in TESTS.rglob("test_*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr == marker
            ):
                yield from (str(a.value) for a in node.args if isinstance(a, ast.Constant))


def test_every_rule_has_an_id_of_its_own() -> None:
    assert len(IDS) == len(set(IDS))
    assert all(re.fullmatch(r"[a-z]+\.[a-z_]+", rule_id) for rule_id in IDS)


def test_there_are_at_least_forty_rules() -> None:
    assert len(IDS) >= 40


@pytest.mark.parametrize("rule", RULES, ids=IDS)
def test_a_rule_says_what_it_means_in_sentences(rule: Rule) -> None:
    assert rule.meaning.endswith(".")
    assert rule.evidence.endswith(".")
    assert rule.guards
    assert all(guard.endswith(".") for guard in rule.guards)


@pytest.mark.parametrize("marker", ["triggers", "near_miss"])
def test_every_rule_has_a_fault_and_a_near_miss(marker: str) -> None:
    found = set(marked(marker))
    assert set(IDS) - found == set(), f"rules without a test marked {marker}"
    assert found - set(IDS) == set(), f"tests marked {marker} of rules that do not exist"


def test_bonds_join_rules_that_exist_and_run_in_no_circle() -> None:
    effects: dict[str, set[str]] = {}
    for bond in BONDS:
        assert {bond.cause, bond.effect} <= set(IDS), bond
        effects.setdefault(bond.cause, set()).add(bond.effect)

    def reach(rule_id: str, seen: frozenset[str]) -> None:
        assert rule_id not in seen, f"circle through {rule_id}"
        for effect in effects.get(rule_id, ()):
            reach(effect, seen | {rule_id})

    for cause in effects:
        reach(cause, frozenset())
