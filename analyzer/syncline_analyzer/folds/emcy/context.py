"""What was around each EMCY: states, SDO writes just before it, measured values on either side."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import (
    Analysis,
    BusStateRow,
    EmcyContextRow,
    EmcyRow,
    NmtStateRow,
    SdoRow,
    SdoTransfers,
    Trace,
)
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.records import dataclass

MAX_CONTEXTS = 1000
"""EMCYs whose surroundings are collected."""
MAX_WRITES = 5
WRITE_NS = 10_000_000_000
"""An SDO write longer before the EMCY is not told [ns]."""
VALUE_NS = 1_000_000_000
"""Measured values this far before and after the EMCY [ns]."""
_WINDOW = 100_000
"""Samples on either side that are looked through."""

Key = tuple[str, int]
"""(bus name, node)."""
Row = TypeVar("Row", NmtStateRow, Trace)


def emcy_context(
    analysis: Analysis, bus_states: Sequence[BusStateRow], *, timed: bool
) -> list[EmcyContextRow]:
    """The surroundings of the first `MAX_CONTEXTS` EMCYs, in order of `seq`.

    Without times only the NMT state is told, by the order of the frames.
    """
    chosen = [row for row in analysis.emcy if row.transition != "reset"][:MAX_CONTEXTS]
    if not chosen:
        return []
    keys = {(row.bus, row.node) for row in chosen}
    states = _by_node(analysis.nmt_states, keys)
    writes = _Writes.of(analysis.sdo.writes, keys) if timed else {}
    traces = _by_node(analysis.trace_data, keys) if timed else {}
    return [
        _context(
            row,
            _sent_in(states.get((row.bus, row.node), ()), row, timed=timed),
            _bus_state(bus_states, row) if timed else None,
            _before(writes.get((row.bus, row.node)), row),
            traces.get((row.bus, row.node), ()),
        )
        for row in chosen
    ]


def state_at(
    rows: Sequence[NmtStateRow], seq: int, t_ns: int, *, timed: bool = True
) -> NmtStateRow | None:
    """The interval of a node's NMT state in which a frame lies; by `seq` where times tell nothing."""
    if not timed:
        told = [row for row in rows if (row.evidence if row.evidence is not None else -1) <= seq]
        return told[-1] if told else None
    inside = [
        row
        for row in rows
        if row.start_ns <= t_ns < row.end_ns and (row.evidence is None or row.evidence <= seq)
    ]
    if inside:
        return inside[-1]
    last = rows[-1] if rows else None
    return last if last is not None and last.start_ns <= t_ns <= last.end_ns else None


def _sent_in(rows: Sequence[NmtStateRow], emcy: EmcyRow, *, timed: bool) -> NmtStateRow | None:
    """The interval in which an EMCY was sent: the one before, where it tells that it ends that."""
    found = state_at(rows, emcy.seq, emcy.t_ns, timed=timed)
    if found is None or found.evidence != emcy.seq or found.state == "UNKNOWN":
        return found
    return rows[max(0, rows.index(found) - 1)]


def _by_node(rows: Iterable[Row], keys: set[Key]) -> Mapping[Key, list[Row]]:
    found: dict[Key, list[Row]] = defaultdict(list)
    for row in rows:
        if (row.bus, row.node) in keys:
            found[row.bus, row.node].append(row)
    return found


@dataclass(slots=True)
class _Writes:
    """SDO writes to one node in order of the `seq` at which they ended."""

    rows: SdoTransfers
    ends: NDArray[np.int64]

    @staticmethod
    def of(transfers: SdoTransfers, keys: set[Key]) -> dict[Key, "_Writes"]:
        named = transfers.of_objects(lambda each: each.index is not None)
        own = {key: named.of_node(*key) for key in keys}
        orders = {
            key: np.argsort(rows.records["end_seq"], kind="stable") for key, rows in own.items()
        }
        ordered = {key: rows.part(orders[key]) for key, rows in own.items()}
        return {key: _Writes(rows, rows.records["end_seq"]) for key, rows in ordered.items()}


def _before(writes: _Writes | None, emcy: EmcyRow) -> list[SdoRow]:
    """The last writes that ended before an EMCY, the latest first."""
    last = int(writes.ends.searchsorted(emcy.seq, "right")) if writes is not None else 0
    if writes is None or not last:
        return []
    latest = slice(max(0, last - MAX_WRITES), last)
    passed = emcy.t_ns - writes.rows.records["end_ns"][latest]
    if not ((passed >= 0) & (passed <= WRITE_NS)).any():
        return []
    near = writes.rows[latest]
    return [row for row in reversed(near) if 0 <= emcy.t_ns - row.end_ns <= WRITE_NS]


def _bus_state(rows: Sequence[BusStateRow], emcy: EmcyRow) -> str | None:
    inside = [row for row in rows if row.bus == emcy.bus and row.start_ns <= emcy.t_ns < row.end_ns]
    return inside[-1].state if inside else None


def _context(
    emcy: EmcyRow,
    state: NmtStateRow | None,
    bus_state: str | None,
    writes: Sequence[SdoRow],
    traces: Sequence[Trace],
) -> EmcyContextRow:
    last = writes[0] if writes else None
    return EmcyContextRow(
        bus=emcy.bus,
        node=emcy.node,
        seq=emcy.seq,
        t_ns=emcy.t_ns,
        code=emcy.code,
        state=state.state if state else NmtState.UNKNOWN.value,
        certainty=state.certainty if state else "assumed",
        bus_state=bus_state,
        write_index=last.index if last else None,
        write_sub=last.sub if last else None,
        write_seq=last.seq if last else None,
        write_ms=(emcy.t_ns - last.end_ns) / 1e6 if last else None,
        writes=[write_text(row, emcy.t_ns) for row in writes],
        values={name: told for trace in traces for name, told in _around(trace, emcy).items()},
    )


def write_text(row: SdoRow, t_ns: int) -> str:
    """An SDO write in words, and how long before a moment its answer came."""
    name = f" {row.name}" if row.name else ""
    value = "" if row.value is None else f" = {row.value}"
    result = "" if row.result == "ok" else f" ({row.result})"
    passed_ms = (t_ns - row.end_ns) / 1e6
    passed = f"{passed_ms / 1e3:.3g} s" if passed_ms >= 1000 else f"{passed_ms:.3g} ms"
    return f"{row.index or 0:04X}h:{row.sub or 0:02X}{name}{value}{result}, {passed} before"


def _around(trace: Trace, emcy: EmcyRow) -> dict[str, Any]:
    """Values of a trace within a second on either side of an EMCY; empty where there are none."""
    place = int(np.searchsorted(trace.seq, emcy.seq))
    begin, stop = max(0, place - _WINDOW), min(len(trace.seq), place + _WINDOW)
    passed = trace.t_ns[begin:stop] - emcy.t_ns
    value = trace.value[begin:stop]
    near = (np.abs(passed) <= VALUE_NS) & np.isfinite(value)
    if not near.any():
        return {}
    rows = np.flatnonzero(near)
    earlier, later = rows[rows < place - begin], rows[rows >= place - begin]
    name = f"{trace.object >> 8:04X}h:{trace.object & 0xFF:02X}"
    return {
        name: {
            "name": trace.name,
            "unit": trace.unit,
            "before": float(value[earlier[-1]]) if len(earlier) else None,
            "after": float(value[later[0]]) if len(later) else None,
            "low": float(value[near].min()),
            "high": float(value[near].max()),
            "samples": int(near.sum()),
            "assumed": list(trace.assumed),
        }
    }
