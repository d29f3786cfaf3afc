"""Runs of the control folds over captures and over frames written down in tests."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from syncline_analyzer.context import Context
from syncline_analyzer.findings.bus import bus_off as bus
from syncline_analyzer.findings.bus import capture, clock
from syncline_analyzer.findings.emcy import errors as emcy
from syncline_analyzer.findings.nmt import rules as nmt
from syncline_analyzer.findings.rule import Facts, apply
from syncline_analyzer.findings.sdo import transfers as sdo
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.control import ControlFold, ControlTables
from syncline_analyzer.folds.emcy.context import emcy_context
from syncline_analyzer.folds.emcy.history import error_history
from syncline_analyzer.nodes import node_rows
from syncline_analyzer.results import Analysis, CaptureRow, Finding, GapRow, NodeRow
from syncline_analyzer.shadow import Shadow
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device

MS = 1_000_000
S = 1_000_000_000
Row = tuple[int, int, int, int, int, bytes]


@dataclass
class Run:
    """What the control folds made of a capture."""

    context: Context
    tables: ControlTables
    analysis: Analysis

    @property
    def nodes(self) -> dict[int, NodeRow]:
        """Rows by node, on a capture of one bus."""
        return {row.node: row for row in self.analysis.nodes}

    def findings(self) -> list[Finding]:
        """Findings of all rules on the control side."""
        rules = (*nmt.RULES, *sdo.RULES, *emcy.RULES, *bus.RULES, *capture.RULES, *clock.RULES)
        return apply(rules, Facts(self.analysis, self.tables, self.context))

    def ids(self) -> list[str]:
        """Ids of the findings."""
        return [finding.id for finding in self.findings()]

    def states(self, node: int) -> list[tuple[str, float, float]]:
        """(state, start, end) of a node in seconds into the capture."""
        first = self.analysis.capture.first_ns
        return [
            (row.state, (row.start_ns - first) / S, (row.end_ns - first) / S)
            for row in self.analysis.nmt_states
            if row.node == node
        ]


def frame(t_ms: float, can_id: int, data: str = "", *, bus: int = 0, flags: int = 0) -> Row:
    """A frame at a time in ms; data as hexadecimal digits."""
    payload = bytes.fromhex(data)
    return (round(t_ms * MS), bus, can_id, flags, len(payload), payload)


def remote(t_ms: float, can_id: int) -> Row:
    """A remote frame."""
    return (round(t_ms * MS), 0, can_id, int(FrameFlag.REMOTE), 1, b"")


def run(
    *items: Row | Gap,
    timed: bool = True,
    batch: int = 1 << 20,
    devices: dict[int, Device] | None = None,
    description: BusDescription | None = None,
    end_ms: float | None = None,
    buses: tuple[str, ...] = ("can0", "can1"),
) -> Run:
    """Feed frames and gaps to the folds, in batches of so many frames."""
    shadow = Shadow(lambda number: buses[number], description, devices)
    context = Context(list(buses), shadow, timed=timed)
    fold = ControlFold(context)
    seq, pending, gaps = 0, list[Row](), list[Gap]()
    rows = [item for item in items if not isinstance(item, Gap)]

    def flush() -> None:
        nonlocal seq
        for start in range(0, len(pending), batch):
            frames = FrameBatch.from_rows(pending[start : start + batch])
            fold.update(IndexedBatch(frames, seq, timed=timed))
            seq += len(frames)
        pending.clear()

    for item in items:
        if isinstance(item, Gap):
            flush()
            fold.gap(item)
            gaps.append(item)
        else:
            pending.append(item)
    flush()
    last_ns = rows[-1][0] if rows else 0
    end_ns = last_ns if end_ms is None else round(end_ms * MS)
    return _finished(context, fold, rows[0][0] if rows else 0, end_ns, len(rows), gaps)


def run_items(
    items: Iterable[FrameBatch | Gap], buses: list[str], description: BusDescription | None = None
) -> Run:
    """Feed batches and gaps to the folds."""
    context = Context(buses, Shadow(lambda number: buses[number], description))
    return _fed(context, items)


def run_capture(path: Path, rows: int = 1 << 20) -> Run:
    """Feed a capture file to the folds, in batches of at most so many rows."""
    from syncline_analyzer.readers import open_capture

    reader = open_capture(path)
    context = Context(reader.facts.buses, Shadow(lambda number: reader.facts.buses[number]))

    def timed() -> Iterator[FrameBatch | Gap]:
        for item in reader.batches():
            context.timed = reader.facts.time_base != "none"
            if isinstance(item, Gap):
                yield item
            else:
                yield from (item[at : at + rows] for at in range(0, len(item), rows))

    return _fed(context, timed())


def _fed(context: Context, items: Iterable[FrameBatch | Gap]) -> Run:
    fold = ControlFold(context)
    seq, first, last, gaps = 0, None, 0, []
    for item in items:
        if isinstance(item, Gap):
            fold.gap(item)
            gaps.append(item)
            continue
        fold.update(IndexedBatch(item, seq, timed=context.timed))
        seq += len(item)
        if len(item):
            first = int(item.t_ns[0]) if first is None else first
            last = int(item.t_ns[-1])
    return _finished(context, fold, first or 0, last, seq, gaps)


def _finished(
    context: Context, fold: ControlFold, first_ns: int, end_ns: int, frames: int, gaps: list[Gap]
) -> Run:
    tables = fold.finish(end_ns)
    capture = CaptureRow(
        files=[],
        frames=frames,
        data_frames=frames,
        remote_frames=0,
        error_frames=0,
        extended_frames=0,
        unparsed_lines=0,
        start_utc_ns=None,
        duration_ns=end_ns - first_ns,
        buses=context.buses,
        gaps=[_gap_row(g, context) for g in gaps],
        first_ns=first_ns,
    )
    analysis = Analysis(
        capture=capture,
        nodes=node_rows(context, tables),
        nmt_commands=tables.nmt.commands,
        nmt_states=tables.nmt.states,
        sync=[],
        pdos=[],
        emcy=tables.emcy.rows,
        errors=tables.emcy.errors,
        sdo=tables.sdo.rows,
        traces=[],
        bus_load=[],
        findings=[],
    )
    bus_states = tables.bus_errors.states
    analysis.emcy_context.extend(emcy_context(analysis, bus_states, timed=context.timed))
    analysis.error_history.extend(error_history(tables, context, capture.gaps))
    return Run(context, tables, analysis)


def _gap_row(gap: Gap, context: Context) -> GapRow:
    bus = None if gap.bus is None else context.bus_name(gap.bus)
    return GapRow(gap.start_ns, gap.end_ns, gap.reason, gap.lost_frames, bus)
