"""The live view: what it shows, and that nothing that happens to it harms the recording."""

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from can.interfaces.virtual import VirtualBus
from click.testing import CliRunner

from syncline_logger import cli
from syncline_logger.bus_options import BusOptions
from syncline_logger.live_view import feed
from syncline_logger.live_view.feed import BROKEN, CLOSED, NO_WINDOW, LiveView
from syncline_logger.live_view.process import NOT_OPENED
from syncline_logger.live_view.scene import Scene, Shown
from syncline_logger.live_view.taken import Begun, Heard, Taken
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record
from syncline_logger.recording import RecordResult
from syncline_logger.sources.python_can import PythonCanSource
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.capture.scan import CaptureScan
from syncline_schemas.description import BusDescription
from syncline_schemas.errors import MissingExtraError
from tests.logger.capture_contents import read_capture
from tests.logger.test_recorder import message

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "samples"
S = 1_000_000_000
FRAMES = [(0x701 + n % 7, f"{n % 128:02X}") for n in range(3000)]
STUCK = (sys.executable, "-c", "import time; time.sleep(600)")
GOES = (sys.executable, "-c", "import sys; sys.stdin.buffer.read(20)")


def batches(name: str, step_ns: int = S // 2) -> Iterator[Taken]:
    """The frames of a sample as a recorder takes them in, every half a second."""
    found = [item for item in CaptureScan(SAMPLES / name).batches() if isinstance(item, FrameBatch)]
    frames = FrameBatch.concat(found)
    begin_ns, end_ns = int(frames.t_ns[0]), int(frames.t_ns[-1]) + 1
    edges = np.arange(begin_ns, end_ns, step_ns)
    for at_ns in edges.tolist():
        part = frames[(frames.t_ns >= at_ns) & (frames.t_ns < at_ns + step_ns)]
        yield Taken(part, part.t_ns, (Heard(0, begin_ns, min(at_ns + step_ns, end_ns)),))


def begun(name: str, start_ns: int) -> Begun:
    text = (SAMPLES / f"{name}.toml").read_text(encoding="utf-8")
    description = BusDescription.loads(text)
    bus = BusInfo("can0", 0, 500_000)
    return Begun(start_ns, (bus,), text, dict(description.files))


def shown(name: str = "bad_day") -> Shown:
    """Everything that the live view would show of a sample."""
    taken = list(batches(f"{name}.mcap"))
    scene = Scene(begun(name, int(taken[0].log_ns[0])))
    everything = Shown()
    for each in taken:
        part = scene.take(each)
        everything.states += part.states
        everything.log += part.log
        everything.signals += part.signals
        everything.loads += part.loads
    return everything


def test_states_emcys_values_and_load_of_the_bad_day_are_shown() -> None:
    expected = json.loads((SAMPLES / "bad_day.expected.json").read_text(encoding="utf-8"))
    found = shown()
    emcys = [row for row in found.log if ": EMCY " in row.text]
    assert len(emcys) == sum(node["emcy"] for node in expected["nodes"])
    assert [row for row in emcys if "8130h no guard request" in row.text]
    last = {row.node.number: row.state for row in found.states}
    for node in expected["nodes"]:
        if node["heartbeats"] > node["empty_heartbeats"]:
            assert last[node["node"]] == node["final_state"]
    lost = [row for row in found.states if row.state == "LOST"]
    assert "3 press drive" in {row.node.label for row in lost}
    signals = {(row.node.number, row.name, row.unit) for row in found.signals}
    assert (10, "Slope longitudinal 16", "deg") in signals
    assert (3, "Position value", "counts") in signals
    load = np.mean([row.percent for row in found.loads])
    assert load == pytest.approx(expected["bus_load_percent"], rel=0.15)


def test_values_are_those_of_the_frames() -> None:
    """JN2100 with 6000h = 100: 2 bytes in steps of 0.1 degree, as its manual has it."""
    frames = np.concatenate(
        [taken.frames.data[taken.frames.can_id == 0x18A] for taken in batches("bad_day.mcap")]
    )
    raw = frames[:, 0].astype(np.int64) | frames[:, 1].astype(np.int64) << 8
    rows = [row for row in shown().signals if row.name == "Slope longitudinal 16"]
    values = np.concatenate([row.values for row in rows])
    assert values[-50:] == pytest.approx(raw[-50:] * 0.1)


def record_virtual(
    folder: Path, view: LiveView | None, then: Callable[[], None] = lambda: None
) -> tuple[RecordResult, list[tuple[int, int, int, bytes]]]:
    """Record the frames of a virtual bus; the result and what is in the file."""
    stop = threading.Event()

    def send() -> None:
        with VirtualBus("live") as bus:
            for n, frame in enumerate(FRAMES):
                bus.send(message(*frame))
                if n == len(FRAMES) // 2:
                    then()
        time.sleep(0.3)
        stop.set()

    def started(path: Path) -> None:
        threading.Thread(target=send).start()

    result = record(
        [PythonCanSource(BusOptions("can0", "virtual", "live"))],
        folder,
        RecordOptions(flush_ns=100_000_000, sync=False),
        stop=stop,
        on_start=started,
        view=view,
    )
    if view:
        view.close()
    return result, read_capture(result.path).frames("can0")


def sent() -> list[tuple[int, int, int, bytes]]:
    return [(can_id, 0, 1, bytes.fromhex(data)) for can_id, data in FRAMES]


def test_the_recording_is_the_same_with_and_without_a_view(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed, "LAST_S", 60.0)
    told: list[str] = []
    target = tmp_path / "live.rrd"
    pytest.importorskip("rerun")
    with LiveView(told.append, str(target)) as view:
        result, frames = record_virtual(tmp_path / "a", view)
    assert view._process is not None
    assert view._process.returncode == 0
    plain, without = record_virtual(tmp_path / "b", None)
    assert frames == without == sent()
    assert (result.gap_count, plain.gap_count, told, view.dropped_frames) == (0, 0, [], 0)
    assert target.stat().st_size > 1000


def test_a_view_that_hangs_costs_no_frame_and_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed, "MAX_WAITING", 500)
    monkeypatch.setattr(feed, "LAST_S", 0.3)
    told: list[str] = []
    view = LiveView(told.append, command=STUCK)
    result, frames = record_virtual(tmp_path, view, lambda: time.sleep(0.5))
    assert frames == sent()
    assert (result.lost_frames, result.gap_count) == (0, 0)
    assert view.dropped_frames > 0
    assert told == [
        "the live view is behind; frames are recorded but not shown",
        f"{view.dropped_frames} frames were recorded but not shown in the live view",
    ]
    assert view._process is not None
    assert view._process.poll() is not None, "nothing is left behind"


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (GOES, CLOSED),
        ((sys.executable, "-c", f"raise SystemExit({NOT_OPENED})"), NO_WINDOW),
        ((sys.executable, "-c", "raise SystemExit(1)"), BROKEN),
    ],
)
def test_a_view_that_is_closed_is_told_once_and_the_recording_goes_on(
    tmp_path: Path, command: tuple[str, ...], words: str
) -> None:
    told: list[str] = []
    gone = threading.Event()

    def tell(text: str) -> None:
        told.append(text)
        gone.set()

    def wait() -> None:
        gone.wait(1.0)

    view = LiveView(tell, command=command)
    result, frames = record_virtual(tmp_path, view, wait)
    assert frames == sent()
    assert result.lost_frames == 0
    assert told == [words]


