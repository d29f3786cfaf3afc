"""What must agree between the tables of an analysis and the truth of its scenario.

Each check gives one sentence for each thing that is wrong; none for an analysis that is right.
"""

from collections.abc import Callable, Iterator

from tests.analyzer.fuzz_case import Case
from tests.analyzer.fuzz_control import (
    capture_counts,
    commands,
    confirmations,
    error_control,
    nodes,
    syncs,
)
from tests.analyzer.fuzz_findings import evidence, findings
from tests.analyzer.fuzz_messages import answer_times, emcys, errors, pdos, responses, sdo
from tests.analyzer.fuzz_objects import objects
from tests.analyzer.fuzz_states import states, timelines

CHECKS: tuple[Callable[[Case], Iterator[str]], ...] = (
    capture_counts,
    commands,
    confirmations,
    nodes,
    error_control,
    emcys,
    errors,
    sdo,
    answer_times,
    responses,
    objects,
    pdos,
    syncs,
    timelines,
    states,
    findings,
    evidence,
)


def wrong(case: Case) -> list[str]:
    """Everything that does not agree, each with the name of its check."""
    return [f"{check.__name__}: {text}" for check in CHECKS for text in check(case)]
