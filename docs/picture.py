"""Makes the pictures of these pages: `python -m docs.picture [--tool rerun_screenshot.py] [NAME ...]`.

session, live: what the Rerun viewer shows; the tool that drives it is not part of this repository.
report: what a browser shows. terminal: what `syncline analyze` prints. Without a name all are made
that can be. It is the machine of the samples on its bad day, with a second encoder on the press
drive's shaft that slips.
"""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from io import StringIO
from pathlib import Path

import click
import numpy as np
from PIL import Image
from rich.console import Console

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.decode.choice import Choice
from syncline_analyzer.decode.stream import Decoding
from syncline_analyzer.engine import analyze
from syncline_analyzer.opened import Opened
from syncline_analyzer.reading import EVERYTHING
from syncline_analyzer.redaction import Redaction
from syncline_analyzer.results import Analysis
from syncline_analyzer.views.report_html import write_report
from syncline_analyzer.views.rerun_view import write_rrd
from syncline_analyzer.views.screen import print_screen
from syncline_logger.live_view.scene import Scene
from syncline_logger.live_view.taken import Begun, Heard, Taken
from syncline_logger.live_view.viewer_sink import ViewerSink
from syncline_samples.devices.lir import Lir
from syncline_samples.machine import Machine, Run
from syncline_samples.motion import Shaft
from syncline_samples.scenarios import PLATFORM, PRESS, bad_day, lir_stored_heartbeat
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.description import BusDescription

PICTURES = Path(__file__).parent / "pictures"
NEED_TOOL = ("session", "live")
NAMES = (*NEED_TOOL, "report", "terminal")
NAME = Path("line3.mcap")
TWIN = 5
CURSOR, LIVE_CURSOR = "97s", "55s"
LIVE_S = 56
"""Of the day that the live view has seen."""
_STEP_NS = 500_000_000
_WIDTH = 1400
_MENU = 40
"""Height of the viewer's menu, which is cut off."""
_SIZE = "1600x1000"
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")


class Slip:
    """The coupling of the second encoder slips by 12 degrees."""

    at_s = 94.0

    def arm(self, machine: Machine) -> None:
        """Schedule it."""
        machine.at(self.at_s, self._slip, machine)

    @staticmethod
    def _slip(machine: Machine) -> None:
        node = machine.nodes[TWIN]
        assert isinstance(node, Lir)
        node.jumped_counts += node.model.counts_per_turn // 30


def machine() -> tuple[Run, BusDescription]:
    """The machine with its second encoder, and a description that says what is known of both."""
    plain = bad_day()
    shaft = next(spec.motion for spec in plain.devices if spec.node_id == PRESS)
    assert isinstance(shaft, Shaft)
    twin = lir_stored_heartbeat(TWIN, "lir-da158a", "press drive 2", shaft, 500)
    run = Run(replace(plain, devices=(*plain.devices, twin), faults=(*plain.faults, Slip())))
    places = f"[bus.can0.node.{TWIN}]", f"[bus.can0.node.{PLATFORM}]"
    text = run.description_toml.replace(places[0], f"{places[0]}\nsame_shaft_as = {PRESS}")
    chosen = f'[bus.can0.node.{PLATFORM}.overrides]\nperp_formula = "asin"\n'
    return run, BusDescription.loads(text + chosen)


def analysis() -> Analysis:
    """What is found on that day."""
    run, description = machine()
    facts = CaptureFacts(NAME, "simulated", run.bus_names)
    return analyze(
        _numbered(run.stream()), [facts], run.bus_names, description=description, devices={}
    )


def _frames(start: int | None, end: int | None) -> Iterator[FrameBatch]:
    """The same frames once more: all of them, the recording chooses."""
    run, _ = machine()
    return (item for item in run.stream() if isinstance(item, FrameBatch))


def _decoding() -> Decoding:
    """The same frames in words."""
    run, description = machine()
    opened = Opened(
        facts=[CaptureFacts(NAME, "simulated", run.bus_names)],
        buses=run.bus_names,
        description=description,
        devices={},
        redaction=Redaction(),
        first_ns=None,
        low_ns=EVERYTHING.low_ns,
        high_ns=EVERYTHING.high_ns,
        stream=_numbered(run.stream()),
    )
    return Decoding(opened, Choice())


