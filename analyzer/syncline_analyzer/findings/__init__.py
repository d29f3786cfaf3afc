"""Rules over the tables, one module per family; what they return is what the report says."""

from syncline_analyzer.context import Context
from syncline_analyzer.findings import angle, bus, emcy, nmt, sdo, timing
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.results import Analysis, Finding

_RANK = {"error": 0, "warning": 1, "info": 2}


def find_all(analysis: Analysis, control: ControlTables, context: Context) -> list[Finding]:
    """Findings of all families: errors first, then by the time they began."""
    found = [
        *bus.find(analysis, control, context),
        *nmt.find(analysis, control, context),
        *emcy.find(analysis, control, context),
        *sdo.find(analysis, control, context),
        *(timing.find(analysis) if context.timed else ()),
        *angle.find(analysis),
    ]
    return sorted(found, key=lambda f: (_RANK[f.severity], f.start_ns, f.id, f.node or 0))
