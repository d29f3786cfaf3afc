"""Findings on configuration: settings that are lost, do nothing, or do not go together."""

from syncline_analyzer.findings import config_bus, config_pdo, config_storage
from syncline_analyzer.findings.rule import Rule

RULES: tuple[Rule, ...] = (*config_storage.RULES, *config_pdo.RULES, *config_bus.RULES)
