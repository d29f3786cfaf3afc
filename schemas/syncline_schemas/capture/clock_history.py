"""What the clock samples of a recording tell of its stamps: which were made by a clock that was wrong.

A machine without a battery clock starts in 1970 or at an old date and gets its date later; a time
server sets clocks that are off. All stamps of a recording are by one of two clocks: UTC as it was
told at that moment, or log time, which follows UTC forward and stays where UTC is set back. Each
sample ties both to the time since the machine started, which nothing sets: so what a later UTC says
moves all stamps before it. Of a clock that is set twice between two samples only the sum is known.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.proto import syncline_pb2

STEP_NS = 1_000_000
"""UTC that moves less against the elapsed time was not set, but slewed or read late."""
PLAUSIBLE_NS = 1_577_836_800_000_000_000
"""2020-01-01: a recorder whose clock says an earlier time has not been told the date."""


@dataclass(frozen=True, slots=True)
class Epoch:
    """A stretch of a recording in which nobody set its clock [ns].

    Attributes:
        begin_log_ns: log time of its first sample.
        from_log_ns: frames taken in it have at least this log time.
        elapsed_ns: since the machine started, at that sample.
        utc_offset_ns: UTC minus elapsed time.
        log_offset_ns: log time minus elapsed time.
        seen_before_log_ns: log time of the last sample before it: the clock was set after that.
        step_ns: how far UTC was set at its begin; 0 in the first.
    """

    begin_log_ns: int
    from_log_ns: int
    elapsed_ns: int
    utc_offset_ns: int
    log_offset_ns: int
    seen_before_log_ns: int
    step_ns: int


class ClockHistory:
    """The epochs of one recording, fed with its clock samples in order of log time.

    Attributes:
        epochs: at least one where there was a sample.
        last_utc_ns: what the clock said last.
    """

    def __init__(self) -> None:
        self.epochs: list[Epoch] = []
        self.last_utc_ns = 0
        self._last: tuple[int, int, int] | None = None

    def add(self, log_ns: int, sample: syncline_pb2.ClockSample) -> None:
        """Take in a sample that stands at this log time; those of adapters are no samples."""
        if sample.HasField("bus"):
            return
        elapsed_ns = sample.boot_ns if sample.HasField("boot_ns") else sample.monotonic_ns
        utc_offset_ns = sample.utc_ns - elapsed_ns
        before = self._last
        log_offset_ns = max(utc_offset_ns, before[2]) if before else log_ns - elapsed_ns
        if sample.HasField("offset_ns"):
            log_offset_ns = sample.offset_ns
        noise_ns = STEP_NS + 2 * sample.uncertainty_ns
        if before is None or abs(utc_offset_ns - before[1]) >= noise_ns:
            self.epochs.append(
                Epoch(
                    log_ns,
                    elapsed_ns + log_offset_ns,
                    elapsed_ns,
                    utc_offset_ns,
                    log_offset_ns,
                    before[0] if before else log_ns,
                    utc_offset_ns - before[1] if before else 0,
                )
            )
        self._last = log_ns, utc_offset_ns, log_offset_ns
        self.last_utc_ns = sample.utc_ns

    def repair(self) -> "ClockRepair | None":
        """What makes the stamps right; None when no clock was set, or none ever told the date."""
        right = [
            n
            for n, epoch in enumerate(self.epochs)
            if epoch.elapsed_ns + epoch.utc_offset_ns >= PLAUSIBLE_NS
        ]
        if len(self.epochs) < 2 or not right:
            return None
        return ClockRepair(tuple(self.epochs), right[-1])


@dataclass(frozen=True, slots=True)
class ClockRepair:
    """Moves stamps to what the clock of the epoch `true_epoch` would have said."""

    epochs: tuple[Epoch, ...]
    true_epoch: int

    def t_ns(self, t_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Stamps of frames by their log times. t_ns, log_ns: (n,) int64; (n,) int64.

        Which of the clocks made a stamp is told by the log time of its frame, which is taken a
        little later than any right stamp: between the samples around a step the stamp may be by
        either UTC, and log time itself where the source gives no stamps.
        """
        number = self._epoch_of(log_ns)
        lag = log_ns - t_ns
        best = self._moved(number, log=True)
        distance = np.abs(lag)
        later = np.minimum(number + 1, len(self.epochs) - 1)
        seen_before = np.array([each.seen_before_log_ns for each in self.epochs])
        log_offset = np.array([each.log_offset_ns for each in self.epochs])[number]
        utc_offset = np.array([each.utc_offset_ns for each in self.epochs])
        for candidate, possible in (
            (number, np.ones(len(t_ns), np.bool_)),
            (later, log_ns >= seen_before[later]),
        ):
            behind = np.abs(lag - (log_offset - utc_offset[candidate]))
            better = possible & (behind < distance)
            best = np.where(better, self._moved(candidate, log=False), best)
            distance = np.where(better, behind, distance)
        return t_ns + best

    def log_t_ns(self, log_ns: int) -> int:
        """The same of a log time."""
        row = np.array([log_ns], np.int64)
        return int(row[0] + self._moved(self._epoch_of(row), log=True)[0])

    @property
    def largest_ns(self) -> int:
        """The largest correction, with its sign."""
        every = np.arange(len(self.epochs))
        moved = self._moved(every, log=False)
        return int(moved[np.argmax(np.abs(moved))])

    def _epoch_of(self, log_ns: NDArray[np.int64]) -> NDArray[np.intp]:
        begins = np.array([each.from_log_ns for each in self.epochs])
        return np.maximum(np.searchsorted(begins, log_ns, side="right") - 1, 0)

    def _moved(self, number: NDArray[np.intp], *, log: bool) -> NDArray[np.int64]:
        """What is to be added to a stamp of an epoch's UTC, or of its log time."""
        set_by = np.cumsum([each.step_ns for each in self.epochs])
        moved: NDArray[np.int64] = (set_by[self.true_epoch] - set_by)[number]
        if log:
            ahead = [each.log_offset_ns - each.utc_offset_ns for each in self.epochs]
            moved = moved - np.array(ahead, np.int64)[number]
        return moved
