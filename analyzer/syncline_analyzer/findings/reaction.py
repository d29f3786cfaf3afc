"""How long after an error a node may tell how it reacted to it (1029h:1)."""

from syncline_analyzer.folds.nmt.timeline import Timeline

REACTION_NS = 1_000_000_000
"""A node does what 1029h:1 asks for within this time of the error [ns]."""
TOLD_PERIODS = 2
"""Its state is told so many periods of its error control later, at the latest."""


def told_until_ns(timeline: Timeline, t_ns: int) -> int:
    """Until when a fall out of OPERATIONAL may be the reaction to an error at a moment [ns].

    A node that still says OPERATIONAL then has not reacted to it: a later fall has another reason.
    """
    history = timeline.history
    period_ns = max(history.period_ns or 0, history.guard_period_ns or 0)
    return t_ns + REACTION_NS + TOLD_PERIODS * period_ns
