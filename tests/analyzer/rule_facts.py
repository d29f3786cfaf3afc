"""Rules applied to tables that a test wrote down, on a bus where the control side saw nothing."""

from collections.abc import Iterable

from syncline_analyzer.context import Context
from syncline_analyzer.findings.rule import Facts, Rule, apply
from syncline_analyzer.folds.control import ControlFold
from syncline_analyzer.results import Analysis, Finding
from syncline_analyzer.shadow import Shadow


def facts_of(analysis: Analysis, buses: tuple[str, ...] = ("can0",)) -> Facts:
    """Facts of these tables."""
    context = Context(list(buses), Shadow(lambda number: buses[number]))
    return Facts(analysis, ControlFold(context).finish(0), context)


def judge(rules: Iterable[Rule], analysis: Analysis) -> list[Finding]:
    """What the rules find in these tables."""
    return apply(rules, facts_of(analysis))
