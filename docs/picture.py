"""Makes `pictures/session.png`: `python -m docs.picture path/to/rerun_screenshot.py [session.rrd]`.

The machine of the samples on its bad day, with a second encoder on the press drive's shaft that slips,
as the Rerun viewer shows it. The tool that drives the viewer is not part of this repository.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from PIL import Image

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.engine import analyze
from syncline_analyzer.results import Analysis
from syncline_analyzer.views.rerun_view import write_rrd
from syncline_samples.devices.lir import Lir
from syncline_samples.machine import Machine, Run
from syncline_samples.motion import Shaft
from syncline_samples.scenarios import PLATFORM, PRESS, bad_day, lir_stored_heartbeat
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.description import BusDescription

PICTURE = Path(__file__).parent / "pictures" / "session.png"
TWIN = 5
CURSOR = "97s"
_WIDTH = 1400
_MENU = 40
"""Height of the viewer's menu, which is cut off."""
_SIZE = "1600x1000"


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
    facts = CaptureFacts(Path("bad_day.mcap"), "simulated", run.bus_names)
    return analyze(
        _numbered(run.stream()), [facts], run.bus_names, description=description, devices={}
    )


def _numbered(stream: Iterator[FrameBatch | Gap]) -> Iterator[tuple[int, FrameBatch | Gap]]:
    seq = 0
    for item in stream:
        yield seq, item
        seq += len(item) if isinstance(item, FrameBatch) else 0


def photograph(tool: Path, recording: Path, picture: Path) -> None:
    """Write what the viewer shows of a recording, without its menu."""
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        told = [sys.executable, str(tool), str(recording), "-o", str(shot), "--size", _SIZE]
        subprocess.run([*told, "--timeline", "capture", "--at", CURSOR], check=True)
        whole = Image.open(shot).convert("RGB")
    shown = whole.crop((0, _MENU, whole.width, whole.height))
    height = round(shown.height * _WIDTH / shown.width)
    small = shown.resize((_WIDTH, height), Image.Resampling.LANCZOS)
    few_colours = small.quantize(method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few_colours.save(picture, optimize=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        rrd = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(temporary) / "session.rrd"
        photograph(Path(sys.argv[1]), write_rrd(analysis(), rrd), PICTURE)
