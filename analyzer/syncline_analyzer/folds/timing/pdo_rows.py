"""Rows of a PDO: its statistics, its responses and the stretches in which it stayed away."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.rhythm import MissedList
from syncline_analyzer.folds.timing.sending import Sending
from syncline_analyzer.results import HoleRow, PdoRow, Responses

MAX_HOLES = 1000
_DEVICE_COLUMNS = ("device_low", "device_high", "device_least", "waiting")
MAX_EVIDENCE = 100


def pdo_row(
    bus: str,
    can_id: int,
    state: PdoState,
    sending: Sending,
    missed: MissedList,
    resolution_ns: int,
) -> PdoRow:
    """The row of a PDO with what it missed; `resolution_ns` is the step of the stamps."""
    owner, answers = state.owner, sending.synchronous
    response = state.response if answers else None
    return PdoRow(
        bus=bus,
        cob_id=can_id,
        node=owner.node if owner else None,
        pdo=owner.name if owner else None,
        frames=state.frames,
        transmission_type=sending.type,
        type_source=sending.source,
        period_us=state.period.quantiles(1000),
        response_us=response.quantiles(1000, std=True) if response else None,
        device_us_low=state.device_low.quantiles(1000) if answers else None,
        device_us_high=state.device_high.quantiles(1000) if answers else None,
        missed=missed.count,
        extra=state.extra if answers else 0,
        late=state.late if answers else 0,
        missed_seq=missed.seq[:MAX_EVIDENCE].tolist(),
        too_soon=state.too_soon,
        extra_alone=state.extra_alone if answers else 0,
        extra_seq=state.extra_seq if answers else [],
        extra_first_ns=state.extra_ns[0] if answers and state.extra_ns else None,
        extra_last_ns=state.extra_ns[-1] if answers and state.extra_ns else None,
        too_soon_seq=state.too_soon_seq,
        too_soon_first_ns=state.too_soon_ns[0] if state.too_soon_ns else None,
        too_soon_last_ns=state.too_soon_ns[-1] if state.too_soon_ns else None,
        inhibit_us=_us(state.broken_inhibit_ns or state.told_inhibit_ns()),
        event_timer_us=_us(state.told_timer_ns()),
    )


def _us(ns: int | None) -> int | None:
    return None if ns is None else ns // 1000


def responses(row: PdoRow, state: PdoState) -> Responses:
    """The single answers; those of a PDO without device times have none either."""
    columns = state.responses.columns()
    unknown = np.full(len(columns["seq"]), np.nan)
    unmeasured = row.device_us_low is None
    low, high, least, waiting = (
        unknown if unmeasured else columns.get(name, unknown) / 1000 for name in _DEVICE_COLUMNS
    )
    counts, edges = state.response.histogram()
    return Responses(
        row.bus,
        row.cob_id,
        row.node,
        row.pdo,
        columns["seq"],
        columns["t_ns"],
        columns["response"] / 1000,
        low,
        high,
        counts,
        edges / 1000,
        least,
        waiting,
    )


def pdo_holes(
    row: PdoRow, missed: MissedList, step_ns: float, filled: Sequence[int] = ()
) -> list[HoleRow]:
    """Missed moments that follow one another, joined; `filled` are SYNCs that errors followed."""
    if not len(missed.t_ns):
        return []
    apart = np.diff(missed.t_ns)
    cuts = np.flatnonzero((apart > 1.5 * step_ns) | (apart < 0)) + 1
    edges = [0, *cuts[: MAX_HOLES - 1].tolist(), len(missed.t_ns)]
    held = np.isin(missed.seq, filled)
    return [_hole(row, missed, held, step_ns, a, b) for a, b in pairwise(edges)]


def _hole(
    row: PdoRow,
    missed: MissedList,
    held: NDArray[np.bool_],
    step_ns: float,
    first: int,
    stop: int,
) -> HoleRow:
    t_ns: NDArray[np.int64] = missed.t_ns
    end_ns = int(t_ns[stop - 1]) + round(step_ns)
    evidence = sorted(set(missed.seq[first : min(stop, first + MAX_EVIDENCE)].tolist()))
    held_back = int(np.count_nonzero(held[first:stop]))
    return HoleRow(
        row.bus, row.cob_id, "pdo", int(t_ns[first]), end_ns, stop - first, evidence, held_back
    )
