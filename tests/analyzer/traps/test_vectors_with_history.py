"""What the sheets' vectors expect of a frame that only the frames before it can tell."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.analyzer.traps.script import OPERATIONAL, Script, Told

VECTORS = Path(__file__).parents[2] / "data" / "vectors" / "skbis-lir-canopen.json"


def vector(name: str) -> dict[str, Any]:
    listed = json.loads(VECTORS.read_text(encoding="utf-8"))
    return next(entry for entry in listed if entry["id"] == name)


def replayed(name: str, *, period: float = 100) -> Told:
    """A node whose heartbeat is on, then the frames of a vector 1 s later, one per period."""
    entry = vector(name)
    script = Script(entry["device"]).read(0, 0x1017, 0, round(period), size=2)
    script.heartbeat(10, 1000)
    for k, step in enumerate(entry["frames"]):
        script.frame(1010 + period * k, step["frame"])
    return script.told()


def test_lb01_a_7fh_after_the_reset_is_the_boot_up() -> None:
    assert vector("LB01")["frames"][1]["expect"]["bootup"] is True
    told = replayed("LB01")
    assert told.row().boot_ups == 1
    assert told.state_names()[-1] == "PRE-OPERATIONAL"


@pytest.mark.parametrize("name", ["LB03", "LB04"])
def test_an_empty_state_byte_after_a_remote_frame_is_no_boot_up(name: str) -> None:
    assert vector(name)["frames"][-1]["expect"]["empty"] is True
    told = replayed(name)
    assert told.row().boot_ups == 0
    assert "INITIALISING" not in told.state_names()
    assert told.states()[-1].state in ("OPERATIONAL", "UNKNOWN")


def test_the_same_byte_without_a_remote_frame_is_a_boot_up() -> None:
    script = Script("lir-ma158k").heartbeat(10, 1000, OPERATIONAL).boot(3000)
    assert script.told().row().boot_ups == 1
