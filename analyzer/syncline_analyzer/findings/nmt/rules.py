"""Findings on NMT (analysis.md 4): the rules of its parts, causes before what follows from them."""

from syncline_analyzer.findings.nmt import (
    guarding,
    heartbeat,
    lost,
    restarts,
    states,
    twins,
    unheard,
)

RULES = (
    *guarding.RULES,
    *lost.RULES,
    *twins.RULES,
    *restarts.RULES,
    *states.RULES,
    *heartbeat.RULES,
    *unheard.RULES,
)
