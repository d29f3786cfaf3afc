"""Our readers and writers against python-can's, on what both can hold."""

from pathlib import Path

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from syncline_analyzer.convert import convert
from syncline_schemas.batch import FrameBatch, FrameFlag
from tests.analyzer.log_builder import Row, frame_rows, message, read, row, rows

PROPERTY = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
# A float of today's epoch has steps of 238 ns, and the writers cut after the microsecond.
FLOAT_NS = 1500


def _written(path: Path, writer: type[can.io.generic.MessageWriter], frames: list[Row]) -> Path:
    with writer(str(path)) as log:
        for frame in frames:
            log.on_message_received(message(frame))
    return path


def _without_time(frames: list[Row]) -> list[tuple[int, int, int, int, bytes]]:
    return [frame[1:] for frame in frames]


def _buses_by_name(batch: FrameBatch, names: list[str], wanted: list[str]) -> list[Row]:
    number = {name: wanted.index(name) for name in names}
    return [(t, number[names[bus]], *rest) for t, bus, *rest in rows(batch)]  # type: ignore[misc]


def _times_agree(ours: list[Row], theirs: list[Row], tolerance_ns: int) -> bool:
    return all(abs(a[0] - b[0]) <= tolerance_ns for a, b in zip(ours, theirs, strict=True))


@PROPERTY
@given(frames=frame_rows(error=False, back=False))
def test_candump_logs_of_python_can_are_read(tmp_path: Path, frames: list[Row]) -> None:
    path = _written(tmp_path / "x.log", can.CanutilsLogWriter, frames)
    batch, facts, _ = read(path)
    found = _buses_by_name(batch, facts.buses, ["can0", "can1"])
    # Its writer forgets the length that a remote frame asks for.
    expected = [
        (*frame[:4], 0 if frame[3] & FrameFlag.REMOTE else frame[4], frame[5]) for frame in frames
    ]
    assert _without_time(found) == _without_time(expected)
    assert _times_agree(found, expected, FLOAT_NS)


@PROPERTY
@given(frames=frame_rows(back=False))
def test_asc_logs_of_python_can_are_read(tmp_path: Path, frames: list[Row]) -> None:
    path = _written(tmp_path / "x.asc", can.ASCWriter, frames)
    batch, facts, _ = read(path)
    found = _buses_by_name(batch, facts.buses, ["1", "2"])
    # Its writer keeps nothing of an error frame, and drops the time below 1 ms from the date.
    expected = [
        (frame[0], frame[1], 0, int(FrameFlag.ERROR), 8, bytes(8))
        if frame[3] & FrameFlag.ERROR
        else frame
        for frame in frames
    ]
    assert _without_time(found) == _without_time(expected)
    assert _times_agree(found, expected, 10**6 + FLOAT_NS)


@PROPERTY
@given(frames=frame_rows(back=False))
def test_blf_logs_of_python_can_are_read(tmp_path: Path, frames: list[Row]) -> None:
    path = _written(tmp_path / "x.blf", can.BLFWriter, frames)
    batch, facts, _ = read(path)
    found = _buses_by_name(batch, facts.buses, ["1", "2"])
    assert _without_time(found) == _without_time(frames)
    assert _times_agree(found, frames, FLOAT_NS)


@PROPERTY
@given(frames=frame_rows(back=False, fd=False, remote=False, error=False))
def test_trc_logs_of_python_can_are_read(tmp_path: Path, frames: list[Row]) -> None:
    path = _written(tmp_path / "x.trc", can.TRCWriter, frames)
    batch, facts, _ = read(path)
    found = _buses_by_name(batch, facts.buses, ["1", "2"])
    assert _without_time(found) == _without_time(frames)
    assert _times_agree(found, frames, 2 * FLOAT_NS)


@PROPERTY
@given(frames=frame_rows(buses=1, fd=False))
def test_csv_logs_of_python_can_are_read(tmp_path: Path, frames: list[Row]) -> None:
    path = _written(tmp_path / "x.csv", can.CSVWriter, frames)
    batch, _, _ = read(path)
    assert [(f[2], f[4], f[5]) for f in rows(batch)] == [(f[2], f[4], f[5]) for f in frames]
    assert _times_agree(rows(batch), frames, FLOAT_NS)


