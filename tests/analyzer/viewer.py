"""The real Rerun viewer without a screen: what it shows of a recording, in pixels."""

import importlib.util
import io
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

SCREENSHOT_TOOL = Path(__file__).parents[2] / "../shared/tools/rerun_screenshot.py"

Picture = NDArray[np.int64]
Edges = tuple[float, float, float, float]
"""Left, top, right and bottom of a part of the window, as shares of it."""


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    """What drives the viewer; tests that need it are skipped where it or a renderer is absent."""
    if not SCREENSHOT_TOOL.exists():
        pytest.skip("the screenshot tool is not here")
    spec = importlib.util.spec_from_file_location("rerun_screenshot", SCREENSHOT_TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["rerun_screenshot"] = module
    spec.loader.exec_module(module)
    if not any(Path(icd).exists() for icd in module.LAVAPIPE):
        pytest.skip("needs the packages libvulkan1 and mesa-vulkan-drivers")
    return module


def pixels_of(png: bytes) -> Picture:
    """(height, width, 3) of a picture."""
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int64)


@dataclass(frozen=True)
class Shown:
    """What the viewer made of a recording: pixels, titles of views, complaints."""

    pixels: Picture
    views: set[str]
    problems: list[str]

    def part(self, edges: Edges) -> Picture:
        """Pixels of a part of the window."""
        height, width, _ = self.pixels.shape
        left, top, right, bottom = edges
        rows = slice(int(top * height), int(bottom * height))
        return self.pixels[rows, int(left * width) : int(right * width)]

    def count(self, colour: tuple[int, int, int], edges: Edges) -> int:
        """Pixels of a colour in a part of the window."""
        return int((np.abs(self.part(edges) - np.array(colour)).max(-1) <= 4).sum())


def shot(tool: ModuleType, path: Path, at: str = "40%") -> Shown:
    """What the viewer shows of a file with its cursor there."""
    with tool.Shot(str(path)) as viewer:
        viewer.seek(None, at)
        png = viewer.settle(quiet=1.0)
        views = {view["name"] for view in viewer.state()["views"]}
        problems = viewer.problems()
    return Shown(pixels_of(png), views, problems)
