"""Every real capture against what an independent program counted in it."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_schemas.batch import FrameBatch, FrameFlag
from tests.analyzer.log_builder import CAPTURES, read

FACTS = sorted((CAPTURES / "facts").glob("*.json"))
pytestmark = pytest.mark.skipif(not FACTS, reason="the real captures are not here")

# Where the facts count from the start of the log, our times are UTC by the date in its header.
ORIGIN_NS = {
    "hilch_ixxat1.trc": 1738061235 * 10**9,  # Date: 28.01.2025, Start time: 10:47:15
    "hilch_pcan2.trc": 1649163686038997760,  # $STARTTIME=44656.5426624884
    "sevcon_20090330_preop.asc": 1238424718002000000,  # Mon Mar 30 14:51:58.002 2009
}
FORMATS = {
    "abb_cm588_candump.txt": ("candump", "none", 1),
    "bg_can0_20260113_193431.log": ("candump", "utc", 1000),
    "canopendemo_sdo_block_fragment.txt": ("candump", "relative", 1000),
    "deltaq_can1_log.csv": ("csv", "utc", 1000),
    "hilch_ixxat1.trc": ("ixxat", "utc", 10_000_000),
    "hilch_pcan2.trc": ("trc", "utc", 100_000),
    "lely_stm32_candump_td.txt": ("candump", "relative", 1000),
    "neg_j1939_bresilla_can_log.txt": ("candump", "utc", 1000),
    "roboteq_ros2_candump.txt": ("candump", "none", 1),
    "sevcon_20090330_preop.asc": ("asc", "utc", 100_000),
    "sevcon_20090331.candump.log": ("candump", "utc", 100_000),
}
# The facts number the ASC's only channel from 0, as python-can does; the file says 1.
CHANNELS = {"sevcon_20090330_preop.asc": {"1": 6634}}


def _capture(facts_file: Path) -> Path:
    name = facts_file.name.removesuffix(".json")
    return next(path for path in (CAPTURES / name, CAPTURES / f"{name}.gz") if path.exists())


def _ids(batch: FrameBatch, flags: FrameFlag, wanted: FrameFlag, digits: int) -> dict[str, int]:
    chosen = batch.can_id[(batch.flags & flags) == wanted]
    return {f"{can_id:0{digits}X}": count for can_id, count in Counter(chosen.tolist()).items()}


@pytest.mark.parametrize("facts_file", FACTS, ids=lambda path: path.name.removesuffix(".json"))
def test_a_real_capture_is_read_as_the_independent_program_read_it(facts_file: Path) -> None:
    listed: dict[str, Any] = json.loads(facts_file.read_text(encoding="utf-8"))
    truth, name = listed["facts"], listed["file"]
    batch, facts, gaps = read(_capture(facts_file))

    assert len(batch) == truth["n_frames"]
    counts = np.bincount(batch.bus, minlength=len(facts.buses)).tolist()
    assert dict(zip(facts.buses, counts, strict=True)) == CHANNELS.get(name, truth["channels"])
    assert int(np.count_nonzero(batch.flags & FrameFlag.ERROR)) == listed.get(
        "error_frame_lines", 0
    )
    kind = FrameFlag.EXTENDED | FrameFlag.REMOTE | FrameFlag.ERROR
    assert _ids(batch, kind, FrameFlag.EXTENDED, 8) == truth["ext_ids"]
    assert _ids(batch, kind, FrameFlag.REMOTE, 3) == truth["rtr_ids"]
    standard = batch[(batch.flags & kind) == 0]
    lengths: dict[str, dict[str, int]] = {}
    for (can_id, dlc), count in Counter(
        zip(standard.can_id.tolist(), standard.dlc.tolist(), strict=True)
    ).items():
        lengths.setdefault(f"{can_id:03X}", {})[str(dlc)] = count
    assert lengths == truth["std_data_ids_dlc"]
    assert [{"line": line, "text": text} for line, text in facts.unparsed_lines] == listed[
        "unparsed_lines"
    ]
    assert facts.unparsed_count == len(listed["unparsed_lines"])
    assert (facts.format, facts.time_base, facts.resolution_ns) == FORMATS[name]
    assert facts.damage is None
    assert gaps == []


@pytest.mark.parametrize("facts_file", FACTS, ids=lambda path: path.name.removesuffix(".json"))
def test_times_are_those_of_the_independent_program(facts_file: Path) -> None:
    listed = json.loads(facts_file.read_text(encoding="utf-8"))
    truth = listed["facts"]
    batch, facts, _ = read(_capture(facts_file))
    if not truth["has_timestamps"]:
        assert facts.time_base == "none"
        assert not batch.t_ns.any()
        return
    origin_ns = ORIGIN_NS.get(listed["file"], 0)
    assert int(batch.t_ns[0]) - origin_ns == round(truth["t_first"] * 10**6) * 1000
    assert int(batch.t_ns[-1]) - origin_ns == round(truth["t_last"] * 10**6) * 1000
    assert int(np.count_nonzero(np.diff(batch.t_ns) < 0)) == truth["n_backward_timestamps"]


def test_the_bit_rate_in_an_ixxat_header_is_taken() -> None:
    _, facts, _ = read(CAPTURES / "hilch_ixxat1.trc")
    assert facts.bitrates == {"1": 500_000}


def test_an_ixxat_trace_that_runs_past_its_stop_time_says_so() -> None:
    _, facts, _ = read(CAPTURES / "hilch_ixxat1.trc")
    assert any("66 s later than the stop time" in note for note in facts.notes)
