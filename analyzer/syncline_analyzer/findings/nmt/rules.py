"""Findings on NMT (analysis.md 4): the rules of its parts, causes before what follows from them."""

from syncline_analyzer.findings.nmt import (
    commands,
    guarding,
    guarding_end,
    heartbeat,
    lost,
    outside,
    restarts,
    states,
    twins,
    unheard,
    waited,
)

RULES = (
    *guarding.RULES,
    *guarding_end.RULES,
    *lost.RULES,
    *waited.RULES,
    *twins.RULES,
    *restarts.RULES,
    *commands.RULES,
    *outside.RULES,
    *states.RULES,
    *heartbeat.RULES,
    *unheard.RULES,
)
