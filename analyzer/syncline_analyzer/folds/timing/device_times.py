"""How long the devices took to answer SYNC: bounds, and what their answers waited for."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.on_wire import OnWire
from syncline_analyzer.folds.timing.pdo_answers import AnswersTo, PdoAnswers
from syncline_analyzer.folds.timing.pdo_columns import AfterSync
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_analyzer.folds.timing.waiting_fold import WaitingFold
from syncline_analyzer.series import Columns
from syncline_schemas import native
from syncline_schemas.wire_length import INTERMISSION_BITS

_BY_EVENTS = (0xFE, 0xFF)
"""Transmission types of a PDO that answers no SYNC, so that none can have kept it waiting."""
_DEVICE = ("device_low", "device_high")
_WAITING = ("device_least", "waiting")

Floats = NDArray[np.float64]


class DeviceTimes:
    """Measures the answers of one bus in a block to the SYNCs of one identifier.

    Args:
        block, bus: the frames.
        sent: (n,) bits on the bus up to the end of each row of the block.
    """

    def __init__(
        self,
        context: Context,
        on_wire: OnWire,
        waiting: WaitingFold,
        block: Block,
        bus: int,
        sent: NDArray[np.int64],
    ) -> None:
        self._waiting = waiting
        self._block = block
        self._sent = sent
        self._bit_ns = on_wire.bit_ns(bus)
        self._slack_ns = context.resolution_ns - 1 + on_wire.noise_ns(bus)

    def measure(self, sync: SyncIndex, after: AfterSync, pdos: Sequence[PdoAnswers]) -> None:
        """Add the times of all these answers to the states of their PDOs, and keep them."""
        if self._bit_ns is None:
            for each in pdos:
                each.state.responses.add(_columns(each))
            return
        by_events = [each for each in pdos if each.state.told_type() in _BY_EVENTS]
        waited = [each for each in pdos if each.state.told_type() not in _BY_EVENTS]
        if by_events:
            answers = AnswersTo(self._block, sync, after, by_events)
            *bounds, limits = self._bounds(answers, self._bit_ns)
            _keep(answers, limits, _DEVICE, *bounds)
        if waited:
            answers = AnswersTo(self._block, sync, after, waited)
            *bounds, limits = self._bounds(answers, self._bit_ns)
            times_ns = *bounds, *self._waiting.answers(answers, *bounds)
            _keep(answers, limits, _DEVICE + _WAITING, *times_ns)

    def _bounds(self, answers: AnswersTo, bit_ns: float) -> tuple[Floats, Floats, Floats]:
        """(low, high) [ns] of the time from the end of the SYNC to the request to send.

        At least: everything since the SYNC, intermissions included, kept the device waiting. At
        most: the bus was idle, and only the frame itself (which has no intermission before its
        end) passed. Both are widened by the step of the stamps and by what these prove to be off
        beyond it (analysis.md section 5).

        Returns: (r,) both, and (p, 4) the least and the largest of either for each PDO.
        """
        if native.available():
            return native.bounds(
                self._sent,
                self._block.wire_bits,
                answers.starts,
                answers.rows,
                answers.position,
                answers.response,
                answers.sync.bits,
                (bit_ns, self._slack_ns, INTERMISSION_BITS),
            )
        rows, response = answers.rows, answers.response
        busy = self._sent.take(rows) - answers.sync.bits.take(answers.position)
        own = self._block.wire_bits.take(rows) - INTERMISSION_BITS
        low = np.floor(response - busy * bit_ns) - self._slack_ns
        high = np.ceil(response - own * bit_ns) + self._slack_ns
        low, high = np.maximum(low, 0.0), np.maximum(high, 0.0)
        limits = [
            how.reduceat(column, answers.starts)
            for column in (low, high)
            for how in (np.minimum, np.maximum)
        ]
        return low, high, np.stack(limits, axis=1)


def _columns(answers: PdoAnswers) -> Columns:
    """Columns of the answers, but those of the device times."""
    frames = answers.frames
    return {"seq": frames.seq, "t_ns": frames.t_ns, "response": answers.response}


def _keep(answers: AnswersTo, limits: Floats, names: Sequence[str], *times_ns: Floats) -> None:
    """Keep answers with (r,) times of their devices [ns].

    The first two of these are bounds with `limits`, see `_bounds`.
    """
    for each, part, (a, b, c, d) in zip(answers.pdos, answers.parts, limits.tolist(), strict=True):
        each.state.device_low.add(times_ns[0][part], (a, b))
        each.state.device_high.add(times_ns[1][part], (c, d))
        columns = _columns(each)
        for name, column in zip(names, times_ns, strict=True):
            columns[name] = column[part]
        each.state.responses.add(columns)