def test_a_view_that_cannot_be_started_is_told(tmp_path: Path) -> None:
    told: list[str] = []
    _, frames = record_virtual(tmp_path, LiveView(told.append, command=(str(tmp_path / "none"),)))
    assert frames == sent()
    assert len(told) == 1
    assert told[0].startswith("the live view cannot be started")


def test_without_a_viewer_nothing_is_recorded_and_one_line_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    words = ["record", "-i", "virtual", "-c", "x", "--view", "-o", str(tmp_path / "new")]
    result = CliRunner().invoke(cli.cli, words)
    assert isinstance(result.exception, MissingExtraError)
    assert 'pip install "syncline[analyzer]"' in str(result.exception)
    assert not (tmp_path / "new").exists()


def test_what_is_written_can_be_read_by_rerun(tmp_path: Path) -> None:
    """Every state, EMCY and value that the scene tells stands in the recording, at its time."""
    chunk = pytest.importorskip("rerun.chunk")
    from syncline_logger.live_view.viewer_sink import ViewerSink

    everything, path = shown(), tmp_path / "live.rrd"
    sink = ViewerSink(str(path), everything.states[0].t_ns)
    sink.show(everything)
    sink.close()
    rows: dict[str, int] = {}
    for each in chunk.RrdReader(str(path)).stream():
        if not each.is_static:
            rows[each.entity_path] = rows.get(each.entity_path, 0) + each.num_rows
    assert sum(n for entity, n in rows.items() if entity.startswith("/nmt/")) == len(
        everything.states
    )
    assert rows["/log"] == len(everything.log)
    values = sum(len(row.values) for row in everything.signals)
    assert sum(n for entity, n in rows.items() if entity.startswith("/values/")) == values


def test_the_viewer_is_reachable_from_this_machine_only(monkeypatch: pytest.MonkeyPatch) -> None:
    from syncline_logger.live_view import process

    commands: list[list[str]] = []

    class Viewer:
        def __init__(self, command: list[str], **options: object) -> None:
            commands.append(command)

        def wait(self) -> int:
            threading.Event().wait()
            return 0

    monkeypatch.setattr("subprocess.Popen", Viewer)
    address = process._open_viewer()
    assert address.startswith("rerun+http://127.0.0.1:")
    assert commands[0][commands[0].index("--bind") + 1] == "127.0.0.1"
