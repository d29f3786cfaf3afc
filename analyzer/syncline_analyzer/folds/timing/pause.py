"""PDOs that stop while their node goes on: long stretches without a frame that was due."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.pdo_periods import PAUSE_NS, PAUSE_PERIODS
from syncline_analyzer.folds.timing.pdo_state import Pause, PdoState
from syncline_analyzer.folds.timing.rhythm import Operational
from syncline_analyzer.folds.timing.silence import Silence
from syncline_analyzer.results import PdoPauseRow, PdoRow

_LEARN = 50
"""Frames from which a PDO has a rhythm that may be missed."""


def pauses(
    row: PdoRow,
    state: PdoState,
    rhythm: tuple[float, str],
    operational: Sequence[Operational],
    silences: Sequence[Silence],
    end_ns: int,
    missed_ns: NDArray[np.int64] | None = None,
) -> list[PdoPauseRow]:
    """The pauses of one PDO while its node was OPERATIONAL and the bus was heard.

    Args:
        rhythm: time between two due frames [ns], and what says so.
        operational: when the node was.
        silences: of the whole bus; what lies in them counts for nothing.
        end_ns: end of the capture.
        missed_ns: SYNCs that a synchronous PDO did not answer; where SYNC itself stays away, none
            is due.
    """
    if state.owner is None or row.pdo is None or state.frames < _LEARN:
        return []
    step_ns, basis = rhythm
    found = []
    for pause in [*state.pauses, *_last(state, end_ns)]:
        for start_ns, stop_ns in _within(pause, operational, step_ns):
            length = stop_ns - start_ns - _silent_ns(silences, start_ns, stop_ns)
            due = int(length / step_ns)
            if missed_ns is not None:
                due = int(((missed_ns > start_ns) & (missed_ns < stop_ns)).sum())
            if length < PAUSE_NS or due < PAUSE_PERIODS:
                continue
            back = pause.end_seq is not None and stop_ns >= pause.end_ns
            evidence = [pause.start_seq]
            if back and pause.end_seq is not None:
                evidence.append(pause.end_seq)
            found.append(
                PdoPauseRow(
                    row.bus,
                    row.cob_id,
                    state.owner.node,
                    row.pdo,
                    start_ns,
                    stop_ns,
                    due,
                    back,
                    basis,
                    evidence,
                )
            )
    return found


def _last(state: PdoState, end_ns: int) -> list[Pause]:
    """The time from the last frame to the end of the capture."""
    if state.last_ns is None or end_ns - state.last_ns < PAUSE_NS:
        return []
    return [Pause(state.last_ns, end_ns, state.last_seq, None)]


def _within(
    pause: Pause, operational: Sequence[Operational], step_ns: float
) -> list[tuple[int, int]]:
    """The parts of a pause in which the node was OPERATIONAL, after it had sent or could have.

    A node that is seen to have left OPERATIONAL in the end may have left it at the last frame.
    """
    parts = []
    for interval in operational:
        start_ns = max(pause.start_ns, interval.start_ns)
        stop_ns = min(pause.end_ns, interval.end_ns)
        leaves = interval.left and interval.end_ns <= pause.end_ns
        begun = interval.start_ns <= pause.start_ns
        if stop_ns > start_ns and begun and not (leaves and stop_ns - start_ns < 4 * PAUSE_NS):
            parts.append((start_ns, stop_ns))
    return parts


def _silent_ns(silences: Sequence[Silence], start_ns: int, stop_ns: int) -> int:
    return sum(
        max(0, min(each.end_ns, stop_ns) - max(each.start_ns, start_ns)) for each in silences
    )
