"""`syncline fleet view`: a catalog of real recordings on this machine, and what is seen of it."""

import importlib.util
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

pytest.importorskip("distributed")
pytest.importorskip("datafusion")

import numpy as np
from click.testing import CliRunner, Result
from datafusion import col, lit
from numpy.typing import NDArray
from rerun.catalog import CatalogClient, DatasetEntry

from syncline_analyzer.fleet.catalog import Catalog, recorded, recordings, served
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.scope import Scope
from syncline_analyzer.fleet.task import Settings
from syncline_analyzer.fleet_command import fleet as command
from syncline_analyzer.views.fleet_catalog import (
    MAX_DEVICES,
    capture_layout,
    property_column,
    table_blueprint,
)
from syncline_samples.fleet import Planted
from syncline_schemas.errors import UsageError
from tests.analyzer.fleet.fleet_builder import analyze, capture, small_log, small_mcap

TOOL = Path(__file__).parents[3] / "../shared/tools/rerun_screenshot.py"
OPERATIONAL = (53, 125, 56)
"""Lane of a node as the viewer shades it."""
FINDING = (211, 47, 47)
Picture = NDArray[np.int64]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A healthy machine, one with resets on its second day, and a plain log; as users do it."""
    folder = tmp_path_factory.mktemp("seen")
    for machine, day in ((0, 0), (1, 0), (1, 1)):
        capture(folder / "in", machine, day, Planted(resets=2 * day))
    small_log(folder / "in" / "odd one" / "night.log")
    wanted = ("--out", folder / "out", "--rrd", "--reports", "--workers", 1)
    done = syncline("analyze", folder / "in", *wanted)
    assert f"Wrote {(folder / 'out').as_posix()}/report.html." in done
    return folder / "out"


@pytest.fixture(scope="module")
def catalog(data: Path) -> Iterator[Catalog]:
    opened = Dataset.open(str(data))
    with recordings(opened.storage, recorded(opened)) as files, served(files) as found:
        yield found


@pytest.fixture(scope="module")
def table(catalog: Catalog) -> DatasetEntry:
    return CatalogClient(catalog.url).get_dataset("fleet")


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    if not TOOL.exists():
        pytest.skip("the screenshot tool is not here")
    spec = importlib.util.spec_from_file_location("rerun_screenshot", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["rerun_screenshot"] = module
    spec.loader.exec_module(module)
    if not any(Path(icd).exists() for icd in module.LAVAPIPE):
        pytest.skip("needs the packages libvulkan1 and mesa-vulkan-drivers")
    return module


def syncline(*arguments: object) -> str:
    """What `syncline fleet` says, in a process of its own."""
    program = "from syncline_logger.cli import main; main()"
    command = [sys.executable, "-c", program, "fleet", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    return done.stderr


def run(*arguments: object) -> Result:
    return CliRunner().invoke(command, ["view", *map(str, arguments)])


def test_the_report_of_the_fleet_is_beside_those_of_the_captures(data: Path) -> None:
    page = (data / "report.html").read_text(encoding="utf-8")
    entries = Dataset.open(str(data)).captures
    assert len(entries) == 4
    for entry in entries:
        assert f'href="reports/{entry.partition.capture_id}.html"' in page
        assert (data / "reports" / f"{entry.partition.capture_id}.html").is_file()


def test_captures_are_found_by_their_properties(table: DatasetEntry, data: Path) -> None:
    entries = {e.partition.capture_id: e for e in Dataset.open(str(data)).captures}
    assert set(table.segment_ids()) == set(entries)
    errors = col(f'"{property_column("errors")}"')[0]
    bad = table.segment_table().filter(errors >= lit(1)).to_pandas()
    (row,) = bad.to_dict("records")
    entry = entries[row["rerun_segment_id"]]
    told = {
        name.removeprefix("property:syncline:"): list(value)
        for name, value in zip(map(str, row), row.values(), strict=True)
        if name.startswith("property:syncline:")
    }
    assert told == {
        "machine": ["machine-001"],
        "date": [entry.partition.date],
        "capture_id": [entry.partition.capture_id],
        "verdict": ["error"],
        "errors": [entry.values["errors"]],
        "warnings": [entry.values["warnings"]],
        "infos": [entry.values["infos"]],
        "worst": told["worst"],
        "nodes": [7],
        "frames": [entry.values["frames"]],
        "duration_s": [entry.values["duration_ns"] / 1e9],
        "blind_s": [0.0],
        "buses": ["can0"],
        "bitrates": [500_000],
    }
    assert "Node 2" in told["worst"][0]
    machine = col(f'"{property_column("machine")}"')[0]
    odd = table.segment_table().filter(machine == lit("odd one")).to_pandas()
    assert odd["property:RecordingInfo:name"].tolist() == ["odd one 2026-03-02 06:00"]


def test_frames_of_all_machines_are_one_table(table: DatasetEntry) -> None:
    states = table.filter_contents(["/nmt/**"]).reader(index="utc").to_pandas()
    assert states["rerun_segment_id"].nunique() == 4


def test_one_layout_and_one_table_for_all(table: DatasetEntry) -> None:
    assert len(table.blueprints()) == 2
    layout = table.default_blueprint()
    assert layout is not None
    assert layout != table.default_segment_table_blueprint() is not None


def test_only_this_machine_can_look(catalog: Catalog) -> None:
    assert catalog.url.startswith("rerun+http://127.0.0.1:")
    port = int(catalog.url.rpartition(":")[2])
    with socket.socket() as other:
        other.settimeout(2)
        assert other.connect_ex(("127.0.0.2", port)) != 0, "127.0.0.1 alone is bound"


def test_layout_has_tabs_by_device_or_by_quantity_where_they_are_many() -> None:
    few = [f"/plots/angle_deg/node_{n}_shaft/0" for n in range(1, 4)]
    many = [f"/plots/angle_deg/node_{n}_shaft/0" for n in range(1, MAX_DEVICES + 2)]
    assert "1 shaft" in _names(few)
    assert "Angle [deg]" in _names(many)
    assert "1 shaft" not in _names(many)
    assert _names([]) >= {"Findings", "EMCY log"}


def _names(entities: list[str]) -> set[str]:
    """Names of all views and tabs of a layout."""
    found, left = set(), [capture_layout(entities).root_container]
    while left:
        part = left.pop()
        found.add(getattr(part, "name", None))
        left.extend(getattr(part, "contents", None) or [])
        left = [each for each in left if not isinstance(each, str)]
    return {str(name) for name in found}


def test_columns_of_the_table_are_there(table: DatasetEntry) -> None:
    known = set(table.segment_table().schema().names) | {"recording link"}
    blueprint = table_blueprint()
    assert blueprint.table_layout is not None
    named = {column.source for column in blueprint.table_layout.columns}
    assert named <= known, named - known


def test_scope_chooses_recordings_the_latest_first(data: Path) -> None:
    opened = Dataset.open(str(data))
    chosen = recorded(opened, Scope.of("machine-*", "2026-03-03", None))
    assert [entry.partition.machine for entry in chosen] == ["machine-001"]
    assert recorded(opened, Scope.of(None, None, "2026-03-02T06:00:30"))[0].partition.machine in (
        "machine-000",
        "odd one",
    )


def test_damaged_recordings_are_told_and_stop_nothing(data: Path, tmp_path: Path) -> None:
    opened = Dataset.open(str(data))
    with recordings(opened.storage, recorded(opened)) as files:
        broken = tmp_path / "broken.rrd"
        broken.write_bytes(b"no recording at all")
        with served({**files, "broken": broken}) as found:
            assert (found.captures, found.unread) == (4, ["broken"])


def test_recordings_of_an_object_store_are_copied(data: Path) -> None:
    import fsspec

    memory = fsspec.filesystem("memory")
    memory.put(str(data), "/seen", recursive=True)
    opened = Dataset.open("memory://seen")
    chosen = recorded(opened, Scope.of("odd one", None, None))
    gone = recorded(opened, Scope.of("machine-000", None, None))[0]
    memory.rm(f"/seen/recordings/{gone.partition.capture_id}.rrd")
    with recordings(opened.storage, [*chosen, gone]) as files:
        (path,) = files.values()
        assert path.read_bytes() == (data / "recordings" / path.name).read_bytes()
    assert not path.exists()


def test_what_cannot_be_shown_is_said(data: Path, tmp_path: Path) -> None:
    assert "no data set is here" in str(run(tmp_path).exception)
    assert "no capture of this machine and time" in str(run(data, "--machine", "x").exception)
    assert "name one" in str(run(data, "--web", "--no-open").exception)
    small_mcap(tmp_path / "in" / "a.mcap")
    out = tmp_path / "out"
    analyze(tmp_path / "in", out)
    gone = tmp_path / "gone"
    analyze(tmp_path / "in", gone, settings=Settings(extras=("recording",)))
    (path,) = (gone / "recordings").iterdir()
    path.unlink()
    for place in (out, gone):
        told = str(run(place, "--no-open").exception)
        assert told.endswith(f"make them: syncline fleet analyze SOURCE... --out {place} --rrd")


def test_a_port_that_is_taken_is_said(data: Path) -> None:
    opened = Dataset.open(str(data))
    with recordings(opened.storage, recorded(opened)) as files, socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(UsageError, match=f"--port {port}: "), served(files, port):
            pass


@pytest.mark.skipif(os.name == "nt", reason="Ctrl-C reaches the whole console there")
def test_command_serves_until_it_is_interrupted(data: Path) -> None:
    # Where the tests run in the background, SIGINT is ignored and would stay so.
    heeds = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    program = f"{heeds}; from syncline_logger.cli import main; main()"
    started = subprocess.Popen(
        [sys.executable, "-c", program, "fleet", "view", str(data), "--no-open", "--limit", "3"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )
    assert started.stdout is not None
    url = started.stdout.readline().strip()
    assert len(CatalogClient(url.partition("/entry/")[0]).get_dataset("fleet").segment_ids()) == 3
    started.send_signal(signal.SIGINT)
    _, words = started.communicate(timeout=30)
    assert started.returncode == 0, words
    assert "1 older capture left out" in words
    assert "3 captures at rerun+http://127.0.0.1:" in words


def shot(tool: ModuleType, url: str) -> tuple[Picture, list[str]]:
    """Pixels of what the viewer shows of a URL of the catalog, without its top bar; complaints."""
    from io import BytesIO
    from time import sleep

    from PIL import Image

    class Catalogued(tool.Shot):  # type: ignore[name-defined, misc]
        def _loaded(self) -> bool:
            return True

    with Catalogued(url, size="1600x1000") as shown:
        sleep(2)
        image = Image.open(BytesIO(shown.settle())).convert("RGB")
        return np.asarray(image).astype(np.int64)[40:], shown.problems()


def count(pixels: Picture, colour: tuple[int, int, int]) -> int:
    return int((np.abs(pixels - np.array(colour)).max(-1) <= 6).sum())


def test_viewer_shows_the_table_and_each_capture_by_one_layout(
    tool: ModuleType, catalog: Catalog, table: DatasetEntry, data: Path
) -> None:
    pixels, problems = shot(tool, catalog.table_url)
    assert problems == []
    rows = pixels[170:360, 240:]
    assert (rows.max(-1) > 150).sum() > 2500, "text of four rows"
    assert (pixels[420:].max(-1) > 150).sum() < 1500, "and nothing below them"
    for entry in Dataset.open(str(data)).captures:
        if entry.partition.machine == "machine-001":
            pixels, problems = shot(tool, table.segment_url(entry.partition.capture_id))
            assert problems == []
            assert count(pixels[:, :990], OPERATIONAL) > 20_000
            assert (count(pixels[:, :990], FINDING) >= 20) == (entry.values["errors"] > 0)
