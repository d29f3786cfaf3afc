"""What the clock samples of a recording tell of its stamps: which were made by a clock that was wrong.

A machine without a battery clock starts in 1970 or at an old date and gets its date later; a time
server sets clocks that are off. All stamps of a recording are by one of two clocks: UTC as it was
told at that moment, or log time, which follows UTC forward and stays where UTC is set back. Each
sample ties both to the time since the machine started, which nothing sets: so what a later UTC says
moves all stamps before it. Of a clock that is set twice between two samples only the sum is known.
"""

import json
from collections.abc import Mapping
from dataclasses import astuple, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.capture.adapter_fit import AdapterFit
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from syncline_schemas.proto import syncline_pb2

STEP_NS = 1_000_000
"""UTC that moves less against the elapsed time was not set, but slewed or read late."""
MAX_TOLD_EPOCHS = 1000
"""A file with more of them does not tell them at its end."""
CLOCKS_KEY = "clocks"
"""Key, in the metadata record at the end of a file, of what its clock samples said."""
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
        adapter_fits: by bus number, of adapters that have a clock of their own.
    """

    def __init__(self) -> None:
        self.epochs: list[Epoch] = []
        self.last_utc_ns = 0
        self.adapter_fits: dict[int, AdapterFit] = {}
        self._last: tuple[int, int, int] | None = None
        self._first_noise_ns = 0
        self._tells_offsets = True

    def to_record(self) -> dict[str, str]:
        """All that another history needs of the samples of one file, as a metadata record.

        Empty where that depends on what came before the file, or is too much.
        """
        told = self._tells_offsets and not self.adapter_fits
        if not told or not 0 < len(self.epochs) <= MAX_TOLD_EPOCHS:
            return {}
        record = {
            "noise_ns": self._first_noise_ns,
            "epochs": [astuple(epoch) for epoch in self.epochs],
            "last": self._last,
            "last_utc_ns": self.last_utc_ns,
        }
        return {CLOCKS_KEY: json.dumps(record)}

    def add_record(self, record: Mapping[str, str]) -> bool:
        """Take in the samples of a whole file from `to_record`; False when it does not tell them."""
        try:
            told = json.loads(record.get(CLOCKS_KEY, ""))
            first, *later = [Epoch(*map(int, fields)) for fields in told["epochs"]]
            log_ns, utc_offset_ns, log_offset_ns = map(int, told["last"])
            noise_ns, last_utc_ns = int(told["noise_ns"]), int(told["last_utc_ns"])
        except (ValueError, TypeError, KeyError):
            return False
        self._add_epoch(first, noise_ns)
        self.epochs += later
        self._last, self.last_utc_ns = (log_ns, utc_offset_ns, log_offset_ns), last_utc_ns
        return True

    def add(self, log_ns: int, sample: "syncline_pb2.ClockSample") -> None:
        """Take in a sample that stands at this log time; those of adapters tell of them alone."""
        if sample.HasField("bus"):
            if sample.HasField("residual_ns"):
                fit = AdapterFit.of(sample, self.adapter_fits.get(sample.bus))
                self.adapter_fits[sample.bus] = fit
            return
        elapsed_ns = sample.boot_ns if sample.HasField("boot_ns") else sample.monotonic_ns
        utc_offset_ns = sample.utc_ns - elapsed_ns
        before = self._last
        log_offset_ns = max(utc_offset_ns, before[2]) if before else log_ns - elapsed_ns
        if sample.HasField("offset_ns"):
            log_offset_ns = sample.offset_ns
        else:
            self._tells_offsets = False
        self._add_epoch(
            Epoch(
                log_ns,
                elapsed_ns + log_offset_ns,
                elapsed_ns,
                utc_offset_ns,
                log_offset_ns,
                seen_before_log_ns=log_ns,
                step_ns=0,
            ),
            STEP_NS + 2 * sample.uncertainty_ns,
        )
        self._last = log_ns, utc_offset_ns, log_offset_ns
        self.last_utc_ns = sample.utc_ns

    def _add_epoch(self, found: Epoch, noise_ns: int) -> None:
        """Begin an epoch at a sample, unless the one before it goes on."""
        before = self._last
        if before is None:
            self._first_noise_ns = noise_ns
            self.epochs.append(found)
        elif abs(found.utc_offset_ns - before[1]) >= noise_ns:
            step_ns = found.utc_offset_ns - before[1]
            self.epochs.append(replace(found, seen_before_log_ns=before[0], step_ns=step_ns))

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
