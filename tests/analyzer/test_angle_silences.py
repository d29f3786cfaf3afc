"""Times between the samples of a trace: silences among them, and stamps of damaged captures."""

import numpy as np
import pytest

from syncline_analyzer.folds.angle.link import Link, _spacing
from syncline_analyzer.folds.angle.samples import Samples
from syncline_analyzer.folds.angle.silence import Pauses
from syncline_schemas.decoder.pdo import MappedObject
from tests.analyzer.traps.script import Script

T0 = 1_760_000_000_000_000_001
SILENCE_NS = 1_234_567_891


def test_a_silence_lasts_as_long_wherever_the_samples_are_cut() -> None:
    t_ns = T0 + np.arange(40) * 10_000_000
    t_ns[20:] += SILENCE_NS - 10_000_000
    assert Pauses().silent(t_ns) == [(20, SILENCE_NS)]
    cut = Pauses()
    assert cut.silent(t_ns[:19]) == []
    assert cut.silent(t_ns[19:]) == [(1, SILENCE_NS)]


def test_stamps_too_far_apart_for_their_distance_are_no_silence() -> None:
    t_ns = np.arange(40) * 10_000_000 - 2**62
    t_ns[20:] += 2**62
    t_ns[20:] += 2**62
    assert Pauses().silent(t_ns) == []


def test_stamps_too_far_apart_for_their_distance_tell_a_spacing() -> None:
    ns = np.array([-(2**62), 2**62, 2**62 + 2**61])
    piece = Samples(MappedObject(0x6004, 0, 32, 0, "position"), ns, ns, ns, ns != 0, ns)
    assert _spacing(Link(), piece, 0x181, np.arange(3)) == (2**63 + 2**61) / 2


def test_the_time_of_frames_that_are_too_short_is_no_step_of_one_period() -> None:
    """The shaft went on turning while 1000 frames held two bytes only."""
    script = Script("haomiao-38", 3).read(-90, 0x6000, 0, 0, size=2).read(-80, 0x6001, 0, 8192)
    script.heartbeat(0, 60_000).pdo(0, 20_000, 20, lambda k: 100 + 273 * k)
    script.every(20_000, 40_000, 20, "183#0102")
    script.pdo(40_000, 60_000, 20, lambda k: 100 + 273 * (k + 2000))
    told = script.told()
    assert told.events("jump") == []
    assert "angle.jump" not in told.ids


@pytest.mark.parametrize("batch", [1 << 20, 700])
def test_turning_too_fast_where_a_trace_begins_and_ends_is_no_jump(batch: int) -> None:
    """The recorder came when the shaft was fast already; its PDO stayed away for a while."""
    script = Script("haomiao-38", 3).read(-90, 0x6000, 0, 0, size=2).read(-80, 0x6001, 0, 8192)
    script.heartbeat(0, 60_000).pdo(0, 20_000, 20, lambda k: 100 + 24_576 * k)
    script.pdo(40_000, 60_000, 20, lambda k: 100 + 273 * k)
    told = script.told(batch)
    assert told.events("jump") == []
    assert [f.id for f in told.analysis.findings if f.severity != "info"].count("angle.overspeed")
    assert "angle.jump" not in told.ids


@pytest.mark.parametrize(
    "jump", [(0, 30_000, 15_200), (15_200, 30_000, 0)], ids=["before", "after"]
)
def test_a_jump_next_to_legal_turning_is_no_turning_too_fast(jump: tuple[int, int, int]) -> None:
    """One step of 10,460 rpm between a shaft at rest and one that turns with 5570 rpm."""
    before, step, after = jump
    script = Script("haomiao-38", 3).read(-90, 0x6000, 0, 0, size=2).read(-80, 0x6001, 0, 8192)
    script.heartbeat(0, 10_000).pdo(0, 5000, 20, lambda k: 100 + before * k)
    start = 100 + before * 249 + step
    told = script.pdo(5000, 10_000, 20, lambda k: start + after * k).told()
    assert len(told.events("jump")) == 1
    assert "angle.overspeed" not in told.ids
