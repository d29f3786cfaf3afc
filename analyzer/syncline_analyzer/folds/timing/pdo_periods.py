"""Periods of a PDO: too short for its inhibit time, too long for its timer, and pauses."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.lateness import others_as_late
from syncline_analyzer.folds.timing.overdue import lacking_after
from syncline_analyzer.folds.timing.pdo_columns import PdoColumns
from syncline_analyzer.folds.timing.pdo_frames import PdoFrames
from syncline_analyzer.folds.timing.pdo_state import Pause, PdoState
from syncline_analyzer.folds.timing.sync_index import SyncIndex

MAX_PAUSES = 1000
MAX_EVIDENCE = 20
PAUSE_NS = 5_000_000_000
PAUSE_PERIODS = 20
"""A PDO that stays away for so long, and so many of its periods, has stopped."""
DEADLINE = 1.1
"""An RPDO is overdue when it takes longer than so many times what its node allows (140xh:5)."""

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def follow(
    columns: PdoColumns,
    number: int,
    state: PdoState,
    frames: PdoFrames,
    sync: SyncIndex | None,
    *,
    timed: bool,
) -> None:
    """Take in the frames of a PDO, by its number; periods in a backlog of SYNCs are none.

    Without times only what was sent is counted.
    """
    t_ns, seq, rows = frames.t_ns, frames.seq, frames.rows
    last_ns, last_seq = state.last_ns, state.last_seq
    state.last_ns, state.last_seq = int(t_ns[-1]), int(seq[-1])
    state.frames += len(rows)
    state.repeats.add(columns.runs[number])
    if not timed:
        return
    periods, limits = columns.periods[frames.place], columns.period_limits(number)
    if limits is None:
        periods = periods[1:]
    if not len(periods):
        return
    bundled = sync is not None and sync.any_bundled
    true = None
    if limits is not None and limits[0] >= 0 and not bundled:
        state.periods.add(periods, seq, t_ns, limits)
    else:
        true = periods >= 0
        if sync is not None and bundled:
            held = np.concatenate(([False], sync.bundled[sync.before[rows]]))
            true &= ~(held[1:] | held[:-1])[len(rows) - len(periods) :]
        after = len(rows) - len(periods)
        state.periods.add(periods[true], seq[after:][true], t_ns[after:][true])
    longest = int(periods.max()) if limits is None else limits[1]
    inhibit_ns, timer_ns = state.told_inhibit_ns(), state.told_timer_ns()
    if timer_ns is None:
        state.overdue.flush()
    due_ns = timer_ns or state.told_deadline_ns()
    if longest < PAUSE_NS and inhibit_ns is None and due_ns is None:
        return
    if last_ns is not None:
        t_ns, seq = np.concatenate(([last_ns], t_ns)), np.concatenate(([last_seq], seq))
    if longest >= PAUSE_NS:
        _find_pauses(state, periods, t_ns, seq)
    if inhibit_ns is not None:
        true = np.ones(len(periods), np.bool_) if true is None else true
        _find_too_soon(state, inhibit_ns, periods, true, t_ns[1:], seq[1:])
    if due_ns is not None:
        rows = rows[-len(periods) :]
        _find_overdue(columns.block, state, due_ns, rows, periods, t_ns[:-1], seq[:-1])


def _find_pauses(state: PdoState, periods: Ints, t_ns: Ints, seq: Ints) -> None:
    """Long times without a frame, of which the rhythm of the whole capture tells more."""
    for at in np.flatnonzero(periods >= PAUSE_NS)[: MAX_PAUSES - len(state.pauses)].tolist():
        state.pauses.append(Pause(int(t_ns[at]), int(t_ns[at + 1]), int(seq[at]), int(seq[at + 1])))


def _find_too_soon(
    state: PdoState, inhibit_ns: int, periods: Ints, true: Bools, t_ns: Ints, seq: Ints
) -> None:
    """Frames closer than half the inhibit time: more than arbitration can pull together."""
    soon = np.flatnonzero(true & (periods < inhibit_ns / 2) & (seq > state.changed_seq))
    if len(soon):
        state.broken_inhibit_ns = inhibit_ns
    state.too_soon += len(soon)
    widen(state.too_soon_ns, t_ns[soon])
    state.too_soon_seq.extend(seq[soon[: MAX_EVIDENCE - len(state.too_soon_seq)]].tolist())


def _find_overdue(
    block: Block,
    state: PdoState,
    due_ns: int,
    rows: NDArray[np.intp],
    periods: Ints,
    before_ns: Ints,
    before_seq: Ints,
) -> None:
    """Missing periods of a cyclic TPDO whose event timer was told, late ones of such an RPDO.

    Not where others on the bus are as late: then nobody was heard, or the clock was set.
    """
    timer_ns = state.told_timer_ns()
    if state.owner is None:
        return
    if timer_ns is not None:
        late = lacking_after(periods, timer_ns)[0]
    else:
        late = np.flatnonzero(periods > DEADLINE * due_ns)
    judged = before_seq >= state.changed_seq
    for at in late[judged[late]].tolist():
        begin = block.batch.row_at(int(before_seq[at]))
        late_ns = int(periods[at]) - due_ns
        judged[at] = not others_as_late(block, state.owner, begin, int(rows[at]), late_ns)
    if timer_ns is not None:
        state.overdue.add(timer_ns, periods, before_ns, before_seq, judged)
    else:
        late = late[judged[late]]
        state.past_deadline.add(before_ns[late] + due_ns, before_seq[late])


def widen(span: list[int], t_ns: Ints) -> None:
    """Widen (first, last) by more stamps, in order."""
    if len(t_ns):
        span[:] = [span[0] if span else int(t_ns[0]), int(t_ns[-1])]
