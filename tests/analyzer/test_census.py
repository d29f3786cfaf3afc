"""What the capture is said to hold."""

from syncline_schemas.batch import FrameFlag
from tests.analyzer.control_runs import MS, Row
from tests.analyzer.whole_run import beats, whole


def _fd_beats(node: int, count: int, *, bus: int = 0) -> list[Row]:
    return [
        (round(100 * k * MS), bus, 0x700 + node, int(FrameFlag.FD), 1, b"\x05")
        for k in range(count)
    ]


def test_can_fd_on_a_bus_is_told_with_the_number_of_its_frames() -> None:
    notes = whole(beats(1, 0, 500), _fd_beats(2, 7, bus=1), buses=("can0", "can1")).capture.notes
    assert [note for note in notes if "CAN FD" in note] == [
        "CAN FD on can1 (7 frames) counts as load only: CANopen FD is not read"
    ]


def test_a_classic_bus_has_no_note_of_can_fd() -> None:
    assert not [note for note in whole(beats(1, 0, 500)).capture.notes if "FD" in note]
