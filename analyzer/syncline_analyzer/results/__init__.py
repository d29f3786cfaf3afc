"""Rows of the tables: what the folds return, and what JSON, pandas and the views show.

The field names are those of `--format json` and never change within a major version. Times named
`*_ns` are stamps `t` as analysis.md defines them; `bus` is the interface's name as recorded;
`evidence` holds `seq` numbers.
"""

from syncline_analyzer.results.analysis import Analysis, Series
from syncline_analyzer.results.angle import (
    TRACE_FLAGS,
    EventKind,
    FollowerRow,
    ShaftRow,
    ShaftTrace,
    Trace,
    TraceEventRow,
    TraceRow,
)
from syncline_analyzer.results.bus import (
    BusErrorRow,
    BusLoadRow,
    BusShareRow,
    BusSilenceRow,
    BusStateRow,
    ClockStepRow,
    DoubledRow,
    LssRow,
    NodeShareRow,
    OverloadRow,
    TimeStampRow,
)
from syncline_analyzer.results.capture import CaptureRow, GapRow, MarkRow
from syncline_analyzer.results.device import DeviceHealthRow, ObjectChangeRow
from syncline_analyzer.results.emcy import EmcyContextRow, EmcyRow, ErrorHistoryRow, ErrorRow
from syncline_analyzer.results.finding import SEVERITY_RANK, Finding, Link, Severity
from syncline_analyzer.results.nodes import NmtCommandRow, NmtStateRow, NodeRow
from syncline_analyzer.results.quantiles import Jitter, Quantiles
from syncline_analyzer.results.sdo import ObjectHistoryRow, ObjectRow, SdoRow
from syncline_analyzer.results.sdo_records import SdoObject
from syncline_analyzer.results.sdo_transfers import SdoTransfers
from syncline_analyzer.results.tilt import TiltRow, TiltSetting, TiltTrace
from syncline_analyzer.results.timing import (
    ErrorControlRow,
    HoleRow,
    PdoLengthRow,
    PdoPauseRow,
    PdoRow,
    Responses,
    SyncDoubleRow,
    SyncJitterRow,
    SyncRow,
    WorstRow,
)
from syncline_analyzer.results.waiting import Ahead, DelayRow, LatenessRow, WaitRow

__all__ = [
    "SEVERITY_RANK",
    "TRACE_FLAGS",
    "Ahead",
    "Analysis",
    "BusErrorRow",
    "BusLoadRow",
    "BusShareRow",
    "BusSilenceRow",
    "BusStateRow",
    "CaptureRow",
    "ClockStepRow",
    "DelayRow",
    "DeviceHealthRow",
    "DoubledRow",
    "EmcyContextRow",
    "EmcyRow",
    "ErrorControlRow",
    "ErrorHistoryRow",
    "ErrorRow",
    "EventKind",
    "Finding",
    "FollowerRow",
    "GapRow",
    "HoleRow",
    "Jitter",
    "LatenessRow",
    "Link",
    "LssRow",
    "MarkRow",
    "NmtCommandRow",
    "NmtStateRow",
    "NodeRow",
    "NodeShareRow",
    "ObjectChangeRow",
    "ObjectHistoryRow",
    "ObjectRow",
    "OverloadRow",
    "PdoLengthRow",
    "PdoPauseRow",
    "PdoRow",
    "Quantiles",
    "Responses",
    "SdoObject",
    "SdoRow",
    "SdoTransfers",
    "Series",
    "Severity",
    "ShaftRow",
    "ShaftTrace",
    "SyncDoubleRow",
    "SyncJitterRow",
    "SyncRow",
    "TiltRow",
    "TiltSetting",
    "TiltTrace",
    "TimeStampRow",
    "Trace",
    "TraceEventRow",
    "TraceRow",
    "WaitRow",
    "WorstRow",
]
