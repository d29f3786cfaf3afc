"""PDOs of nodes that must not send any: those outside OPERATIONAL."""

from collections.abc import Callable, Iterable, Iterator

from syncline_analyzer.findings.nmt.guarding_story import guarding_stories
from syncline_analyzer.findings.nmt.twins import twins
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.folds.nmt.events import Ignored, Violation
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.results import Finding
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.wording import counted

STORY_PDOS_NS = 1_000_000_000
"""PDOs this soon after a node fell out of OPERATIONAL belong to the story of its fall [ns]."""
FIRST_TPDO = 0x180
LONG_OUTSIDE_NS, MANY_OUTSIDE = 5_000_000_000, 20
"""So long, and so often, PDOs go on whose identifier alone says whose they are."""


def _pdo_outside(facts: Facts) -> Iterator[Finding]:
    """PDOs of nodes that are known to be in another state than OPERATIONAL."""
    stories, doubled = guarding_stories(facts), twins(facts)
    for (number, node), timeline in facts.control.nmt.timelines.items():
        bus = facts.context.bus_name(number)
        owned = _owned(timeline, node)
        found = [
            violation
            for violation in timeline.violations
            if owned(violation)
            and not any(during(violation, ignored) for ignored in timeline.ignored)
            and not doubled.at(bus, node, violation.end_ns)
            and not _after_story(stories, bus, node, violation)
        ]
        if not found:
            continue
        first = found[0]
        known = "by command" if first.certainty == "commanded" else "by its own word"
        yield Finding(
            "nmt.pdo_outside_operational",
            "warning",
            bus,
            node,
            first.start_ns,
            max(v.end_ns for v in found),
            f"{facts.who(bus, node)} sent {counted(sum(v.number for v in found), 'PDO')}"
            f" ({identifiers(found)}) while it was {first.state} {known}.",
            "A second device under the same number, a device that does not keep to CiA 301, or a"
            " command that it did not follow.",
            "Switch the node off: do the PDOs stop? Compare with its heartbeat.",
            [v.seq for v in found[:20]],
            assumed=sorted(
                {f"{v.can_id:03X}h is its TPDO1, as predefined" for v in found if v.guess}
            ),
        )


def _owned(timeline: Timeline, node: int) -> Callable[[Violation], bool]:
    """Tells PDOs that are known to be a node's, or likely are, from those that may be another's."""
    likely = _sends_first_tpdo(timeline, node)
    return lambda v: not v.guess or (likely and v.can_id == FIRST_TPDO + node)


def _sends_first_tpdo(timeline: Timeline, node: int) -> bool:
    """Whether PDOs on its predefined identifier are a node's: they began while it was OPERATIONAL.

    They go on for long against its own word; those of another device would have been there before
    the node was started.
    """
    can_id = FIRST_TPDO + node
    same = [v for v in timeline.violations if v.can_id == can_id and v.guess]
    if not same:
        return False
    began = min(s.first_ns for s in timeline.history.spans if s.can_id == can_id and s.count)
    state = next((i for i in timeline.intervals if i.start_ns <= began < i.end_ns), None)
    return (
        state is not None
        and state.state is NmtState.OPERATIONAL
        and state.certainty == "observed"
        and any(v.certainty == "observed" for v in same)
        and sum(v.end_ns - v.start_ns for v in same) >= LONG_OUTSIDE_NS
        and sum(v.number for v in same) >= MANY_OUTSIDE
    )


def _after_story(stories: list[Finding], bus: str, node: int, violation: Violation) -> bool:
    """Whether PDOs still came in a story of lost guarding of their node."""
    return any(
        (story.bus, story.node) == (bus, node)
        and story.start_ns <= violation.start_ns <= story.end_ns + STORY_PDOS_NS
        for story in stories
    )


def during(violation: Violation, ignored: Ignored) -> bool:
    """Whether PDOs show that the node did not follow a command."""
    return violation.start_ns <= ignored.t_ns and violation.end_ns >= ignored.command.t_ns


def identifiers(violations: Iterable[Violation]) -> str:
    return ", ".join(sorted({f"{v.can_id:03X}h" for v in violations}))


RULES = (
    Rule(
        "nmt.pdo_outside_operational",
        "A node sent PDOs in a state in which it must not.",
        "These PDOs.",
        (
            "Frames in flight within 10 ms of the change are none, nor PDOs asked by remote frames.",
            (
                "Only PDOs of which the bus or the description says whose they are; those on its"
                " predefined identifier where they began after it was started and go on for 5 s"
                " against its own word, which is said."
            ),
        ),
        _pdo_outside,
    ),
)
