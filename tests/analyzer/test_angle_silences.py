"""Times between the samples of a trace: silences among them, and stamps of damaged captures."""

import numpy as np

from syncline_analyzer.folds.angle.link import Link, _spacing
from syncline_analyzer.folds.angle.samples import Samples
from syncline_analyzer.folds.angle.silence import Pauses
from syncline_schemas.decoder.pdo import MappedObject

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