def _numbered(stream: Iterator[FrameBatch | Gap]) -> Iterator[tuple[int, FrameBatch | Gap]]:
    seq = 0
    for item in stream:
        yield seq, item
        seq += len(item) if isinstance(item, FrameBatch) else 0


def live(path: Path) -> Path:
    """What the live view would have drawn of the first part of that day."""
    run, description = machine()
    items = [item for item in run.stream() if isinstance(item, FrameBatch)]
    frames = FrameBatch.concat(items)
    begin_ns = int(frames.t_ns[0])
    bus = BusInfo("can0", 0, 500_000)
    begun = Begun(begin_ns, (bus,), description.text, dict(description.files))
    scene, sink = Scene(begun), ViewerSink(str(path), begin_ns)
    for now_ns in range(begin_ns, begin_ns + LIVE_S * 10**9, _STEP_NS):
        rows = np.flatnonzero((frames.t_ns >= now_ns) & (frames.t_ns < now_ns + _STEP_NS))
        part = frames[rows]
        sink.show(scene.take(Taken(part, part.t_ns, (Heard(0, begin_ns, now_ns + _STEP_NS),))))
    sink.close()
    return path


def photograph(tool: Path, recording: Path, picture: Path, at: str) -> None:
    """Write what the viewer shows of a recording, without its menu."""
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        told = [sys.executable, str(tool), str(recording), "-o", str(shot), "--size", _SIZE]
        subprocess.run([*told, "--timeline", "capture", "--at", at], check=True)
        whole = Image.open(shot).convert("RGB")
    _save(whole.crop((0, _MENU, whole.width, whole.height)), picture)


def page(browser: str, report: Path, picture: Path) -> None:
    """Write what a browser shows of the first screen of a report."""
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        subprocess.run(
            [
                *(browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"),
                *("--window-size=1400,1000", "--virtual-time-budget=5000"),
                *(f"--user-data-dir={folder}", f"--screenshot={shot}", report.as_uri()),
            ],
            check=True,
            capture_output=True,
        )
        _save(Image.open(shot).convert("RGB"), picture)


def terminal(found: Analysis, picture: Path) -> None:
    """Write what `syncline analyze` prints on a terminal of 120 columns."""
    console = Console(
        width=120, height=41, record=True, file=StringIO(), force_terminal=True,
        color_system="truecolor", highlight=False,
    )  # fmt: skip
    print_screen(found, console)
    svg = console.export_svg(title="syncline analyze line3.mcap", unique_id="syncline")
    picture.write_text(svg, encoding="utf-8")


def _save(shown: Image.Image, picture: Path) -> None:
    height = round(shown.height * _WIDTH / shown.width)
    small = shown.resize((_WIDTH, height), Image.Resampling.LANCZOS)
    few_colours = small.quantize(method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few_colours.save(picture, optimize=True)


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(NAMES))
@click.option("--tool", type=click.Path(exists=True, path_type=Path))
def main(names: tuple[str, ...], tool: Path | None) -> None:
    """Make the pictures of these names, or all that can be made."""
    browser = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    wanted = names or [
        name for name in NAMES if (tool or name not in NEED_TOOL) and (browser or name != "report")
    ]
    found = analysis() if {*wanted} - {"live"} else None
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in wanted:
            picture = PICTURES / f"{name}.png"
            if name == "live" and tool:
                photograph(tool, live(folder / "live.rrd"), picture, LIVE_CURSOR)
            elif name == "session" and tool and found:
                recording = write_rrd(found, folder / "s.rrd", _frames, decode=_decoding)
                photograph(tool, recording, picture, CURSOR)
            elif name == "report" and browser and found:
                page(browser, write_report(found, folder / "report.html"), picture)
            elif name == "terminal" and found:
                terminal(found, picture.with_suffix(".svg"))
            else:
                raise click.UsageError(f"{name} needs what is not here: --tool or a browser")


if __name__ == "__main__":
    main()
