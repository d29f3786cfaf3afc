"""Decoding behind its bounded queue."""

import threading

import numpy as np
from numpy.typing import NDArray

from syncline_logger.decode_worker import QUEUED_BATCHES, DecodeWorker
from syncline_logger.decoding import Decoded, LiveDecoder
from syncline_schemas.batch import FrameBatch

FRAMES = FrameBatch.from_rows([(0, 0, 0x705, 0, 1, b"\x05")] * 3)
TIMES = np.zeros(3, np.int64)


class SlowDecoder(LiveDecoder):
    """A decoder that works only when it is let."""

    def __init__(self) -> None:
        super().__init__({0: "a"})
        self.go = threading.Event()
        self.begun = threading.Event()

    def decode(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> Decoded:
        self.begun.set()
        self.go.wait(30)
        return super().decode(frames, log_ns)


def test_what_is_decoded_in_time_is_there_at_once() -> None:
    worker = DecodeWorker(LiveDecoder({0: "a"}))
    assert worker.submit(FRAMES, TIMES)
    [decoded] = worker.results(30)
    assert len(decoded.blocks) == 1
    assert worker.finish(1) == []


def test_a_slow_decoder_holds_nobody_up_and_its_losses_are_counted() -> None:
    decoder = SlowDecoder()
    worker = DecodeWorker(decoder)
    assert worker.submit(FRAMES, TIMES)
    decoder.begun.wait(30)
    assert all(worker.submit(FRAMES, TIMES) for _ in range(QUEUED_BATCHES))
    assert not worker.submit(FRAMES, TIMES)
    assert worker.dropped_frames == 3
    assert worker.results(0) == []
    decoder.go.set()
    assert len(worker.finish(30)) == 1 + QUEUED_BATCHES


def test_a_decoder_that_raises_says_so_once() -> None:
    decoder = LiveDecoder({0: "a"})
    decoder.decode = None  # type: ignore[assignment,method-assign]
    worker = DecodeWorker(decoder)
    for _ in range(2):
        worker.submit(FRAMES, TIMES)
    problems = [problem for decoded in worker.finish(30) for problem in decoded.problems]
    assert len(problems) == 1
