"""Findings on configuration: settings that are lost, do nothing, or do not go together."""

from syncline_analyzer.findings.config import mixed as config_mixed
from syncline_analyzer.findings.config import network as config_bus
from syncline_analyzer.findings.config import pdo as config_pdo
from syncline_analyzer.findings.config import storage as config_storage
from syncline_analyzer.findings.rule import Rule

RULES: tuple[Rule, ...] = (
    *config_storage.RULES,
    *config_pdo.RULES,
    *config_mixed.RULES,
    *config_bus.RULES,
)
