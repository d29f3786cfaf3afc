"""Whole analyses with the compiled loops and without them tell the same."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from syncline_schemas import native

SAMPLES = Path(__file__).parents[2] / "samples"


def told(capture: Path, switch: str) -> dict[str, Any]:
    """What `syncline analyze --format json` says of a capture."""
    ran = subprocess.run(
        [
            *(sys.executable, "-P", "-c"),
            "from syncline_logger.cli import main; main()",
            *("analyze", str(capture), "--format", "json"),
        ],
        capture_output=True,
        check=False,
        encoding="utf-8",
        env={**os.environ, native.SWITCH: switch},
    )
    found: dict[str, Any] = json.loads(ran.stdout)
    return found


@pytest.mark.skipif(not native.available(), reason="the library was not built")
@pytest.mark.parametrize("name", ["bad_day.mcap", "jittery_sync.log"])
def test_samples_tell_the_same_either_way(name: str) -> None:
    capture = SAMPLES / name
    if not capture.exists():
        pytest.skip("the samples are not here")
    compiled, plain = told(capture, "1"), told(capture, "0")
    assert compiled["findings"]
    assert compiled == plain
