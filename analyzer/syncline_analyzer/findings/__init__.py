"""Rules over the tables, one module per family; what they return is what the report says."""

from collections.abc import Iterable

from syncline_analyzer.context import Context
from syncline_analyzer.findings.angle import motion
from syncline_analyzer.findings.angle import rules as angle
from syncline_analyzer.findings.bounded import bounded
from syncline_analyzer.findings.bus import bus_off as bus
from syncline_analyzer.findings.bus import capture, clock, errors, lss
from syncline_analyzer.findings.config import rules as config
from syncline_analyzer.findings.device import assignment, described, identity, self_test, stored
from syncline_analyzer.findings.device import rules as device
from syncline_analyzer.findings.emcy import errors as emcy
from syncline_analyzer.findings.nmt import rules as nmt
from syncline_analyzer.findings.rule import Facts, Rule, apply
from syncline_analyzer.findings.sdo import transfers as sdo
from syncline_analyzer.findings.story import joined
from syncline_analyzer.findings.timing import (
    idle,
    load,
    pdo,
    pdo_asked,
    sync_counter,
    sync_end,
    waiting,
    waiting_sdo,
)
from syncline_analyzer.findings.timing import sync as timing
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.results import SEVERITY_RANK, Analysis, Finding

RULES: tuple[Rule, ...] = (
    *bus.RULES,
    *errors.RULES,
    *capture.RULES,
    *clock.RULES,
    *nmt.RULES,
    *emcy.RULES,
    *sdo.RULES,
    *config.RULES,
    *lss.RULES,
    *timing.RULES,
    *sync_end.RULES,
    *sync_counter.RULES,
    *pdo.RULES,
    *pdo_asked.RULES,
    *waiting.RULES,
    *waiting_sdo.RULES,
    *load.RULES,
    *angle.RULES,
    *motion.RULES,
    *device.RULES,
    *stored.RULES,
    *self_test.RULES,
    *identity.RULES,
    *assignment.RULES,
    *described.RULES,
    *idle.RULES,
)
"""Every rule, by family."""
_OF_ANY_BUS = ("bus", "error", "capture", "clock")
"""Families that judge a bus of any protocol."""


def find_all(analysis: Analysis, control: ControlTables, context: Context) -> list[Finding]:
    """Findings of all rules as stories: errors first, then by the time they began."""
    facts = Facts(analysis, control, context)
    found = joined(bounded(facts, _of_canopen(facts, apply(RULES, facts))))
    return sorted(found, key=lambda f: (SEVERITY_RANK[f.severity], f.start_ns, f.id, f.node or 0))


def _of_canopen(facts: Facts, findings: Iterable[Finding]) -> list[Finding]:
    """Without what CANopen would mean on a bus that uses its identifiers for something else."""
    foreign = {facts.context.bus_name(bus) for bus in facts.control.nmt.foreign}
    return [
        each
        for each in findings
        if each.bus not in foreign or each.id.partition(".")[0] in _OF_ANY_BUS
    ]