def _ours(tmp_path: Path, frames: list[Row], ending: str) -> Path:
    """The frames as a log that our writer made, by way of a candump log made by hand."""
    source, target = tmp_path / "source.log", tmp_path / f"x{ending}"
    source.write_text("".join(map(_candump_line, frames)), encoding="ascii")
    convert([source], target)
    return target


def _candump_line(frame: Row) -> str:
    t_ns, bus, can_id, bits, dlc, data = frame
    flags = FrameFlag(bits)
    if FrameFlag.ERROR in flags:
        name = f"{can_id | 0x20000000:08X}"
    else:
        name = f"{can_id:08X}" if FrameFlag.EXTENDED in flags else f"{can_id:03X}"
    if FrameFlag.REMOTE in flags:
        text = f"#R{dlc}"
    elif FrameFlag.FD in flags:
        text = f"##{(FrameFlag.BRS in flags) + 2 * (FrameFlag.ESI in flags)}{data.hex().upper()}"
    else:
        text = f"#{data.hex().upper()}"
    way = " T" if FrameFlag.TX in flags else ""
    return f"({t_ns // 10**9}.{t_ns % 10**9 // 1000:06d}) can{bus} {name}{text}{way}\n"


READERS: dict[str, type[can.io.generic.MessageReader]] = {
    ".log": can.CanutilsLogReader,
    ".asc": can.ASCReader,
    ".blf": can.BLFReader,
    ".trc": can.TRCReader,
}


@pytest.mark.parametrize("ending", READERS)
@PROPERTY
@given(data=st.data())
def test_python_can_reads_what_we_write(tmp_path: Path, ending: str, data: st.DataObject) -> None:
    # Its TRC reader cannot read the FD length code nor error frames; its candump reader knows one
    # class of error frames; its ASC reader takes empty FD frames for remote ones.
    plain = ending == ".trc"
    frames = data.draw(frame_rows(fd=not plain, error=ending == ".blf", buses=1))
    if ending == ".asc":
        frames = [frame for frame in frames if not (frame[3] & FrameFlag.FD and not frame[5])]
    frames = frames or [row()]
    path = _ours(tmp_path, frames, ending)
    found = list(READERS[ending](str(path)))
    assert len(found) == len(frames)
    for theirs, ours in zip(found, frames, strict=True):
        expected = message(ours)
        assert theirs.arbitration_id == expected.arbitration_id
        assert theirs.is_remote_frame == expected.is_remote_frame
        assert theirs.is_error_frame == expected.is_error_frame
        assert theirs.is_fd == expected.is_fd
        assert theirs.dlc == expected.dlc
        assert bytes(theirs.data) == bytes(expected.data)
        if not theirs.is_error_frame:
            assert theirs.is_extended_id == expected.is_extended_id
            assert theirs.is_rx == expected.is_rx


@pytest.mark.parametrize(
    "ending", [".log", ".log.zst", ".asc", ".blf", ".trc", ".csv", ".pcapng", ".mcap"]
)
@PROPERTY
@given(data=st.data())
def test_what_we_write_we_read_again(tmp_path: Path, ending: str, data: st.DataObject) -> None:
    contents = ending not in (".asc", ".trc")
    frames = data.draw(frame_rows())
    batch, facts, _ = read(_ours(tmp_path, frames, ending))
    order = [f"can{frame[1]}" for frame in frames]
    names = list(dict.fromkeys(order))
    if ending in (".asc", ".trc", ".blf"):
        renamed = {str(number + 1): name for number, name in enumerate(names)}
        facts.buses[:] = [renamed[name] for name in facts.buses]
    found = _buses_by_name(batch, facts.buses, ["can0", "can1"])
    if not contents:
        found = [_no_error_contents(frame) for frame in found]
        frames = [_no_error_contents(frame) for frame in frames]
    assert found == frames


def _no_error_contents(frame: Row) -> Row:
    if frame[3] & FrameFlag.ERROR:
        return (*frame[:2], 0, frame[3], 0, b"")
    return frame
