"""Stamps of a recorder whose clock is set while it records, against the true times."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_schemas.capture.clock_history import PLAUSIBLE_NS, ClockHistory, ClockRepair
from syncline_schemas.proto import syncline_pb2

SECOND = 1_000_000_000
TRUE_NS = 1_763_780_000 * SECOND
"""True UTC at the machine's start."""
SAMPLES_NS = 900_000_000


@dataclass
class Recorder:
    """A recorder's clocks over the time since the machine started, its samples and its frames.

    `settings`: (elapsed_ns, step_ns) of UTC, which is `wrong_ns` off at first.
    """

    wrong_ns: int
    settings: list[tuple[int, int]]
    seconds: float = 30
    lag_ns: int = 200_000
    with_new_fields: bool = True
    samples: list[tuple[int, syncline_pb2.ClockSample]] = field(default_factory=list)
    log_offsets: list[tuple[int, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        log_offset = self.utc_offset(SECOND)
        self.log_offsets.append((0, log_offset))
        for elapsed in range(SECOND, SECOND + round(self.seconds * SECOND), SAMPLES_NS):
            log_ns = elapsed + log_offset
            log_offset = max(log_offset, self.utc_offset(elapsed))
            self.log_offsets.append((elapsed, log_offset))
            sample = syncline_pb2.ClockSample(
                utc_ns=elapsed + self.utc_offset(elapsed), monotonic_ns=elapsed
            )
            if self.with_new_fields:
                sample.boot_ns = elapsed
                sample.monotonic_ns = elapsed - 5 * SECOND
                sample.offset_ns = log_offset
            self.samples.append((log_ns, sample))

    def utc_offset(self, elapsed_ns: int) -> int:
        return TRUE_NS + self.wrong_ns + sum(s for at, s in self.settings if at <= elapsed_ns)

    def log_ns(self, elapsed_ns: int) -> int:
        return elapsed_ns + next(o for at, o in reversed(self.log_offsets) if at < elapsed_ns)

    def history(self) -> ClockHistory:
        history = ClockHistory()
        for log_ns, sample in self.samples:
            history.add(log_ns, sample)
        return history

    def repair(self) -> ClockRepair:
        repair = self.history().repair()
        assert repair is not None
        return repair

    def repaired(self, elapsed_ns: list[int], *, by: str) -> list[int]:
        """t after the repair, less the true time, of frames stamped by the kernel or log time."""
        log = np.array([self.log_ns(at + self.lag_ns) for at in elapsed_ns])
        t = log if by == "log" else np.array([at + self.utc_offset(at) for at in elapsed_ns])
        true = np.array(elapsed_ns) + TRUE_NS + (self.lag_ns if by == "log" else 0)
        wrong_by: list[int] = (self.repair().t_ns(t, log) - true).tolist()
        return wrong_by


FRAMES = [SECOND + n * 37_000_000 for n in range(1, 750)]


@pytest.mark.parametrize("by", ["kernel", "log"])
@pytest.mark.parametrize("new", [True, False])
@pytest.mark.parametrize(
    ("wrong_ns", "set_at"),
    [
        (-TRUE_NS, [(12 * SECOND, TRUE_NS)]),
        (-40 * 86_400 * SECOND, [(1_500_000_000, 40 * 86_400 * SECOND)]),
        (7_200 * SECOND, [(9 * SECOND, -7_200 * SECOND)]),
        (-TRUE_NS, [(5 * SECOND, TRUE_NS - 3 * SECOND), (20 * SECOND, 3 * SECOND)]),
        (0, [(5 * SECOND, 3_600 * SECOND), (20 * SECOND, -3_600 * SECOND)]),
        (-2 * SECOND, [(5 * SECOND, SECOND), (6_500_000_000, SECOND)]),
    ],
)
def test_all_stamps_are_true_after_the_repair(
    wrong_ns: int, set_at: list[tuple[int, int]], by: str, new: bool
) -> None:
    recorder = Recorder(wrong_ns, set_at, with_new_fields=new)
    assert set(recorder.repaired(FRAMES, by=by)) == {0}


@given(
    st.lists(
        st.tuples(
            st.tuples(st.integers(1, 12), st.integers(0, SECOND)).map(
                lambda at: at[0] * 2 * SECOND + at[1]
            ),
            st.integers(1, 10**7).map(lambda ms: ms * 1_000_000 + SECOND),
            st.booleans(),
        ),
        min_size=1,
        max_size=3,
        unique_by=lambda each: each[0] // (2 * SECOND),
    ),
    st.sampled_from(["kernel", "log"]),
    st.integers(0, 50_000_000),
)
@settings(max_examples=60, deadline=None)
def test_whatever_was_set_the_stamps_become_true(
    moves: list[tuple[int, int, bool]], by: str, lag_ns: int
) -> None:
    steps = [(at, step if forward else -step) for at, step, forward in moves]
    recorder = Recorder(-sum(step for _, step in steps), steps, lag_ns=lag_ns)
    assert set(recorder.repaired(FRAMES, by=by)) <= {0}


def test_a_clock_that_was_never_set_needs_no_repair() -> None:
    assert Recorder(0, []).history().repair() is None


def test_slewing_needs_no_repair() -> None:
    recorder = Recorder(0, [(n * SECOND, 400_000) for n in range(2, 30)])
    assert recorder.history().repair() is None


def test_a_date_that_was_never_told_cannot_be_repaired() -> None:
    history = Recorder(-TRUE_NS, [(5 * SECOND, 10 * SECOND)]).history()
    assert history.repair() is None
    assert history.last_utc_ns < PLAUSIBLE_NS


def test_a_clock_that_lost_its_date_is_believed_before_that() -> None:
    recorder = Recorder(0, [(10 * SECOND, -TRUE_NS)])
    assert set(recorder.repaired(FRAMES, by="kernel")) == {0}


def test_the_samples_of_a_later_segment_repair_the_earlier() -> None:
    recorder = Recorder(-TRUE_NS, [(20 * SECOND, TRUE_NS)])
    first, both = ClockHistory(), ClockHistory()
    for log_ns, sample in recorder.samples[:10]:
        first.add(log_ns, sample)
    assert first.repair() is None
    for log_ns, sample in (*recorder.samples[:10], *recorder.samples[25:]):
        both.add(log_ns, sample)
    repair = both.repair()
    assert repair is not None
    log = np.array([recorder.log_ns(at) for at in FRAMES[:200]])
    t = np.array([at + recorder.utc_offset(at) for at in FRAMES[:200]])
    assert repair.t_ns(t, log).tolist() == [at + TRUE_NS for at in FRAMES[:200]]
    assert repair.largest_ns == TRUE_NS


def test_samples_of_adapters_are_none_of_the_recorders_clock() -> None:
    history = ClockHistory()
    history.add(5, syncline_pb2.ClockSample(utc_ns=TRUE_NS, bus=0, adapter_ns=3))
    assert history.epochs == []


def test_gaps_move_with_log_time() -> None:
    recorder = Recorder(-TRUE_NS, [(12 * SECOND, TRUE_NS)])
    repair = recorder.repair()
    for at in (5 * SECOND, 25 * SECOND):
        assert repair.log_t_ns(recorder.log_ns(at)) == at + TRUE_NS


@settings(max_examples=40, deadline=None)
@given(
    wrong_s=st.integers(-7200, 7200),
    steps=st.lists(st.tuples(st.integers(1, 29), st.integers(-3600, 3600)), max_size=4),
    cuts=st.lists(st.integers(1, 33), max_size=3),
)
def test_what_files_tell_at_their_end_is_what_their_samples_tell(
    wrong_s: int, steps: list[tuple[int, int]], cuts: list[int]
) -> None:
    recorder = Recorder(wrong_s * SECOND, [(at * SECOND, by * SECOND) for at, by in sorted(steps)])
    edges = [0, *sorted(cuts), len(recorder.samples)]
    told = ClockHistory()
    for begin, end in pairwise(edges):
        of_file = ClockHistory()
        for log_ns, sample in recorder.samples[begin:end]:
            of_file.add(log_ns, sample)
        assert told.add_record(of_file.to_record()) == (begin < end)
    history = recorder.history()
    assert (told.epochs, told.last_utc_ns) == (history.epochs, history.last_utc_ns)
    assert told.repair() == history.repair()


def test_files_tell_nothing_where_their_samples_are_needed() -> None:
    assert Recorder(0, [], with_new_fields=False).history().to_record() == {}
    assert ClockHistory().to_record() == {}
    history = Recorder(0, []).history()
    history.add(0, syncline_pb2.ClockSample(bus=0, adapter_ns=1, mapped_ns=2, residual_ns=3))
    assert history.to_record() == {}
    for broken in ("", "{}", '{"epochs": []}', '{"epochs": [[1]], "last": [1, 2, 3]}', "[1]"):
        assert not ClockHistory().add_record({"clocks": broken})
