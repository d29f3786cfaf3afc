"""What happens to a running recording, as its own log tells it."""

import re
import threading
from pathlib import Path

import numpy as np

from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_condition import BusCondition
from syncline_logger.live_status import LiveStatus
from syncline_logger.notes import Note, gap_text
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record
from syncline_logger.recording import Recording
from syncline_logger.segments import Split
from syncline_logger.source import SourceFacts
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import BusInfo

S = 1_000_000_000
T0 = 1_760_000_000 * S


def live_bus() -> LiveStatus:
    return LiveStatus([BusInfo("can0", 0)], 0)


def heartbeats(live: LiveStatus, *beats: tuple[float, int]) -> list[str]:
    """What is told of node 5 after its heartbeats: second and state byte."""
    for t_s, byte in beats:
        t_ns = round(t_s * S)
        batch = FrameBatch.from_rows([(t_ns, 0, 0x705, 0, 1, bytes([byte]))])
        live.update(batch, batch.t_ns)
    return [change.text for change in live.take_changes()]


def test_each_change_of_a_node_is_told_once() -> None:
    live = live_bus()
    assert heartbeats(live, (0, 0), (1, 0x7F), (2, 5), (3, 5), (4, 4), (5, 5)) == [
        "node 5 boots, is heard, PRE-OPERATIONAL",
        "node 5 goes from PRE-OPERATIONAL to OPERATIONAL",
        "node 5 goes from OPERATIONAL to STOPPED",
        "node 5 goes from STOPPED to OPERATIONAL",
    ]


def test_a_node_that_is_lost_and_back_between_two_looks_is_told() -> None:
    live = live_bus()
    heartbeats(live, (0, 5), (1, 5), (2, 5))
    assert heartbeats(live, (5, 5)) == []
    assert heartbeats(live, (14.5, 5)) == ["node 5 was silent for 9.5 s"]
    assert heartbeats(live, (15, 0)) == [
        "node 5 boots, goes from OPERATIONAL to PRE-OPERATIONAL",
    ]


def test_a_silence_is_told_when_it_is_seen_and_when_it_ends() -> None:
    live = live_bus()
    heartbeats(live, (0, 5), (1, 5), (2, 5))
    live.listened(0, 0, 8 * S)
    live.snapshot(8 * S, "x", 0, [BusCondition("virtual")])
    live.snapshot(9 * S, "x", 0, [BusCondition("virtual")])
    assert [(each.log_ns, each.text) for each in live.take_changes()] == [
        (8 * S, "node 5 goes from OPERATIONAL to LOST")
    ]
    assert heartbeats(live, (12, 5)) == [
        "node 5 was silent for 10.0 s, goes from LOST to OPERATIONAL"
    ]


def test_who_could_not_be_heard_was_not_silent() -> None:
    live = live_bus()
    heartbeats(live, (0, 5), (1, 5), (2, 5))
    live.listened(0, 58 * S, 59 * S)
    assert heartbeats(live, (60, 5)) == [], "the recorder was deaf"
    heartbeats(live, *((second, 5) for second in range(61, 67)))
    late = FrameBatch.from_rows([(67 * S, 0, 0x705, 0, 1, b"\x05")])
    live.update(late, np.array([99 * S]))
    assert live.take_changes() == [], "the frame was handed over late"


def test_everything_that_happens_to_a_recording_is_noted(tmp_path: Path) -> None:
    notes: list[Note] = []
    options = RecordOptions(recording_id="ab", split=Split(time_ns=10 * S), decode=False)
    recording = Recording(
        tmp_path, [BusInfo("a", 0)], options, start_ns=T0, host="h", on_note=notes.append
    )
    batch = FrameBatch.from_rows([(T0 + S, 0, 0x705, 0, 1, b"\x05")])
    recording.take_frames(batch, batch.t_ns)
    recording.write(batch, batch.t_ns)
    gap = Gap(T0 + 2 * S, T0 + 4 * S, "unplugged", 3, 0)
    recording.add_gap(gap, T0 + 5 * S)
    recording.add_status(0, T0 + 5 * S, "listening again")
    recording.ask("it fell", T0 + 6 * S)
    later = FrameBatch.from_rows([(T0 + 11 * S, 0, 0x705, 0, 1, b"\x05")])
    recording.take_frames(later, later.t_ns)
    recording.write(later, later.t_ns)
    recording.finish(T0 + 12 * S, "stopped")
    first, second = "20251009T085320Z_ab_0000", "20251009T085331Z_ab_0001"
    assert [((note.log_ns - T0) // S, note.serious, str(note)) for note in notes] == [
        (0, False, f"writing {tmp_path / first}.part.mcap"),
        (1, False, "a: node 5 is heard, OPERATIONAL"),
        (
            5,
            True,
            f"a: {gap_text(gap)}",
        ),
        (5, False, "a: listening again"),
        (6, False, "mark: it fell"),
        (11, False, f"writing {tmp_path / second}.part.mcap"),
        (11, False, f"closed {tmp_path / first}.mcap: 1 frame, 0.0 MB"),
        (12, False, f"closed {tmp_path / second}.mcap: 1 frame, 0.0 MB"),
    ]


class Loses:
    """A source that loses frames twice, of which once the number is not known."""

    def __init__(self, stop: threading.Event) -> None:
        self.facts = SourceFacts("a", "virtual", "one")
        self._stop = stop

    def open(self) -> None:
        pass

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        if not self._stop.is_set():
            buffer.lose(bus, 36, "line", T0, T0 + S)
            buffer.lose(bus, None, "closed", T0 + 2 * S, T0 + 3 * S)
            self._stop.set()
        return 0

    def fileno(self) -> None:
        return None

    def close(self) -> None:
        pass


def test_a_loss_is_noted_once_with_its_number(tmp_path: Path) -> None:
    """Who adds up the own log gets what was lost."""
    stop, notes = threading.Event(), list[Note]()
    result = record(
        [Loses(stop)],
        tmp_path,
        RecordOptions(decode=False),
        stop=stop,
        on_note=notes.append,
    )
    texts = [note.text for note in notes if note.bus]
    assert len(texts) == len([note for note in notes if note.serious]) == 2
    assert sum(int(n) for text in texts for n in re.findall(r"(\d+) frames lost", text)) == 36
    assert result.lost_frames == 36
    assert [text for text in result.problems if "36 frames lost" in text], (
        "and stands in the capture"
    )
